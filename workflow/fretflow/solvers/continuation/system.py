"""The rig on its contact as equations in the arm's motion and the frequency, solved along a curve.

Unknowns are y = (a, omega): the arm's coefficients and the angular frequency, of

    R(a, omega) = Z(omega) a - g(omega) - Phi[a]

One row more, ``t . (y - y_0) = 0`` in scaled unknowns, makes the system square also at turning points (Keller 1977).

Marching the contact gives Phi, and its derivative at a multiple of the cost. So the derivative is avoided: the defect
of a model is corrected (`continuation_model`), the contact's own backbone, within a few per cent of Phi, or where all
sticks a spring, which is exact. Where this is slow, Newton takes over, with the derivative of Phi by the march. Either
way the root is that of R.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.continuation.model import SMALL, Plane, RigOnBackbone, Secants
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.arm import ArmEquations
from fretflow.solvers.quasi_static.backbone import Backbone
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion
from fretflow.solvers.quasi_static.march import ContactMarch, PeriodHistory, PeriodicMarch, Surroundings
from fretflow.solvers.quasi_static.sample import STICK, Array, SampleState
from fretflow.solvers.quasi_static.solver import NEAR

SHORTEST_STEP = 0.1  # of a Newton step; beyond that a shorter arc is cheaper
ACROSS = 2.0  # growth of the residual that is let pass
MAX_ACROSS = 3  # times
MAX_DEFECTS = 12
SLOW = 0.5  # decrease of the residual by a correction of the defect
MAX_SLOW = 3  # times
MODEL_TOLERANCE = 0.01  # of the residual that is to be reduced
FIRST = 0.01  # about the residual of a first guess
CONTACT_TOLERANCE = 0.01  # of the residual's
REPEAT = 0.5  # of the residual: what of a nodal force may change from period to period, which Phi hardly feels
FIRST_REPEAT = 0.02
RATE_STEP = 1e-6  # of the frequency


@dataclass(frozen=True)
class Point:
    """Arm and block coefficients (2 H + 1,) in m, omega in rad/s, and the contact's period.

    `residual` (2 H + 1,) N, and its norm relative to the excitation.
    """

    arm: Array
    block: Array
    omega: float
    trajectory: PeriodHistory
    residual: Array
    norm: float
    secants: Secants
    iterations: int = 0

    @property
    def scales(self) -> Array:
        """Return the lengths (2 H + 2,) of the unknowns: the arm's amplitude and the frequency themselves."""
        return np.append(np.full(len(self.arm), max(float(np.linalg.norm(self.arm)), SMALL)), self.omega)

    @property
    def end(self) -> SampleState:
        """Return the contact at the end of the period, which is the one before its beginning."""
        return self.trajectory.sample(-1)

    @property
    def sticks(self) -> bool:
        """Tell whether no node moves during the period."""
        return not np.any(self.trajectory.state != STICK)

    @property
    def unknowns(self) -> Array:
        """Return (a, omega)."""
        return np.append(self.arm, self.omega)


