"""A structure on its contact: constraint modes, fixed-interface modes, and the massless boundary.

With the contact's relative displacement u and M-normalised modes Phi of the closed joint, ``q = Psi u + Phi eta``
(R. R. Craig, M. C. C. Bampton, AIAA J. 6 (1968) 1313); u and eta are coupled by inertia alone. In ``y = Phi^T M q``
they are coupled by stiffness alone, and the little inertia that is left at u is dropped (C. D. Monjaraz Tec, J. Gross,
M. Krack, Comput. Struct. 260 (2022) 106698):

    y'' + L y - L m u = Phi^T F,    f = (K_c + m^T L m) u - m^T L y - (Psi - Phi m)^T F,    m = Phi^T M Psi.

Statically this is exact however few modes are kept. Motions of the whole structure that strain nothing are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve, eigh, qr
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array, quantity, record
from fretflow.structure.matrices import DENSE, Matrix, StructureMatrices

RIGID_MOTIONS = 6
RIGID = 1e-6  # eigenvalue over that of the seventh mode: a thousandth of its frequency
NEGATIVE = 1e-6  # of the largest diagonal term: below it round-off
UNBALANCED = 1e-6  # of the bolts' forces
COMPARED = 6  # frequencies that tell the error of the reduction
SHIFT = 1e-9  # of the largest stiffness over the largest mass: far above round-off, far below the modes that are cut


@record
class ReducedStructure:
    """A structure on its m contact points and N modes of the closed joint; see the module's text."""

    stiffness: Array = quantity("N/m", "(3 m, 3 m), K_c, static")
    boundary_mass: Array = quantity("kg", "(3 m, 3 m)")
    eigenvalues: Array = quantity("1/s^2", "(N,), L")
    coupling: Array = quantity("kg^0.5", "(N, 3 m), m")
    areas: Array = quantity("m^2", "(m,)")
    points: Array = quantity("m", "(m, 3)")
    gap: Array = quantity("m", "(m,)")
    preload: tuple[Array, Array] | None  # of the bolts, per unit: on u (3 m,) and on eta (N,)
    inputs: Mapping[str, tuple[Array, Array]]  # on u and on eta
    outputs: Mapping[str, tuple[Array, Array]]
    modal_damping: float | None = quantity("1", default=None)
    damping: Array | None = quantity("N*s/m", "(3 m + N, 3 m + N), on u and eta, of which modes have a ratio each",
                                     default=None)
    rigid_motions: int = quantity("1", default=0)
    error: float = quantity("1", "largest relative error of the first frequencies with the joint open", default=0.0)

    @property
    def contacts(self) -> int:
        """Return the number of contact points."""
        return len(self.areas)


class _Basis(NamedTuple):
    """Modes of the closed joint (n, N), their eigenvalues, rigid motions (n, r) and constraint modes (n, 3 m)."""

    modes: Array
    eigenvalues: Array
    rigid: Array
    constraint: Array


