"""Files that users give: opened only where they are files, and refused in one line where they are no such file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from fretflow.core.errors import InputError

LARGEST = 10**7  # bytes of a case file or a recording.toml, which are some kB


def read_toml(path: Path, refusal: type[InputError], way_out: str) -> dict[str, Any]:
    """Return the content of the TOML file `path`.

    Raises
    ------
    InputError
        Of class `refusal`, naming why it cannot be read, and the `way_out` where there is no such file.
    """
    try:
        if path.exists() and not path.is_dir() and not path.is_file():
            raise refusal(f"{path}: is no file but a pipe or a device; {way_out}")
        if path.is_file() and path.stat().st_size > LARGEST:
            raise refusal(f"{path}: {path.stat().st_size / 1e6:.0f} MB are no file of keys and values; {way_out}")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise refusal(f"{path}: cannot be read ({error.strerror}); {way_out}") from error
    except RecursionError as error:
        raise refusal(f"{path}: its tables or arrays lie hundreds deep in each other; {way_out}") from error
    except ValueError as error:  # no TOML, no UTF-8, thousands of digits, a null character in the path
        raise refusal(f"{path}: not valid TOML: {str(error).partition(';')[0]}") from error
