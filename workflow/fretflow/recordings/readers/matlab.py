"""Hysteresis loops in MATLAB files: an N x 2 array of displacement and force for each cycle count.

Rigs exchange them as structures of many shapes: a field a loop, a structure array, a cell array beside a list of
cycle counts, or two vectors a loop. Each pair of columns that is found is one loop; its cycle count is a number
beside it, or the number in the name of a field on the way to it, or else its place.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError
from fretflow.core.store import array_of, open_hdf5
from fretflow.recordings.notes import Note
from fretflow.recordings.readers.tables import Array, Table

SUFFIXES = (".mat",)
SHORTEST = 8  # samples of a loop
MOST_ITEMS = 20_000  # cells and fields of a file
COUNTS = ("cycle", "cycles", "cycle_count", "cyclecount", "n_cycles", "ncycles", "num_cycles", "numcycles")
PAIRS = (("displacement", "force"), ("displacement", "friction_force"), ("disp", "force"), ("x", "f"), ("u", "f"),
         ("d", "f"), ("delta", "q"), ("displacement", "friction"))
_NUMBER_IN_NAME = re.compile(r"(\d+(?:p\d+)?(?:e\d+)?)(k|m)?(?![a-z0-9])", re.IGNORECASE)
_MULTIPLES = {"": 1.0, "k": 1e3, "m": 1e6}


@dataclass(frozen=True)
class FoundLoop:
    """A loop in a MATLAB file: where, its two columns (N, 2), and its cycle count if the file tells."""

    name: str
    samples: Array
    cycle: float | None


def read(path: Path, wanted: Sequence[str] | None = None) -> Table:
    """Read all loops of a MATLAB file (versions 5 to 7.3) as one table: cycle, repeat, displacement, force.

    Raises
    ------
    CorruptRecordingError
        If the file is cut off or damaged.
    UnsupportedRecordingError
        If no loops are found in it.
    """
    found = list(_loops(load_matlab(path), ""))
    if not found:
        raise UnsupportedRecordingError(f"{path}: no N x 2 array of displacement and force found in it; save one for "
                                        "each cycle count")
    notes: tuple[Note, ...] = ()
    counts = [loop.cycle for loop in found]
    if None in counts:
        counts = [float(place) for place in range(len(found))]
        if len(found) > 1:
            notes = (Note(path.name, f"cycle counts are not told; the {len(found)} loops count from 0 in their order"),)
    seen: dict[float, int] = {}
    repeats = []
    for count in counts:
        repeats.append(seen.setdefault(count or 0.0, 0))
        seen[count or 0.0] += 1
    sizes = [len(loop.samples) for loop in found]
    samples = np.concatenate([loop.samples for loop in found])
    columns = {"cycle": np.repeat(np.array(counts, dtype=float), sizes),
               "repeat": np.repeat(np.array(repeats, dtype=float), sizes),
               "displacement": samples[:, 0].copy(), "force": samples[:, 1].copy()}
    return Table(path, columns, notes=notes)


def load_matlab(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file (versions 5 to 7.3); a sparse matrix of 7.3 as its columns and its `rows`.

    Raises
    ------
    CorruptRecordingError
        If the file is cut off or damaged.
    """
    from scipy.io import loadmat  # here, as readers of other forms need none of SciPy
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # version 7.3 is HDF5
        with open_hdf5(path, UnsupportedRecordingError) as file:
            items = _Items(file)
            content = {name: items.read(item) for name, item in file.items() if not name.startswith("#")}
    except (MatReadError, ValueError, TypeError, EOFError, KeyError, IndexError, zlib.error) as error:
        raise CorruptRecordingError(f"{path}: is no whole MATLAB file ({error}); save it again") from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


