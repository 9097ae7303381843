"""How errors reach the user: one line on stderr and an exit code."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback

from cyclopts import CycloptsError

from fretflow.core.errors import NO_SPACE, FretflowError, InputError, NonConvergenceError, printable
from fretflow.pipeline.ranks import started_rank

INTERRUPTED = 130
BAD_USAGE = 2
UNEXPECTED = 1


def describe(error: BaseException) -> tuple[str, int]:
    """Return one line about `error` for the user, and its exit code; the traceback of a surprise goes to a file."""
    if isinstance(error, CycloptsError):
        return f"{error}; `fretflow --help` lists what there is", BAD_USAGE
    if isinstance(error, NonConvergenceError):
        history = f"; residual history in {error.history_file}" if error.history_file else ""
        state = f"; last good state in {error.last_good}" if error.last_good else ""
        return f"{error}{history}{state}", error.exit_code
    if isinstance(error, FretflowError):
        return str(error), error.exit_code
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; the same command continues where it stopped", INTERRUPTED
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        return (f"{error.filename or 'a file'}: cannot be read or written ({error.strerror}); complete results are "
                "kept: free some space or see who may write there, then run again"), InputError.exit_code
    return f"unexpected {type(error).__name__}: {error}{_keep_traceback(error)}", UNEXPECTED


def say(message: str, code: int) -> int:
    """Write one line to stderr, once for all ranks unless it is a surprise of one of them, and return `code`."""
    if started_rank() == 0 or code == UNEXPECTED:
        sys.stderr.write(f"fretflow: {printable(' '.join(message.split()))}\n")
    return code


def _keep_traceback(error: BaseException) -> str:
    """Return where the traceback was written, nothing if it could not be."""
    try:
        handle, name = tempfile.mkstemp(prefix="fretflow-traceback-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            traceback.print_exception(error, file=file)
    except OSError:
        return ""
    return f"; traceback in {name}"
