"""The run command: cases in turn or at once, and what was found; render: its pictures again; export: as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from fretflow.cli.terminal import (
    Force,
    Json,
    Out,
    Progress,
    Several,
    Terminal,
    describe,
    keep_json,
    load,
    new_table,
    say,
    say_line,
    show_files,
    show_warnings,
)
from fretflow.core.errors import EnsembleError, StoreError
from fretflow.pipeline.ranks import started_rank

if TYPE_CHECKING:
    from fretflow.case.bolted import BoltedCase
    from fretflow.case.config import Case
    from fretflow.pipeline.comparison import CaseComparison
    from fretflow.pipeline.ensemble import Workers
    from fretflow.pipeline.stage import StageResult
    from fretflow.pipeline.summary import Figure
    from fretflow.pipeline.trends import Trend

COMPARISON_FILE = "comparison.csv"
MIB = 2**20


def run(
    case: Path, /, *cases: Path, until: str | None = None, out: Out = Path("runs"), force: Force = False,
    jobs: int = 1, executor: str = "local", json: Json = None,
) -> None:
    """Run all stages of one or more cases: mesh, reduce, preload, solve, wear, response, render; or bolted structures.

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
        last stage to run: mesh, reduce, preload, solve, wear, response or render
    jobs
        cases run at a time on this machine
    executor
        where cases run: local processes; mpi, the ranks of `mpirun -n N fretflow run ...`, of which one leads;
        or dask=ADDRESS of a scheduler whose workers see the same files
    """
    from fretflow.case.bolted import load_bolted_case
    from fretflow.pipeline.ensemble import Workers
    from fretflow.pipeline.run import check_names
    from fretflow.pipeline.stage import SUMMARY_FILE

    bolted = {path: own for path in (case, *cases) if (own := load_bolted_case(path)) is not None}
    for own in bolted.values():
        _run_bolted(own, out)
    if len(bolted) == 1 + len(cases):
        return
    parsed = [load(path) for path in (case, *cases) if path not in bolted]
    check_names(parsed)
    workers = Workers.parse(executor, jobs)
    if workers.in_turn:
        _in_turn(parsed, until, out, force)
    else:
        _at_once(parsed, until, out, force, workers)
    if json is not None and workers.leads:
        summaries = [(one.name, out / one.name / SUMMARY_FILE) for one in parsed]
        keep_json(json, {name: loads(file.read_text(encoding="utf-8")) for name, file in summaries})


def _run_bolted(case: BoltedCase, out: Path) -> None:
    """Run a case of a bolted structure and show its figures."""
    from fretflow.case.plausibility import implausible
    from fretflow.pipeline.bolted import run_bolted

    show_warnings(list(implausible(case)))
    with Progress() as progress:
        progress.begin("structure")
        study = run_bolted(case, out, lambda share, text: progress.advance("structure", share, text))
    view = new_table(study.title, "figure", "found")
    for name, value in study.figures.items():
        view.add_row(*_figure(name, value))
    Terminal().print(view)
    show_files(sorted((out / case.name).iterdir()), "pictures and curves")


def _figure(name: str, value: float) -> tuple[str, str]:
    """Return a figure in words and its own unit: of ``largest_pressure_Pa`` the largest pressure in MPa."""
    from fretflow.core.units import pretty_number

    head, _, last = name.rpartition("_")
    unit, size = {"Pa": ("MPa", 1e6), "Hz": ("Hz", 1.0), "m3": ("mm³", 1e-9)}.get(last, ("", 1.0))
    return (head if unit else name).replace("_", " "), f"{pretty_number(value / size, 4)} {unit}".rstrip()


@dataclass(frozen=True)
class _Ended:
    """How a case ended: exit code 0 and no message if well."""

    code: int = 0
    message: str = ""


def _in_turn(cases: Sequence[Case], until: str | None, out: Path, force: bool) -> None:
    """Run cases one after the other in this process; one that fails does not stop the others."""
    from fretflow.pipeline.run import leading

    progress, ends = Progress(), []
    with leading(out, progress) as runner:
        for case in cases:
            try:
                with progress:
                    results = runner.run(case, until, force)
                _summarise(case, results, out / case.name)
            except Exception as error:  # whatever ends one case, the others are run and all are told in the end
                if len(cases) == 1:
                    raise
                message, code = describe(error)
                say(f"{case.name}: {message}", code)
                ends.append(_Ended(code, message))
            else:
                ends.append(_Ended())
    if len(cases) > 1:
        _report(cases, out, ends)


def _at_once(cases: Sequence[Case], until: str | None, out: Path, force: bool, workers: Workers) -> None:
    """Run cases by several workers; one that fails does not stop the others."""
    from fretflow.pipeline.ensemble import run_ensemble
    from fretflow.pipeline.run import CaseTask, run_task

    ends = [_Ended()] * len(cases)
    tasks = [CaseTask(case, out.absolute(), until, force) for case in cases]  # a worker may run in another folder
    for done, outcome in enumerate(run_ensemble(run_task, tasks, workers), start=1):
        if outcome.error is not None:
            message, code = describe(outcome.error)
            ends[outcome.index] = _Ended(code, message)
        failure = ends[outcome.index].message
        state = f"failed: {failure}" if failure else "complete"
        Terminal().print(f"{done} of {len(cases)}  {escape(cases[outcome.index].name)}  {escape(state)}",
                         highlight=False, soft_wrap=True)
    if workers.leads:
        _report(cases, out, ends)


def _report(cases: Sequence[Case], out: Path, ends: Sequence[_Ended]) -> None:
    """Show one table of all cases, keep it as a CSV file, and raise if any failed.

    Raises
    ------
    EnsembleError
        Naming the cases that failed.
    """
    from fretflow.pipeline.comparison import CaseComparison, write_comparison
    from fretflow.pipeline.run import compare_run

    rows = [CaseComparison(case.name, failure=end.message) if end.message  # what is on disk may be of another run
            else compare_run(case, out / case.name) for case, end in zip(cases, ends, strict=True)]
    _show_comparison(rows)
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
    from fretflow.pipeline.run import results_of
    from fretflow.pipeline.stage import SUMMARY_FILE

    run_results = results_of(case, results, home)
    _show_summary(case, *run_results.summarised, results)
    show_warnings(run_results.warnings)
    files = [home / SUMMARY_FILE]
    for result in results.values():
        files += [result.folder / name for name in result.manifest.files
                  if name.endswith((".png", ".svg", ".pdf", ".gif", ".csv", ".pvd"))]
    show_files(files, "pictures and curves")


def _show_summary(case: Case, figures: Sequence[Figure], trends: Sequence[Trend],
                 results: Mapping[str, StageResult]) -> None:
    """Print what a run found, the paper's trends and what each stage cost."""
    console = Terminal()
    if figures:
        view = new_table(f"{case.name}: {case.title}" if case.title else case.name, "figure", "found")
        for figure in figures:
            view.add_row(figure.name, figure.text)
        console.print(view)
    if trends:
        view = new_table("the paper's trends", "trend", "", "found", "paper")
        words = {True: "met", False: "not met", None: "cannot tell"}
        for trend in trends:
            view.add_row(trend.name, words[trend.met], trend.found, trend.paper)
        console.print(view)
    view = new_table("stages", "stage", "time, s", "peak memory, MiB", "")
    for result in results.values():
        manifest = result.manifest
        view.add_row(result.name, f"{manifest.seconds:.1f}", f"{manifest.peak_memory / MIB:.0f}",
                     "reused" if result.reused else "")
    console.print(view)


