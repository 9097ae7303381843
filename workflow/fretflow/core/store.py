"""Records in HDF5: one file a record, written whole or not at all.

Arrays have named dimensions, and ``units``, ``long_name`` and flags as attributes after the CF conventions, so that
``xarray.open_dataset(file, engine="h5netcdf")`` shows them as they are.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import Field, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import h5py
import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError, StoreError
from fretflow.core.records import Labelled

T = TypeVar("T")
FORMAT = "fretflow-record/1"
# Names of dimensions by their symbol in the shape of a field; other symbols stand for themselves.
DIMENSIONS = {"N": "sample", "nodes": "node", "contact nodes": "node", "3": "direction", "2": "pair", "K": "row",
              "P": "point", "points": "point", "cells": "cell", "8": "corner", "dofs": "dof", "modes": "mode",
              "d": "coordinate"}
COMPRESSED = 1032  # times: the most that deflate makes of a byte (zlib technical details)
SAMPLED = 2**16  # numbers of an array, by which it is told whether the rest is worth compressing
_SHAPE = re.compile(r"\(([^()]+)\)")
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."  # as netCDF-4 marks such a scale


def write_record(path: Path, record: Any) -> Path:
    """Write `record` to the HDF5 file `path` through a temporary file and a rename.

    A mapping of arrays becomes a group; its arrays carry their units in their names, as the columns of CSV files do.
    What a record derives as ``coordinates``, by name, is written beside its fields and not read again.

    Raises
    ------
    StoreError
        If the file cannot be written (disk full, read-only directory).
    """
    # The file is made in memory: HDF5 that meets a full disk can neither finish nor close its file.
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        file.attrs["format"] = FORMAT
        _write_group(file, record)
        file.flush()
        image = file.id.get_file_image()
    write_whole(path, image)
    return path


@contextmanager
def open_hdf5(path: Path, refusal: type[InputError] = StoreError) -> Iterator[h5py.File]:
    """Open the HDF5 file `path` for reading, provided that all it holds lies in itself.

    Raises
    ------
    InputError
        Of class `refusal`, naming what would be read from another file, or is a mere link.
    OSError
        If the file is no HDF5 or damaged.
    """
    with h5py.File(path, "r") as file:
        try:
            name = _elsewhere(file["/"], (), set())
        except RecursionError as error:
            raise OSError("its groups lie hundreds deep in each other") from error
        except (KeyError, RuntimeError) as error:
            raise OSError(f"damaged links, {error}") from error
        if name is not None:
            raise refusal(f"{path}: {name} is a link or lies in another file; save the data itself in this one")
        yield file


def array_of(item: h5py.Dataset, refusal: type[InputError] = StoreError) -> Any:
    """Return all that a dataset holds.

    Raises
    ------
    InputError
        Of class `refusal`, if nearly nothing of it was ever written: a few kB may claim to hold any size.
    """
    claimed = math.prod(item.shape or ()) * item.dtype.itemsize
    if claimed > COMPRESSED * (item.id.get_storage_size() + 4096):
        raise refusal(f"{item.file.filename}: {item.name}: {claimed / 1e9:.3g} GB of which next to nothing was ever "
                      "written; save it again")
    return item[()]


def unit_of(item: h5py.Dataset) -> str:
    """Return the unit that a dataset states, in the encodings there are; empty where it states none as text."""
    unit = item.attrs.get("unit", item.attrs.get("units", ""))
    if isinstance(unit, bytes):
        try:
            return unit.decode()
        except UnicodeDecodeError:
            return unit.decode("latin-1")
    return unit if isinstance(unit, str) else ""


def _elsewhere(group: h5py.Group, within: tuple[int, ...], seen: set[int]) -> str | None:
    """Return the name of the first item at or below `group` that is not stored there or leads back to it, if any."""
    within = (*within, h5py.h5o.get_info(group.id).addr)
    for name in group:
        if isinstance(name, bytes):
            raise KeyError(f"a name is no UTF-8 text: {name!r}")
        if group.id.links.get_info(name.encode(errors="surrogateescape")).type != h5py.h5l.TYPE_HARD:
            return f"{group.name.rstrip('/')}/{name}"
        item = group[name]
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            return str(item.name)
        if isinstance(item, h5py.Group):
            place = h5py.h5o.get_info(item.id).addr
            if place in within:
                return f"{group.name.rstrip('/')}/{name}"
            if place not in seen and (foreign := _elsewhere(item, within, seen)):
                return foreign
            seen.add(place)
    return None


def write_whole(path: Path, content: bytes) -> None:
    """Write `content` to `path` through a temporary file and a rename.

    Raises
    ------
    StoreError
        If the file cannot be written (disk full, read-only directory).
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.unlink(missing_ok=True)  # also a link that stands there
        with temporary.open("xb") as handle:
            handle.write(content)
            handle.flush()
            os.fsync(handle.fileno())
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        absent = isinstance(error, FileNotFoundError | NotADirectoryError)
        advice = "choose another --out, a folder that is there" if absent else (
            "complete results are kept: free some space or choose another --out, then run again")
        raise StoreError(f"{path}: cannot be written ({error.strerror}); {advice}") from error


