"""Forced response by continuation against closed forms and an independent time integration.

What carries the weight: where the contact sticks every point of the curve, its peak and its half-power points are
those of the linear rig; where one node slides the first harmonics are those of a Jenkins element marched in time; and
the derivative by the frequency is that of central differences.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.store import read_record
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.continuation import checkpoint
from fretflow.solvers.continuation import follow as continuation
from fretflow.solvers.continuation.checkpoint import SavedTraces
from fretflow.solvers.continuation.curve import (
    CHANNELS,
    ResponseCurve,
    SweepDirection,
    label_branches,
    read_peak,
    summit,
    turns,
)
from fretflow.solvers.continuation.follow import Sweep, continue_response, respond
from fretflow.solvers.continuation.points import Trail
from fretflow.solvers.continuation.system import ContinuationSystem
from fretflow.solvers.quasi_static.backbone import Backbone
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.optimize import brentq

RIG = LumpedRig(moving_mass=10.0, arm_mass=0.5, ground_stiffness=6e5, hinge_stiffness=4e6, ground_damping=120.0,
                hinge_damping=30.0)
STIFFNESS, LOAD = 1.5e6, 60.0


def problem(force, mu):
    joint = QuasiStaticJoint.from_stiffness(np.diag([STIFFNESS, STIFFNESS, 2e6]), RIG)
    interface = Interface(nodes=np.zeros((1, 2)), areas=np.ones(1), gap=np.zeros(1))
    return rig_problem(joint=joint, interface=interface, friction_coefficient=mu, frequency=100.0,
                           excitation=force, normal_load=LOAD)


def linear(frequency, force):
    impedance = RIG.impedance(np.atleast_1d(2 * np.pi * frequency))
    impedance[:, 1, 1] += STIFFNESS
    return np.linalg.solve(impedance, np.broadcast_to([[force], [0.0]], (len(impedance), 2, 1)))[..., 0]


@cache
def sticking(start=40.0, stop=120.0):
    sweep = Sweep(start=start, stop=stop, harmonics=5, samples=24, fine_harmonics=7, fine_samples=32, tolerance=1e-7)
    return respond(problem(2.0, 100.0), sweep, lambda direction, frequency: None)


def test_a_sticking_contact_gives_the_linear_response_in_both_directions():
    curve = sticking()
    expected = linear(curve.frequency, 2.0)
    np.testing.assert_allclose(curve.first_harmonic[:, :2], expected, rtol=1e-5)
    np.testing.assert_allclose(curve.receptance("arm"), np.abs(expected[:, 1]) / 2.0, rtol=1e-5)
    # the back faces move with the arm and the ground, and the faces do not slide
    np.testing.assert_allclose(curve.first_harmonic[:, 3], expected[:, 1], rtol=1e-5)
    assert np.abs(curve.first_harmonic[:, [2, 4]]).max() < 1e-15
    assert np.all(curve.stable)
    assert not curve.bridged.any()
    assert set(curve.branch) == {0}
    for direction in SweepDirection:
        own = curve.frequency[curve.along(direction)]
        assert np.all(direction * np.diff(own) > 0.0)
        assert sorted(own[[0, -1]]) == pytest.approx([40.0, 120.0])


def test_peak_and_half_power_damping_are_those_of_the_linear_rig():
    def amplitude(f):
        return abs(linear(f, 2.0)[0, 0])

    grid = np.linspace(40.0, 120.0, 160001)
    exact = np.abs(linear(grid, 2.0)[:, 0])
    top = grid[np.argmax(exact)]
    low, high = (brentq(lambda f: amplitude(f) * np.sqrt(2.0) - exact.max(), *ends)
                 for ends in ((40.0, top), (top, 120.0)))
    for direction in SweepDirection:
        peak = read_peak(sticking(), direction=direction)
        assert peak.amplitude == pytest.approx(exact.max(), rel=1e-3)
        assert peak.frequency == pytest.approx(top, rel=2e-4)
        assert peak.lower_half_power == pytest.approx(low, rel=2e-4)
        assert peak.upper_half_power == pytest.approx(high, rel=2e-4)
        assert peak.damping_ratio == pytest.approx((high - low) / (high + low), rel=0.01)
        assert peak.reason == ""


def test_both_ways_along_one_branch_tell_one_peak():
    """Each way's own points stand elsewhere on a flat summit, and told it 0.5 Hz apart."""
    up, down = (read_peak(sticking(), direction=direction) for direction in SweepDirection)
    assert down.frequency == pytest.approx(up.frequency, rel=1e-9)
    assert down.damping_ratio == pytest.approx(up.damping_ratio, rel=1e-9)


