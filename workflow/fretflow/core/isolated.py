"""A call in a fresh Python interpreter: its main thread is its own, and a crash takes nobody along."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from fretflow.core.errors import PlatformError

R = TypeVar("R")
LAST_WORDS = 300  # characters of a dead process's stderr that are passed on


def call_isolated(function: Callable[..., R], /, *args: Any, before: Callable[[], object] = int, **kwargs: Any) -> R:
    """Return ``function(*args, **kwargs)`` as computed by an interpreter of its own, which calls `before` first.

    Raises
    ------
    PlatformError
        If that interpreter dies.
    Exception
        What the function raises.
    """
    asked = pickle.dumps(before) + pickle.dumps((function, args, kwargs))
    done = subprocess.run([sys.executable, "-P", "-m", __name__], input=asked, capture_output=True, check=False)
    if done.returncode != 0:
        words = " ".join(done.stderr.decode(errors="replace")[-LAST_WORDS:].split())
        raise PlatformError(f"its process ended with code {done.returncode}: {words}")
    value, error = pickle.loads(done.stdout)
    if error is not None:
        raise error
    return value  # type: ignore[no-any-return]


def _serve() -> None:
    """Answer one call from stdin on stdout; whatever else is written to stdout goes to stderr."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    pickle.load(sys.stdin.buffer)()
    function, args, kwargs = pickle.load(sys.stdin.buffer)
    for fatal in (signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGSEGV):
        signal.signal(fatal, signal.SIG_DFL)  # those of MPI and PETSc, now loaded, may wait for ever in a broken heap
    result: tuple[Any, Exception | None]
    try:
        result = (function(*args, **kwargs), None)
    except Exception as error:  # noqa: BLE001 - the caller raises it
        result = (None, error)
    with answer:
        answer.write(pickle.dumps(result))


if __name__ == "__main__":
    _serve()
