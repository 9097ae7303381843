"""Frequency stepping and loop readings around solvers whose answer is known.

What carries the weight: the resonance found is that of the oscillator put in, each solution starts from its
nearest neighbour, and a failing neighbour is replaced by a start from zero before anything is given up.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.case.config import Solver, validate_case
from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.pipeline import response, response_curves
from fretflow.pipeline.problem import rig_problem
from fretflow.pipeline.response import check_response, first_harmonic, forced_response, read_loops
from fretflow.pipeline.run_records import stated_error
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.solvers.quasi_static.backbone import BackboneSolver
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint, change_rig
from fretflow.structure.two_mass_rig.lumped import LumpedRig

RESONANCE, DAMPING, STATIC = 137.0, 0.02, 1e-6
TAU = 2.0 * np.pi * np.arange(64) / 64
PROBLEM = rig_problem(
    joint=QuasiStaticJoint.from_stiffness(
        np.eye(3) * 1e7, LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    ),
    interface=Interface(nodes=np.zeros((1, 2)), areas=np.ones(1), gap=np.zeros(1)),
    friction_coefficient=0.5,
    frequency=100.0,
    excitation=53.0,
    normal_load=60.0,
)
CASE = validate_case({
    "format": "fretflow-case/1", "name": "x", "test": {"excitation_amplitude": "53 N", "cycles": 1},
    "output": {"frequency_response": {"start": "50 Hz", "stop": "400 Hz", "points": 15}}})


def amplitude(frequency):
    ratio = frequency / RESONANCE
    return STATIC / (1.0 - ratio**2 + 2j * DAMPING * ratio)


class Oscillator:
    """A periodic solver of one linear oscillator."""

    def __init__(self, fails=lambda frequency, start: False):
        self.fails = fails
        self.starts = {}

    def solve(self, problem, start=None):
        frequency = problem.frequency
        if self.fails(frequency, start):
            raise NonConvergenceError("no", history=[1.0])
        self.starts[frequency] = start
        motion = (amplitude(frequency) * np.exp(1j * TAU)).real
        return PeriodicSolution(
            method="oscillator",
            frequency=frequency,
            displacement=np.zeros((64, 1, 3)),
            force=np.zeros((64, 1, 3)),
            state=np.zeros((64, 1), dtype=np.int8),
            internal=np.column_stack([motion, motion]),
            outputs={"block": motion, "arm": motion},
            friction_force=np.zeros(64),
            residual_history=(0.0,),
            error_estimate=0.0,
        )


def respond(solver):
    return forced_response(CASE, solver, PROBLEM, 7, lambda share: None)


def test_the_response_is_that_of_the_oscillator():
    solver = Oscillator()
    curve = respond(solver)
    assert np.all(np.diff(curve.frequency) > 0)
    assert (curve.frequency[0], curve.frequency[-1]) == pytest.approx((50.0, 400.0))
    exact = amplitude(curve.frequency)
    np.testing.assert_allclose(curve.amplitude, np.abs(exact), rtol=1e-12)
    np.testing.assert_allclose(curve.phase, -np.angle(exact), rtol=1e-9)  # behind the force, 0 to pi
    assert curve.cycles == 7
    assert curve.excitation == 53.0


def test_points_gather_at_the_peak_so_that_the_resonance_is_found_between_the_asked_ones():
    curve = respond(Oscillator())
    true_peak = RESONANCE * np.sqrt(1.0 - 2.0 * DAMPING**2)
    assert curve.resonance == pytest.approx(true_peak, rel=2e-3)
    asked = np.geomspace(50.0, 400.0, 15)
    assert (
        np.abs(asked - true_peak).min() / true_peak > 0.02
    )  # the asked points alone miss it by ten times that


def test_a_response_is_checked_over_its_range_and_the_worst_is_stated():
    curve = respond(Oscillator())
    true = check_response(Oscillator(), PROBLEM, curve)
    assert true.error == pytest.approx(np.zeros(5), abs=1e-12)
    assert true.checked[[0, -1]] == pytest.approx([50.0, 400.0])
    assert curve.frequency[np.argmax(curve.amplitude)] in true.checked
    apart = np.diff(np.log(true.checked))  # midway in octaves, as far as the asked points allow
    assert apart[0] == pytest.approx(apart[1], abs=2 * np.log(8.0) / 14)
    off = replace(curve, amplitude=curve.amplitude * np.where(curve.frequency < 60.0, 1.11, 1.0))
    checked = check_response(Oscillator(), PROBLEM, off)
    assert checked.worst == (pytest.approx(0.11, rel=1e-9), pytest.approx(50.0))
    assert stated_error([true, checked]) == (
        "of 5 amplitudes of each curve the worst is 11.0 % off the full solution, at 50 Hz")
    unfinished = check_response(Oscillator(fails=lambda frequency, start: frequency > 100.0), PROBLEM, off)
    assert unfinished.checked.tolist() == [f for f in checked.checked if f <= 100.0]


def test_each_solution_starts_from_its_nearest_neighbour():
    solver = Oscillator()
    respond(solver)
    order = list(solver.starts)
    assert solver.starts[order[0]] is None
    for k, frequency in enumerate(order[1:], start=1):
        nearest = min(order[:k], key=lambda known: abs(known - frequency))
        assert solver.starts[frequency].frequency == nearest


def test_a_failing_neighbour_is_replaced_by_a_start_from_zero():
    solver = Oscillator(fails=lambda frequency, start: frequency > 200.0 and start is not None)
    respond(solver)
    assert all(start is None for frequency, start in solver.starts.items() if frequency > 200.0)


def test_a_frequency_that_cannot_be_solved_is_named():
    with pytest.raises(NonConvergenceError, match=r"forced response at 400 Hz") as caught:
        respond(Oscillator(fails=lambda frequency, start: frequency > 390.0))
    assert caught.value.history == (1.0,)


def test_a_peak_at_the_end_of_the_range_is_given_as_it_is():
    case = replace_range(start="200 Hz", stop="400 Hz")
    curve = forced_response(case, Oscillator(), PROBLEM, 0, lambda share: None)
    assert curve.resonance == pytest.approx(200.0)


def replace_range(**values):
    response = CASE.output.frequency_response.model_dump()
    raw = {key: f"{value} Hz" for key, value in response.items() if key != "points"} | {"points": 15} | values
    return validate_case({
        "format": "fretflow-case/1", "name": "x", "test": {"excitation_amplitude": "53 N", "cycles": 1},
        "output": {"frequency_response": raw}})


def test_what_a_backbone_does_not_know_is_followed_by_continuation(monkeypatch):
    """A normal load that follows the motion; a point is the period of the full solver."""
    monkeypatch.setattr(response_curves, "HARMONICS", 7)
    monkeypatch.setattr(response_curves, "SAMPLES", 64)
    solver = Solver(harmonics=7, samples=64)
    case = replace_range(start="95 Hz", stop="115 Hz").model_copy(update={"solver": solver})
    problem = replace(PROBLEM, structure=change_rig(PROBLEM.structure, load_slope=5e4))
    curved = replace(PROBLEM, structure=change_rig(PROBLEM.structure, load_curvature=5e9))
    for other in (problem, curved):
        with pytest.raises(InputError, match="backbone does not know a normal load that depends on the motion"):
            BackboneSolver.of(other, 7, 64).solve(other)
    shares = []
    curve = response._respond(case, problem, 3, shares.append)
    assert not len(curve.checked)  # it is the full solution itself
    assert curve.cycles == 3
    assert np.all(np.diff(curve.frequency) > 0.0)
    assert curve.frequency[[0, -1]] == pytest.approx([95.0, 115.0])
    assert max(shares) == pytest.approx(1.0)
    settings = Solver(harmonics=7, samples=32, estimate_error=False)
    full = QuasiStaticSolver(settings).solve(problem.vary(frequency=95.0))
    assert curve.amplitude[0] == pytest.approx(abs(first_harmonic(full)), rel=1e-3, abs=0.0)
    assert curve.phase[0] == pytest.approx(-np.angle(first_harmonic(full)) % (2 * np.pi), rel=1e-3)


def test_the_first_harmonic_is_that_of_the_moving_mass():
    period = Oscillator().solve(PROBLEM)
    motion = 1.0 + 3.0 * np.cos(TAU - 0.4) + np.cos(2 * TAU)
    moved = replace(period, outputs={"block": motion, "arm": np.zeros(64)})
    assert first_harmonic(moved) == pytest.approx(3.0 * np.exp(-0.4j))


def parallelogram(limit, stiffness, slide, samples=400):
    """Return displacement and force of a loop: stick slope `stiffness`, sliding by `slide` at `limit`."""
    elastic = 2.0 * limit / stiffness
    corners_x = np.array([0.0, elastic, elastic + slide, slide, 0.0])
    corners_f = np.array([-limit, limit, limit, -limit, -limit])
    path = np.concatenate(
        [[0.0], np.cumsum(np.hypot(np.diff(corners_x) / slide, np.diff(corners_f) / limit))]
    )
    along = np.linspace(0.0, path[-1], samples, endpoint=False)
    return np.interp(along, path, corners_x), np.interp(along, path, corners_f)


def test_loops_are_read_at_every_kept_cycle_count():
    limits = {0: 20.0, 1000: 30.0}
    periods = {}
    for cycles, limit in limits.items():
        x, force = parallelogram(limit, 20e6, 10e-6)
        periods[cycles] = replace(Oscillator().solve(PROBLEM), friction_force=force,
                                  outputs={"block": x, "arm": x})
    series = read_loops(periods, 60.0, lambda period: period.rig_displacement[:, 0])
    assert series.cycles.tolist() == [0, 1000]
    np.testing.assert_allclose(series.friction_coefficient, [20 / 60, 30 / 60], rtol=0.01)
    np.testing.assert_allclose(series.tangential_stiffness, 20e6, rtol=0.01)
    np.testing.assert_allclose(series.dissipated_energy, [2 * 20 * 10e-6, 2 * 30 * 10e-6], rtol=0.01)
    np.testing.assert_allclose(series.sliding_distance, 10e-6, rtol=0.01)
    assert series.regime == ("gross slip", "gross slip")


def test_what_a_loop_does_not_show_is_nan():
    x, force = 1e-6 * np.cos(TAU), 20.0 * np.cos(TAU - 1e-3)  # an ellipse, nearly a line: no plateau
    period = replace(
        Oscillator().solve(PROBLEM), friction_force=force, outputs={"block": x, "arm": x}
    )
    series = read_loops({5: period}, 60.0, lambda period: period.rig_displacement[:, 0])
    assert np.isnan(series.friction_coefficient[0])
    assert series.regime != ("gross slip",)


def test_faces_that_stick_all_the_time_have_no_loop_but_a_regime():
    still = {"block": np.zeros(len(TAU)), "arm": np.zeros(len(TAU))}
    stuck = replace(Oscillator().solve(PROBLEM), friction_force=20.0 * np.cos(TAU), outputs=still)
    series = read_loops({0: stuck}, 60.0, lambda period: period.rig_displacement[:, 0])
    assert series.regime == ("stick",)
    assert [*series.sliding_distance, *series.peak_to_peak, *series.dissipated_energy] == [0.0, 0.0, 0.0]
    assert np.isnan([*series.friction_coefficient, *series.tangential_stiffness]).all()
