"""What every command shares: the terminal, progress with the time left, tables, files, errors and exit codes."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import chain
from json import dumps
from math import isfinite
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from cyclopts import CycloptsError, Parameter, UnusedCliTokensError
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.markup import escape
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from fretflow.core.errors import NO_SPACE, FretflowError, InputError, NonConvergenceError, printable, shortened
from fretflow.core.plugins import formats_asked
from fretflow.pipeline.ranks import started_rank, started_size

if TYPE_CHECKING:
    from rich.progress import TaskID

    from fretflow.case.config import Case
    from fretflow.pipeline.stage import StageResult

INTERRUPTED = 130
BAD_USAGE = 2
UNEXPECTED = 1
TOLD_EVERY = 60.0  # s, where there is no terminal
REPEATED = 3  # s after which an interruption that ended nothing comes again
ANEW = {"diagnose", "effects", "export", "loops", "verify"}  # commands that keep nothing half done
NAMES = {"case", "effects", "id", "key", "parameter"}  # headings of what is copied: never broken

Out = Annotated[Path, Parameter(help="folder of all results; a case's own are in OUT/NAME")]
Force = Annotated[bool, Parameter(negative="", show_default=False, help="compute again what is already there")]
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
Several = Annotated[tuple[str, ...], Parameter(negative="", show_default=False)]


def _can_be_written(kind: object, path: Path | None) -> None:
    """Refuse a file that will not be written, before anything is computed for it."""
    if path is None:
        return
    if path.is_dir():
        raise ValueError(f"{path} is a folder; name a file")
    above = next(folder for folder in path.absolute().parents if folder.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise ValueError(f"{above} is no folder that may be written in; name another file")


NewFile = Annotated[Path | None, Parameter(validator=_can_be_written)]
Json = Annotated[Path | None, Parameter(help="file for all numbers", validator=_can_be_written)]


class Terminal(Console):
    """The user's terminal, on which text out of files and paths stays text: it moves no cursor and sets no title."""

    silent: ClassVar[bool] = False  # by --quiet: errors are said, and nothing else

    def __init__(self, *, quiet: bool = False, **settings: Any) -> None:
        super().__init__(quiet=quiet or self.silent, **settings)

    def print(self, *objects: Any, crop: bool = False, **settings: Any) -> None:
        """Print, and cut nothing off what a narrow terminal has no room for: it wraps the line."""
        super().print(*objects, crop=crop, **settings)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of `renderable`, those that rich itself steers the terminal with as they are."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


