"""Time integration of the whole joint, free of Fourier series: the check of every periodic solver.

The two-mass rig is stepped by the generalised-alpha scheme in the form of Arnold and Bruels (Multibody System
Dynamics 18, 2007): second order, unconditionally stable, and what a rigid contact excites at infinite frequency
shrinks by RADIUS each step::

    x1 = x0 + h v0 + h^2 ((1/2 - b) a0 + b a1),   v1 = v0 + h ((1 - g) a0 + g a1)
    (1 - m) a1 + m a0 = (1 - l) w1 + l w0,        M w1 + C v1 + K x1 = F(t1) + e f_x

with b, g, m, l functions of RADIUS (Chung and Hulbert 1993). The contact is quasi-static at the end of each step.
There the rig gives the arm's position as ``q_x = alpha + beta f_x``, so that the contact sees one more spring in
series: with flexibility ``G + beta B_x B_x^T`` and the position alpha, a step is one sample of `contact_sample`.

A friction force that jumps within a step costs an order, so a step in which the arm turns is made in small parts.
Further forces on the rig, and a load or friction that follow the motion, are those of the motion that is extrapolated
from the step before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.sample import STICK, Array, ContactSystem, Instant, SampleSolver, SampleState
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint

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
    block: NDArray[np.float64] = quantity("m", "(M,)")
    arm: NDArray[np.float64] = quantity("m", "(M,), x")
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
        """Return how far each period's arm is from that of the one before, at most, over its peak-to-peak."""
        periods = self.arm.reshape(-1, self.steps_per_period)
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
    """March like `integrate` until the arm repeats itself.

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
    march = _March(problem, start, steps_per_period)
    marched: list[Array] = []
    while True:
        marched.append(march.period(len(marched)))
        history = _history(march.size, steps_per_period, np.hstack(marched))
        if len(marched) >= most or (len(marched) >= fewest and history.change[-1:].max(initial=0.0) <= drift):
            return history


def _history(size: float, steps: int, rows: Array) -> TimeHistory:
    return TimeHistory(
        steps_per_period=steps, time=size * np.arange(1.0, rows.shape[1] + 1), block=rows[0], arm=rows[1],
        relative_displacement=rows[2], friction_force=rows[3], friction_work=rows[4])


class _March:
    """The joint on its way, period after period."""

    def __init__(self, problem: PeriodicProblem, start: PeriodicSolution | None, steps: int) -> None:
        joint = problem.joint.quasi_static()
        self.steps = steps
        self.size = 1.0 / (problem.frequency * steps)
        self.whole, self.small = (_Step(problem, joint, h) for h in (self.size, self.size / PARTS))
        self.weights = problem.interface.areas / problem.interface.areas.sum()
        self.now = (_at_rest(problem, joint, self.whole.system) if start is None
                    else _at_phase_zero(problem, joint, start))

    def period(self, number: int) -> Array:
        """March a period; return block, arm, relative displacement, friction force and work, (5, steps)."""
        rows = np.empty((5, self.steps))
        nodes = len(self.weights)
        for j in range(self.steps):
            now = self._step(self.size * (number * self.steps + j))
            rows[:, j] = (*now.rig.x, now.contact.displacement[:nodes] @ self.weights, -now.friction, now.work)
            self.now = replace(now, work=0.0)
        return rows

    def _step(self, time: float) -> _Joint:
        after = self.whole.advance(self.now, time)
        turns = self.now.rig.v[1] * after.rig.v[1] <= 0.0
        if not turns or np.all(self.now.contact.state == STICK):
            return after
        after = self.now
        for part in range(PARTS):
            after = self.small.advance(after, time + part * self.small.size)
        return after


@dataclass(frozen=True)
class _Rig:
    """The rig at an instant: displacement, velocity, the scheme's acceleration and the true one, each (2,)."""

    x: Array
    v: Array
    a: Array
    w: Array


@dataclass(frozen=True)
class _Joint:
    """The joint at an instant, and what friction has dissipated since the last instant kept, J."""

    rig: _Rig
    contact: SampleState
    work: float = 0.0

    @property
    def friction(self) -> float:
        """Return the x force on the arm, N."""
        return float(self.contact.force[:len(self.contact.state)].sum())


