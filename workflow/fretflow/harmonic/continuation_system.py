"""The rig on its contact as equations in the arm's motion and the frequency, solved along a curve.

Unknowns are y = (a, omega): the arm's coefficients and the angular frequency. The contact is rate-independent, so
that its friction force does not depend on omega and the derivatives of

    R(a, omega) = Z(omega) a - g(omega) - Phi[a]

are exact: dR/da from the march of the contact, dR/domega from the rig alone. One row more, ``t . (y - y_0) = 0`` in
scaled unknowns, makes the system square also at turning points (Keller 1977).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.harmonic.arm import ArmEquations, real_blocks
from fretflow.harmonic.contact_march import ContactMarch, PeriodicMarch, Trajectory
from fretflow.harmonic.contact_sample import Array, ContactSystem, SampleState
from fretflow.harmonic.fourier import to_real
from fretflow.harmonic.jenkins_start import jenkins_arm_motion
from fretflow.harmonic.periodic import PeriodicProblem
from fretflow.harmonic.quasi_static import NEAR
from fretflow.rig.lumped import LumpedRig

SHORTEST_STEP = 0.1  # of a Newton step; beyond that a shorter arc is cheaper
ACROSS = 2.0  # growth of the residual that is let pass
MAX_ACROSS = 3  # times
SMALL = 1e-9  # m, the scale of an arm at rest


@dataclass(frozen=True)
class Point:
    """Arm coefficients (2 H + 1,) in m, omega in rad/s and what they make.

    `residual` (2 H + 1,) N; `jacobian` (2 H + 1, 2 H + 1) N/m; `rate` (2 H + 1,) N s, the residual's derivative by
    omega; `norm` of the residual relative to the excitation.
    """

    arm: Array
    omega: float
    period: PeriodicMarch
    residual: Array
    jacobian: Array
    rate: Array
    norm: float
    iterations: int = 0

    @property
    def scales(self) -> Array:
        """Return the lengths (2 H + 2,) of the unknowns: the arm's amplitude and the frequency themselves."""
        return np.append(np.full(len(self.arm), np.linalg.norm(self.arm)), self.omega)

    @property
    def end(self) -> SampleState:
        """Return the contact at the end of the period, which is the one before its beginning."""
        return self.period.trajectory.sample(-1)

    @property
    def matrix(self) -> Array:
        """Return the derivative (2 H + 1, 2 H + 2) of R by the unknowns."""
        return np.column_stack([self.jacobian, self.rate])

    @property
    def unknowns(self) -> Array:
        """Return (a, omega)."""
        return np.append(self.arm, self.omega)


def arm_rates(rig: LumpedRig, omega: float, excitation: float, harmonics: int) -> tuple[Array, Array]:
    """Return the derivatives by omega of the arm's impedance and of its load.

    With the block eliminated, ``Z_a = v^T z v`` for ``v = (-z_ba / z_bb, 1)``, at which it is stationary, so that
    ``dZ_a = v^T dz v``; the load is ``v_b F``.

    Returns
    -------
    (2 H + 1, 2 H + 1), (2 H + 1,)
        In N s/m and N s.
    """
    order = np.arange(harmonics + 1)
    z = rig.impedance(omega * order)
    slope = order[:, None, None] * (-2.0 * omega * order[:, None, None] * rig.mass + 1j * rig.damping)
    carried = -z[:, 0, 1] / z[:, 0, 0]
    arm = slope[:, 0, 0] * carried**2 + 2.0 * slope[:, 0, 1] * carried + slope[:, 1, 1]
    load = np.zeros(harmonics + 1, dtype=complex)
    load[1] = -(slope[1, 0, 1] + carried[1] * slope[1, 0, 0]) / z[1, 0, 0] * excitation
    return real_blocks(arm), to_real(load)


