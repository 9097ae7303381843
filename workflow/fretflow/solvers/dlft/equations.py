"""The DLFT equations: residual and exact Jacobian of one period.

Tubita, Fantetti, Blanc, Thouverez (2021), equations (3)-(8), after Nacivet et al., J. Sound Vib. 265 (2003)
201-219. In the signs used here the contact force is ``f = (Z u - load) - eps (u - x)``, where x obeys the
contact law in time and u are the harmonics that are kept. The prediction is ``f_u = Z u - load - eps u``;
the correction ``eps x``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.law import ContactLaw
from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.dlft.march import PeriodicFriction, friction_derivative, periodic_friction
from fretflow.solvers.dlft.preconditioner import NodePreconditioner, bands
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix, to_complex, to_real
from fretflow.solvers.newton import LARGE, Operator


class Evaluation(NamedTuple):
    """The contact forces of one iterate.

    Attributes
    ----------
    residual : (2 H + 1, 3 n)
        ``Z u - load - f`` in N.
    drive : (N, nodes, 3)
        ``f_u`` in N, the force that a node held at x = 0 would carry.
    trial_normal : (N, nodes)
        Normal force that contact would need, N; a node is open where it is not positive.
    friction : PeriodicFriction
        Tangential forces.
    limit : (N, nodes)
        Radius of the friction disc, N.
    force : (N, nodes, 3)
        Contact force on the upper nodes, N; it obeys the contact law at every sample.
    """

    residual: NDArray[np.float64]
    drive: NDArray[np.float64]
    trial_normal: NDArray[np.float64]
    friction: PeriodicFriction
    limit: NDArray[np.float64]
    force: NDArray[np.float64]


@record
class DlftEquations:
    """One joint at one frequency; the unknowns are u (2 H + 1, 3 n) in m, real coefficients."""

    stiffness: Stiffness
    load: NDArray[np.complex128] = quantity("N", "(H + 1, 3 n)")
    gap: NDArray[np.float64] = quantity("m", "(nodes,)")
    law: ContactLaw
    penalty: NDArray[np.float64] | float = quantity("N/m", "() or (nodes,)")
    samples: int

    def check(self) -> None:
        """Check the penalty and the number of samples.

        Raises
        ------
        InputError
            If the penalty is not positive or the samples cannot tell the harmonics apart.
        """
        if not np.all(np.asarray(self.penalty) > 0.0):
            raise InputError(f"penalty = {self.penalty}: must be positive")
        if self.samples <= 2 * self.harmonics:
            raise InputError(f"samples = {self.samples}: too few for {self.harmonics} harmonics; "
                             f"at least {2 * self.harmonics + 1} are needed")

    @property
    def harmonics(self) -> int:
        """Return H."""
        return len(self.load) - 1

    @property
    def scale(self) -> float:
        """Return the size of the load in N: the norm of its resultants over all harmonics."""
        return float(np.linalg.norm(self.load.reshape(len(self.load), -1, 3).sum(axis=1))) or 1.0

    @cached_property
    def synthesis(self) -> NDArray[np.float64]:
        """Return the matrix (N, 2 H + 1) from coefficients to samples."""
        return synthesis_matrix(self.harmonics, self.samples)

    @cached_property
    def analysis(self) -> NDArray[np.float64]:
        """Return the matrix (2 H + 1, N) from samples to coefficients."""
        return analysis_matrix(self.harmonics, self.samples)

    @cached_property
    def _single(self) -> Stiffness:
        return self.stiffness.single()

    @cached_property
    def _single_parts(self) -> tuple[NDArray[np.float32], ...]:
        return tuple(self._single.real_part(k).astype(np.float32) for k in bands(self.harmonics)[0])

    def up_to(self, harmonics: int) -> DlftEquations:
        """Return the equations that keep only the first harmonics, 0..`harmonics`."""
        return replace(self, stiffness=self.stiffness.up_to(harmonics), load=self.load[:harmonics + 1])

    @property
    def _penalties(self) -> NDArray[np.float64]:
        """Return the penalty of each DOF (3 n,), N/m."""
        return np.repeat(np.broadcast_to(self.penalty, len(self.gap)), 3)

    def apply_stiffness(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return Z u, real coefficients (2 H + 1, 3 n) in N."""
        return to_real(self.stiffness.apply(to_complex(u)))

    def evaluate(self, u: NDArray[np.float64]) -> Evaluation:
        """Return the residual and the contact forces at `u`."""
        linear = self.apply_stiffness(u) - to_real(self.load)
        drive = (self.synthesis @ (linear - self._penalties * u)).reshape(self.samples, -1, 3)
        trial_normal = drive[:, :, 2] - self.penalty * self.gap
        normal = np.maximum(trial_normal, 0.0)
        limit = self.law.slip_limit(normal)
        friction = periodic_friction(drive[:, :, 0] + 1j * drive[:, :, 1], limit)
        force = np.stack([friction.force.real, friction.force.imag, normal], axis=2)
        residual = linear - self.analysis @ force.reshape(self.samples, -1)
        return Evaluation(residual, drive, trial_normal, friction, limit, force)

    def contact_displacement(self, at: Evaluation) -> NDArray[np.float64]:
        """Return x (N, nodes, 3) in m: the displacement in time that obeys the contact law."""
        return np.asarray((at.force - at.drive) / self._penalties.reshape(-1, 3))

    def force_derivative(self, at: Evaluation) -> NDArray[np.float64]:
        """Return D (nodes, 2 H + 1, 3, 2 H + 1, 3): coefficients of the contact force by those of `drive`."""
        closed = (at.trial_normal > 0.0).astype(float)
        rate = closed * self.law.slip_limit_slope(np.maximum(at.trial_normal, 0.0))
        tangential = friction_derivative(at.friction, at.limit, rate, self.synthesis, self.analysis)
        q = len(self.analysis)
        derivative = np.zeros((closed.shape[1], q, 3, q, 3))
        derivative[:, :, 0] = tangential.real.transpose(0, 1, 3, 2)
        derivative[:, :, 1] = tangential.imag.transpose(0, 1, 3, 2)
        products = (self.analysis[:, None, :] * self.synthesis.T[None, :, :]).reshape(q * q, -1)
        derivative[:, :, 2, :, 2] = (products @ closed).T.reshape(-1, q, q)
        return derivative

    def linearise(self, at: Evaluation, before: Operator | None = None) -> tuple[Operator, Operator]:
        """Return the products with the Jacobian ``Z - D (Z - eps I)`` and with its approximate inverse.

        In large systems, where the matrices of Z are read from memory, the former takes them in single precision: a
        step of Newton's method needs no more, and the residual is of the whole Z. The latter keeps the factors of the
        one `before`, of another iterate, where it is given.
        """
        derivative = self.force_derivative(at)
        nodes, q = len(derivative), len(self.analysis)
        blocks, penalties = derivative.reshape(nodes, 3 * q, 3 * q), self._penalties

        def apply(flat: NDArray[np.float64]) -> NDArray[np.float64]:
            v = flat.reshape(q, 3 * nodes)
            zv = self.apply_stiffness(v) if 3 * nodes < LARGE else to_real(
                self._single.apply(to_complex(v).astype(np.complex64)))
            drive = (zv - penalties * v).reshape(q, nodes, 3).transpose(1, 0, 2)
            force = blocks @ drive.reshape(nodes, 3 * q, 1)
            return np.asarray((zv - force.reshape(nodes, q, 3).transpose(1, 0, 2).reshape(q, -1)).ravel())

        kept = before if isinstance(before, NodePreconditioner) else None
        return apply, NodePreconditioner(derivative, self._single_parts, self.penalty, kept)