class ArmSystem:
    """The equations of one problem, at any frequency, on fixed harmonics and samples."""

    def __init__(self, problem: PeriodicProblem, harmonics: int, samples: int, tolerance: float,
                 max_iterations: int, backbone: Backbone | None = None) -> None:
        """Take the contact's `backbone` if it has one and it serves as a model."""
        self.problem = problem
        self.joint = problem.joint.quasi_static()
        self.harmonics, self.samples = harmonics, samples
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.march = ContactMarch.of(problem)
        own = float(self.march.solver.kbx[:self.march.system.size].sum())
        spring = Backbone(np.array([own]), np.array([np.inf]))
        self.spring = RigOnBackbone(self.joint.rig, spring, problem.excitation)
        self.backbone = None if backbone is None else replace(self.spring, backbone=backbone)

    def equations(self, omega: float) -> ArmEquations:
        """Return the rig's equations at `omega` (rad/s)."""
        return ArmEquations.of(self.at(omega), self.harmonics, self.samples)

    def at(self, omega: float) -> PeriodicProblem:
        """Return the problem at `omega` (rad/s)."""
        return replace(self.problem, frequency=omega / (2.0 * np.pi))

    def under(self, excitation: float) -> ArmSystem:
        """Return the same system under another `excitation` (N)."""
        return ArmSystem(replace(self.problem, excitation=excitation), self.harmonics, self.samples, self.tolerance,
                         self.max_iterations, None if self.backbone is None else self.backbone.backbone)

    def block_motion(self, point: Point) -> Array:
        """Return the block's motion (N,) in m."""
        return np.asarray(self.equations(point.omega).synthesis @ point.block)

    def guess(self, omega: float) -> Array:
        """Return arm coefficients of the rig with one Jenkins element, a start from nothing."""
        limit = float(np.mean(self.problem.friction_coefficient)) * self.problem.normal_load
        motion = jenkins_arm_motion(self.joint.rig, float(self.spring.backbone.stiffness[0]), limit,
                                    self.problem.excitation, omega / (2.0 * np.pi), self.samples)
        return np.asarray(self.equations(omega).analysis @ motion)

    def evaluate(self, unknowns: Array, start: SampleState, near: PeriodHistory | None, last: float,
                 block: Array | None = None) -> Point:
        """March the period of (a, omega) from the contact `start`.

        `last` is the residual's norm before, for the contact's accuracy; `near` a period close by, `block` its block.
        """
        arm, omega = unknowns[:-1], float(unknowns[-1])
        e = self.equations(omega)
        rig = e.balance(arm, block)
        trajectory = self._period(e, arm, np.zeros((self.samples, 0)), start, near, last).trajectory
        residual = rig.residual - e.analysis @ trajectory.friction
        return Point(arm, rig.block, omega, trajectory, residual,
                     float(np.linalg.norm(residual)) / self.problem.excitation, Secants.none(len(arm)))

    def derivative(self, point: Point) -> Array:
        """Return the derivative (2 H + 1, 2 H + 2) of R by (a, omega); friction that depends on the rate is held."""
        e = self.equations(point.omega)
        contact = self._period(e, point.arm, e.synthesis, point.end, point.trajectory, point.norm)
        h = RATE_STEP * point.omega
        ahead, back = (self.equations(point.omega + s).balance(point.arm, point.block).residual for s in (h, -h))
        return np.column_stack([e.balance(point.arm, point.block).jacobian - e.analysis @ contact.tangent,
                                (ahead - back) / (2.0 * h)])

    def correct(self, plane: Plane, start: SampleState, known: Point | None = None) -> Point:
        """Return the root of R on `plane`, the contact starting from `start`; `known` is a root close by.

        Raises
        ------
        NonConvergenceError
            With the residual history relative to the excitation.
        """
        now = self._by_defects(plane, start, known)
        return now if now.norm <= self.tolerance else self._by_newton(plane, now)

    def at_frequency(self, omega: float, arm: Array, start: SampleState, known: Point | None = None) -> Point:
        """Return the root at `omega` (rad/s), with `arm` as guess. Raises NonConvergenceError as `correct`."""
        return self.correct(Plane.of_frequency(omega, arm), start, known)

    def tangent(self, point: Point, along: Array) -> Array:
        """Return the unit tangent of the curve (2 H + 2,) in scaled unknowns, on the side of `along`."""
        bordered = np.vstack([self.derivative(point) * (point.scales / self.problem.excitation), along])
        found = np.linalg.solve(bordered, np.append(np.zeros(len(point.arm)), 1.0))
        return np.asarray(found / np.linalg.norm(found))

    def _period(self, e: ArmEquations, arm: Array, directions: Array, start: SampleState, near: PeriodHistory | None,
                last: float) -> PeriodicMarch:
        self.march.surroundings = Surroundings(e.omega, self.problem.load_slope, self.problem.motion_factors)
        accuracy = max(CONTACT_TOLERANCE * self.tolerance, min(1e-6, 1e-3 * last**2))
        repeat = min(FIRST_REPEAT, REPEAT * last)
        return self.march.period(e.synthesis @ arm, directions, start, near, accuracy, repeat)

    def _model_of(self, point: Point) -> RigOnBackbone | None:
        return self.spring if point.sticks else self.backbone

    def _on_model(self, model: RigOnBackbone, defect: Array, plane: Plane, guess: Array, last: float) -> Array:
        return model.solve(self.equations, defect, plane, guess, MODEL_TOLERANCE * max(last, self.tolerance))

    def _first(self, plane: Plane, known: Point | None) -> Array:
        """Return a guess on `plane`: the model with the defect at `known`, else, if that works, the model alone."""
        model = self.backbone if known is None else self._model_of(known)
        if model is None:
            return plane.unknowns
        if known is not None:
            return self._on_model(model, self._defect(model, known), plane, plane.unknowns, FIRST)
        with suppress(NonConvergenceError):
            return self._on_model(model, np.zeros(len(plane.unknowns) - 1), plane, plane.unknowns, FIRST)
        return plane.unknowns

    def _by_defects(self, plane: Plane, start: SampleState, known: Point | None) -> Point:
        """Return the root, or how far the correction of the model's defect led."""
        secants = Secants.none(len(plane.unknowns) - 1) if known is None else known.secants
        now, slow = self.evaluate(self._first(plane, known), start, None, 1.0), 0
        before: tuple[RigOnBackbone | None, Array, Array] = (None, now.residual, now.residual)
        for count in range(1, MAX_DEFECTS + 1):
            model = self._model_of(now)
            if now.norm <= self.tolerance or model is None or slow > MAX_SLOW:
                break
            defect = self._defect(model, now)
            if before[0] is model:
                secants = secants.with_pair(defect - before[1], now.residual - before[2])
            before = model, defect, now.residual
            following = self._next(model, secants.extrapolate(defect, now.residual), plane, now)
            if following is None:  # misled by what held at other points
                secants = secants.forgotten()
                following = self._next(model, defect, plane, now)
            if following is None:
                break
            slow += following.norm > SLOW * now.norm
            now = replace(following, iterations=count)
        return replace(now, secants=secants)

    def _defect(self, model: RigOnBackbone, point: Point) -> Array:
        return model.residual(self.equations(point.omega), point.arm) - point.residual

    def _next(self, model: RigOnBackbone, defect: Array, plane: Plane, now: Point) -> Point | None:
        """Return the next iterate, or None where the model or the contact fails, or the residual grows."""
        near = now.trajectory if now.norm < NEAR else None
        with suppress(NonConvergenceError, np.linalg.LinAlgError):
            unknowns = self._on_model(model, defect, plane, now.unknowns, now.norm)
            following = self.evaluate(unknowns, now.end, near, now.norm, now.block)
            if following.norm < ACROSS * now.norm:
                return following
        return None

    def _by_newton(self, plane: Plane, now: Point) -> Point:
        across, history = 0, [now.norm]
        while now.norm > self.tolerance:
            following = self._step(now, plane, across < MAX_ACROSS) if len(history) <= self.max_iterations else None
            if following is None:
                raise NonConvergenceError(
                    f"forced response near {now.omega / (2.0 * np.pi):.6g} Hz: residual {now.norm:.1e} of the "
                    f"excitation after {len(history) - 1} iterations", history)
            across += following.norm > now.norm
            now = replace(following, iterations=now.iterations + 1, secants=now.secants)
            history.append(now.norm)
        return now

    def _step(self, now: Point, plane: Plane, worse: bool) -> Point | None:
        """Return a point with a smaller residual, or a larger one if `worse` is allowed.

        Samples that begin to stick put kinks into R. Where a Newton step leads across one, the mean of the
        derivatives on both sides is tried before the step is shortened.
        """
        tried: list[Point] = []
        matrix, length, force = self.derivative(now), 1.0, self.problem.excitation
        while length >= SHORTEST_STEP:
            unknowns = now.unknowns + length * plane.step(now.residual / force, matrix / force)
            if unknowns[-1] > 0.0:
                near = now.trajectory if not tried and now.norm < NEAR else None
                following = self.evaluate(unknowns, now.end, near, now.norm, now.block)
                if following.norm < (1.0 - 1e-3 * length) * now.norm:
                    return following
                tried.append(following)
                if len(tried) == 1:
                    matrix = 0.5 * (matrix + self.derivative(following))
            length *= 0.5 if len(tried) != 1 else 1.0
        best = min(tried, key=lambda point: point.norm, default=None)
        return best if worse and best is not None and best.norm < ACROSS * now.norm else None
