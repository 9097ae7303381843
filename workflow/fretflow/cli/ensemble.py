"""Several cases with one command: in turn or at once, one table at the end, no failure stopping the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.case.config import Case
from fretflow.core.errors import EnsembleError, StoreError
from fretflow.pipeline.ensemble import Outcome, Workers, run_ensemble
from fretflow.pipeline.ranks import Ranks, keep_to_itself, started_size
from fretflow.pipeline.runner import Runner, Silent

if TYPE_CHECKING:
    from fretflow.pipeline.comparison import CaseComparison

COMPARISON_FILE = "comparison.csv"


@dataclass(frozen=True)
class Task:
    """One case to run, as handed to a worker."""

    case: Case
    out: Path
    until: str | None
    force: bool


@dataclass(frozen=True)
class Ended:
    """How a case ended: exit code 0 and no message if well."""

    code: int = 0
    message: str = ""


def run_task(task: Task) -> None:
    """Run one case in this process alone and write its summary."""
    from fretflow.cli.pipeline import pipeline
    from fretflow.pipeline.summary import summarise, write_summary

    if started_size() > 1:
        keep_to_itself()
    results = Runner(pipeline(), task.out, Ranks(together=False), Silent()).run(task.case, task.until, task.force)
    figures, trends = summarise(task.case, {name: result.folder for name, result in results.items()})
    write_summary(task.out / task.case.name / "summary.json", figures, trends)


def run_at_once(tasks: Sequence[Task], workers: Workers) -> Iterator[tuple[int, Outcome[None]]]:
    """Run `tasks` on `workers` and yield each with how many have ended, as it ends."""
    yield from enumerate(run_ensemble(run_task, tasks, workers), start=1)


def report(cases: Sequence[Case], out: Path, ends: Sequence[Ended]) -> None:
    """Show one table of all cases, keep it as a CSV file, and raise if any failed.

    Raises
    ------
    EnsembleError
        Naming the cases that failed.
    """
    from fretflow.cli.report import show_comparison, show_files
    from fretflow.pipeline.comparison import write_comparison

    rows = [_row(case, out, end.message) for case, end in zip(cases, ends, strict=True)]
    show_comparison(rows)
    failed = [f"{row.name}: {row.failure}" for row in rows if row.failure]
    if failed:
        # also a case that a worker completed where this process does not see it
        code = max(end.code or StoreError.exit_code for end, row in zip(ends, rows, strict=True) if row.failure)
        summary = f"{len(failed)} of {len(cases)} cases failed; " + "; ".join(failed)
    try:
        show_files([write_comparison(out / COMPARISON_FILE, rows)], "table")
    except StoreError:
        if not failed:  # what failed says why, a full disk for example
            raise
    if failed:
        raise EnsembleError(summary, code)


def _row(case: Case, out: Path, failure: str) -> CaseComparison:
    from fretflow.cli.pipeline import complete_stages
    from fretflow.pipeline.comparison import CaseComparison, compare
    from fretflow.pipeline.stage import Manifest

    if failure:  # what is on disk may be of another run
        return CaseComparison(case.name, failure=failure)
    try:
        folders = complete_stages(out / case.name)
        return compare(case, folders, sum(Manifest.read(folder).seconds for folder in folders.values()))
    except StoreError as error:
        return CaseComparison(case.name, failure=str(error))
