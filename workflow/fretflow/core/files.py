"""Files that users give: opened only where they are files, and refused in one line where they are no such file."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fretflow.core.errors import ConfigError, InputError, did_you_mean

MOST_NAMED = 3  # files of a folder
LARGEST = 10**7  # bytes of a case file or a recording.toml, which are some kB

CASE, STRUCTURE, RECORDING = "fretflow-case/1", "fretflow-structure/1", "fretflow-recording/1"  # formats
TAKEN_BY = {CASE: "a case, which `fretflow run` takes",
            STRUCTURE: "a bolted structure, which `fretflow run` takes and nothing else does",
            RECORDING: "a recording, which `fretflow loops` and `fretflow diagnose` take"}


def read_toml(path: Path, refusal: type[InputError], way_out: str, formats: Sequence[str] = tuple(TAKEN_BY)
              ) -> dict[str, Any]:
    """Return the content of the TOML file `path`.

    Raises
    ------
    InputError
        Of class `refusal`, naming why it cannot be read, and the `way_out`.
    ConfigError
        If it is of another format of fretflow's than `formats`, saying what takes it.
    """
    raw = _parsed(path, refusal, way_out)
    own = raw.get("format")
    if isinstance(own, str) and own in TAKEN_BY and own not in formats:
        raise ConfigError(f"{path}: format: is {TAKEN_BY[own]}")
    return raw


def _parsed(path: Path, refusal: type[InputError], way_out: str) -> dict[str, Any]:
    try:
        if path.exists() and not path.is_dir() and not path.is_file():
            raise refusal(f"{path}: is no file but a pipe or a device; {way_out}")
        if path.is_file() and path.stat().st_size > LARGEST:
            raise refusal(f"{path}: {path.stat().st_size / 1e6:.0f} MB are no file of keys and values; {way_out}")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise refusal(f"{path}: cannot be read ({error.strerror}){_inside(path)}; {way_out}{_near(path)}") from error
    except RecursionError as error:
        raise refusal(f"{path}: its tables or arrays lie hundreds deep in each other; {way_out}") from error
    except ValueError as error:  # no TOML, no UTF-8, thousands of digits, a null character in the path
        raise refusal(f"{path}: not valid TOML: {str(error).partition(';')[0]}; {way_out}") from error


def no_file(path: Path) -> str:
    """Say why a path is no file: there is nothing, or a folder."""
    return f"{path} is a folder; name a file" if path.is_dir() else f"there is no {path}"


def _inside(path: Path) -> str:
    """Return which files a folder holds one of which may be meant by it."""
    inside = sorted(file.name for file in path.glob("*.toml"))[:MOST_NAMED]
    return f", and holds {', '.join(inside)}" if inside else ""


def _near(path: Path) -> str:
    """Return the question after a file beside `path` of nearly its name."""
    try:
        return "" if path.exists() else did_you_mean(path.name, [file.name for file in path.parent.iterdir()])
    except OSError:
        return ""
