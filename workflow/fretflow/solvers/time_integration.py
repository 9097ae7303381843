"""Time integration of the whole structure, free of Fourier series: the check of every periodic solver.

The internal coordinates are stepped by the generalised-alpha scheme in the form of Arnold and Bruels (Multibody System
Dynamics 18, 2007): second order, unconditionally stable, and what a rigid contact excites at infinite frequency
shrinks by RADIUS each step::

    x1 = x0 + h v0 + h^2 ((1/2 - b) a0 + b a1),   v1 = v0 + h ((1 - g) a0 + g a1)
    (1 - m) a1 + m a0 = (1 - l) w1 + l w0,        M w1 + C v1 + S x1 = F(t1) + T f

with b, g, m, l functions of RADIUS (Chung and Hulbert 1993). The contact is quasi-static at the end of each step. There
the structure gives ``x1 = x_free + D T f`` with D = (i M + g / (b h) C + S)^-1, i the inertia of a step, so that the
contact sees one more flexibility in series,

    f = (1 + R D T)^-1 (K u - R x_free - P i),    (1 + R D T)^-1 = 1 - R (D^-1 + T R)^-1 T

and a step is one sample of `quasi_static.sample`. A friction force that jumps within a step costs an order, so a step
in which the moving faces turn is made in small parts. Further forces, and friction that follows the motion, are those
of the motion that is extrapolated from the step before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import press
from fretflow.solvers.quasi_static.sample import STICK, Array, ContactSystem, SampleSolver, SampleState
from fretflow.structure.internal_forces import total_force

RADIUS = 0.5
M, L = (2.0 * RADIUS - 1.0) / (RADIUS + 1.0), RADIUS / (RADIUS + 1.0)
G = 0.5 + L - M
B = 0.25 * (G + 0.5)**2
PARTS = 32
CONTACT_TOLERANCE = 1e-8  # of the mean nodal load
ROUND_OFF = 16.0 * float(np.finfo(float).eps)


@record
class TimeHistory:
    """A motion of the joint on M = periods x steps equidistant instants, ``t_j = (j + 1) T / steps``."""

    steps_per_period: int = quantity("1")
    time: NDArray[np.float64] = quantity("s", "(M,)")
    internal: NDArray[np.float64] = quantity("m", "(M, d), internal coordinates")
    outputs: Mapping[str, NDArray[np.float64]] = quantity("m", "by name, (M,) or (M, k)")
    moved: NDArray[np.float64] = quantity("m", "(M,), of the moving faces along x")
    relative_displacement: NDArray[np.float64] = quantity("m", "(M,), area mean of the faces' x")
    friction_force: NDArray[np.float64] = quantity("N", "(M,), x force of the upper specimen on the lower")
    friction_work: NDArray[np.float64] = quantity("J", "(M,), dissipated in the step that ends at each instant")

    def of_period(self, values: NDArray[np.float64], period: int = -1) -> NDArray[np.float64]:
        """Return `values` (M,) of one period (steps,), from its phase 0 on; the last period by default."""
        return np.roll(values.reshape(-1, self.steps_per_period)[period], 1)

    @property
    def sliding_distance(self) -> NDArray[np.float64]:
        """Return the peak-to-peak of the relative displacement in each period, m."""
        return np.asarray(np.ptp(self.relative_displacement.reshape(-1, self.steps_per_period), axis=1))

    @property
    def dissipated_energy(self) -> NDArray[np.float64]:
        """Return the friction's work in each period, J."""
        return np.asarray(self.friction_work.reshape(-1, self.steps_per_period).sum(axis=1))

    @property
    def change(self) -> NDArray[np.float64]:
        """Return how far each period's moving faces are from the one before, at most, over their peak-to-peak."""
        periods = self.moved.reshape(-1, self.steps_per_period)
        span = max(float(np.ptp(periods[-1])), float(np.finfo(float).tiny))
        return np.asarray(np.abs(np.diff(periods, axis=0)).max(axis=1) / span)


def integrate(problem: PeriodicProblem, start: PeriodicSolution | None, periods: int,
              steps_per_period: int) -> TimeHistory:
    """March the joint in time from phase 0 of `start`, or from rest under its normal load.

    Raises
    ------
    InputError
        If there is no period, or fewer than eight steps in one.
    NonConvergenceError
        If the contact of a step is not found.
    """
    return settle(problem, start, (periods, periods), steps_per_period, 0.0)


