"""A friction joint given by its matrices, as solvers see it.

With DOF x, loads F at rows h, a contact map Q (u = Q x) and contact forces f on x as ``Q^T f``::

    M x'' + C x' + K x = h F + Q^T f

Massless boundary. Let Phi be the M-normalised modes of the closed joint (Q Phi = 0), L their eigenvalues, and A the
motion that moves the contact without any inertia of theirs (Q A = 1, Phi^T M A = 0), so that ``x = A u + Phi y`` and
y'' carries all inertia but ``A^T M A``: between two free bodies the momentum is kept, and lost is only the small mass
by which faces move against each other (a period tells its share, see `solvers.quasi_static.cautions`). Without that,

    f = K_c u + K_y y - A^T h F,   K_c = A^T K A,  K_y = A^T K Phi,   y'' + L y + K_y^T u = Phi^T h F

which is the form of `structure.structure` with G = K_c^-1, B = -G K_y, W = G A^T h, S = L - K_y^T G K_y and, as an open
joint moves by Z = Phi + A B, forces Z^T h F and Z^T C Z for the damping. In modes of S the highest may be left out;
their flexibility then goes to G (C. D. Monjaraz Tec, J. Gross, M. Krack, Comput. Struct. 260 (2022) 106698).

Springs in series with the contact, ``u = Q x + c f``, need no mass to be dropped: there x is in modes of the open
joint, B = Q Phi and G = diag(c). The dynamic stiffness keeps all mass,

    [ D(i w)  -Q^T ] [x]   [h F]
    [ Q        c   ] [f] = [ u ],   D = K + i w C - w^2 M
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.structure.matrices import StructureMatrices, check_force_map
from fretflow.structure.structure import (
    Array,
    Complex,
    DynamicStiffness,
    LinearInternal,
    MasslessBoundary,
    ObservedMotion,
    squeezed,
)

RIGID = 1e-9  # eigenvalue over the largest one below which a motion strains nothing
UNSEEN = 1e-12  # relative motion of the contact by such a motion that is round-off


@dataclass(frozen=True)
class _MatrixMotion:
    """Motion away from the contact; complex amplitudes per harmonic (a `structure.structure.StructureMotion`)."""

    internal: Complex
    outputs: Mapping[str, Complex]


@dataclass(frozen=True)
class _Modes:
    """The massless boundary in modal coordinates q: ``x = shape q + contact f + load F``, ``q = project x``.

    `squares` (d,) are the eigenvalues in 1/s^2; letters of the flexible form as in the module's text.
    """

    squares: Array
    shape: Array
    contact: Array
    load: Array
    project: Array
    flexibility: Array
    motion: Array
    input_motion: Array
    contact_mass: Array | None = None  # A^T M A


@record
class Joint:
    """A structure with a friction joint, given by its matrices in SI units (a `structure.structure.Structure`).

    `from_matrices` builds it.

    Examples
    --------
    Two masses, the second one rubbing on the ground through the contact at its three DOF:

    >>> import numpy as np
    >>> import fretflow as ff
    >>> k = 1e6 * np.eye(4)
    >>> k[0, 1] = k[1, 0] = -4e5
    >>> joint = ff.Joint.from_matrices(k, np.diag([1.0, 0.1, 0.1, 0.1]), contact_map=np.eye(4)[1:], observe={"tip": 0})
    >>> joint.massless_boundary().size
    1
    """

    mass: Array = quantity("kg", "(N, N)")
    stiffness: Array = quantity("N/m", "(N, N)")
    damping: Array = quantity("N s/m", "(N, N)")
    contact_map: Array = quantity("1", "(3 n, N)")
    observed: Mapping[str, Array] = quantity("1", "(N,) each: inputs and outputs")
    springs: Array = quantity("m/N", "(3 n,), compliance in series with the contact")
    modes: int | None = None

    @classmethod
    def from_matrices(cls, stiffness: Array, mass: Array, damping: Array | None = None, *,
                      contact: Sequence[int] | NDArray[np.int64] | None = None, contact_map: Array | None = None,
                      force_map: Array | None = None, observe: Mapping[str, int | Array] | None = None,
                      modal_damping: float | None = None, modes: int | None = None,
                      contact_compliance: float | Array = 0.0) -> Joint:
        """Build a joint from its matrices.

        Parameters
        ----------
        stiffness, mass, damping : (N, N)
            K, M and C in N/m, kg and N s/m; symmetric; C is zero by default. Of C the quasi-static solver keeps what
            acts on the open joint, and tells where the rest matters; DLFT keeps all.
        contact : sequence of int
            Numbers of the nodes that rub against the ground, node k having DOF 3 k, 3 k + 1 (tangential) and 3 k + 2
            (normal, positive when open).
        contact_map : (3 n, N)
            Instead of `contact`: relative displacement of n contact points by the DOF, two tangential rows and the
            normal one, positive when open, for each. Interfaces with several normals are points with their own rows.
        force_map : (N, 3 n), optional
            How contact forces act; it must be the transposed contact map up to a factor for each column.
        observe : mapping
            Named DOF, by number or as a row (N,): inputs of forces in N, and outputs in m.
        modal_damping : float, optional
            Damping ratio of every mode of the open joint, beside C.
        modes : int, optional
            Internal modes that the quasi-static solver keeps; by default all.
        contact_compliance : float or (3 n,), optional
            Springs in series with the contact, m/N; with them no mass is neglected, which a contact needs that carries
            all the mass.

        Raises
        ------
        InputError
            If a matrix is not symmetric, not definite where it must be, or of the wrong shape; if the map has dependent
            rows; or if no contact or too many modes are asked for.
        """
        size = len(stiffness)
        rows = _rows(size, contact, contact_map)
        if force_map is not None:
            check_force_map(np.asarray(force_map, dtype=float), rows)
        if np.size(contact_compliance) not in (1, len(rows)):
            raise InputError(f"contact_compliance: has {np.size(contact_compliance)} values, but the contact has "
                             f"{len(rows)} DOF; give one, or one for each")
        springs = np.broadcast_to(np.asarray(contact_compliance, dtype=float), len(rows)).copy()
        if not np.all(springs >= 0.0) or (np.any(springs > 0.0) and not np.all(springs > 0.0)):
            raise InputError("contact_compliance: give springs at all contact DOF, or none")
        if not isinstance(observe or {}, Mapping):
            raise InputError(f"observe: {observe!r} names no places; give a DOF or a row for each name, "
                             'such as {"tip": 0}')
        observed = {name: _row(size, name, where) for name, where in (observe or {}).items()}
        if 3 * (len(rows) // 3) >= size and not springs.any():
            raise InputError("K: all DOF are the contact's, so that a massless contact leaves no inertia; give "
                             "contact_compliance, the flexibility of the faces")
        n = len(rows) // 3
        whole, extra = size, max(0, len(rows) + 1 - size)  # the check wants more DOF than the contact's
        checked = StructureMatrices(
            mass=_padded(mass, extra), stiffness=_padded(stiffness, extra),
            damping=_padded(np.zeros((size, size)) if damping is None else damping, extra, 0.0),
            contact_map=np.hstack([rows, np.zeros((len(rows), extra))]), areas=np.ones(n), points=np.zeros((n, 3)))
        k, m, c = (np.asarray(part)[:whole, :whole] for part in (checked.stiffness, checked.mass, checked.damping))
        _check_sign(M=m, K=k, C=c)
        made = cls(mass=m, stiffness=k, damping=c + _modal(k, m, modal_damping), contact_map=rows, observed=observed,
                   springs=springs, modes=modes)
        if modes is not None and not 1 <= modes <= len(made._all_modes.squares):
            raise InputError(f"modes = {modes}: the structure has {len(made._all_modes.squares)} internal modes")
        return made

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the loads."""
        return tuple(self.observed)

    @property
    def linear(self) -> bool:
        """Return True: the matrices tell all."""
        return True

    def massless_boundary(self) -> MasslessBoundary:
        """Return the structure with a massless contact."""
        return self._boundary

    def dynamic_stiffness(self, frequency: float, loads: Complex) -> DynamicStiffness:
        """Return the relative dynamic stiffness at the harmonics of `frequency` (Hz) under loads (H + 1, i) in N."""
        omega, contact = 2.0 * float(np.pi) * frequency, len(self.contact_map)
        stiffness, load = np.empty((len(loads), contact, contact), dtype=complex), []
        for k, forces in enumerate(loads):
            known = np.zeros((len(self.mass) + contact, contact + 1), dtype=complex)
            known[:-contact, -1], known[-contact:, :-1] = self._rows.T @ forces, np.eye(contact)
            try:
                solution = np.linalg.solve(self._saddle(k * omega), known)[-contact:]
            except np.linalg.LinAlgError as error:
                raise InputError("K: a motion that moves no contact against another strains nothing, which a dynamic "
                                 'stiffness cannot hold; use method="quasi-static"') from error
            stiffness[k] = solution[:, :-1]
            load.append(-solution[:, -1])
        return DynamicStiffness(omega=omega, stiffness=stiffness, load=np.array(load))

    def motion_amplitudes(self, frequency: float, displacement: Complex, loads: Complex) -> _MatrixMotion:
        """Return internal coordinates and outputs for relative displacements (H + 1, 3 n) in m."""
        omega = 2.0 * np.pi * frequency
        x = np.array([np.linalg.solve(self._saddle(k * omega), np.concatenate([self._rows.T @ forces, u]))
                      for k, (forces, u) in enumerate(zip(loads, displacement, strict=True))])[:, :len(self.mass)]
        outputs = {name: squeezed((x @ row)[:, None]) for name, row in self.observed.items()}
        return _MatrixMotion(np.asarray(x @ self._kept_modes.project.T, dtype=complex), outputs)

    @cached_property
    def _rows(self) -> Array:
        rows: Array = np.reshape([*self.observed.values()], (len(self.observed), len(self.mass)))
        return rows

    def _saddle(self, omega: float) -> Complex:
        dynamic = self.stiffness + 1j * omega * self.damping - omega**2 * self.mass
        return np.block([[dynamic, -self.contact_map.T.astype(complex)],
                         [self.contact_map, np.diag(self.springs)]])

    @cached_property
    def _all_modes(self) -> _Modes:
        return self._open_modes() if self.springs.any() else self._massless_modes()

    def _open_modes(self) -> _Modes:
        """Return the modes of the open joint, on springs."""
        squares, phi = _eigen(self.stiffness, self.mass, "M", "every DOF needs a mass")
        contact, inputs = len(self.contact_map), len(self.observed)
        return _Modes(squares, phi, np.zeros((len(phi), contact)), np.zeros((len(phi), inputs)), phi.T @ self.mass,
                      np.diag(self.springs), self.contact_map @ phi, np.zeros((contact, inputs)))

    def _massless_modes(self) -> _Modes:
        """Return the modes of the joint without the mass by which its faces move against each other."""
        q, k, m = self.contact_map, self.stiffness, self.mass
        closed = null_space(q)
        eigenvalues, vectors = _eigen(closed.T @ k @ closed, closed.T @ m @ closed, "M",
                                      "every DOF besides the contact's needs a mass")
        phi = closed @ vectors
        lifted = np.linalg.pinv(q)
        moving = lifted - phi @ (phi.T @ m @ lifted)  # A
        try:
            flexibility = np.linalg.inv(np.linalg.cholesky(moving.T @ k @ moving))
        except np.linalg.LinAlgError as error:
            raise InputError("K: the contact's own motion strains nothing; every contact DOF needs a stiffness, or "
                             "give contact_compliance") from error
        flexibility = flexibility.T @ flexibility
        across = moving.T @ k @ phi
        motion = -flexibility @ across
        stiffness = np.diag(eigenvalues) + across.T @ motion
        squares, turned = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
        input_motion = flexibility @ moving.T @ self._rows.T
        return _Modes(squares, (phi + moving @ motion) @ turned, moving @ flexibility, moving @ input_motion,
                      turned.T @ (phi.T @ m), flexibility, motion @ turned, input_motion, moving.T @ m @ moving)

    @cached_property
    def _kept_modes(self) -> _Modes:
        """Return the lowest modes and the statics of the others; motions that strain nothing and touch nothing go."""
        all_modes = self._all_modes
        squares, motion = all_modes.squares, all_modes.motion
        size = float(np.abs(motion).max(initial=0.0))
        idle = (np.abs(squares) < RIGID * float(np.abs(squares).max(initial=1.0))) & (
            np.abs(motion).max(axis=0, initial=0.0) <= UNSEEN ** 0.5 * size)
        order = np.flatnonzero(~idle)
        kept = order[:len(order) if self.modes is None else self.modes]
        rest = np.setdiff1d(order, kept)
        if np.any(squares[rest] <= 0.0):
            raise InputError(f"modes = {self.modes}: leaves out a motion that strains nothing; keep more modes")
        soft = 1.0 / squares[rest]
        shape, push = all_modes.shape[:, rest], all_modes.shape[:, rest].T @ self._rows.T
        return self._turned(_Modes(
            squares[kept], all_modes.shape[:, kept], all_modes.contact + (shape * soft) @ motion[:, rest].T,
            all_modes.load + (shape * soft) @ push, all_modes.project[kept],
            all_modes.flexibility + (motion[:, rest] * soft) @ motion[:, rest].T, motion[:, kept],
            all_modes.input_motion + (motion[:, rest] * soft) @ push, all_modes.contact_mass))

    @staticmethod
    def _turned(modes: _Modes) -> _Modes:
        """Return other coordinates, of which only as many move the contact as it has DOF: the last ones."""
        contact, d = modes.motion.shape
        if d <= contact:
            return modes
        turn = np.linalg.svd(modes.motion)[2].T[:, ::-1]
        motion = modes.motion @ turn
        motion[:, :d - contact] = 0.0
        return _Modes(turn.T @ (modes.squares[:, None] * turn), modes.shape @ turn, modes.contact, modes.load,
                      turn.T @ modes.project, modes.flexibility, motion, modes.input_motion, modes.contact_mass)

    @cached_property
    def _boundary(self) -> MasslessBoundary:
        modes = self._kept_modes
        d, contact, inputs = len(modes.project), len(self.contact_map), len(self.observed)
        stiffness = np.diag(modes.squares) if modes.squares.ndim == 1 else modes.squares
        moved = np.hstack([modes.shape, modes.contact, modes.load])
        whole = moved.T @ self.damping @ moved
        damping = whole[:d, :d]
        return MasslessBoundary(
            flexibility=modes.flexibility, bare_stiffness=_inverse(modes.flexibility), motion=modes.motion,
            free=np.zeros((contact, 0)), transfer=modes.motion.T.copy(),
            internal=LinearInternal(mass=np.eye(d), damping=0.5 * (damping + damping.T),
                                    stiffness=0.5 * (stiffness + stiffness.T)),
            inputs=self.inputs, input_force=modes.shape.T @ self._rows.T, input_motion=modes.input_motion,
            input_free=np.zeros((0, inputs)), free_coupling=np.zeros((0, d)),
            sliding=modes.motion[0::3].mean(axis=0), contact_mass=modes.contact_mass,
            whole_damping=whole if modes.contact.any() else None,
            outputs={name: ObservedMotion(row[None] @ modes.shape, force=row[None] @ modes.contact,
                                          load=row[None] @ modes.load) for name, row in self.observed.items()})


