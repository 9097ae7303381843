"""The true periodic solver: internal coordinates by harmonics, the contact quasi-static at every time sample.

The bodies' own modes beside the internal coordinates lie far above the harmonics that matter, so the contact nodes
carry no inertia and their motion has no reason to be truncated (massless boundary, see `structure.structure`). The
coordinates are harmonic, and the force they feel of the contact is a functional Phi of their motion a:

    Z_a(k omega) a_k = g_k + Phi_k[a],    k = 0..H

with Z_a their impedance after elimination of those that the contact does not see. Newton on the (2 H + 1) d_a
coefficients uses the exact tangent of Phi from the march of the contact. Where that fails from all starts, further
forces, then the excitation, are raised from nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.audit import audit_period
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.backbone import Backbone, find_arm
from fretflow.solvers.quasi_static.candidate_nodes import (
    PartOfFaces,
    candidate_nodes,
    extend_solution,
    penetrating,
    restrict,
    restrict_solution,
)
from fretflow.solvers.quasi_static.internal import InternalBalance, InternalEquations, seen_coordinates
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion, jenkins_rig_motion
from fretflow.solvers.quasi_static.march import ContactMarch, PeriodicMarch
from fretflow.solvers.quasi_static.sample import Array, PeriodHistory, SampleState, plain
from fretflow.structure.internal_forces import ShareOfForce
from fretflow.structure.two_mass_rig.lumped import LumpedRig

SMALLEST_STEP = 1e-3
SMALLEST_SHARE = 0.05  # step in which further forces or the excitation are raised
REPEATS = 0.02  # how well a period must repeat, relative to the residual before it
STEP_ANGLE = 0.15  # of the fastest oscillation, in a first guess marched with further forces
LAGGED = 0.3  # decrease of the residual with which a former tangent serves
NEAR = 1e-2  # residual below which the last period is a good guess of the next
# Violation of the contact law over the solver's tolerance, and at least, that counts as one: ten times what was seen of
# the direction of sliding, and a hundred times of all else.
UNLAWFUL, LEAST_UNLAWFUL = 1e3, 1e-6
COARSE = 1e-6  # tolerance from which a period is a step on the way to something, and its contact as rough
TANGENT_BYTES = 2**28  # of the tangent that is marched at once
CLOSE = 5e-3  # residual of a neighbouring period below which no other start is looked at


class _Settings(Protocol):
    """The part of the case's [solver] section that this solver reads."""

    @property
    def resolved_harmonics(self) -> int: ...
    @property
    def resolved_samples(self) -> int: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def max_iterations(self) -> int: ...
    @property
    def estimate_error(self) -> bool: ...


