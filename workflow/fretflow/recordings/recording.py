"""A whole recording, read and cleaned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fretflow.case.config import Rig, Specimens
from fretflow.core.errors import RecordingError, UnreliableRecordingError
from fretflow.core.records import Array, record
from fretflow.recordings.blocks import Columns, read_columns
from fretflow.recordings.cleaning import clean_loops
from fretflow.recordings.description import file_at
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.loopset import LoopSet, Series, frozen_arrays
from fretflow.recordings.notes import Note, row_ranges
from fretflow.recordings.periods import cycle_cuts
from fretflow.recordings.plausibility import check_file, check_loops, check_motion, check_wear
from fretflow.recordings.schema import (
    FILE,
    FileBlock,
    RecordedTest,
    RecordedWear,
    RecordingFile,
    SweepCondition,
    load_recording_file,
    name_of,
)
from fretflow.recordings.series import clean_series, loops_of_series

if TYPE_CHECKING:
    import xarray as xr


@record
class Points:
    """A table without cycles, P rows in SI: a frequency response or a map of depth."""

    channels: Mapping[str, Array]
    units: Mapping[str, str]
    sd: Mapping[str, float]
    calibration_sd: Mapping[str, float]

    def check(self) -> None:
        """Make the channels read-only."""
        object.__setattr__(self, "channels", frozen_arrays(self.channels))


@record
class LoopSweep:
    """Loops at other conditions; `loops.cycles` holds the ids of the `conditions`, in the same order."""

    conditions: tuple[SweepCondition, ...]  # complete, as far as the test is
    loops: LoopSet


@record
class Recording:
    """What was recorded, in SI, and what had to be done to it."""

    path: Path
    title: str
    test: RecordedTest
    rig: Rig | None = None  # None where nothing is said of it
    specimen: Specimens | None = None
    given: Mapping[str, Any] = field(default_factory=dict)  # of test, rig and specimen, by the keys of case files
    wear: RecordedWear = field(default_factory=RecordedWear)
    loops: LoopSet | None = None
    series: Series | None = None
    sweep: LoopSweep | None = None
    frf: Points | None = None
    wear_depth: Points | None = None
    notes: tuple[Note, ...] = ()

    @property
    def kind(self) -> RecordingKind:
        """Return what is to be predicted."""
        return self.test.kind

    @property
    def arrays(self) -> xr.Dataset:
        """Return the loops as `LoopSet.arrays` does, those of whole periods where one long record was made.

        Raises
        ------
        RecordingError
            If there are no loops.
        """
        if self.loops is not None:
            return self.loops.arrays
        if self.series is None:
            raise RecordingError(f"{self.path}: holds no loops; [loops] or [series] in {FILE} names them")
        return loops_of_series(self.series)[0].arrays


def read_joint_recording(path: Path) -> Recording:
    """Read loops, records and maps of a joint: a recording's folder or its ``recording.toml``.

    Raises
    ------
    RecordingError
        If a file is damaged, contradicts another or too little of it is usable.
    ConfigError
        If ``recording.toml`` has a missing, unknown or impossible value.
    """
    toml = file_at(path)
    file = load_recording_file(toml)
    folder, test = toml.parent, file.test
    notes: list[Note] = []
    loops = series = sweep = None
    if file.loops is not None:
        loops, more = loops_of(read_columns("loops", file.loops, folder), test)
        check_file(toml, file, loops.cycles)
        notes += more
    if file.series is not None:
        series, more = series_of(read_columns("series", file.series, folder), test)
        notes += more
    if file.sweep is not None:
        sweep, more = _sweep(read_columns("sweep", file.sweep, folder), file)
        notes += more
    tables: dict[str, Points | None] = {"frf": None, "wear_depth": None}
    for name in tables:
        block: FileBlock | None = getattr(file, name)
        if block is not None:
            tables[name], more = _points(read_columns(name, block, folder))
            notes += more
    if (depth := tables["wear_depth"]) is not None:
        check_wear(toml, file.wear.worn_volume, depth.channels)
    return Recording(
        path=path, title=file.title or name_of(path), test=test, rig=file.rig, specimen=file.specimen,
        given=file.given(), wear=file.wear, loops=loops, series=series, sweep=sweep, notes=tuple(notes), **tables)


def loops_of(columns: Columns, test: RecordedTest) -> tuple[LoopSet, tuple[Note, ...]]:
    """Clean the loops of a block and compare them with what is stated of the test."""
    frequency = float("nan") if test.excitation_frequency is None else test.excitation_frequency
    loops, notes = clean_loops(columns, lambda _: frequency)
    count = len(loops.cycles)
    notes += check_loops(columns.path, columns.block, loops, test, _stated([test.normal_load] * count),
                         _stated([test.excitation_amplitude] * count))
    if count == 1 and len(loops.repeats) == 1:
        notes += (Note(columns.block, "one cycle count only: no evolution can be seen"),)
    if loops.repeats.max() < 2:
        notes += (Note(columns.block, "no repeats: uncertainties rest on the noise within each loop"),)
    return loops, notes


def series_of(columns: Columns, test: RecordedTest) -> tuple[Series, tuple[Note, ...]]:
    """Clean a long record and compare it with what is stated of the test."""
    series, notes = clean_series(columns)
    if "displacement" in series.channels:
        check_motion(columns.path, columns.block, test.kind, float(np.ptp(series.channels["displacement"])))
        notes += _other_frequency(series, test.excitation_frequency)
    return series, notes


def _other_frequency(series: Series, stated: float | None) -> tuple[Note, ...]:
    """Return a note where the displacement comes back at quite another frequency than that stated, Hz."""
    cuts = cycle_cuts(series.channels["displacement"])
    if stated is None or not series.sampling_interval or len(cuts) < 3:
        return ()
    frequency = 1.0 / (float(np.median(np.diff(cuts))) * series.sampling_interval)
    if abs(np.log2(frequency / stated)) < 1.0:
        return ()
    return (Note("series", f"cycles come at {frequency:.4g} Hz where {stated:.4g} Hz are stated; correct "
                 "excitation_frequency or the unit of time", "time"),)


def _sweep(columns: Columns, file: RecordingFile) -> tuple[LoopSweep, tuple[Note, ...]]:
    if file.sweep is None:
        raise UnreliableRecordingError("sweep: there is no such block")
    test = file.test
    keys = [key for key in SweepCondition.model_fields if key != "id"]
    stated = {c.id: c.model_copy(update={key: getattr(test, key) for key in keys if getattr(c, key) is None})
              for c in file.sweep.conditions}
    there = np.unique(columns.index("condition"))
    there = there[there >= 0]
    unknown = [int(i) for i in there if int(i) not in stated]
    if unknown:
        raise UnreliableRecordingError(f"sweep.conditions: none has the id {unknown[0]} that stands in {columns.path}; "
                                       "describe it or remove its rows")

    def frequency(condition: int) -> float:
        value = stated[condition].excitation_frequency
        return float("nan") if value is None else value

    loops, notes = clean_loops(columns, frequency, index="condition")
    conditions = tuple(stated[int(i)] for i in loops.cycles)
    notes += check_loops(columns.path, "sweep", loops, test, _stated([c.normal_load for c in conditions]),
                         _stated([c.excitation_amplitude for c in conditions]))
    absent = [str(i) for i in stated if i not in there]
    if absent:
        notes += (Note("sweep", f"no rows for the conditions {', '.join(absent)}"),)
    return LoopSweep(conditions=conditions, loops=loops), notes


def _points(columns: Columns) -> tuple[Points, tuple[Note, ...]]:
    complete = np.all([np.isfinite(values) for values in columns.values.values()], axis=0)
    notes = columns.notes
    if not complete.all():
        notes += (Note(columns.block, "lack a number and are left out", "", row_ranges(np.flatnonzero(~complete))),)
    return Points(channels={name: values[complete] for name, values in columns.values.items()}, units=columns.units,
                  sd=columns.sd, calibration_sd=columns.calibration_sd), notes


def _stated(values: list[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])