class ArmSystem:
    """The equations of one problem, at any frequency, on fixed harmonics and samples."""

    def __init__(self, problem: PeriodicProblem, harmonics: int, samples: int, tolerance: float,
                 max_iterations: int) -> None:
        self.problem = problem
        self.joint = problem.joint.quasi_static()
        self.harmonics, self.samples = harmonics, samples
        self.tolerance, self.max_iterations = tolerance, max_iterations
        system = ContactSystem.build(self.joint.stiffness, problem.interface.gap,
                                     np.asarray(problem.friction_coefficient), problem.normal_load)
        self.march = ContactMarch(system, self.joint.flexibility)

    def equations(self, omega: float) -> ArmEquations:
        """Return the rig's equations at `omega` (rad/s)."""
        return ArmEquations.build(self.joint.rig, omega, self.problem.excitation, self.harmonics, self.samples)

    def guess(self, omega: float) -> Array:
        """Return arm coefficients of the rig with one Jenkins element, a start from nothing."""
        sliding = self.joint.motion[:, 0]
        limit = float(np.mean(self.problem.friction_coefficient)) * self.problem.normal_load
        motion = jenkins_arm_motion(self.joint.rig, float(sliding @ self.joint.stiffness @ sliding), limit,
                                    self.problem.excitation, omega / (2.0 * np.pi), self.samples)
        return np.asarray(self.equations(omega).analysis @ motion)

    def evaluate(self, unknowns: Array, start: SampleState, near: Trajectory | None, last: float) -> Point:
        """March the period of (a, omega) from the contact `start`.

        `last` is the residual's norm before, for the contact's accuracy; `near` a period close by.
        """
        arm, omega = unknowns[:-1], float(unknowns[-1])
        e = self.equations(omega)
        accuracy = max(0.1 * self.tolerance, min(1e-6, 1e-3 * last**2))
        period = self.march.period(e.synthesis @ arm, e.synthesis, start, near, accuracy)
        residual = e.impedance @ arm - e.load - e.analysis @ period.trajectory.friction
        matrix, load = arm_rates(self.joint.rig, omega, self.problem.excitation, self.harmonics)
        return Point(arm=arm, omega=omega, period=period, residual=residual,
                     jacobian=e.impedance - e.analysis @ period.tangent, rate=matrix @ arm - load,
                     norm=float(np.linalg.norm(residual)) / self.problem.excitation)

    def correct(self, unknowns: Array, row: Array, scales: Array, start: SampleState) -> Point:
        """Return the root of R on the plane through `unknowns` whose normal is `row`, in scaled unknowns.

        Raises
        ------
        NonConvergenceError
            With the residual history relative to the excitation.
        """
        now, across = self.evaluate(unknowns, start, None, 1.0), 0
        history = [now.norm]
        while now.norm > self.tolerance:
            following = None
            if len(history) <= self.max_iterations:
                following = self._step(now, row, scales, across < MAX_ACROSS)
            if following is None:
                raise NonConvergenceError(
                    f"forced response near {now.omega / (2.0 * np.pi):.6g} Hz: residual {now.norm:.1e} of the "
                    f"excitation after {len(history) - 1} iterations", history)
            across += following.norm > now.norm
            now = following
            history.append(now.norm)
        return Point(**{**vars(now), "iterations": len(history) - 1})

    def at_frequency(self, omega: float, arm: Array, start: SampleState) -> Point:
        """Return the root at `omega` (rad/s), with `arm` as guess. Raises NonConvergenceError as `correct`."""
        unknowns = np.append(arm, omega)
        row = np.zeros(len(unknowns))
        row[-1] = 1.0
        scales = np.append(np.full(len(arm), max(float(np.linalg.norm(arm)), SMALL)), omega)
        return self.correct(unknowns, row, scales, start)

    def tangent(self, point: Point, along: Array) -> Array:
        """Return the unit tangent of the curve (2 H + 2,) in scaled unknowns, on the side of `along`."""
        bordered = np.vstack([point.matrix * (point.scales / self.problem.excitation), along])
        found = np.linalg.solve(bordered, np.append(np.zeros(len(point.arm)), 1.0))
        return np.asarray(found / np.linalg.norm(found))

    def _step(self, now: Point, row: Array, scales: Array, worse: bool) -> Point | None:
        """Return a point with a smaller residual, or a larger one if `worse` is allowed.

        Samples that begin to stick put kinks into R. Where a Newton step leads across one, the mean of the
        derivatives on both sides is tried before the step is shortened.
        """
        tried: list[Point] = []
        matrix, length = now.matrix, 1.0
        while length >= SHORTEST_STEP:
            bordered = np.vstack([matrix * (scales / self.problem.excitation), row])
            step = scales * np.linalg.solve(bordered, np.append(-now.residual / self.problem.excitation, 0.0))
            unknowns = now.unknowns + length * step
            if unknowns[-1] > 0.0:
                near = now.period.trajectory if not tried and now.norm < NEAR else None
                following = self.evaluate(unknowns, now.end, near, now.norm)
                if following.norm < (1.0 - 1e-3 * length) * now.norm:
                    return following
                tried.append(following)
                matrix = 0.5 * (matrix + following.matrix)
            length *= 0.5 if len(tried) != 1 else 1.0
        best = min(tried, key=lambda point: point.norm, default=None)
        return best if worse and best is not None and best.norm < ACROSS * now.norm else None
