"""A structure on its contact as equations in its motion and the frequency, solved along a curve.

Unknowns are y = (a, omega): the coefficients of the coordinates that the contact sees and the angular frequency, of

    R(a, omega) = Z(omega) a - g(omega) - Phi[a]

One row more, ``t . (y - y_0) = 0`` in scaled unknowns, makes the system square also at turning points (Keller 1977).

Marching the contact gives Phi, and its derivative at a multiple of the cost. So the derivative is avoided where there
is one coordinate: the defect of a model is corrected (`continuation.model`), the contact's own backbone, within a few
per cent of Phi, or where all sticks a spring, which is exact. Where this is slow, or there are several, Newton takes
over with the derivative of Phi by the march, made rarely: between, secants tell how R changes across its kinks. Either
way the root is that of R.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.continuation.model import FORMER, SMALL, OnBackbone, Plane, Secants
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.backbone import Backbone
from fretflow.solvers.quasi_static.internal import InternalEquations, seen_coordinates
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion
from fretflow.solvers.quasi_static.march import ContactMarch, PeriodicMarch, Surroundings
from fretflow.solvers.quasi_static.newton import HALVED, NEAR
from fretflow.solvers.quasi_static.sample import STICK, Array, PeriodHistory, SampleSolver, SampleState
from fretflow.solvers.quasi_static.starts import stuck_start
from fretflow.structure.two_mass_rig.lumped import LumpedRig

ACROSS = 2.0  # growth of the residual that is let pass
MAX_DEFECTS = 12
SLOW = 0.5  # decrease of the residual by a correction of the defect
MAX_SLOW = 3  # times
MODEL_TOLERANCE = 0.01  # of the residual that is to be reduced
FIRST = 0.01  # about the residual of a first guess
CONTACT_TOLERANCE = 0.01  # of the residual's
REPEAT = 0.5  # of the residual: what of a nodal force may change from period to period, which Phi hardly feels
FIRST_REPEAT = 0.02
RATE_STEP = 1e-6  # of the frequency
NO_MEMORY = np.zeros((0, 0)), np.zeros((0, 0))


@dataclass(frozen=True)
class CurvePoint:
    """Coefficients of the coordinates that the contact sees and of the others in m, omega in rad/s, and the period.

    `end` is the contact at the end of the period, which is the one before its beginning, from which the `history` can
    be marched again where it is not kept. `residual` (n_a,) N, and its norm relative to the excitation.
    """

    seen: Array
    other: Array
    omega: float
    end: SampleState
    sticks: bool  # every node, all the period
    history: PeriodHistory | None
    residual: Array
    norm: float
    secants: Secants
    iterations: int = 0

    @property
    def scales(self) -> Array:
        """Return the lengths (n_a + 1,) of the unknowns: the motion's amplitude and the frequency themselves."""
        return np.append(np.full(len(self.seen), max(float(np.linalg.norm(self.seen)), SMALL)), self.omega)

    @property
    def unknowns(self) -> Array:
        """Return (a, omega)."""
        return np.append(self.seen, self.omega)

    def without_history(self) -> CurvePoint:
        """Return it with copies of its arrays, laid out as if read from a file, and its period not kept."""
        end = SampleState(self.end.displacement.copy(), self.end.force.copy(), self.end.state.copy())
        secants = Secants(self.secants.defects.copy(), self.secants.residuals.copy())
        return replace(self, seen=self.seen.copy(), other=self.other.copy(), end=end, history=None,
                       residual=self.residual.copy(), secants=secants)


