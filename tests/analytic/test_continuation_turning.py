"""Turning points, jumps and stability against a time integration of the same oscillator.

What carries the weight: a second contact that closes beyond a stroke and opens again makes the rig a bilinear spring,
whose response folds. The fold's two edges must be where stepped time integration, up and down, jumps; between them
the stable periods must be those that the integration settles on, and the middle branch must be unstable.
"""

from functools import cache

import numpy as np
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.continuation.curve import SweepDirection, read_peak
from fretflow.solvers.continuation.follow import Sweep, respond
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

RIG = LumpedRig(moving_mass=10.0, arm_mass=0.5, ground_stiffness=6e5, hinge_stiffness=4e6, ground_damping=90.0,
                hinge_damping=20.0)
SOFT, OWN, COUPLED, NORMAL = 1e-6, 1e-2, 0.7e-6, 1e-6  # m/N
GAP, LOAD, FORCE = 1.4e-6, 60.0, 0.2
START, STOP = 57.0, 63.0


def problem():
    """Two nodes: the first always closed; the second closes when the arm moves by GAP / (COUPLED / SOFT)."""
    flexibility = np.diag([SOFT, SOFT, 1e-12, OWN, OWN, NORMAL])
    flexibility[0, 5] = flexibility[5, 0] = COUPLED
    joint = QuasiStaticJoint.from_stiffness(np.linalg.inv(flexibility), RIG)
    interface = Interface(nodes=np.zeros((2, 2)), areas=np.ones(2), gap=np.array([0.0, GAP]))
    return rig_problem(joint=joint, interface=interface, friction_coefficient=1e3, frequency=100.0,
                           excitation=FORCE, normal_load=LOAD)


def springs():
    """Return the stiffness below and above the stroke at which the second node closes, and that stroke."""
    # unknown f_Ax, f_Az, f_Bx, f_Bz, q_z for a unit step of the arm; both nodes stay where they are
    matrix = np.array([[SOFT, 0, 0, COUPLED, 0], [0, 1e-12, 0, 0, 1], [0, 0, OWN, 0, 0], [COUPLED, 0, 0, NORMAL, 1],
                       [0, 1, 0, 1, 0]])
    forces = np.linalg.solve(matrix, [-1.0, 0.0, -1.0, 0.0, 0.0])
    return 1.0 / SOFT, -(forces[0] + forces[2]), (GAP - 1e-12 * LOAD) * SOFT / COUPLED


@cache
def curve():
    sweep = Sweep(start=START, stop=STOP, harmonics=9, samples=48, fine_harmonics=12, fine_samples=72)
    return respond(problem(), sweep, lambda direction, frequency: None)


def integrate(frequencies, steps=160, periods=80):
    """Step through `frequencies`, each from the last one's end; return the block's first harmonics in m."""
    below, above, stroke = springs()
    mass, damping, stiffness = RIG.mass, RIG.damping, RIG.stiffness
    x, v, amplitudes = np.zeros(2), np.zeros(2), []
    restoring = 0.0
    for frequency in frequencies:
        h = 1.0 / (frequency * steps)
        inert = 4.0 / h**2 * mass + 2.0 / h * damping
        solved = [np.linalg.inv(inert + stiffness + np.diag([0.0, k])) for k in (below, above)]
        drive = FORCE * np.cos(2 * np.pi * np.arange(steps + 1) / steps)
        for _ in range(periods):
            blocks = []
            for j in range(steps):
                push = inert @ x + 4.0 / h * (mass @ v) - stiffness @ x
                push[0] += drive[j] + drive[j + 1]
                push[1] -= restoring
                new = solved[0] @ push
                if new[1] > stroke:
                    push[1] += (above - below) * stroke
                    new = solved[1] @ push
                restoring = below * new[1] + (above - below) * max(new[1] - stroke, 0.0)
                x, v = new, 2.0 / h * (new - x) - v
                blocks.append(x[0])
        amplitudes.append(abs(2.0 * np.fft.rfft(blocks)[1] / steps))
    return np.array(amplitudes)


def test_the_curve_folds_and_its_middle_branch_is_unstable():
    response = curve()
    for direction in SweepDirection:
        assert len(response.turning_points(direction)) == 2
    assert set(response.branch) == {0, 1, 2}
    inner = np.ones(len(response.branch), dtype=bool)  # at a turning point a multiplier is one
    for direction in SweepDirection:
        for turn in response.turning_points(direction):
            inner[max(turn - 1, 0):turn + 2] = False
    assert np.all(response.stable[inner & (response.branch != 1)])
    assert not np.any(response.stable[inner & (response.branch == 1)])
    assert np.sum(inner & (response.branch == 1)) >= 3
    assert read_peak(response).damping_ratio is None
    assert "turns back" in read_peak(response).reason


def branches_at(response, frequency, direction):
    """Return the numbers of the branches that have a period at `frequency`, on the curve of `direction`."""
    own = response.along(direction)
    ends = np.sort([response.frequency[own][1:], response.frequency[own][:-1]], axis=0)
    return set(response.branch[own[:-1]][(ends[0] <= frequency) & (frequency <= ends[1])])


def test_all_periods_at_a_frequency_are_kept_under_their_own_labels():
    response = curve()
    turns = response.frequency[response.turning_points(SweepDirection.UP)]
    between = float(turns.mean())
    for direction in SweepDirection:
        assert branches_at(response, between, direction) == {0, 1, 2}
    assert branches_at(response, START + 0.1, SweepDirection.UP) == {0}
    assert branches_at(response, STOP - 0.1, SweepDirection.UP) == {2}
    amplitudes = []
    for branch in range(3):
        own = np.flatnonzero(response.branch == branch)
        nearest = own[np.argmin(np.abs(response.frequency[own] - between))]
        amplitudes.append(abs(response.first_harmonic[nearest, 0]))
    assert amplitudes[0] > 1.2 * amplitudes[1] > 1.2 * 1.2 * amplitudes[2]


def test_stepped_time_integration_jumps_where_the_curve_turns():
    response = curve()
    own = response.along(SweepDirection.UP)
    turns = response.frequency[response.turning_points(SweepDirection.UP)]
    low, high = turns.min(), turns.max()
    assert high - low > 0.5
    frequency, amplitude = response.frequency[own], np.abs(response.first_harmonic[own, 0])
    upper, lower = ((response.branch[own] == branch) & (np.abs(frequency - edge) > 0.1)
                    for branch, edge in ((0, high), (2, low)))
    upper = np.flatnonzero(upper & (frequency > low - 0.8))
    lower = np.flatnonzero(lower & (frequency < high + 0.8))[::-1]
    assert min(len(upper), len(lower)) >= 3
    up = integrate(np.append(frequency[upper], high + 0.4))
    down = integrate(np.append(frequency[lower], low - 0.2))
    np.testing.assert_allclose(up[:-1], amplitude[upper], rtol=0.02)
    np.testing.assert_allclose(down[:-1], amplitude[lower], rtol=0.02)
    # the next step beyond the fold leaves the branch
    assert up[-1] < 0.5 * up[-2]
    assert down[-1] > 1.5 * down[-2]
