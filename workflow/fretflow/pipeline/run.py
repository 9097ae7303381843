"""A case from its file to its results: from Python, by the command line and by its workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fretflow.case.config import Case, load_case
from fretflow.core.errors import StoreError
from fretflow.effects.catalogue import parse_effects
from fretflow.pipeline.comparison import CaseComparison, compare
from fretflow.pipeline.ensemble import Outcome, Workers, run_ensemble
from fretflow.pipeline.ranks import Ranks, keep_to_itself, started_size
from fretflow.pipeline.results import RunResults
from fretflow.pipeline.runner import Runner, Silent
from fretflow.pipeline.stage import Manifest, StageResult
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


class _Told(Silent):
    """Passes on how far a run is: all of its stages count alike."""

    def __init__(self, stages: Sequence[str], progress: Callable[[float, str], None]) -> None:
        self._stages, self._progress = list(stages), progress

    def advance(self, stage: str, share: float, text: str) -> None:
        self._progress((self._stages.index(stage) + share) / len(self._stages), f"{stage}: {text}")

    def end(self, result: StageResult) -> None:
        self._progress((self._stages.index(result.name) + 1) / len(self._stages), f"{result.name}: complete")


def run(case: Case | Path | str, out: Path | str = "runs", *, until: str | None = None, force: bool = False,
        progress: Callable[[float, str], None] | None = None) -> RunResults:
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
    >>> found = ff.run("examples/quick.toml", until="solve")  # doctest: +SKIP
    >>> float(found.loops.sel(cycles=0).friction_force.max())  # in N  # doctest: +SKIP
    49.7
    """
    from fretflow.pipeline.stages import pipeline

    known = case if isinstance(case, Case) else read_case(Path(case))
    stages = pipeline()
    watcher = Silent() if progress is None else _Told([stage.name for stage in stages], progress)
    results = Runner(stages, Path(out), Ranks(together=False), watcher).run(known, until, force)
    return results_of(known, results, Path(out) / known.name)


def results_of(case: Case, results: Mapping[str, StageResult], home: Path) -> RunResults:
    """Return what the stages of a run in `home` hold, and write their summary."""
    found = RunResults({name: result.folder for name, result in results.items()}, case, home)
    write_summary(home, case, *found.summarised)
    return found


def run_task(task: CaseTask) -> None:
    """Run one case in this process alone and write its summary."""
    if started_size() > 1:
        keep_to_itself()
    run(task.case, task.out, until=task.until, force=task.force)


def run_at_once(tasks: Sequence[CaseTask], workers: Workers) -> Iterator[tuple[int, Outcome[None]]]:
    """Run `tasks` on `workers` and yield each with how many have ended, as it ends."""
    yield from enumerate(run_ensemble(run_task, tasks, workers), start=1)


def compare_run(case: Case, home: Path) -> CaseComparison:
    """Return what the run in `home` found beside what `case` says was measured; a damaged run is a failure."""
    from fretflow.pipeline.stages import complete_stages

    try:
        folders = complete_stages(home)
        return compare(case, folders, sum(Manifest.read(folder).seconds for folder in folders.values()))
    except StoreError as error:
        return CaseComparison(case.name, failure=str(error))
