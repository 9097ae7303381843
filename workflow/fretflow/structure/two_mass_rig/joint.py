"""The joint: two reduced specimens and the rig that moves one of them, condensed onto relative displacement.

The upper specimen's clamped face follows the arm (x, and z freely; y and rotations held); the lower one's
is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve
from scipy.linalg.lapack import dpotrf, dpotri

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.structure.reduction.reduced_specimen import OBSERVATION_DOFS, ReducedSpecimen
from fretflow.structure.structure import NORMAL_LOAD, DynamicStiffness, MasslessBoundary, ObservedMotion, Structure
from fretflow.structure.two_mass_rig.lumped import LumpedRig

MIRRORED = 256  # rows copied at once across the diagonal: both parts stay in cache
RIG_DOFS = 3  # block x, arm x, arm z: the first internal DOFs of the upper body
TRANSLATION = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])  # of a point, by arm motion (x, z)

INPUTS = ("block", "arm", NORMAL_LOAD)
DOWN = np.array([1.0, 1.0, -1.0])  # from the inputs to loads on block x, arm x and arm z

UNLOADED = np.zeros(0, dtype=complex)


@record
class JointMotion:
    """Motion away from the contact; complex amplitudes per harmonic."""

    rig: NDArray[np.complex128] = quantity("m", "(H + 1, 2), block and arm, x")
    upper_observation: NDArray[np.complex128] = quantity("m", "(H + 1, 3)")
    lower_observation: NDArray[np.complex128] = quantity("m", "(H + 1, 3)")

    @property
    def internal(self) -> NDArray[np.complex128]:
        """Return that of the internal coordinates, block and arm."""
        return self.rig

    @property
    def outputs(self) -> dict[str, NDArray[np.complex128]]:
        """Return the outputs by name."""
        return {"block": self.rig[:, 0], "arm": self.rig[:, 1], "upper": self.upper_observation,
                "lower": self.lower_observation}


class JointModel(Structure, Protocol):
    """A joint on the rig, dynamic or not (a `structure.structure.Structure`)."""

    @property
    def rig(self) -> LumpedRig:
        """Return the rig."""
        ...

    def with_rig(self, rig: LumpedRig) -> JointModel:
        """Return the joint on another rig."""
        ...

    def quasi_static(self) -> QuasiStaticJoint:
        """Return the joint with its specimens massless."""
        ...

    def motion_amplitudes(self, frequency: float, displacement: NDArray[np.complex128],
                          loads: NDArray[np.complex128]) -> JointMotion:
        """Return the rig's and the observation nodes' motion for relative displacements (H + 1, 3 n) in m."""
        ...


def rig_of(structure: Structure) -> JointModel:
    """Return `structure` as a joint on the rig.

    Raises
    ------
    InputError
        If it is none.
    """
    if not hasattr(structure, "rig"):
        raise InputError("acts on the two-mass rig, and the structure is another one; leave it out")
    return cast(JointModel, structure)


def change_rig(structure: Structure, **changes: Any) -> Structure:
    """Return a joint on the rig with other values of some of the rig's fields; `forces` are added.

    Raises
    ------
    InputError
        If the structure is not on the rig.
    """
    joint = rig_of(structure)
    changes["forces"] = (*joint.rig.forces, *changes.get("forces", ()))
    return joint.with_rig(replace(joint.rig, **changes))


class _OnRig:
    """What all joints on the rig share."""

    rig: LumpedRig

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the loads: x forces on block and arm, and what presses the arm down."""
        return INPUTS

    @property
    def linear(self) -> bool:
        """Return whether the rig is linear and its normal load constant."""
        return not self.rig.forces and self.rig.load_slope == self.rig.load_curvature == 0.0


