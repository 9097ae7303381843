"""Processes that end with who started them, however that one ended."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from threading import Thread
from typing import Any

INTERRUPTED = 130  # exit code, as after an interruption from the terminal
# Code that ends a process where its stdin does: that is a pipe whose other end the trial alone holds.
TIED = (f"import os, threading; threading.Thread(target=lambda: (os.read(0, 1), os._exit({INTERRUPTED})), "
        "daemon=True).start(); ")


def tied_processes(count: int) -> ProcessPoolExecutor:
    """Return `count` fresh interpreters that end with this one."""
    return _Quiet(count, mp_context=multiprocessing.get_context("spawn"), initializer=_tie)


class _Quiet(ProcessPoolExecutor):
    """Processes that an interruption from the terminal, which reaches them too, ends without a word."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, until `_tie`
        try:
            return super().submit(function, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _tie() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(INTERRUPTED)
