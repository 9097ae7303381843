"""Hysteresis loops in MATLAB files: an N x 2 array of displacement and force for each cycle count.

Rigs exchange them as structures of many shapes: a field a loop, a structure array, a cell array beside a list of
cycle counts, or two vectors a loop. Each pair of columns that is found is one loop; its cycle count is a number
beside it, or the number in the name of a field on the way to it, or else its place.
"""

from __future__ import annotations

import itertools
import re
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from struct import error as StructError
from struct import unpack_from
from typing import Any

import h5py
import numpy as np

from fretflow.core.errors import CorruptRecordingError, UnsupportedRecordingError
from fretflow.core.records import Array
from fretflow.core.store import array_of, open_hdf5
from fretflow.recordings.notes import Note
from fretflow.recordings.readers.tables import Table

SUFFIXES = (".mat",)
SHORTEST = 8  # samples of a loop
MOST_ITEMS = 20_000  # cells and fields of a file
DEEPEST = 200  # cells in each other
MATRIX, COMPRESSED = 14, 15  # kinds of elements, "MAT-File Format", table 1-1
DIMENSIONS, SPARSE = 5, 5  # kind of the element that holds the dimensions; class of arrays that leave zeros out
MOST_DIMENSIONS = 32  # of NumPy
MOST_EMPTY = 1000  # items of an array that may have no fields
KINDS = frozenset((*range(1, 8), 9, *range(12, 19)))
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

    Where all `wanted` columns are variables, vectors of one length, they are the table.

    Raises
    ------
    CorruptRecordingError
        If the file is cut off or damaged.
    UnsupportedRecordingError
        If no loops are found in it.
    """
    content = load_matlab(path)
    if wanted and (columns := _columns(content, wanted)):
        return Table(path, columns)
    loops = list(_loops(content, ""))
    if not loops:
        raise UnsupportedRecordingError(f"{path}: no N x 2 array of displacement and force found in it; save one for "
                                        "each cycle count")
    notes: tuple[Note, ...] = ()
    counts = [loop.cycle for loop in loops]
    if None in counts:
        counts = [float(place) for place in range(len(loops))]
        if len(loops) > 1:
            notes = (Note(path.name, f"cycle counts are not told; the {len(loops)} loops count from 0 in their order"),)
    seen: defaultdict[float | None, Iterator[int]] = defaultdict(itertools.count)
    sizes = [len(loop.samples) for loop in loops]
    columns = {name: np.repeat(np.array(values, dtype=float), sizes) for name, values in (
        ("cycle", counts), ("repeat", [next(seen[count]) for count in counts]))}
    samples = np.concatenate([loop.samples for loop in loops]).T.copy()
    return Table(path, columns | dict(zip(("displacement", "force"), samples, strict=True)), notes=notes)


def _columns(content: Mapping[str, Any], wanted: Sequence[str]) -> dict[str, Array]:
    """Return the wanted variables if they are vectors of one length, else none."""
    vectors = {name: np.ravel(content[name]) for name in wanted if _is_numeric(content.get(name))
               and content[name].size == max(content[name].shape, default=0) > 1}
    alike = len(vectors) == len(set(wanted)) and len({len(values) for values in vectors.values()}) == 1
    return {name: np.asarray(values, dtype=float) for name, values in vectors.items()} if alike else {}


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
        _check_elements(path)
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # version 7.3 is HDF5
        with open_hdf5(path, UnsupportedRecordingError) as file:
            items = _Items(file)
            content = {name: items.read(item) for name, item in file.items() if not name.startswith("#")}
    except (MatReadError, ValueError, TypeError, EOFError, LookupError, NameError, AttributeError, OverflowError,
            zlib.error, StructError) as error:
        raise CorruptRecordingError(f"{path}: is no whole MATLAB file ({error}); save it again") from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _check_elements(path: Path) -> None:
    """Refuse a file of versions 5 to 7 with cells in cells by the thousand, or unknown elements, which end SciPy."""
    with path.open("rb") as file:
        order = {b"\0\1IM": "<", b"\1\0MI": ">"}.get(file.read(128)[124:])
        content = b"" if order is None else file.read()
    if order is not None and _depth(content, order) > DEEPEST:
        raise CorruptRecordingError(f"{path}: its cells or structures lie hundreds deep in each other; save the loops "
                                    "alone")


def _depth(content: bytes, order: str, packed: bool = False) -> int:
    """Return how deep arrays lie in each other, of the elements (kind, size, content) in a file or `packed` in one."""
    at, ends, deepest = 0, [0], 0
    while at + 8 <= len(content) and deepest <= DEEPEST:
        kind, size = unpack_from(f"{order}II", content, at)
        at += 8
        while len(ends) > 1 and at > ends[-1]:
            ends.pop()
        if (kind & 0xFFFF) not in KINDS and (kind or size):
            raise ValueError(f"an element at byte {at:,} is of kind {kind}, which there is not")
        if kind < 1 << 16 and at + size > len(content):
            raise ValueError(f"cut off within the {size:,} bytes of an element")
        if kind == MATRIX:
            _check_size(content[at:at + 16 + 4 * MOST_DIMENSIONS], size, order)
            ends.append(at + size)
            deepest = max(deepest, len(ends) - 1)
        elif kind == COMPRESSED and not packed:
            deepest = max(deepest, _depth(zlib.decompress(content[at:at + size]), order, packed=True))
            at += size
        elif kind < 1 << 16:  # others hold their few bytes in place of the size
            at += size + -size % 8
    return deepest


def _check_size(head: bytes, size: int, order: str) -> None:
    """Refuse an array whose `head`, flags and dimensions, claims more items than its `size` in bytes holds."""
    if len(head) < 32:
        return
    (flags,), (kind, count) = unpack_from(f"{order}I", head, 8), unpack_from(f"{order}II", head, 16)
    if flags & 0xFF == SPARSE or kind & 0xFFFF != DIMENSIONS:
        return
    claimed = abs(count) if kind >> 16 else prod(map(abs, unpack_from(f"{order}{min(count, len(head) - 24) // 4}i",
                                                                     head, 24)))
    if claimed > max(MOST_EMPTY, size):
        raise ValueError(f"an array of {claimed:,} items in {size:,} bytes")


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
            rows = np.ravel(item.attrs.get("MATLAB_sparse", ()))
            tall = {"rows": int(rows[0])} if rows.size == 1 and rows.dtype.kind in "iu" else {}
            return {name: self.read(child, within) for name, child in item.items()} | tall
        values = array_of(item, CorruptRecordingError)
        if item.attrs.get("MATLAB_class") == b"char":
            letters = np.ravel(values) if np.asarray(values).dtype.kind == "u" else np.zeros(0)
            return letters.astype("<u2").tobytes().decode("utf-16-le", errors="replace")
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
    node = _plain(node)
    if isinstance(node, list):
        for place, item in enumerate(node):
            yield from _loops(item, f"{name}({place + 1})", cycle)
        return
    fields = {key.lower(): _plain(value) for key, value in node.items()} if isinstance(node, dict) else {}
    counts = next((np.ravel(fields[key]) for key in COUNTS if _is_numeric(fields.get(key))), np.zeros(0))
    own = float(counts[0]) if len(counts) == 1 else cycle
    if (samples := _samples(fields or node)) is not None:
        yield FoundLoop(name, samples, own if own is not None else _count_in_name(name))
        return
    for key in node if fields else ():
        items, here = _plain(node[key]), f"{name}.{key}" if name else key
        if isinstance(items, list) and len(items) == len(counts) > 1:
            for count, item in zip(counts, items, strict=True):
                yield from _loops(item, here, float(count))
        else:
            yield from _loops(items, here, own)


def _plain(node: Any) -> Any:
    """Return what MATLAB holds as a dict of fields, a list of cells, structures or pages (N x 2 x K), or an array."""
    if (names := getattr(node, "_fieldnames", None)) is not None:
        return {name: getattr(node, name) for name in names}
    if isinstance(node, dict):  # a structure array of version 7.3 is a dict of equally long lists
        lengths = {len(value) if isinstance(value, list) else 0 for value in node.values()}
        alike = len(lengths) == 1 and lengths != {0}
        return [dict(zip(node, values, strict=True)) for values in zip(*node.values(), strict=True)] if alike else node
    if isinstance(node, list):
        return node
    node = np.asarray(node)
    if node.dtype == object:
        return list(np.ravel(node))
    return list(np.moveaxis(node, 2, 0)) if node.ndim == 3 and _is_numeric(node) else node


def _is_numeric(node: Any) -> bool:
    return isinstance(node, np.ndarray) and node.dtype.kind in "fiu"


def _samples(node: Any) -> Array | None:
    """Return the loop (N, 2) that an array is, or that two fields of a structure hold, if they do."""
    if isinstance(node, dict):
        pair = [[node[name] for name in names] for names in PAIRS if all(_is_numeric(node.get(name)) for name in names)]
        if not pair or pair[0][0].size != pair[0][1].size:
            return None
        node = np.column_stack([np.ravel(values) for values in pair[0]])
    if not _is_numeric(node) or node.ndim != 2 or 2 not in node.shape:
        return None
    samples = node if node.shape[1] == 2 else node.T
    return np.asarray(samples, dtype=float) if len(samples) >= SHORTEST else None


def _count_in_name(name: str) -> float | None:
    """Return the number that the innermost numbered field on the way carries: ``cycle_2e4``, ``N10k``."""
    for part in reversed(re.sub(r"\(\d+\)", "", name).split(".")):
        if numbers := _NUMBER_IN_NAME.findall(part):
            number, multiple = numbers[-1]
            return float(number.replace("p", ".")) * _MULTIPLES[multiple.lower()]
    return None