class QuasiStaticSolver:
    """Solves periodic problems true to time integration; see the module's text."""

    def __init__(self, settings: _Settings) -> None:
        self.settings = settings

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period; where the tolerance is not coarse, its contact law is audited.

        Raises
        ------
        NonConvergenceError
            With the residual history, relative to the excitation.
        AuditError
            If the period breaks the contact law at a node and sample.
        """
        found = self._solve(problem, self.settings.resolved_samples, start)
        if self.settings.tolerance <= COARSE:
            audit_period(problem, found, max(LEAST_UNLAWFUL, UNLAWFUL * self.settings.tolerance))
        if not self.settings.estimate_error:
            return found
        # first order in the samples: the difference to half of them is about the error that remains
        coarse = self._solve(problem, self.settings.resolved_samples // 2, found)
        fine, rough = (sliding_distance(s, problem.interface) for s in (found, coarse))
        return replace(found, error_estimate=abs(fine - rough) / max(fine, 1e-15))

    def _solve(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        """Solve for the nodes within reach, and again for more of them if others turn out to touch."""
        nodes = candidate_nodes(problem, start)
        while not nodes.all():
            near = None if start is None else restrict_solution(start, nodes)
            found = extend_solution(self._solve_all(restrict(problem, nodes), samples, near), problem, nodes)
            missed = penetrating(found, problem.interface, nodes)
            if not missed.any():
                return found
            nodes, start = nodes | missed, found
        return self._solve_all(problem, samples, start)

    def _solve_all(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        forces = problem.boundary.forces
        if start is None and forces:
            try:
                return self._find(problem, samples, None, marched=True)
            except NonConvergenceError:
                pass  # partial slip, where one element is no good guess
        try:
            return self._find(problem, samples, start)
        except NonConvergenceError:
            if start is not None:
                raise
        if forces:
            return self._raised(lambda share: with_forces(problem, share), samples,
                                self._find(with_forces(problem, 0.0), samples, None), 0.5)
        return self._raised(lambda share: replace(problem, excitation=problem.excitation.scaled(share)), samples,
                            None, 0.25)

    def _raised(self, at: Callable[[float], PeriodicProblem], samples: int, found: PeriodicSolution | None,
                step: float) -> PeriodicSolution:
        """Return the period of ``at(1)`` by steps from the one `found` at zero, or from rest."""
        share = 0.0
        while share < 1.0:
            target = min(1.0, share + step)
            try:
                found = self._find(at(target), samples, found)
            except NonConvergenceError:
                step *= 0.5
                if step < SMALLEST_SHARE:
                    raise
                continue
            share, step = target, 2.0 * step
        if found is None:
            raise NonConvergenceError("quasi-static period: nothing to raise")
        return found

    def _find(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None,
              marched: bool = False) -> PeriodicSolution:
        harmonics = min(self.settings.resolved_harmonics, (samples - 1) // 2)
        equations = InternalEquations.of(problem, harmonics, samples)
        march = ContactMarch.of(problem, equations.seen)
        near_starts: tuple[_Start, ...] = ()
        if start is None:
            contact = march.preloaded(problem.preload.frictional)
        else:
            near = _as_history(start, equations.seen, samples)
            contact = SampleState.of(near)
            other = equations.coefficients(_resample(start.internal, samples)[:, equations.other])
            near_starts = (_Start(equations.coefficients(near.position), other, near),)
        newton = _InternalNewton(equations, march, self.settings.tolerance)
        found, history = newton.solve(chain(near_starts, _cold_starts(problem, equations, march, marched)), contact,
                                      self.settings.max_iterations)
        return _solution(problem, equations, found, history)


def with_forces(problem: PeriodicProblem, share: float) -> PeriodicProblem:
    """Return the problem with a share of the structure's further forces."""
    boundary = problem.boundary
    forces = tuple(ShareOfForce(share, force) for force in boundary.forces) if share else ()
    return replace(problem, structure=PartOfFaces(problem.structure, replace(boundary, forces=forces)))


def _cold_starts(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch, marched: bool
                 ) -> Iterator[_Start]:
    """Make the starts that need no neighbouring period."""
    rig, one = problem.boundary.internal, len(equations.seen) == 1
    if marched and isinstance(rig, LumpedRig):
        block, arm = (equations.analysis @ _marched(problem, rig, march, len(equations.synthesis))).T
        yield _Start(arm, block)
    elif one and isinstance(rig, LumpedRig):
        yield _first_start(problem, equations, march, rig)
    else:
        yield stuck_start(equations, march)
        yield _Start(np.zeros_like(equations.load))


def stuck_start(equations: InternalEquations, march: ContactMarch) -> _Start:
    """Return the linear motion on a contact that sticks, with its tangent."""
    stuck = -np.kron(np.eye(len(equations.analysis)), march.system.felt_stiffness)
    return _Start(np.linalg.solve(equations.impedance - stuck, equations.load), tangent=stuck)


def _first_start(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch, rig: LumpedRig
                 ) -> _Start:
    """Return the motion on the contact's backbone, with its tangent, or where that fails on a Jenkins element."""
    try:
        backbone = Backbone.of(march, march.preloaded(problem.preload.frictional))
        arm = find_arm(problem, equations, backbone)
    except NonConvergenceError:
        return _Start(equations.analysis @ jenkins_arm_motion(
            rig, *_one_element(march), problem.excitation.amplitude, problem.frequency,
            len(equations.synthesis)))
    _, tangent = backbone.friction(equations.synthesis @ arm, equations.synthesis)
    return _Start(arm, tangent=equations.analysis @ tangent)


