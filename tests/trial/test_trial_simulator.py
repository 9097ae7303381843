"""The trial's simulator against closed forms, balances and a time history of another integrator.

The weight is carried by the comparison with ``tests/data/periodic``: whatever contact, rig and integration share in
error would show there.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow_trial.campaign import Plan, Test
from fretflow_trial.contact import Contact
from fretflow_trial.elasticity import element_stiffness, grid, specimen_compliance
from fretflow_trial.hidden import Facts
from fretflow_trial.joint import Joint, node_areas, specimens
from fretflow_trial.listed_wear import scar_edge
from fretflow_trial.period import March
from fretflow_trial.physics import Channels, Condition, Physics, Slow
from fretflow_trial.rig import ARM, BLOCK, Rig, step_of
from numpy.typing import NDArray

Array = NDArray[np.float64]

PERIODIC = Path(__file__).parents[1] / "data" / "periodic"


def unworn(joint: Joint) -> Slow:
    none = np.zeros(joint.size)
    return Slow(0.0, 0.0, none, none, 0.0, 0.0)


def springs(stiffness: float, joint: Joint) -> Physics:
    each = np.full(joint.size, stiffness)
    return Physics(friction=0.88, springs=lambda slow, pressure: (each, each))


@pytest.fixture(scope="module")
def finite_elements() -> Joint:
    """Return the joint of the reference, from its stiffness."""
    with np.load(PERIODIC / "krel_49.npz") as stored:
        stiffness, place = 1e3 * stored["K"], 1e-3 * stored["x"]
    line = np.unique(np.round(place[:, 0], 9))
    weight = np.full(len(line), 1e-3 / (len(line) - 1))
    weight[[0, -1]] /= 2.0
    areas = np.prod([weight[np.argmin(np.abs(line[:, None] - place[:, k]), axis=0)] for k in (0, 1)], axis=0)
    flexible = np.linalg.inv(stiffness)
    return Joint(place[:, :2], areas, flexible[0::3, 0::3], flexible[2::3, 2::3], flexible[0::3, 2::3])


def test_rig_resonates_at_its_modes() -> None:
    rig, duration = Rig(), 1e-5
    values = np.linalg.eigvals(step_of(rig, duration).free)
    frequencies = np.unique(np.round(np.abs(np.log(values)) / (2.0 * np.pi * duration), 3))
    mass, _, stiffness = rig.matrices()
    exact = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real) / (2.0 * np.pi)
    assert frequencies == pytest.approx(np.sort(exact), rel=1e-4)
    assert frequencies == pytest.approx([40.0, 2500.0], rel=5e-4)


def test_rig_without_friction_follows_its_frequency_response() -> None:
    rig, steps, frequency = Rig(beside_stiffness=2e5, beside_damping=300.0), 400, 100.0
    step = step_of(rig, 1.0 / (steps * frequency))
    drive = np.cos(2.0 * np.pi * np.arange(steps + 1) / steps)
    powers = np.linalg.matrix_power(step.free, steps)
    forced = np.zeros(4)
    for k in range(steps):
        forced = step.free @ forced + step.early[:, BLOCK] * drive[k] + step.late[:, BLOCK] * drive[k + 1]
    start = np.linalg.solve(np.eye(4) - powers, forced)
    mass, damping, stiffness = rig.matrices()
    omega = 2.0 * np.pi * frequency
    response = np.linalg.solve(stiffness - omega**2 * mass + 1j * omega * damping, np.array([1.0, 0.0]))
    assert start[:2] == pytest.approx(response.real, rel=1e-4, abs=0.0)
    assert start[2:] == pytest.approx((1j * omega * response).real, rel=2e-3, abs=0.0)


@pytest.mark.parametrize("amplitude", [60, 75])
def test_period_is_that_of_another_integrator(finite_elements: Joint, amplitude: int) -> None:
    march = March(finite_elements, springs(2e15, finite_elements), Condition(float(amplitude)), unworn(finite_elements),
                  np.full(49, 60e6))
    channels = march.channels(march.settle().track)
    time, _, displacement, force = np.loadtxt(PERIODIC / f"asperity_{amplitude}N.csv", delimiter=",", skiprows=1).T
    expected = np.interp(channels.time, time, 1e-6 * displacement, period=0.01)
    assert np.ptp(channels.displacement) == pytest.approx(np.ptp(expected), rel=5e-3, abs=0.0)
    error = channels.displacement - channels.displacement.mean() - (expected - expected.mean())
    assert np.sqrt(np.mean(error**2)) < 5e-3 * np.ptp(expected)
    assert np.sqrt(np.mean((channels.friction_force - np.interp(channels.time, time, force, period=0.01))**2)) < 1.0


def test_specimens_are_as_stiff_as_finite_elements_make_them(finite_elements: Joint) -> None:
    stiffness = []
    for joint in (specimens(), finite_elements):
        both = np.block([[joint.sliding, joint.cross], [joint.cross.T, joint.normal]])
        one = np.repeat(np.eye(2), joint.size, axis=1)
        stiffness.append(np.diag(one @ np.linalg.solve(both, one.T)))
    # Finite elements come from above: 6 linear bricks a side here, with 10 they give 27.1 and 86.4 N/um.
    assert stiffness[0] == pytest.approx(stiffness[1], rel=0.07, abs=0.0)
    assert stiffness[0] == pytest.approx([27.1e6, 86.4e6], rel=0.04, abs=0.0)
    assert np.all(stiffness[0] < stiffness[1])


def test_areas_add_up_and_integrate_polynomials() -> None:
    joint = specimens()
    assert joint.areas.sum() == pytest.approx(1e-6, rel=1e-12, abs=0.0)
    assert joint.areas @ (2e3 * joint.nodes[:, 0])**4 == pytest.approx(1e-6 / 5.0, rel=1e-12, abs=0.0)
    assert node_areas(joint.nodes).min() > 0.0


def test_element_is_exact_for_uniform_strain_and_free_for_rigid_motion() -> None:
    size = np.array([1e-3, 2e-3, 0.5e-3])
    stiffness = element_stiffness(size, 1.0, 0.3)
    x = np.meshgrid(*(grid((0.0, 1e3 * length)).nodes for length in size), indexing="ij")
    place = np.stack([one.ravel() for one in x], axis=1)
    stretch = np.zeros_like(place)
    stretch[:, 0] = place[:, 0]
    energy = stretch.ravel() @ stiffness @ stretch.ravel()
    assert energy == pytest.approx(0.7 / (1.3 * 0.4) * size.prod(), rel=1e-12, abs=0.0)
    turn = np.stack([-place[:, 1], place[:, 0], 0.0 * place[:, 0]], axis=1)
    assert np.abs(stiffness @ turn.ravel()).max() < 1e-12 * np.abs(stiffness).max()


def test_column_is_as_compliant_as_a_bar() -> None:
    # A ridge that is all there is of the body: pressed evenly it is a bar on a clamped base.
    _, compliance = specimen_compliance(along=(-0.5, 0.0, 0.5), across=(-0.5, 0.0, 0.5), upwards=(0.0, 0.5, 2.0, 6.0),
                                        poisson=0.0)
    areas = node_areas(specimens().nodes) * 1e6
    mean = areas @ compliance[2::3, 2::3] @ areas
    assert mean == pytest.approx(6e-3 / 1e-6, rel=1e-6)


def test_gross_slip_dissipates_by_coulomb_and_all_energy_is_accounted_for() -> None:
    joint, physics = specimens(), Physics(friction=0.8)
    march = March(joint, physics, Condition(70.0, 55.0), unworn(joint), np.full(joint.size, 55e6))
    track = march.settle(tolerance=1e-6).track
    channels = march.channels(track, every=1)
    dissipated = float(march.worn(track).power @ joint.areas) / 100.0
    assert dissipated == pytest.approx(4.0 * 0.8 * 55.0 * 0.5 * np.ptp(channels.displacement), rel=3e-3, abs=0.0)
    velocity = track.rig[:, 2:]
    supplied = np.mean(track.excitation * velocity[:, BLOCK]) / 100.0
    _, damping, _ = physics.rig.matrices()
    damped = np.mean(np.einsum("ki,ij,kj->k", velocity, damping, velocity)) / 100.0
    assert supplied == pytest.approx(dissipated + damped, rel=2e-3, abs=0.0)
    assert dissipated > 0.9 * supplied


def test_partial_slip_is_the_difference_of_two_pressings() -> None:
    # Ciavarella (1998) and Jaeger (1998): with like elasticity in both directions and no coupling, the friction
    # force is mu times pressing under N less pressing under N - T / mu. Exact for the discrete problem too.
    one = specimens()
    joint = Joint(one.nodes, one.areas, 1.3 * one.normal, one.normal, np.zeros_like(one.normal))
    rigid = np.full(joint.size, 1e15)
    contact = Contact(joint, rigid, rigid, 0.0)
    crown = -1.5 * np.sum(joint.nodes**2, axis=1)
    everywhere = np.ones(joint.size, dtype=bool)
    load, friction = 60.0, 0.5
    pressing, approach, closed = contact.press(load, crown, everywhere)
    assert 5 < closed.sum() < joint.size
    less, shallower, inner = contact.press(35.0, crown, everywhere)
    drive = np.full(joint.size, 1.3 * friction * (approach - shallower))
    drive[~closed] = 0.0
    force, slip, sliding = contact.friction(friction * pressing, drive, np.ones(joint.size))
    assert force == pytest.approx(friction * (pressing - less), abs=1e-6 * load)
    assert force.sum() == pytest.approx(friction * 25.0, rel=1e-6)
    assert np.all((sliding == 0.0)[inner])
    assert np.all(slip[inner] == 0.0)


def test_stuck_contact_is_a_spring() -> None:
    joint = specimens()
    contact = Contact(joint, 1e20 * joint.areas, 1e20 * joint.areas, 0.0)
    force, slip, _ = contact.friction(np.full(joint.size, 1e6), np.full(joint.size, 1e-6), np.zeros(joint.size))
    assert force.sum() == pytest.approx(1e-6 * np.linalg.inv(joint.sliding).sum(), rel=1e-6)
    assert not slip.any()


def test_wear_is_archards_and_does_not_depend_on_the_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    joint, physics = specimens(), Physics(friction=0.85)
    plan = Plan(Condition(62.0), (0, 30_000), ())
    outcome = Test(joint, physics, plan).run()
    volume = float(outcome.depth @ joint.areas)
    assert volume == pytest.approx(physics.wear / physics.friction * outcome.energy, rel=5e-3, abs=0.0)
    monkeypatch.setattr("fretflow_trial.campaign.LARGEST_WEAR", 0.05e-6)
    monkeypatch.setattr("fretflow_trial.campaign.PASSING_STEPS", 400)
    fine = Test(joint, physics, plan).run()
    assert fine.jumps > 1.5 * outcome.jumps
    assert outcome.depth == pytest.approx(fine.depth, rel=0.02, abs=0.0)
    assert outcome.loops[-1].approach.mean() - outcome.loops[0].approach.mean() == pytest.approx(
        float(outcome.depth @ joint.share), rel=0.1, abs=0.0)


def test_half_the_step_changes_little() -> None:
    joint = specimens()
    strokes = []
    for steps in (200, 400):
        march = March(joint, replace(Physics(), friction=0.8), Condition(), unworn(joint), np.full(49, 60e6),
                      steps=steps)
        strokes.append(np.ptp(march.settle().track.rig[:, ARM]))
    assert strokes[0] == pytest.approx(strokes[1], rel=3e-3, abs=0.0)


@pytest.mark.parametrize("other", [False, True])
def test_the_force_sensor_takes_up_what_holds_the_arm_back_at_the_scar(other: bool) -> None:
    """Newton's third law between the specimens: what is measured beside friction is minus the force on the arm.

    The middle of the stroke is free, the force at the end is the peak of a deep scar, and it stays beyond.
    """
    hidden = scar_edge(np.random.default_rng(5), other, Facts(cycles=100_000, amplitude=60.0, load=60.0, hinge=1e8))
    physics, end = hidden.apply(Physics()), 8e-6
    slow = replace(unworn(specimens()), depth=np.full(specimens().size, 1e-3), scar=end)
    arm = end * np.array([-1.5, -1.0, -0.3, 0.0, 0.3, 1.0, 1.5])
    still = np.zeros(len(arm))
    channels = Channels(100.0, 1, still, still, still, still, still, still, arm, still, still)
    measured = physics.sensors[0](channels, slow).friction_force
    on_arm = np.array([physics.rig_forces[0](np.array([0.0, x, 0.0, 0.0]), slow)[ARM] for x in arm])
    np.testing.assert_allclose(measured, -on_arm, rtol=1e-12)
    peak = hidden.parameters["peak_force"]
    np.testing.assert_allclose(on_arm, peak * np.array([1.0, 1.0, 0.0, 0.0, 0.0, -1.0, -1.0]), rtol=1e-6)
