"""Floquet multipliers against those of linear rigs in closed form and against perturbed marches of the nonlinear one.

What carries the weight: on a contact that sticks the multipliers are ``exp(lambda T)`` of the rig's own eigenvalues,
damped or driven unstable by a negative dashpot; on a contact that slides, the monodromy matrix must be that of
differences between two nonlinear marches of rig and contact.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.contact.law import FactorAndSlopes
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.continuation.system import ContinuationSystem
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.sample import STICK, PeriodHistory, SampleSolver, SampleState
from fretflow.solvers.stability import Around, floquet_multipliers, is_stable, monodromy_matrix
from fretflow.structure.internal_forces import ForceAndSlopes
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint, change_rig
from fretflow.structure.two_mass_rig.lumped import LumpedRig

STIFFNESS = 2e6  # N/m
RIG_STATES = 5  # block and arm position, their velocities, and the friction force


def rig(ground_damping=60.0):
    return LumpedRig(moving_mass=10.0, arm_mass=0.5, ground_stiffness=6e5, hinge_stiffness=4e6,
                     ground_damping=ground_damping, hinge_damping=150.0)


def converged(force, frequency, samples, rig_, nodes=1, gap=None, mu=0.6):
    spread = 1.0 + 0.3 * np.arange(3 * nodes) / (3 * nodes)
    stiffness = np.diag(STIFFNESS / nodes * spread)
    joint = QuasiStaticJoint.from_stiffness(stiffness, rig_)
    interface = Interface(nodes=np.zeros((nodes, 2)), areas=np.ones(nodes),
                          gap=np.zeros(nodes) if gap is None else gap)
    problem = rig_problem(joint=joint, interface=interface, friction_coefficient=mu, frequency=frequency,
                              excitation=force, normal_load=60.0)
    system = ContinuationSystem(problem, min(15, samples // 4), samples, 1e-9, 30)
    omega = 2 * np.pi * frequency
    guess = system.guess(omega) if force > 1.0 else 1e-9 * np.ones(2 * system.harmonics + 1)
    return system, system.at_frequency(omega, guess, system.march.preloaded())


def nothing_around(samples):
    """Return that nothing beside structure and contact follows the motion of block and arm."""
    none, slopes = np.zeros(samples), np.zeros((samples, 2, 2))
    return Around(np.array([1]), np.ones(1), FactorAndSlopes(np.ones(samples), none, none),
                  ForceAndSlopes(np.zeros((samples, 2)), slopes, slopes))


@pytest.mark.parametrize("ground_damping", [60.0, -40.0, 3.0])
def test_a_sticking_contact_has_the_multipliers_of_the_linear_rig(ground_damping):
    own, frequency = rig(ground_damping), 60.0
    errors = []
    for samples in (128, 256):
        system, point = converged(1.0, frequency, samples, own)
        assert np.all(point.history.state == STICK)
        multipliers = floquet_multipliers(own, system.march.system, point.history, frequency, nothing_around(samples))
        stiffness = own.stiffness + np.diag([0.0, STIFFNESS])
        companion = np.block([[np.zeros((2, 2)), np.eye(2)],
                              [-np.linalg.solve(own.mass, stiffness), -np.linalg.solve(own.mass, own.damping)]])
        exact = np.exp(np.linalg.eigvals(companion) / frequency)
        exact = exact[np.argsort(-np.abs(exact))]
        assert is_stable(multipliers) == (ground_damping > 0.0)
        assert np.abs(multipliers[4:]).max() < 1e-10  # the friction force is no state of its own
        errors.append(max(np.abs(exact - value).min() for value in multipliers[:2]))
        assert np.abs(multipliers[0]) == pytest.approx(np.abs(exact[0]), rel=2e-3)
    assert errors[1] < 0.27 * errors[0] < 0.05  # second order in the samples


def pull(contact, arm):
    """Return the pull (3 n,) at a position (1,) of the arm."""
    bent = 0.0 if contact.curvature is None else contact.curvature @ arm**2
    return contact.pull + contact.coupling @ arm + bent


@pytest.mark.parametrize(("force", "nodes"), [(60.0, 1), (45.0, 3)])
def test_monodromy_is_that_of_perturbed_nonlinear_marches(force, nodes):
    own, frequency, samples = rig(), 45.0, 96
    system, point = converged(force, frequency, samples, own, nodes)
    period, contact = point.history, system.march.system
    # begin where nodes stick that slip later: there the contact remembers
    stuck = np.all(period.state == STICK, axis=1) & np.all(np.roll(period.state, 1, axis=0) == STICK, axis=1)
    assert 0 < np.sum(stuck) < samples
    first = int(np.argmax(stuck))
    period = PeriodHistory(*(np.roll(values, -first, axis=0) for values in period))
    n, h = contact.size, 1.0 / (frequency * samples)
    moving = np.flatnonzero(np.any(period.state != STICK, axis=0))
    memory = np.concatenate([3 * moving, 3 * moving + 1])
    inert = own.mass * 4.0 / h**2 + own.damping * 2.0 / h

    def march(perturbation):
        """Step rig and contact implicitly around the period, the rig's motion and forces as deviations."""
        solver = SampleSolver(contact)
        solver.tolerance = 1e-13 * contact.load
        x, v, phi = perturbation[:2].copy(), perturbation[2:4].copy(), perturbation[4]
        before = SampleState.of(period)
        before = SampleState(before.displacement.copy(), before.force, before.state)
        before.displacement[memory] += perturbation[RIG_STATES:]
        for j in range(samples):
            after, x1 = before, x.copy()
            push = inert @ x + 4.0 / h * own.mass @ v - own.stiffness @ x
            for _ in range(40):
                after = solver.solve(pull(contact, period.position[j] + x1[1]), before.displacement,
                                     SampleState.of(period, j), pull(contact, period.position[j - 1]))
                new = after.force[0::3].sum() - period.force[j, 0::3].sum()
                residual = (inert + own.stiffness) @ x1 - push - np.array([0.0, phi + new])
                if np.abs(residual).max() < 1e-12:
                    break
                _, slope = solver.tangent(after, before.displacement, np.zeros((3 * n, 1)), np.ones((1, 1)))
                x1 -= np.linalg.solve(inert + own.stiffness - np.diag([0.0, slope[0, 0]]), residual)
            x, v, phi, before = x1, 2.0 / h * (x1 - x) - v, new, after
        return np.concatenate([x, v, [phi], (before.displacement - period.displacement[-1])[memory]])

    matrix = monodromy_matrix(own, contact, period, frequency, nothing_around(len(period.state)))
    rng = np.random.default_rng(5)
    scales = np.concatenate([[1e-6, 1e-6, 1e-3, 1e-3, 1.0], np.full(len(memory), 1e-6)])
    direction = rng.normal(size=len(matrix)) * scales * 1e-5
    differences = 0.5 * (march(direction) - march(-direction))
    expected = matrix @ direction
    size = np.abs(matrix) @ np.abs(direction)
    assert np.all(np.abs(differences - expected) < 1e-6 * size + 1e-9 * np.abs(scales))