class ContinuationSystem:
    """The equations of one problem, at any frequency, on fixed harmonics and samples."""

    def __init__(self, problem: PeriodicProblem, harmonics: int, samples: int, tolerance: float,
                 max_iterations: int, backbone: Backbone | None = None) -> None:
        """Take the contact's `backbone` if it has one and it serves as a model."""
        self.problem = problem
        self.seen = seen_coordinates(problem.boundary)
        self.harmonics, self.samples = harmonics, samples
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.march = ContactMarch.of(problem, self.seen)
        self.scale = problem.excitation.amplitude
        self.spring: OnBackbone | None = None
        if len(self.seen) == 1:
            own = float(self.march.system.felt_stiffness[0, 0])
            self.spring = OnBackbone(Backbone(np.array([own]), np.array([np.inf])), self.scale)
        self.backbone = None if backbone is None else OnBackbone(backbone, self.scale)
        self._derivative: Array | None = None  # of R, where Newton was last

    def equations(self, omega: float) -> InternalEquations:
        """Return the rig's equations at `omega` (rad/s)."""
        return InternalEquations.of(self.at(omega), self.harmonics, self.samples)

    def at(self, omega: float) -> PeriodicProblem:
        """Return the problem at `omega` (rad/s)."""
        return self.problem.vary(frequency=omega / (2.0 * np.pi))

    def under(self, share: float) -> ContinuationSystem:
        """Return the same system under a `share` of the excitation."""
        part = replace(self.problem, excitation=self.problem.excitation.scaled(share))
        return ContinuationSystem(part, self.harmonics, self.samples, self.tolerance, self.max_iterations,
                                  None if self.backbone is None else self.backbone.backbone)

    def motion(self, point: CurvePoint) -> Array:
        """Return the motion of all coordinates (N, d) in m."""
        return self.equations(point.omega).whole_motion(point.seen, point.other)

    def guess(self, omega: float) -> Array:
        """Return coefficients of a start from nothing: the rig with one Jenkins element, else the stuck structure."""
        equations, rig = self.equations(omega), self.problem.boundary.internal
        if self.spring is None or not isinstance(rig, LumpedRig):
            return stuck_start(equations, self.march).seen
        limit = float(np.mean(self.problem.friction_coefficient)) * self.problem.normal_load
        motion = jenkins_arm_motion(rig, float(self.spring.backbone.stiffness[0]), limit, self.scale,
                                    omega / (2.0 * np.pi), self.samples)
        return np.asarray(equations.analysis @ motion)

    def evaluate(self, unknowns: Array, start: SampleState, near: PeriodHistory | None, last: float,
                 other: Array | None = None) -> CurvePoint:
        """March the period of (a, omega) from the contact `start`.

        `last` is the residual's norm before, for the contact's accuracy; `near` a period close by, `other` the
        coordinates there that the contact does not see.
        """
        seen, omega = unknowns[:-1], float(unknowns[-1])
        e = self.equations(omega)
        balance = e.balance(seen, other)
        none = np.zeros((self.samples, len(self.seen), 0))
        history = self._period(e, seen, none, start, near, last).history
        residual = balance.residual - e.coefficients(history.force @ self.march.system.transfer.T)
        return CurvePoint(seen, balance.other, omega, SampleState.of(history), not np.any(history.state != STICK),
                          history, residual, float(np.linalg.norm(residual)) / self.scale, Secants.none(len(seen)))

    def period(self, point: CurvePoint) -> PeriodHistory:
        """Return the period of a root, marched again where it has not been kept. Raises NonConvergenceError."""
        if point.history is not None:
            return point.history
        again = self.evaluate(point.unknowns, point.end, None, point.norm, point.other).history
        if again is None:
            raise NonConvergenceError("forced response: the period is not found again")
        return again

    @property
    def memory(self) -> tuple[Array, Array]:
        """Return what a step leaves to the next: the derivative (n_a, n_a + 1) of R or (0, 0), and the march's."""
        return NO_MEMORY[0] if self._derivative is None else self._derivative, self.march.memory

    def begin_step(self, memory: tuple[Array, Array]) -> None:
        """Begin a step with nothing but a `memory`, so that it depends on what can be kept in a file."""
        derivative, self.march.memory = memory
        self._derivative = derivative if derivative.size else None
        self.march.solver = SampleSolver(self.march.system)

    def derivative(self, point: CurvePoint) -> Array:
        """Return the derivative (n_a, n_a + 1) of R by (a, omega); friction that depends on the rate is held."""
        e = self.equations(point.omega)
        contact = self._period(e, point.seen, e.directions(), point.end, point.history, point.norm)
        h = RATE_STEP * point.omega
        ahead, back = (self.equations(point.omega + s).balance(point.seen, point.other).residual for s in (h, -h))
        return np.column_stack([e.balance(point.seen, point.other).linear.jacobian - e.coefficients(contact.tangent),
                                (ahead - back) / (2.0 * h)])

    def correct(self, plane: Plane, start: SampleState, known: CurvePoint | None = None) -> CurvePoint:
        """Return the root of R on `plane`, the contact starting from `start`; `known` is a root close by.

        Raises
        ------
        NonConvergenceError
            With the residual history relative to the excitation.
        """
        now = self._by_defects(plane, start, known)
        return now if now.norm <= self.tolerance else self._by_newton(plane, now)

    def at_frequency(self, omega: float, seen: Array, start: SampleState,
                     known: CurvePoint | None = None) -> CurvePoint:
        """Return the root at `omega` (rad/s), with `seen` as guess. Raises NonConvergenceError as `correct`."""
        return self.correct(Plane.of_frequency(omega, seen), start, known)

    def tangent(self, point: CurvePoint, along: Array) -> Array:
        """Return the unit tangent of the curve (n_a + 1,) in scaled unknowns, on the side of `along`."""
        bordered = np.vstack([self.derivative(point) * (point.scales / self.scale), along])
        tangent = np.linalg.solve(bordered, np.append(np.zeros(len(point.seen)), 1.0))
        return np.asarray(tangent / np.linalg.norm(tangent))

    def _period(self, e: InternalEquations, seen: Array, directions: Array, start: SampleState,
                near: PeriodHistory | None, last: float) -> PeriodicMarch:
        self.march.surroundings = Surroundings.of(self.at(e.omega), self.seen)
        accuracy = max(CONTACT_TOLERANCE * self.tolerance, min(1e-6, 1e-3 * last**2))
        repeat = min(FIRST_REPEAT, REPEAT * last)
        return self.march.period(e.motion(seen), directions, start, near, accuracy, repeat)

    def _model_of(self, point: CurvePoint) -> OnBackbone | None:
        return self.spring if point.sticks else self.backbone

    def _on_model(self, model: OnBackbone, defect: Array, plane: Plane, guess: Array, last: float) -> Array:
        return model.solve(self.equations, defect, plane, guess, MODEL_TOLERANCE * max(last, self.tolerance))

    def _first(self, plane: Plane, known: CurvePoint | None) -> Array:
        """Return a guess on `plane`: the model with the defect at `known`, else, if that works, the model alone."""
        model = self.backbone if known is None else self._model_of(known)
        if model is None:
            return plane.unknowns
        if known is not None:
            return self._on_model(model, self._defect(model, known), plane, plane.unknowns, FIRST)
        with suppress(NonConvergenceError):
            return self._on_model(model, np.zeros(len(plane.unknowns) - 1), plane, plane.unknowns, FIRST)
        return plane.unknowns

    def _by_defects(self, plane: Plane, start: SampleState, known: CurvePoint | None) -> CurvePoint:
        """Return the root, or how far the correction of the model's defect led."""
        secants = Secants.none(len(plane.unknowns) - 1) if known is None else known.secants
        now, slow = self.evaluate(self._first(plane, known), start, None, 1.0), 0
        before: tuple[OnBackbone | None, Array, Array] = (None, now.residual, now.residual)
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

    def _defect(self, model: OnBackbone, point: CurvePoint) -> Array:
        return model.residual(self.equations(point.omega), point.seen) - point.residual

    def _next(self, model: OnBackbone, defect: Array, plane: Plane, now: CurvePoint) -> CurvePoint | None:
        """Return the next iterate, or None where the model or the contact fails, or the residual grows."""
        near = now.history if now.norm < NEAR else None
        with suppress(NonConvergenceError, np.linalg.LinAlgError):
            unknowns = self._on_model(model, defect, plane, now.unknowns, now.norm)
            following = self.evaluate(unknowns, now.end, near, now.norm, now.other)
            if following.norm < ACROSS * now.norm:
                return following
        return None

    def _by_newton(self, plane: Plane, now: CurvePoint) -> CurvePoint:
        """Return the root by Newton, with the derivative of a point before as long as it serves.

        Raises
        ------
        NonConvergenceError
            If a derivative made anew does not halve the residual.
        """
        history, matrix, made = [now.norm], self._derivative, 0
        if matrix is not None and matrix.shape != (len(now.seen), len(now.seen) + 1):
            matrix = None
        while now.norm > self.tolerance:
            if matrix is None:
                matrix, made = self.derivative(now), made + 1
            best, self._derivative = self._by_secants(plane, now, matrix, history), matrix
            given_up = made >= self.max_iterations or (made > 0 and best.norm > HALVED * now.norm)
            if best.norm > self.tolerance and given_up:
                raise NonConvergenceError(
                    f"forced response near {now.omega / (2.0 * pi):.6g} Hz: residual {best.norm:.1e} of the "
                    f"excitation after {len(history) - 1} iterations", history)
            now, matrix = best, None
        return now

    def _by_secants(self, plane: Plane, now: CurvePoint, matrix: Array, history: list[float]) -> CurvePoint:
        """Return the best of the points to which steps by one derivative lead, extrapolated by those before them.

        Samples that begin to stick put kinks into R, between which steps by the derivative at one point creep. Secants
        tell how R changes on the whole across them (D. G. Anderson, J. ACM 12 (1965)).
        """
        solve, secants, best, since = plane.solver(matrix / self.scale), Secants.none(len(now.unknowns)), now, 0
        before: tuple[Array, Array] | None = None
        while now.norm > self.tolerance and since <= FORMER and np.isfinite(now.norm):
            off = solve(now.residual / self.scale)
            ahead = now.unknowns / plane.scales - off
            if before is not None:
                secants = secants.with_pair(ahead - before[0], off - before[1])
            before = ahead, off
            unknowns = plane.scales * secants.extrapolate(ahead, off)
            if not unknowns[-1] > 0.0:
                break
            try:
                near = now.history if now.norm < NEAR else None
                following = self.evaluate(unknowns, now.end, near, now.norm, now.other)
            except NonConvergenceError:  # of the contact, too far from where it was
                break
            now = replace(following, iterations=now.iterations + 1, secants=best.secants)
            history.append(now.norm)
            if len(self.seen) == 1 and best.norm < NEAR and now.norm > ACROSS * best.norm:
                break  # one coordinate has few kinks, and periods of other branches lie near
            best, since = (now, 0) if now.norm < best.norm else (best, since + 1)
        return best
