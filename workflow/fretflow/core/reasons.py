"""Why a value of a file was refused, in words that tell what was given."""

from __future__ import annotations

import re
from collections.abc import Mapping

from pydantic_core import ErrorDetails

_OWN_WORDS = re.compile(r", (got a|unable to) .*")  # of pydantic, on what was given


def reason(error: ErrorDetails, clearer: Mapping[str, str]) -> str:
    """Return the reason of a validation error, by `clearer` (type to words) or by the validator's message."""
    if error["type"] in clearer:
        return clearer[error["type"]]
    text = error["msg"].removeprefix("Value error, ")
    if not text.startswith("Input should"):
        return text
    wanted, given = text.replace("Input should", "must", 1), error["input"]
    if not isinstance(given, bool | int | float | str):
        return wanted
    return f"{_OWN_WORDS.sub('', wanted)}, got {given!r}"
