"""The edges of the scar: a force with a potential, at the place where the stroke has dug.

What carries the weight: the force takes no energy out of any motion that returns, alone and in a solved period; its
peak and the place of the ends are the closed forms; and over a marched test the ends of the loops harden.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.effects.cycle import PeriodicCycle, respond, true_signals
from fretflow.effects.scar_edge import HALF_STROKE, EdgeForce, ScarEdge
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.time_integration import integrate
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.history import WearSettings
from fretflow.wear.implicit import Implicit
from fretflow.wear.scheme import WearingJoint
from fretflow.wear.slow import SlowState

COARSE, FINE = (QuasiStaticSolver(Solver(harmonics=h, samples=n, estimate_error=False)) for h, n in ((5, 32), (7, 64)))
EFFECT = ScarEdge().changed(peak_force=15.0, width=0.4, depth_scale=5e-7)
SHARE = np.full(9, 1.0 / 9.0)


def scar(depth, end):
    memory = EFFECT.initial_memory(SimpleFace()) | {HALF_STROKE: np.asarray(end)}
    return replace(SlowState.worn_by(np.full(9, depth)), memory=memory)


class SimpleFace:
    areas = SHARE


def at(force, place):
    """Return the force on the arm and its slope at `place` (N,), m."""
    still = np.zeros((len(place), 2))
    response = force(np.stack([0.3 * place, place], axis=1), still)
    assert not response.force[:, 0].any()
    assert not response.by_velocity.any()
    return response.force[:, 1], response.by_displacement[:, 1, 1]


def test_the_force_is_that_of_a_potential():
    force = EdgeForce(peak=12.0, half_stroke=6e-6, width=2e-6, power=2.0, end=6e-6)
    place = np.linspace(-8e-6, 8e-6, 4001)
    value, slope = at(force, place)
    into = np.clip(np.abs(place) - 4e-6, 0.0, 2e-6)
    potential = 12.0 * (into**3 / (3.0 * 2e-6**2) + np.maximum(np.abs(place) - 6e-6, 0.0))
    np.testing.assert_allclose(value[1:-1], -(potential[2:] - potential[:-2]) / (place[2] - place[0]), atol=0.02)
    smooth = np.abs(np.abs(place[1:-1]) - 6e-6) > 5e-9  # all but the kink at the end
    rise = (value[2:] - value[:-2]) / (place[2] - place[0])
    np.testing.assert_allclose(slope[1:-1][smooth], rise[smooth], atol=1e4)
    ends, _ = at(force, np.array([-6e-6, 6e-6, 3e-6, 5e-6, 7e-6]))
    np.testing.assert_allclose(ends, [12.0, -12.0, 0.0, -3.0, -12.0], rtol=1e-12)


@pytest.mark.parametrize("power", [1.0, 3.0])
def test_other_floors_have_potentials_too_that_go_on_beyond_the_stroke(power):
    """A bowl, parabolic or quartic, over the whole stroke and half of it again; beyond, the flank is straight."""
    force = EdgeForce(peak=12.0, half_stroke=4e-6, width=4e-6, power=power, end=6e-6)
    place = np.linspace(-8e-6, 8e-6, 4001)
    value, slope = at(force, place)
    within = np.minimum(np.abs(place), 6e-6)
    potential = 12.0 * (within**(power + 1.0) / ((power + 1.0) * 4e-6**power)
                        + (1.5**power) * (np.abs(place) - within))
    np.testing.assert_allclose(value[1:-1], -(potential[2:] - potential[:-2]) / (place[2] - place[0]), atol=0.05)
    smooth = np.abs(np.abs(place[1:-1]) - 6e-6) > 5e-9
    rise = (value[2:] - value[:-2]) / (place[2] - place[0])
    np.testing.assert_allclose(slope[1:-1][smooth], rise[smooth], rtol=1e-4, atol=10.0)
    ends, _ = at(force, np.array([-4e-6, 2e-6, 7e-6]))
    np.testing.assert_allclose(ends, [12.0, -12.0 * 0.5**power, -12.0 * 1.5**power], rtol=1e-12)


def test_beyond_a_fold_the_period_is_the_one_on_which_the_motion_settles(winkler):
    """A rig driven above its resonance jumps where the scar's spring has raised that to the drive."""
    base = winkler(foundation=5e13, excitation=75.0)

    def hardened(peak):
        force = EdgeForce(peak, half_stroke=2e-5, width=2e-5, power=3.0, end=1e-3)
        return replace(base, structure=change_rig(base.structure, forces=(force,)))

    before = FINE.solve(hardened(15.0))
    small = np.ptp(before.rig_displacement[:, 1])
    beyond = FINE.solve(hardened(20.0), before)
    assert np.ptp(beyond.rig_displacement[:, 1]) > 1.8 * small
    marched = integrate(hardened(20.0), before, 200, 512)
    assert marched.change[-1] < 1e-4
    settled = marched.of_period(marched.internal[:, 1])
    assert np.ptp(beyond.rig_displacement[:, 1]) == pytest.approx(np.ptp(settled), rel=5e-3)


