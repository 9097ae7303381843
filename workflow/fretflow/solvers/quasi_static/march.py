"""The contact marched through a period of the internal coordinates, with the exact tangent of the force they feel.

That force is a functional of the motion: what a sample does depends on what slid before. The tangent carries the
derivative of the displacement from sample to sample with the same factors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import Coulomb
from fretflow.contact.kernels.march import Forcing, march
from fretflow.contact.kernels.sample import empty_period
from fretflow.contact.law import FactorAndSlopes
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.kept_factors import WORTH_KEEPING, KeptFactors
from fretflow.solvers.quasi_static.sample import (
    SEPARATION,
    STICK,
    Array,
    ContactSystem,
    PeriodHistory,
    SampleSolver,
    SampleState,
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
UNPUSHED = 1e-9  # of the loads: force on the coordinates at rest that is round-off
SLOPE_REPEATS = 1e-3  # change of the displacements' derivatives from period to period, m/m


@dataclass(frozen=True)
class PeriodicMarch:
    """A period that repeats, and the tangent of the force on the coordinates to p motions of them, (N, d, p)."""

    history: PeriodHistory
    tangent: Array
    periods: int


@dataclass(frozen=True)
class _Pass:
    """One marched period and where it ended; slope (3 n, p) is the end's derivative."""

    history: PeriodHistory
    tangent: Array
    end: SampleState
    slope: Array


@dataclass(frozen=True)
class Surroundings:
    """What of the contact follows the motion beside the pull: friction, by factors of position and speed along x.

    `sliding` (d,) is the moving faces' x by the coordinates; `free` (3 n, s) the motions under the normal load alone.
    """

    law: Coulomb
    omega: float
    sliding: Array
    free: Array

    @classmethod
    def of(cls, problem: PeriodicProblem, seen: NDArray[np.intp]) -> Surroundings:
        """Return those of `problem` and the coordinates `seen`."""
        return cls(problem.law, problem.omega, problem.boundary.sliding[seen], problem.boundary.free)

    def friction_factor(self, position: Array) -> FactorAndSlopes:
        """Return the factor on friction (N,) over a period of coordinates (N, d), and its slopes."""
        x = position @ self.sliding
        if not self.law.motion_factors:
            return FactorAndSlopes(np.ones_like(x), np.zeros_like(x), np.zeros_like(x))
        return self.law.factor(x, time_derivative(x, self.omega))

    def factor_slope(self, factor: FactorAndSlopes, directions: Array) -> Array:
        """Return the derivative (N, p) of the factor by directions (N, d, p) of the coordinates."""
        if not self.law.motion_factors:
            return np.zeros((len(directions), directions.shape[2]))
        x = np.einsum("jdp,d->jp", directions, self.sliding)
        return np.asarray(factor.by_position[:, None] * x
                          + factor.by_velocity[:, None] * time_derivative(x, self.omega))

    def check(self, pull: Array) -> None:
        """Check that the normal load never vanishes under the pull (N, 3 n).

        Raises
        ------
        NonConvergenceError
            If the motion would lift the faces off.
        """
        if self.free.shape[1] and not (pull @ self.free).max() < 0.0:
            raise NonConvergenceError("the normal load vanishes during the motion; lower the load's slope or the drive")


