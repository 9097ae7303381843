"""A single file of loops without a ``recording.toml``: its columns are named by the user or read off its headings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fretflow.core.errors import UnitError, UnsupportedRecordingError
from fretflow.recordings.blocks import columns_of
from fretflow.recordings.channels import CHANNELS, INDICES, unit_size
from fretflow.recordings.headings import NEEDED, columns_told, known_unit, taken_in_words, unit_example, unit_told
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT
from fretflow.recordings.notes import Note
from fretflow.recordings.readers.tables import Table, read_table
from fretflow.recordings.recording import Recording, loops_of, series_of
from fretflow.recordings.schema import LoopsBlock, RecordedTest

_WITH_UNIT = re.compile(r"\s*(.*?)\s*\[\s*([^\]]+?)\s*\]\s*")


@dataclass(frozen=True)
class Wanted:
    """What the user says of a bare file: by channel ``"COLUMN [UNIT]"``, ``"COLUMN"`` or ``"[UNIT]"``."""

    columns: Mapping[str, str] = field(default_factory=dict)
    excitation_frequency: float | None = None  # Hz


def read_bare(path: Path, wanted: Wanted) -> Recording:
    """Read a file of displacement and force.

    With a column of cycles it holds loops at several cycle counts; otherwise it is one record, cut into the cycles
    by which the displacement comes back.

    Raises
    ------
    RecordingError
        If the file cannot be used, or its columns or units cannot be told.
    """
    table = read_table(path)
    specs, notes = _specs(table, wanted)
    test = RecordedTest(kind=IMPOSED_DISPLACEMENT)
    if wanted.excitation_frequency is not None:
        test = test.model_copy(update={"excitation_frequency": wanted.excitation_frequency})
    name = "loops" if "cycle" in specs else "series"
    columns = columns_of(table, name, LoopsBlock.model_validate({"file": path.name, **specs}))
    loops = series = None
    if name == "loops":
        loops, more = loops_of(columns, test)
    else:
        series, more = series_of(columns, test)
    return Recording(path=path, title=path.stem, test=test, loops=loops, series=series, notes=(*notes, *more))


def _specs(table: Table, wanted: Wanted) -> tuple[dict[str, dict[str, Any]], tuple[Note, ...]]:
    """Return the keys of a block for the channels of the table, and notes on what was taken and what was left out."""
    named = {channel: _named(table, channel, text) for channel, text in wanted.columns.items()}
    told = columns_told(table, tuple(column for column, _ in named.values() if column))
    specs: dict[str, dict[str, Any]] = {}
    lacks: dict[str, str] = {}
    for channel in CHANNELS:
        column, unit = named.get(channel, ("", ""))
        if not column and len(told.get(channel, ())) > 1:
            raise UnsupportedRecordingError(f"{table.path}: columns {' and '.join(told[channel])} may both be the "
                                            f'{channel}; name one: --{_option(channel)} "{told[channel][-1]} [UNIT]"')
        column = column or "".join(told.get(channel, ()))
        unit = unit or unit_told(table, channel, column)
        if channel in named and unit:
            _check_unit(channel, unit)
        if column and (unit or channel in INDICES):
            specs[channel] = {"column": column} if channel in INDICES else {"column": column, "unit": unit}
        elif channel in NEEDED or channel in named:
            lacks[channel] = column
    if lacks:
        raise UnsupportedRecordingError(f"{table.path}: {_asked(table, lacks)}")
    used = {spec["column"] for spec in specs.values()}
    notes = tuple(Note(table.path.name, "column not used", heading) for heading in table.columns if heading not in used)
    taken = {channel: spec["column"] for channel, spec in specs.items() if not named.get(channel, ("",))[0]}
    if taken:
        notes = (Note(table.path.name, f"{taken_in_words(taken)}: as the headings tell"), *notes)
    return specs, notes


def _check_unit(channel: str, unit: str) -> None:
    try:
        unit_size(channel, unit)
    except UnitError as error:
        raise UnitError(f"--{_option(channel)}: {error}") from error


def _asked(table: Table, lacks: Mapping[str, str]) -> str:
    """Return what is asked of the user where headings do not tell a channel, or not its unit."""
    unknown = " or the ".join(channel for channel, column in lacks.items() if not column)
    told = [f"no column {', '.join(table.columns)} is known as the {unknown}"] if unknown else []
    told += [f"column {column} has no unit that is known as one of the {channel}"
             for channel, column in lacks.items() if column]
    options = " ".join(f'--{_option(channel)} "{column or "COLUMN"} [{unit_example(channel)}]"'
                       for channel, column in lacks.items())
    return (f"{' and '.join(told)}; name {'it' if len(lacks) == 1 else 'them'}: {options}, or in a file by `fretflow "
            "init --recording`")


def _option(channel: str) -> str:
    return "force" if channel == "friction_force" else channel


def _named(table: Table, channel: str, text: str) -> tuple[str, str]:
    """Return the column and the unit of ``"COLUMN [UNIT]"``; either may be empty."""
    if text in table.columns:
        return text, ""
    if match := _WITH_UNIT.fullmatch(text):
        column, unit = match[1], match[2]
    else:
        column, unit = text, ""
    if not column:
        return "", unit
    try:
        return table.column(column)[0], unit
    except UnsupportedRecordingError as error:
        brackets = f'; a unit alone stands in brackets, "[{text}]"' if known_unit(channel, text) else ""
        raise UnsupportedRecordingError(f"--{_option(channel)}: {error}{brackets}") from error
