"""Tables in text: comma, semicolon, tab or blank between the values, point or comma in the numbers.

NumPy's reader takes some 0.1 s for a million numbers; only a file that it refuses is read row by row, to name
the row in error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError
from fretflow.core.records import Array
from fretflow.recordings.notes import Note
from fretflow.recordings.readers.tables import MOST_COLUMNS, Table

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".prn")
COMMENTS = ("#", "%")
EMPTY = {"", "nan", "na", "n/a", "-", "--", "null", "none"}

_NUMBER_WITH_COMMA = re.compile(r"[+-]?(?:\d+|\d{1,3}(?:\.\d{3})+),\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class _Form:
    """How a text file is written."""

    encoding: str
    delimiter: str | None  # None: any blanks
    decimal_comma: bool
    thousands: bool  # points part them
    headings: tuple[str, ...]
    units: tuple[str, ...]
    lines_before: int  # the first row of numbers comes after so many lines

    def plain(self, line: str) -> str:
        """Return a line with its numbers as Python reads them."""
        line = line.replace(".", "") if self.thousands else line
        return line.replace(",", ".") if self.decimal_comma else line


def read(path: Path, wanted: Sequence[str] | None = None) -> Table:
    """Read a text file of numbers, its headings in the first line that is no comment, if it has any.

    All columns are read; a second line of headings is taken as units. A last row that is cut off is left out with a
    note.

    Raises
    ------
    CorruptRecordingError
        If the file holds no numbers, or a row is too short or holds text, naming the row and column.
    UnsupportedRecordingError
        If commas may separate numbers or be part of them.
    """
    form = _form(path)
    notes: tuple[Note, ...] = ()
    try:
        rows, kept = _read_fast(path, form)
    except ValueError:
        rows, kept, notes = _read_by_row(path, form)
    columns = {form.headings[k]: np.ascontiguousarray(rows[:, j]) for j, k in enumerate(kept)}
    units = {form.headings[k]: form.units[k] for k in kept if form.units and form.units[k]}
    return Table(path, columns, units, notes)


def _form(path: Path) -> _Form:
    encoding = _encoding(path)
    with path.open(encoding=encoding) as file:
        head = [(number, line.strip()) for number, line in enumerate(islice(file, 1000))]
    head = [(number, line) for number, line in head if line and not line.startswith(COMMENTS)]
    first = next((k for k, (_, line) in enumerate(head) if _delimiter(line)[1]), None)
    if first is None:
        raise CorruptRecordingError(f"{path}: holds no row of numbers; export it again")
    number, line = head[first]
    delimiter = _delimiter(line)[0]
    width = len(_split(line, delimiter))
    if width > MOST_COLUMNS:
        raise UnsupportedRecordingError(f"{path}: row 1 has {width:,} values, and at most {MOST_COLUMNS:,} are read; a "
                                        "row is an instant and a column a channel: transpose it")
    cells = [cell for _, text in head[first:] for cell in _split(text, delimiter)]
    with_comma = [cell for cell in cells if delimiter != "," and _NUMBER_WITH_COMMA.fullmatch(cell)]
    above = [_split(text, delimiter) for _, text in head[max(0, first - 2):first]]
    if delimiter and line.endswith(delimiter) and above and len(above[-1]) == width + 1:
        width += 1  # the last cell is empty
    if delimiter == "," and above and len(above[-1]) * 2 == width:
        raise UnsupportedRecordingError(f"{path}: row 1 has {width} values for {width // 2} headings: commas both "
                                        "in and between numbers; export it with semicolons")
    above = [names for names in above if len(names) == width] or _commented(path, encoding, number, delimiter, width)
    headings = above[0] if above else [str(k + 1) for k in range(width)]
    if len(set(headings)) < width:
        raise UnsupportedRecordingError(f"{path}: two columns have one heading among {', '.join(headings)}; "
                                        "rename one")
    units = [unit.strip("[]()") for unit in above[1]] if len(above) > 1 else []
    return _Form(encoding, delimiter, bool(with_comma), any("." in cell for cell in with_comma), tuple(headings),
                 tuple(units), number)


def _commented(path: Path, encoding: str, number: int, delimiter: str | None, width: int) -> list[list[str]]:
    """Return the headings in the comment right above line `number`, where some programs put them."""
    with path.open(encoding=encoding) as file:
        line = next(islice(file, number - 1, None), "") if number else ""
    names = _split(line.strip().lstrip("".join(COMMENTS)), delimiter) if line.startswith(COMMENTS) else []
    return [names] if len(names) == width and not any(map(_is_number, names)) else []


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        start = file.read(1 << 16)
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in start:
        raise UnsupportedRecordingError(f"{path}: is no text; export it as CSV")
    try:
        start[:-4].decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _split(line: str, delimiter: str | None) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.strip().split(delimiter)]
    return cells[:-1] if len(cells) > 1 and not cells[-1] and delimiter in (",", ";") else cells


def _delimiter(line: str) -> tuple[str | None, bool]:
    """Return the delimiter of a line, and whether it is a line of numbers."""
    for delimiter in (";", "\t", None, ","):
        if delimiter is not None and delimiter not in line:
            continue
        cells = _split(line, delimiter)
        comma = delimiter != "," and any(_NUMBER_WITH_COMMA.fullmatch(cell) for cell in cells)
        values = [cell.replace(".", "").replace(",", ".") if _NUMBER_WITH_COMMA.fullmatch(cell) else cell
                  for cell in cells] if comma else cells
        numbers = [_is_number(value) for value in values]
        plausible = all(number or value.lower() in EMPTY for number, value in zip(numbers, values, strict=True))
        mostly = delimiter is not None and (numbers[0] or 2 * sum(numbers) > len(numbers))
        if any(numbers) and (plausible or mostly):
            if delimiter is None and len(cells) == 1 and comma:
                continue  # "1,5" is two numbers
            return delimiter, True
    return None, False


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.lower() not in EMPTY


def _lines(file: TextIO, form: _Form) -> Iterator[str]:
    body = islice(file, form.lines_before, None)
    return map(form.plain, body) if form.decimal_comma else body


def _read_fast(path: Path, form: _Form) -> tuple[Array, Sequence[int]]:
    with path.open(encoding=form.encoding) as file:
        rows = np.loadtxt(_lines(file, form), delimiter=form.delimiter, comments=COMMENTS, ndmin=2)
    if rows.shape[1] != len(form.headings):
        raise ValueError("trailing delimiters")
    return rows, range(len(form.headings))


def _read_by_row(path: Path, form: _Form) -> tuple[Array, Sequence[int], tuple[Note, ...]]:
    """Read rows one by one, with empty cells as nan; columns of text are left out."""
    width = len(form.headings)
    cells: list[list[str]] = []
    short: int | None = None
    with path.open(encoding=form.encoding) as file:
        for line in islice(file, form.lines_before, None):
            text = next((line.partition(mark)[0] for mark in COMMENTS if mark in line), line).strip("\r\n ")
            if not text:
                continue
            if short is not None:
                raise CorruptRecordingError(f"{path}: row {short + 1} has {len(cells[-1])} values where the first has "
                                            f"{width}; repair or remove it")
            cells.append(_padded(_split(form.plain(text), form.delimiter), text, form, width))
            if len(cells[-1]) != width:
                short = len(cells) - 1
    notes: tuple[Note, ...] = ()
    if short is not None:
        notes = (Note(path.name, "the file is cut off within this row, which is left out", rows=((short + 1,) * 2,)),)
        cells.pop()
    text_columns = {k for k in range(width) if cells and not _is_cell(cells[0][k])}
    kept = [k for k in range(width) if k not in text_columns]
    notes += tuple(Note(path.name, "holds text and is left out", form.headings[k]) for k in sorted(text_columns))
    return np.array([[_number(row[k], path, j, form.headings[k]) for k in kept]
                     for j, row in enumerate(cells)]), kept, notes


def _padded(cells: list[str], text: str, form: _Form, width: int) -> list[str]:
    """Give back the empty last cell that looks like a delimiter at the end of the line."""
    ends_empty = form.delimiter in (",", ";") and text.endswith(form.delimiter or "\0")
    return [*cells, ""] if ends_empty and len(cells) == width - 1 else cells


def _is_cell(text: str) -> bool:
    return text.lower() in EMPTY or _is_number(text)


def _number(text: str, path: Path, row: int, heading: str) -> float:
    if text.lower() in EMPTY:
        return float("nan")
    try:
        return float(text)
    except ValueError as error:
        raise CorruptRecordingError(f"{path}: row {row + 1}, column {heading}: {text!r} is no number; repair or "
                                    "empty the cell") from error
