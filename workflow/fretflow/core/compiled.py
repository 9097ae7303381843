"""Inner loops compiled at their first call by numba, with LAPACK's LU factorisation and BLAS's products for them.

The machine code is kept beside the source or in the user's cache; only the first run of a version waits for it. Plain
loops compile in a tenth of the time that array expressions and NumPy's functions take, and run as fast.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import binding
from numba import njit, types
from numba.extending import get_cython_function_address
from numpy.typing import NDArray

SINGLE = 4  # bytes of a number in single precision
Compiled = TypeVar("Compiled", bound=Callable[..., Any])


def compiled(function: Compiled) -> Compiled:
    """Compile `function`; divisions by zero give inf and nan, as NumPy's do."""
    try:
        made = njit(cache=True, error_model="numpy")(function)
        _forget_outdated(made)
    except RuntimeError:  # no folder where the machine code could be kept
        made = njit(error_model="numpy")(function)
    _survive_full_disk(made)
    _take_constants_as_values(made)
    return cast(Compiled, made)


def is_compiled(made: Any) -> bool:
    """Tell whether a compiled function's machine code is there, so that its first call need not wait for it."""
    if not hasattr(made, "_cache"):  # compiling is switched off
        return True
    kept = getattr(made._cache, "_cache_file", None)  # None where there is no folder for it
    return bool(made.signatures or (kept and kept._load_index()))


def _take_constants_as_values(made: Any) -> None:
    """Let no constant argument make a version of its own, whose compilation would take as long again."""
    if not hasattr(made, "get_call_template"):  # compiling is switched off
        return
    template = made.get_call_template
    made.get_call_template = lambda args, kws: template(
        tuple(map(types.unliteral, args)), {name: types.unliteral(one) for name, one in kws.items()})


def _forget_outdated(made: Any) -> None:
    """Remove what was kept of an earlier version and names types that are no more, which numba stumbles over."""
    if not hasattr(made, "_cache"):  # compiling is switched off
        return
    try:
        made._cache._cache_file._load_index()
    except (AttributeError, ImportError):
        made._cache.flush()


def _survive_full_disk(made: Any) -> None:
    """Let code that cannot be kept be compiled at every run, instead of ending this one."""
    if not hasattr(made, "_cache"):  # compiling is switched off
        return
    save = made._cache.save_overload

    def save_if_it_can(signature: Any, code: Any) -> None:
        with suppress(OSError):
            save(signature, code)

    made._cache.save_overload = save_if_it_can


def _routine(library: str, name: str, arguments: int) -> Any:
    """Return a routine of SciPy's BLAS or LAPACK, all of whose arguments are addresses."""
    symbol = f"fretflow_{name}"
    binding.add_symbol(symbol, get_cython_function_address(f"scipy.linalg.{library}", name))
    return types.ExternalFunction(symbol, types.void(*[types.intp] * arguments))


_dgetrf = _routine("cython_lapack", "dgetrf", 6)
_dgetrs = _routine("cython_lapack", "dgetrs", 9)
_sgetrf = _routine("cython_lapack", "sgetrf", 6)
_sgetrs = _routine("cython_lapack", "sgetrs", 9)
_dgemm = _routine("cython_blas", "dgemm", 13)
_dgemv = _routine("cython_blas", "dgemv", 11)
_dsymv = _routine("cython_blas", "dsymv", 10)


@compiled
def largest(values: NDArray[np.float64]) -> float:
    """Return the largest size, nan if there is any."""
    most = 0.0
    for value in values:
        if np.isnan(value):
            return np.nan
        most = max(most, abs(value))
    return most


@compiled
def factorise(columns: NDArray[np.floating[Any]], pivots: NDArray[np.int32]) -> bool:
    """Replace a matrix, given by its columns (q, q), by its LU factors; `pivots` (q,). Return whether it is regular.

    In the matrix's own precision, single or double.
    """
    size = np.array([len(columns)], dtype=np.int32)
    info = np.zeros(1, dtype=np.int32)
    if columns.itemsize == SINGLE:
        _sgetrf(size.ctypes.data, size.ctypes.data, columns.ctypes.data, size.ctypes.data, pivots.ctypes.data,
                info.ctypes.data)
    else:
        _dgetrf(size.ctypes.data, size.ctypes.data, columns.ctypes.data, size.ctypes.data, pivots.ctypes.data,
                info.ctypes.data)
    return bool(info[0] == 0 and size[0] == len(columns))


