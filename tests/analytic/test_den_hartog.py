"""One node on the rig: forced motion with dry friction, with and without stops, to 0.5 % in amplitude.

What carries the weight: without stops Den Hartog's closed form is exact (Trans. ASME 53 (1931), APM-53-9)::

    x0 = F / k sqrt(V^2 - (R / F)^2 U^2),  V = 1 / (1 - b^2),  U = sin(pi / b) / (b (1 + cos(pi / b)))

with R the friction force and b the frequency over the natural one. With stops, and for a friction element of finite
stiffness (Jenkins), `DryOscillator` below is exact: it joins closed-form pieces of motion at events found as roots.
It shares nothing with the solvers, and is itself held against the closed form.
"""

from dataclasses import dataclass
from functools import cache
from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.time_integration import integrate
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.optimize import brentq

NATURAL, FORCE, LOAD = 40.0, 100.0, 60.0
MASS = 10.5
STIFFNESS = MASS * (2.0 * pi * NATURAL)**2
LOOKS = 400  # instants a period at which an event is looked for
STUCK = 0


@dataclass(frozen=True)
class DryOscillator:
    """``m x'' + c x' + k x + r = F cos(w t)``, r dry friction of limit R behind a spring (inf: rigid)."""

    ratio: float  # of frequencies, b
    limit: float  # R in N
    spring: float = np.inf  # N/m
    damping: float = 0.0  # ratio

    @property
    def omega(self):
        return self.ratio * 2.0 * pi * NATURAL

    def linear(self, spring, load, start, x, v):
        """Return the motion from (x, v) at `start` with a spring and a constant load more, and its velocity."""
        k, c, w = STIFFNESS + spring, 2.0 * self.damping * sqrt(STIFFNESS * MASS), self.omega
        own = sqrt(k / MASS - (c / (2.0 * MASS))**2)
        fade = c / (2.0 * MASS)
        forced = FORCE / complex(k - w**2 * MASS, w * c)

        def driven(t):
            turn = forced * np.exp(1j * w * t)
            return turn.real + load / k, (1j * w * turn).real

        d, dv = driven(start)
        a = x - d
        b = (v - dv + fade * a) / own

        def motion(t):
            d, dv = driven(t)
            s = t - start
            e, cs, sn = np.exp(-fade * s), np.cos(own * s), np.sin(own * s)
            return (d + e * (a * cs + b * sn), dv + e * ((own * b - fade * a) * cs - (own * a + fade * b) * sn))

        return motion

    def piece(self, state, t, x, v, anchor):
        """Return the motion that begins at t, and a function of time whose positive sign ends it."""
        if state != STUCK:
            motion = self.linear(0.0, -state * self.limit, t, x, v)
            return motion, lambda s: -state * motion(s)[1]
        if self.spring == np.inf:
            return (lambda s: (x + 0.0 * s, 0.0 * s)), lambda s: abs(self.pull(s, x)) - self.limit
        motion = self.linear(self.spring, self.spring * anchor, t, x, v)
        return motion, lambda s: self.spring * abs(motion(s)[0] - anchor) - self.limit

    def pull(self, t, x):
        """Return what a mass at rest at x leaves to friction, N."""
        return FORCE * np.cos(self.omega * t) - STIFFNESS * x

    def after(self, state, t, x, anchor):
        """Return the next state and the unloaded position of the friction spring."""
        if self.spring < np.inf and state == STUCK:
            return int(np.sign(x - anchor)), anchor
        if self.spring < np.inf:
            return STUCK, x - state * self.limit / self.spring
        pull = float(self.pull(t, x))
        stays = state != STUCK and abs(pull) <= self.limit
        return (STUCK if stays else int(np.sign(pull))), anchor

    def pieces(self, periods):
        """Return the pieces (from, to, motion, state) of the motion from rest; state is 0 or the sense of slip."""
        step = 2.0 * pi / self.omega / LOOKS
        end, t, x, v, state, anchor, pieces = periods * LOOKS * step, 0.0, 0.0, 0.0, STUCK, 0.0, []
        while t < end:
            motion, excess = self.piece(state, t, x, v, anchor)
            until = self._first_root(excess, t, step, end)
            pieces.append((t, until, motion, state))
            t, (x, v) = until, (float(value) for value in motion(until))
            state, anchor = self.after(state, t, x, anchor)
            v = 0.0 if self.spring == np.inf else v
        return pieces

    @staticmethod
    def _first_root(excess, t, step, end):
        early = t + 1e-6 * step  # behind the event that began the piece
        while early < end:
            instants = early + step * np.arange(LOOKS + 1)
            above = np.flatnonzero(excess(instants) > 0.0)
            if len(above) and above[0] == 0:
                return early
            if len(above):
                return brentq(excess, instants[above[0] - 1], instants[above[0]], xtol=1e-15 * end, rtol=1e-14)
            early = instants[-1]
        return end


@cache
def exact(ratio, limit, spring=np.inf, damping=0.0, periods=150, instants=2000):
    """Return the last period (instants,) from rest and the stops in it."""
    oscillator = DryOscillator(ratio, limit, spring, damping)
    pieces = oscillator.pieces(periods)
    period = 2.0 * pi / oscillator.omega
    first = (periods - 1) * period
    times = first + period * np.arange(instants) / instants
    motion, stuck = np.empty(instants), np.zeros(instants, dtype=bool)
    for start, until, piece, state in pieces:
        inside = (times >= start) & (times < until)
        motion[inside], stuck[inside] = piece(times[inside])[0], state == STUCK
    stops = int(np.sum(stuck & ~np.roll(stuck, 1)))
    return motion, stops


