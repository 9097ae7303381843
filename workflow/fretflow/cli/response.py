"""The response command: nonlinear frequency responses of a run, their table, files and picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fretflow.case.config import Case, load_case
from fretflow.cli.report import Progress, Terminal, new_table, show_files
from fretflow.core.errors import InputError
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.units import parse_quantity
from fretflow.pipeline.response_curves import (
    FOLDER,
    RunCurve,
    asked_curves,
    make_curve,
    read_peaks,
    sweep_of,
    write_curves,
)
from fretflow.pipeline.stage import CASE_FILE, SUMMARY_FILE
from fretflow.pipeline.stages import complete_stages
from fretflow.pipeline.summary import summarise, write_summary

STATES = ("unworn", "worn")
STAGE = "response"


def states_of(unworn: bool, worn: bool) -> tuple[str, ...]:
    """Return the states asked for; neither flag means both."""
    return tuple(s for s, asked in zip(STATES, (unworn, worn), strict=True) if asked or unworn == worn)


def quantity_of(option: str, text: str | None, unit: str) -> float | None:
    """Return the number that `option` gives in `unit`, or None where it is not given.

    Raises
    ------
    InputError
        If it has no unit of the right kind, or is not positive.
    """
    if text is None:
        return None
    try:
        value = parse_quantity(text, unit)
    except ValueError as error:
        raise InputError(f"{option}: {error}") from error
    if not value > 0.0:
        raise InputError(f"{option} {text!r}: must be positive")
    return value


def run_of(given: Path) -> tuple[Case, dict[str, Path]]:
    """Return the case and the complete stages of the result folder `given`.

    Raises
    ------
    StoreError
        If there is no run.
    """
    folders = complete_stages(given)
    return load_case(given / CASE_FILE), folders


def respond(case: Case, folders: Mapping[str, Path], home: Path, states: Sequence[str],
            bounds: tuple[str | None, str | None], levels: Sequence[str], progress: Progress) -> list[Path]:
    """Make the curves of a run, show their peaks and return the files written.

    Parameters
    ----------
    case : Case
    folders : mapping of str to Path
        The run's complete stages.
    home : Path
        The run's folder.
    states : sequence of str
        Out of unworn and worn.
    bounds : (str or None, str or None)
        Lowest and highest frequency with unit; by default the case's.
    levels : sequence of str
        Excitations with unit; by default the case's.
    progress : Progress

    Raises
    ------
    InputError
        If an option cannot be used or a stage is missing.
    NonConvergenceError
        Naming the frequency.
    """
    start, stop = (quantity_of(name, text, "Hz") for name, text in zip(("--start", "--stop"), bounds, strict=True))
    given = [value for text in levels if (value := quantity_of("--excitation", text, "N")) is not None]
    excitations = sorted(set(given)) or [case.test.excitation_amplitude]
    folder = home / FOLDER
    asked = asked_curves(case, folders, states, excitations, sweep_of(case, start, stop), folder)
    folder.mkdir(parents=True, exist_ok=True)
    curves: list[RunCurve] = []
    with progress:
        progress.begin(STAGE)
        for done, one in enumerate(asked):
            curves.append(make_curve(one, lambda share, text, done=done: progress.advance(  # type: ignore[misc]
                STAGE, (done + share) / len(asked), text)))
            progress.note(STAGE, f"{one.name}: {len(curves[-1].curve.frequency)} points  {one.file}")
    show_peaks(curves)
    files = [*write_curves(folder, curves, folders), *provided(FIGURES, "response")(folder / "curves.png", curves)]
    if (home / SUMMARY_FILE).is_file():
        files.append(write_summary(home, case, *summarise(case, folders)))
    show_files([*files, *(one.file for one in asked)], "curves and pictures")
    return files


def show_peaks(curves: Sequence[RunCurve]) -> None:
    """Print what is read off each of `curves`."""
    view = new_table("resonance of the moving mass", "curve", "", "peak", "amplitude", "damping", "folds", "stability")
    reasons = []
    for peak in read_peaks(curves):
        damping = "-" if peak.damping_ratio is None else f"{peak.damping_ratio:.2%}"
        stable = "stable" if not peak.unstable_points else f"{peak.unstable_points} of {peak.points} unstable"
        view.add_row(f"{peak.state}, {peak.excitation:g} N", peak.direction, f"{peak.frequency:.2f} Hz",
                     f"{peak.amplitude * 1e6:.2f} um", damping,
                     str(peak.turning_points) if peak.turning_points else "none", stable)
        if peak.bridged_points:
            name = f"{peak.state}, {peak.excitation:g} N, {peak.direction}"
            reasons.append(f"{peak.bridged_points} gaps bridged, {name}: there the curve could not be followed")
        if peak.reason:
            reasons.append(f"no damping for {peak.state}, {peak.excitation:g} N, {peak.direction}: {peak.reason}")
    console = Terminal(highlight=False)
    console.print(view)
    for reason in reasons:
        console.print(reason)