def press_frictionless(gap: Array, flexibility_zz: Array, free_z: Array, free_load: Array
                       ) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Press faces together without friction by an active-set iteration.

    Parameters
    ----------
    gap : (n,)
        Gap of the nodes where no force acts, m.
    flexibility_zz : (n, n)
        Their normal flexibility, m/N.
    free_z, free_load : (n, s), (s,)
        Normal motions by free coordinates, and the loads on these, N.

    Returns
    -------
    (n,), (s,), (n,)
        Normal forces in N, the free coordinates in m, and which nodes are closed.

    Raises
    ------
    NonConvergenceError
        If the set of closed nodes does not settle, or no closed node holds the load.
    """
    closed: NDArray[np.bool_] = np.ones(len(gap), dtype=bool)
    for _ in range(MAX_PRELOAD_STEPS):
        i = np.flatnonzero(closed)
        c, size = len(i), len(i) + len(free_load)
        matrix = np.zeros((size, size))
        matrix[:c, :c], matrix[:c, c:], matrix[c:, :c] = flexibility_zz[np.ix_(i, i)], free_z[i], free_z[i].T
        try:
            solution = np.linalg.solve(matrix, np.append(-gap[i], free_load))
        except np.linalg.LinAlgError:
            break
        force = np.zeros(len(gap))
        force[i], free = solution[:c], solution[c:]
        opening = gap + free_z @ free + flexibility_zz @ force
        new = np.where(closed, force > 0.0, opening < 0.0)
        if np.array_equal(new, closed):
            return force, free, closed
        closed = new
    raise NonConvergenceError("static preload: the set of closed nodes did not settle; check the gap of the faces")


@dataclass(frozen=True)
class Rest:
    """The faces before anything moves: flexibility (3 n, 3 n) m/N, free motions (3 n, s) and loads (s,) N on these.

    `offset` (3 n,) m is what constant loads move.
    """

    flexibility: Array
    free: Array
    free_load: Array
    offset: Array

    @classmethod
    def of(cls, problem: PeriodicProblem) -> Rest:
        """Return the faces of `problem`; internal coordinates are at zero, or where they have to give way."""
        b, loads = problem.boundary, problem.loads(0)[0].real
        held = cls(b.flexibility, b.free, b.input_free @ loads, b.input_motion @ loads)
        pushed = b.input_force @ loads + b.transfer @ held.settled(problem.interface.gap).force
        if np.abs(pushed).max(initial=0.0) <= UNPUSHED * float(np.abs(loads).sum()):
            return held
        yielding = b.motion @ np.linalg.pinv(b.internal.stiffness, hermitian=True)
        return replace(held, flexibility=b.flexibility + yielding @ b.transfer,
                       offset=held.offset + yielding @ (b.input_force @ loads))

    def settled(self, gap: Array) -> SampleState:
        """Return the faces pressed without friction, their nodes' gap being (n,) m."""
        zz = self.flexibility[2::3, 2::3]
        normal, free, closed = press_frictionless(gap + self.offset[2::3], zz, self.free[2::3], self.free_load)
        force = np.zeros(len(self.offset))
        force[2::3] = normal
        u = self.offset + self.free @ free + self.flexibility[:, 2::3] @ normal
        return SampleState(u, force, np.where(closed, STICK, SEPARATION).astype(np.int8))


