"""What the command line shows: progress with the time left, tables, files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.segment import Segment
from rich.table import Table

from fretflow.core.errors import printable
from fretflow.pipeline.ranks import started_rank, started_size

if TYPE_CHECKING:
    from fretflow.case.config import Case
    from fretflow.pipeline.comparison import CaseComparison
    from fretflow.pipeline.stage import StageResult
    from fretflow.pipeline.summary import Figure
    from fretflow.pipeline.trends import Trend
    from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen

MIB = 2**20


class Terminal(Console):
    """The user's terminal, on which text out of files and paths stays text: it moves no cursor and sets no title."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of `renderable`, those that rich itself steers the terminal with as they are."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


class Progress:
    """Shows how a run goes on: a bar with the time left on a terminal, and a line for each complete stage."""

    def __init__(self) -> None:
        self._console = Terminal(quiet=started_rank() > 0)
        self._task: TaskID | None = None

    def __enter__(self) -> Progress:
        self._bars = Bars(
            TextColumn("{task.fields[stage]:<9}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=self._console,
            disable=not self._console.is_terminal or started_size() > 1,
            redirect_stderr=False,
            transient=True,
        )
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def begin(self, stage: str) -> None:
        """Note that `stage` starts computing."""
        self._task = self._bars.add_task("", total=1.0, stage=stage)

    def advance(self, stage: str, share: float, text: str) -> None:
        """Note that `share` (0 to 1) of `stage` is done."""
        if self._task is not None:
            self._bars.update(self._task, completed=share, description=text)

    def note(self, stage: str, text: str) -> None:
        """Print a line about `stage`, which goes on."""
        self._console.print(f"{stage:<9} {text}", highlight=False, markup=False, soft_wrap=True)

    def end(self, result: StageResult) -> None:
        """Note that a stage is complete, computed or reused."""
        if self._task is not None:
            self._bars.remove_task(self._task)
            self._task = None
        cost = "reused" if result.reused else f"{result.manifest.seconds:.1f} s"
        self._console.print(f"{result.name:<9} {cost:>9}  {result.folder}", highlight=False, soft_wrap=True)


def show_case(case: Case) -> None:
    """Print every value of `case` in the units that engineers use."""
    from fretflow.case.casefile import entries

    console, shown = Terminal(), list(entries(case))
    if case.effects:
        from fretflow.effects.catalogue import parse_effects

        for effect in parse_effects(case.effects):
            shown += entries(effect, ("effects", effect.id))
    for table, group in groupby(shown, key=lambda entry: entry.table):
        view = new_table(".".join(table) or "case", "key", "value", "", "meaning")
        for entry in group:
            view.add_row(
                entry.key, escape(entry.readable), "default" if entry.is_default else "", entry.meaning
            )
        console.print(view)


def show_modes(specimens: Mapping[str, ReducedSpecimen]) -> None:
    """Print the natural frequencies of each specimen, full model against reduced."""
    console = Terminal()
    for side, specimen in specimens.items():
        view = new_table(f"{side} specimen, back face clamped: {specimen.full_dofs:_} DOF against "
                         f"{len(specimen.stiffness)}", "mode", "full model, Hz", "Craig-Bampton, Hz", "error")
        rows = zip(
            specimen.full_frequencies, specimen.reduced_frequencies, specimen.frequency_error, strict=True
        )
        for number, (full, reduced, error) in enumerate(rows, start=1):
            view.add_row(str(number), f"{full:.2f}", f"{reduced:.2f}", f"{error:.5%}")
        console.print(view)


def show_summary(case: Case, figures: Sequence[Figure], trends: Sequence[Trend],
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


def show_ended(done: int, total: int, name: str, failure: str) -> None:
    """Print that a case of several has ended."""
    state = f"failed: {failure}" if failure else "complete"
    Terminal().print(f"{done} of {total}  {escape(name)}  {escape(state)}", highlight=False, soft_wrap=True)


def show_comparison(rows: Sequence[CaseComparison]) -> None:
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


def _beside(found: float | None, measured: float | None, error: float | None, text: Callable[[float], str]) -> str:
    lines = ["-" if found is None else text(found)]
    if measured is not None:
        lines.append(text(measured) + ("" if error is None else f" ({error:+.1%})"))
    return "\n".join(lines)


def _micrometres(value: float) -> str:
    return f"{value * 1e6:.4g} um"


def _cubic_millimetres(value: float) -> str:
    return f"{value * 1e9:.4g} mm^3"


def show_files(files: Sequence[Path], title: str) -> None:
    """Print the paths of `files`."""
    console = Terminal(highlight=False)
    console.print(f"{title}:")
    for file in files:
        console.print(f"  {escape(str(file))}", soft_wrap=True)


def new_table(title: str, *headings: str) -> Table:
    """Return an empty table in the house style."""
    view = Table(title=escape(title), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        view.add_column(heading, overflow="fold")
    return view