def _show_comparison(rows: Sequence[CaseComparison]) -> None:
    """Print one line a case: what was found, what was measured and the difference."""
    console = Terminal(quiet=started_rank() > 0)
    view = new_table("found, and beneath it what was measured", "case", "sliding, mean of test", "worn volume",
                     "regime", "time, s")
    for row in rows:
        if row.failure:
            view.add_row(row.name, "failed, see above")
            continue
        changes = row.worn_regime not in (None, row.regime)
        regime = f"{row.regime}, then {row.worn_regime}" if changes else str(row.regime or "-")
        view.add_row(row.name, _beside(row.sliding, row.measured_sliding, row.sliding_error, _micrometres),
                     _beside(row.volume, row.measured_volume, row.volume_error, _cubic_millimetres),
                     regime + (f"\n{row.measured_regime}" if row.measured_regime else ""), f"{row.seconds:.0f}")
    console.print(view)
    if missed := [row.name for row in rows if row.remarkable]:
        console.print(f"Not met within 10 %, or in another regime: {', '.join(missed)}. The rig's masses and damping "
                      "decide the sliding, and it the volume: `fretflow calibrate CASES` fits them to all that was "
                      "measured, and says what that determines and what not.")


def _beside(computed: float | None, measured: float | None, error: float | None, text: Callable[[float], str]) -> str:
    lines = ["-" if computed is None else text(computed)]
    if measured is not None:
        lines.append(text(measured) + ("" if error is None else f" ({100.0 * error:+.1f} %)"))
    return "\n".join(lines)


def _micrometres(value: float) -> str:
    return f"{value * 1e6:.4g} µm"


def _cubic_millimetres(value: float) -> str:
    return f"{value * 1e9:.4g} mm³"


def render(run: Path, /, *, figures: Several = (), formats: Several = (), json: Json = None) -> None:
    """Draw the pictures of a run again, off-screen, as far as its stages are complete.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1
    figures
        picture to draw, such as loops or wear_depth; may be given several times; by default all that its case asks for
    formats
        png, svg or pdf; may be given several times
    """
    from fretflow.pipeline.stages import render_run

    files = render_run(run, figures, formats)
    show_files([*files, *keep_json(json, {"files": list(map(str, files))})], "files")


def export(run: Path, /, *, to: Path | None = None, noise: float = 0.0, json: Json = None) -> None:
    """Write a run's loops and wear as a recording, which `loops` reads and `diagnose` explains.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1
    to
        folder of the recording; by default RUN/recording
    noise
        of displacement and force, as a share of half their range, such as 0.005; with it each loop is drawn three
        times, which a diagnosis needs
    """
    from fretflow.pipeline.exported import stiffness_told
    from fretflow.pipeline.results import RunResults
    from fretflow.recordings.schema import EXPORTED

    folder = run / EXPORTED if to is None else to
    found = RunResults.of(run)
    files = found.to_recording(folder, noise)
    show_files([*files, *keep_json(json, {"recording": str(folder), "files": list(map(str, files))})], "recording")
    explains = f"`fretflow diagnose {folder}` explains it" if noise else "of one with --noise, diagnose explains it"
    say_line(f"`fretflow loops {folder}` reads it, and {explains}; {stiffness_told(found.case.mesh)}")
