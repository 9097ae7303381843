"""A joint condensed once for many harmonics: its bodies as polynomials of frequency, its rig exact.

Both bodies have proportional damping, so their dynamic stiffness is ``(1 + s b) (K + x M)`` at s = i w, with
``x = (s^2 + s a) / (1 + s b)``. With its back face held each body is analytic in x up to its first natural frequency,
two orders of magnitude above the harmonics: few terms of a polynomial in x, fitted at Chebyshev nodes, are exact to
round-off there. What resonates is the rig, and that enters by three DOFs: the relative stiffness of a harmonic is
these few real matrices and a term of rank three.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import eigsh

from fretflow.core.records import quantity, record
from fretflow.structure.mirror import MirrorPlane
from fretflow.structure.reduction.reduced_specimen import OBSERVATION_DOFS, ReducedSpecimen
from fretflow.structure.structure import Structure
from fretflow.structure.two_mass_rig.joint import (
    DOWN,
    RIG_DOFS,
    TRANSLATION,
    JointMotion,
    QuasiStaticJoint,
    RigJoint,
    invert_stiffness,
)
from fretflow.structure.two_mass_rig.lumped import LumpedRig

REACH = 1.0 / 20.0  # highest frequency of the fit, by the lowest of the bodies'
TERMS = 4  # which at that reach leaves 1e-13 of the stiffness
NEGLIGIBLE = 1e-15  # a term below this share of the first is left out
SINGLE = float(np.finfo(np.float32).eps)


class RelativeStiffness(NamedTuple):
    """``Z_k = sum_t weights[k, t] terms[t] - levers_k cores_k levers_k^T`` and the load, at harmonics 0..H.

    Attributes
    ----------
    terms : (T, 3 n, 3 n)
        Real symmetric matrices in N/m, the first of them static.
    weights : (H + 1, T)
        Complex; that of the first term is one at rest.
    levers : (H + 1, 3 n, 3)
        Contact forces in N/m that hold the contact where a rig DOF moves.
    cores : (H + 1, 3, 3)
        Receptance of the rig in m/N, the contact being held.
    load : (H + 1, 3 n)
        Complex amplitudes in N.
    """

    terms: NDArray[np.float64]
    weights: NDArray[np.complex128]
    levers: NDArray[np.complex128]
    cores: NDArray[np.complex128]
    load: NDArray[np.complex128]

    def apply(self, u: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return Z u for complex amplitudes (H + 1, 3 n); each real matrix is read once for all harmonics."""
        parts = u.view(u.real.dtype).reshape(*u.shape, 2).transpose(0, 2, 1).reshape(-1, u.shape[1])
        held = self.cores @ (_transposed(self.levers) @ u[:, :, None])
        product = -(self.levers @ held)[:, :, 0]
        for weight, term in zip(self.weights.T, self.terms, strict=True):
            real = (parts @ term).reshape(len(u), 2, -1)
            product += weight[:, None] * (real[:, 0] + 1j * real[:, 1])
        return np.asarray(product)

    def real_part(self, harmonic: int) -> NDArray[np.float64]:
        """Return the real part of Z at one harmonic, (3 n, 3 n) in N/m."""
        weights, lever = self.weights[harmonic].real, self.levers[harmonic]
        static = np.tensordot(weights, self.terms, axes=1)
        moved = lever @ self.cores[harmonic]
        static -= np.hstack([moved.real, -moved.imag]) @ np.hstack([lever.real, lever.imag]).T
        return static

    def up_to(self, harmonics: int) -> RelativeStiffness:
        """Return the first harmonics, 0..`harmonics`."""
        return RelativeStiffness(self.terms, *(part[:harmonics + 1] for part in self[1:]))

    def single(self) -> RelativeStiffness:
        """Return it in single precision, without the terms that this cannot tell."""
        kept = self._told(SINGLE)
        complexes: Any = (one.astype(np.complex64) for one in (self.weights[:, kept], *self[2:]))
        return RelativeStiffness(self.terms[kept].astype(np.float32), *complexes)

    def _told(self, share: float) -> NDArray[np.bool_]:
        """Return which terms are above `share` of the first one."""
        sizes = np.abs(self.weights).max(axis=0) * [np.abs(term).max() for term in self.terms]
        return np.asarray(sizes > share * sizes[0])