def _marched(problem: PeriodicProblem, rig: LumpedRig, march: ContactMarch, samples: int) -> Array:
    """Return the motion (samples, 2) in m of block and arm on one Jenkins element, with all forces on the rig."""
    stuck, limit = _one_element(march)
    stiffest = rig.stiffness + np.diag([0.0, stuck])
    fastest = float(np.sqrt(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(rig.mass, stiffest))))))
    per_sample = -(-int(fastest / (problem.frequency * STEP_ANGLE)) // samples) or 1
    phase = 2.0 * np.pi * np.arange(samples * per_sample) / (samples * per_sample)
    drive = (problem.loads_at(phase) @ problem.boundary.input_force.T)[:, 0]
    return jenkins_rig_motion(rig, problem.boundary.forces, stuck, limit, drive.tolist(),
                              problem.frequency)[::per_sample]


def _one_element(march: ContactMarch) -> tuple[float, float]:
    """Return the stiffness (N/m) of the stuck contact and the limit (N) of the whole."""
    system = march.system
    return float(system.felt_stiffness[0, 0]), float(system.friction.mean()) * system.load


@dataclass(frozen=True)
class _Start:
    """Coefficients of a and of b, None where b follows a, and what is known near by.

    That is a period, and the `tangent` (n_a, n_a) N/m of the contact's force.
    """

    seen: Array
    other: Array | None = None
    near: PeriodHistory | None = None
    tangent: Array | None = None


@dataclass(frozen=True)
class _Iterate:
    """The coefficients of a, the period they make, the structure's balance with it and its norm over the load.

    `felt` (n_a,) N is the contact's force on a and `tangent` (n_a, n_a) N/m its derivative, None where it has to be
    made anew. b `follows` a, or is an unknown beside it.
    """

    seen: Array
    history: PeriodHistory
    felt: Array
    balance: InternalBalance
    norm: float
    tangent: Array | None
    follows: bool


class _InternalNewton:
    """Newton on the coefficients of a with a line search on the residual.

    The tangent costs five times the period itself, so that it is made only where a step was taken. Close to the root
    that of the step before serves, at first that of the start, corrected so that it gives the change of force just
    seen (C. G. Broyden, Math. Comp. 19 (1965) 577-593).
    """

    def __init__(self, equations: InternalEquations, march: ContactMarch, tolerance: float) -> None:
        self.equations = equations
        self.march = march
        self.tolerance = tolerance

    def solve(self, starts: Iterator[_Start], before: SampleState, max_iterations: int
              ) -> tuple[_Iterate, tuple[float, ...]]:
        """Return the root and the residual history; where former tangents lead astray, again without them.

        Further starts are looked at only where those before are far from balance; the best of them is taken.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        """
        first = self._best(starts, before)
        try:
            return self._solve(first, max_iterations, NEAR)
        except NonConvergenceError:
            return self._solve(first, max_iterations, 0.0)

    def _best(self, starts: Iterator[_Start], before: SampleState) -> _Iterate:
        best: _Iterate | None = None
        while best is None or best.norm > CLOSE:
            try:
                start = next(starts, None)
                if start is None:
                    break
                period = self._march(start.seen, self._none, before, start.near, 1.0)
                found = self._iterate(start, period.history, start.tangent)
            except NonConvergenceError as error:
                failure = error
                continue
            best = found if best is None or found.norm < best.norm else best
        if best is None:
            raise failure
        return best

    def _march(self, seen: Array, directions: Array, before: SampleState, near: PeriodHistory | None, last: float
               ) -> PeriodicMarch:
        """March the period of `seen`; `last` is the norm before, for the contact's accuracy."""
        # the contact need not be solved much closer than the residual that Newton is about to reach
        accuracy = max(0.1 * self.tolerance, min(1e-6, 1e-3 * last**2))
        repeat = min(REPEATS * last, last**2)
        return self.march.period(self.equations.motion(seen), directions, before, near, accuracy, repeat)

    @property
    def _none(self) -> Array:
        return np.zeros((len(self.equations.synthesis), len(self.equations.seen), 0))

    def _felt(self, history: PeriodHistory) -> Array:
        return self.equations.coefficients(history.force @ self.march.system.transfer.T)

    def _iterate(self, at: _Start, history: PeriodHistory, tangent: Array | None = None) -> _Iterate:
        e = self.equations
        balance = e.balance(at.seen) if at.other is None else e.beside_balance(at.seen, at.other)
        felt = self._felt(history)
        residual = balance.residual - felt
        return _Iterate(at.seen, history, felt, replace(balance, residual=residual),
                        float(np.hypot(np.linalg.norm(residual), balance.size)) / e.scale, tangent, at.other is None)

    def _solve(self, first: _Iterate, max_iterations: int, lagged_below: float) -> tuple[_Iterate, tuple[float, ...]]:
        now = first
        history = [now.norm]
        while not now.norm <= self.tolerance:  # nan included
            try:
                following = self._step(now, lagged_below) if len(history) <= max_iterations else None
            except NonConvergenceError as error:
                error.history = error.history or tuple(history)
                raise
            if following is None:
                raise NonConvergenceError(
                    f"quasi-static period: residual {now.norm:.1e} of the excitation after {len(history) - 1} "
                    "iterations; use more samples, or start from a neighbouring solution", history)
            now = following
            history.append(now.norm)
        return now, tuple(history)

    def _step(self, now: _Iterate, lagged_below: float) -> _Iterate | None:
        if now.tangent is not None:
            following = self._searched(now, now.tangent, lagged_below, shortest=1.0)
            if following is not None:
                return following
        closer, tangent = self._differentiated(now)
        if closer.norm <= self.tolerance:  # what was left came from the accuracy of the march
            return closer
        return self._searched(closer, tangent, lagged_below, SMALLEST_STEP)

    def _searched(self, now: _Iterate, tangent: Array, lagged_below: float, shortest: float) -> _Iterate | None:
        """Return the iterate after the longest step that helps; with a tangent only where that serves once more."""
        step = np.linalg.solve(now.balance.jacobian - tangent, -now.balance.reduced)
        moved, length = now.balance.other_step(step), 1.0
        while length >= shortest:
            following = self._tried(now, tangent, length * step, length * moved)
            if following is not None and following.norm < (1.0 - 1e-3 * length) * now.norm:
                serves = following.norm < min(lagged_below, LAGGED * now.norm)
                return following if serves else replace(following, tangent=None)
            length *= 0.5
        return None

    def _differentiated(self, now: _Iterate) -> tuple[_Iterate, Array]:
        """Return the same iterate, marched once more, and the tangent there, made by as many columns as fit."""
        e = self.equations
        directions, history, parts = e.directions(), now.history, []
        columns = max(1, TANGENT_BYTES // (8 * directions[:, :, 0].size))
        for first in range(0, directions.shape[2], columns):
            found = self._march(now.seen, directions[:, :, first:first + columns], SampleState.of(history), history,
                                now.norm)
            history = found.history
            parts.append(e.coefficients(found.tangent))
        other = None if now.follows else now.balance.other
        return self._iterate(_Start(now.seen, other), history), np.hstack(parts)

    def _tried(self, now: _Iterate, tangent: Array, step: Array, moved: Array) -> _Iterate | None:
        """Return the iterate after a step, with the tangent corrected by it; None where the contact is not found."""
        near = now.history if now.norm < NEAR else None
        try:
            found = self._march(now.seen + step, self._none, SampleState.of(now.history), near, now.norm).history
        except NonConvergenceError:  # of the contact, too far from where it was
            return None
        corrected = tangent + np.outer(self._felt(found) - now.felt - tangent @ step, step / (step @ step))
        return self._iterate(_Start(now.seen + step, now.balance.other + moved), found, corrected)


def press(problem: PeriodicProblem) -> SampleState:
    """Return the contact under the normal load before anything moves, pressed as `problem` says."""
    return ContactMarch.of(problem, seen_coordinates(problem.boundary)).preloaded(problem.preload.frictional)


def sliding_distance(solution: PeriodicSolution, interface: Interface) -> float:
    """Return the peak-to-peak of the area mean of the faces' relative x displacement, m."""
    mean = solution.displacement[:, :, 0] @ interface.areas / interface.areas.sum()
    return float(np.ptp(mean))


def _resample(values: NDArray[Any], samples: int) -> NDArray[Any]:
    """Take the nearest earlier sample of a period (N, ...) at each of `samples` times."""
    taken: NDArray[Any] = values[np.arange(samples) * len(values) // samples]
    return taken


def _as_history(solution: PeriodicSolution, seen: NDArray[np.intp], samples: int) -> PeriodHistory:
    """Read a solution as a guess."""
    u, f = (_resample(a, samples).reshape(samples, -1) for a in (solution.displacement, solution.force))
    return PeriodHistory(plain(_resample(solution.internal, samples)[:, seen]), plain(u), plain(f),
                         np.require(_resample(solution.state, samples), dtype=np.int8, requirements=["C", "W"]))


def _solution(problem: PeriodicProblem, equations: InternalEquations, found: _Iterate, history: tuple[float, ...]
              ) -> PeriodicSolution:
    period = found.history
    samples, nodes = period.state.shape
    internal = equations.whole_motion(found.seen, found.balance.other)
    loads = problem.loads_at(2.0 * np.pi * np.arange(samples) / samples)
    force = period.force.reshape(samples, nodes, 3)
    return PeriodicSolution(
        method="quasi-static", frequency=problem.frequency,
        displacement=period.displacement.reshape(samples, nodes, 3).copy(), force=force.copy(), state=period.state,
        internal=internal, outputs=problem.boundary.observe(internal, period.displacement, period.force, loads),
        friction_force=-force[:, :, 0].sum(axis=1), residual_history=history, error_estimate=float("nan"))