@record
class QuasiStaticJoint(_OnRig):
    """Contact condensed statically: ``u = motion q + flexibility f`` with rigid arm motion q = (x, z).

    The arm feels ``motion^T f``; `rig` holds the masses, the specimen's own mass added to the arm's.
    The observation nodes move by ``(q_x, 0, q_z) + upper_compliance f`` and ``-lower_compliance f``.
    """

    stiffness: NDArray[np.float64] = quantity("N/m", "(3 n, 3 n)")
    flexibility: NDArray[np.float64] = quantity("m/N", "(3 n, 3 n)")
    motion: NDArray[np.float64] = quantity("1", "(3 n, 2)")
    rig: LumpedRig
    upper_compliance: NDArray[np.float64] = quantity("m/N", "(3, 3 n)")
    lower_compliance: NDArray[np.float64] = quantity("m/N", "(3, 3 n)")

    @classmethod
    def from_stiffness(cls, stiffness: NDArray[np.float64], rig: LumpedRig) -> QuasiStaticJoint:
        """Build a joint of a bare relative stiffness (3 n, 3 n) in N/m; it observes the back faces.

        Raises
        ------
        InputError
            If the stiffness is not symmetric positive definite or its size is not 3 n.
        """
        k = np.asarray(stiffness, dtype=float)
        if k.ndim != 2 or k.shape[0] != k.shape[1] or k.shape[0] % 3:
            raise InputError(f"relative stiffness: shape {k.shape} is not (3 n, 3 n); give x, y, z per node")
        if not np.allclose(k, k.T, rtol=0.0, atol=1e-9 * np.abs(k).max()):
            raise InputError("relative stiffness: not symmetric; give the stiffness of both bodies in series")
        none = np.zeros((3, len(k)))
        return cls(stiffness=0.5 * (k + k.T), flexibility=invert_stiffness(k, "relative stiffness"),
                   motion=_rigid_motion(len(k)), rig=rig, upper_compliance=none, lower_compliance=none)

    def quasi_static(self) -> QuasiStaticJoint:
        """Return the joint itself."""
        return self

    def with_rig(self, rig: LumpedRig) -> QuasiStaticJoint:
        """Return the joint on another rig."""
        return replace(self, rig=rig)

    def massless_boundary(self) -> MasslessBoundary:
        """Return the joint as solvers see it: coordinates block and arm x, and the arm's z free under the load."""
        return self._boundary

    @cached_property
    def _boundary(self) -> MasslessBoundary:
        size, none = len(self.stiffness), np.zeros((3, 2))
        by_arm = none.copy()
        by_arm[0, 1] = 1.0
        motion = np.column_stack([np.zeros(size), self.motion[:, 0]])
        block, arm = np.eye(2)[:, None]
        return MasslessBoundary(
            flexibility=self.flexibility, bare_stiffness=self.stiffness, motion=motion, free=self.motion[:, 1:],
            transfer=motion.T, internal=self.rig, inputs=INPUTS, input_force=np.eye(2, 3),
            input_motion=np.zeros((size, 3)), input_free=np.array([[0.0, 0.0, 1.0]]),
            free_coupling=np.array([[0.0, self.rig.load_slope]]), sliding=np.array([0.0, 1.0]), forces=self.rig.forces,
            free_curvature=np.array([[0.0, self.rig.load_curvature]]) if self.rig.load_curvature else None,
            outputs={"block": ObservedMotion(block), "arm": ObservedMotion(arm),
                     "upper": ObservedMotion(by_arm, free=np.eye(3)[:, 2:], force=self.upper_compliance),
                     "lower": ObservedMotion(none, force=-self.lower_compliance),
                     "approach": ObservedMotion(np.zeros((1, 2)), free=np.ones((1, 1)))})

    def dynamic_stiffness(self, frequency: float, loads: NDArray[np.complex128]) -> DynamicStiffness:
        """Return the relative dynamic stiffness at the harmonics of `frequency` (Hz) under loads (H + 1, 3) in N.

        With rig motion p = (block x, arm x, arm z), ``f = K (u - B p)`` and ``Zr p = g + B^T f``, so that
        ``Z = K - K B S^-1 B^T K`` and ``load = K B S^-1 g`` with ``S = Zr + B^T K B``.
        """
        coupling = self.stiffness @ self._lever
        series, loads = self._rig_series(frequency, loads), loads * DOWN
        solved = np.linalg.solve(series, np.broadcast_to(coupling.T, (len(series), *coupling.T.shape)))
        rig = np.linalg.solve(series, loads[..., None])[..., 0]
        return DynamicStiffness(omega=2.0 * float(np.pi) * frequency, load=rig @ coupling.T,
                                stiffness=(self.stiffness - coupling @ solved).astype(complex))

    def motion_amplitudes(self, frequency: float, displacement: NDArray[np.complex128],
                          loads: NDArray[np.complex128]) -> JointMotion:
        """Return the rig's and the observation nodes' motion for relative displacements (H + 1, 3 n) in m."""
        series, loads = self._rig_series(frequency, loads), loads * DOWN
        coupling = self.stiffness @ self._lever
        rig = np.linalg.solve(series, (loads + displacement @ coupling)[..., None])[..., 0]
        force = displacement @ self.stiffness - rig @ coupling.T
        upper, lower = self.observe(rig[:, 1:], force)
        return JointMotion(rig=np.asarray(rig[:, :2], dtype=complex), upper_observation=upper,
                           lower_observation=lower)

    def observe(self, arm: NDArray[Any], force: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return upper and lower observation displacements (N, 3) in m.

        `arm` is the arm's motion (x, z) in m, (N, 2); `force` the contact forces in N, (N, 3 n). Rows are
        time samples or harmonics.
        """
        return arm @ TRANSLATION.T + force @ self.upper_compliance.T, -(force @ self.lower_compliance.T)

    @property
    def _lever(self) -> NDArray[np.float64]:
        """Return B (3 n, 3): contact motion by rig motion (block x, arm x, arm z)."""
        return np.hstack([np.zeros((len(self.stiffness), 1)), self.motion])

    def _rig_series(self, frequency: float, loads: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return S (H + 1, 3, 3) of the rig for as many harmonics as the loads have; the arm's z has no impedance."""
        omegas = 2.0 * np.pi * frequency * np.arange(len(loads))
        series = np.zeros((len(loads), RIG_DOFS, RIG_DOFS), dtype=complex)
        series[:, :2, :2] = self.rig.impedance(omegas)
        series += self._lever.T @ self.stiffness @ self._lever
        return series


@record
class RigJoint(_OnRig):
    """Both specimens and the rig."""

    upper: ReducedSpecimen
    lower: ReducedSpecimen
    rig: LumpedRig

    def check(self) -> None:
        """Check that the contact nodes of both specimens match in number.

        Raises
        ------
        InputError
            If they do not.
        """
        if self.upper.contact_size != self.lower.contact_size:
            raise InputError(f"joint: {len(self.upper.contact_nodes)} contact nodes on the upper specimen, "
                             f"{len(self.lower.contact_nodes)} on the lower; mesh both faces alike")

    def dynamic_stiffness(self, frequency: float, loads: NDArray[np.complex128]) -> DynamicStiffness:
        """Return the relative dynamic stiffness at the harmonics of `frequency` (Hz) under loads (H + 1, 3) in N.

        Each body is condensed exactly onto its contact DOFs; then, with contact forces f and -f,
        ``Z = Z_A - Z_A (Z_A + Z_B)^-1 Z_A`` and ``load = g_A - Z_A (Z_A + Z_B)^-1 g_A``, which needs no
        inverse of Z_A, singular at harmonic 0 for the free vertical motion.
        """
        upper, lower = self._bodies()
        omega, size = 2.0 * float(np.pi) * frequency, self.upper.contact_size
        stiffness = np.empty((len(loads), size, size), dtype=complex)
        load = np.empty((len(loads), size), dtype=complex)
        for k, rig_load in enumerate(loads * DOWN):
            za, ga = upper.condensed(k * omega, rig_load)
            zb, _ = lower.condensed(k * omega, UNLOADED)
            solved = solve(za + zb, np.column_stack([za, ga]), check_finite=False)
            stiffness[k] = za - za @ solved[:, :-1]
            load[k] = ga - za @ solved[:, -1]
        return DynamicStiffness(omega=omega, stiffness=stiffness, load=load)

    def motion_amplitudes(self, frequency: float, displacement: NDArray[np.complex128],
                          loads: NDArray[np.complex128]) -> JointMotion:
        """Return the rig's and the observation nodes' motion for relative displacements (H + 1, 3 n) in m.

        ``Z_A (u + u_B) + Z_B u_B = g_A`` gives the lower face's motion, hence both bodies' inner DOFs.
        """
        upper, lower = self._bodies()
        harmonics, omega = len(displacement) - 1, 2.0 * np.pi * frequency
        rig = np.empty((harmonics + 1, 2), dtype=complex)
        observed = np.empty((2, harmonics + 1, OBSERVATION_DOFS), dtype=complex)
        for k, rig_load in enumerate(loads * DOWN):
            za, ga = upper.condensed(k * omega, rig_load)
            zb, _ = lower.condensed(k * omega, UNLOADED)
            face = solve(za + zb, ga - za @ displacement[k], check_finite=False)
            inner = upper.inner(k * omega, rig_load, displacement[k] + face)
            rig[k], observed[0, k] = inner[:2], inner[RIG_DOFS:RIG_DOFS + OBSERVATION_DOFS]
            observed[1, k] = lower.inner(k * omega, UNLOADED, face)[:OBSERVATION_DOFS]
        return JointMotion(rig=rig, upper_observation=observed[0], lower_observation=observed[1])

    def with_rig(self, rig: LumpedRig) -> RigJoint:
        """Return the joint on another rig."""
        return replace(self, rig=rig)

    def massless_boundary(self) -> MasslessBoundary:
        """Return the joint with its specimens massless, as solvers see it."""
        return self._massless.massless_boundary()

    @cached_property
    def _massless(self) -> QuasiStaticJoint:
        return self.quasi_static()

    def quasi_static(self) -> QuasiStaticJoint:
        """Return the joint with its specimens massless, but for the upper one's mass, added to the arm's."""
        size = self.upper.contact_size
        flexibility, compliances = np.zeros((size, size)), []
        for body in (self.upper, self.lower):
            clamped = _clamped(body)
            own = invert_stiffness(clamped.condensed(0.0, UNLOADED)[0].real, "contact stiffness of a specimen")
            flexibility += own
            compliances.append(clamped.static_inner_map()[:OBSERVATION_DOFS] @ own)
        arm_mass = self.rig.arm_mass + _sliding_mass(self.upper)
        return QuasiStaticJoint(
            stiffness=invert_stiffness(flexibility, "relative flexibility"), flexibility=flexibility,
            motion=_rigid_motion(size), rig=replace(self.rig, arm_mass=arm_mass),
            upper_compliance=compliances[0], lower_compliance=compliances[1])

    def _bodies(self) -> tuple[_Body, _Body]:
        return _on_rig(self.upper, self.rig), _clamped(self.lower)


@dataclass(frozen=True)
class _Body:
    """Matrices of one body, contact DOFs first, and their condensation at one angular frequency."""

    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]
    mass: NDArray[np.float64]
    contact: int

    def _blocks(self, omega: float) -> tuple[NDArray[np.complex128], ...]:
        z = self.stiffness - omega**2 * self.mass + 1j * omega * self.damping
        c = self.contact
        return z[:c, :c], z[:c, c:], z[c:, :c], z[c:, c:]

    def _load(self, rig_load: NDArray[np.complex128]) -> NDArray[np.complex128]:
        load = np.zeros(len(self.stiffness) - self.contact, dtype=complex)
        load[:len(rig_load)] = rig_load
        return load

    def condensed(self, omega: float, rig_load: NDArray[np.complex128]
                  ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the dynamic stiffness of the contact DOFs and the load carried to them."""
        cc, ci, ic, ii = self._blocks(omega)
        solved = solve(ii, np.column_stack([ic, self._load(rig_load)]), check_finite=False)
        return cc - ci @ solved[:, :-1], -(ci @ solved[:, -1])

    def inner(self, omega: float, rig_load: NDArray[np.complex128],
              contact: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the inner DOFs that follow from the contact DOFs."""
        _, _, ic, ii = self._blocks(omega)
        return np.asarray(solve(ii, self._load(rig_load) - ic @ contact, check_finite=False))

    def static_inner_map(self) -> NDArray[np.float64]:
        """Return the matrix from contact to inner DOFs at rest, (inner, contact)."""
        c = self.contact
        return np.asarray(-solve(self.stiffness[c:, c:], self.stiffness[c:, :c], check_finite=False))


def _clamped(body: ReducedSpecimen) -> _Body:
    """Return `body` with its clamped face fixed; inner DOFs are observation and modal."""
    kept = np.r_[:body.contact_size, body.observation.start:len(body.stiffness)]
    pick = np.ix_(kept, kept)
    return _Body(body.stiffness[pick], body.damping[pick], body.mass[pick], body.contact_size)


def _on_rig(body: ReducedSpecimen, rig: LumpedRig) -> _Body:
    """Return `body` on the arm; inner DOFs are block x, arm x, arm z, observation and modal."""
    c, face = body.contact_size, body.rigid.start
    kept = np.r_[:c, face, face + 2, body.observation.start:len(body.stiffness)]
    block = c  # the block has no counterpart in the specimen: its row is inserted behind the contact
    place = np.delete(np.arange(len(kept) + 1), block)

    def assembled(specimen: NDArray[np.float64], lumped: NDArray[np.float64]) -> NDArray[np.float64]:
        matrix = np.zeros((len(kept) + 1, len(kept) + 1))
        matrix[np.ix_(place, place)] = specimen[np.ix_(kept, kept)]
        matrix[block:block + 2, block:block + 2] += lumped
        return matrix

    return _Body(assembled(body.stiffness, rig.stiffness), assembled(body.damping, rig.damping),
                 assembled(body.mass, rig.mass), c)


def _sliding_mass(body: ReducedSpecimen) -> float:
    """Return the mass that a rigid translation in x moves, in kg."""
    x = np.zeros(len(body.mass))
    x[0:body.contact_size:3] = x[body.rigid.start] = x[body.observation.start] = 1.0
    return float(x @ body.mass @ x)


def _rigid_motion(size: int) -> NDArray[np.float64]:
    """Return the motion (3 n, 2) of the contact nodes by arm motion (x, z)."""
    return np.tile(TRANSLATION, (size // 3, 1))


def invert_stiffness(matrix: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return the symmetric inverse of a positive definite matrix."""
    factor, failed = dpotrf(matrix.T)  # by columns, as LAPACK reads it
    if failed:
        raise InputError(f"{name}: not positive definite; a body is not held, or its mesh broken")
    inverse = dpotri(factor, overwrite_c=True)[0].T
    for first in range(0, len(inverse), MIRRORED):
        rows, rest = slice(first, first + MIRRORED), slice(first + MIRRORED, None)
        inverse[rows, rest] = inverse[rest, rows].T
        inverse[rows, rows] = np.tril(inverse[rows, rows]) + np.tril(inverse[rows, rows], -1).T
    return np.asarray(inverse)