def test_forces_on_the_rig_take_part():
    """A negative dashpot given as a force is one of the rig's own; a spring likewise."""
    samples, frequency = 96, 45.0
    system, point = converged(60.0, frequency, samples, rig(60.0))
    contact, period = system.march.system, point.history
    more = np.array([[0.0, 0.0], [0.0, 0.0]]), np.array([[100.0, 0.0], [0.0, 0.0]])
    around = nothing_around(samples)
    forced = replace(around, forces=around.forces._replace(
        by_displacement=np.broadcast_to(more[0], (samples, 2, 2)),
        by_velocity=np.broadcast_to(more[1], (samples, 2, 2))))
    matrix = monodromy_matrix(rig(60.0), contact, period, frequency, forced)
    own = monodromy_matrix(rig(-40.0), contact, period, frequency, around)
    np.testing.assert_allclose(matrix, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())
    assert not np.allclose(matrix, monodromy_matrix(rig(60.0), contact, period, frequency, around), rtol=1e-3)


@dataclass(frozen=True)
class Weakening:
    """Friction that falls with speed and rises along x."""

    def __call__(self, position, velocity):
        share = 0.3 * np.exp(-np.abs(velocity) / 5e-3)
        return FactorAndSlopes(1.0 + share + 2e3 * position, np.full_like(position, 2e3),
                               -np.sign(velocity) * share / 5e-3)