def test_a_point_from_elsewhere_is_not_put_into_the_summit(monkeypatch):
    """The plane across a chord meets the curve far off too: a peak at 22 Hz stood at 34 Hz for a point at 129 Hz."""
    plain = ContinuationSystem.correct

    def correct_elsewhere(self, plane, start, known=None):
        point = plain(self, plane, start, known)
        across = self.samples == 32 and plane.row[:-1].any()  # the finer ones, between two points
        return self.at_frequency(1.4 * point.omega, point.seen, point.end) if across else point

    monkeypatch.setattr(ContinuationSystem, "correct", correct_elsewhere)
    curve = sticking.__wrapped__()
    assert not any(len(curve.turning_points(direction)) for direction in SweepDirection)
    assert read_peak(curve).frequency == pytest.approx(read_peak(sticking()).frequency, rel=5e-3)


def test_peak_and_damping_of_an_oscillator_are_those_of_the_closed_form():
    """A stuck joint under one mass: ``f_0 sqrt(1 - 2 zeta^2)``, ``F / (2 k zeta sqrt(1 - zeta^2))`` and zeta."""
    zeta, mass = 0.02, 10.0
    frequency = np.sqrt(STIFFNESS / mass) / (2 * np.pi)
    rig = LumpedRig(moving_mass=mass, arm_mass=1e-6, ground_stiffness=0.0, hinge_stiffness=1e13,
                    ground_damping=2 * zeta * np.sqrt(STIFFNESS * mass), hinge_damping=0.0)
    given = problem(2.0, 100.0)
    oscillator = replace(given, structure=replace(given.structure, rig=rig))
    seen: list[float] = []
    curve = continue_response(oscillator, 50, 75, progress=seen.append, harmonics=3, samples=16, fine_harmonics=3,
                              fine_samples=24, tolerance=1e-7, directions=(SweepDirection.UP,))
    assert min(seen) == pytest.approx(50.0)
    peak = read_peak(curve)
    assert peak.frequency == pytest.approx(frequency * np.sqrt(1 - 2 * zeta**2), rel=2e-4)
    assert peak.amplitude == pytest.approx(2.0 / (2 * STIFFNESS * zeta * np.sqrt(1 - zeta**2)), rel=1e-3)
    assert peak.damping_ratio == pytest.approx(zeta, rel=5e-3)


@pytest.mark.parametrize(("asked", "reason"), [
    ({"start": 60.0, "stop": 50.0}, "start must be positive and below stop"),
    ({"start": 50.0, "stop": 60.0, "channel": "tip"}, "tip"),
    ({"start": 50.0, "stop": 60.0, "sample": 16}, "no setting sample; .*; did you mean samples")])
def test_what_cannot_be_followed_is_refused(asked, reason):
    with pytest.raises(InputError, match=reason):
        continue_response(problem(2.0, 100.0), **asked)


def test_the_load_is_raised_step_by_step_where_rest_leads_nowhere(monkeypatch):
    solve, asked = ContinuationSystem.at_frequency, []

    def fail_first(system, omega, arm, start, known=None):
        asked.append(system.problem.excitation.amplitude)
        if len(asked) == 1:
            raise NonConvergenceError("no", [1.0])
        return solve(system, omega, arm, start, known)

    monkeypatch.setattr(ContinuationSystem, "at_frequency", fail_first)
    sweep = Sweep(start=55.0, stop=57.0, harmonics=15, samples=64, fine_harmonics=15, fine_samples=64,
                  directions=(SweepDirection.UP,))
    curve = respond(problem(20.0, 0.3), sweep, lambda direction, frequency: None)
    np.testing.assert_allclose(asked[1:11], 20.0 * np.arange(1, 11) / 10)
    direct = respond_directly(sweep, 55.0)
    assert curve.first_harmonic[0, 0] == pytest.approx(direct, rel=1e-4)
    assert not curve.bridged.any()