class ContactMarch:
    """Marches the contact of one system through periods of the internal coordinates."""

    def __init__(self, system: ContactSystem, surroundings: Surroundings, rest: Callable[[], SampleState]) -> None:
        """Take the contact, what follows the motion, and what presses the faces before anything moves."""
        self.system, self.surroundings, self.rest = system, surroundings, rest
        self.solver = SampleSolver(system)
        self._kept = KeptFactors(system.size, self.solver.factors[0]) if system.size >= WORTH_KEEPING else None
        self.repeat = 0.0  # N, see `period`
        self._tangential = np.arange(3 * system.size) % 3 != 2
        self._returning: Array = np.zeros((0, 0))  # (3 n, 3 n), see `_newton_start`

    @classmethod
    def of(cls, problem: PeriodicProblem, seen: NDArray[np.intp]) -> ContactMarch:
        """Return the contact of `problem` and the coordinates `seen` from it."""
        return cls(ContactSystem.of(problem, seen), Surroundings.of(problem, seen),
                   lambda: Rest.of(problem).settled(problem.interface.gap))

    @property
    def memory(self) -> Array:
        """The derivative of the slid positions after a period by those before it, (3 n, 3 n), or (0, 0)."""
        return self._returning

    @memory.setter
    def memory(self, returning: Array) -> None:
        self._returning = returning

    def preloaded(self, frictional: bool = False) -> SampleState:
        """Return the joint under its normal load, the faces frictionless while it is applied, or not.

        Raises
        ------
        NonConvergenceError
            If the contact does not settle.
        """
        return self._pressed() if frictional else self.rest()

    def _pressed(self) -> SampleState:
        """Apply the load in small parts against friction, the coordinates held."""
        n = self.system.size
        state = SampleState(np.zeros(3 * n), np.zeros(3 * n), np.full(n, STICK, dtype=np.int8))
        state.displacement[2::3] = -self.system.gap
        for part in np.arange(1, PRELOAD_PARTS + 1):
            before, share = ((part - step) / PRELOAD_PARTS for step in (1, 0))
            solver = SampleSolver(replace(self.system, load=share * self.system.load))
            state = solver.solve(share * self.system.pull, state.displacement, state, before * self.system.pull)
        return state

    def period(self, position: Array, directions: Array, start: SampleState, guess: PeriodHistory | None,
               tolerance: float, repeat: float = 0.0) -> PeriodicMarch:
        """March until the contact repeats itself, and with it the tangent.

        Parameters
        ----------
        position : (N, d)
            Coordinates in m.
        directions : (N, d, p)
            Their derivative by p parameters.
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
        before, slope, last = start, np.zeros((3 * self.system.size, directions.shape[2])), np.inf
        forcing = self._forcing(position, directions)
        run = self._pass(position, forcing, before, slope, guess)
        for period in range(1, MAX_PERIODS):
            drift = self._drift(run, before, slope)
            waits = period <= NEWTON_AFTER and not self._derivatives_lag(run, before)
            shot = not waits and drift < HELPS * last and self._has_monodromy(run, before)
            if shot:
                before, slope = self._shooting_step(run, before, slope, MAY_PERSIST)
            elif waits:
                before, slope = run.end, run.slope
            else:
                before, slope = self._newton_start(position, directions, run)
            last = drift if shot else np.inf
            # the first loading is a poor guess of the way back: there the sample before serves better
            near = None if guess is None and period == 1 else run.history
            # a derivative that starts elsewhere has to end there by itself: the last period's ends where that began
            same = run if waits or not slope.shape[1] else None
            try:
                run = self._pass(position, forcing, before, slope, near, same)
            except NonConvergenceError:
                if waits:
                    raise
                before, slope, last, self._returning = run.end, run.slope, np.inf, np.zeros((0, 0))  # misled
                run = self._pass(position, forcing, before, slope, near, run)
            if self._repeats(run, before, slope) and not (shot and self._drift(run, before, slope) > 1.0):
                return PeriodicMarch(run.history, run.tangent[:, :position.shape[1]], period + 1)
        raise NonConvergenceError(
            f"the contact did not repeat itself within {MAX_PERIODS} periods; it may ratchet under this load")

    def _forcing(self, position: Array, directions: Array) -> Forcing:
        """Return what a period of the coordinates (N, d) is under, and its derivatives by `directions` (N, d, p)."""
        pull = self.system.pulled(position)
        self.surroundings.check(pull)
        factor = self.surroundings.friction_factor(position)
        return Forcing(*map(plain, (pull, factor.factor, self.system.moved(position, directions),
                                    self.surroundings.factor_slope(factor, directions))))

    def _pass(self, position: Array, forcing: Forcing, start: SampleState, slope: Array, guess: PeriodHistory | None,
              last: _Pass | None = None) -> _Pass:
        """March one period; where it has become the `last` one, the rest is taken from there."""
        system, samples = self.system, len(position)
        history = empty_period(samples, system.size, position.shape[1])
        tangent = np.zeros(forcing.directions.shape)
        history.position[:] = position
        none = empty_period(0, system.size, position.shape[1])
        near, former = guess or none, last.history if last else none
        limits = self.solver.tolerance, self.repeat
        if self._kept is not None and not tangent.shape[2]:
            until, after = self._kept.march(system.data, forcing, start.alone(), near, former, limits, history), slope
        else:
            until, after = march(system.data, self.solver.factors, forcing, start.alone(), plain(slope), near, former,
                                 tangent[:0] if last is None else last.tangent, limits, history, tangent)
        if until < 0:
            raise NonConvergenceError(f"contact at time sample {-1 - until} of {samples} did not converge; use more "
                                      "samples per period")
        if last is not None and until < samples:
            return _Pass(history, tangent, last.end, last.slope)
        return _Pass(history, tangent, SampleState.of(history), after)

    def _newton_start(self, position: Array, directions: Array, run: _Pass) -> tuple[SampleState, Array]:
        """Return the contact, and its slope, from which a period should end as it began.

        A partly sliding contact creeps toward its shakedown state over many periods. With T the derivative of
        the slid positions after a period by those before it, Newton leads there at once: (I - T) du = drift.
        T costs ten times the period itself, so that it is kept as long as it serves.
        """
        n, p, memory = self.system.size, directions.shape[2], _memory(run)
        own = np.zeros((3 * n, len(memory)))
        own[memory, np.arange(len(memory))] = 1.0
        moving = np.concatenate([directions, np.zeros((*position.shape, len(memory)))], axis=2)
        probe = self._pass(position, self._forcing(position, moving), run.end, np.hstack([run.slope, own]),
                           run.history)
        self._returning = np.zeros((3 * n, 3 * n))
        self._returning[np.ix_(memory, memory)] = probe.slope[memory, p:]
        return self._shooting_step(replace(probe, slope=probe.slope[:, :p]), run.end, run.slope, PERSISTS, memory)

    def _shooting_step(self, run: _Pass, before: SampleState, slope: Array, persists: float,
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
        return SampleState(displacement, run.end.force, run.end.state), slope

    def _derivatives_lag(self, run: _Pass, before: SampleState) -> bool:
        """Tell whether derivatives are all that has yet to repeat, and that slowly because some node always sticks."""
        repeats = np.abs(run.end.force - before.force).max() < self.repeat
        return bool(run.slope.shape[1] and repeats and not _forgets(run))

    def _has_monodromy(self, run: _Pass, before: SampleState) -> bool:
        """Tell whether there is a former T and too little left for it to lead astray."""
        return self._returning.size > 0 and self._moved(run, before) < SMALL * self.system.load / self.system.size

    def _moved(self, run: _Pass, before: SampleState) -> float:
        """Return how far from its start a period ends, as a nodal force in N."""
        moved = np.abs(run.end.displacement - before.displacement)[self._tangential]
        return float(self.system.penalty * moved.max())

    def _drift(self, run: _Pass, before: SampleState, slope: Array) -> float:
        """Return how far from its start a period ends, 1 being about where it repeats."""
        turned = np.abs(run.slope - slope)[self._tangential].max(initial=0.0)
        return float(max(self._moved(run, before) / self.repeat, turned / SLOPE_REPEATS))

    def _repeats(self, run: _Pass, before: SampleState, slope: Array) -> bool:
        """Tell whether a period ends with the forces of `before` and with the derivatives that it began with."""
        return bool(np.abs(run.end.force - before.force).max() < self.repeat
                    and np.abs(run.slope - slope)[self._tangential].max(initial=0.0) < SLOPE_REPEATS)


def press(problem: PeriodicProblem) -> SampleState:
    """Return the contact under the normal load before anything moves, pressed as `problem` says."""
    return ContactMarch.of(problem, seen_coordinates(problem.boundary)).preloaded(problem.preload.frictional)


def _memory(run: _Pass) -> NDArray[np.intp]:
    """Return the tangential DOFs of the nodes that do not stick all the period."""
    moving = np.flatnonzero(np.any(run.history.state != STICK, axis=0))
    return np.concatenate([3 * moving, 3 * moving + 1])


def _forgets(run: _Pass) -> bool:
    """Tell whether no node sticks at some sample: nothing is remembered from there on."""
    return bool(np.any(np.all(run.history.state != STICK, axis=1)))