@compiled
def substitute(factors: NDArray[np.floating[Any]], pivots: NDArray[np.int32], columns: NDArray[np.floating[Any]]
               ) -> None:
    """Replace right-hand sides, given by their columns (p, q), by the solutions of `factorise`d equations.

    The right-hand sides have the factors' precision.
    """
    size = np.array([len(factors), len(columns), 0], dtype=np.int32)
    plain = np.array([78], dtype=np.int8)  # "N": not the transpose
    if columns.itemsize != factors.itemsize:
        raise ValueError("factors and right-hand sides differ in precision")
    if factors.itemsize == SINGLE:
        _sgetrs(plain.ctypes.data, size.ctypes.data, size[1:].ctypes.data, factors.ctypes.data, size.ctypes.data,
                pivots.ctypes.data, columns.ctypes.data, size.ctypes.data, size[2:].ctypes.data)
    else:
        _dgetrs(plain.ctypes.data, size.ctypes.data, size[1:].ctypes.data, factors.ctypes.data, size.ctypes.data,
                pivots.ctypes.data, columns.ctypes.data, size.ctypes.data, size[2:].ctypes.data)
    if size[2] != 0 or plain[0] != 78:
        raise ValueError("LAPACK refused its arguments")


@compiled
def _multiply_vector(a: NDArray[np.float64], b: NDArray[np.float64], product: NDArray[np.float64]) -> None:
    """Put ``a @ b`` of (m, s) and (s, 1) into `product` (m, 1); twice as fast as a product of matrices."""
    size = np.array([a.shape[1], a.shape[0], 1], dtype=np.int32)
    transposed, scale = np.array([84], dtype=np.int8), np.array([1.0, 0.0])  # "T": of the columns that BLAS reads
    if size[1] > 0:
        _dgemv(transposed.ctypes.data, size.ctypes.data, size[1:].ctypes.data, scale.ctypes.data, a.ctypes.data,
               size.ctypes.data, b.ctypes.data, size[2:].ctypes.data, scale[1:].ctypes.data, product.ctypes.data,
               size[2:].ctypes.data)
    if transposed[0] != 84 or scale[1] != 0.0 or size[2] != 1:
        raise ValueError("BLAS changed its arguments")  # never; keeps them alive until here


@compiled
def multiply(a: NDArray[np.float64], b: NDArray[np.float64], product: NDArray[np.float64]) -> None:
    """Put ``a @ b`` of (m, s) and (s, p) into `product` (m, p)."""
    if a.shape[1] == 0:
        product.fill(0.0)
        return
    if b.shape[1] == 1:
        _multiply_vector(a, b, product)
        return
    # by columns, as BLAS reads them, these are the transposed matrices: product^T = b^T a^T
    size = np.array([b.shape[1], a.shape[0], a.shape[1]], dtype=np.int32)
    plain, scale = np.array([78], dtype=np.int8), np.array([1.0, 0.0])  # "N": as they are
    if min(size[0], size[1]) > 0:
        _dgemm(plain.ctypes.data, plain.ctypes.data, size.ctypes.data, size[1:].ctypes.data, size[2:].ctypes.data,
               scale.ctypes.data, b.ctypes.data, size.ctypes.data, a.ctypes.data, size[2:].ctypes.data,
               scale[1:].ctypes.data, product.ctypes.data, size.ctypes.data)
    if plain[0] != 78 or scale[1] != 0.0 or size[2] != a.shape[1]:
        raise ValueError("BLAS changed its arguments")  # never; keeps them alive until here


@compiled
def multiply_symmetric(matrix: NDArray[np.float64], vector: NDArray[np.float64], product: NDArray[np.float64]) -> None:
    """Put ``matrix @ vector`` into `product` (m,), the matrix (m, m) being symmetric: only one half of it is read."""
    size = np.array([len(matrix), 1], dtype=np.int32)
    half, scale = np.array([76], dtype=np.int8), np.array([1.0, 0.0])  # "L": the lower one
    _dsymv(half.ctypes.data, size.ctypes.data, scale.ctypes.data, matrix.ctypes.data, size.ctypes.data,
           vector.ctypes.data, size[1:].ctypes.data, scale[1:].ctypes.data, product.ctypes.data, size[1:].ctypes.data)
    if half[0] != 76 or scale[1] != 0.0 or size[1] != 1:
        raise ValueError("BLAS changed its arguments")  # never; keeps them alive until here
