"""Forces beside the contact: their slopes, and a period under play of a hinge as stiff as the rig's.

What carries the weight: slopes against differences, the hinge's force against the dead zone it rounds, and a period
found from nothing where the play is crossed at a stiffness a hundred times that of the ground.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.effects.backlash import Backlash
from fretflow.effects.model import EffectModel
from fretflow.effects.viscous import SPEED, _Dashpot
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.audit import further_force
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion, jenkins_rig_motion
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.force_laws import ArmSupport, BlockPull, HingePlay
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.special import gamma

RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)


@pytest.mark.parametrize("force", [
    ArmSupport(2e5, 1e16), BlockPull(4.0), HingePlay(1e8, 2e-6, 0.1), HingePlay(1e8, 2e-6, 1.0),
    _Dashpot(300.0, 0.5), _Dashpot(300.0, 2.0)])
def test_slopes_are_those_of_differences(force):
    random = np.random.default_rng(3)
    x, v = 2e-6 * random.normal(size=(60, 2)), 1e-3 * random.normal(size=(60, 2))
    response, step = force(x, v), 1e-11
    for place in range(2):
        dx = step * np.eye(2)[place]
        by_x = (force(x + dx, v).force - force(x - dx, v).force) / (2.0 * step)
        by_v = (force(x, v + 1e5 * dx).force - force(x, v - 1e5 * dx).force) / (2e5 * step)
        assert by_x == pytest.approx(response.by_displacement[:, :, place], rel=1e-4, abs=1e-4 * 1e8)
        assert by_v == pytest.approx(response.by_velocity[:, :, place], rel=1e-4, abs=1e-4)


def test_a_cubic_force_is_felt_in_its_own_harmonics():
    """The cube of the 16th is three quarters of it and one of the 48th, which 64 samples take for the 16th."""
    loads, place, cubic, x = np.zeros((17, 2), dtype=complex), 2 * 16 - 1, 1e16, 2e-6
    loads[1, 0] = 53.0
    seen = np.zeros(33)
    seen[place] = x
    bare, pushed = (InternalEquations.build(RIG, np.array([1]), 2.0 * np.pi * 100.0, loads, 64, forces)
                    for forces in ((), (ArmSupport(0.0, cubic),)))
    free, held = bare.balance(seen), pushed.balance(seen)
    assert held.residual - free.residual == pytest.approx(0.75 * cubic * x**3 * np.eye(33)[place], abs=1e-9)
    assert (held.linear.jacobian - free.linear.jacobian)[place, place] == pytest.approx(2.25 * cubic * x**2)
    motion = np.outer(pushed.synthesis @ seen, [0.0, 1.0])
    problem = SimpleNamespace(boundary=SimpleNamespace(forces=pushed.forces), omega=pushed.omega)
    assert further_force(problem, motion) == pytest.approx(-0.75 * cubic * x**2 * motion, abs=1e-9)


@pytest.mark.parametrize("power", [0.5, 1.0, 1.7])
def test_a_dashpot_takes_the_energy_of_its_power_of_the_speed(power):
    """Of a sine: 2^(2 + b) Gamma(1 + b / 2)^2 / Gamma(2 + b) C omega^b x^(1 + b) (Soong, Constantinou, 1994)."""
    damping, x, omega = 300.0, 40e-6, 2.0 * np.pi * 400.0  # 16 times the speed that c is told at
    angle = 2.0 * np.pi * np.arange(4096) / 4096
    v = -omega * x * np.sin(angle)
    taken = _Dashpot(damping, power).of(v)[0]
    energy = float(taken @ v) * 2.0 * np.pi / omega / len(angle)
    constant = damping * SPEED ** (1.0 - power)
    closed = 2.0 ** (2.0 + power) * gamma(1.0 + 0.5 * power) ** 2 / gamma(2.0 + power)
    assert energy == pytest.approx(closed * constant * omega**power * x ** (1.0 + power), rel=0.01)


@pytest.mark.parametrize("rounding", [0.1, 1.0])
def test_a_hinge_carries_nothing_within_its_play_and_all_but_the_play_beyond(rounding):
    k, half = 1e8, 1e-6
    apart = np.linspace(-4.0, 4.0, 801) * half
    x = np.column_stack([0.3e-6 + 0.0 * apart, 0.3e-6 + apart])
    taken = HingePlay(k, 2.0 * half, rounding)(x, np.zeros_like(x)).force
    carried = k * apart - taken[:, 1]
    dead = np.sign(apart) * k * np.maximum(np.abs(apart) - half, 0.0)
    outside = np.abs(np.abs(apart) / half - 1.0) > rounding
    assert carried[outside] == pytest.approx(dead[outside], abs=1e-9)
    assert np.abs(carried - dead).max() == pytest.approx(k * half * rounding / 4.0, rel=0.01)
    assert np.all(np.diff(carried) >= -1e-9)
    assert taken.sum(axis=1) == pytest.approx(np.zeros(801), abs=1e-12)
    assert np.all(HingePlay(k, 0.0, rounding)(x, x).force == 0.0)


def test_a_rig_marched_in_small_steps_is_that_of_the_implicit_march():
    steps = 2000
    drive = 70.0 * np.cos(2.0 * np.pi * np.arange(steps) / steps)
    marched = jenkins_rig_motion(RIG, [], 20e6, 48.0, drive.tolist(), 100.0)
    implicit = jenkins_arm_motion(RIG, 20e6, 48.0, 70.0, 100.0, steps)
    assert marched[:, 1] == pytest.approx(implicit, abs=3e-3 * np.ptp(implicit))


@pytest.mark.parametrize("play", [1e-6])
def test_a_period_is_found_across_the_play_of_a_stiff_hinge(play):
    """Arm and block are unknowns together: the arm alone does not tell where in the play the block is."""
    joint = QuasiStaticJoint.from_stiffness(np.diag([20e6, 20e6, 40e6]), RIG)
    bare = rig_problem(joint=joint, interface=Interface(nodes=np.zeros((1, 2)), areas=np.full(1, 1e-6),
                           gap=np.zeros(1)), friction_coefficient=0.8, frequency=100.0, excitation=70.0,
                           normal_load=60.0)
    model = EffectModel.build(bare, [Backlash().changed(play=play)])
    problem = model.problem(model.initial())
    period = QuasiStaticSolver(Solver(harmonics=40, samples=256, estimate_error=False)).solve(problem)
    assert len(period.residual_history) < 12
    drive = 70.0 * np.cos(2.0 * np.pi * np.arange(2048) / 2048)
    marched = jenkins_rig_motion(RIG, problem.boundary.forces, 20e6, 48.0, drive.tolist(), 100.0)[::8]
    for own, other in zip(period.rig_displacement.T, marched.T, strict=True):
        assert np.sqrt(np.mean((own - other)**2)) < 0.01 * np.ptp(other)
    assert np.ptp(np.diff(period.rig_displacement, axis=1)) > play
