"""A structure given by its matrices: mass, stiffness, and the map to the relative motion of its contact points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.linalg import qr

from fretflow.core.arguments import Like, is_array
from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record

Matrix: TypeAlias = Annotated[Any, Like("a matrix of finite numbers, dense or sparse",
                                        lambda value: sparse.issparse(value) or (
                                            isinstance(value, np.ndarray) and is_array(value) and value.ndim == 2))]

ASYMMETRY = 1e-6  # of the largest entry: single precision and text of seven digits stay below it
DEPENDENT = 1e-9  # of the largest singular value of a map's rows of unit length
DENSE = 1500  # DOF up to which dense algebra is the faster


@record
class StructureMatrices:
    """M and K of a structure whose joint is open, and what acts on it, DOF q (n,), contact points m.

    Rows ``3 j .. 3 j + 2`` of the contact map Q are the relative displacement of point j: two tangential directions and
    the normal one, which is positive when the joint opens. A contact force f acts as ``Q^T f``.

    Examples
    --------
    A mass of 2 kg on a spring, and beside it a slider of 10 N/mm that a bolt presses to the ground:

    >>> import fretflow as ff
    >>> import numpy as np
    >>> mass, stiffness = np.diag([2.0, 0.0, 0.0, 0.0]), np.diag([4e4, 1e4, 1e4, 1e4])  # kg, N/m
    >>> stiffness[0, 1] = stiffness[1, 0] = -1e4
    >>> rows = np.eye(4)
    >>> slider = ff.StructureMatrices(mass=mass, stiffness=stiffness, contact_map=rows[1:], areas=np.array([1e-6]),
    ...                               points=np.zeros((1, 3)), preload=-rows[3], outputs={"mass": rows[0]})
    >>> slider.size, slider.contacts
    (4, 1)
    """

    mass: Matrix = quantity("kg", "(n, n), dense or sparse")
    stiffness: Matrix = quantity("N/m", "(n, n)")
    contact_map: Matrix = quantity("1", "(3 m, n)")
    areas: Array = quantity("m^2", "(m,)")
    points: Array = quantity("m", "(m, 3)")
    preload: Array | None = quantity("1", "(n,), force per unit of bolt load", default=None)
    gap: Array | None = quantity("m", "(m,), without any load; zero by default", default=None)
    damping: Matrix = quantity("N*s/m", "(n, n); nonlinear modes have a ratio in place of it", default=None)
    modal_damping: float | None = quantity("1", "ratio, of every mode", default=None)
    inputs: Mapping[str, Array] = quantity("1", "(n,) each", default_factory=dict)
    outputs: Mapping[str, Array] = quantity("1", "(n,) each", default_factory=dict)

    @property
    def size(self) -> int:
        """Return the number of DOF."""
        return int(self.mass.shape[0])

    @property
    def contacts(self) -> int:
        """Return the number of contact points."""
        return len(self.areas)

    def check(self) -> None:
        """Check shapes, symmetry and the rank of the contact map.

        Raises
        ------
        InputError
            Naming the array.
        """
        n = self.size
        if n == 0:
            raise InputError("M: holds nothing")
        for name, label in (("mass", "M"), ("stiffness", "K"), ("damping", "C")):
            matrix = getattr(self, name)
            if matrix is not None:
                object.__setattr__(self, name, _symmetric(matrix, n, label))
        m = len(self.areas)
        self._check_shapes(m, n)
        if m == 0 or 3 * m >= n:
            raise InputError(f"contact_map: {3 * m} rows for {n} DOF; give at least one contact point, and fewer rows "
                             "than DOF")
        if not np.all(self.areas > 0.0):
            raise InputError(f"areas: must be positive, number {int(np.argmin(self.areas)) + 1} is {self.areas.min()}")
        if self.modal_damping is not None and not 0.0 <= self.modal_damping < 1.0:
            raise InputError(f"modal_damping: {self.modal_damping} is no damping ratio between 0 and 1")
        _independent(self.contact_map)

    def _check_shapes(self, m: int, n: int) -> None:
        """Check the shapes of all that is no square matrix."""
        shapes = {"contact_map": (3 * m, n), "areas": (m,), "points": (m, 3), "preload": (n,), "gap": (m,)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is None:
                continue
            if values.shape != shape:
                raise InputError(f"{name}: has the shape {values.shape}, but {m} areas and {n} DOF need {shape}")
            _finite(values, name)
        for kind in ("inputs", "outputs"):
            for name, row in getattr(self, kind).items():
                if row.shape != (n,):
                    raise InputError(f"{kind}: {name} has the shape {row.shape}, but a row has {n} numbers, one a DOF")
                _finite(row, f"{kind}: {name}")
                if not np.any(row):
                    raise InputError(f"{kind}: {name} holds only zeros, which is no place on the structure that moves")


def check_force_map(force_map: Matrix, contact_map: Matrix) -> None:
    """Refuse a force map that is not the transposed contact map with a positive factor for each column.

    The factors, areas where contact tractions are meant, change the unit of the contact forces alone.

    Raises
    ------
    InputError
        If forces and displacements do not belong together.
    """
    if force_map.shape != contact_map.shape[::-1]:
        raise InputError(f"force_map: has the shape {force_map.shape}, but contact_map needs {contact_map.shape[::-1]}")
    own, other = sparse.csr_matrix(force_map.T), sparse.csr_matrix(contact_map)
    square = np.asarray(other.multiply(other).sum(axis=1)).ravel()
    factor = np.asarray(own.multiply(other).sum(axis=1)).ravel() / np.maximum(square, np.finfo(float).tiny)
    left = own - sparse.diags(factor) @ other
    if not np.all(factor > 0.0) or abs(left).max() > ASYMMETRY * abs(own).max():
        raise InputError("force_map: is not the transposed contact_map with a positive factor for each column, so that "
                         "forces do not act where displacements are read; leave it out or correct its signs")


def _symmetric(matrix: Matrix, n: int, label: str) -> Matrix:
    if matrix.ndim != 2 or matrix.shape != (n, n):
        raise InputError(f"{label}: has the shape {matrix.shape}, but M has {n} rows; M, K and C are square and alike")
    _finite(matrix, label)
    lean, largest = abs(matrix - matrix.T), float(abs(matrix).max())
    if label != "C" and largest == 0.0:
        raise InputError(f"{label}: holds only zeros")
    if float(lean.max()) > ASYMMETRY * largest:
        row, column = divmod(int(lean.argmax()), n)
        raise InputError(f"{label}: is not symmetric, {label}[{row}, {column}] and {label}[{column}, {row}] differ by "
                         f"{lean.max() / largest:.1e} of its largest entry; give both triangles")
    row = int(np.argmin(matrix.diagonal()))
    if matrix.diagonal()[row] < -float(lean.max()) - n * np.finfo(float).eps * largest:  # a free motion's, rounded
        raise InputError(f"{label}: is not positive definite, {label}[{row}, {row}] is negative; correct its sign")
    whole = 0.5 * (matrix + matrix.T)
    return whole.tocsc() if sparse.issparse(whole) else np.asarray(whole)


def _finite(values: Matrix, label: str) -> None:
    held = values.data if sparse.issparse(values) else values
    if np.iscomplexobj(held):
        raise InputError(f"{label}: must be real; give damping as C or modal_damping")
    if not np.all(np.isfinite(held)):
        raise InputError(f"{label}: holds numbers that are not finite")


def _independent(contact_map: Matrix) -> None:
    """Refuse dependent rows: a force in one of them could not be told from forces in others."""
    rows = sparse.csr_matrix(contact_map)
    length = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    if np.any(length == 0.0):
        raise InputError(f"contact_map: row {int(np.argmin(length))} is empty, point {int(np.argmin(length)) // 3} "
                         "touches nothing; leave the point out")
    unit = sparse.diags(1.0 / length) @ rows
    size = np.abs(np.diagonal(qr((unit @ unit.T).toarray(), mode="r", pivoting=True)[0]))
    rank = int(np.sum(size > DEPENDENT * size[0]))
    if rank < len(length):
        raise InputError(f"contact_map: its rows depend on each other, rank {rank} of {len(length)}; give each "
                         "contact point one relative displacement that no other has")