def test_friction_and_load_that_follow_the_motion_take_part():
    """Against differences of marches in which both follow the perturbed motion."""
    own, frequency, samples = rig(), 45.0, 96
    system, point = converged(60.0, frequency, samples, own)
    problem = replace(
        system.problem, law=replace(system.problem.law, motion_factors=(Weakening(),)),
        structure=change_rig(system.problem.structure, load_slope=4e4, load_curvature=5e9)).vary(frequency=frequency)
    motion = system.motion(point)
    speed = time_derivative(motion[:, 1], problem.omega)
    # a period of its own under these laws: the arm's motion as it is, the contact marched until it repeats
    march = ContactMarch.of(problem, np.array([1]))
    period = march.period(motion[:, 1:], np.zeros((samples, 1, 0)), march.preloaded(), None, 1e-13).history
    contact = march.system
    h = 1.0 / (frequency * samples)
    moving = np.flatnonzero(np.any(period.state != STICK, axis=0))
    memory = np.concatenate([3 * moving, 3 * moving + 1])
    inert = own.mass * 4.0 / h**2 + own.damping * 2.0 / h

    def differences(perturbation):
        x, v, phi = perturbation[:2].copy(), perturbation[2:4].copy(), perturbation[4]
        before = SampleState.of(period)
        before = SampleState(before.displacement.copy(), before.force, before.state)
        before.displacement[memory] += perturbation[RIG_STATES:]
        solver = SampleSolver(contact)
        solver.tolerance = 1e-14 * contact.load
        for j in range(samples):
            push = inert @ x + 4.0 / h * own.mass @ v - own.stiffness @ x + np.array([0.0, phi])
            after, new, x1 = before, phi, x
            for _ in range(60):
                x1 = np.linalg.solve(inert + own.stiffness, push + np.array([0.0, new]))
                v1 = 2.0 / h * (x1 - x) - v
                arm = period.position[j] + x1[1]
                factor = Weakening()(arm, speed[j] + v1[1]).factor[0]
                after = solver.solve(pull(contact, arm), before.displacement, SampleState.of(period, j),
                                     pull(contact, period.position[j - 1]), factor)
                last, new = new, after.force[0::3].sum() - period.force[j, 0::3].sum()
                if abs(new - last) < 1e-13:
                    break
            x, v, phi, before = x1, v1, new, after
        return np.concatenate([x, v, [phi], (before.displacement - period.displacement[-1])[memory]])

    matrix = monodromy_matrix(own, contact, period, frequency, Around.of(problem, motion))
    scales = np.concatenate([[1e-6, 1e-6, 1e-3, 1e-3, 1.0], np.full(len(memory), 1e-6)])
    direction = np.random.default_rng(3).normal(size=len(matrix)) * scales * 1e-5
    expected = matrix @ direction
    odd_part = 0.5 * (differences(direction) - differences(-direction))
    size = np.abs(matrix) @ np.abs(direction)
    assert np.all(np.abs(odd_part - expected) < 1e-5 * size + 1e-9 * np.abs(scales))
    plain = monodromy_matrix(own, system.march.system, period, frequency, nothing_around(len(period.state)))
    assert np.abs((plain - matrix) @ direction / size).max() > 1e-3  # they matter


def test_sliding_damps():
    own = rig(3.0)
    moduli = {}
    for force in (1.0, 60.0):
        system, point = converged(force, 45.0, 96, own)
        multipliers = floquet_multipliers(own, system.march.system, point.history, 45.0, nothing_around(96))
        moduli[force] = np.abs(multipliers[0])
    assert moduli[60.0] < 0.9 * moduli[1.0] < 0.9