class Interruption:
    """The user's wish to stop, which is not lost where a library swallows it or makes another error of it."""

    wanted: ClassVar[bool] = False
    ends: ClassVar[str] = ""  # the command that it ends

    @classmethod
    def watch(cls) -> None:
        """Take interruptions by Ctrl-C or a batch system, and repeat one that ended nothing."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, cls._raise)

    @classmethod
    def settle(cls) -> None:
        """Repeat it no more: what it interrupted has ended."""
        signal.alarm(0)

    @classmethod
    def _raise(cls, *_: object) -> None:
        cls.wanted = True
        signal.alarm(REPEATED)
        raise KeyboardInterrupt


class Progress:
    """Shows how a run goes on: a line for each complete stage, between them a bar with the time left.

    Where there is no terminal, as in the log of a batch job, a line a minute stands for the bar, also while one step
    takes long.
    """

    def __init__(self) -> None:
        self._console = Terminal(quiet=started_rank() > 0)
        self._task: TaskID | None = None
        self._at: tuple[str, float, str] | None = None  # stage, share, text
        self._began = monotonic()

    def __enter__(self) -> Progress:
        from rich.progress import BarColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        class TimeLeft(TimeRemainingColumn):
            def render(self, task: Task) -> Text:
                return Text("left ").append(super().render(task)) if task.fields["steady"] else Text("")

        self._bars = Bars(
            TextColumn("{task.fields[stage]:<9}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TimeLeft(),
            TextColumn("{task.description}"),
            console=self._console,
            disable=not self._console.is_terminal or started_size() > 1,
            redirect_stderr=False,
            transient=True,
        )
        self._bars.start()
        self._left = Event()
        if not self._console.is_terminal:
            Thread(target=self._tell, args=(self._left,), daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._left.set()
        self._bars.stop()

    def _tell(self, left: Event) -> None:
        while not left.wait(TOLD_EVERY):
            if self._at is not None:
                stage, share, text = self._at
                self.note(stage, f"{100.0 * share:.0f} %  {(monotonic() - self._began) / 60.0:.0f} min  {text}")

    def begin(self, stage: str, steady: bool = True) -> None:
        """Note that `stage` starts computing; where its share does not grow steadily no time left is shown."""
        self._task = self._bars.add_task("", total=1.0, stage=stage, steady=steady)
        self._at, self._began = (stage, 0.0, ""), monotonic()

    def advance(self, stage: str, share: float, text: str) -> None:
        """Note that `share` (0 to 1) of `stage` is done."""
        if self._task is not None:
            self._bars.update(self._task, completed=share, description=text)
            self._at = stage, share, text

    def note(self, stage: str, text: str) -> None:
        """Print a line about `stage`, which goes on."""
        self._console.print(f"{stage:<9} {text}", highlight=False, markup=False, soft_wrap=True)

    def end(self, result: StageResult) -> None:
        """Note that a stage is complete, computed or reused."""
        if self._task is not None:
            self._bars.remove_task(self._task)
            self._task = self._at = None
        cost = "reused" if result.reused else f"{result.manifest.seconds:.1f} s"
        self._console.print(f"{result.name:<9} {cost:>9}  {result.folder}", highlight=False, soft_wrap=True)


def keep_json(file: Path | None, content: object) -> list[Path]:
    """Write `content` as JSON to `file`, if one is asked for, and return what was written; nan becomes null."""
    if file is None:
        return []
    from fretflow.core.store import write_whole

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--json {file}: cannot be written ({error.strerror}); name another file") from error
    write_whole(file, (dumps(_plain(content), indent=1, allow_nan=False) + "\n").encode())
    return [file]


def _plain(content: object) -> Any:
    """Return `content` as JSON takes it."""
    if is_dataclass(content) and not isinstance(content, type):
        content = {one.name: getattr(content, one.name) for one in fields(content)}
    if hasattr(content, "tolist"):  # of NumPy
        content = content.tolist()
    if isinstance(content, Mapping):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, str | bool | int | None):
        return content
    if isinstance(content, float):
        return content if isfinite(content) else None
    if isinstance(content, Iterable):
        return [_plain(value) for value in content]
    return str(content)


def say_line(text: str) -> None:
    """Print a line as it is."""
    Terminal().print(text, highlight=False, markup=False, soft_wrap=True)


def show_files(files: Sequence[Path], title: str) -> None:
    """Print the paths of `files`, of pictures in each of the formats that the user's variable names."""
    console = Terminal(highlight=False)
    console.print(f"{title}:")
    first, *further = formats_asked()
    every = ([file, *(file.with_suffix(f".{one}") for one in further if file.suffix == f".{first}")] for file in files)
    for file in dict.fromkeys(chain.from_iterable(every)):
        console.print(f"  {escape(str(file))}", soft_wrap=True)