class _Step:
    """Steps of one size: the rig with ``x1 = free + response f_x``, and the contact on its compliance beta."""

    def __init__(self, problem: PeriodicProblem, joint: QuasiStaticJoint, size: float) -> None:
        rig, h = joint.rig, size
        self.size, self.mass, self.damping = size, rig.mass, rig.damping
        self.omega, self.drive = problem.omega, ((1, complex(problem.excitation)), *problem.overtones)
        self.forces = problem.rig_forces
        self.load, self.load_slope, self.factors = problem.normal_load, problem.load_slope, problem.motion_factors
        self.inertia = (1.0 - M) / (1.0 - L) / (B * h**2)  # d w1 / d x1
        self.flexibility = np.linalg.inv(self.inertia * rig.mass + G / (B * h) * rig.damping + rig.stiffness)
        self.response = self.flexibility[:, 1]
        sliding = joint.motion[:, 0]
        series = joint.flexibility + self.response[1] * np.outer(sliding, sliding)
        stiffness = cho_solve(cho_factor(series, lower=True), np.eye(len(series)))
        self.system = ContactSystem.of(problem, 0.5 * (stiffness + stiffness.T))
        self.solver = SampleSolver(self.system)
        self.round_off = ROUND_OFF * float(self.system.stiffness.diagonal().max())
        self.before: SampleState | None = None

    def advance(self, now: _Joint, time: float) -> _Joint:
        """Return the joint one step after `time`.

        Raises
        ------
        NonConvergenceError
            If the contact is not found.
        """
        rig, h = now.rig, self.size
        ahead = rig.x + h * rig.v + (0.5 - B) * h**2 * rig.a  # x1 - b h^2 a1
        drift = rig.v + (1.0 - G) * h * rig.a  # v1 - g h a1
        kept = (M * rig.a - L * rig.w) / (1.0 - L)
        load = self.mass @ (self.inertia * ahead - kept) + self.damping @ (G / (B * h) * ahead - drift)
        load[0] += sum((force * np.exp(1j * order * self.omega * (time + h))).real for order, force in self.drive)
        x1, v1 = (rig.x + h * rig.v + 0.5 * h**2 * rig.a)[None], (rig.v + h * rig.a)[None]
        for force in self.forces:
            load += force(x1, v1).force[0]
        free = self.flexibility @ load
        contact = self._press(float(free[1]), float(rig.x[1]), now, self._instant(x1[:, 1], v1[:, 1]))
        n = len(contact.state)
        x = free + self.response * contact.force[:n].sum()
        a = (x - ahead) / (B * h**2)
        slid = (contact.displacement - now.contact.displacement)[:2 * n]
        return _Joint(_Rig(x, drift + G * h * a, a, (1.0 - M) / (1.0 - L) * a + kept), contact,
                      now.work - float(contact.force[:2 * n] @ slid))

    def _instant(self, position: Array, velocity: Array) -> Instant:
        """Return load and friction factor at a position and velocity (1,) of the arm."""
        grip = float(np.prod([factor(position, velocity).factor[0] for factor in self.factors]))
        return Instant(self.load + self.load_slope * float(position[0]), grip)

    def _press(self, free: float, arm: float, now: _Joint, instant: Instant) -> SampleState:
        """Return the contact when the arm would, without friction, go from `arm` to `free`, in m."""
        last = now.contact
        # a rigid contact knows its force no better than its stiffness times the round-off of displacements
        largest = max(abs(free), float(np.abs(last.displacement).max()))
        self.solver.tolerance = max(CONTACT_TOLERANCE * self.system.load / self.system.size,
                                    self.round_off * largest)
        guess = last
        if self.before is not None and np.array_equal(last.state, self.before.state):
            guess = _carried_on(last, self.before)
        self.before = last
        held = arm - self.response[1] * now.friction  # here the contact would stay as it is
        return self.solver.solve(free, last.displacement, guess, held, instant)


def _carried_on(now: SampleState, earlier: SampleState) -> SampleState:
    """Guess the next sample by repeating the last step."""
    return SampleState(2.0 * now.displacement - earlier.displacement, now.force,
                       2.0 * now.approach - earlier.approach, now.state)


def _at_rest(problem: PeriodicProblem, joint: QuasiStaticJoint, system: ContactSystem) -> _Joint:
    pressed = ContactMarch(system, joint.flexibility).preloaded(problem.frictional_preload)
    return _begin(problem, joint, np.zeros((2, 2)), pressed)


def _at_phase_zero(problem: PeriodicProblem, joint: QuasiStaticJoint, start: PeriodicSolution) -> _Joint:
    samples = len(start.state)
    amplitudes = np.fft.rfft(start.rig_displacement, axis=0)
    turning: NDArray[Any] = 1j * problem.omega * np.arange(len(amplitudes))
    if samples % 2 == 0:
        turning[-1] = 0.0  # the last one has no phase
    velocity = np.fft.irfft(turning[:, None] * amplitudes, samples, axis=0)[0]
    u, f = (np.ascontiguousarray(array[0].T).ravel() for array in (start.displacement, start.force))
    elastic = joint.flexibility @ start.force[0].ravel()
    approach = float(np.mean(start.displacement[0, :, 2] - elastic[2::3]))
    contact = SampleState(u, f, approach, start.state[0])
    return _begin(problem, joint, np.array([start.rig_displacement[0], velocity]), contact)


def _begin(problem: PeriodicProblem, joint: QuasiStaticJoint, motion: Array, contact: SampleState) -> _Joint:
    """Return the joint with the rig's displacement and velocity (2, 2) and accelerations from the balance of forces."""
    (x, v), rig = motion, joint.rig
    drive = problem.excitation + sum(force.real for _, force in problem.overtones)
    load = np.array([drive, contact.force[:len(contact.state)].sum()])
    for force in problem.rig_forces:
        load += force(x[None], v[None]).force[0]
    acceleration = (load - rig.damping @ v - rig.stiffness @ x) / rig.mass.diagonal()
    return _Joint(_Rig(x, v, acceleration, acceleration), contact)