def respond_directly(sweep, frequency):
    system = ContinuationSystem(problem(20.0, 0.3), sweep.harmonics, sweep.samples, 1e-8, 20)
    omega = 2 * np.pi * frequency
    point = system.at_frequency(omega, system.guess(omega), system.march.preloaded())
    return 2.0 * np.fft.rfft(system.motion(point)[:, 0])[1] / sweep.samples


def gap_between(monkeypatch, low, high):
    """Make every point between two frequencies fail."""
    solve = ContinuationSystem.correct

    def fail_between(system, plane, start, known=None):
        if low < plane.unknowns[-1] / (2 * np.pi) < high:
            raise NonConvergenceError(f"no period at {plane.unknowns[-1] / (2 * np.pi):.6g} Hz", [1.0])
        return solve(system, plane, start, known)

    monkeypatch.setattr(ContinuationSystem, "correct", fail_between)


SHORT = Sweep(start=85.0, stop=110.0, harmonics=3, samples=16, fine_harmonics=3, fine_samples=16, tolerance=1e-7,
              longest_step=0.004)  # of a linear rig beyond its resonance


def test_a_gap_is_bridged_and_said(monkeypatch):
    gap_between(monkeypatch, 95.0, 95.3)
    curve = respond(problem(2.0, 100.0), SHORT, lambda direction, frequency: None)
    for direction in SweepDirection:
        own = curve.along(direction)
        assert np.sum(curve.bridged[own]) == 1
        (place,) = np.flatnonzero(curve.bridged[own])
        before, after = curve.frequency[own[place - 1]], curve.frequency[own[place]]
        assert sorted([before, after])[0] <= 95.0
        assert sorted([before, after])[1] >= 95.3
        assert abs(after - before) < 0.011 * before
    np.testing.assert_allclose(curve.first_harmonic[:, :2], linear(curve.frequency, 2.0), rtol=1e-5)


def test_a_curve_that_turns_round_on_itself_is_taken_up_beyond_and_said(monkeypatch):
    """At one point on the way up the next is sought behind, as where contacts that stick have many periods."""
    real, turned = continuation._Follower._arc, []

    def turn_once(self, now, along, arc):
        if not turned and now.omega > 2 * np.pi * 95.0 and along[-1] > 0.0:
            turned.append(now.omega / (2 * np.pi))
            return real(self, now, -along, arc)
        return real(self, now, along, arc)

    monkeypatch.setattr(continuation._Follower, "_arc", turn_once)
    up = replace(SHORT, directions=(SweepDirection.UP,))
    curve = respond(problem(2.0, 100.0), up, lambda direction, frequency: None)
    assert curve.frequency[-1] == pytest.approx(110.0)
    assert np.all(np.diff(curve.frequency) > 0.0)
    assert curve.frequency[np.flatnonzero(curve.bridged) - 1] == pytest.approx(turned)
    np.testing.assert_allclose(curve.first_harmonic[:, :2], linear(curve.frequency, 2.0), rtol=1e-5)


def test_a_curve_in_partial_slip_ends_after_few_periods_and_is_saved_as_it_goes(monkeypatch, tmp_path):
    """25 nodes on a dome of 0.5 m; derivatives by differences would take a period for each of 31 coefficients."""
    side = np.linspace(-0.4e-3, 0.4e-3, 5)
    nodes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    apart = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    flexibility = 2.0 * (1.0 - 0.29**2) / (np.pi * 193e9) / np.where(apart > 0.0, apart, 0.2e-3 / 3.525)  # Love
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    slipping = rig_problem(
        joint=QuasiStaticJoint.from_stiffness(np.linalg.inv(np.kron(flexibility, np.eye(3))), rig),
        interface=Interface(nodes=nodes, areas=np.full(25, 4e-8), gap=np.sum(nodes**2, axis=1)),
        friction_coefficient=0.88, frequency=200.0, excitation=45.0, normal_load=60.0)
    evaluations, sizes, file = [], [], tmp_path / "curve.part"
    evaluate = ContinuationSystem.evaluate
    monkeypatch.setattr(ContinuationSystem, "evaluate",
                        lambda self, *given: evaluations.append(self) or evaluate(self, *given))
    monkeypatch.setattr(checkpoint, "RARELY", 0.0)
    sweep = Sweep(start=60.0, stop=200.0, harmonics=15, samples=64, fine_harmonics=15, fine_samples=64)
    curve = respond(slipping, sweep, lambda direction, frequency: sizes.append(
        len(read_record(file, SavedTraces).points["bridged"]) if file.exists() else 0), file)

    state = QuasiStaticSolver(Solver(harmonics=15, samples=64)).solve(slipping).state
    assert curve.frequency[[0, -1]] == pytest.approx([60.0, 60.0])
    assert np.max(curve.frequency) == pytest.approx(200.0)
    assert np.any(np.any(state == ContactState.STICK, axis=1) & np.any(state == ContactState.SLIP, axis=1))
    assert len(evaluations) < 31 * len(curve.frequency)
    assert np.all(np.diff(sizes) >= 0)
    assert sizes[-1] >= len(curve.frequency) - 2