@record
class CondensedJoint:
    """Polynomials in ``x / scale``, lowest power first; every term is a matrix over the contact DOFs or the rig's.

    With contact forces f and the arm's motion p = (x, z): ``f = (1 + s b) stiffness (u + lever p)``; the arm feels
    ``-lever^T f`` and the inertia ``(1 + s b) arm``. The observation nodes move by ``upper_lever p + upper_compliance
    f / (1 + s b)`` and ``-lower_compliance f / (1 + s b)``.
    """

    stiffness: NDArray[np.float64] = quantity("N/m", "(T, 3 n, 3 n)")
    lever: NDArray[np.float64] = quantity("1", "(T, 3 n, 2)")
    arm: NDArray[np.float64] = quantity("N/m", "(T, 2, 2)")
    upper_compliance: NDArray[np.float64] = quantity("m/N", "(T, 3, 3 n)")
    upper_lever: NDArray[np.float64] = quantity("1", "(T, 3, 2)")
    lower_compliance: NDArray[np.float64] = quantity("m/N", "(T, 3, 3 n)")
    scale: float = quantity("1/s^2")
    rayleigh_mass: float = quantity("1/s")
    rayleigh_stiffness: float = quantity("s")
    rig: LumpedRig
    plane: MirrorPlane | None = None  # that it is one side of, n being the nodes kept

    def reaches(self, frequency: float, harmonics: int) -> bool:
        """Return whether the polynomials hold up to that harmonic of `frequency` (Hz)."""
        return (2.0 * np.pi * frequency * harmonics) ** 2 <= self.scale

    @cached_property
    def spectral_radius(self) -> float:
        """Return the largest eigenvalue of the static stiffness by node in N/m.

        Of one side that is with the rig held: where specimens are alike, turned over, antisymmetric motions, which the
        rig does not feel, are as stiff, and the value is that of both sides.
        """
        if self.plane is None:
            return spectral_radius(self.relative(1.0, np.zeros((1, RIG_DOFS), dtype=complex)).real_part(0))
        size = np.sqrt(np.repeat(self.plane.times, 3))  # a node that stands for two is as stiff as both
        return spectral_radius(self.stiffness[0] / size / size[:, None])

    def relative(self, frequency: float, loads: NDArray[np.complex128]) -> RelativeStiffness:
        """Return relative stiffness and load at the harmonics of `frequency` (Hz) under loads (H + 1, 3) in N."""
        harmonics = len(loads) - 1
        powers, damped = self._powers(frequency, harmonics)
        size = self.stiffness.shape[1]
        levers = np.zeros((harmonics + 1, size, RIG_DOFS), dtype=complex)
        arm = _at(powers, self.lever)
        for t, term in enumerate(self.stiffness):
            levers[:, :, 1:] += (powers[:, t] * damped)[:, None, None] * _product(term, arm)
        series = np.zeros((harmonics + 1, RIG_DOFS, RIG_DOFS), dtype=complex)
        series[:, :2, :2] = self.rig.impedance(_omegas(frequency, harmonics))
        series[:, 1:, 1:] += damped[:, None, None] * _at(powers, self.arm) + _transposed(arm) @ levers[:, :, 1:]
        cores = np.linalg.inv(series)
        held = cores @ (loads * DOWN)[:, :, None]
        whole = RelativeStiffness(terms=self.stiffness, weights=powers * damped[:, None], levers=levers, cores=cores,
                                  load=-(levers @ held)[:, :, 0])
        kept = whole._told(NEGLIGIBLE)
        return whole if kept.all() else whole._replace(terms=whole.terms[kept], weights=whole.weights[:, kept])

    def motion_amplitudes(self, frequency: float, displacement: NDArray[np.complex128],
                          loads: NDArray[np.complex128]) -> JointMotion:
        """Return the rig's and the observation nodes' motion for relative displacements (H + 1, 3 n) in m."""
        harmonics = len(displacement) - 1
        powers, damped = self._powers(frequency, harmonics)
        relative = self.relative(frequency, loads)
        held = _transposed(relative.levers) @ displacement[:, :, None]
        rig = relative.cores @ ((loads * DOWN)[:, :, None] - held)
        pressed = (relative.apply(displacement) - relative.load)[:, :, None] / damped[:, None, None]
        upper = _at(powers, self.upper_lever) @ rig[:, 1:] + _at(powers, self.upper_compliance) @ pressed
        lower = -_at(powers, self.lower_compliance) @ pressed
        return JointMotion(rig=rig[:, :2, 0], upper_observation=upper[:, :, 0],
                           lower_observation=np.asarray(lower[:, :, 0], dtype=complex))

    def _powers(self, frequency: float, harmonics: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the powers (H + 1, T) of x and the factors ``1 + s b`` (H + 1,)."""
        s = 1j * _omegas(frequency, harmonics)
        damped = 1.0 + s * self.rayleigh_stiffness
        x = (s**2 + s * self.rayleigh_mass) / damped / self.scale
        return np.asarray(x[:, None] ** np.arange(len(self.stiffness))), damped


def spectral_radius(stiffness: NDArray[np.float64]) -> float:
    """Return the largest eigenvalue of a symmetric stiffness, N/m: the penalty of Charleux et al. (2006)."""
    first = np.random.default_rng(0).normal(size=len(stiffness))  # Lanczos from a fixed vector: repeatable
    return float(eigsh(stiffness, k=1, which="LM", v0=first, return_eigenvectors=False)[0])


def condensed(joint: Structure, plane: MirrorPlane | None = None) -> CondensedJoint | None:
    """Return `joint` condensed, or None where it has no such form: springs in series, bodies damped differently.

    Of a joint that is symmetric about a `plane` the nodes on one side alone are kept.
    """
    if isinstance(joint, QuasiStaticJoint):
        return _massless(joint, plane)
    if isinstance(joint, RigJoint) and _damping(joint.upper) == _damping(joint.lower):
        return _elastic(joint, plane)
    return None


def _massless(joint: QuasiStaticJoint, plane: MirrorPlane | None) -> CondensedJoint:
    stiffness, motion = joint.stiffness, joint.motion
    upper, lower = joint.upper_compliance, joint.lower_compliance
    if plane is not None and not (plane.is_kept_by(stiffness) and plane.is_symmetric(motion.T)):
        plane = None
    if plane is not None:
        stiffness, motion = plane.stiffness(stiffness), plane.mean(motion.T).T
        upper, lower = plane.mean(upper), plane.mean(lower)
    return CondensedJoint(
        stiffness=stiffness[None], lever=-motion[None], arm=np.zeros((1, 2, 2)), upper_compliance=upper[None],
        upper_lever=TRANSLATION[None].copy(), lower_compliance=lower[None], scale=float("inf"), rayleigh_mass=0.0,
        rayleigh_stiffness=0.0, rig=joint.rig, plane=plane)


def _elastic(joint: RigJoint, plane: MirrorPlane | None) -> CondensedJoint:
    """Evaluate the bodies at Chebyshev nodes of x in [-scale, 0] and fit the polynomials through them."""
    lowest = min(joint.upper.full_frequencies.min(), joint.lower.full_frequencies.min())
    scale = float((2.0 * np.pi * REACH * lowest) ** 2)
    nodes = -0.5 * (1.0 - np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS))
    values = []
    for node in nodes:
        upper, seen = _free_of_inner(joint.upper, float(node) * scale, joint.upper.rigid.start + np.array([0, 2]))
        lower, seen_below = _free_of_inner(joint.lower, float(node) * scale, np.zeros(0, dtype=np.int64))
        if plane is not None:
            c = len(lower)
            if not (plane.is_kept_by(upper[:c, :c]) and plane.is_kept_by(lower) and plane.is_symmetric(upper[c:, :c])):
                return _elastic(joint, None)
            upper, seen = _half(upper, plane), _half_columns(seen, plane)
            lower, seen_below = _half(lower, plane), _half_columns(seen_below, plane)
        values.append(_bodies(upper, seen, lower, seen_below))
    fit = np.linalg.inv(np.vander(nodes, increasing=True))

    def terms(pick: Callable[[_Bodies], NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.asarray(np.einsum("tj,j...->t...", fit, np.stack([pick(value) for value in values])))

    return CondensedJoint(
        stiffness=terms(lambda v: v.stiffness), lever=terms(lambda v: v.lever), arm=terms(lambda v: v.arm),
        upper_compliance=terms(lambda v: v.upper_compliance), upper_lever=terms(lambda v: v.upper_lever),
        lower_compliance=terms(lambda v: v.lower_compliance), scale=scale, rig=joint.rig,
        rayleigh_mass=joint.upper.rayleigh_mass, rayleigh_stiffness=joint.upper.rayleigh_stiffness, plane=plane)


class _Bodies(NamedTuple):
    """Both bodies at one x, as the terms of `CondensedJoint`."""

    stiffness: NDArray[np.float64]
    lever: NDArray[np.float64]
    arm: NDArray[np.float64]
    upper_compliance: NDArray[np.float64]
    upper_lever: NDArray[np.float64]
    lower_compliance: NDArray[np.float64]


def _bodies(upper: NDArray[np.float64], seen: NDArray[np.float64], lower: NDArray[np.float64],
            seen_below: NDArray[np.float64]) -> _Bodies:
    """Return both at one x by their stiffness, that of the arm's x and z last, and what observation nodes move by."""
    c = len(lower)
    across = upper[:c, c:]
    flexibility = invert_stiffness(upper[:c, :c], "contact stiffness of the upper specimen")
    lever = flexibility @ across
    flexibility_below = invert_stiffness(lower, "contact stiffness of the lower specimen")
    return _Bodies(
        stiffness=invert_stiffness(flexibility + flexibility_below, "relative flexibility"), lever=lever,
        arm=upper[c:, c:] - across.T @ lever, upper_compliance=seen[:, :c] @ flexibility,
        upper_lever=seen[:, c:] - seen[:, :c] @ lever, lower_compliance=seen_below @ flexibility_below)


def _half(matrix: NDArray[np.float64], plane: MirrorPlane) -> NDArray[np.float64]:
    """Return a stiffness of contact DOFs, and of others behind them, for the nodes on one side of a plane."""
    c = 3 * plane.nodes
    across = plane.total(matrix[c:, :c])
    return np.block([[plane.stiffness(matrix[:c, :c]), across.T], [across, matrix[c:, c:]]])


def _half_columns(rows: NDArray[np.float64], plane: MirrorPlane) -> NDArray[np.float64]:
    """Return rows by contact DOFs, and by others behind them, for the nodes on one side of a plane."""
    c = 3 * plane.nodes
    return np.hstack([plane.total(rows[:, :c]), rows[:, c:]])


def _product(matrix: NDArray[np.float64], stack: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return a real matrix (m, n) times each of a complex stack (K, n, c), reading the matrix once."""
    k, n, c = stack.shape
    columns = np.ascontiguousarray(stack.transpose(1, 0, 2)).reshape(n, k * c).view(float)
    return np.asarray((matrix @ columns).view(complex).reshape(len(matrix), k, c).transpose(1, 0, 2))


def _free_of_inner(body: ReducedSpecimen, x: float, face: NDArray[np.int64]
                   ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``K + x M`` of contact and `face` DOFs, and the observation node's motion by theirs (3, kept).

    Observation and modal DOFs are free of force, the other DOFs of the clamped face are held.
    """
    kept = np.r_[:body.contact_size, face].astype(int)
    inner = np.r_[body.observation.start:len(body.stiffness)]

    def part(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        block = np.ix_(rows, columns)
        return np.asarray(body.stiffness[block] + x * body.mass[block])

    across = part(inner, kept)
    answer = -cho_solve(cho_factor(part(inner, inner), lower=True), across)
    return np.asarray(part(kept, kept) + across.T @ answer), answer[:OBSERVATION_DOFS]


def _at(powers: NDArray[np.complex128], terms: NDArray[np.float64]) -> NDArray[Any]:
    """Return the polynomials with coefficients `terms` (T, ...) at every harmonic, (H + 1, ...)."""
    return np.asarray(np.einsum("kt,t...->k...", powers, terms))


def _transposed(stack: NDArray[Any]) -> NDArray[Any]:
    return stack.transpose(0, 2, 1)


def _damping(body: ReducedSpecimen) -> tuple[float, float]:
    return body.rayleigh_mass, body.rayleigh_stiffness


def _omegas(frequency: float, harmonics: int) -> NDArray[np.float64]:
    return np.asarray(2.0 * np.pi * frequency * np.arange(harmonics + 1))
