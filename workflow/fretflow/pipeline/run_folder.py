"""The folder of a run: one process at a time writes it, and what cannot be written is one clear line."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from fretflow.core.errors import NO_SPACE, InputError, StoreError


@contextmanager
def holding(home: Path) -> Iterator[None]:
    """Make the folder of a run, and keep it for this process.

    Raises
    ------
    StoreError
        If it cannot be made, or the disk is full.
    InputError
        If another process runs there.
    """
    with _writing(home), _locked(home):
        yield


@contextmanager
def _writing(home: Path) -> Iterator[None]:
    """Turn a full disk or a folder that cannot be made or written into one clear line."""
    made = False
    try:
        home.mkdir(parents=True, exist_ok=True)
        made = True
        yield
    except OSError as error:
        if made and error.errno not in NO_SPACE:
            raise
        raise StoreError(
            f"{error.filename or home}: cannot be written ({error.strerror}); complete stages are "
            "kept: free some space or choose another --out, then run again"
        ) from error


def _own_file(path: Path) -> TextIO:
    """Open the file `path`, made if it is not there, but nothing that stands elsewhere under that name."""
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        handle = os.fdopen(number, "r+", encoding="utf-8")
    except OSError as error:
        if path.is_file() and not path.is_symlink():
            raise
        raise StoreError(f"{path}: is no ordinary file; remove it and run again") from error
    state = os.fstat(number)
    if stat.S_ISREG(state.st_mode) and state.st_nlink == 1:
        return handle
    handle.close()
    raise StoreError(f"{path}: is a link or no ordinary file; remove it and run again")


@contextmanager
def _locked(home: Path) -> Iterator[None]:
    """Hold the run folder for this process; the system lets go of it however the process ends."""
    with _own_file(home / ".lock") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            handle.seek(0)
            holder = handle.read().strip() or "unknown"
            raise InputError(f"{home}: in use by another run (process {holder}); wait for it, "
                             "or choose another --out") from error
        handle.seek(0)
        handle.write(str(os.getpid()))
        handle.truncate()
        handle.flush()
        yield
