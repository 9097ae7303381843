"""Forced response by continuation against closed forms and an independent time integration.

What carries the weight: where the contact sticks every point of the curve, its peak and its half-power points are
those of the linear rig; where one node slides the first harmonics are those of a Jenkins element marched in time; and
the derivative by the frequency is that of central differences.
"""

from functools import cache

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError
from fretflow.harmonic.continuation import Sweep, respond
from fretflow.harmonic.continuation_curve import (
    CHANNELS,
    Direction,
    ResponseCurve,
    label_branches,
    read_peak,
)
from fretflow.harmonic.continuation_system import ArmSystem, arm_rates
from fretflow.harmonic.periodic import PeriodicProblem
from fretflow.harmonic.quasi_static import ArmEquations
from fretflow.rig.joint import QuasiStaticJoint
from fretflow.rig.lumped import LumpedRig
from scipy.optimize import brentq

RIG = LumpedRig(moving_mass=10.0, arm_mass=0.5, ground_stiffness=6e5, hinge_stiffness=4e6, ground_damping=120.0,
                hinge_damping=30.0)
STIFFNESS, LOAD = 1.5e6, 60.0


def problem(force, mu):
    joint = QuasiStaticJoint.from_stiffness(np.diag([STIFFNESS, STIFFNESS, 2e6]), RIG)
    interface = Interface(nodes=np.zeros((1, 2)), areas=np.ones(1), gap=np.zeros(1))
    return PeriodicProblem(joint=joint, interface=interface, friction_coefficient=mu, frequency=100.0,
                           excitation=force, normal_load=LOAD)


def linear(frequency, force):
    impedance = RIG.impedance(np.atleast_1d(2 * np.pi * frequency))
    impedance[:, 1, 1] += STIFFNESS
    return np.linalg.solve(impedance, np.broadcast_to([[force], [0.0]], (len(impedance), 2, 1)))[..., 0]


@cache
def sticking(start=40.0, stop=120.0):
    return respond(problem(2.0, 100.0), Sweep(start=start, stop=stop, harmonics=5, samples=32, fine_harmonics=7,
                                              fine_samples=48), lambda frequency: None)


def test_a_sticking_contact_gives_the_linear_response_in_both_directions():
    found = sticking()
    expected = linear(found.frequency, 2.0)
    np.testing.assert_allclose(found.first_harmonic[:, :2], expected, rtol=1e-5)
    np.testing.assert_allclose(found.receptance("arm"), np.abs(expected[:, 1]) / 2.0, rtol=1e-5)
    # the back faces move with the arm and the ground, and the faces do not slide
    np.testing.assert_allclose(found.first_harmonic[:, 3], expected[:, 1], rtol=1e-5)
    assert np.abs(found.first_harmonic[:, [2, 4]]).max() < 1e-15
    assert np.all(found.stable)
    assert not found.bridged.any()
    assert set(found.branch) == {0}
    for direction in Direction:
        own = found.frequency[found.along(direction)]
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
    for direction in Direction:
        peak = read_peak(sticking(), direction=direction)
        assert peak.amplitude == pytest.approx(exact.max(), rel=1e-3)
        assert peak.frequency == pytest.approx(top, rel=2e-4)
        assert peak.lower_half_power == pytest.approx(low, rel=2e-4)
        assert peak.upper_half_power == pytest.approx(high, rel=2e-4)
        assert peak.damping_ratio == pytest.approx((high - low) / (high + low), rel=0.01)
        assert peak.reason == ""


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
    sweep = Sweep(start=30.0, stop=90.0, harmonics=25, samples=128, fine_harmonics=25, fine_samples=128,
                  directions=(Direction.UP,))
    return respond(problem(20.0, 0.3), sweep, lambda frequency: None)


def test_a_sliding_node_is_the_jenkins_element_marched_in_time():
    found = sliding()
    own = found.along(Direction.UP)
    chosen = own[np.unique(np.searchsorted(found.frequency[own], np.geomspace(31.0, 89.0, 14)))]
    expected = jenkins(found.frequency[chosen], 20.0, 0.3 * LOAD)
    stroke = found.peak_to_peak[chosen, CHANNELS.index("relative")]
    assert np.sum(stroke > 5e-6) >= 4  # gross slip, and stick
    assert np.sum(stroke < 1e-7) >= 2
    np.testing.assert_allclose(found.first_harmonic[chosen, :2], expected, rtol=5e-3)


@pytest.mark.parametrize("omega", [130.0, 450.0, 2500.0])
def test_derivative_by_the_frequency_is_that_of_central_differences(omega):
    rng = np.random.default_rng(7)
    arm = rng.normal(size=19)
    matrix, load = arm_rates(RIG, omega, 53.0, 9)
    h = 1e-4 * omega
    plus, minus = (ArmEquations.build(RIG, omega + s, 53.0, 9, 40) for s in (h, -h))
    expected = (plus.impedance - minus.impedance) / (2 * h)
    np.testing.assert_allclose(matrix @ arm, expected @ arm, rtol=1e-5, atol=1e-6 * np.abs(expected @ arm).max())
    np.testing.assert_allclose(load, (plus.load - minus.load) / (2 * h), rtol=1e-5, atol=1e-9)
    system = ArmSystem(problem(20.0, 0.3), 9, 64, 1e-9, 20)
    motion = 1e-5 * arm / np.arange(1, 20)
    rest = system.march.preloaded()
    point = system.evaluate(np.append(motion, omega), rest, None, 1e-6)
    sides = [system.evaluate(np.append(motion, omega + s), rest, None, 1e-6).residual for s in (h, -h)]
    rate = (sides[0] - sides[1]) / (2 * h)
    np.testing.assert_allclose(point.rate, rate, rtol=1e-5, atol=1e-6 * np.abs(rate).max())


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


def test_an_unknown_channel_is_refused():
    with pytest.raises(InputError, match=r"'anvil'.*block, arm"):
        read_peak(sticking(), "anvil")


def test_a_curve_survives_its_file(tmp_path):
    from fretflow.core.store import read_record, write_record

    again = read_record(write_record(tmp_path / "curve.h5", sticking()), ResponseCurve)
    np.testing.assert_array_equal(again.first_harmonic, sticking().first_harmonic)
    np.testing.assert_array_equal(again.stable, sticking().stable)