def closed_form(ratio, limit):
    v, u = 1 / (1 - ratio**2), sin(pi / ratio) / (ratio * (1 + cos(pi / ratio)))
    return FORCE / STIFFNESS * sqrt(v**2 - (limit / FORCE)**2 * u**2)


def problem(ratio, limit, spring=None, damping=0.0):
    """One node on the rig, its hinge out of the way; a rigid contact is a million times stiffer than the rig."""
    rig = LumpedRig.from_modes(10.0, 0.5, NATURAL, 2e5, damping)
    spring = 1e6 * STIFFNESS if spring is None else spring
    return rig_problem(
        joint=QuasiStaticJoint.from_stiffness(spring * np.eye(3), rig), frequency=ratio * NATURAL,
        interface=Interface(nodes=np.zeros((1, 2)), areas=np.array([1e-6]), gap=np.zeros(1)),
        excitation=FORCE, friction_coefficient=limit / LOAD, normal_load=LOAD)


def error(motion, expected):
    """Return the error of the amplitude, and the rms distance over the range."""
    same = np.interp(np.arange(len(motion)) / len(motion), np.arange(len(expected) + 1) / len(expected),
                     np.append(expected, expected[0]))
    return abs(np.ptp(motion) / np.ptp(expected) - 1.0), np.sqrt(np.mean((motion - same)**2)) / np.ptp(expected)


WITHOUT_STOPS = [(0.4, 10.0), (0.8, 60.0), (1.2, 60.0), (1.5, 40.0), (2.5, 40.0)]


@pytest.mark.parametrize(("ratio", "limit"), WITHOUT_STOPS)
def test_the_exact_motion_without_stops_is_the_closed_form(ratio, limit):
    motion, stops = exact(ratio, limit)
    assert stops == 0
    assert np.ptp(motion) / 2 == pytest.approx(closed_form(ratio, limit), rel=1e-5)


@pytest.mark.parametrize(("ratio", "limit"), WITHOUT_STOPS)
def test_time_integration_without_stops(ratio, limit):
    history = integrate(problem(ratio, limit), None, 40, 200)
    assert history.sliding_distance[-1] / 2 == pytest.approx(closed_form(ratio, limit), rel=5e-3)
    assert error(history.of_period(history.outputs["arm"]), exact(ratio, limit)[0])[1] < 2e-3


@pytest.mark.parametrize(("ratio", "limit", "stops"), [
    (0.2, 20.0, 2), (0.2, 40.0, 4), (0.3, 10.0, 4), (0.4, 40.0, 2), (0.6, 80.0, 2), (1.2, 80.0, 2)])
def test_time_integration_with_stops(ratio, limit, stops):
    """The contact is a million times stiffer than the rig: it sticks, and lets go, without chatter."""
    expected, found_stops = exact(ratio, limit)
    assert found_stops == stops
    history = integrate(problem(ratio, limit), None, 12, 400)
    amplitude, distance = error(history.of_period(history.outputs["arm"]), expected)
    assert amplitude < 5e-3
    assert distance < 5e-3
    slid = history.of_period(history.relative_displacement)
    still = np.abs(slid - np.roll(slid, 1)) < 1e-5 * np.ptp(slid)
    assert int(np.sum(still & ~np.roll(still, 1))) == stops


@pytest.mark.parametrize(("ratio", "limit"), [(0.2, 40.0), (1.2, 80.0)])
def test_time_integration_gains_two_orders_a_halving_also_with_stops(ratio, limit):
    errors = []
    for steps in (50, 100, 200):
        history = integrate(problem(ratio, limit), None, 12, steps)
        errors.append(error(history.of_period(history.outputs["arm"]), exact(ratio, limit)[0])[1])
    assert errors[2] < 0.15 * errors[0]


JENKINS = [  # ratio, limit in N, spring over the rig's, damping ratio
    (0.2, 40.0, 10.0, 0.02), (0.3, 10.0, 30.0, 0.02), (0.3, 60.0, 30.0, 0.02), (0.3, 30.0, 30.0, 0.0),
    (0.4, 40.0, 30.0, 0.02), (0.6, 80.0, 30.0, 0.02), (0.8, 60.0, 30.0, 0.02), (1.2, 80.0, 100.0, 0.02),
    (1.5, 40.0, 100.0, 0.02)]


@pytest.mark.parametrize("case", JENKINS)
def test_periodic_solver_with_and_without_stops(case):
    """A friction element of finite stiffness, the same in both; sticking in up to half of the period."""
    ratio, limit, spring, damping = case
    expected, stops = exact(ratio, limit, spring * STIFFNESS, damping)
    assert stops >= 2
    given = problem(ratio, limit, spring * STIFFNESS, damping)
    errors = []
    for harmonics, samples in ((12, 128), (25, 256), (50, 512)):
        period = QuasiStaticSolver(Solver(harmonics=harmonics, samples=samples, estimate_error=False)).solve(given)
        errors.append(error(period.rig_displacement[:, 1], expected))
    assert max(errors[-2]) < 5e-3
    assert max(errors[-1]) < 1e-3
    assert errors[-1][1] < 0.5 * errors[0][1]


def test_periodic_solver_without_stops_nears_the_closed_form_as_the_contact_stiffens():
    """A spring shifts the amplitude by the root of its give over the amplitude."""
    shifts = []
    for spring in (1e2, 1e4):
        settings = Solver(harmonics=50, samples=512, estimate_error=False)
        period = QuasiStaticSolver(settings).solve(problem(1.5, 40.0, spring * STIFFNESS, 0.0))
        shifts.append(np.ptp(period.rig_displacement[:, 1]) / 2 / closed_form(1.5, 40.0) - 1.0)
    assert 0.0 < shifts[1] < 0.2 * shifts[0]
    assert shifts[1] < 0.015
