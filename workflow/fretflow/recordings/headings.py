"""What the columns of a file of loops are, read off their headings: usual English and German names, and units."""

from __future__ import annotations

import re
from collections.abc import Mapping

from fretflow.core.errors import UnitError
from fretflow.recordings.channels import CHANNELS, INDICES, unit_size
from fretflow.recordings.readers.tables import Table

NEEDED = ("displacement", "friction_force")  # of a loop

# Names of columns, as rigs export them; only read where no recording.toml says what a column is.
ALIASES = {
    "displacement": ("displacement", "disp", "delta", "position", "slip", "stroke", "x", "d",
                     "weg", "verschiebung", "relativverschiebung", "schwingweg", "gleitweg", "auslenkung"),
    "friction_force": ("friction_force", "force", "friction", "tangential_force", "ftr", "ft", "load", "q", "f",
                       "reibkraft", "reibungskraft", "tangentialkraft", "kraft", "fr", "f_r", "f_t"),
    "time": ("time", "t", "zeit"),
    "excitation": ("excitation", "shaker_force", "drive_force", "anregung", "anregungskraft",
                   "erregung", "erregerkraft"),
    "normal_force": ("normal_force", "normal_load", "fn", "n", "p", "normalkraft", "f_n", "anpresskraft"),
    "cycle": ("cycle", "cycles", "cycle_count", "zyklus", "zyklen", "zykluszahl", "zyklenzahl", "schwingspiel",
              "schwingspiele", "lastspiel", "lastspiele", "lastwechsel"),
    "repeat": ("repeat", "repetition", "wiederholung"),
}

LONGEST = 200  # characters of a heading that is taken apart
BRACKETED = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")
# "force in N", "force / N", "force, N", "force N"; with nothing else to part them, "force/N" or "force_N".
_UNIT_LAST = (re.compile(r"(.+?)(?:\s+in\s+|\s*[/,]\s+|\s+/|\s+)(\S+)"), re.compile(r"([^_/]+)/(\S+)"),
              re.compile(r"(.+)_([^_]*)"))


def split_heading(heading: str) -> tuple[str, str]:
    """Split a column's heading into its name and the text that may be its unit.

    ``displacement_um``, ``x [um]``, ``Weg in µm`` and ``Force (kN)`` carry a unit; ``friction_force`` only seems to.
    """
    for form in (BRACKETED, *_UNIT_LAST) if len(heading) <= LONGEST else ():
        if match := form.fullmatch(heading.strip()):
            return match[1].strip(), match[2]
    return heading, ""


def unit_set_apart(heading: str) -> str:
    """Return the text that may be a heading's unit, if it is no single letter or digit after a blank or ``_``.

    That may as well be a part of the name: of F_N, zeta 1, a_m.
    """
    name, unit = split_heading(heading)
    between = heading.strip().removeprefix(name).removesuffix(unit).strip()
    return unit if len(unit) > 1 or between not in ("", "_") else ""


def known_unit(channel: str, unit: str) -> str:
    """Return `unit` if it is one of the channel's, else nothing."""
    if not unit or channel in INDICES:
        return ""
    try:
        unit_size(channel, unit)
    except UnitError:
        return ""
    return unit


def unit_in_heading(channel: str, heading: str) -> str:
    """Return the unit that a column's `heading` states, if it is one of the channel's dimension."""
    return known_unit(channel, split_heading(heading)[1])


def unit_told(table: Table, channel: str, heading: str) -> str:
    """Return the unit that a file states for a column, in its heading or beside it, if it is one of the channel's."""
    return unit_in_heading(channel, heading) or known_unit(channel, table.units.get(heading, ""))


def unit_example(channel: str) -> str:
    """Return a unit that a channel is usual in."""
    si = CHANNELS[channel][0]
    return "um" if si == "m" else si


def columns_told(table: Table, taken: tuple[str, ...] = ()) -> dict[str, tuple[str, ...]]:
    """Return the columns that may be a channel, by channel; one where that is told, and none of those `taken`.

    Names tell it; where none does, a unit does if it is that of one column alone.
    """
    left = [heading for heading in table.columns if heading not in taken]
    candidates = {channel: tuple(heading for heading in left if _plain_names(heading) & set(names))
                  for channel, names in ALIASES.items()}
    unnamed = [heading for heading in left if not any(heading in columns for columns in candidates.values())]
    for channel in NEEDED:
        candidates[channel] = candidates[channel] or tuple(one for one in unnamed if unit_told(table, channel, one))
    # F_N is a force in N where there is no other, else the normal one
    needed = [candidates[channel] for channel in NEEDED]
    candidates = {channel: tuple(one for one in columns if channel in NEEDED or (one,) not in needed)
                  for channel, columns in candidates.items()}
    return {channel: columns for channel, columns in candidates.items() if columns}


def taken_in_words(taken: Mapping[str, str]) -> str:
    """Return which column was taken for which channel, on one line."""
    return ", ".join(f"{channel.replace('_', ' ')} from {column!r}" for channel, column in taken.items())


def _plain_names(heading: str) -> set[str]:
    return {re.sub(r"[\s-]+", "_", name.strip().casefold()) for name in (heading, split_heading(heading)[0])}
