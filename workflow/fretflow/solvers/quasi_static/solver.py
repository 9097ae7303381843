"""The true periodic solver: the rig by harmonics, the contact quasi-static at every time sample.

The specimens' own modes lie two decades above the harmonics that matter, so the contact nodes carry no inertia and
their motion has no reason to be truncated (the idea of a massless boundary; Monjaraz-Tec, Gross and Krack 2022).
The rig's few inertial DOF are harmonic, and the contact's friction force is a functional Phi of the arm's motion x:

    Z_a(k omega) x_k = g_k + Phi_k[x],    k = 0..H

with Z_a the rig's impedance at the arm after elimination of the block. Newton on the 2 H + 1 coefficients of x uses
the exact tangent of Phi from the march of the contact. Further forces on the rig are raised from nothing where the
whole of them is too far from the first guess.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.audit import audit_period
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.arm import ArmEquations, RigBalance
from fretflow.solvers.quasi_static.backbone import Backbone, find_arm
from fretflow.solvers.quasi_static.candidate_nodes import (
    candidate_nodes,
    extend_solution,
    penetrating,
    restrict,
    restrict_solution,
)
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion, jenkins_rig_motion
from fretflow.solvers.quasi_static.march import ContactMarch, PeriodHistory, PeriodicMarch
from fretflow.solvers.quasi_static.sample import Array, ContactSystem, SampleState
from fretflow.structure.two_mass_rig.forces import ShareOfForce
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint

SMALLEST_STEP = 1e-3
SMALLEST_SHARE = 0.05  # step in which further forces on the rig are raised
REPEATS = 0.02  # how well a period must repeat, relative to the residual before it
STEP_ANGLE = 0.15  # of the fastest oscillation, in a first guess marched with forces on the rig
LAGGED = 0.3  # decrease of the residual with which a former tangent serves
NEAR = 1e-2  # residual below which the last period is a good guess of the next
# Violation of the contact law over the solver's tolerance, and at least, that counts as one: ten times what was seen of
# the direction of sliding, and a hundred times of all else.
UNLAWFUL, LEAST_UNLAWFUL = 1e3, 1e-6
COARSE = 1e-6  # tolerance from which a period is a step on the way to something, and its contact as rough
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
        joint = problem.joint.quasi_static()
        nodes = candidate_nodes(problem, joint, start)
        while not nodes.all():
            near = None if start is None else restrict_solution(start, nodes)
            found = extend_solution(self._solve_all(restrict(problem, joint, nodes), samples, near), joint, nodes)
            missed = penetrating(found, problem.interface, nodes)
            if not missed.any():
                return found
            nodes, start = nodes | missed, found
        return self._solve_all(replace(problem, joint=joint), samples, start)

    def _solve_all(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        if start is None and problem.rig_forces:
            try:
                return self._find(problem, samples, None, marched=True)
            except NonConvergenceError:
                pass  # partial slip, where one element is no good guess
        try:
            return self._find(problem, samples, start)
        except NonConvergenceError:
            if start is not None or not problem.rig_forces:
                raise
        found, share, step = self._find(replace(problem, rig_forces=()), samples, None), 0.0, 0.5
        while share < 1.0:
            target = min(1.0, share + step)
            part = replace(problem, rig_forces=tuple(ShareOfForce(target, force) for force in problem.rig_forces))
            try:
                found = self._find(part, samples, found)
            except NonConvergenceError:
                step *= 0.5
                if step < SMALLEST_SHARE:
                    raise
                continue
            share, step = target, 2.0 * step
        return found

    def _find(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None,
              marched: bool = False) -> PeriodicSolution:
        joint = problem.joint.quasi_static()
        harmonics = min(self.settings.resolved_harmonics, (samples - 1) // 2)
        equations = ArmEquations.of(problem, harmonics, samples)
        march = ContactMarch.of(problem)
        near_starts: tuple[_Start, ...] = ()
        if start is None:
            contact = march.preloaded(problem.frictional_preload)
        else:
            near = _as_trajectory(start, march.system, samples)
            contact = near.sample(samples - 1)
            block = equations.analysis @ _resample(start.rig_displacement[:, 0], samples)
            near_starts = (_Start(equations.analysis @ near.arm, block, near),)
        newton = _ArmNewton(equations, march, problem.excitation, self.settings.tolerance)
        found, history = newton.solve(chain(near_starts, _cold_starts(problem, equations, march, marched)), contact,
                                      self.settings.max_iterations)
        return _solution(problem, joint, equations, found, history)


def _cold_starts(problem: PeriodicProblem, equations: ArmEquations, march: ContactMarch, marched: bool
                 ) -> Iterator[_Start]:
    """Make the start that needs no neighbouring period."""
    if marched:
        block, arm = (equations.analysis @ _marched(problem, march, len(equations.synthesis))).T
        yield _Start(arm, block)
    else:
        yield _first_start(problem, equations, march, march.preloaded(problem.frictional_preload))


def _first_start(problem: PeriodicProblem, equations: ArmEquations, march: ContactMarch, contact: SampleState
                 ) -> _Start:
    """Return the arm's motion on the contact's backbone, with its tangent, or where that fails on a Jenkins element."""
    try:
        backbone = Backbone.of(march, contact)
        arm = find_arm(problem, equations, backbone)
    except NonConvergenceError:
        return _Start(equations.analysis @ jenkins_arm_motion(
            problem.joint.quasi_static().rig, *_one_element(march), problem.excitation, problem.frequency,
            len(equations.synthesis)))
    _, tangent = backbone.friction(equations.synthesis @ arm, equations.synthesis)
    return _Start(arm, tangent=equations.analysis @ tangent)


def _marched(problem: PeriodicProblem, march: ContactMarch, samples: int) -> Array:
    """Return the motion (samples, 2) in m of block and arm on one Jenkins element, with all forces on the rig."""
    rig, (stuck, limit) = problem.joint.quasi_static().rig, _one_element(march)
    stiffest = rig.stiffness + np.diag([0.0, stuck])
    fastest = float(np.sqrt(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(rig.mass, stiffest))))))
    per_sample = -(-int(fastest / (problem.frequency * STEP_ANGLE)) // samples) or 1
    phase = 2.0 * np.pi * np.arange(samples * per_sample) / (samples * per_sample)
    drive = problem.excitation * np.cos(phase)
    for order, amplitude in problem.overtones:
        drive = drive + (amplitude * np.exp(1j * order * phase)).real
    return jenkins_rig_motion(rig, problem.rig_forces, stuck, limit, drive.tolist(), problem.frequency)[::per_sample]


def _one_element(march: ContactMarch) -> tuple[float, float]:
    """Return the stiffness (N/m) of the stuck contact and the limit (N) of the whole."""
    system = march.system
    return float(march.solver.kbx[:system.size].sum()), float(system.friction.mean()) * system.load


@dataclass(frozen=True)
class _Start:
    """Coefficients (2 H + 1,) of the arm and of the block, None where that follows the arm, and what is known near by.

    That is a period, and the `tangent` (2 H + 1, 2 H + 1) N/m of the friction force.
    """

    arm: Array
    block: Array | None = None
    near: PeriodHistory | None = None
    tangent: Array | None = None


@dataclass(frozen=True)
class _Iterate:
    """The arm's coefficients, the period they make, the rig's balance with it and its norm over the excitation.

    `tangent` (2 H + 1, 2 H + 1) N/m is that of the friction force, None where it has to be made anew. The block
    `follows` the arm, or is an unknown beside it.
    """

    arm: Array
    trajectory: PeriodHistory
    rig: RigBalance
    norm: float
    tangent: Array | None
    follows: bool


class _ArmNewton:
    """Newton on the arm's coefficients with a line search on the residual.

    The tangent costs five times the period itself, so that it is made only where a step was taken. Close to the root
    that of the step before serves, at first that of the contact's backbone, corrected so that it gives the change of
    friction just seen (C. G. Broyden, Math. Comp. 19 (1965) 577-593).
    """

    def __init__(self, equations: ArmEquations, march: ContactMarch, scale: float, tolerance: float) -> None:
        self.equations = equations
        self.march = march
        self.scale = scale
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
                period = self._march(start.arm, self._none, before, start.near, 1.0)
                found = self._iterate(start, period.trajectory, start.tangent)
            except NonConvergenceError as error:
                failure = error
                continue
            best = found if best is None or found.norm < best.norm else best
        if best is None:
            raise failure
        return best

    def _march(self, arm: Array, directions: Array, before: SampleState, near: PeriodHistory | None, last: float
               ) -> PeriodicMarch:
        """March the period of `arm`; `last` is the norm before, for the contact's accuracy."""
        # the contact need not be solved much closer than the residual that Newton is about to reach
        accuracy = max(0.1 * self.tolerance, min(1e-6, 1e-3 * last**2))
        repeat = min(REPEATS * last, last**2)
        return self.march.period(self.equations.synthesis @ arm, directions, before, near, accuracy, repeat)

    @property
    def _none(self) -> Array:
        return np.zeros((len(self.equations.synthesis), 0))

    def _iterate(self, at: _Start, trajectory: PeriodHistory, tangent: Array | None = None) -> _Iterate:
        e = self.equations
        rig = e.balance(at.arm) if at.block is None else e.beside_balance(at.arm, at.block)
        residual = rig.residual - e.analysis @ trajectory.friction
        return _Iterate(at.arm, trajectory, replace(rig, residual=residual),
                        float(np.hypot(np.linalg.norm(residual), rig.size)) / self.scale, tangent, at.block is None)

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
        step = np.linalg.solve(now.rig.jacobian - tangent, -now.rig.reduced)
        moved, length = now.rig.block_step(step), 1.0
        while length >= shortest:
            following = self._tried(now, tangent, length * step, length * moved)
            if following is not None and following.norm < (1.0 - 1e-3 * length) * now.norm:
                serves = following.norm < min(lagged_below, LAGGED * now.norm)
                return following if serves else replace(following, tangent=None)
            length *= 0.5
        return None

    def _differentiated(self, now: _Iterate) -> tuple[_Iterate, Array]:
        """Return the same iterate, marched once more, and the tangent there."""
        e = self.equations
        found = self._march(now.arm, e.synthesis, now.trajectory.sample(-1), now.trajectory, now.norm)
        block = None if now.follows else now.rig.block
        return self._iterate(_Start(now.arm, block), found.trajectory), e.analysis @ found.tangent

    def _tried(self, now: _Iterate, tangent: Array, step: Array, moved: Array) -> _Iterate | None:
        """Return the iterate after a step, with the tangent corrected by it; None where the contact is not found."""
        near = now.trajectory if now.norm < NEAR else None
        try:
            found = self._march(now.arm + step, self._none, now.trajectory.sample(-1), near,
                                now.norm).trajectory
        except NonConvergenceError:  # of the contact, too far from where it was
            return None
        felt = self.equations.analysis @ (found.friction - now.trajectory.friction)
        corrected = tangent + np.outer(felt - tangent @ step, step / (step @ step))
        return self._iterate(_Start(now.arm + step, now.rig.block + moved), found, corrected)


