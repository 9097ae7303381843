"""Work that one MPI rank does for all, without leaving the others waiting when it fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from fretflow.core.errors import FretflowError

T = TypeVar("T")


def on_root(comm: Any, work: Callable[[], T]) -> T | None:
    """Run `work` on rank 0 of `comm` and return its value there, None elsewhere.

    Raises
    ------
    FretflowError
        On every rank, if `work` raised it on rank 0.
    """
    value: T | None = None
    failure: FretflowError | None = None
    if comm.rank == 0:
        try:
            value = work()
        except FretflowError as error:
            failure = error
    failure = comm.bcast(failure, root=0)
    if failure is not None:
        raise failure
    return value
