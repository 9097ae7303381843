"""What the columns of a table of wear tests are, read off their headings.

Such tables are typed by hand: ``V_mm3``, ``SigmaEd_J``, ``phi_star_W_per_mm2``, ``alpha_1e-5_mm3_per_J``,
``Pressure [MPa]``. The unit's dimension tells what a column may be; where several columns share one, the name decides.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from fretflow.core.units import parse_quantity
from fretflow.recordings.headings import BRACKETED

# Role -> SI unit that it is kept in and names that it goes by; "1": a number that counts.
ROLES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "volume": ("m^3", ("v", "volume", "wear_volume", "worn_volume", "wear")),
    "volume_sd": ("m^3", ("v_sd", "sd_v", "volume_sd", "wear_volume_sd", "worn_volume_sd", "sd")),
    "energy": ("J", ("e", "ed", "sigmaed", "energy", "dissipated_energy", "friction_energy")),
    "coefficient": ("m^3/J", ("alpha", "coefficient", "energy_coefficient", "wear_coefficient", "k")),
    "pressure": ("Pa", ("p", "pressure", "mean_pressure", "p_mean", "pmax", "pmax_h", "p_max", "p0")),
    "load": ("N", ("n", "fn", "load", "normal_load", "normal_force", "p", "w")),
    "amplitude": ("m", ("delta", "delta_g", "d", "amplitude", "amp", "displacement", "displacement_amplitude",
                        "sliding_amplitude")),
    "sliding_distance": ("m", ("sliding_distance", "distance", "total_sliding", "s")),
    "frequency": ("Hz", ("f", "frequency", "freq")),
    "power_density": ("W/m^2", ("phi", "phi_star", "q", "power_density", "friction_power_density")),
    "cycles": ("1", ("n", "cycles", "n_cycles", "cycle", "number_of_cycles")),
}
BY_NAME_ALONE = frozenset({"volume_sd", "amplitude", "sliding_distance", "cycles"})  # else what has the unit will do

_POWERS = re.compile(r"(?<=[A-Za-z])(-?\d)")


@dataclass(frozen=True)
class Heading:
    """A heading taken apart; the factor stands in front of the unit."""

    name: str
    unit: str  # as pint reads it, nothing where there is none
    factor: float = 1.0


def take_apart(heading: str, stated: str = "") -> Heading:
    """Return name and unit of a heading; the unit that the file states apart goes first.

    ``alpha_1e-5_mm3_per_J`` is alpha in 1e-5 mm^3/J.
    """
    bracketed = BRACKETED.fullmatch(heading)
    name, unit = (bracketed[1], bracketed[2]) if bracketed else (heading, stated)
    if unit:
        return _with_factor(name, unit)
    words = heading.strip().replace(" ", "_").split("_")
    start = len(words) - 1
    while start > 1 and words[start - 1].lower() == "per":
        start -= 2
    name = "_".join(words[:start])
    if start < 1 or dimension(_readable("_".join(words[start:]))) is None:
        return Heading(heading, "")
    if start > 1 and (factor := _number(words[start - 1])) is not None:
        return Heading("_".join(words[:start - 1]), _readable("_".join(words[start:])), factor)
    return Heading(name, _readable("_".join(words[start:])))


def dimension(unit: str) -> str | None:
    """Return the SI unit among those of the roles that `unit` has the dimension of, if any."""
    for si in dict.fromkeys(si for si, _ in ROLES.values() if si != "1"):
        try:
            parse_quantity(f"1 {unit}", si)
        except ValueError:
            continue
        return si
    return None


def roles_of(headings: Mapping[str, Heading]) -> dict[str, tuple[str, ...]]:
    """Return the columns that may have each role, those by its name before those by its unit alone."""
    roles: dict[str, tuple[str, ...]] = {}
    for role, (si, names) in ROLES.items():
        own = [column for column, heading in headings.items() if (dimension(heading.unit) or "1") == si]
        plain = {column: _plain(headings[column].name) for column in own}
        named = sorted((column for column in own if plain[column] in names), key=lambda c: names.index(plain[c]))
        others = [] if role in BY_NAME_ALONE else [column for column in own if column not in named
                                                   and plain[column] not in ROLES["volume_sd"][1]]
        if named or others:
            roles[role] = (*named, *others)
    return roles


def _with_factor(name: str, unit: str) -> Heading:
    first, _, rest = unit.strip().partition(" ")
    factor = _number(first) if rest else None
    return Heading(name.strip(), _readable(rest if factor is not None else unit), 1.0 if factor is None else factor)


def _readable(unit: str) -> str:
    """Return a unit as pint reads it: ``mm3_per_J`` is ``mm^3/J``."""
    return _POWERS.sub(r"^\1", unit.replace("_per_", "/")) if "^" not in unit else unit


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _plain(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")