def press(problem: PeriodicProblem) -> SampleState:
    """Return the contact under the normal load before anything moves, pressed as `problem` says."""
    return ContactMarch.of(problem).preloaded(problem.frictional_preload)


def sliding_distance(solution: PeriodicSolution, interface: Interface) -> float:
    """Return the peak-to-peak of the area mean of the faces' relative x displacement, m."""
    mean = solution.displacement[:, :, 0] @ interface.areas / interface.areas.sum()
    return float(np.ptp(mean))


def _resample(values: NDArray[Any], samples: int) -> NDArray[Any]:
    """Take the nearest earlier sample of a period (N, ...) at each of `samples` times."""
    taken: NDArray[Any] = values[np.arange(samples) * len(values) // samples]
    return taken


def _as_trajectory(solution: PeriodicSolution, system: ContactSystem, samples: int) -> PeriodHistory:
    """Read a solution as a guess; the arm's approach follows from the balance of the normal forces."""
    nodes = solution.displacement.shape[1]
    u, f = (_resample(a, samples).transpose(0, 2, 1).reshape(samples, 3 * nodes)
            for a in (solution.displacement, solution.force))
    kbx, kbz = system.rigid_forces()
    arm = _resample(solution.rig_displacement[:, 1], samples)
    unbalanced = u @ kbz - arm * kbx[2 * nodes:].sum() - f[:, 2 * nodes:].sum(axis=1)
    return PeriodHistory(arm, u, f, unbalanced / kbz[2 * nodes:].sum(), _resample(solution.state, samples))


def _solution(problem: PeriodicProblem, joint: QuasiStaticJoint, equations: ArmEquations, found: _Iterate,
              history: tuple[float, ...]) -> PeriodicSolution:
    period = found.trajectory
    samples, nodes = period.state.shape
    u, f = (a.reshape(samples, 3, nodes).transpose(0, 2, 1) for a in (period.displacement, period.force))
    moved = equations.synthesis @ found.arm
    upper, lower = joint.observe(np.column_stack([moved, period.approach]), f.reshape(samples, 3 * nodes))
    return PeriodicSolution(
        method="quasi-static", frequency=problem.frequency, displacement=np.ascontiguousarray(u),
        force=np.ascontiguousarray(f), state=period.state,
        rig_displacement=np.column_stack([equations.synthesis @ found.rig.block, moved]),
        upper_observation=upper, lower_observation=lower, friction_force=-period.friction,
        residual_history=history, error_estimate=float("nan"))
