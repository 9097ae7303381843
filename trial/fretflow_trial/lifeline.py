"""Processes that end with who started them, however that one ended."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from threading import Thread

INTERRUPTED = 130  # exit code, as after an interruption from the terminal
# Code that ends a process where its stdin does: that is a pipe whose other end the trial alone holds.
TIED = (f"import os, threading; threading.Thread(target=lambda: (os.read(0, 1), os._exit({INTERRUPTED})), "
        "daemon=True).start(); ")


def tied_processes(count: int) -> ProcessPoolExecutor:
    """Return `count` fresh interpreters that end with this one."""
    return ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_tie)


def _tie() -> None:
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(INTERRUPTED)
