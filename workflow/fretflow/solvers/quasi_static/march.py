"""The contact marched through a period of arm motion, with the exact tangent of its friction force.

The friction force is a functional of the arm's motion: what a sample does depends on what slid before. The tangent
carries the derivative of the displacement from sample to sample with the same factors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.march import Course, march
from fretflow.contact.kernels.sample import Marched, empty_march
from fretflow.contact.law import MotionFactor
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.sample import (
    SEPARATION,
    STICK,
    Array,
    ContactSystem,
    Instant,
    SampleSolver,
    SampleState,
    not_found,
    plain,
)

MAX_PERIODS = 60
MAX_PRELOAD_STEPS = 100
PRELOAD_PARTS = 20  # of a load applied against friction
NEWTON_AFTER = 3  # periods
HELPS = 0.5  # decrease of the drift with which a former T serves once more
PERSISTS = 1e-6  # share of I - T below which a position persists; where T is a former one:
MAY_PERSIST = 1e-3
SMALL = 1e-3  # drift relative to the mean nodal load; one that is larger a former T might lead elsewhere
SLOPE_REPEATS = 1e-3  # change of the displacements' derivatives from period to period, m/m


@dataclass(frozen=True)
class PeriodHistory:
    """A marched period: arm q_x (N,), u and f (N, 3 n) in component order, arm q_z (N,), state (N, n)."""

    arm: Array
    displacement: Array
    force: Array
    approach: Array
    state: NDArray[np.int8]

    def sample(self, j: int) -> SampleState:
        """Return sample j."""
        return SampleState(self.displacement[j], self.force[j], float(self.approach[j]), self.state[j])


    @cached_property
    def marched(self) -> Marched:
        """Return the samples as the compiled loops take them."""
        return Marched(plain(self.displacement), plain(self.force), plain(self.approach),
                       np.require(self.state, dtype=np.int8, requirements=["C", "W"]))

    @property
    def friction(self) -> Array:
        """Return the x force on the upper specimen, (N,) in N."""
        n = self.state.shape[1]
        force: Array = self.force[:, :n].sum(axis=1)
        return force


@dataclass(frozen=True)
class PeriodicMarch:
    """A period that repeats, and the tangent of its friction force to arm motions, (N, p)."""

    trajectory: PeriodHistory
    tangent: Array
    periods: int


@dataclass(frozen=True)
class _Pass:
    """One marched period and where it ended; slope (3 n, p) is the end's derivative."""

    trajectory: PeriodHistory
    tangent: Array
    end: SampleState
    slope: Array


@dataclass(frozen=True)
class Conditions:
    """What changes with the arm's motion x(t): normal load and the factor on friction, with their derivatives.

    `load`, `grip` (N,); `load_slope`, `grip_slope` (N, p), by the motions that were asked for.
    """

    load: Array
    grip: Array
    load_slope: Array
    grip_slope: Array

    def at(self, j: int) -> Instant:
        """Return those of sample j."""
        return Instant(float(self.load[j]), float(self.grip[j]))


@dataclass(frozen=True)
class Surroundings:
    """How the contact's surroundings follow the arm: load ``N + slope x``, friction by factors of x and its rate."""

    omega: float = 1.0
    load_slope: float = 0.0
    factors: tuple[MotionFactor, ...] = ()

    @classmethod
    def of(cls, problem: PeriodicProblem) -> Surroundings:
        """Return those of `problem`."""
        return cls(problem.omega, problem.load_slope, problem.motion_factors)

    def conditions(self, load: float, arm: Array, directions: Array) -> Conditions:
        """Return the conditions of a period of arm positions (N,), m, and their derivatives by `directions` (N, p).

        Raises
        ------
        NonConvergenceError
            If the motion would lift the arm off.
        """
        loads = load + self.load_slope * arm
        if not loads.min() > 0.0:
            raise NonConvergenceError("the normal load vanishes during the motion; lower the load's slope or the drive")
        grip, grip_slope = np.ones_like(arm), np.zeros_like(directions)
        if self.factors:
            velocity, rates = time_derivative(arm, self.omega), time_derivative(directions, self.omega)
            for factor in self.factors:
                value, by_position, by_velocity = factor(arm, velocity)
                grip_slope = value[:, None] * grip_slope + grip[:, None] * (
                    by_position[:, None] * directions + by_velocity[:, None] * rates)
                grip = grip * value
        return Conditions(loads, grip, self.load_slope * directions, grip_slope)


