"""The response command: nonlinear frequency responses of a run, their table, files and picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.cli.terminal import (
    Flag,
    Json,
    Out,
    Progress,
    Several,
    Terminal,
    keep_json,
    load,
    new_table,
    positive,
    show_files,
)

if TYPE_CHECKING:
    from fretflow.pipeline.response_curves import RunCurve

STATES = ("unworn", "worn")
STAGE = "response"


def response(
    run: Path, /, *, unworn: Flag = False,
    worn: Flag = False, start: str | None = None, stop: str | None = None,
    excitation: Several = (), out: Out = Path("runs"), json: Json = None,
) -> None:
    """Follow the nonlinear frequency response by continuation, up and down, around turning points.

    Every point is a solution of the whole contact, with its stability; peak, half-power damping and folds are read
    off each curve. A curve is kept beside the run's stages, so that it is made once; an interrupted one goes on from
    its last points.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1, or a case file, whose stages are run as far as needed
    unworn
        the unworn contact only; by default both
    worn
        the worn contact only
    start
        lowest frequency, for example "20 Hz"; by default the case's
    stop
        highest frequency
    excitation
        amplitude of the force, for example "53 N"; may be given several times; by default the case's
    """
    from fretflow.case.config import load_case
    from fretflow.pipeline.response_curves import read_peaks
    from fretflow.pipeline.run import leading, make_curves
    from fretflow.pipeline.stage import CASE_FILE
    from fretflow.pipeline.stages import complete_stages

    states = states_of(unworn, worn)
    bounds = positive("--start", start, "Hz"), positive("--stop", stop, "Hz")
    levels = [level for text in excitation if (level := positive("--excitation", text, "N")) is not None]
    progress, home = Progress(), run
    if run.is_file():
        case = load(run)
        home = out / case.name
        with leading(out, progress) as runner, progress:
            stages = runner.run(case, "wear" if "worn" in states else "reduce")
        folders = {name: result.folder for name, result in stages.items()}
    else:
        folders = complete_stages(run)
        case = load_case(run / CASE_FILE)
    with progress:
        progress.begin(STAGE, steady=False)
        curves, files = make_curves(case, folders, home, states, bounds, levels,
                                    lambda share, text: progress.advance(STAGE, share, text),
                                    lambda text: progress.note(STAGE, text))
    show_peaks(curves)
    show_files([*files, *keep_json(json, read_peaks(curves))], "curves and pictures")


def states_of(unworn: bool, worn: bool) -> tuple[str, ...]:
    """Return the states asked for; neither flag means both."""
    return tuple(s for s, asked in zip(STATES, (unworn, worn), strict=True) if asked or unworn == worn)


def show_peaks(curves: Sequence[RunCurve]) -> None:
    """Print what is read off each of `curves`."""
    from fretflow.pipeline.response_curves import read_peaks

    view = new_table("resonance of the moving mass", "curve", "", "peak", "amplitude", "damping", "folds", "stability")
    notes: dict[str, list[str]] = {}  # what is said, of which curves
    for peak in read_peaks(curves):
        level = f"{peak.state}, {peak.excitation:g} N"
        damping = "-" if peak.damping_ratio is None else f"{100.0 * peak.damping_ratio:.2f} %"
        stable = "stable" if not peak.unstable_points else f"{peak.unstable_points} of {peak.points} unstable"
        view.add_row(level, peak.direction, f"{peak.frequency:.2f} Hz", f"{peak.amplitude * 1e6:.2f} µm", damping,
                     str(peak.turning_points) if peak.turning_points else "none", stable)
        if peak.bridged_points:
            notes.setdefault(f"{peak.gaps} bridged: there the curve could not be followed", []).append(
                f"{level}, {peak.direction}")
        if peak.reason:
            notes.setdefault(f"no damping, as {peak.reason}", []).append(f"{level}, {peak.direction}")
    console = Terminal(highlight=False)
    console.print(view)
    for said, of in notes.items():
        console.print(f"{'; '.join(of)}: {said}")
    if any("range" in said for said in notes):
        console.print("--start and --stop widen the range")