def settle(problem: PeriodicProblem, start: PeriodicSolution | None, periods: tuple[int, int],
           steps_per_period: int, drift: float) -> TimeHistory:
    """March like `integrate` until the moving faces repeat themselves.

    Parameters
    ----------
    problem, start, steps_per_period
        As for `integrate`.
    periods : (int, int)
        The fewest and the most periods to march.
    drift : float
        Change from one period to the next, see `TimeHistory.change`, at which to stop.

    Raises
    ------
    InputError
        If there is no period, or fewer than eight steps in one.
    NonConvergenceError
        If the contact of a step is not found.
    """
    fewest, most = periods
    if fewest < 1 or steps_per_period < 8:
        raise InputError(f"time integration: {fewest} periods of {steps_per_period} steps; "
                         "at least one period and eight steps are needed")
    march = _March(problem, _at_rest(problem) if start is None else at_phase_zero(problem, start), steps_per_period)
    marched: list[_Rows] = []
    while True:
        marched.append(march.period())
        history = _history(problem, steps_per_period, marched)
        if len(marched) >= most or (len(marched) >= max(fewest, 2) and history.change[-1].max() <= drift):
            return history


def march_periods(problem: PeriodicProblem, now: AtInstant, steps: int) -> Iterator[tuple[Array, SampleState]]:
    """Yield of each period from `now`, an instant of phase 0, the internal coordinates (steps, d) in m, phase 0 first.

    With them comes the contact at the period's end. Raises as `integrate`.
    """
    march = _March(problem, now, steps)
    while True:
        internal = march.period().internal
        yield np.roll(internal, 1, axis=0), march.now.contact


@dataclass(frozen=True)
class _Rows:
    """A marched period: internal coordinates, outputs, relative displacement, friction force and work at each step."""

    internal: Array
    outputs: dict[str, Array]
    relative: Array
    friction: Array
    work: Array


def _history(problem: PeriodicProblem, steps: int, marched: list[_Rows]) -> TimeHistory:
    size, internal = 1.0 / (problem.frequency * steps), np.concatenate([rows.internal for rows in marched])
    return TimeHistory(
        steps_per_period=steps, time=size * np.arange(1.0, len(internal) + 1), internal=internal,
        outputs={name: np.concatenate([rows.outputs[name] for rows in marched]) for name in marched[0].outputs},
        moved=internal @ problem.boundary.sliding,
        relative_displacement=np.concatenate([rows.relative for rows in marched]),
        friction_force=np.concatenate([rows.friction for rows in marched]),
        friction_work=np.concatenate([rows.work for rows in marched]))


class _March:
    """The structure on its way, period after period."""

    def __init__(self, problem: PeriodicProblem, now: AtInstant, steps: int) -> None:
        self.problem, self.steps, self.now = problem, steps, now
        size = 1.0 / (problem.frequency * steps)
        self.whole, self.small = _Step(problem, size), _Step(problem, size / PARTS)
        self.loads = self._loads_at(np.arange(1.0, steps + 1))
        self.weights = problem.interface.areas / problem.interface.areas.sum()

    def period(self) -> _Rows:
        """March a period."""
        boundary, work = self.problem.boundary, np.empty(self.steps)
        internal, (u, f) = np.empty((self.steps, boundary.size)), np.empty((2, self.steps, 3 * boundary.nodes))
        for j in range(self.steps):
            now = self._step(j)
            internal[j], u[j], f[j], work[j] = now.motion[0], now.contact.displacement, now.contact.force, now.work
            self.now = replace(now, work=0.0)
        return _Rows(internal, boundary.observe(internal, u, f, self.loads), u[:, 0::3] @ self.weights,
                     -f[:, 0::3].sum(axis=1), work)

    def _loads_at(self, step: Array) -> Array:
        """Return the loads (N, i) in N at so many (N,) steps from phase 0."""
        return self.problem.loads_at(2.0 * np.pi * step / self.steps)

    def _step(self, j: int) -> AtInstant:
        sliding = self.problem.boundary.sliding
        with suppress(NonConvergenceError):  # too far for one step
            after = self.whole.advance(self.now, self.loads[j])
            turns = (sliding @ self.now.motion[1]) * (sliding @ after.motion[1]) <= 0.0
            if not turns or np.all(self.now.contact.state == STICK):
                return after
        after = self.now
        for load in self._loads_at(j + np.arange(1.0, PARTS + 1) / PARTS):
            after = self.small.advance(after, load)
        return after


@dataclass(frozen=True)
class AtInstant:
    """The structure at an instant, and what friction has dissipated since the last instant kept, J.

    The rows of `motion` (4, d) are displacement, velocity, the scheme's acceleration and the true one.
    """

    motion: Array
    contact: SampleState
    work: float = 0.0


