"""Cases as the commands run them: read, led by one rank, in turn or at once, and what was found in the end."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.cli.errors import describe, say
from fretflow.core.errors import EnsembleError, InputError, StoreError

if TYPE_CHECKING:
    from fretflow.case.config import Case
    from fretflow.pipeline.ensemble import Workers
    from fretflow.pipeline.runner import Runner, Watcher
    from fretflow.pipeline.stage import StageResult

COMPARISON_FILE = "comparison.csv"


def load(path: Path) -> Case:
    """Read a case file, its effects included, before anything is computed."""
    from fretflow.case.config import load_case

    case = load_case(path)
    if case.effects:
        from fretflow.effects.catalogue import parse_effects

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
    from fretflow.pipeline.ranks import Ranks
    from fretflow.pipeline.runner import Runner
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


@dataclass(frozen=True)
class Ended:
    """How a case ended: exit code 0 and no message if well."""

    code: int = 0
    message: str = ""


def in_turn(cases: Sequence[Case], until: str | None, out: Path, force: bool) -> None:
    """Run cases one after the other in this process; one that fails does not stop the others."""
    from fretflow.cli.report import Progress

    progress, ends = Progress(), []
    with leading(out, progress) as runner:
        for case in cases:
            try:
                with progress:
                    results = runner.run(case, until, force)
                _summarise(case, results, out / case.name)
            except Exception as error:
                if len(cases) == 1:
                    raise
                message, code = describe(error)
                say(f"{case.name}: {message}", code)
                ends.append(Ended(code, message))
            else:
                ends.append(Ended())
    if len(cases) > 1:
        report(cases, out, ends)


def at_once(cases: Sequence[Case], until: str | None, out: Path, force: bool, workers: Workers) -> None:
    """Run cases by several workers; one that fails does not stop the others."""
    from fretflow.cli.report import show_ended
    from fretflow.pipeline.run import CaseTask, run_at_once

    ends = [Ended()] * len(cases)
    tasks = [CaseTask(case, out.absolute(), until, force) for case in cases]  # a worker may run in another folder
    for done, outcome in run_at_once(tasks, workers):
        if outcome.error is not None:
            message, code = describe(outcome.error)
            ends[outcome.index] = Ended(code, message)
        show_ended(done, len(cases), cases[outcome.index].name, ends[outcome.index].message)
    if workers.leads:
        report(cases, out, ends)


def report(cases: Sequence[Case], out: Path, ends: Sequence[Ended]) -> None:
    """Show one table of all cases, keep it as a CSV file, and raise if any failed.

    Raises
    ------
    EnsembleError
        Naming the cases that failed.
    """
    from fretflow.cli.report import show_comparison, show_files
    from fretflow.pipeline.comparison import CaseComparison, write_comparison
    from fretflow.pipeline.run import compare_run

    rows = [CaseComparison(case.name, failure=end.message) if end.message  # what is on disk may be of another run
            else compare_run(case, out / case.name) for case, end in zip(cases, ends, strict=True)]
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


def _summarise(case: Case, results: dict[str, StageResult], home: Path) -> None:
    from fretflow.cli.report import show_files, show_summary
    from fretflow.pipeline.run import results_of
    from fretflow.pipeline.stage import SUMMARY_FILE

    show_summary(case, *results_of(case, results, home).summarised, results)
    files = [home / SUMMARY_FILE]
    for result in results.values():
        files += [result.folder / name for name in result.manifest.files if name.endswith((".png", ".csv", ".pvd"))]
    show_files(files, "pictures and curves")
