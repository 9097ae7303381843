"""HDF5 files: a dataset of one row of numbers for each column, at the top of the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError
from fretflow.core.store import array_of, open_hdf5, unit_of
from fretflow.recordings.readers.tables import MOST_COLUMNS, Table

SUFFIXES = (".h5", ".hdf5", ".hdf")


def read(path: Path, wanted: Sequence[str] | None = None) -> Table:
    """Read the `wanted` datasets, by default all at the top of the file.

    Raises
    ------
    UnsupportedRecordingError
        If one is not there or no row of numbers.
    CorruptRecordingError
        If they are of several lengths, or empty.
    """
    columns, units = {}, {}
    with open_hdf5(path, UnsupportedRecordingError) as file:
        if wanted is None and len(file) > MOST_COLUMNS:
            raise UnsupportedRecordingError(f"{path}: holds {len(file):,} items, and at most {MOST_COLUMNS:,} columns "
                                            "are read; save the channels alone")
        there = [name for name, item in file.items() if _is_row(item)]
        for name in there if wanted is None else wanted:
            item = file.get(name)
            if not _is_row(item) or item.dtype.kind not in "fiub":
                raise UnsupportedRecordingError(f"{path}: {name!r} is no dataset of one row of numbers; at the top "
                                                f"of the file there are {', '.join(there) or 'none'}")
            columns[name] = np.ravel(np.asarray(array_of(item, CorruptRecordingError), dtype=float))
            units[name] = unit_of(item)
    if len({len(column) for column in columns.values()}) != 1 or not len(next(iter(columns.values()), ())):
        lengths = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        raise CorruptRecordingError(f"{path}: its datasets must be of one length above zero, got {lengths or 'none'}; "
                                    "export it again")
    return Table(path, columns, {name: unit for name, unit in units.items() if unit})


def _is_row(item: h5py.Dataset | h5py.Group | None) -> bool:
    """Tell whether an item is one row of numbers, or a column, as MATLAB writes it."""
    return isinstance(item, h5py.Dataset) and (item.ndim == 1 or (item.ndim == 2 and 1 in item.shape))
