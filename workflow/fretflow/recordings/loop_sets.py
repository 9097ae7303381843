"""All loops of a recording and what is read off them, as tables for programs: CSV and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fretflow.core.errors import InputError, UnreliableRecordingError, UnsupportedRecordingError
from fretflow.core.units import pretty_quantity
from fretflow.recordings.bare import Wanted, read_bare
from fretflow.recordings.kinds import FILE, read_recording
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.notes import Note
from fretflow.recordings.plausibility import check_friction
from fretflow.recordings.readings import LoopReading, RecordedReadings, read_recorded_loops, without_friction
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import repeatability
from fretflow.recordings.schema import RecordedTest, SweepCondition
from fretflow.recordings.series import loops_of_series

QUANTITIES = {
    "friction_coefficient": "1", "friction_limit": "N", "tangential_stiffness": "N/m", "dissipated_energy": "J",
    "sliding_distance": "m", "peak_to_peak": "m",
}


@dataclass(frozen=True)
class LoopsRead:
    """A set of loops and what was read off them."""

    name: str
    index: str  # what tells the loops apart
    called: tuple[str, ...]  # each loop that is read, for people
    loops: LoopSet
    readings: RecordedReadings

    @property
    def shown(self) -> tuple[str, ...]:
        """Return the quantities that some loop shows; the friction limit only where it tells no coefficient."""
        names = {name for name in QUANTITIES if np.isfinite(getattr(self.readings, name).value).any()}
        if np.isfinite(self.readings.stiffness_at_least).any():
            names.add("tangential_stiffness")
        if "friction_coefficient" in names:
            names.discard("friction_limit")
        return tuple(name for name in QUANTITIES if name in names)

    def largest(self, name: str) -> float:
        """Return the largest size of a quantity; of a stiffness that is only bounded, that of its bounds."""
        values = getattr(self.readings, name).value
        if name == "tangential_stiffness" and not np.isfinite(values).any():
            values = self.readings.stiffness_at_least
        return float(np.nanmax(np.abs(values)))


def recorded(path: Path, given: Mapping[str, str], load: float | None, hertz: float | None) -> tuple[
        Recording, float | None]:
    """Return the recording at `path` and its normal load in N, from the file or else from the user.

    Parameters
    ----------
    path : Path
        Folder of a recording, its ``recording.toml``, or a single file of loops.
    given : mapping
        For a single file, ``"COLUMN [UNIT]"`` by channel as far as it is not to be found by itself.
    load, hertz : float or None
        Normal load in N and frequency in Hz; refused where the recording says something else.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    InputError
        If what is given is there already, or nothing is at `path`.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such folder or file; give a folder with a {FILE}, or one file of loops")
    if not path.is_dir() and path.suffix != ".toml":
        return read_bare(path, Wanted(given, hertz)), load
    if given:
        option = next(iter(given)).removeprefix("friction_")
        raise InputError(f"--{option}: columns are named in {FILE} already; leave it out")
    recording = read_recording(path)
    if not isinstance(recording, Recording):
        raise UnsupportedRecordingError(f"{path}: a {recording.kind} is no recording of loops; `fretflow diagnose` "
                                        "reads it")
    test = recording.test
    for option, mine, stated in (("--normal-load", load, test.normal_load),
                                 ("--frequency", hertz, test.excitation_frequency)):
        if mine is not None and stated is not None and abs(mine / stated - 1.0) > 1e-6:
            raise UnreliableRecordingError(f"{option}: {mine:g} where the recording says {stated:g}; leave the option "
                                           f"out or correct {FILE}")
        if option == "--frequency" and mine is not None and stated is None:
            raise InputError(f"--frequency: give test.excitation_frequency in {FILE}, which tells all else of the test")
    return recording, load if test.normal_load is None else test.normal_load


