"""What was done to a recording before it was used: nothing is changed or left out without a note."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MOST_RANGES = 4


@dataclass(frozen=True)
class Note:
    """A warning about part of a recording. Rows count from 1, the first row of numbers below the heading."""

    block: str
    text: str
    channel: str = ""
    rows: tuple[tuple[int, int], ...] = field(default=())  # first and last row of each range

    def __str__(self) -> str:
        where = ", ".join(filter(None, (self.block, self.channel, rows_in_words(self.rows))))
        return f"{where}: {self.text}"


def row_ranges(rows: NDArray[np.int64]) -> tuple[tuple[int, int], ...]:
    """Return the ranges (first, last), counted from 1, of row indices that count from 0; (n,)."""
    if not len(rows):
        return ()
    rows = np.unique(rows)
    breaks = np.flatnonzero(np.diff(rows) > 1)
    first, last = np.r_[rows[0], rows[breaks + 1]], np.r_[rows[breaks], rows[-1]]
    return tuple((int(a) + 1, int(b) + 1) for a, b in zip(first, last, strict=True))


def rows_in_words(ranges: tuple[tuple[int, int], ...]) -> str:
    """Return ranges of rows for people: ``rows 3-7, 12 and 5 more ranges up to row 900``."""
    if not ranges:
        return ""
    words = [f"{a}-{b}" if b > a else f"{a}" for a, b in ranges[:MOST_RANGES]]
    one = len(ranges) == 1 and ranges[0][0] == ranges[0][1]
    rest = len(ranges) - MOST_RANGES
    more = f" and {rest} more place{'s' * (rest > 1)} up to row {ranges[-1][1]}" if rest > 0 else ""
    return f"{'row' if one else 'rows'} {', '.join(words)}{more}"
