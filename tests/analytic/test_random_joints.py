"""Joints of random matrices: the default solver finds their periods, which time integration confirms.

What carries the weight: the integrator knows no Fourier series and nothing of Newton's way to the root. Springs,
damping, friction and drive are random, from a contact that sticks to one that opens.
"""

import fretflow as ff
import numpy as np
import pytest
from fretflow.core.errors import UnstablePeriodWarning
from fretflow.solvers.time_integration import settle


def random_problem(seed, nodes, sliding, lift):
    """Return masses in a row on contact nodes that rub on the ground, driven by `sliding` times the friction."""
    rng = np.random.default_rng(seed)
    stiffness = np.zeros((6 * nodes, 6 * nodes))

    def spring(a, b, constants):
        for c in range(3):
            ends = np.array([3 * a + c] if b is None else [3 * a + c, 3 * b + c])
            stiffness[np.ix_(ends, ends)] += constants[c] * (2.0 * np.eye(len(ends)) - 1.0)

    for i in range(nodes):
        spring(i, None, 10 ** rng.uniform(5.5, 6.5, 3) / nodes)
        spring(i, nodes + i, 10 ** rng.uniform(6.3, 7.3, 3))
        if i:
            spring(i - 1, i, 10 ** rng.uniform(6.3, 7.3, 3))
    mass = np.diag(np.repeat([0.1, 1e-5], 3 * nodes))
    joint = ff.Joint.from_matrices(stiffness, mass, contact=range(nodes, 2 * nodes),
                                   observe={"tip": 3 * nodes - 3, "lift": 3 * nodes - 1},
                                   modal_damping=10 ** rng.uniform(-2.5, -1.0))
    friction = rng.uniform(0.1, 0.8)
    face = ff.Interface(np.zeros((nodes, 2)), np.full(nodes, 1e-4), np.zeros(nodes))
    drive = {"tip": sliding * friction * 100.0, "lift": lift * 100.0 / nodes * 1j}
    return ff.PeriodicProblem(joint, face, ff.Coulomb(friction), ff.Harmonic(rng.uniform(50.0, 300.0), drive),
                              preload=ff.NormalLoad(100.0))


@pytest.mark.parametrize(("seed", "nodes", "sliding", "lift"), [
    (0, 1, 3.0, 0.0), (1, 2, 1.0, 0.0), (2, 3, 0.3, 0.0), (3, 3, 1.5, 1.5), (4, 5, 1.0, 0.0), (5, 2, 1.5, 2.0)])
def test_the_period_of_a_random_joint_is_that_of_time_integration(seed, nodes, sliding, lift):
    given = random_problem(seed, nodes, sliding, lift)
    period = ff.solve_periodic(given, harmonics=31, samples=256)
    history = settle(given, period, (2, 8), 1024, 1e-4)
    assert np.ptp(period.output("tip")) == pytest.approx(np.ptp(history.of_period(history.outputs["tip"])), rel=0.01)


def test_an_unstable_period_is_told_and_left_by_time_integration():
    given = random_problem(14, 2, 1.5, 2.0)
    with pytest.warns(UnstablePeriodWarning, match="multiplier is 1.1"):
        period = ff.solve_periodic(given, harmonics=31, samples=256)
    history = settle(given, period, (30, 30), 256, 0.0)
    assert np.ptp(history.of_period(history.outputs["tip"])) != pytest.approx(np.ptp(period.output("tip")), rel=0.01)
