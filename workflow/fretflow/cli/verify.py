"""The verify command: where a run's periods are, and what their check says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from fretflow.case.config import load_case
from fretflow.cli.report import Terminal
from fretflow.core.errors import FretflowError, InputError
from fretflow.pipeline.stage import CASE_FILE
from fretflow.pipeline.stages import complete_stages
from fretflow.pipeline.verify import PeriodCheck, check_same_case, verdict, verify_run, write_checks

FOLDER = "verify"


def verify(run: Path, periods: int, steps: int | None, out: Path) -> list[Path]:
    """Check the solved periods of `run`, a result folder or a case file; print a table and return the files.

    Raises
    ------
    InputError
        If there is nothing to check or the case has changed since.
    FretflowError
        If a period differs from time integration by more than 1 %.
    """
    if periods < 1 or (steps is not None and steps < 8):
        raise InputError(f"--periods {periods}, --steps {steps}: give at least 1 period and 8 steps")
    home, given = run, None
    if run.is_file():
        given = load_case(run)
        home = out / given.name
    folders = complete_stages(home)
    case = load_case(home / CASE_FILE)
    if given is not None:
        check_same_case(given, case, home)
    console = Terminal(highlight=False)
    checks = verify_run(case, folders, periods, steps, console.print)
    files = write_checks(home / FOLDER, checks)
    console.print(_table(checks))
    for file in files:
        console.print(f"  {file}", soft_wrap=True)
    if (found := verdict(checks)) is not None:
        raise FretflowError(found)
    console.print("verdict: time integration confirms the periodic solution within 1 %")
    return files


def _table(checks: Sequence[PeriodCheck]) -> Table:
    view = Table(title="time integration from the periodic solution", title_justify="left", box=SIMPLE_HEAD,
                 pad_edge=False)
    for heading in ("period", "figure", "periodic", "integrated", "difference"):
        view.add_column(heading, overflow="fold")
    for check in checks:
        title = f"{check.name}, {check.cycles:_} cycles" if check.cycles else check.name
        for name, pair, scale, difference in (
                ("sliding distance, um", check.sliding_distance, 1e6, check.sliding_difference),
                ("energy per cycle, mJ", check.dissipated_energy, 1e3, check.energy_difference)):
            view.add_row(title, name, *(f"{scale * value:.4f}" for value in pair), f"{difference:.2%}")
            title = ""
        view.add_row("", "force, rms over range", "", "", f"{check.force_difference:.2%}")
        drift = f"{check.drift[-1]:.2%}" if len(check.drift) else "unknown"
        view.add_row("", "drift per period", "", f"{len(check.drift) + 1} periods", drift)
    return view
