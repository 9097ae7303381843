"""The time integrator: its order, its energy balance, and the true periodic solver against it.

What carries the weight: the integrator knows no Fourier series, so the periodic solver's distance to it is the
solver's error, which must be small and fall as samples and harmonics grow. The integrator itself must follow a joint
that sticks like the matrix exponential, with order two, and balance its energies.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver, sliding_distance
from fretflow.solvers.time_integration import integrate, settle
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.linalg import expm

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
NODES = len(DATA["x"])
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
PAIR = QuasiStaticJoint.from_stiffness(1e3 * DATA["K"], RIG)
SLIDING = (53.0, 60.0, 75.0)


def problem(force, joint=PAIR, mu=0.88):
    nodes = len(joint.stiffness) // 3
    interface = Interface(nodes=np.zeros((nodes, 2)), areas=np.full(nodes, 1e-6 / nodes), gap=np.zeros(nodes))
    return rig_problem(joint=joint, interface=interface, friction_coefficient=mu, frequency=100.0,
                           excitation=force, normal_load=60.0)


@cache
def periodic(force, harmonics, samples):
    settings = Solver(harmonics=harmonics, samples=samples, estimate_error=False)
    return QuasiStaticSolver(settings).solve(problem(force))


@cache
def integrated(force):
    """Integrate, at 1024 steps, from the period of 256 samples until the arm repeats itself."""
    return settle(problem(force), periodic(force, 25, 256), (3, 12), 1024, 2e-4)


def distance(force, harmonics, samples):
    """Return how far a period is from time integration: sliding distance, and rms of the force over its range."""
    period, history = periodic(force, harmonics, samples), integrated(force)
    friction = history.of_period(history.friction_force)[::1024 // samples]
    sliding = history.sliding_distance[-1]
    return (abs(sliding_distance(period, problem(force).interface) / sliding - 1.0),
            np.sqrt(np.mean((period.friction_force - friction)**2)) / np.ptp(friction))


@pytest.mark.parametrize("force", SLIDING)
def test_the_periodic_solver_is_true_to_time_integration(force):
    sliding, friction = distance(force, 25, 256)
    assert sliding < 0.01
    assert friction < 0.02


@pytest.mark.parametrize("force", [53.0, 60.0])
def test_the_distance_falls_as_samples_and_harmonics_grow(force):
    rough, middle, fine = (distance(force, h, n) for h, n in ((8, 32), (15, 128), (50, 512)))
    assert rough[0] > 2.0 * fine[0]
    assert rough[1] > middle[1] > fine[1]


@pytest.mark.parametrize("force", SLIDING)
def test_work_of_the_excitation_is_friction_and_damping(force):
    """Over the last period; sums of the motion alone, by the trapezoidal rule and central differences."""
    history = integrated(force)
    steps = history.steps_per_period
    block, arm = (history.of_period(history.outputs[name]) for name in ("block", "arm"))
    push = force * np.cos(2 * np.pi * np.arange(steps) / steps)
    given = np.sum(0.5 * (push + np.roll(push, 1)) * (block - np.roll(block, 1)))
    moved = np.column_stack([block, arm]) - np.roll(np.column_stack([block, arm]), 1, axis=0)
    damped = np.einsum("ji,ik,jk->", moved, RIG.damping, moved) * 100.0 * steps
    assert given == pytest.approx(history.dissipated_energy[-1] + damped, rel=5e-3)


def test_a_joint_that_sticks_follows_the_matrix_exponential_with_order_two():
    joint = QuasiStaticJoint.from_stiffness(2e6 * np.eye(3), LumpedRig.from_modes(10.0, 0.5, 40.0, 450.0, 0.03))
    turning = 2 * np.pi * 100.0
    matrix = np.zeros((6, 6))  # x, v, cos, sin
    inverse = np.linalg.inv(joint.rig.mass)
    matrix[:2, 2:4] = np.eye(2)
    matrix[2:4, :2] = -inverse @ (joint.rig.stiffness + np.diag([0.0, 2e6]))
    matrix[2:4, 2:4] = -inverse @ joint.rig.damping
    matrix[2:4, 4] = inverse @ [30.0, 0.0]
    matrix[4, 5], matrix[5, 4] = -turning, turning
    errors = []
    for steps in (100, 200, 400):
        history = integrate(problem(30.0, joint, mu=50.0), None, 3, steps)
        state = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
        hop, exact = expm(matrix * 0.01 / steps), []
        for _ in range(3 * steps):
            state = hop @ state
            exact.append(state[:2])
        motion = np.column_stack([history.outputs["block"], history.outputs["arm"]])
        errors.append(np.abs(motion - exact).max() / np.ptp(exact))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 5e-3


def test_whether_motion_repeats_takes_two_periods():
    after = [settle(problem(60.0), None, (fewest, 40), 64, 1e-3) for fewest in (1, 2)]
    assert len(after[0].change) == len(after[1].change) > 1
    assert after[0].change[-1] <= 1e-3


def test_a_joint_at_rest_stays_at_rest():
    history = integrate(problem(0.0), None, 1, 16)
    assert np.abs(history.outputs["arm"]).max() < 1e-16
    assert np.abs(history.friction_force).max() < 1e-6
    assert np.abs(history.friction_work).max() < 1e-18


def test_a_step_far_longer_than_the_hinge_mode_is_stable():
    """At 16 steps a period the hinge mode turns by a right angle more than once a step."""
    history = integrate(problem(75.0), None, 20, 16)
    assert history.sliding_distance[-1] == pytest.approx(integrated(75.0).sliding_distance[-1], rel=0.1)


def test_change_is_that_of_the_arm_from_period_to_period():
    history = integrate(problem(60.0), None, 3, 32)
    periods = history.outputs["arm"].reshape(3, 32)
    assert history.change[1] == pytest.approx(np.abs(periods[2] - periods[1]).max() / np.ptp(periods[2]))
    assert history.of_period(history.outputs["arm"])[0] == history.outputs["arm"][-1]
    assert history.of_period(history.outputs["arm"], 0)[1] == history.outputs["arm"][0]


@pytest.mark.parametrize(("periods", "steps"), [(0, 64), (1, 7)])
def test_too_little_is_refused(periods, steps):
    with pytest.raises(InputError, match="at least one period and eight steps"):
        integrate(problem(60.0), None, periods, steps)
