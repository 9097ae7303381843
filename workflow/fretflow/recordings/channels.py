"""The channels that a recording may have: one table of names and dimensions, and their units at the boundary."""

from __future__ import annotations

import re

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

# Short names of columns, as rigs export them; only read where no recording.toml says what a column is.
ALIASES = {
    "displacement": ("displacement", "disp", "delta", "position", "slip", "stroke", "x", "d"),
    "friction_force": ("friction_force", "force", "friction", "tangential_force", "ftr", "ft", "load", "q", "f"),
    "time": ("time", "t"),
    "excitation": ("excitation", "shaker_force", "drive_force"),
    "normal_force": ("normal_force", "fn", "n", "p"),
    "cycle": ("cycle", "cycles", "cycle_count"),
    "repeat": ("repeat", "repetition"),
}

BRACKETED = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")


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


def split_heading(heading: str) -> tuple[str, str]:
    """Split a column's heading into its name and the text that may be its unit.

    ``displacement_um``, ``x [um]`` and ``Force (kN)`` carry a unit; ``friction_force`` only seems to.
    """
    if match := BRACKETED.fullmatch(heading):
        return match[1].strip(), match[2]
    name, _, unit = heading.rpartition("_")
    return (name, unit) if name else (heading, "")


def unit_in_heading(channel: str, heading: str) -> str | None:
    """Return the unit that a column's `heading` states, if it is one of the channel's dimension."""
    unit = split_heading(heading)[1]
    if not unit or CHANNELS[channel] == ("1",):
        return None
    try:
        unit_size(channel, unit)
    except UnitError:
        return None
    return unit


def channel_of(heading: str) -> str | None:
    """Return the channel that a column's `heading` names, by its full or short name, if any."""
    names = {heading.strip().lower().replace(" ", "_"), split_heading(heading)[0].strip().lower().replace(" ", "_")}
    return next((channel for channel, aliases in ALIASES.items() if names & set(aliases)), None)
