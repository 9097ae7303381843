"""A single file of loops without a ``recording.toml``: its columns are named by the user or read off its headings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fretflow.core.errors import UnitError, UnsupportedRecordingError
from fretflow.recordings.blocks import columns_of
from fretflow.recordings.channels import CHANNELS, INDICES, channel_of, unit_in_heading, unit_size
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
        loops, found = loops_of(columns, test)
    else:
        series, found = series_of(columns, test)
    return Recording(path=path, title=path.stem, test=test, loops=loops, series=series, notes=(*notes, *found))


def _specs(table: Table, wanted: Wanted) -> tuple[dict[str, dict[str, Any]], tuple[Note, ...]]:
    """Return the keys of a block for the channels of the table, and what was left out."""
    named = {channel: _named(table, channel, text) for channel, text in wanted.columns.items()}
    taken = {column for column, _ in named.values() if column}
    guessed: dict[str, str] = {}
    for heading in table.columns:
        channel = channel_of(heading)
        if heading in taken or channel is None or (channel in named and named[channel][0]):
            continue
        if channel in guessed:
            raise UnsupportedRecordingError(f"{table.path}: columns {guessed[channel]} and {heading} may both be the "
                                            f'{channel}; name one: --{_option(channel)} "{heading} [UNIT]"')
        guessed[channel] = heading
    specs: dict[str, dict[str, Any]] = {}
    for channel in CHANNELS:
        column, unit = named.get(channel, ("", ""))
        column = column or guessed.get(channel, "")
        unit = unit or unit_in_heading(channel, column) or _stated(table, channel, column)
        if channel in named and unit:
            _check_unit(channel, unit)
        if column and (unit or channel in INDICES):
            specs[channel] = {"column": column} if channel in INDICES else {"column": column, "unit": unit}
        elif channel in ("displacement", "friction_force") or channel in named:
            _demand(table, channel, column)
    used = {spec["column"] for spec in specs.values()}
    notes = tuple(Note(table.path.name, "column not used", heading) for heading in table.columns if heading not in used)
    return specs, notes


def _stated(table: Table, channel: str, column: str) -> str:
    """Return the unit that the file states for a column, where that is one of the channel's."""
    unit = table.units.get(column, "")
    try:
        unit_size(channel, unit)
    except UnitError:
        return ""
    return unit


def _check_unit(channel: str, unit: str) -> None:
    try:
        unit_size(channel, unit)
    except UnitError as error:
        raise UnitError(f"--{_option(channel)}: {error}") from error


def _demand(table: Table, channel: str, column: str) -> None:
    unit = "um" if CHANNELS[channel][0] == "m" else CHANNELS[channel][0]
    example = f'--{_option(channel)} "{column or "COLUMN"} [{unit}]"'
    if not column:
        raise UnsupportedRecordingError(f"{table.path}: no column {', '.join(table.columns)} is known as the "
                                        f"{channel}; name it: {example}, or in a file by `fretflow init --recording`")
    raise UnsupportedRecordingError(f"{table.path}: column {column} has no unit that is known as one of the "
                                    f"{channel}; give it: {example}")


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
        raise UnsupportedRecordingError(f"--{_option(channel)}: {error}") from error