def test_the_peak_grows_with_the_depth(winkler):
    problem = winkler()
    for depth in (1e-7, 5e-7, 2e-6):
        force = EFFECT.period(problem, scar(depth, 6e-6)).boundary.forces[-1]
        assert at(force, np.array([-6e-6]))[0][0] == pytest.approx(15.0 * (1.0 - np.exp(-depth / 5e-7)), rel=1e-12)
        assert at(force, np.array([3.59e-6]))[0][0] == 0.0  # a width of 0.4 before the end
    assert EFFECT.period(problem, scar(0.0, 6e-6)) is problem


def test_the_shape_of_the_rise_is_that_of_the_parameters(winkler):
    """At the end of the stroke the peak, half way to it by the power, and beyond until the rise ends."""
    bowl = EFFECT.changed(width=1.0, power=3.0, reach=1.5)
    force = bowl.period(winkler(), scar(5e-7, 6e-6)).boundary.forces[-1]
    ends, _ = at(force, np.array([-6e-6, -3e-6, -9e-6, -12e-6]))
    np.testing.assert_allclose(ends, bowl.peak(5e-7) * np.array([1.0, 0.5**3, 1.5**3, 1.5**3]), rtol=1e-12)


def test_the_ends_move_out_as_wear_digs_there_and_never_in(winkler):
    response = respond_once(winkler())
    state = scar(0.0, 0.0)
    for arm_range, worn in ((8e-6, 1e-8), (12e-6, 2e-7), (12e-6, 3e-7), (4e-6, 1e-6)):
        memory = EFFECT.evolve(state, 100.0, np.full(9, worn), 0.1, replace(response, arm_range=arm_range))
        state = state.after(100.0, np.full(9, worn), 0.1, {**state.memory, **memory})
    # first 4 um; then towards 6 um over a depth of 0.5 um; then a smaller stroke leaves them
    assert float(state.memory[HALF_STROKE]) == pytest.approx(6e-6 - 2e-6 * np.exp(-1.0), rel=1e-12, abs=0.0)


def respond_once(problem):
    return respond(FINE.solve(problem), problem.interface)


@pytest.mark.parametrize("depth", [0.0, 2e-6])
def test_a_solved_period_loses_no_energy_to_it(winkler, depth):
    """Work of the drive, of the rig's damping and of friction at the arm balance; the edges' share would be seen."""
    problem = EFFECT.period(winkler(foundation=5e13, excitation=75.0), scar(depth, 1.9e-5))
    period = FINE.solve(problem)
    velocity = time_derivative(period.rig_displacement, problem.omega)
    step = 1.0 / (100.0 * len(velocity))
    drive = 75.0 * np.cos(2.0 * np.pi * np.arange(len(velocity)) / len(velocity)) @ velocity[:, 0] * step
    damping = np.einsum("ji,ik,jk->", velocity, problem.structure.rig.damping, velocity) * step
    friction = period.friction_force @ velocity[:, 1] * step
    assert abs(drive - damping - friction) < 1e-4 * drive
    assert friction == pytest.approx(respond(period, problem.interface).dissipated_energy, rel=1e-2)
    if depth:
        force, _ = at(problem.boundary.forces[-1], period.rig_displacement[:, 1])
        assert np.abs(force).max() > 5.0
        assert np.abs(force * velocity[:, 1]).sum() * step > 0.05 * drive  # what a one-way force would have taken


def test_over_a_test_the_measured_ends_of_the_loops_harden(winkler):
    problem = winkler(foundation=5e13, excitation=75.0)
    effect = EFFECT.changed(peak_force=8.0)
    model = PeriodicCycle(COARSE, problem, [effect])
    joint = WearingJoint(model, WearSettings(coefficient=1e-14, cycles=60_000, tolerance=0.2))
    step, state = joint.unworn()
    reached, added = [], []
    while step.cycles < 60_000:
        step, state = Implicit(joint).advance(step, state)
        loaded = model.model.problem(step.slow)
        measured = true_signals(loaded, state, state.displacement[:, :, 0].mean(axis=1))
        beside = measured.friction_force - state.friction_force
        added.append(beside[np.argmax(measured.arm)])
        reached.append(float(step.slow.memory[HALF_STROKE]))
        into = min(1.0, (measured.arm.max() / reached[-1] - 0.6) / 0.4)
        assert added[-1] == pytest.approx(effect.peak(float(step.depth.mean())) * into**2, rel=1e-9)
        assert abs(beside[np.argmin(np.abs(measured.arm))]) == 0.0  # nothing in the middle
    assert np.all(np.diff(reached) >= 0.0)
    assert np.all(np.diff(added) > 0.0)
    assert added[-1] > 5.0
