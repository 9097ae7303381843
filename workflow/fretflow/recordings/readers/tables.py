"""Files of numbers as columns, whatever their form: text, HDF5 or MATLAB."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError
from fretflow.core.store import open_hdf5
from fretflow.recordings.notes import Note

Array = NDArray[np.float64]

TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc", ".prn")
HDF5 = (".h5", ".hdf5", ".hdf")
MATLAB = (".mat",)


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
        raise UnsupportedRecordingError(f"{self.path}: has no column {name!r}; it has {', '.join(self.columns)}")


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
        raise CorruptRecordingError(f"{path}: there is no such file; a path counts from the folder of recording.toml")
    suffix = path.suffix.lower()
    try:
        if suffix in TEXT:
            from fretflow.recordings.readers.delimited import read_delimited

            return read_delimited(path)
        if suffix in HDF5:
            return _read_hdf5(path, wanted)
        if suffix in MATLAB:
            from fretflow.recordings.readers.matlab import read_matlab

            return read_matlab(path)
    except OSError as error:
        raise CorruptRecordingError(f"{path}: cannot be read ({error.strerror or error}); export it again") from error
    raise UnsupportedRecordingError(
        f"{path}: a file {suffix or 'without a suffix'} is not read; give one of {' '.join(TEXT + HDF5 + MATLAB)}")


def _read_hdf5(path: Path, wanted: Sequence[str] | None) -> Table:
    columns, units = {}, {}
    with open_hdf5(path, UnsupportedRecordingError) as file:
        there = [name for name, item in file.items() if isinstance(item, h5py.Dataset) and item.ndim == 1]
        for name in there if wanted is None else wanted:
            item = file.get(name)
            if not isinstance(item, h5py.Dataset) or item.ndim != 1 or item.dtype.kind not in "fiub":
                raise UnsupportedRecordingError(f"{path}: {name!r} is no dataset of one row of numbers; at the top "
                                                f"of the file there are {', '.join(there) or 'none'}")
            columns[name] = np.asarray(item[()], dtype=float)
            unit = item.attrs.get("unit", item.attrs.get("units", ""))
            units[name] = unit.decode() if isinstance(unit, bytes) else str(unit)
    if len({len(column) for column in columns.values()}) != 1 or not len(next(iter(columns.values()), ())):
        lengths = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        raise CorruptRecordingError(f"{path}: its datasets must be of one length above zero, got {lengths or 'none'}; "
                                    "export it again")
    return Table(path, columns, {name: unit for name, unit in units.items() if unit})