class Stiffness(Protocol):
    """Dynamic stiffness Z at harmonics 0..H; `rig.condensed.RelativeStiffness` is one."""

    def apply(self, u: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return Z u in N for complex amplitudes (H + 1, 3 n) in m."""
        ...

    def real_part(self, harmonic: int) -> NDArray[np.float64]:
        """Return the real part of Z at one harmonic, (3 n, 3 n) in N/m."""
        ...

    def up_to(self, harmonics: int) -> Stiffness:
        """Return the first harmonics, 0..`harmonics`."""
        ...

    def single(self) -> Stiffness:
        """Return it in single precision."""
        ...


class DenseStiffness(NamedTuple):
    """One dense complex matrix a harmonic, (H + 1, 3 n, 3 n) in N/m."""

    matrices: NDArray[np.complex128]

    def apply(self, u: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return Z u in N for complex amplitudes (H + 1, 3 n) in m."""
        return np.asarray((self.matrices @ u[:, :, None])[:, :, 0])

    def real_part(self, harmonic: int) -> NDArray[np.float64]:
        """Return the real part of Z at one harmonic, (3 n, 3 n) in N/m."""
        return np.asarray(self.matrices[harmonic].real)

    def up_to(self, harmonics: int) -> DenseStiffness:
        """Return the first harmonics, 0..`harmonics`."""
        return DenseStiffness(self.matrices[:harmonics + 1])

    def single(self) -> DenseStiffness:
        """Return it in single precision."""
        return DenseStiffness(self.matrices.astype(np.complex64))