def test_a_gap_too_wide_is_an_error_that_names_the_frequency(monkeypatch):
    gap_between(monkeypatch, 90.0, 100.0)
    words = r"forced response near (89|90)\.\d+ Hz: the curve has a gap"
    with pytest.raises(NonConvergenceError, match=words) as caught:
        respond(problem(2.0, 100.0), SHORT, lambda direction, frequency: None)
    assert caught.value.history == (1.0,)


def test_the_defect_of_a_model_is_corrected_to_the_true_root_whatever_the_model():
    """A backbone off by a third must not show in the result."""
    omega, results = 2 * np.pi * 55.0, []
    for share in (1.0, 1.3):
        backbone = Backbone(np.array([share * STIFFNESS]), np.array([share * 0.3 * LOAD]))
        system = ContinuationSystem(problem(20.0, 0.3), 15, 64, 1e-8, 20, backbone)
        point = system.at_frequency(omega, system.guess(omega), system.march.preloaded())
        assert point.norm <= 1e-8
        results.append(point.seen)
    np.testing.assert_allclose(results[1], results[0], rtol=0.0, atol=1e-6 * np.linalg.norm(results[0]))


def test_nodes_out_of_reach_do_not_matter_and_are_called_in_where_they_touch(monkeypatch):
    """Three nodes in a row, the outer ones of a crowned face: one touches only as the arm moves, one never does."""
    rows = []
    flexibility = np.kron(6e-7 * np.eye(3) + 1e-7, np.eye(3))
    flexibility[0, 5] = flexibility[5, 0] = 4e-7  # friction at the first node tilts the second one down
    joint = QuasiStaticJoint.from_stiffness(np.linalg.inv(flexibility), RIG)
    interface = Interface(nodes=np.zeros((3, 2)), areas=np.ones(3), gap=np.array([0.0, 4.7e-5, 1e-3]))
    crowned = rig_problem(joint=joint, interface=interface, friction_coefficient=0.5, frequency=100.0,
                              excitation=25.0, normal_load=LOAD)
    sweep = Sweep(start=45.0, stop=47.0, harmonics=11, samples=48, fine_harmonics=11, fine_samples=48,
                  directions=(SweepDirection.UP,))
    make = continuation.Face.of
    monkeypatch.setattr(continuation.Face, "of", lambda problem, nodes: rows.append(nodes) or make(problem, nodes))
    curve = respond(crowned, sweep, lambda direction, frequency: None)
    assert [nodes.tolist() for nodes in rows] == [[True, False, False], [True, True, False]]
    monkeypatch.setattr(continuation, "candidate_nodes", lambda problem, start: np.ones(3, dtype=bool))
    whole = respond(crowned, sweep, lambda direction, frequency: None)
    assert len(rows) == 3
    np.testing.assert_allclose(np.interp(46.0, curve.frequency, np.abs(curve.first_harmonic[:, 2])),
                               np.interp(46.0, whole.frequency, np.abs(whole.first_harmonic[:, 2])), rtol=1e-3)
    np.testing.assert_allclose(curve.first_harmonic[0], whole.first_harmonic[0], rtol=1e-4, atol=1e-10)


