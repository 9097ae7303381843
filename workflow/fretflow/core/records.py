"""Frozen records: results that cannot change after they were made.

A record is a frozen dataclass whose arrays, also those in mappings, are read-only. Each field that is a physical
quantity carries its unit, and `core.store` writes any record to HDF5 with those units.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import IntEnum
from numbers import Number
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

T = TypeVar("T")
Array = NDArray[np.float64]  # of numbers, whatever their unit and shape
Labelled = tuple[tuple[str, ...], Any, str]  # dimensions, values, unit
_PLAIN = frozenset({float, int, bool, str, tuple, type(None)})  # most fields; told at once


def quantity(unit: str, shape: str = "", *, coordinate: bool = False, codes: type[IntEnum] | None = None,
             **kwargs: Any) -> Any:
    """Declare a record field with its unit and, for arrays, its shape in words such as ``"(nodes, 3), of the upper"``.

    Result files name an array's dimensions by its shape. A one-dimensional `coordinate` gives its own name to its
    dimension, along which it tells the others apart; `codes` say what integers mean.
    """
    return field(metadata={"unit": unit, "shape": shape, "coordinate": coordinate, "codes": codes}, **kwargs)


def _freeze_arrays(self: Any) -> None:
    for name, value in tuple(vars(self).items()):
        if type(value) in _PLAIN:
            continue
        if isinstance(value, np.ndarray):
            object.__setattr__(self, name, _frozen(value))
        elif isinstance(value, Mapping):
            held = {key: _frozen(item) if isinstance(item, np.ndarray) else item for key, item in value.items()}
            object.__setattr__(self, name, held)


def _frozen(value: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if value.base is not None:
        value = value.copy()  # whoever holds the base of a view could change it
    value.setflags(write=False)
    return value


def _in_short(value: Any, unit: str = "") -> str:
    """Return a value as it is shown: of arrays that fill lines their shape."""
    if isinstance(value, np.ndarray) and value.size > 8:
        return f"<{' x '.join(map(str, value.shape))}{f' in {unit}' if unit not in ('', '1') else ''}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_in_short(item, unit)}' for key, item in value.items())}}}"
    if type(value) in (tuple, list):
        return f"({', '.join(_in_short(item, unit) for item in value)})"
    return repr(value)


def _equal(self: Any, other: Any) -> bool:
    return type(self) is type(other) and all(_same(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)


def _show(self: Any) -> str:
    shown = (f"{f.name}={_in_short(getattr(self, f.name), f.metadata.get('unit', ''))}" for f in fields(self) if f.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(quantity, field))
def record(cls: type[T]) -> type[T]:
    """Make `cls` a keyword-only frozen dataclass with read-only arrays, of which large ones are shown by their shape.

    A class may define ``check(self)`` to validate itself; it runs after construction.
    """

    def __post_init__(self: Any) -> None:
        _freeze_arrays(self)
        check = getattr(self, "check", None)
        if check is not None:
            check()

    cls.__post_init__ = __post_init__  # type: ignore[attr-defined]
    cls.__eq__ = _equal  # type: ignore[method-assign]
    if "__repr__" not in vars(cls):
        cls.__repr__ = _show  # type: ignore[method-assign]
    return dataclass(frozen=True, kw_only=True)(cls)


def digest(*values: Any) -> str:
    """Return a hash of all that records, plain values, and arrays, groups and settings of them hold.

    Of an object of another kind it tells the class alone.
    """
    told = hashlib.sha256()
    for part in _parts(values):
        told.update(part)
    return told.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    if isinstance(value, str | Number | None):
        yield repr(complex(value) if isinstance(value, Number) else value).encode()  # type: ignore[call-overload]
    elif isinstance(value, np.ndarray):
        yield from (f"{value.dtype}{value.shape}".encode(), value.tobytes())
    elif isinstance(value, list | tuple):
        yield f"{len(value)} of".encode()
        for one in value:
            yield from _parts(one)
    else:
        yield type(value).__qualname__.encode()
        held = {f.name: getattr(value, f.name) for f in fields(value)} if is_dataclass(value) else (
            value if isinstance(value, Mapping) else value.model_dump() if hasattr(value, "model_dump") else {})
        for name, one in held.items():
            yield str(name).encode()
            yield from _parts(one)


def unit_of(cls: type[Any], name: str) -> str:
    """Return the unit declared for field `name` of record class `cls`, or ``""``."""
    for f in fields(cls):
        if f.name == name:
            return str(f.metadata.get("unit", ""))
    raise KeyError(f"{cls.__name__} has no field {name}")


def to_dataset(data: Mapping[str, Labelled], coordinates: Mapping[str, Labelled]) -> xr.Dataset:
    """Return arrays with named dimensions, each with its unit as the attribute ``units``."""
    import xarray as xr

    return xr.Dataset(*({name: (dimensions, values, {"units": unit}) for name, (dimensions, values, unit)
                         in each.items()} for each in (data, coordinates)))