def write_csv(path: Path, columns: Mapping[str, Sequence[object] | NDArray[Any]]) -> Path:
    """Write equally long `columns` to the CSV file `path`; a column's name ends in its unit.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
    write_whole(path, text.getvalue().encode())
    return path


def read_record(path: Path, cls: type[T]) -> T:
    """Read a record of class `cls` from the HDF5 file `path`.

    Raises
    ------
    StoreError
        If the file is missing, truncated or holds another kind of record.
    """
    if not path.is_file():
        raise StoreError(f"{path}: no such result file; run the stage that writes it again")
    try:
        with open_hdf5(path) as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("record") != cls.__name__:
                raise StoreError(f"{path}: holds no {cls.__name__} of {FORMAT}; run again with --force")
            return _read_group(file, cls)
    except (OSError, KeyError, RuntimeError) as error:
        raise StoreError(f"{path}: truncated or damaged ({error}); remove it and run again") from error


def _write_group(group: h5py.Group, record: Any) -> None:
    group.attrs["record"] = type(record).__name__
    written: list[tuple[Field[Any], h5py.Dataset]] = []
    for f in fields(record):
        value = getattr(record, f.name)
        if value is None:
            continue
        if is_dataclass(value):
            _write_group(group.create_group(f.name), value)
        elif isinstance(value, Mapping):
            place = group.create_group(f.name)
            written += [(f, _write_dataset(place, name, np.asarray(item))) for name, item in value.items()]
        else:
            written.append((f, _write_dataset(group, f.name, _plain_value(value))))
    for f, dataset in written:
        _describe(f, dataset)
    _name_dimensions(group, written)
    for name, values in getattr(record, "coordinates", {}).items():
        _write_coordinate(group, name, values)


def _describe(f: Field[Any], dataset: h5py.Dataset) -> None:
    for key, attribute in (("unit", "unit"), ("unit", "units"), ("shape", "shape")):
        if f.metadata.get(key):
            dataset.attrs[attribute] = f.metadata[key]
    if codes := f.metadata.get("codes"):
        dataset.attrs["flag_values"] = np.array([int(code) for code in codes], dtype=dataset.dtype)
        dataset.attrs["flag_meanings"] = " ".join(code.name.lower() for code in codes)


def _name_dimensions(group: h5py.Group, written: Sequence[tuple[Field[Any], h5py.Dataset]]) -> None:
    """Attach a dimension scale to each axis, named by the shape of its field, or by the coordinate that it has."""
    owners = {_symbols(f, 1)[0]: f.name for f, _ in written if f.metadata.get("coordinate")}
    for name in owners.values():
        group[name].make_scale(name)
    for f, dataset in written:
        name, symbols = dataset.name.rpartition("/")[2], _symbols(f, dataset.ndim)
        used = {name}
        for axis, size in enumerate(dataset.shape if f.name not in owners.values() else ()):
            scale = owners.get(symbols[axis]) or DIMENSIONS.get(
                symbols[axis], re.sub(r"\W+", "_", symbols[axis]).strip("_"))
            known = scale not in group or (group[scale].attrs.get("CLASS") == b"DIMENSION_SCALE"
                                           and group[scale].shape == (size,))
            if not scale or scale in used or not known:  # a square matrix, or two sizes under one symbol
                scale = f"{name}_{axis}"
            if scale not in group:
                _write_scale(group, scale, size)
            dataset.dims[axis].attach_scale(group[scale])
            used.add(scale)


def _symbols(f: Field[Any], axes: int) -> tuple[str, ...]:
    """Return the symbols of so many axes in the shape of field `f`, such as "(N,) or (N, k)"; empty if not there."""
    for shape in _SHAPE.findall(f.metadata.get("shape", "")):
        symbols = tuple(part.strip() for part in shape.split(",") if part.strip())
        if len(symbols) == axes:
            return symbols
    return ("",) * axes


def _write_scale(group: h5py.Group, name: str, size: int) -> None:
    """Write a dimension: of directions their names, else a netCDF dimension without a variable."""
    if name == "direction" and size == len("xyz"):
        group.create_dataset(name, data=np.array(["x", "y", "z"], dtype=h5py.string_dtype())).make_scale(name)
    else:
        group.create_dataset(name, data=np.zeros(size, dtype=np.float32)).make_scale(f"{_NO_VARIABLE}{size:10d}")


def _write_coordinate(group: h5py.Group, name: str, coordinate: Labelled) -> None:
    """Write what a record derives along a dimension that it has, and name it at the arrays along that dimension."""
    (dimension,), values, unit = coordinate
    arrays = [item for item in group.values() if isinstance(item, h5py.Dataset)
              and any(group[dimension] in axis.values() for axis in item.dims)]
    dataset = _write_dataset(group, name, np.asarray(values))
    dataset.attrs.update({"unit": unit, "units": unit})
    dataset.dims[0].attach_scale(group[dimension])
    for item in arrays:
        item.attrs["coordinates"] = name


def _plain_value(value: Any) -> Any:
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, tuple):
        value = np.asarray(value)
        if value.dtype.kind == "U":
            value = value.astype(h5py.string_dtype())
    return value


def _write_dataset(group: h5py.Group, name: str, value: Any) -> h5py.Dataset:
    compress = isinstance(value, np.ndarray) and value.nbytes > 4096 and _is_worth_compressing(value)
    return group.create_dataset(name, data=value, compression="gzip" if compress else None,
                                compression_opts=1 if compress else None, shuffle=compress)


def _is_worth_compressing(array: NDArray[Any]) -> bool:
    """Tell whether deflate, which takes seven times as long as writing, spares a fifth of an array, by its middle."""
    if array.dtype.kind != "f" or array.size < 2 * SAMPLED:
        return True
    middle = array.ravel(order="K")[(array.size - SAMPLED) // 2:][:SAMPLED]
    shuffled = np.ascontiguousarray(middle).view(np.uint8).reshape(SAMPLED, -1).T
    return len(zlib.compress(shuffled.tobytes(), 1)) < 0.8 * middle.nbytes


def _read_group(group: h5py.Group, cls: type[T]) -> T:
    hints = get_type_hints(cls)
    values: dict[str, Any] = {}
    for f in fields(cls):  # type: ignore[arg-type]
        kind = hints[f.name]
        if f.name not in group:
            if type(None) in get_args(kind):
                values[f.name] = None
            continue
        values[f.name] = _read_value(group[f.name], _plain(kind))
    try:
        return cls(**values)
    except TypeError as error:
        raise StoreError(f"{group.file.filename}: incomplete {cls.__name__} ({error}); run again with --force"
                         ) from error


def _plain(kind: Any) -> Any:
    """Strip ``| None`` from a type hint."""
    options = [k for k in get_args(kind) if k is not type(None)]
    if type(None) in get_args(kind) and len(options) == 1:
        return options[0]
    return kind


def _read_value(item: h5py.Group | h5py.Dataset, kind: Any) -> Any:
    origin = getattr(kind, "__origin__", kind)
    if origin is Mapping:
        return {name: np.asarray(item[name][()]) for name in item}
    if isinstance(item, h5py.Group):
        return _read_group(item, kind)
    value = item[()]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value.decode() if isinstance(value, bytes) else value)
    if origin is tuple:
        return tuple(v.decode() if isinstance(v, bytes) else v.item() for v in np.atleast_1d(value))
    if kind is str:
        return value.decode()
    if kind in (int, float, bool):
        return kind(value)
    return value