class _Items:
    """The items of a version 7.3 file as dicts, lists and arrays as MATLAB shows them."""

    def __init__(self, file: h5py.File) -> None:
        self._file, self._read = file, 0

    def read(self, item: h5py.Group | h5py.Dataset, within: tuple[int, ...] = ()) -> Any:
        """Return an item that lies in others, by their addresses.

        Raises
        ------
        CorruptRecordingError
            If it refers to itself or to nothing.
        UnsupportedRecordingError
            If references make too many of it.
        """
        self._read += 1
        address = h5py.h5o.get_info(item.id).addr
        if address in within:
            raise CorruptRecordingError(f"{self._file.filename}: {item.name} refers to itself; save it again")
        if self._read > MOST_ITEMS:
            raise UnsupportedRecordingError(f"{self._file.filename}: more than {MOST_ITEMS:,} cells and fields; save "
                                            "the loops alone")
        within = (*within, address)
        if isinstance(item, h5py.Group):
            tall = {"rows": int(item.attrs["MATLAB_sparse"])} if "MATLAB_sparse" in item.attrs else {}
            return {name: self.read(child, within) for name, child in item.items()} | tall
        values = array_of(item, CorruptRecordingError)
        if item.attrs.get("MATLAB_class") == b"char":
            return "".join(map(chr, np.ravel(values)))
        if item.dtype == h5py.ref_dtype:
            return [self.read(self._behind(reference), within) for reference in np.ravel(values.T)]
        return np.squeeze(np.asarray(values).T)

    def _behind(self, reference: h5py.Reference) -> h5py.Group | h5py.Dataset:
        try:
            return self._file[reference]
        except (KeyError, ValueError) as error:
            raise CorruptRecordingError(f"{self._file.filename}: a cell refers to nothing ({error}); save it again"
                                        ) from error


def _loops(node: Any, name: str, cycle: float | None = None) -> Iterator[FoundLoop]:
    """Yield the loops at and below `node`; `cycle` is the count that holds for it from outside."""
    fields = _fields(node)
    if fields is not None:
        yield from _loops_of_fields(fields, name, cycle)
    elif (items := _items(node)) is not None:
        for place, item in enumerate(items):
            yield from _loops(item, f"{name}({place + 1})", cycle)
    elif (samples := _as_samples(node)) is not None:
        yield FoundLoop(name, samples, cycle if cycle is not None else _count_in_name(name))


def _loops_of_fields(fields: dict[str, Any], name: str, cycle: float | None) -> Iterator[FoundLoop]:
    lower = {key.lower(): value for key, value in fields.items()}
    counts = next((np.ravel(lower[key]) for key in COUNTS if key in lower and _is_numeric(lower[key])), None)
    own = float(counts[0]) if counts is not None and len(counts) == 1 else cycle
    if (pair := next((p for p in PAIRS if p[0] in lower and p[1] in lower), None)) is not None:
        values = [np.ravel(lower[key]) if _is_numeric(lower[key]) else np.zeros(0) for key in pair]
        if len(values[0]) == len(values[1]) >= SHORTEST:
            samples = np.column_stack(values).astype(float)
            yield FoundLoop(name, samples, own if own is not None else _count_in_name(name))
            return
    for key, value in fields.items():
        items = _items(value)
        here = f"{name}.{key}" if name else key
        if counts is not None and items is not None and len(items) == len(counts) > 1:
            for count, item in zip(counts, items, strict=True):
                yield from _loops(item, here, float(count))
        else:
            yield from _loops(value, here, own)


def _fields(node: Any) -> dict[str, Any] | None:
    if isinstance(node, dict):
        return _structure_array(node)
    names = getattr(node, "_fieldnames", None)
    return None if names is None else {name: getattr(node, name) for name in names}


def _structure_array(node: dict[str, Any]) -> dict[str, Any]:
    """Turn a structure array of version 7.3, a dict of equally long lists, into one structure an element."""
    lengths = {len(value) if isinstance(value, list) else 0 for value in node.values()}
    if len(lengths) != 1 or lengths == {0}:
        return node
    return {"": [dict(zip(node, values, strict=True)) for values in zip(*node.values(), strict=True)]}


def _items(node: Any) -> list[Any] | None:
    """Return the elements of a cell or structure array, or the pages of an N x 2 x K array."""
    if isinstance(node, list):
        return node
    if isinstance(node, np.ndarray) and node.dtype == object:
        return list(np.ravel(node))
    if isinstance(node, np.ndarray) and node.ndim == 3 and _is_numeric(node):
        return list(np.moveaxis(node, 2, 0))
    return None


def _is_numeric(node: Any) -> bool:
    return np.asarray(node).dtype.kind in "fiu"


def _as_samples(node: Any) -> Array | None:
    values: NDArray[Any] = np.asarray(node)
    if values.dtype.kind not in "fiu" or values.ndim != 2 or 2 not in values.shape:
        return None
    values = values if values.shape[1] == 2 else values.T
    return values.astype(float) if len(values) >= SHORTEST else None


def _count_in_name(name: str) -> float | None:
    """Return the number that the innermost numbered field on the way carries: ``cycle_2e4``, ``N10k``."""
    for part in reversed(re.sub(r"\(\d+\)", "", name).split(".")):
        if numbers := _NUMBER_IN_NAME.findall(part):
            number, multiple = numbers[-1]
            return float(number.replace("p", ".")) * _MULTIPLES[multiple.lower()]
    return None
