"""Structures in files: ``.npz``, HDF5, MATLAB (5 and 7.3), or a folder of Matrix Market files.

Names are those of DESIGN section 8: `M`, `K`, `contact_map` and `areas` are required. Sparse matrices are, besides what
MATLAB and Matrix Market have, groups of `data`, `indices`, `indptr` and `shape` (compressed rows). Named inputs and
outputs are a group or structure with a row each, or an array of rows beside `input_names` and `output_names`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import h5py
import numpy as np
from scipy import sparse
from scipy.io import mmread

from fretflow.core.errors import CorruptRecordingError, InputError, UnsupportedRecordingError
from fretflow.core.records import Array
from fretflow.core.store import array_of, open_hdf5, unit_of
from fretflow.core.units import parse_quantity
from fretflow.recordings.readers.hdf5 import SUFFIXES as HDF5
from fretflow.recordings.readers.matlab import SUFFIXES as MATLAB
from fretflow.recordings.readers.matlab import load_matlab
from fretflow.structure.matrices import StructureMatrices, check_force_map

MATRIX_MARKET = ".mtx"
NUMPY = ".npz"
ROW_ORDER = ("data", "indices", "indptr", "shape")  # of a sparse matrix in compressed rows
MATLAB_ORDER = ("data", "ir", "jc")  # of MATLAB 7.3, in compressed columns
UNITS = {"M": "kg", "K": "N/m", "C": "N*s/m", "areas": "m^2", "points": "m", "gap": "m"}
REQUIRED = ("M", "K", "contact_map", "areas")
OPTIONAL = ("C", "modal_damping", "force_map", "points", "preload", "gap")
NAMED = {"inputs": "input_names", "outputs": "output_names"}


def read_structure(path: Path) -> StructureMatrices:
    """Read a structure's matrices; the file says which form it has by its suffix, a folder is of Matrix Market files.

    Raises
    ------
    CorruptRecordingError
        If the file is missing, cut off or damaged.
    UnsupportedRecordingError
        If its form is not known.
    InputError
        Naming file and array: missing, of another shape, not symmetric, dependent.
    """
    try:
        content = _content(path)
        # m beside M is another variable, such as the number of contact points
        held = {name if _key(name) in content else _key(name): value for name, value in content.items()}
    except (OSError, ValueError, BadZipFile, EOFError, KeyError, MemoryError) as error:
        raise CorruptRecordingError(f"{path}: is no whole file of matrices ({error}); save it again") from error
    for name in REQUIRED:
        if name not in held:
            raise InputError(f"{path}: has no {name}; it has {', '.join(sorted(held)) or 'nothing'}, and needs "
                             f"{', '.join(REQUIRED)}")
    try:
        return _structure(held)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _key(name: str) -> str:
    """Return a name as it is known: ``k`` for K is too, ``inputs`` in any case of letters."""
    known = {one.lower(): one for one in (*REQUIRED, *OPTIONAL, *NAMED, *NAMED.values())}
    return known.get(name.lower(), name)


def _structure(held: Mapping[str, Any]) -> StructureMatrices:
    values = {name: _matrix(held[name], name) for name in (*REQUIRED, *OPTIONAL) if name in held}
    for name in ("M", "K", "contact_map"):
        if values[name].ndim != 2:
            raise InputError(f"{name}: is no matrix, it has the shape {values[name].shape}")
    size, areas = values["M"].shape[0], _vector(values["areas"])
    if "force_map" in values:
        check_force_map(values["force_map"], values["contact_map"])
    damping = _vector(values.get("modal_damping", np.zeros(0)))
    if len(damping) > 1 and np.ptp(damping) > 0.0:
        raise InputError("modal_damping: must be one ratio for all modes; give C where they differ")
    points = _dense(values.get("points", np.zeros((len(areas), 3))))
    return StructureMatrices(
        mass=values["M"], stiffness=values["K"], damping=values.get("C"),
        modal_damping=float(damping[0]) if len(damping) else None, contact_map=values["contact_map"], areas=areas,
        points=points.reshape(-1, 3) if points.ndim == 1 and points.size % 3 == 0 else points,
        preload=_vector(values["preload"]) if "preload" in values else None,
        gap=_vector(values["gap"]) if "gap" in values else None,
        **{name: _rows(held.get(name), held.get(names), size, name) for name, names in NAMED.items()})


def _rows(held: Any, names: Any, size: int, kind: str) -> dict[str, Array]:
    """Return named rows of `size` numbers: a mapping, or an array (rows, size) with or without names."""
    if held is None:
        return {}
    if not isinstance(held, Mapping) and hasattr(held, "_fieldnames"):  # a structure of MATLAB 5
        held = {name: getattr(held, name) for name in held._fieldnames}
    if isinstance(held, Mapping):
        return {str(name): _vector(_matrix(row, f"{kind}: {name}")) for name, row in held.items()}
    rows = np.atleast_2d(_dense(_matrix(held, kind)))
    rows = rows.T if rows.shape[0] == size != rows.shape[1] else rows
    labels = [str(k + 1) for k in range(len(rows))] if names is None else [
        one.decode() if isinstance(one, bytes) else str(one).strip() for one in np.ravel(np.array(names, dtype=object))]
    if len(labels) != len(rows):
        raise InputError(f"{kind}: {len(rows)} rows but {len(labels)} names in {NAMED[kind]}")
    return dict(zip(labels, rows, strict=True))


def _matrix(held: Any, name: str) -> Any:
    """Return numbers, dense or sparse, in SI."""
    factor = 1.0
    if isinstance(held, tuple):  # with the unit that the file states
        held, unit = held
        try:
            factor = parse_quantity(f"1 {unit}", UNITS[name]) if name in UNITS else 0.01 if unit == "%" else 1.0
        except ValueError as error:
            raise InputError(f"{name}: its unit {unit!r} is none like {UNITS[name]}; matrices are in SI") from error
    if sparse.issparse(held):
        made = held
    elif isinstance(held, Mapping) and (set(ROW_ORDER) <= set(held) or MATLAB_ORDER[-1] in held):
        try:
            made = _sparse(held)
        except (ValueError, TypeError) as error:
            raise InputError(f"{name}: is no whole sparse matrix ({error}); save it again") from error
    else:
        made = _plain(held)
        if np.asarray(made).dtype.kind not in "fiub":
            raise InputError(f"{name}: holds no real numbers")
        made = np.asarray(made, dtype=float)
    return made if factor == 1.0 else made * factor


def _sparse(held: Mapping[str, Any]) -> Any:
    """Return a sparse matrix by its compressed rows, or as MATLAB 7.3 has it: without entries it has `jc` alone."""
    if set(ROW_ORDER) <= set(held):
        shape = tuple(int(one) for one in np.ravel(_plain(held["shape"])))
        return sparse.csr_matrix(tuple(np.ravel(_plain(held[key])) for key in ROW_ORDER[:3]), shape=shape)
    data, rows, starts = (np.ravel(_plain(held.get(key, np.zeros(0)))) for key in MATLAB_ORDER)
    tall = held.get("rows")
    return sparse.csc_matrix((data, rows.astype(np.int64), starts),
                             shape=None if tall is None else (int(tall), len(starts) - 1))


def _plain(held: Any) -> Any:
    return held[0] if isinstance(held, tuple) else held


def _dense(values: Any) -> Array:
    return np.asarray(values.todense() if sparse.issparse(values) else values, dtype=float)


def _vector(values: Any) -> Array:
    return _dense(values).ravel()


def _content(path: Path) -> dict[str, Any]:
    """Return what a file holds by name: arrays, sparse matrices, mappings of them, or pairs with a unit."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix == MATRIX_MARKET:
        folder = path if path.is_dir() else path.parent
        return _grouped({file.stem: mmread(file) for file in sorted(folder.glob(f"*{MATRIX_MARKET}"))})
    if not path.is_file():
        raise CorruptRecordingError(f"{path}: there is no such file; a path counts from the folder of recording.toml")
    if suffix == NUMPY:
        with path.open("rb") as whole, np.load(whole, allow_pickle=False) as file:
            return _grouped({name: file[name] for name in file.files})
    if suffix in HDF5:
        with open_hdf5(path, UnsupportedRecordingError) as file:
            return _of_hdf5(file)
    if suffix in MATLAB:
        return load_matlab(path)
    raise UnsupportedRecordingError(f"{path}: matrices are read from {NUMPY}, {' '.join((*HDF5, *MATLAB))} or a folder "
                                    f"of {MATRIX_MARKET} files")


def _grouped(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return flat names such as ``K.data`` and ``outputs/tip`` as mappings."""
    grouped: dict[str, Any] = {}
    for name, value in flat.items():
        mark = next((one for one in "/." if one in name), None)
        group, _, own = name.partition(mark) if mark else ("", "", name)
        if group:
            grouped.setdefault(group, {})[own] = value
        else:
            grouped[name] = value
    return grouped


def _of_hdf5(group: h5py.Group) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            entries[name] = _of_hdf5(item)
            if "shape" in item.attrs:
                entries[name]["shape"] = item.attrs["shape"]
            continue
        value, unit = array_of(item, CorruptRecordingError), unit_of(item)
        entries[name] = (value, unit) if unit else value
    return entries
