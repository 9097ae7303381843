"""The verify command: a run's periods integrated in time, as a check."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.cli.terminal import Json, Out, Terminal, keep_json, new_table
from fretflow.core.errors import FretflowError, InputError

if TYPE_CHECKING:
    from rich.table import Table

    from fretflow.pipeline.verify import PeriodCheck

FOLDER = "verify"


def verify(run: Path, /, *, periods: int = 3, steps: int | None = None, out: Out = Path("runs"),
           json: Json = None) -> None:
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
    from fretflow.case.config import load_case
    from fretflow.pipeline.stage import CASE_FILE
    from fretflow.pipeline.stages import complete_stages
    from fretflow.pipeline.verify import check_same_case, verdict, verify_run, write_checks

    for option, value, least in (("periods", periods, 1), ("steps", steps, 8)):
        if value is not None and value < least:
            raise InputError(f"--{option} {value}: must be at least {least}")
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
    files = [*write_checks(home / FOLDER, checks), *keep_json(json, checks)]
    console.print(_table(checks))
    for file in files:
        console.print(f"  {file}", soft_wrap=True)
    if (failure := verdict(checks)) is not None:
        raise FretflowError(failure)
    console.print("verdict: time integration confirms the periodic solution within 1 %")


def _table(checks: Sequence[PeriodCheck]) -> Table:
    view = new_table("time integration from the periodic solution", "period", "figure", "periodic", "integrated",
                     "difference")
    for check in checks:
        title = f"{check.name}, {check.cycles:,} cycles" if check.cycles else check.name
        for name, pair, scale, difference in (
                ("sliding distance, µm", check.sliding_distance, 1e6, check.sliding_difference),
                ("energy per cycle, mJ", check.dissipated_energy, 1e3, check.energy_difference)):
            view.add_row(title, name, *(f"{scale * value:.4f}" for value in pair), f"{100.0 * difference:.2f} %")
            title = ""
        view.add_row("", "force, rms over range", "", "", f"{100.0 * check.force_difference:.2f} %")
        drift = f"{100.0 * check.drift[-1]:.2f} %" if len(check.drift) else "unknown"
        view.add_row("", "drift per period", "", f"{len(check.drift) + 1} periods", drift)
    return view