def read_sets(recording: Recording, load: float | None) -> tuple[list[LoopsRead], tuple[Note, ...]]:
    """Return all loops of the recording under a normal `load` in N, read, and its notes.

    Raises
    ------
    UnreliableRecordingError
        If a loop shows a friction that no contact has.
    InputError
        If there are no loops.
    """
    notes = recording.notes
    relative = (recording.test.normal_load_sd or 0.0) / (recording.test.normal_load or 1.0)
    sets = []

    def add(name: str, loops: LoopSet, loads: Sequence[float | None], consecutive: bool = False,
            conditions: Mapping[int, str] | None = None) -> None:
        known = np.array([np.nan if value is None else value for value in loads])
        readings = read_recorded_loops(loops, known, relative, consecutive)
        lumped = not recording.kind.friction_alone
        shown = np.flatnonzero(np.isfinite(readings.friction_coefficient.value))
        below = np.flatnonzero(readings.friction_limit.value <= 0.0)
        if below.size and not lumped:
            raise UnreliableRecordingError(
                f"{recording.path}: {name}: friction force of loop {readings.cycles[below[0]]}: its plateaus are the "
                "wrong way round; see its samples for damaged ones")
        if shown.size and not lumped:
            k = shown[np.argmax(readings.friction_coefficient.value[shown])]
            check_friction(f"{recording.path}: {name}: friction force of loop {readings.cycles[k]}",
                           float(readings.friction_coefficient.value[k]), float(known[k]))
        called = tuple(conditions[int(k)] if conditions else f"{k:,}" for k in readings.cycles)
        sets.append(LoopsRead(name, "conditions" if conditions else "cycles", called, loops,
                              without_friction(readings) if lumped else readings))

    if recording.loops is not None:
        add("loops", recording.loops, [load] * len(recording.loops.cycles))
    if recording.series is not None:
        loops, more = loops_of_series(recording.series)
        notes += more
        add("series", loops, [load] * len(loops.cycles), consecutive=True)
    if recording.sweep is not None:
        add("sweep", recording.sweep.loops, [c.normal_load for c in recording.sweep.conditions],
            conditions={c.id: _differs(c, recording.test) for c in recording.sweep.conditions})
    if not sets:
        raise InputError(f"{recording.path}: has no loops, series or sweep to read")
    if recording.kind.friction_alone and any(np.isnan(s.readings.friction_coefficient.value).all() and
                                                     np.isfinite(s.readings.friction_limit.value).any() for s in sets):
        notes += (Note("test", "the normal load is not known, so the friction limit is given instead of a coefficient; "
                       "--normal-load adds it", "normal_load"),)
    return sets, notes


def _differs(condition: SweepCondition, test: RecordedTest) -> str:
    """Return by what a condition differs from the test, for people; the rest is as there."""
    parts = (("excitation", "excitation_amplitude", "N"), ("displacement", "displacement_amplitude", "m"),
             ("load", "normal_load", "N"), ("", "excitation_frequency", "Hz"))
    told = [f"{word} {pretty_quantity(value, unit, 4)}".strip() for word, key, unit in parts
            if (value := getattr(condition, key)) is not None and value != getattr(test, key)]
    return ", ".join(told) or "as the test"


def csv_columns(loops_read: LoopsRead) -> dict[str, Any]:
    """Return the columns of a table of all readings; units stand in their names."""
    readings, repeats = loops_read.readings, loops_read.loops.repeats
    columns: dict[str, Any] = {loops_read.index: readings.cycles, "called": loops_read.called,
                               "repeats": repeats[repeats > 0], "regime": readings.regime}
    for name, unit in QUANTITIES.items():
        estimate: LoopReading = getattr(readings, name)
        tail = "" if unit == "1" else f"_{unit.replace('/', '_per_')}"
        columns[f"{name}{tail}"] = estimate.value
        for part in ("sd", "noise", "repeats", "calibration"):
            columns[f"{name}_{part}{tail}"] = getattr(estimate, part)
    columns["tangential_stiffness_at_least_N_per_m"] = readings.stiffness_at_least
    return columns


def as_json(recording: Recording, load: float | None, sets: Sequence[LoopsRead], notes: Sequence[Note]
            ) -> dict[str, Any]:
    """Return everything as JSON takes it; what a loop does not show is null."""
    return {
        "recording": str(recording.path), "title": recording.title, "kind": str(recording.kind),
        "normal_load": None if load is None else {"value": load, "unit": "N"},
        "sets": [{"name": loops_read.name, "told_apart_by": loops_read.index, "aligned_to": loops_read.loops.aligned_to,
                  "loops": [_plain_row(loops_read, k) for k in range(len(loops_read.readings.cycles))],
                  "repeatability": _plain_repeats(loops_read.loops)} for loops_read in sets],
        "warnings": [{"text": note.text, "block": note.block, "channel": note.channel, "rows": note.rows}
                     for note in notes],
    }


def _plain_row(loops_read: LoopsRead, k: int) -> dict[str, Any]:
    readings = loops_read.readings
    row: dict[str, Any] = {loops_read.index.removesuffix("s"): int(readings.cycles[k]), "called": loops_read.called[k],
                           "regime": readings.regime[k]}
    for name, unit in QUANTITIES.items():
        estimate: LoopReading = getattr(readings, name)
        source = estimate.dominated_by[k]
        row[name] = {"value": _number(estimate.value[k]), "sd": _number(estimate.sd[k]), "unit": unit,
                     "mostly_by": None if source is None else str(source)}
    row["tangential_stiffness"]["at_least"] = _number(readings.stiffness_at_least[k])
    return row


def _plain_repeats(loops: LoopSet) -> dict[str, Any] | None:
    if loops.repeats.max() < 2:
        return None
    repeats = {name: repeatability(np.where(loops.usable[:, :, None], values, np.nan))
               for name, values in loops.channels.items()}
    return {name: {"noise_sd": float(np.sqrt(np.mean(r.noise_sd**2))), "gain_sd": r.gain_sd, "offset_sd": r.offset_sd,
                   "repeat_sd": float(np.sqrt(np.mean(r.repeat_sd**2))), "unit": loops.units[name]}
            for name, r in repeats.items()}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
