"""The channels that a recording may have: one table of names and dimensions, and their units at the boundary."""

from __future__ import annotations

from fretflow.core.errors import UnitError
from fretflow.core.units import parse_quantity

# What says where a row belongs; whole numbers without a unit.
INDICES = ("cycle", "repeat", "condition")

# Name -> SI units that it may be kept in, one for each dimension that it may have.
CHANNELS: dict[str, tuple[str, ...]] = {
    "time": ("s",),
    "displacement": ("m",),
    "force": ("N",),
    "friction_force": ("N",),
    "excitation": ("N",),
    "normal_force": ("N",),
    "approach": ("m",),
    "velocity": ("m/s",),
    "acceleration": ("m/s^2",),
    "frequency": ("Hz",),
    "amplitude": ("m/N", "m", "m/s", "m/s^2", "m/s/N", "m/s^2/N", "N/m"),
    "phase": ("rad",),
    "x": ("m",),
    "y": ("m",),
    "depth": ("m",),
    **{name: ("1",) for name in INDICES},
}


def unit_size(channel: str, unit: str) -> tuple[float, str]:
    """Return the size of `unit` in SI and the SI unit that `channel` is then kept in.

    Raises
    ------
    UnitError
        If the unit is unknown or of no dimension that the channel may have.
    """
    reason = ""
    for si in CHANNELS[channel]:
        if si == "1":
            if unit in ("", "1"):
                return 1.0, "1"
            reason = f"{channel} counts something and has no unit, got {unit!r}; leave the unit out"
            continue
        try:
            size = parse_quantity(f"1 {unit}", si)
        except ValueError as error:
            reason = reason or str(error)
        else:
            if size > 0.0:
                return size, si
    raise UnitError(reason or f"{unit!r} is no unit of {channel}")
