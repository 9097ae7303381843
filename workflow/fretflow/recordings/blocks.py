"""A block of a recording as columns in SI, with what it and its file say of units in agreement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnitError, UnreliableRecordingError, UnsupportedRecordingError
from fretflow.core.records import Array
from fretflow.core.units import per_cent, pretty_quantity
from fretflow.recordings.channels import INDICES, unit_size
from fretflow.recordings.headings import ALIASES, unit_in_heading
from fretflow.recordings.notes import Note, row_ranges, rows_in_words
from fretflow.recordings.periods import is_noisy, spikes, standing_still
from fretflow.recordings.plausibility import check_heading
from fretflow.recordings.readers.tables import Table, read_table
from fretflow.recordings.schema import DisplacementOf, FileBlock, LoopsBlock

LARGEST = 1e15  # in any unit; what is beyond was never measured
MOST_LOST = 0.2  # of the rows, whose index may be missing


@dataclass(frozen=True)
class Columns:
    """The channels of a block, row by row, in SI; nan where a cell is empty."""

    block: str
    path: Path
    values: Mapping[str, Array]
    units: Mapping[str, str]
    sd: Mapping[str, float] = field(default_factory=dict)
    calibration_sd: Mapping[str, float] = field(default_factory=dict)
    displacement_of: DisplacementOf | None = None
    notes: tuple[Note, ...] = ()

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.values.values())))

    @property
    def physical(self) -> tuple[str, ...]:
        """Return the names of the channels that were measured at an instant: neither indices nor time."""
        return tuple(name for name in self.values if name not in (*INDICES, "time"))

    def index(self, name: str) -> NDArray[np.int64]:
        """Return the whole numbers of channel `name`, all zero without it; -1 where there is none in a few rows.

        Raises
        ------
        UnreliableRecordingError
            If many are missing or no whole number, naming the rows.
        """
        values = self.values.get(name)
        if values is None:
            return np.zeros(self.rows, dtype=np.int64)
        good = np.isfinite(values) & (values == np.round(values)) & (values >= 0.0)
        if np.mean(good) < 1.0 - MOST_LOST:
            raise UnreliableRecordingError(
                f"{self.path}: {name}, {rows_in_words(row_ranges(np.flatnonzero(~good)))}: must be a whole number from "
                "0; repair or remove these rows")
        return np.where(good, values, -1.0).astype(np.int64)


def read_columns(name: str, block: FileBlock, folder: Path) -> Columns:
    """Read the file of a `block` called `name`, from the `folder` of the recording.

    Raises
    ------
    RecordingError
        If the file cannot be used, lacks a column, or states another unit than the block.
    """
    table = read_table(folder / block.file, [str(spec.column) for spec in block.channels.values()])
    return columns_of(table, name, block)


def columns_of(table: Table, name: str, block: FileBlock) -> Columns:
    """Return the columns of a `block` called `name` that is in `table`.

    Raises
    ------
    RecordingError
        If the table lacks a column, one stands for two channels, or it states another unit than the block.
    """
    values, units, notes, taken = {}, {}, table.notes, dict[str, str]()
    for channel, spec in block.channels.items():
        heading, column = _column(table, name, channel, spec.column)
        if (other := taken.setdefault(heading, channel)) != channel:
            raise UnsupportedRecordingError(f"{table.path}: column {heading} is named as {other} and as {channel} of "
                                            f"{name}; name a column for each")
        check_heading(table.path, name, channel, heading)
        _agree(table, name, channel, heading, spec.unit)
        size, units[channel] = unit_size(channel, spec.unit)
        size *= spec.scale
        if (wild := np.flatnonzero(np.abs(column) > LARGEST / max(1.0, abs(size)))).size:
            column = column.copy()
            column[wild] = np.nan
            notes += (Note(name, f"beyond {LARGEST:g}, taken as missing", channel, row_ranges(wild)),)
        values[channel] = column if size == 1.0 else column * size
    if isinstance(block, LoopsBlock):
        notes += _without_spikes(name, values) + _saturated(name, values, units)
    return Columns(
        name, table.path, values, units,
        sd={channel: sd for channel in block.channels if (sd := block.sd_of(channel)) is not None},
        calibration_sd={channel: spec.calibration_sd for channel, spec in block.channels.items()},
        displacement_of=block.displacement_of if isinstance(block, LoopsBlock) else None, notes=notes)


def _without_spikes(block: str, values: dict[str, Array]) -> tuple[Note, ...]:
    """Take spikes of the measured channels as missing, and return notes that name their rows."""
    begins = np.zeros(len(next(iter(values.values()))), dtype=bool)
    for name in set(INDICES) & set(values):
        begins[1:] |= np.diff(values[name]) != 0.0
    notes = []
    for name in [name for name in values if name not in (*INDICES, "time")]:
        if (rows := spikes(values[name], begins)).size:
            values[name] = values[name].copy()
            values[name][rows] = np.nan
            notes.append(Note(block, "a spike, taken as missing", name, row_ranges(rows)))
    return tuple(notes)


def _saturated(block: str, values: Mapping[str, Array], units: Mapping[str, str]) -> tuple[Note, ...]:
    """Return notes on channels that stand still at an extreme value; none where nothing has noise as sensors have."""
    notes = []
    if "displacement" not in values or not is_noisy(values["displacement"]):
        return ()
    for name in [name for name in values if name not in (*INDICES, "time")]:
        if (rows := np.flatnonzero(standing_still(values[name]))).size:
            limit = pretty_quantity(float(np.abs(values[name][rows]).max()), units[name], 4)
            share = per_cent(len(rows) / len(values[name]))
            notes.append(Note(block, f"stands still at {limit}, in {share} of the samples: a saturated sensor? "
                              "what is read of it is a lower bound", name, row_ranges(rows)))
    return tuple(notes)


def _column(table: Table, block: str, channel: str, column: str | int) -> tuple[str, Array]:
    try:
        return table.column(column)
    except UnsupportedRecordingError as error:
        raise UnsupportedRecordingError(f"{block}.{channel}.column: {error}") from error


def _agree(table: Table, block: str, channel: str, heading: str, unit: str) -> None:
    """Compare the unit that the block gives with that in the file, in its heading or beside it."""
    named = heading.strip().casefold() in ALIASES.get(channel, ())  # F_N is the normal force, in whatever unit
    stated = table.units.get(heading) or ("" if named else unit_in_heading(channel, heading))
    if not stated or channel in INDICES:
        return
    try:
        same = np.isclose(unit_size(channel, stated)[0], unit_size(channel, unit)[0], rtol=1e-9, atol=0.0)
    except UnitError as error:
        raise UnreliableRecordingError(f"{table.path}: column {heading} is in {stated!r}, which is no unit of "
                                       f"{channel} ({block}.{channel}); name the right column") from error
    if not same:
        raise UnreliableRecordingError(f"{block}.{channel}.unit: is {unit!r}, but the file {table.path} says "
                                       f"{stated!r} of column {heading}; correct the one that is wrong")