def reduce_structure(matrices: StructureMatrices, modes: int | None = None) -> ReducedStructure:
    """Reduce a structure to its contact and `modes` of the closed joint; by default all of a small one, 60 else.

    Returns
    -------
    ReducedStructure
        In SI; its `error` is what the reduction changes of the first frequencies with the joint open.

    Raises
    ------
    InputError
        If M or K is not definite where it must be, a part hangs loose, or the bolts' forces have no balance.
    NonConvergenceError
        If the modes of a large structure do not converge.

    Examples
    --------
    >>> import fretflow as ff
    >>> reduced = ff.reduce_structure(ff.structure_from_mesh("beam.msh", steel, faces), 20)  # doctest: +SKIP
    >>> reduced.error  # doctest: +SKIP
    7e-06
    """
    free = matrices.size - 3 * matrices.contacts
    small = matrices.size <= DENSE
    wanted = free if small and modes is None else min(free, modes or 60)
    basis = (_dense_basis if small else _sparse_basis)(matrices, wanted)
    psi, phi, mass = basis.constraint, basis.modes, matrices.mass
    weighed = mass @ psi
    stiffness = psi.T @ (matrices.stiffness @ psi)
    stiffness = 0.5 * (stiffness + stiffness.T)
    lowest = float(np.linalg.eigvalsh(stiffness)[0])
    if lowest < -NEGATIVE * float(stiffness.diagonal().max()):
        raise InputError(f"K: gives energy when the joint moves (eigenvalue {lowest:.1e} N/m); it must not be negative")

    def seen(rows: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        return {name: (row @ psi, row @ phi) for name, row in rows.items()}

    preload = matrices.preload
    if preload is not None and basis.rigid.size:
        out = float(np.abs((mass @ basis.rigid) @ (basis.rigid.T @ preload)).max())
        if out > UNBALANCED * float(np.abs(preload).max()):
            raise InputError("preload: the bolts' forces push the whole structure away, which nothing holds; each bolt "
                             "pulls both of its ends alike")
    damping = None
    if matrices.damping is not None:  # large bases are not copied for nothing
        both = np.hstack([psi, phi])
        damping = np.asarray(both.T @ (matrices.damping @ both))
    reduced = ReducedStructure(
        stiffness=stiffness, boundary_mass=psi.T @ weighed, eigenvalues=basis.eigenvalues,
        coupling=phi.T @ weighed, areas=matrices.areas, points=matrices.points,
        gap=np.zeros(matrices.contacts) if matrices.gap is None else matrices.gap,
        preload=None if preload is None else (preload @ psi, preload @ phi), inputs=seen(matrices.inputs),
        outputs=seen(matrices.outputs), modal_damping=matrices.modal_damping, rigid_motions=basis.rigid.shape[1],
        damping=damping)
    return reduced if wanted == free else _with_error(reduced, matrices)


def _dense_basis(matrices: StructureMatrices, wanted: int) -> _Basis:
    q, k, m = (np.asarray(one.todense() if sparse.issparse(one) else one)
               for one in (matrices.contact_map, matrices.stiffness, matrices.mass))
    contact = len(q)
    orthogonal, triangle = qr(q.T)
    lifted = np.linalg.solve(triangle[:contact], orthogonal[:, :contact].T).T
    closed = orthogonal[:, contact:]
    inner_k, inner_m = closed.T @ k @ closed, closed.T @ m @ closed
    try:
        last = min(len(inner_m), wanted + RIGID_MOTIONS) - 1
        values, vectors = eigh(inner_k, inner_m, subset_by_index=[0, last])
    except np.linalg.LinAlgError as error:
        raise InputError("M: is not positive definite on the motions of the closed joint; every DOF needs a mass, "
                         "contact DOF apart") from error
    rigid = _rigid_count(values)
    strain = inner_m @ vectors[:, :rigid]
    held = inner_k + max(float(values[rigid]), 1.0) * (strain @ strain.T)
    try:
        constraint = lifted - closed @ cho_solve(cho_factor(held), closed.T @ (k @ lifted))
    except np.linalg.LinAlgError as error:
        raise InputError("K: is not positive definite on the motions of the closed joint") from error
    free = closed @ vectors[:, :rigid]
    constraint -= free @ (free.T @ (m @ constraint))
    kept = slice(rigid, rigid + wanted)
    return _Basis(closed @ vectors[:, kept], values[kept], free, constraint)


class _ClosedJoint:
    """The static answer of a sparse structure whose contact is held: ``K + sigma M`` with Q q given, factorised once.

    Across the contact a stiffness is added, which changes nothing there and holds parts that hang on it alone.
    """

    def __init__(self, stiffness: Matrix, mass: Matrix, contact_map: Matrix) -> None:
        across = contact_map.T @ contact_map
        self.map = contact_map
        self.shift, self.inverse = _shifted(stiffness, mass, float(stiffness.diagonal().max())
                                            / max(float(across.diagonal().max()), 1.0) * across)
        self.moved = self.inverse(contact_map.T.toarray(order="F"))
        try:
            self.held = cho_factor(contact_map @ self.moved)
        except np.linalg.LinAlgError as error:
            raise InputError("K: is not positive definite on the motions of the contact") from error

    def lifted(self) -> Array:
        """Return the motion (n, 3 m) under unit displacements of the contact."""
        return np.asarray(cho_solve(self.held, self.moved.T).T)

    def solve(self, right: Array) -> Array:
        """Return the motion under forces (n,) or (n, k), the contact held still."""
        free = self.inverse(right)
        return np.asarray(free - self.moved @ cho_solve(self.held, self.map @ free))


def _shifted(stiffness: Matrix, mass: Matrix, more: Matrix | None = None) -> tuple[float, Callable[[Array], Array]]:
    """Return a small sigma in 1/s^2 and what solves with ``K + sigma M + more``, which is positive definite."""
    shift = SHIFT * float(stiffness.diagonal().max()) / float(mass.diagonal().max())
    whole = stiffness + shift * mass
    from fretflow.structure.fem.cholesky import factorise  # PETSc is started where it is needed

    try:
        return shift, factorise(whole if more is None else whole + more)
    except InputError as error:
        raise InputError(f"K: cannot be factorised ({error}); a part without mass hangs loose") from error


def _lowest(stiffness: Matrix, mass: Matrix, count: int, shift: float, solve: Callable[[Array], Array]
            ) -> tuple[Array, Array]:
    """Return the lowest eigenvalues, ascending, and their M-normalised vectors."""
    n = stiffness.shape[0]
    try:
        values, vectors = eigsh(stiffness, count, mass, sigma=-shift, which="LM",
                                OPinv=LinearOperator((n, n), matvec=solve), v0=solve(np.sin(np.arange(1.0, n + 1.0))))
    except ArpackError as error:
        raise NonConvergenceError(f"modes of the structure: {error}; ask for fewer") from error
    order = np.argsort(values)
    return values[order], vectors[:, order]


def _sparse_basis(matrices: StructureMatrices, wanted: int) -> _Basis:
    """Return the modes by Lanczos on the closed joint."""
    q, k, m = (sparse.csc_matrix(one) for one in (matrices.contact_map, matrices.stiffness, matrices.mass))
    joint = _ClosedJoint(k, m, q)
    values, vectors = _lowest(k, m, wanted + RIGID_MOTIONS, joint.shift, joint.solve)
    rigid = _rigid_count(values)
    modes, kept = vectors[:, rigid:rigid + wanted], values[rigid:rigid + wanted]
    free = vectors[:, :rigid]
    constraint = joint.lifted()
    along, rows = np.hstack([modes, free]), np.vstack([(k @ modes / kept).T, (m @ free).T])
    # the shift's share goes: along the modes and rigid motions at once, beyond them by their ratio to it
    constraint -= along @ (rows @ constraint)
    constraint -= joint.solve(k @ constraint)
    constraint -= along @ (rows @ constraint)
    return _Basis(modes, kept, free, constraint)


def _rigid_count(values: Array) -> int:
    """Return how many of the eigenvalues (ascending) are of motions that strain nothing."""
    reference = float(values[min(RIGID_MOTIONS, len(values) - 1)])
    if not reference > 0.0:
        raise InputError(f"K: {int(np.sum(values <= 0.0))} motions strain nothing though the joint is closed; a part "
                         "hangs loose, or K is not positive")
    if float(values[0]) < -RIGID * reference:
        raise InputError(f"K: is not positive on the motions of the closed joint (eigenvalue {values[0]:.1e} 1/s^2)")
    return int(np.sum(values < RIGID * reference))


def _with_error(reduced: ReducedStructure, matrices: StructureMatrices) -> ReducedStructure:
    """Return the reduced structure with the error of its first frequencies while its joint is open."""
    from dataclasses import replace

    count = COMPARED + 2 * RIGID_MOTIONS
    if matrices.size <= DENSE:
        full = eigh(*(np.asarray(one.todense() if sparse.issparse(one) else one)
                      for one in (matrices.stiffness, matrices.mass)), eigvals_only=True,
                    subset_by_index=[0, min(count, matrices.size) - 1])
    else:
        k, m = sparse.csc_matrix(matrices.stiffness), sparse.csc_matrix(matrices.mass)
        full = _lowest(k, m, count, *_shifted(k, m))[0]
    own_k, own_m = assembled(reduced)
    own = eigh(own_k, own_m, eigvals_only=True, subset_by_index=[0, min(count, len(own_k)) - 1])
    top = float(full[-1])
    full, own = (values[values > RIGID * top] for values in (full, own))
    compared = min(COMPARED, len(full), len(own))
    return replace(reduced, error=float(np.max(np.abs(np.sqrt(own[:compared] / full[:compared]) - 1.0), initial=0.0)))


def assembled(reduced: ReducedStructure, massless: bool = False) -> tuple[Array, Array]:
    """Return stiffness and mass of (u, eta), or of (u, y) with the `massless` boundary; (3 m + N, 3 m + N)."""
    contact, modes = len(reduced.stiffness), len(reduced.eigenvalues)
    k, m = np.zeros((contact + modes,) * 2), np.eye(contact + modes)
    k[:contact, :contact], k[contact:, contact:] = reduced.stiffness, np.diag(reduced.eigenvalues)
    if massless:
        carried = reduced.eigenvalues[:, None] * reduced.coupling
        k[:contact, :contact] += reduced.coupling.T @ carried
        k[contact:, :contact], k[:contact, contact:] = -carried, -carried.T
        m[:contact, :contact] = 0.0
        return k, m
    m[:contact, :contact] = reduced.boundary_mass
    m[contact:, :contact], m[:contact, contact:] = reduced.coupling, reduced.coupling.T
    return k, m
