"""How far something is: what functions that take their time are given to tell it by."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # of the share that is done, and of what is going on
