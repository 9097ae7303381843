"""Nonlinear frequency responses of a run: curves by continuation, and what is read off them.

They are no stage of a run: each curve is kept beside the run's stages under a name that holds a hash of all that it
depends on, and is made once. While it is followed its points are kept in a file of their own, from which an interrupted
one goes on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log
from pathlib import Path
from typing import Any

import numpy as np

from fretflow.case.config import Case, PeriodicMethod, slice_hash
from fretflow.core.errors import InputError
from fretflow.core.progress import Progress
from fretflow.core.records import quantity, record
from fretflow.core.store import read_record, write_csv, write_record
from fretflow.pipeline.problem import make_model
from fretflow.pipeline.run_records import RunRecords
from fretflow.pipeline.stage import write_json
from fretflow.solvers.continuation.curve import CHANNELS, Peak, ResponseCurve, SweepDirection, read_peak
from fretflow.solvers.continuation.follow import Sweep, respond
from fretflow.solvers.periodic import PeriodicProblem

VERSION = 4  # of the curves; a new one makes old files unused
FOLDER = "response_curves"
PEAKS = "peaks.json"
UNFINISHED = ".part"  # ending of the file of a curve that is being followed
HARMONICS, SAMPLES = 40, 256  # at least: an arm that sticks rings at many times the lowest frequencies


@record
class RunCurve:
    """A response curve of a run, unworn or after `cycles` cycles of wear."""

    state: str
    cycles: int
    curve: ResponseCurve

    @property
    def name(self) -> str:
        """Return a short name for people."""
        return f"{self.state}, {self.curve.excitation:g} N"

    def peak(self, direction: SweepDirection) -> Peak:
        """Return the moving mass's largest resonance on the curve of `direction`."""
        return read_peak(self.curve, "block", direction)


@record
class FoundPeak:
    """A line of the table of peaks; lengths of the moving mass's first harmonic. None where there is none."""

    state: str
    cycles: int
    direction: str
    excitation: float = quantity("N")
    frequency: float = quantity("Hz")
    amplitude: float = quantity("m")
    lower_half_power: float | None = quantity("Hz")
    upper_half_power: float | None = quantity("Hz")
    damping_ratio: float | None = quantity("1")
    reason: str  # why there is no damping ratio
    turning_points: int
    unstable_points: int
    points: int
    bridged_points: int
    sampling_error: float = quantity("1")

    @property
    def gaps(self) -> str:
        """Return how many gaps were bridged, in words."""
        return "1 gap" if self.bridged_points == 1 else f"{self.bridged_points} gaps"

    @property
    def text(self) -> str:
        """Return what was found, for people."""
        damping = (f"no damping: {self.reason}" if self.damping_ratio is None
                   else f"damping {100.0 * self.damping_ratio:.2f} %")
        folds = f"{self.turning_points} turning points" if self.turning_points else "no fold"
        unstable = f", {self.unstable_points} unstable" if self.unstable_points else ", all stable"
        bridged = f", {self.gaps} bridged" if self.bridged_points else ""
        return (f"{self.frequency:.5g} Hz, {self.amplitude * 1e6:.4g} µm, {damping}; {self.points} points, "
                f"{folds}{unstable}{bridged}")


@dataclass(frozen=True)
class AskedCurve:
    """A curve to be made: its problem, with the wear and the excitation, and where it is kept."""

    state: str
    cycles: int
    problem: PeriodicProblem
    sweep: Sweep
    file: Path

    @property
    def name(self) -> str:
        """Return a short name for people."""
        return f"{self.state}, {self.problem.excitation.amplitude:g} N"


