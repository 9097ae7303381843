"""The file ``recording.toml`` of any kind of recording: what all have, read, and validated in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError

from fretflow.case.sections import Section, Title
from fretflow.core.errors import ConfigError, CorruptRecordingError, missing_last, reason
from fretflow.core.files import RECORDING, read_toml

FILE = "recording.toml"
CLEARER = {"extra_forbidden": "unknown key; docs/recordings.md lists those there are", "missing": "is required",
           "too_short": "must hold one at least", "model_type": "must be a table of keys"}

M = TypeVar("M", bound=BaseModel)


class Description(Section):
    """What a ``recording.toml`` says of itself, whatever was recorded."""

    format: Literal["fretflow-recording/1"] = Field(description="format of this file")
    title: Title = Field("", description="one line for people")
    source: str = Field("", description="where the recording comes from")
    licence: str = Field("", description="terms of its use")


def file_at(path: Path) -> Path:
    """Return the file of a recording that is named by its folder or by the file itself."""
    return path / FILE if path.is_dir() else path


def read_description(toml: Path) -> dict[str, Any]:
    """Return the content of a ``recording.toml``.

    Raises
    ------
    CorruptRecordingError
        If it cannot be read.
    ConfigError
        If it is no recording's.
    """
    raw = read_toml(toml, CorruptRecordingError, f"a recording is a folder with a {FILE}, which `fretflow init "
                    "--recording FILE` writes for a file of loops, or one table of wear tests", formats=(RECORDING,))
    if raw.get("format") != RECORDING:
        raise ConfigError(f"{toml}: format: must be {RECORDING!r}")
    return raw


def validated(model: type[M], raw: dict[str, Any], toml: Path) -> M:
    """Return the content `raw` of the file `toml` as a `model`.

    Raises
    ------
    ConfigError
        Naming the file, the first field in error, and the way out.
    """
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first, *rest = missing_last(error)
        field = ".".join(str(part) for part in first["loc"] if part != "channels")
        text = reason(first, CLEARER, model)
        if len(first["loc"]) == 1 and isinstance(test := raw.get("test"), dict) and "kind" in test:
            text = text.replace("unknown key", f"unknown key where test.kind is {test['kind']!r}")
        # A message about a key of this table begins with the key's name.
        joint = "." if text.partition(":")[0].replace(".", "").replace("_", "").isalnum() and ":" in text else ": "
        more = f" (and {len(rest)} more)" if rest else ""
        raise ConfigError(f"{toml}: {f'{field}{joint}' if field else ''}{text}{more}") from error
