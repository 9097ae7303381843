"""A case from its file to its results: from Python, by the command line and by its workers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fretflow.case.config import Case, load_case
from fretflow.core.errors import InputError, StoreError
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.progress import Progress
from fretflow.effects.catalogue import parse_effects
from fretflow.pipeline.comparison import CaseComparison, compare
from fretflow.pipeline.ranks import Ranks, keep_to_itself, started_size
from fretflow.pipeline.response_curves import FOLDER, RunCurve, asked_curves, make_curve, sweep_of, write_curves
from fretflow.pipeline.results import RunResults
from fretflow.pipeline.runner import Runner, Silent, Watcher
from fretflow.pipeline.stage import SUMMARY_FILE, Manifest, StageResult
from fretflow.pipeline.summary import write_summary


@dataclass(frozen=True)
class CaseTask:
    """One case to run, as handed to a worker."""

    case: Case
    out: Path
    until: str | None
    force: bool


def read_case(path: Path) -> Case:
    """Read a case file and check its effects, before anything is computed.

    Raises
    ------
    ConfigError
        Naming the file and the field.
    """
    case = load_case(path)
    parse_effects(case.effects, str(path))
    return case


def check_names(cases: Sequence[Case]) -> None:
    """Check that every case has a name of its own.

    Raises
    ------
    InputError
        Naming the one that several have.
    """
    names = [case.name for case in cases]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"name: {name!r} is the name of several cases; give each its own")


@contextmanager
def leading(out: Path, watcher: Watcher) -> Iterator[Runner]:
    """Give rank 0 the runner; every other rank serves it here until the run is over, and exits."""
    from fretflow.pipeline.stages import pipeline

    ranks = Ranks()
    runner = Runner(pipeline(), out, ranks, watcher)
    if ranks.rank > 0:
        runner.serve()
        sys.exit(0)
    try:
        yield runner
    finally:
        ranks.dismiss()


class _Told(Silent):
    """Passes on how far a run is: all of its stages count alike."""

    def __init__(self, stages: Sequence[str], progress: Progress) -> None:
        self._stages, self._progress = list(stages), progress

    def advance(self, stage: str, share: float, text: str) -> None:
        self._progress((self._stages.index(stage) + share) / len(self._stages), f"{stage}: {text}")

    def end(self, result: StageResult) -> None:
        self._progress((self._stages.index(result.name) + 1) / len(self._stages), f"{result.name}: complete")


def run(case: Case | Path | str, out: Path | str = "runs", *, until: str | None = None, force: bool = False,
        progress: Progress | None = None) -> RunResults:
    """Run the stages of a case in this process, keep them in ``out/<name>`` and return what they hold.

    Complete stages of the same case are reused and an interrupted one goes on where it stopped.

    Parameters
    ----------
    case : Case, Path or str
        A case, or the file of one.
    out : Path or str
        Folder of all results.
    until : str, optional
        Last stage: mesh, reduce, preload, solve, wear, response or render; by default all.
    force : bool
        Compute again what is already there.
    progress : callable, optional
        Takes the share that is done, 0 to 1, and what is being done.

    Returns
    -------
    RunResults
        Loops, contact maps, wear and responses as labelled arrays in SI, the summary, and figures by ``plot()``.

    Raises
    ------
    InputError
        If the case, a mesh or the folder cannot be used.
    NonConvergenceError
        If a stage does not converge, with the residual history.

    Examples
    --------
    >>> import fretflow as ff
    >>> results = ff.run("examples/quick.toml", until="solve")  # doctest: +SKIP
    >>> round(float(results.loops.sel(cycles=0).friction_force.max()), 1)  # in N  # doctest: +SKIP
    52.8
    """
    from fretflow.pipeline.stages import pipeline

    known = case if isinstance(case, Case) else read_case(Path(case))
    stages = pipeline()
    watcher = Silent() if progress is None else _Told([stage.name for stage in stages], progress)
    results = Runner(stages, Path(out), Ranks(together=False), watcher).run(known, until, force)
    return results_of(known, results, Path(out) / known.name)


def results_of(case: Case, results: Mapping[str, StageResult], home: Path) -> RunResults:
    """Return what the stages of a run in `home` hold, and write their summary."""
    run_results = RunResults({name: result.folder for name, result in results.items()}, case, home)
    write_summary(home, case, run_results.folders)
    return run_results


def run_task(task: CaseTask) -> None:
    """Run one case in this process alone and write its summary."""
    if started_size() > 1:
        keep_to_itself()
    run(task.case, task.out, until=task.until, force=task.force)


def compare_run(case: Case, home: Path) -> CaseComparison:
    """Return what the run in `home` found beside what `case` says was measured; a damaged run is a failure."""
    from fretflow.pipeline.stages import complete_stages

    try:
        folders = complete_stages(home)
        return compare(case, folders, sum(Manifest.read(folder).seconds for folder in folders.values()))
    except StoreError as error:
        return CaseComparison(case.name, failure=str(error))


def make_curves(case: Case, folders: Mapping[str, Path], home: Path, states: Sequence[str],
                bounds: tuple[float | None, float | None], levels: Sequence[float],
                progress: Progress, note: Callable[[str], None]
                ) -> tuple[list[RunCurve], list[Path]]:
    """Make the curves of a run, keep them in its `home` and return them with the files written.

    Parameters
    ----------
    case : Case
    folders : mapping of str to Path
        The run's complete stages.
    home : Path
        The run's folder.
    states : sequence of str
        Out of unworn and worn.
    bounds : (float or None, float or None)
        Lowest and highest frequency in Hz; by default the case's.
    levels : sequence of float
        Excitations in N; by default the case's.
    progress, note : callable
        Take the share that is done and what is being done, and a line about each curve.

    Raises
    ------
    InputError
        If the range is empty or a stage is missing.
    NonConvergenceError
        Naming the frequency.
    """
    folder = home / FOLDER
    excitations = sorted(set(levels)) or [case.test.excitation_amplitude]
    asked = asked_curves(case, folders, states, excitations, sweep_of(case, *bounds), folder)
    folder.mkdir(parents=True, exist_ok=True)
    curves: list[RunCurve] = []
    for done, one in enumerate(asked):
        curves.append(make_curve(one, lambda share, text, done=done: progress(  # type: ignore[misc]
            (done + share) / len(asked), text)))
        note(f"{one.name}: {len(curves[-1].curve.frequency)} points  {one.file}")
    files = [*write_curves(folder, curves, folders, [one.file for one in asked]),
             *provided(FIGURES, "response")(folder / "curves.png", curves)]
    if (home / SUMMARY_FILE).is_file():
        files.append(write_summary(home, case, folders))
    return curves, [*files, *(one.file for one in asked)]