def test_what_the_range_does_not_show_is_said():
    outside = read_peak(sticking(90.0, 120.0))
    assert outside.damping_ratio is None
    assert outside.frequency == pytest.approx(90.0)
    assert "end of the frequency range" in outside.reason
    peak = read_peak(sticking()).frequency
    cut = read_peak(sticking(round(peak, 1) - 0.3, 120.0))
    assert cut.lower_half_power is None
    assert cut.upper_half_power == pytest.approx(read_peak(sticking()).upper_half_power, rel=2e-4)
    assert "below the peak" in cut.reason


def jenkins(frequencies, force, limit, steps=1200, periods=100):
    """March rig and Jenkins element at all `frequencies` at once; return first harmonics (block, arm)."""
    h = 1.0 / (np.asarray(frequencies) * steps)
    inert = 4.0 / h[:, None, None] ** 2 * RIG.mass + 2.0 / h[:, None, None] * RIG.damping
    free, stuck = (np.linalg.inv(inert + RIG.stiffness + np.diag([0.0, k])) for k in (0.0, STIFFNESS))
    x, v, friction = np.zeros((len(h), 2)), np.zeros((len(h), 2)), np.zeros(len(h))
    drive, taken = force * np.cos(2 * np.pi * np.arange(steps + 1) / steps), []
    for period in range(periods):
        for j in range(steps):
            push = np.einsum("fij,fj->fi", inert, x) + 4.0 / h[:, None] * (v @ RIG.mass) - x @ RIG.stiffness
            push[:, 0] += drive[j] + drive[j + 1]
            push[:, 1] -= friction
            held = push.copy()
            held[:, 1] += STIFFNESS * x[:, 1] - friction
            new = np.einsum("fij,fj->fi", stuck, held)
            trial = friction + STIFFNESS * (new[:, 1] - x[:, 1])
            slips = np.abs(trial) > limit
            after = np.clip(trial, -limit, limit)
            held = push.copy()
            held[:, 1] -= after
            new = np.where(slips[:, None], np.einsum("fij,fj->fi", free, held), new)
            x, v, friction = new, 2.0 / h[:, None] * (new - x) - v, after
            if period == periods - 1:
                taken.append(x)
    turn = np.exp(-2j * np.pi * np.arange(1, steps + 1) / steps)
    return 2.0 / steps * np.einsum("t,tfi->fi", turn, np.array(taken))


@cache
def sliding():
    sweep = Sweep(start=35.0, stop=90.0, harmonics=25, samples=96, fine_harmonics=25, fine_samples=128,
                  longest_step=0.08, directions=(SweepDirection.UP,))
    return respond(problem(20.0, 0.3), sweep, lambda direction, frequency: None)


def test_a_sliding_node_is_the_jenkins_element_marched_in_time():
    curve = sliding()
    own = curve.along(SweepDirection.UP)
    chosen = own[np.unique(np.searchsorted(curve.frequency[own], np.geomspace(36.0, 89.5, 14)))]
    expected = jenkins(curve.frequency[chosen], 20.0, 0.3 * LOAD)
    stroke = curve.peak_to_peak[chosen, CHANNELS.index("relative")]
    assert np.sum(stroke > 5e-6) >= 4  # gross slip, and stick
    assert np.sum(stroke < 1e-7) >= 2
    np.testing.assert_allclose(curve.first_harmonic[chosen, :2], expected, rtol=5e-3)


@pytest.mark.parametrize("omega", [130.0, 450.0, 2500.0])
def test_derivative_by_the_frequency_is_that_of_central_differences(omega):
    rng = np.random.default_rng(7)
    arm = rng.normal(size=19)
    h = 1e-4 * omega
    loads = np.zeros((10, 2), dtype=complex)
    loads[1, 0] = 53.0
    plus, here, minus = (InternalEquations.build(RIG, np.array([1]), omega + s, loads, 40) for s in (h, 0.0, -h))
    matrix, load = here.rates()
    expected = (plus.impedance - minus.impedance) / (2 * h)
    np.testing.assert_allclose(matrix @ arm, expected @ arm, rtol=1e-5, atol=1e-6 * np.abs(expected @ arm).max())
    np.testing.assert_allclose(load, (plus.load - minus.load) / (2 * h), rtol=1e-5, atol=1e-9)
    system = ContinuationSystem(problem(20.0, 0.3), 9, 64, 1e-9, 20)
    motion = 1e-5 * arm / np.arange(1, 20)
    rest = system.march.preloaded()
    point = system.evaluate(np.append(motion, omega), rest, None, 1e-6)
    sides = [system.evaluate(np.append(motion, omega + s), rest, None, 1e-6).residual for s in (h, -h)]
    rate = (sides[0] - sides[1]) / (2 * h)
    np.testing.assert_allclose(system.derivative(point)[:, -1], rate, rtol=1e-5, atol=1e-6 * np.abs(rate).max())


