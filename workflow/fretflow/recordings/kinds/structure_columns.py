"""Numbers and columns of a structure's recording: with their units, into SI."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BeforeValidator, Field

from fretflow.case.config import Section
from fretflow.core import units as u
from fretflow.core.errors import ConfigError, UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.recordings.headings import split_heading, unit_set_apart
from fretflow.recordings.notes import row_ranges, rows_in_words
from fretflow.recordings.readers.tables import Table

ANGULAR, HZ = "rad/s", 0.5 / np.pi
TABLE = "file, from the folder of recording.toml"  # what the key `file` of a block holds


class StructureColumn(Section):
    """A column of a file: its heading or place, unit, and errors."""

    column: str | int
    unit: str = ""
    sd: str | float | None = None
    calibration_sd: float = Field(0.0, ge=0.0, lt=1.0)


def parsed(value: object, unit: str) -> float:
    """Return a number with its unit, or in per cent where it counts."""
    if unit == "Hz" and isinstance(value, str) and value.strip().endswith(ANGULAR):
        return u.parse_quantity(value.replace(ANGULAR, unit), unit) * HZ
    if unit != "1":
        return u.parse_quantity(value, unit)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    text = str(value).strip()
    try:
        return 0.01 * float(text[:-1]) if text.endswith("%") else float(text)
    except ValueError as error:
        raise ValueError(f'{value!r} is no number; write it as 0.01 or "1 %"') from error


@dataclass(frozen=True, slots=True)
class Parsed(BeforeValidator):
    """What reads a key, in an SI unit that pages of keys can tell."""

    unit: str = "1"


def number(unit: str) -> Parsed:
    """Return what reads a number; nothing stays nothing."""
    return Parsed(lambda value: None if value is None else parsed(value, unit), unit=unit)


def positive_range(unit: str) -> Parsed:
    """Return what reads a range: a pair, or a table of low and high."""
    def parse(value: object) -> tuple[float, float]:
        pair = [value.get("low"), value.get("high")] if isinstance(value, dict) else value
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            example = '["1 kN", "20 kN"]' if unit == "N" else "[0.1, 0.9]"
            raise ValueError(f"{value!r} is no range; give its two ends, such as {example}")
        low, high = (parsed(end, unit) for end in pair)
        if not 0.0 < low < high:
            raise ValueError(f"{value!r}: the lower end must be positive and below the upper one")
        return low, high

    return Parsed(parse, unit=unit)


def _size(block: str, name: str, unit: str, choices: tuple[str, ...]) -> tuple[float, str]:
    """Return the size of `unit` in SI, and which of the SI units in `choices` it is one of."""
    if "1" in choices and unit in ("", "1", "%"):
        return (0.01 if unit == "%" else 1.0), "1"
    if not unit:
        raise ConfigError(f"{block}.{name}.unit: is required, for example {choices[0]!r}")
    for si in choices:
        if si == "1":
            continue
        if si == "Hz" and unit == ANGULAR:
            return HZ, si
        try:
            return u.parse_quantity(f"1 {unit}", si), si
        except ValueError:
            continue
    raise ConfigError(f"{block}.{name}.unit: {unit!r} is no unit like {' or '.join(choices)}")


def read_column(table: Table, block: str, name: str, spec: StructureColumn, choices: tuple[str, ...]
            ) -> tuple[Array, str]:
    """Return a column in SI and the SI unit it is in; none of its numbers may be missing."""
    heading, values = table.column(spec.column)
    size, si = _size(block, name, spec.unit, choices)
    apart = table.units.get(heading) or unit_set_apart(heading)
    stated = apart or split_heading(heading)[1]
    if stated and stated != spec.unit:
        try:
            other = _size(block, name, stated, choices)
        except ConfigError:  # part of a name that is no unit
            other = (size, si)
        # after a blank or _ may stand a part of the name: of zeta 1, of a_m in m/s^2
        if other != (size, si) and (apart or (other[1] == si and stated != "1")):
            raise UnreliableRecordingError(f"{block}.{name}.unit: is {spec.unit!r}, but the file {table.path} says "
                                           f"{stated!r} of column {heading}; correct the one that is wrong")
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        raise UnreliableRecordingError(f"{table.path}: {name}, {rows_in_words(row_ranges(wrong))}: no number; remove "
                                       "these rows")
    return values * size, si


def stated_sd(block: str, name: str, spec: StructureColumn, si: str) -> float | None:
    """Return the sd that is stated of a column, in SI, if there is one; a bare number is in per cent where that is."""
    if spec.sd is None:
        return None
    bare = spec.unit == "%" and not str(spec.sd).strip().endswith("%")
    try:
        sd = parsed(f"{spec.sd} %" if bare else spec.sd, si)
    except ValueError as error:
        raise ConfigError(f"{block}.{name}.sd: {error}") from error
    if not sd > 0.0:
        raise ConfigError(f"{block}.{name}.sd: must be positive, got {spec.sd!r}")
    return sd
