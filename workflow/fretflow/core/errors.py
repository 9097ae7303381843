"""The errors that fretflow raises, by what the user can do about them.

Every message is one line: the field or file, what is wrong, and the way out.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails, ValidationError

# What the system says where nothing can be written: the user's to mend.
NO_SPACE = {errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EPERM, errno.EDQUOT, errno.EFBIG}

LONGEST = 1000  # characters of a message

# What makes a terminal do things instead of showing them: control characters, and those that turn text around.
_CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_LINES = re.compile(r"\s*\n\s*")
_QUOTED = re.compile(r"'([^']*)'")  # what may be chosen from, in words of pydantic
_PLAINER = {"a valid tuple": "several in brackets", "a valid string": "text in quotes",
            "a valid integer": "a whole number", "a valid number": "a number", "a valid boolean": "true or false",
            "a valid dictionary": "a table of keys"}
_OWN_WORDS = re.compile(r", (got a|unable to) .*")  # of pydantic, on what was given


def printable(text: str) -> str:
    """Return `text`, which may come from a file or a path, without what would steer a terminal; lines stay."""
    return _CONTROL.sub("", text)


def shortened(text: str) -> str:
    """Return a message that holds no more of the user's text than people read."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST // 2]} ... {text[-LONGEST // 4:]}"


class FretflowError(Exception):
    """Base of every error that fretflow raises on purpose."""

    exit_code = 1

    def __str__(self) -> str:
        return shortened(_LINES.sub(" ", super().__str__()))  # one line, also where it shows an array


class FretflowWarning(UserWarning):
    """Base of every warning of a result that holds less than it seems to."""


class UnstablePeriodWarning(FretflowWarning):
    """The period solves its equations, but no test would stay on it."""


class HeavyContactWarning(FretflowWarning):
    """The contact has more inertia or damping than the method may leave out."""


class InputError(FretflowError):
    """The user's input cannot be used: a field, a file, a mesh. Exit code 2."""

    exit_code = 2


class ConfigError(InputError):
    """A case file has a missing, unknown or impossible value."""


class UnitError(InputError):
    """A physical number lacks its unit or has one of the wrong dimension."""


class MeshError(InputError):
    """A mesh lacks its groups, has unmatched contact nodes or an inverted element."""


class StoreError(InputError):
    """A result file is missing, truncated or of another schema."""


class RecordingError(InputError):
    """A recording cannot be used."""


class CorruptRecordingError(RecordingError):
    """A file of a recording cannot be read, or is damaged or cut off."""


class UnsupportedRecordingError(RecordingError):
    """A recording is of a form that fretflow does not read, or does not say what is needed to read it."""


class UnreliableRecordingError(RecordingError):
    """A recording can be read but contradicts itself, or too little of it is usable."""


class PlatformError(FretflowError):
    """Something that the machine should provide is missing."""

    exit_code = 2


class NonConvergenceError(FretflowError):
    """An iteration did not reach its tolerance. Exit code 3.

    Attributes
    ----------
    history : tuple of float
        Residual norm of each iteration, relative to the load unless the message says otherwise.
    last_good : Path or None
        Where the last good state is kept, if one was written.
    history_file : Path or None
        File that keeps the history, once a run has written it.

    Examples
    --------
    >>> import fretflow as ff
    >>> try:
    ...     raise ff.NonConvergenceError("no step helps", history=[1.0, 0.5])
    ... except ff.FretflowError as error:
    ...     print(error, error.history)
    no step helps (1.0, 0.5)
    """

    exit_code = 3

    def __init__(self, message: str, history: Sequence[float] = (), last_good: Path | None = None) -> None:
        super().__init__(message)
        self.history = tuple(float(r) for r in history)
        self.last_good = last_good
        self.history_file: Path | None = None


class AuditError(FretflowError):
    """A result violates a law that it must satisfy: a balance, a cone, an orthogonality. Exit code 3."""

    exit_code = 3


class EnsembleError(FretflowError):
    """Some of several cases failed while the others were completed.

    Attributes
    ----------
    exit_code : int
        That of the worst case.
    """

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def missing_last(error: ValidationError) -> list[ErrorDetails]:
    """Return the errors of a table, keys that are missing last: one that is unknown tells why."""
    return sorted(error.errors(), key=lambda one: one["type"] == "missing")


def reason(error: ErrorDetails, clearer: Mapping[str, str], model: type[Any]) -> str:
    """Return why a table of class `model` is refused, by `clearer` (type to words) or by the validator's message."""
    if error["type"] in clearer:
        meant = _key_meant(model, error["loc"]) if error["type"] == "extra_forbidden" else ""
        return clearer[error["type"]] + meant
    text = error["msg"].removeprefix("Value error, ")
    if not text.startswith("Input should"):
        return text
    wanted, given = text.replace("Input should", "must", 1), error["input"]
    for theirs, ours in _PLAINER.items():
        wanted = wanted.replace(theirs, ours)
    if not isinstance(given, bool | int | float | str):
        return wanted
    meant = did_you_mean(given, _QUOTED.findall(wanted)) if isinstance(given, str) else ""
    return f"{_OWN_WORDS.sub('', wanted)}, got {given!r}{meant}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a question after the nearest of `known` names where `name` begins it or is a slip of it, else nothing."""
    names = list(known)
    near = [one for one in names if len(name) > 2 and one.startswith(name)] or get_close_matches(name, names, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _key_meant(model: Any, location: Sequence[int | str]) -> str:
    """Return the question after the key that an unknown one at `location` in tables of class `model` is a slip of."""
    for part in location[:-1]:
        if isinstance(part, int):
            continue
        kind = model.model_fields[part].annotation if part in model.model_fields else None
        model = next((one for one in (kind, *get_args(kind)) if hasattr(one, "model_fields")), None)
        if model is None:
            return ""
    return did_you_mean(str(location[-1]), model.model_fields)