def sweep_of(case: Case, start: float | None, stop: float | None) -> Sweep:
    """Return range and settings for `case`: its samples at the peak, half of them along the curve, or more.

    Raises
    ------
    InputError
        If the range is empty.
    """
    asked = case.output.frequency_response
    low, high = asked.start if start is None else start, asked.stop if stop is None else stop
    if not 0.0 < low < high:
        raise InputError(f"--start {low:g} Hz, --stop {high:g} Hz: start must be positive and below stop")
    own = (0, 0) if case.solver.method is PeriodicMethod.DLFT else (case.solver.resolved_harmonics,
                                                                    case.solver.resolved_samples)
    harmonics, samples = max(HARMONICS, own[0]), max(SAMPLES, own[1])
    return Sweep(start=low, stop=high, harmonics=min(harmonics, samples // 4 - 1), samples=samples // 2,
                 fine_harmonics=harmonics, fine_samples=samples)


def asked_curves(case: Case, folders: Mapping[str, Path], states: Sequence[str], excitations: Sequence[float],
                 sweep: Sweep, out: Path) -> list[AskedCurve]:
    """Return the curves to be made of the run in `folders`, for `states` out of unworn and worn.

    Raises
    ------
    InputError
        If the run lacks a stage for them, or nothing has worn.
    """
    if "reduce" not in folders or ("worn" in states and "wear" not in folders):
        missing = "reduce" if "reduce" not in folders else "wear"
        raise InputError(f"{case.name}: stage {missing} is not complete; `fretflow run CASE --until {missing}` "
                         "completes it, or give the case file instead of the folder")
    model = make_model(case, folders["reduce"])
    curves = []
    for state in states:
        slow, cycles, after = model.initial(), 0, folders["reduce"].name
        if state == "worn":
            history = RunRecords(folders).history
            slow, cycles, after = history.slow(-1), int(history.cycles[-1]), folders["wear"].name
        problem = model.problem(slow)
        for excitation in excitations:
            settings = case.model_dump(mode="json", include={"test": {"normal_load", "excitation_frequency"},
                                                             "rig": True, "contact": True, "effects": True})
            key = slice_hash(VERSION, settings, folders["reduce"].name, after, excitation, vars(sweep))
            curves.append(AskedCurve(state, cycles, problem.vary(amplitude=excitation), sweep,
                                     out / f"{state}-{excitation:g}N-{key}.h5"))
    return curves


def make_curve(asked: AskedCurve, progress: Progress) -> RunCurve:
    """Return the curve that is `asked` for, from its file if it has been made before, wholly or in part.

    Raises
    ------
    NonConvergenceError
        Naming the frequency.
    StoreError
        If it cannot be written.
    """
    if asked.file.is_file():
        return read_record(asked.file, RunCurve)
    sweep, done = asked.sweep, 0.0

    def note(direction: SweepDirection, frequency: float) -> None:
        nonlocal done
        share = log(frequency / sweep.start) / log(sweep.stop / sweep.start)
        along = share if direction is SweepDirection.UP else 1.0 - share
        before = sweep.directions.index(direction)
        done = max(done, (before + min(max(along, 0.0), 1.0)) / len(sweep.directions))
        progress(done, f"{asked.name}, {'up' if direction is SweepDirection.UP else 'down'}: {frequency:.4g} Hz")

    unfinished = asked.file.with_suffix(UNFINISHED)
    curve = RunCurve(state=asked.state, cycles=asked.cycles, curve=respond(asked.problem, sweep, note, unfinished))
    write_record(asked.file, curve)
    unfinished.unlink(missing_ok=True)
    return curve


def read_peaks(curves: Sequence[RunCurve]) -> list[FoundPeak]:
    """Return the resonance of each of `curves` in each direction."""
    peaks = []
    for run in curves:
        for direction in SweepDirection:
            own = run.curve.along(direction)
            if not len(own):
                continue
            peak = run.peak(direction)
            peaks.append(FoundPeak(
                state=run.state, cycles=run.cycles, direction=direction.name.lower(), excitation=run.curve.excitation,
                frequency=peak.frequency, amplitude=peak.amplitude, lower_half_power=peak.lower_half_power,
                upper_half_power=peak.upper_half_power, damping_ratio=peak.damping_ratio, reason=peak.reason,
                turning_points=len(run.curve.turning_points(direction)),
                unstable_points=int(np.sum(~run.curve.stable[own])), points=len(own),
                bridged_points=int(np.sum(run.curve.bridged[own])), sampling_error=run.curve.sampling_error))
    return peaks


def write_curves(folder: Path, curves: Sequence[RunCurve], inputs: Mapping[str, Path], files: Sequence[Path]
                 ) -> list[Path]:
    """Write ``curves.csv``, ``peaks.csv`` and, with the stages and `files` of the curves, ``peaks.json``.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    peaks = read_peaks(curves)
    rows = [vars(peak) for peak in peaks]
    units = {"excitation": "_N", "frequency": "_Hz", "amplitude": "_m", "lower_half_power": "_Hz",
             "upper_half_power": "_Hz"}
    table = {name + units.get(name, ""): ["" if row[name] is None else row[name] for row in rows] for name in rows[0]}
    needed = {"reduce", *(["wear"] if any(run.state == "worn" for run in curves) else [])}
    used = {name: path.name for name, path in inputs.items() if name in needed}
    write_json(folder / PEAKS, {"stages": used, "peaks": [{"text": peak.text, **vars(peak)} for peak in peaks],
                                "curves": [file.name for file in files]})
    return [write_csv(folder / "curves.csv", _columns(curves)), write_csv(folder / "peaks.csv", table),
            folder / PEAKS]


def kept_peaks(folders: Mapping[str, Path]) -> list[tuple[str, float, str]]:
    """Return what ``peaks.json`` of a run holds of its present stages: name, frequency in Hz and text of each peak.

    Nothing where no curves were made, or those of other stages.
    """
    try:
        return [(f"{row['state']}, {row['excitation']:g} N, {row['direction']}", float(row["frequency"]),
                 str(row["text"])) for row in _kept(folders)["peaks"]]
    except (ValueError, KeyError, TypeError):
        return []


def kept_curves(folders: Mapping[str, Path]) -> list[RunCurve]:
    """Return the curves of a run's present stages that were asked for last; none where there are none.

    Raises
    ------
    StoreError
        If the file of one is missing or damaged.
    """
    folder = _folder(folders)
    return [read_record(folder / Path(name).name, RunCurve) for name in _kept(folders).get("curves", ())]


def _folder(folders: Mapping[str, Path]) -> Path:
    return folders["reduce"].parent / FOLDER


def _kept(folders: Mapping[str, Path]) -> dict[str, Any]:
    """Return ``peaks.json``, empty where there is none of the present stages."""
    try:
        kept: dict[str, Any] = json.loads((_folder(folders) / PEAKS).read_text(encoding="utf-8"))
        return kept if all(folders[stage].name == name for stage, name in kept["stages"].items()) else {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _columns(curves: Sequence[RunCurve]) -> dict[str, Sequence[object]]:
    counts = [len(run.curve.frequency) for run in curves]

    def repeated(values: Sequence[object]) -> Sequence[object]:
        return list(np.repeat(np.asarray(values), counts))

    def joined(name: str) -> Sequence[object]:
        return list(np.concatenate([getattr(run.curve, name) for run in curves]))

    motion = np.concatenate([run.curve.first_harmonic for run in curves])
    span = np.concatenate([run.curve.peak_to_peak for run in curves])
    columns: dict[str, Sequence[object]] = {
        "state": repeated([run.state for run in curves]), "cycles": repeated([run.cycles for run in curves]),
        "excitation_N": repeated([run.curve.excitation for run in curves]), "direction": joined("direction"),
        "branch": joined("branch"), "stable": joined("stable"), "bridged": joined("bridged"),
        "frequency_Hz": joined("frequency")}
    for k, channel in enumerate(CHANNELS):
        columns |= {f"{channel}_amplitude_m": list(np.abs(motion[:, k])),
                    f"{channel}_phase_rad": list(np.mod(-np.angle(motion[:, k]), 2.0 * np.pi)),
                    f"{channel}_peak_to_peak_m": list(span[:, k])}
    return columns | {name: joined(name) for name in ("multiplier", "residual", "iterations", "samples")}