def frictionless_preload(system: ContactSystem, flexibility_zz: Array) -> tuple[Array, float, NDArray[np.bool_]]:
    """Press the faces together without friction by an active-set iteration.

    Parameters
    ----------
    system : ContactSystem
    flexibility_zz : (n, n)
        Normal flexibility of the contact nodes, m/N.

    Returns
    -------
    (n,), float, (n,)
        Normal forces in N, approach of the arm in m, and which nodes are closed.

    Raises
    ------
    NonConvergenceError
        If the set of closed nodes does not settle.
    """
    closed: NDArray[np.bool_] = np.ones(system.size, dtype=bool)
    for _ in range(MAX_PRELOAD_STEPS):
        i = np.flatnonzero(closed)
        matrix = np.ones((len(i) + 1, len(i) + 1))
        matrix[:-1, :-1], matrix[-1, -1] = flexibility_zz[np.ix_(i, i)], 0.0
        found = np.linalg.solve(matrix, np.append(-system.gap[i], system.load))
        force = np.zeros(system.size)
        force[i], approach = found[:-1], float(found[-1])
        opening = system.gap + approach + flexibility_zz @ force
        new = np.where(closed, force > 0.0, opening < 0.0)
        if np.array_equal(new, closed):
            return force, approach, closed
        closed = new
    raise NonConvergenceError("static preload: the set of closed nodes did not settle; check the gap of the faces")


