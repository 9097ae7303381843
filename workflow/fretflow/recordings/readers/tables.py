"""Files of numbers as columns: each file of this room that has ``SUFFIXES`` and ``read`` reads one form of them."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import fretflow.recordings.readers as room
from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError, did_you_mean
from fretflow.core.records import Array
from fretflow.recordings.notes import Note

MOST_COLUMNS = 1000


@dataclass(frozen=True)
class Table:
    """Equally long columns of a file, as they stand there; nan where a cell is empty."""

    path: Path
    columns: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)  # that the file itself states for a column
    notes: tuple[Note, ...] = ()

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values())))

    def column(self, name: str | int) -> tuple[str, Array]:
        """Return the heading and the values of a column, by its heading or by its place counted from 1.

        Raises
        ------
        UnsupportedRecordingError
            If there is none, naming those that there are.
        """
        if isinstance(name, int) or (name not in self.columns and name.isdigit()):
            place = int(name)
            if 1 <= place <= len(self.columns):
                return list(self.columns.items())[place - 1]
        elif name in self.columns:
            return name, self.columns[name]
        raise UnsupportedRecordingError(f"{self.path}: has no column {name!r}; it has {', '.join(self.columns)}"
                                        f"{did_you_mean(str(name), self.columns)}")


class Reader(Protocol):
    """A module that reads one form of files."""

    SUFFIXES: tuple[str, ...]

    def read(self, path: Path, wanted: Sequence[str] | None) -> Table:
        """Return the columns of the file at `path`: at least those `wanted`, by default all.

        Raises
        ------
        RecordingError
            If the file cannot be used, naming the row where there is one.
        OSError
            If it cannot be opened.
        """
        ...


@cache
def readers() -> Mapping[str, Reader]:
    """Return the readers by the suffix of their files."""
    modules = [importlib.import_module(f"{room.__name__}.{info.name}") for info in pkgutil.iter_modules(room.__path__)]
    return MappingProxyType({suffix: module for module in modules for suffix in getattr(module, "SUFFIXES", ())})


def read_table(path: Path, wanted: Sequence[str] | None = None) -> Table:
    """Read the file at `path`; of HDF5 only the `wanted` datasets, by default all at its top.

    Raises
    ------
    UnsupportedRecordingError
        If the form of the file is not known or a wanted dataset is not there.
    CorruptRecordingError
        If the file is missing, cut off or damaged, naming the row where there is one.
    """
    if not path.is_file():
        raise CorruptRecordingError(f"{path}: " + (
            "is no file; name one of loops" if path.exists() else
            "there is no such file; a path counts from the folder of recording.toml"))
    reader = readers().get(path.suffix.lower())
    if reader is None:
        raise UnsupportedRecordingError(f"{path}: a file {path.suffix.lower() or 'without a suffix'} is not read; give "
                                        f"one of {' '.join(readers())}")
    try:
        return reader.read(path, wanted)
    except RecursionError as error:
        raise CorruptRecordingError(f"{path}: its items lie hundreds deep in each other; export it again") from error
    except UnicodeDecodeError as error:
        raise CorruptRecordingError(f"{path}: byte {error.start + 1:,} of a part of it is no {error.encoding} text; "
                                    "export it again") from error
    except OSError as error:
        raise CorruptRecordingError(f"{path}: cannot be read ({error.strerror or error}); export it again") from error
    except MemoryError as error:
        raise UnsupportedRecordingError(f"{path}: does not fit into memory ({error}); give a part of it") from error