def _rows(size: int, contact: Sequence[int] | NDArray[np.int64] | None, contact_map: Array | None) -> Array:
    if (contact is None) == (contact_map is None):
        raise InputError("contact: give either the numbers of the contact nodes or a contact_map")
    if contact_map is not None:
        rows = np.asarray(contact_map, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != size or not rows.size or rows.shape[0] % 3:
            raise InputError(f"contact_map: has the shape {rows.shape}, but three rows a contact point and {size} "
                             "columns are needed")
        return rows
    nodes: NDArray[np.int64] = np.asarray(contact)
    if not nodes.size or nodes.dtype.kind not in "iu" or size % 3 or nodes.min() < 0 or 3 * nodes.max() + 2 >= size:
        raise InputError(f"contact: {contact} must be whole numbers k, counted from 0, of nodes that have three of the "
                         f"{size} DOF, 3 k to 3 k + 2; give a contact_map where DOF are other than that")
    return np.asarray(np.eye(size)[(3 * nodes[:, None] + np.arange(3)).ravel()])


def _row(size: int, name: str, where: int | Array) -> Array:
    row: Array = np.zeros(size)
    if np.ndim(where):
        row = np.array(where, dtype=float)
        if row.shape != (size,):
            raise InputError(f"observe: {name} has the shape {row.shape}, but a row has {size} numbers, one a DOF")
        if not np.isfinite(row).all() or not row.any():
            raise InputError(f"observe: {name} must be finite numbers, and not zeros alone")
        return row
    if not isinstance(where, Integral):
        raise InputError(f"observe: {name} is {where!r}, which is no whole number of a DOF")
    if not 0 <= int(where) < size:
        raise InputError(f"observe: {name} is DOF {where}, but they run from 0 to {size - 1}")
    row[int(where)] = 1.0
    return row


def _check_sign(**matrices: Array) -> None:
    for name, matrix in matrices.items():
        squares = np.linalg.eigvalsh(matrix)
        if squares[0] < -RIGID * np.abs(squares).max():
            raise InputError(f"{name}: is not positive, its smallest eigenvalue is {squares[0]:.3g} and the largest "
                             f"{squares[-1]:.3g}; a structure of its own gives no energy")


def _padded(matrix: Array, extra: int, diagonal: float = 1.0) -> Array:
    if np.iscomplexobj(matrix):
        raise InputError("M, K and C: must be real; give damping as C or modal_damping")
    values = np.asarray(matrix, dtype=float)
    if not extra or values.ndim != 2 or values.shape[0] != values.shape[1]:
        return values
    wide = diagonal * np.eye(len(values) + extra)
    wide[:len(values), :len(values)] = values
    return wide


def _modal(stiffness: Array, mass: Array, ratio: float | None) -> Array:
    """Return the damping (N, N) that gives every mode of the open joint this ratio."""
    if ratio is None:
        return np.zeros_like(mass)
    if not 0.0 <= ratio < 1.0:
        raise InputError(f"modal_damping: {ratio} is no damping ratio between 0 and 1")
    squares, phi = _eigen(stiffness, mass, "modal_damping: M", "every DOF needs a mass; give C instead")
    weighed = mass @ phi
    damping: Array = weighed @ (2.0 * ratio * np.sqrt(np.maximum(squares, 0.0))[:, None] * weighed.T)
    return damping


def _eigen(stiffness: Array, mass: Array, name: str, remedy: str) -> tuple[Array, Array]:
    """Return eigenvalues and M-normalised modes."""
    try:
        squares, phi = eigh(stiffness, mass)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{name}: is not positive definite; {remedy}") from error
    if squares.size and squares[0] < -RIGID * float(np.abs(squares).max()):
        raise InputError(f"K: is not positive (eigenvalue {squares[0]:.1e} 1/s^2), as an elastic structure's is")
    return squares, phi


def _inverse(flexibility: Array) -> Array:
    inverse: NDArray[Any] = np.linalg.inv(flexibility)
    return np.asarray(0.5 * (inverse + inverse.T))
