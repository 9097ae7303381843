"""The command line of fretflow: what may be asked for.

Imports stay inside the commands, so that help and `show` start without numerical libraries.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from fretflow import __version__
from fretflow.cli.errors import describe, say
from fretflow.cli.run import at_once, check_names, in_turn, leading, load
from fretflow.core.errors import InputError, printable
from fretflow.pipeline.ranks import close_process

app = App(name="fretflow", version=__version__, help_format="plaintext", result_action="return_value",
          exit_on_error=False, print_error=False, suppress_keyboard_interrupt=False,
          help="Vibration and fretting wear of structures held together by friction.")

Out = Annotated[Path, Parameter(help="folder of all results; a case's own are in OUT/<name>")]
Force = Annotated[bool, Parameter(negative="", help="compute again what is already there")]


@app.command
def run(
    case: Path, /, *cases: Path, until: str | None = None, out: Out = Path("runs"), force: Force = False,
    jobs: int = 1, executor: str = "local",
) -> None:
    """Run all stages of one or more cases: mesh, reduce, preload, solve, wear, response, render.

    Complete stages are reused and an interrupted one goes on where it stopped. Several cases end with one table
    of what was found beside what each case says was measured; a case that fails does not stop the others, and
    the exit code is that of the worst.

    Parameters
    ----------
    case
        case file to run; more may follow
    cases
        more case files
    until
        last stage to run
    jobs
        cases run at a time on this machine
    executor
        where cases run: local processes; mpi, the ranks of `mpirun -n N fretflow run ...`, of which one leads;
        or dask=ADDRESS of a scheduler whose workers see the same files
    """
    from fretflow.pipeline.ensemble import Workers

    parsed = [load(path) for path in (case, *cases)]
    check_names(parsed)
    workers = Workers.parse(executor, jobs)
    if workers.in_turn:
        in_turn(parsed, until, out, force)
    else:
        at_once(parsed, until, out, force, workers)


@app.command
def modes(case: Path, /, *, out: Out = Path("runs"), force: Force = False) -> None:
    """List each specimen's natural frequencies: full model against Craig-Bampton; with a CSV and a plot.

    Parameters
    ----------
    case
        case file
    """
    from fretflow.case.config import load_case
    from fretflow.cli.report import Progress, show_files, show_modes
    from fretflow.core.plugins import FIGURES, provided
    from fretflow.core.store import read_record
    from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen

    parsed = load_case(case)
    progress = Progress()
    with leading(out, progress) as runner, progress:
        folder = runner.run(parsed, "reduce", force)["reduce"].folder
    specimens = {side: read_record(folder / f"{side}.h5", ReducedSpecimen) for side in ("upper", "lower")}
    show_modes(specimens)
    show_files(provided(FIGURES, "modes")(out / parsed.name / "modes.png", *specimens.values()), "files")


@app.command
def calibrate(case: Path, /, *cases: Path, out: Out = Path("runs")) -> None:
    """Identify the rig and the wear coefficient from what the cases' [measured] tables hold.

    Masses, springs (by the two modes) and damping follow from in_phase_frequency, out_of_phase_frequency and the
    sliding_distance of every case given, the wear coefficient from worn_volume; each with a 95 % interval and whether
    the data determine it. Standard deviations that are not given are assumed: 5 % of a distance or a volume, 1 % of a
    mode. Cases that are calibrated together are of one joint. Writes OUT/<name>-calibrated.toml for each case and
    OUT/calibration.json.

    Parameters
    ----------
    case
        case file with a [measured] table; more may follow
    cases
        the same joint at other loads
    """
    from fretflow.cli.calibrate import calibrate_cases
    from fretflow.cli.report import Progress

    parsed = [load(path) for path in (case, *cases)]
    check_names(parsed)
    progress = Progress()
    with leading(out, progress) as runner, progress:
        calibrate_cases(parsed, runner, out)


@app.command
def render(run: Path, /) -> None:
    """Draw the pictures of a run again, off-screen, as far as its stages are complete.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1
    """
    from fretflow.cli.report import show_files
    from fretflow.pipeline.stages import render_run

    show_files(render_run(run), "files")


@app.command
def verify(run: Path, /, *, periods: int = 3, steps: int | None = None, out: Out = Path("runs")) -> None:
    """Check a run's solved periods, unworn and worn, by time integration; exit code 1 if they differ by over 1 %.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1, or its case file
    periods
        fewest periods to integrate; up to ten times as many while the motion still drifts
    steps
        steps a period; by default four a sample of the solution, at least 512
    """
    from fretflow.cli.verify import verify as check

    check(run, periods, steps, out)


@app.command
def effects(effect: str | None = None, /, *, out: Out = Path("runs/effects")) -> None:
    """List the physics beyond the baseline, or describe one effect with its equation, parameters and a picture.

    Parameters
    ----------
    effect
        id of an effect
    """
    from fretflow.cli.effects import list_effects, show_effect

    if effect is None:
        list_effects()
    else:
        show_effect(effect, out)


@app.command
def loops(
    recording: Path, /, *, normal_load: str | None = None, frequency: str | None = None,
    displacement: str | None = None, force: str | None = None, time: str | None = None, out: Out = Path("runs"),
    json: Path | None = None,
) -> None:
    """Read recorded hysteresis loops: friction, stiffness, energy and sliding with uncertainty, for each cycle count.

    Writes OUT/<name>-loops/ with a picture and CSV. Whatever had to be cleaned or left out is listed with its rows.

    Parameters
    ----------
    recording
        folder with a recording.toml, or one file of loops: CSV, HDF5 or MATLAB
    normal_load
        such as "60 N", where the recording does not say it
    frequency
        such as "100 Hz", of a single file
    displacement
        of a single file: "COLUMN [UNIT]", "[UNIT]" or "COLUMN" where its heading has the unit; likewise:
    force
        column and unit of the friction force
    time
        column and unit of the time
    json
        file for all numbers
    """
    from fretflow.cli.loops import show_loops

    columns = {"displacement": displacement, "friction_force": force, "time": time}
    show_loops(recording, columns, normal_load, frequency, out, json)


@app.command
def diagnose(
    recording: Path, /, *, fast: Annotated[bool, Parameter(negative="")] = False, json: Path | None = None,
    out: Path | None = None, case: Path | None = None,
) -> None:
    """Say whether the model explains a recording and, if not, where they part and which physics is left out.

    Writes report.html, the verdict as JSON, the places of the difference as CSV and, where effects are named, a case
    with them for `fretflow run`. Every verdict has exit code 0.

    Parameters
    ----------
    recording
        folder with a recording.toml, or a table of wear tests
    fast
        looks at fewer effects: in a minute or two
    json
        file for a copy of the JSON
    out
        folder of the results; by default runs/diagnosis/<recording>
    case
        file for a copy of the case
    """
    from fretflow.cli.diagnose import diagnose_recording

    diagnose_recording(recording, fast, out, json, case)


@app.command
def response(
    run: Path, /, *, unworn: Annotated[bool, Parameter(negative="")] = False,
    worn: Annotated[bool, Parameter(negative="")] = False, start: str | None = None, stop: str | None = None,
    excitation: tuple[str, ...] = (), out: Out = Path("runs"),
) -> None:
    """Follow the nonlinear frequency response by continuation, up and down, around turning points.

    Every point is a solution of the whole contact, with its stability; peak, half-power damping and folds are read
    off each curve. A curve takes a minute or two and is kept beside the run's stages, so that it is made once.

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
    from fretflow.cli.report import Progress
    from fretflow.cli.response import respond, run_of, states_of

    states, progress = states_of(unworn, worn), Progress()
    if not run.is_file():
        respond(*run_of(run), run, states, (start, stop), excitation, progress)
        return
    case = load_case(run)
    with leading(out, progress) as runner:
        with progress:
            stages = runner.run(case, "wear" if "worn" in states else "reduce")
        folders = {name: result.folder for name, result in stages.items()}
        respond(case, folders, out / case.name, states, (start, stop), excitation, progress)