class ReadableTable(Table):
    """A table that breaks no word: where its columns are too narrow, rows are lists of headings and cells."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the table, or its rows one below the other."""
        wide = options.update(max_width=10_000)
        own = [[Measurement.get(console, wide, cell) for cell in (column.header, *column.cells)]
               for column in self.columns]
        widths = [max(one.maximum if column.no_wrap else one.minimum for one in cells)
                  for column, cells in zip(self.columns, own, strict=True)]
        whole = [max(one.maximum for one in cells) for cells in own]
        room = options.max_width - self.__rich_measure__(console, wide).maximum + sum(whole)
        if sum(widths) <= room:
            for wanted in ([max((one.maximum for one in cells[1:]), default=0) for cells in own], whole):
                more = [max(0, one - width) for one, width in zip(wanted, widths, strict=True)]
                given = min(room - sum(widths), sum(more))  # to cells first, then to headings
                widths = [width + one * given // max(sum(more), 1) for one, width in zip(more, widths, strict=True)]
            for column, width in zip(self.columns, widths, strict=True):
                column.width = width
            yield from super().__rich_console__(console, options)
            return
        yield Text.from_markup(str(self.title or ""), style="table.title")
        for cells in zip(*(column.cells for column in self.columns), strict=True):
            row = Table.grid(padding=(0, 2, 0, 0))
            row.add_column(style="bold", no_wrap=True)
            row.add_column(overflow="fold")
            for column, cell in zip(self.columns, cells, strict=True):
                row.add_row(column.header, cell)
            yield row
            yield ""


def new_table(title: str, *headings: str) -> Table:
    """Return an empty table in the house style."""
    view = ReadableTable(title=escape(title), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        longest = max((len(word) for word in heading.split()), default=0)
        view.add_column(heading, overflow="fold", no_wrap=heading in NAMES, min_width=longest)
    return view


def load(path: Path) -> Case:
    """Read a case file, its effects included, before anything is computed."""
    from fretflow.case.config import load_case
    from fretflow.case.plausibility import warnings
    from fretflow.pipeline.estimate import time_warning

    case = load_case(path)
    if case.effects:
        from fretflow.effects.catalogue import parse_effects

        parse_effects(case.effects, str(path))
    show_warnings((*warnings(case), *time_warning(case)))
    return case


def show_warnings(texts: Sequence[str]) -> None:
    """Print warnings, a line each."""
    for text in texts:
        Terminal(quiet=started_rank() > 0, highlight=False).print(f"warning: {escape(text)}", soft_wrap=True)


def describe(error: BaseException) -> tuple[str, int]:
    """Return one line about `error` for the user, and its exit code; the traceback of a surprise goes to a file."""
    if Interruption.wanted or isinstance(error, KeyboardInterrupt):
        after = "begins anew" if Interruption.ends in ANEW else "goes on from what is complete"
        return f"interrupted; the same command {after}", INTERRUPTED
    if isinstance(error, CycloptsError):
        command = " ".join(("fretflow", *(error.command_chain or ())))
        said = f"{command} takes no {' '.join(error.unused_tokens or ())!r} there" if isinstance(
            error, UnusedCliTokensError) else str(error).partition(" Available commands")[0].rstrip(".")
        return f"{shortened(said)}; `{command} --help` tells what there is", BAD_USAGE
    if isinstance(error, NonConvergenceError):
        history = f"; residual history in {error.history_file}" if error.history_file else ""
        state = f"; last good state in {error.last_good}" if error.last_good else ""
        return f"{error}{history}{state}", error.exit_code
    if isinstance(error, FretflowError):
        return str(error), error.exit_code
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        return (f"{error.filename or 'a file'}: cannot be read or written ({error.strerror}); complete results are "
                "kept: free some space or see who may write there, then run again"), InputError.exit_code
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: cannot be used ({error.strerror}); name another", InputError.exit_code
    if isinstance(error, MemoryError):
        return f"out of memory ({error}); give less at a time, or more memory", InputError.exit_code
    where = f"{own}: " if (own := _place_in_own_effect(error)) else "unexpected "
    return f"{where}{type(error).__name__}: {shortened(str(error))}{_keep_traceback(error)}", UNEXPECTED


def say(message: str, code: int) -> int:
    """Write one line to stderr, once for all ranks unless it is a surprise of one of them, and return `code`."""
    if started_rank() == 0 or code == UNEXPECTED:
        sys.stderr.write(f"fretflow: {printable(' '.join(message.split()))}\n")
    return code


def _place_in_own_effect(error: BaseException) -> str:
    """Return file and line of a user's effect that an error passed through, the innermost; nothing if there is none."""
    from fretflow.effects.catalogue import MODULES

    return next((f"{frame.f_code.co_filename}, line {line}" for frame, line in
                 reversed(list(traceback.walk_tb(error.__traceback__)))
                 if str(frame.f_globals.get("__name__", "")).startswith(MODULES)), "")


def _keep_traceback(error: BaseException) -> str:
    """Return where the traceback was written, nothing if it could not be."""
    try:
        handle, name = tempfile.mkstemp(prefix="fretflow-traceback-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            traceback.print_exception(error, file=file)
    except OSError:
        return ""
    return f"; traceback in {name}"


def positive(option: str, text: str | None, unit: str) -> float | None:
    """Return the number that `option` gives in `unit`, or None where it is not given.

    Raises
    ------
    InputError
        If it has no unit of the right kind, or is not positive.
    """
    from fretflow.core.units import parse_quantity

    if text is None:
        return None
    try:
        value = parse_quantity(text, unit)
    except ValueError as error:
        raise InputError(f"{option}: {error}") from error
    if not value > 0.0:
        raise InputError(f"{option}: must be positive, got {text!r}")
    return value