class _Step:
    """Steps of one size: the coordinates ``x1 = free + D T f``, and the contact with that flexibility in series."""

    def __init__(self, problem: PeriodicProblem, size: float) -> None:
        b, h = problem.boundary, size
        self.problem, self.size, self.mass, self.damping = problem, size, b.internal.mass, b.internal.damping
        # of motions: x1 - b h^2 a1, v1 - g h a1, what is kept of both accelerations, and x and v extrapolated
        self.predictor = np.array([[1.0, h, (0.5 - B) * h**2, 0.0], [0.0, 1.0, (1.0 - G) * h, 0.0],
                                   [0.0, 0.0, M / (1.0 - L), -L / (1.0 - L)],
                                   [1.0, h, 0.5 * h**2, 0.0], [0.0, 1.0, h, 0.0]])
        self.inertia = (1.0 - M) / (1.0 - L) / (B * h**2)  # d w1 / d x1
        dynamic = self.inertia * self.mass + G / (B * h) * self.damping + b.internal.stiffness
        self.flexibility = np.linalg.inv(dynamic)
        self.response = self.flexibility @ b.transfer
        plain = ContactSystem.of(problem)
        self.carried = b.coupling @ np.linalg.inv(dynamic + plain.felt_stiffness)  # R (D^-1 + T R)^-1
        stiffness = plain.stiffness - self.carried @ (b.transfer @ plain.stiffness)
        self.system = ContactSystem.of_parts(0.5 * (stiffness + stiffness.T), plain.coupling, plain.transfer, plain.gap,
                                             plain.law, plain.pull, plain.load)
        self.solver = SampleSolver(self.system)
        self.round_off = ROUND_OFF * float(self.system.stiffness.diagonal().max())
        self.before: SampleState | None = None

    def advance(self, now: AtInstant, driven: Array) -> AtInstant:
        """Return the structure one step later, under the loads `driven` (i,) then, N.

        Raises
        ------
        NonConvergenceError
            If the contact is not found.
        """
        h, b, factor = self.size, self.problem.boundary, 1.0
        ahead, drift, kept, x1, v1 = self.predictor @ now.motion
        load = (self.mass @ (self.inertia * ahead - kept) + self.damping @ (G / (B * h) * ahead - drift)
                + b.input_force @ driven)
        if b.forces:
            load = load + total_force(b.forces, x1[None], v1[None]).force[0]
        if self.problem.law.motion_factors:
            factor = float(self.problem.law.factor(x1[None] @ b.sliding, v1[None] @ b.sliding).factor[0])
        free = self.flexibility @ load
        held = now.motion[0] - self.response @ now.contact.force  # here the contact would stay as it is
        pulls = b.coupling @ np.column_stack([free, held]) + (b.input_pull @ driven)[:, None]
        if b.curvature is not None:
            pulls += b.curvature @ np.column_stack([x1, now.motion[0]])**2
        contact = self._press(free, pulls - self.carried @ (b.transfer @ pulls), now.contact, factor)
        x = free + self.response @ contact.force
        a = (x - ahead) / (B * h**2)
        slid = (contact.displacement - now.contact.displacement).reshape(-1, 3)[:, :2]
        return AtInstant(np.array([x, drift + G * h * a, a, (1.0 - M) / (1.0 - L) * a + kept]), contact,
                         now.work - float(np.sum(contact.force.reshape(-1, 3)[:, :2] * slid)))

    def _press(self, free: Array, pulls: Array, last: SampleState, factor: float) -> SampleState:
        """Return the contact when the coordinates would, without contact, go to `free` (d,), in m.

        The `pulls` (3 n, 2), N, are those then, and with which it would stay as it was `last`.
        """
        # a rigid contact knows its force no better than its stiffness times the round-off of displacements
        largest = max(float(np.abs(free).max(initial=0.0)), float(np.abs(last.displacement).max()))
        self.solver.tolerance = max(CONTACT_TOLERANCE * self.system.load / self.system.size,
                                    self.round_off * largest)
        guess = last
        if self.before is not None and np.array_equal(last.state, self.before.state):
            guess = SampleState(2.0 * last.displacement - self.before.displacement, last.force, last.state)
        self.before = last
        return self.solver.solve(pulls[:, 0], last.displacement, guess, pulls[:, 1], factor)


def _at_rest(problem: PeriodicProblem) -> AtInstant:
    return begin(problem, np.zeros((2, problem.boundary.size)), press(problem))


def at_phase_zero(problem: PeriodicProblem, start: PeriodicSolution) -> AtInstant:
    """Return the structure at phase 0 of a period."""
    contact = SampleState(start.displacement[0].ravel(), start.force[0].ravel(), start.state[0])
    velocity = time_derivative(start.internal, problem.omega)[0]
    return begin(problem, np.array([start.internal[0], velocity]), contact)


def begin(problem: PeriodicProblem, motion: Array, contact: SampleState) -> AtInstant:
    """Return the structure with displacements and velocities (2, d) and accelerations from the balance of forces."""
    (x, v), b = motion, problem.boundary
    load = b.input_force @ problem.loads_at(np.zeros(1))[0] + b.transfer @ contact.force
    load = load + total_force(b.forces, x[None], v[None]).force[0] - b.internal.damping @ v - b.internal.stiffness @ x
    acceleration = np.linalg.solve(b.internal.mass, load)
    return AtInstant(np.array([x, v, acceleration, acceleration]), contact)
