"""Sensitivities of the period against differences of full solutions and against laws that they must obey.

What carries the weight: central differences of solutions solved again, for every kind of parameter, in gross slip, in
partial slip with nodes stuck all the period, and with nodes that open; and three exact laws that no difference enters:
the period is homogeneous in forces and lengths, in forces and stiffnesses, and unchanged when time is stretched.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError
from fretflow.effects.cycle import respond
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix, to_complex, to_real
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.sample import PeriodHistory, SampleState
from fretflow.solvers.quasi_static.sensitivity import Direction
from fretflow.solvers.quasi_static.solver import InternalEquations, QuasiStaticSolver
from fretflow.solvers.sensitivity import sensitivities
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
EVERY_OTHER = np.flatnonzero(np.isin(np.arange(49) // 7 % 2 + np.arange(49) % 7 % 2, 0))
NODES, HARMONICS, SAMPLES = len(EVERY_OTHER), 8, 48
RNG = np.random.default_rng(5)
WEIGHTS, SPRINGS = RNG.random(NODES), 1e-9 * RNG.random(3 * NODES)
AREAS = 1e-6 / NODES * (1.0 + 0.2 * RNG.random(NODES))
TILT = 3e-8 * RNG.random(NODES)
DOME = TILT + 6e-7 * np.sum((DATA["x"][EVERY_OTHER, :2] / 0.5)**2, axis=1)
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
PARTS = {"moving_mass": 1.0, "arm_mass": 50.0, "ground_stiffness": 10.0, "hinge_stiffness": 50.0,
         "ground_damping": 100.0, "hinge_damping": 3000.0}
NO_RIG = LumpedRig(**dict.fromkeys(PARTS, 0.0))
SOLVER = QuasiStaticSolver(Solver(harmonics=HARMONICS, samples=SAMPLES, estimate_error=False))
OUTPUTS = ("block", "arm", "upper", "lower")
GROSS, PARTIAL, OPENING = (75.0, False), (38.0, False), (60.0, True)


def joint():
    dofs = (3 * EVERY_OTHER[:, None] + np.arange(3)).ravel()
    flexibility = np.linalg.inv(1e3 * DATA["K"])[np.ix_(dofs, dofs)]
    observed = np.random.default_rng(8).normal(size=(2, 3, 3 * NODES))
    return replace(with_flexibility(0.5 * (flexibility + flexibility.T)), upper_compliance=1e-9 * observed[0],
                   lower_compliance=1e-9 * observed[1])


def with_flexibility(flexibility, model=None):
    stiffness = np.linalg.inv(flexibility)
    if model is None:
        return QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T), RIG)
    return replace(model, stiffness=0.5 * (stiffness + stiffness.T), flexibility=flexibility)


@cache
def problem(force, domed, mu=0.88):
    interface = Interface(nodes=1e-3 * DATA["x"][EVERY_OTHER, :2], areas=AREAS, gap=DOME if domed else TILT)
    return rig_problem(joint=joint(), interface=interface, friction_coefficient=mu, frequency=100.0,
                           excitation=force, normal_load=60.0)


@cache
def solution(force, domed, mu=0.88):
    given = problem(force, domed, mu)
    return solve_again(given, SOLVER.solve(given))


def solve_again(given, start):
    """Solve from `start` to round-off: differences of loosely converged periods would show their looseness."""
    model, synthesis = given.structure, synthesis_matrix(HARMONICS, SAMPLES)
    equations = InternalEquations.of(given, HARMONICS, SAMPLES)
    march = ContactMarch.of(given, equations.seen)
    u, f = (a.reshape(SAMPLES, -1).copy() for a in (start.displacement, start.force))
    near = PeriodHistory(start.internal[:, 1:].copy(), u, f, start.state.copy())
    arm = equations.analysis @ near.position[:, 0]
    for turn in range(10):
        period = march.period((synthesis @ arm)[:, None], synthesis[:, None], SampleState.of(near), near, 1e-14)
        near = period.history
        friction = near.force[:, 0::3].sum(axis=1)
        residual = equations.impedance @ arm - equations.load - equations.analysis @ friction
        if turn > 2 and np.linalg.norm(residual) < 1e-13 * given.excitation.amplitude:
            break
        arm = arm - np.linalg.solve(equations.impedance - equations.analysis @ period.tangent[:, 0], residual)
    else:
        pytest.fail(f"residual {np.linalg.norm(residual)} N")
    u, f = (a.reshape(SAMPLES, NODES, 3) for a in (near.displacement, near.force))
    approach = u[:, 0, 2] - near.force @ model.flexibility[2]
    upper, lower = model.observe(np.column_stack([synthesis @ arm, approach]), near.force)
    block = synthesis @ equations.free_other(arm)
    return replace(start, displacement=u, force=f, state=near.state, friction_force=-friction,
                   internal=np.column_stack([block, synthesis @ arm]),
                   outputs={"block": block, "arm": synthesis @ arm, "upper": upper, "lower": lower})


def friction(weights=1.0):
    """Return the friction coefficient, or a pattern of it over the nodes, and samples if it varies."""
    return Direction(name="friction", friction=np.broadcast_to(weights, (SAMPLES, NODES)))


def normal_load():
    return Direction(name="normal load", normal_load=np.ones(SAMPLES))


def gap(weights):
    return Direction(name="gap", gap=weights)


def rig_force(history, name):
    """Return a force history (N, 2) on block and arm."""
    return Direction(name=name, force=history)


def flexibility(matrix):
    """Return a change of the faces' flexibility; G itself scales it, -G scales the stiffness."""
    return Direction(name="flexibility", flexibility=matrix)