@app.command
def trial(
    *, cases: int = 20, seed: int = 0, fast: bool = False, jobs: int = 1, out: Path = Path("runs/trial")
) -> None:
    """Try `diagnose` on recordings whose hidden physics it cannot know, and write the scoreboard.

    The recordings come from a second simulator that shares nothing with the rest. Their answers are sealed (a salted
    hash is printed first, salt and key in the end), every diagnosis is a process of its own that sees one recording
    only, and OUT holds trial.html, trial.json and all answers. A trial that is stopped goes on with the same command.

    Parameters
    ----------
    cases
        number of recordings: a fifth with nothing hidden, a fifth with physics beyond the catalogue, a fifth with two
        effects, the rest with one
    seed
        which recordings
    fast
        diagnose with --fast
    jobs
        recordings made or diagnosed at a time
    out
        folder of the trial
    """
    from fretflow.cli.trial import show_trial

    show_trial(cases, seed, fast, jobs, out)


@app.command
def init(path: Path = Path("case.toml"), /) -> None:
    """Write a commented case file to start from.

    Parameters
    ----------
    path
        file to write; an existing one is left alone
    """
    from fretflow.case.casefile import starting_case

    try:
        with path.open("x", encoding="utf-8") as handle:
            handle.write(starting_case())
    except FileExistsError as error:
        raise InputError(f"{path}: exists and is left as it is; name another file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file") from error
    sys.stdout.write(printable(f"{path} written; `fretflow run {path}` runs it\n"))


@app.command
def show(case: Path, /) -> None:
    """Show the parsed case: every value with its unit, and which ones are defaults.

    Parameters
    ----------
    case
        case file
    """
    from fretflow.cli.report import show_case

    show_case(load(case))


def main() -> None:
    """Run the command line and exit: 0 done, 2 bad input, 3 no convergence, 130 interrupted, 1 unexpected."""
    close_process()
    _limit_threads()
    sys.exit(execute(sys.argv[1:]))


def execute(arguments: list[str]) -> int:
    """Run the command line with `arguments` and return the exit code; errors become one line on stderr."""
    try:
        app(arguments)
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - the user gets one line
        return say(*describe(error))
    return 0


def _limit_threads() -> None:
    """Give BLAS one thread, unless the user has chosen; before NumPy loads it.

    The contact's matrices have a few hundred rows: a second thread spends ten times what it gains on waiting.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