class ContactMarch:
    """Marches the contact of one system through periods of arm motion."""

    def __init__(self, system: ContactSystem, flexibility: Array, surroundings: Surroundings | None = None) -> None:
        """Take the flexibility (3 n, 3 n) in node order, m/N."""
        self.system = system
        self.flexibility = flexibility
        self.surroundings = surroundings or Surroundings()
        self.solver = SampleSolver(system)
        self.repeat = 0.0  # N, see `period`
        self._returning: Array = np.zeros((0, 0))  # (2 n, 2 n), see `_newton_start`

    @classmethod
    def of(cls, problem: PeriodicProblem) -> ContactMarch:
        """Return the contact of `problem`."""
        joint = problem.joint.quasi_static()
        return cls(ContactSystem.of(problem, joint.stiffness), joint.flexibility, Surroundings.of(problem))

    def preloaded(self, frictional: bool = False) -> SampleState:
        """Return the joint under its normal load, the faces frictionless or not while it is applied."""
        return self._pressed() if frictional else self._settled()

    def _pressed(self) -> SampleState:
        """Apply the load in small parts against friction, the arm held along x."""
        n = self.system.size
        state = SampleState(np.zeros(3 * n), np.zeros(3 * n), 0.0, np.full(n, STICK, dtype=np.int8))
        state.displacement[2 * n:] = -self.system.gap
        for share in np.arange(1, PRELOAD_PARTS + 1) / PRELOAD_PARTS:
            part = replace(self.system, load=share * self.system.load)
            state = SampleSolver(part).solve(0.0, state.displacement, state, 0.0)
        return state

    def _settled(self) -> SampleState:
        n = self.system.size
        normal, approach, closed = frictionless_preload(self.system, self.flexibility[2::3, 2::3])
        u = (self.flexibility[:, 2::3] @ normal).reshape(n, 3).T.copy()
        u[2] += approach
        force = np.concatenate([np.zeros(2 * n), normal])
        return SampleState(u.ravel(), force, approach, np.where(closed, STICK, SEPARATION).astype(np.int8))

    def period(self, arm: Array, directions: Array, start: SampleState, guess: PeriodHistory | None,
               tolerance: float, repeat: float = 0.0) -> PeriodicMarch:
        """March until the contact repeats itself, and with it the tangent.

        Parameters
        ----------
        arm : (N,)
            Arm positions in m.
        directions : (N, p)
            Derivative of the arm positions by p parameters.
        start : SampleState
            Contact before the first sample of the first period.
        guess : PeriodHistory or None
            A neighbouring period.
        tolerance : float
            Largest force residual at a node, relative to the mean nodal load.
        repeat : float
            Largest change of a nodal force from period to period, likewise; at least a hundred tolerances.

        Raises
        ------
        NonConvergenceError
            If the contact does not repeat within 60 periods.
        """
        mean_load = self.system.load / self.system.size
        self.solver.tolerance = tolerance * mean_load
        self.repeat = max(100.0 * tolerance, repeat) * mean_load
        before, slope, last = start, np.zeros((3 * self.system.size, directions.shape[1])), np.inf
        run = self._pass(arm, directions, before, slope, guess)
        for period in range(1, MAX_PERIODS):
            drift = self._drift(run, before, slope)
            waits = period <= NEWTON_AFTER and not self._lingers(run, before)
            led = not waits and drift < HELPS * last and self._knows(run, before)
            if led:
                before, slope = self._led(run, before, slope, MAY_PERSIST)
            elif waits:
                before, slope = run.end, run.slope
            else:
                before, slope = self._newton_start(arm, directions, run)
            last = drift if led else np.inf
            # the first loading is a poor guess of the way back: there the sample before serves better
            near = None if guess is None and period == 1 else run.trajectory
            try:
                run = self._pass(arm, directions, before, slope, near, run)
            except NonConvergenceError:
                if waits:
                    raise
                before, slope, last, self._returning = run.end, run.slope, np.inf, np.zeros((0, 0))  # led astray
                run = self._pass(arm, directions, before, slope, near, run)
            if self._repeats(run, before, slope) and not (led and self._drift(run, before, slope) > 1.0):
                return PeriodicMarch(run.trajectory, run.tangent, period + 1)
        raise NonConvergenceError(
            f"the contact did not repeat itself within {MAX_PERIODS} periods; it may ratchet under this load")

    def _pass(self, arm: Array, directions: Array, start: SampleState, slope: Array, guess: PeriodHistory | None,
              last: _Pass | None = None) -> _Pass:
        """March one period; where it has become the `last` one, the rest is taken from there."""
        n, samples = self.system.size, len(arm)
        found, tangent = empty_march(samples, n), np.zeros((samples, directions.shape[1]))
        under = self.surroundings.conditions(self.system.load, arm, directions)
        course = Course(*map(plain, (arm, under.load, under.grip, directions, under.load_slope, under.grip_slope)))
        none = empty_march(0, n)
        until, after = march(
            self.system.data, self.solver.factors, course, start.alone(), plain(slope),
            none if guess is None else guess.marched, none if last is None else last.trajectory.marched,
            tangent[:0] if last is None else last.tangent, (self.solver.tolerance, self.repeat), found, tangent)
        if until < 0:
            raise not_found(float(arm[-1 - until]))
        trajectory = PeriodHistory(arm, *found)
        if last is not None and until < samples:
            return _Pass(trajectory, tangent, last.end, last.slope)
        return _Pass(trajectory, tangent, trajectory.sample(samples - 1), after)

    def _newton_start(self, arm: Array, directions: Array, run: _Pass) -> tuple[SampleState, Array]:
        """Return the contact, and its slope, from which a period should end as it began.

        A partly sliding contact creeps toward its shakedown state over many periods. With T the derivative of
        the slid positions after a period by those before it, Newton leads there at once: (I - T) du = drift.
        T costs ten times the period itself, so that it is kept as long as it serves.
        """
        n, p, memory = self.system.size, directions.shape[1], _memory(run)
        own = np.zeros((3 * n, len(memory)))
        own[memory, np.arange(len(memory))] = 1.0
        still = np.zeros((len(arm), len(memory)))
        probe = self._pass(arm, np.hstack([directions, still]), run.end, np.hstack([run.slope, own]), run.trajectory)
        self._returning = np.zeros((2 * n, 2 * n))
        self._returning[np.ix_(memory, memory)] = probe.slope[memory, p:]
        return self._led(replace(probe, slope=probe.slope[:, :p]), run.end, run.slope, PERSISTS, memory)

    def _led(self, run: _Pass, before: SampleState, slope: Array, persists: float,
             memory: NDArray[np.intp] | None = None) -> tuple[SampleState, Array]:
        """Return where to start instead of `before` and `slope`, from which `run` was marched, with the T in hand."""
        at = _memory(run) if memory is None else memory
        returning = self._returning[np.ix_(at, at)]
        drift = np.column_stack([run.slope[at] - slope[at], (run.end.displacement - before.displacement)[at]])
        # some positions persist for ever (T = 1): for those no more than the drift itself
        change = drift + np.linalg.lstsq(np.eye(len(at)) - returning, returning @ drift, rcond=persists)[0]
        slope, displacement = slope.copy(), before.displacement.copy()
        slope[at] += change[:, :-1]
        displacement[at] += change[:, -1]
        return SampleState(displacement, run.end.force, run.end.approach, run.end.state), slope

    def _lingers(self, run: _Pass, before: SampleState) -> bool:
        """Tell whether derivatives are all that has yet to repeat, and that slowly because some node always sticks."""
        repeats = np.abs(run.end.force - before.force).max() < self.repeat
        return bool(run.slope.shape[1] and repeats and not _forgets(run))

    def _knows(self, run: _Pass, before: SampleState) -> bool:
        """Tell whether there is a former T and too little left for it to lead astray."""
        return self._returning.size > 0 and self._moved(run, before) < SMALL * self.system.load / self.system.size

    def _moved(self, run: _Pass, before: SampleState) -> float:
        """Return how far from its start a period ends, as a nodal force in N."""
        moved = np.abs(run.end.displacement - before.displacement)[:2 * self.system.size]
        return float(self.system.penalty * moved.max())

    def _drift(self, run: _Pass, before: SampleState, slope: Array) -> float:
        """Return how far from its start a period ends, 1 being about where it repeats."""
        turned = np.abs(run.slope - slope)[:2 * self.system.size].max(initial=0.0)
        return float(max(self._moved(run, before) / self.repeat, turned / SLOPE_REPEATS))

    def _repeats(self, run: _Pass, before: SampleState, slope: Array) -> bool:
        """Tell whether a period ends with the forces of `before` and with the derivatives that it began with."""
        return bool(np.abs(run.end.force - before.force).max() < self.repeat
                    and np.abs(run.slope - slope)[:2 * self.system.size].max(initial=0.0) < SLOPE_REPEATS)


def _memory(run: _Pass) -> NDArray[np.intp]:
    """Return the tangential DOFs of the nodes that do not stick all the period."""
    n = run.trajectory.state.shape[1]
    moving = np.flatnonzero(np.any(run.trajectory.state != STICK, axis=0))
    return np.concatenate([moving, n + moving])


def _forgets(run: _Pass) -> bool:
    """Tell whether no node sticks at some sample: nothing is remembered from there on."""
    return bool(np.any(np.all(run.trajectory.state != STICK, axis=1)))