def rig_part(name):
    """Return one of the masses, springs and dashpots of a `LumpedRig`."""
    return Direction(name=name, rig=replace(NO_RIG, **{name: 1.0}))


def excitation():
    wave = np.cos(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    return rig_force(np.column_stack([wave, np.zeros(SAMPLES)]), "excitation")


def frequency(given, period):
    """Return the frequency of the excitation, by what it changes of the rig's forces at the motion found."""
    moved = to_complex(analysis_matrix(HARMONICS, SAMPLES) @ period.internal)
    k = np.arange(HARMONICS + 1)[:, None, None]
    by_omega = 1j * k * RIG.damping - 2.0 * given.omega * k**2 * RIG.mass
    force = to_real(-2.0 * np.pi * np.einsum("kab,kb->ka", by_omega, moved))
    return rig_force(synthesis_matrix(HARMONICS, SAMPLES) @ force, "frequency")


def perturbations(given, period):
    """Return for each direction how the problem changes by e units of it, and a unit of its size."""
    model, face = given.structure, given.interface
    changes = [
        (friction(), lambda e: given.vary(friction_coefficient=0.88 + e), 0.88),
        (friction(WEIGHTS), lambda e: given.vary(friction_coefficient=0.88 + e * WEIGHTS), 0.88),
        (normal_load(), lambda e: given.vary(normal_load=60.0 + e), 60.0),
        (gap(WEIGHTS), lambda e: replace(given, interface=replace(face, gap=face.gap + e * WEIGHTS)), 1e-5),
        (flexibility(np.diag(SPRINGS)), lambda e: replace(
            given, structure=with_flexibility(model.flexibility + e * np.diag(SPRINGS), model)), 50.0),
        (flexibility(model.flexibility), lambda e: replace(
            given, structure=with_flexibility((1.0 + e) * model.flexibility, model)), 3.0),
        (excitation(), lambda e: given.vary(amplitude=given.excitation.amplitude + e),
         given.excitation.amplitude),
        (frequency(given, period), lambda e: given.vary(frequency=100.0 + e), 100.0)]
    for part, slightness in PARTS.items():  # how much more of it is needed for a like change
        size = getattr(RIG, part) * slightness
        changes.append((rig_part(part), lambda e, part=part: replace(
            given, structure=replace(model, rig=replace(RIG, **{part: getattr(RIG, part) + e}))), size))
    return changes


def change_of(exact, name):
    """Return the sensitivity of one of these quantities."""
    return exact.outputs[name] if name in OUTPUTS else getattr(exact, name)


def quantities(given, period):
    """Return what a period is differentiated for, from the period alone."""
    response, areas = respond(period, given.interface), given.interface.areas
    return {
        "seen": analysis_matrix(HARMONICS, SAMPLES) @ period.rig_displacement[:, 1],
        **{name: period.outputs[name] for name in OUTPUTS},
        "relative_displacement": period.displacement[:, :, 0] @ areas / areas.sum(),
        "friction_force": period.friction_force, "sliding_distance": response.sliding_distance,
        "dissipated_energy": response.dissipated_energy, "pressure_sliding": response.pressure_sliding,
        "slip_path": response.slip_path, "mean_pressure": response.mean_pressure,
        "mean_opening": response.mean_opening}


def test_the_cases_are_what_they_are_called():
    state = {case: solution(*case).state for case in (GROSS, PARTIAL, OPENING)}
    assert np.all(state[GROSS] != ContactState.STICK, axis=1).any()
    assert 0 < np.all(state[PARTIAL] == ContactState.STICK, axis=0).sum() < NODES
    assert np.any(state[PARTIAL] == ContactState.SLIP)
    opens = np.any(state[OPENING] == ContactState.SEPARATION, axis=0)
    assert np.any(opens & np.any(state[OPENING] != ContactState.SEPARATION, axis=0))


@pytest.mark.parametrize("case", [GROSS, PARTIAL, OPENING])
def test_every_direction_is_that_of_central_differences(case):
    given, period = problem(*case), solution(*case)
    changes, values = perturbations(given, period), quantities(given, period)
    exact = sensitivities(given, period, [direction for direction, _, _ in changes], HARMONICS)
    missed = {}
    for i, (direction, change, size) in enumerate(changes):
        h = 1e-5 * size
        plus, minus = (quantities(p, solve_again(p, period)) for p in (change(h), change(-h)))
        turned = np.abs(exact.seen[i]).max() / np.abs(values["seen"]).max()
        for name, value in values.items():
            difference, own = (plus[name] - minus[name]) / (2.0 * h), change_of(exact, name)[i]
            # a dashpot shifts the phase, on which means do not depend: their own change is what is left
            scale = max(np.abs(difference).max(), 1e-2 * turned * np.abs(value).max(), 1e-300)
            error = np.abs(own - difference).max() / scale
            if error > 1e-5:
                missed[direction.name, name] = error
    assert not missed


FORCES = ("friction_force",)
LENGTHS = ("seen", "block", "arm", "relative_displacement", "sliding_distance", "slip_path", "mean_opening")


def weighted(given, period, directions, weights):
    """Return the change of each quantity along a combination of directions, its value and its scale."""
    exact, values = sensitivities(given, period, directions, HARMONICS), quantities(given, period)
    return {name: (np.tensordot(weights, change_of(exact, name), 1), value, np.abs(value).max())
            for name, value in values.items()}


@pytest.mark.parametrize("case", [GROSS, PARTIAL, OPENING])
def test_homogeneous_in_forces_and_lengths(case):
    """Euler: scaling excitation, load, gap and what stuck positions remember scales forces and lengths alike."""
    given, period = problem(*case), solution(*case)
    directions = [excitation(), normal_load(), gap(given.interface.gap),
                  Direction(name="locked", locked=period.displacement[0, :, :2])]
    degree = dict.fromkeys((*FORCES, *LENGTHS, "upper", "lower", "mean_pressure"), 1.0)
    degree |= dict.fromkeys(("dissipated_energy", "pressure_sliding"), 2.0)
    for name, (change, value, scale) in weighted(given, period, directions,
                                                 [given.excitation.amplitude, given.normal_load, 1.0, 1.0]).items():
        assert change == pytest.approx(degree[name] * value, abs=1e-8 * scale), name


def rig_directions():
    return [rig_part(part) for part in PARTS], [getattr(RIG, part) for part in PARTS]


@pytest.mark.parametrize("case", [GROSS, PARTIAL, OPENING])
def test_homogeneous_in_forces_and_stiffnesses(case):
    """Scaling all forces, springs, dashpots, masses and the contact's stiffness leaves every motion as it is."""
    given, period = problem(*case), solution(*case)
    rig, sizes = rig_directions()
    directions = [*rig, excitation(), normal_load(), flexibility(given.structure.flexibility)]
    weights = [*sizes, given.excitation.amplitude, given.normal_load, -1.0]
    for name, (change, value, scale) in weighted(given, period, directions, weights).items():
        if name not in ("upper", "lower"):  # their compliance is not scaled
            expected = 0.0 if name in LENGTHS else 1.0
            assert change == pytest.approx(expected * value, abs=1e-8 * scale), name


@pytest.mark.parametrize("case", [GROSS, PARTIAL, OPENING])
def test_stretching_time_changes_nothing(case):
    """A contact without rate: frequency times its derivative is that of masses twice and of dashpots once."""
    given, period = problem(*case), solution(*case)
    rig, sizes = rig_directions()
    powers = np.array([2.0 if "mass" in part else 1.0 if "damping" in part else 0.0 for part in PARTS])
    weights = [given.frequency, *(-powers * sizes)]
    faster = frequency(given, period)
    single = sensitivities(given, period, [faster], HARMONICS)
    for name, (change, _, _) in weighted(given, period, [faster, *rig], weights).items():
        assert np.abs(change).max() < 1e-9 * given.frequency * np.abs(change_of(single, name)).max() + 1e-30, name


def test_a_joint_that_sticks_is_the_linear_joint():
    """With X = (Z + k)^-1 F, each derivative is -(Z + k)^-1 dZ X, in closed form."""
    given, period = problem(30.0, False, 50.0), solution(30.0, False, 50.0)
    assert np.all(period.state == ContactState.STICK)
    stiffness = given.structure.motion[:, 0] @ given.structure.stiffness @ given.structure.motion[:, 0]
    omega = 2.0 * np.pi * 100.0
    linear = RIG.impedance(np.array([omega]))[0] + np.diag([0.0, stiffness])
    motion = np.linalg.solve(linear, [30.0, 0.0])
    changes = [(rig_part("moving_mass"), -omega**2 * np.diag([1.0, 0.0])),
               (rig_part("arm_mass"), -omega**2 * np.diag([0.0, 1.0])),
               (rig_part("ground_stiffness"), np.diag([1.0, 0.0])),
               (rig_part("hinge_stiffness"), np.array([[1.0, -1.0], [-1.0, 1.0]])),
               (rig_part("hinge_damping"), 1j * omega * np.array([[1.0, -1.0], [-1.0, 1.0]])),
               (frequency(given, period), 2.0 * np.pi * (1j * RIG.damping - 2.0 * omega * RIG.mass)),
               (flexibility(given.structure.flexibility), -stiffness * np.diag([0.0, 1.0]))]
    exact = sensitivities(given, period, [direction for direction, _ in changes], HARMONICS)
    for i, (_, change) in enumerate(changes):
        moved = np.column_stack([exact.outputs[name][i] for name in ("block", "arm")])
        amplitudes = to_complex(analysis_matrix(HARMONICS, SAMPLES) @ moved)
        assert amplitudes[1] == pytest.approx(-np.linalg.solve(linear, change @ motion), rel=1e-9, abs=1e-30)
        assert np.abs(exact.slip_path[i]).max() == 0.0
        assert np.abs(exact.dissipated_energy[i]) == 0.0


@pytest.mark.parametrize("case", [GROSS, PARTIAL])
def test_a_spring_or_dashpot_as_a_force_is_the_spring_or_dashpot(case):
    given, period = problem(*case), solution(*case)
    block = period.rig_displacement[:, 0]
    amplitudes = np.fft.rfft(block)
    speed = np.fft.irfft(1j * given.omega * np.arange(len(amplitudes)) * amplitudes, SAMPLES)
    histories = [np.column_stack([-h, np.zeros(SAMPLES)]) for h in (block, speed)]
    pushed = sensitivities(given, period, [rig_force(h, "added") for h in histories], HARMONICS)
    ground = [rig_part(part) for part in ("ground_stiffness", "ground_damping")]
    built = sensitivities(given, period, ground, HARMONICS)
    for name in ("block", "arm", "friction_force", "pressure_sliding"):
        one, other = change_of(pushed, name), change_of(built, name)
        scale = np.abs(other).max(axis=1, keepdims=True)
        assert one / scale == pytest.approx(other / scale, abs=1e-9)


def test_friction_matters_only_where_and_when_a_node_slips():
    given, period = problem(*OPENING), solution(*OPENING)
    slips = period.state == ContactState.SLIP
    exact = sensitivities(given, period, [friction(), friction(1.0 * slips), friction(1.0 * ~slips)], HARMONICS)
    for name in ("seen", "relative_displacement", "dissipated_energy", "mean_pressure"):
        rows = getattr(exact, name)
        scale = np.abs(rows[0]).max()
        assert rows[1] == pytest.approx(rows[0], rel=1e-9, abs=1e-12 * scale)
        assert np.abs(rows[2]).max() < 1e-12 * scale


def test_combinations_are_directions():
    given, period = problem(*OPENING), solution(*OPENING)
    exact = sensitivities(given, period, [gap(WEIGHTS), *map(gap, np.eye(NODES))], HARMONICS)
    for name in ("arm", "mean_pressure", "sliding_distance", "pressure_sliding"):
        rows = change_of(exact, name)
        summed = np.tensordot(WEIGHTS, rows[1:], 1)
        assert summed == pytest.approx(rows[0], rel=1e-9, abs=1e-10 * np.abs(rows[0]).max())


def test_what_cannot_be_differentiated_is_refused():
    given, period = problem(*GROSS), solution(*GROSS)
    with pytest.raises(InputError, match="harmonics"):
        sensitivities(given, period, [friction()], HARMONICS - 2)
    with pytest.raises(InputError, match="dlft"):
        sensitivities(given, replace(period, method="dlft"), [friction()], HARMONICS)
    with pytest.raises(InputError, match="direction gap: gap has shape"):
        sensitivities(given, period, [gap(np.ones(NODES + 1))], HARMONICS)