def test_branches_are_stretches_between_turning_points_and_shared_by_both_directions():
    s = np.linspace(-2.0, 2.0, 41)
    folded, motion = s**3 - 1.5 * s, np.column_stack([3.0 + s, 1j * s])
    up, down = label_branches([(folded, motion), (folded[::-1] + 1e-3, motion[::-1])])
    assert sorted(set(up)) == [0, 1, 2]
    assert np.array_equal(np.diff(up) >= 0, np.full(40, True))
    middle = np.abs(s) < 0.6
    assert set(up[middle]) == {1}
    assert set(down[::-1][middle]) == {1}
    assert down[0] == 2
    assert down[-1] == 0
    _, other = label_branches([(folded, motion), (folded, 2.0 * motion)])
    assert sorted(set(other)) == [3, 4, 5]


def test_a_fold_as_narrow_as_the_samples_make_is_none():
    places = turns(np.array([60.0, 61.0, 62.0, 61.98, 62.5, 63.0, 62.0, 61.0, 61.01, 60.99, 64.0]))
    assert places.tolist() == [5, 9]
    assert turns(np.array([3.0, 2.0, 2.001, 1.0])).size == 0
    assert turns(np.array([3.0, 2.0, 2.1, 1.0])).tolist() == [1, 2]


def test_an_unknown_channel_is_refused():
    with pytest.raises(InputError, match=r"'anvil'.*block, arm"):
        read_peak(sticking(), "anvil")


def test_a_curve_survives_its_file(tmp_path):
    from fretflow.core.store import read_record, write_record

    again = read_record(write_record(tmp_path / "curve.h5", sticking()), ResponseCurve)
    np.testing.assert_array_equal(again.first_harmonic, sticking().first_harmonic)
    np.testing.assert_array_equal(again.stable, sticking().stable)


def test_the_way_back_meets_the_points_of_the_way_there(monkeypatch):
    sweep = Sweep(start=50.0, stop=70.0, harmonics=15, samples=64, fine_harmonics=15, fine_samples=64)

    def shared():
        curve = respond(problem(20.0, 0.3), sweep, lambda direction, frequency: None)
        up, down = (curve.frequency[curve.along(direction)] for direction in SweepDirection)
        return np.mean(np.isin(np.round(down, 6), np.round(up, 6)))

    assert shared() > 0.7
    monkeypatch.setattr(Trail, "ahead", lambda trail, now, along, reach: None)
    assert shared() < 0.3


def test_an_uneven_summit_is_smoothed():
    """Amplitudes uneven by 0.2 % put the peak of an oscillator at one of several points; all of them tell where."""
    frequency = np.linspace(90.0, 110.0, 41)
    motion = 1.0 / (1.0 - (frequency / 100.0) ** 2 + 0.2j * frequency / 100.0)
    uneven = motion * (1.0 + 0.002 * (-1.0) ** np.arange(41) * np.sign(frequency - 99.5))
    one = replace(sticking(), frequency=frequency, first_harmonic=np.tile(uneven[:, None], 5),
                  direction=np.ones(41, dtype=np.int8), excitation=1.0)
    peak = read_peak(one)
    exact = 100.0 * np.sqrt(1.0 - 2.0 * 0.1**2)
    assert peak.frequency == pytest.approx(exact, abs=0.25)
    assert abs(frequency[np.argmax(np.abs(uneven))] - exact) > 0.4
    assert summit(np.array([0.5, 0.98, 0.995, 1.0, 0.999, 0.98, 0.995])) == (2, 4)
    assert summit(np.array([0.5, 0.9, 1.0, 0.9])) == (1, 3)
