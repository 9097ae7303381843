"""Rigs drawn anew: other integrators, specimens and laws against closed forms, balances and limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.recordings.recording import read_joint_recording
from fretflow_trial.campaign import Test
from fretflow_trial.case import LISTED, Case, Simulated, draw
from fretflow_trial.contact import Contact, UnsettledContactError
from fretflow_trial.hidden import CATALOGUE, Facts, Hidden
from fretflow_trial.joint import Joint, Specimen, half_space_compliance, half_spaces, meshed, rigid_modes, specimens
from fretflow_trial.period import March
from fretflow_trial.physics import Condition, Instant, Physics, Slow, Worn
from fretflow_trial.record import coloured, write
from fretflow_trial.rig import ARM, BLOCK, Rig, Scheme, step_of
from fretflow_trial.signal import slopes
from fretflow_trial.world import FINEST, SLIDING, WORLDS, YIELDING
from numpy.random import SeedSequence
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCHEMES = (Scheme(), Scheme("implicit"), Scheme("implicit", 0.6), Scheme("explicit"))


def unworn(joint: Joint) -> Slow:
    none = np.zeros(joint.size)
    return Slow(0.0, 0.0, none, none, 0.0, 0.0)


def forced(rig: Rig, steps: int, scheme: Scheme, frequency: float = 100.0) -> Array:
    """Return the state (4,) at phase 0 of a rig without friction that a cosine of 1 N on the block drives."""
    step = step_of(rig, 1.0 / (steps * frequency), scheme)
    drive = np.cos(2.0 * np.pi * np.arange(steps + 1) / steps)
    reached = np.zeros(4)
    for k in range(steps):
        reached = step.free @ reached + step.early[:, BLOCK] * drive[k] + step.late[:, BLOCK] * drive[k + 1]
    return np.asarray(np.linalg.solve(np.eye(4) - np.linalg.matrix_power(step.free, steps), reached))


@pytest.mark.parametrize(("scheme", "order"), [(Scheme("implicit"), 2), (Scheme("implicit", 0.6), 1),
                                               (Scheme("explicit"), 2)])
def test_integrators_converge_to_the_frequency_response(scheme: Scheme, order: int) -> None:
    rig, omega = Rig(beside_stiffness=2e5, beside_damping=300.0), 200.0 * np.pi
    mass, damping, stiffness = rig.matrices()
    exact = np.linalg.solve(stiffness - omega**2 * mass + 1j * omega * damping, np.array([1.0, 0.0])).real
    error = [np.linalg.norm(forced(rig, steps, scheme)[:2] - exact) / np.linalg.norm(exact) for steps in (800, 1600)]
    assert error[0] < 5e-3
    assert error[0] / error[1] == pytest.approx(2.0**order, rel=0.1)


def test_half_spaces_yield_as_love_and_cerruti_have_it() -> None:
    """Middle of a square of side 2 a: 8 a ln(1 + sqrt 2) is the integral of 1 / r; far off, point forces."""
    specimen = Specimen(youngs_modulus=200e9, poissons_ratio=0.3, contact_width=1e-3)
    young, poisson, width = 200e9, 0.3, 1e-3
    _, sliding, normal = half_space_compliance(specimen, 1)
    integral = 4.0 * width * np.log(1.0 + np.sqrt(2.0)) / width**2
    assert normal[0, 0] == pytest.approx(2.0 * (1.0 - poisson**2) / (np.pi * young) * integral, rel=1e-12)
    assert sliding[0, 0] == pytest.approx(2.0 * (1.0 + poisson) * (1.0 - 0.5 * poisson) / (np.pi * young) * integral,
                                          rel=1e-12)
    nodes, sliding, normal = half_space_compliance(specimen, 9)
    first, beside, ahead = 0, 8, 72  # of a corner: the far ends of both edges
    far = nodes[ahead, 0] - nodes[first, 0]
    assert nodes[beside, 1] - nodes[first, 1] == pytest.approx(far)
    assert sliding[first, ahead] == pytest.approx(2.0 * (1.0 + poisson) / (np.pi * young * far), rel=2e-3)
    assert sliding[first, beside] == pytest.approx(2.0 * (1.0 - poisson**2) / (np.pi * young * far), rel=2e-3)
    assert normal[first, beside] == pytest.approx(2.0 * (1.0 - poisson**2) / (np.pi * young * far), rel=2e-3)


def stiffness_as_rigid(joint: Joint) -> Array:
    modes = rigid_modes(joint.nodes)
    return np.asarray(modes.T @ np.linalg.solve(np.block([[joint.sliding, joint.cross],
                                                          [joint.cross.T, joint.normal]]), modes))


def test_other_meshes_and_half_spaces_are_the_same_specimens() -> None:
    """As rigid faces a mesh of its own is as stiff as the stored one, and half-spaces on its body are so exactly."""
    other = meshed(Specimen(), [0.12], [0.2], [0.12, 0.4])
    assert not np.allclose(other.nodes, specimens().nodes)
    assert other.areas.sum() == pytest.approx(1e-6, rel=1e-12)
    scale = np.diag(1.0 / np.array([1.0, 1.0, 1e3, 1e3]))  # a tilt is per metre
    stored, own = (scale @ stiffness_as_rigid(one) @ scale for one in (specimens(), other))
    assert own == pytest.approx(stored, abs=0.01 * stored[0, 0])
    halves = half_spaces(other, 6)
    whole = stiffness_as_rigid(halves)
    assert whole == pytest.approx(stiffness_as_rigid(other), rel=1e-9, abs=1e-9 * np.abs(whole).max())
    for joint in (other, halves):
        assert np.linalg.eigvalsh(np.block([[joint.sliding, joint.cross], [joint.cross.T, joint.normal]])).min() > 0.0


def test_a_softer_and_narrower_contact_scales_as_it_should() -> None:
    """All lengths by 1.2 and Young's modulus by 1/2: compliance scales with 1 / (E L), the mass with L cubed."""
    one, big = Specimen(), Specimen(0.5 * 193e9, 0.29, 1.2e-3, 1.2e-3, 7.2e-3, 6e-3)
    small, large = (meshed(specimen, [0.1], [0.2], [0.12, 0.4]) for specimen in (one, big))
    assert large.sliding == pytest.approx(small.sliding * 2.0 / 1.2, rel=1e-9, abs=1e-12 * small.sliding.max())
    assert large.half == pytest.approx(1.2 * small.half)
    assert big.mass == pytest.approx(1.2**3 * one.mass)


def test_one_node_is_a_jenkins_element() -> None:
    """Spring and slider in series: a loop of 4 S (X - S / k), its flanks k steep, for X beyond S / k."""
    stiffness, limit, amplitude, area = 2e7, 40.0, 9e-6, 1e-6
    body, none = np.array([[0.5 / stiffness]]), np.zeros((1, 1))
    joint = Joint(np.zeros((1, 2)), np.array([area]), body, body, none)
    contact = Contact(joint, np.array([2.0 * stiffness]), np.array([1e20]), 0.0)
    phase = np.linspace(0.0, 4.0 * np.pi, 4001)
    place, force, slip, state = amplitude * np.sin(phase), np.zeros(len(phase)), np.zeros(1), np.zeros(1)
    for k, x in enumerate(place):
        friction, moved, state = contact.friction(np.array([limit]), np.array([x]) - slip, state)
        force[k], slip = friction[0], slip + moved
    last = slice(2000, 4001)
    work = float(0.5 * (force[last][1:] + force[last][:-1]) @ np.diff(place[last]))
    assert work == pytest.approx(4.0 * limit * (amplitude - limit / stiffness), rel=2e-3)
    flank = slice(2501, 2600)  # after the turn at the largest displacement
    assert np.polyfit(place[flank], force[flank], 1)[0] == pytest.approx(stiffness, rel=1e-6)
    assert np.abs(force).max() == pytest.approx(limit)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_energy_is_accounted_for_by_every_integrator_and_half_spaces(scheme: Scheme) -> None:
    joint = half_spaces(specimens(), 5)
    physics = Physics(rig=Rig(8.0, 0.4, 35.0, 2000.0, 0.02), friction=0.7, rigid=2e15)
    march = March(joint, physics, Condition(66.0, 50.0, 110.0), unworn(joint), np.full(joint.size, 50e6), None, 600,
                  scheme)
    track = march.settle(tolerance=1e-6).track
    channels = march.channels(track, every=1)
    assert channels.displacement.max() - channels.displacement.min() > SLIDING
    dissipated = float(march.worn(track).power @ joint.areas) / 110.0
    assert dissipated == pytest.approx(4.0 * 0.7 * 50.0 * 0.5 * np.ptp(channels.displacement), rel=5e-3, abs=0.0)
    velocity = track.rig[:, 2:]
    supplied = np.mean(track.excitation * velocity[:, BLOCK]) / 110.0
    damped = np.mean(np.einsum("ki,ij,kj->k", velocity, physics.rig.matrices()[1], velocity)) / 110.0
    assert supplied == pytest.approx(dissipated + damped, rel=5e-3, abs=0.0)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_stuck_joint_rests_at_its_static_limit(scheme: Scheme) -> None:
    """A constant force on the block: ground spring beside hinge and stuck contact in series, by every integrator."""
    joint, rig = half_spaces(specimens(), 5), Rig(8.0, 0.4, 35.0, 2000.0, 0.02)
    contact = Contact(joint, 2e15 * joint.areas, 2e15 * joint.areas, 0.0)
    held, _, _ = contact.friction(np.full(joint.size, 1e6), np.full(joint.size, 1e-6), np.zeros(joint.size))
    stuck = 1e6 * float(held.sum())
    step = step_of(replace(rig, beside_stiffness=stuck), 1e-5, scheme)
    rest = np.linalg.solve(np.eye(4) - step.free, (step.early + step.late) @ np.array([20.0, 0.0]))
    series = 1.0 / (1.0 / rig.hinge + 1.0 / stuck)
    assert rest[BLOCK] == pytest.approx(20.0 / (rig.ground + series), rel=1e-6)
    assert rest[ARM] == pytest.approx(rest[BLOCK] * series / stuck, rel=1e-6)
    assert np.abs(rest[2:]).max() < 1e-9


def test_coloured_noise_has_its_variance_and_correlation() -> None:
    noise = coloured(np.random.default_rng(1), 200_000, 0.7)
    assert noise.std() == pytest.approx(1.0, rel=0.02)
    for lag in (1, 3):
        assert np.mean(noise[lag:] * noise[:-lag]) == pytest.approx(0.7**lag, abs=0.02)


def instant(joint: Joint, speed: float = 0.0, pressure: float = 60e6) -> Instant:
    return Instant(0.0, speed, 0.0, np.full(joint.size, pressure), np.ones(joint.size))


def forms(name: str) -> list[Hidden]:
    """Return the catalogue's law and every other form of an effect that twenty draws give."""
    facts, rng = Facts(100_000, 60.0, 60.0, Rig().hinge), np.random.default_rng(7)
    by_law = {one.law: one for one in (LISTED[name](rng, other, facts) for other in (False, *(20 * [True])))}
    return list(by_law.values())


def test_every_form_of_a_law_has_the_limits_of_its_physics() -> None:
    joint, start, end = specimens(), unworn(specimens()), replace(unworn(specimens()), cycles=1e12, energy=1e9,
                                                                   elapsed=1.0)
    worn = Worn(np.ones(49), np.ones(49), np.ones(49), 100.0)
    for one in forms("friction-run-in"):
        (friction,) = one.apply(Physics()).friction_over_test
        assert [friction(start), friction(end)] == pytest.approx([one.parameters["initial"], one.parameters["final"]])
    for one in forms("velocity-dependent-friction"):
        (factor,) = one.apply(Physics()).friction_at_instant
        assert factor(instant(joint)) == pytest.approx(1.0 + one.parameters["strength"])
        assert factor(instant(joint, 100.0 * one.parameters["speed_scale"])) == pytest.approx(1.0, abs=1e-3)
    for one in forms("load-dependent-friction"):
        (factor,) = one.apply(Physics()).friction_at_instant
        low, middle, high = (np.mean(factor(instant(joint, pressure=60e6 * share))) for share in (0.999, 1.0, 1.001))
        assert middle == pytest.approx(1.0)
        assert (high - low) / 0.002 == pytest.approx(-one.parameters["exponent"], rel=1e-3)
    for one in forms("wear-coefficient-evolution"):
        (wear,) = one.apply(Physics()).wear_factors
        assert wear(worn, start) == pytest.approx(np.ones(49))
        assert wear(worn, end) == pytest.approx(np.full(49, one.parameters["final_share"]), rel=1e-5)
    for one in forms("normal-load-drift"):
        (load,) = one.apply(Physics()).load_over_test
        assert load(start) == pytest.approx(1.0)
        assert load(end) < 1.0
    for one in forms("distributed-micro-slip"):
        factors = one.apply(Physics()).friction_of_node
        assert factors is not None
        assert factors @ joint.share == pytest.approx(1.0)


def test_law_forms_are_many_and_the_catalogues_is_none_of_them() -> None:
    names = {name: [one.law for one in forms(name)] for name in LISTED}
    assert all(laws.count(CATALOGUE) == 1 for laws in names.values())
    alone = {name for name, laws in names.items() if len(laws) == 1}
    assert alone == {"force-offset", "sensor-inertia", "extra-mode", "wear-power-law"}
    assert len(names["friction-run-in"]) == 5
    assert len(names["velocity-dependent-friction"]) == 5


@pytest.fixture(scope="module")
def anew() -> list[Case]:
    """Return twelve cases of the fourth world, in which nothing is hidden."""
    return [draw("nothing", (), SeedSequence(seed), 4) for seed in range(12)]


def test_no_two_rigs_drawn_anew_are_alike(anew: list[Case]) -> None:
    for names in ({one.plan.main for one in anew}, {one.stated for one in anew}, {one.physics.rigid for one in anew},
                  {one.noise.depth for one in anew}, {one.physics.rig for one in anew}):
        assert len(names) == 12
    assert len({one.joint.size for one in anew}) > 3
    assert len({one.plan.scheme.method for one in anew}) == 3
    assert len({one.channels for one in anew}) > 1


def test_what_is_drawn_is_within_what_nobody_calls_an_effect(anew: list[Case]) -> None:
    """Asperities beside the bodies, the modulus, the explicit step, samples that fit the steps, cycles in order."""
    for one in anew:
        elastic = np.linalg.inv(one.joint.sliding).sum()
        yielding = np.linalg.inv(one.joint.sliding + np.diag(1.0 / (one.physics.rigid * one.joint.areas))).sum()
        # under rigid faces the edges carry more, where springs yield more than under an even load
        assert elastic / yielding - 1.0 < 1.5 * YIELDING
        assert abs(one.joint.specimen.youngs_modulus / one.stated.youngs_modulus - 1.0) <= 0.02
        assert one.plan.steps % one.plan.samples == 0
        assert 200 <= one.plan.steps <= 1000
        assert one.plan.cycles == tuple(sorted(set(one.plan.cycles)))
        if one.plan.scheme.method == "explicit":
            march = March(one.joint, one.physics, one.plan.main, unworn(one.joint), np.ones(one.joint.size), None,
                          one.plan.steps)
            fastest = np.abs(np.angle(np.linalg.eigvals(march.step.free))).max()
            assert fastest < FINEST
    assert [world for world, one in WORLDS.items() if one.anew] == [3, 4]
    assert [world for world, one in WORLDS.items() if one.other_laws] == [2, 4]


def test_a_joint_that_sticks_is_not_recorded(anew: list[Case]) -> None:
    case = min(anew, key=lambda one: one.joint.size * one.plan.steps)
    held = replace(case.plan, main=replace(case.plan.main, amplitude=0.5 * case.plan.main.amplitude))
    with pytest.raises(UnsettledContactError, match="not to be recorded"):
        Test(case.joint, case.physics, held).run(case.recordable)


def test_a_rig_drawn_anew_is_recorded_with_its_own_drawing(anew: list[Case], tmp_path: Path) -> None:
    case = min(anew, key=lambda one: one.joint.size * one.plan.steps)
    case = replace(case, plan=replace(case.plan, cycles=(0, 1500), sweep=case.plan.sweep[:1]))
    outcome = Test(case.joint, case.physics, case.plan).run(case.recordable)
    rates = slopes(case.joint, case.physics, case.plan, outcome, case.seen)
    recording = read_joint_recording(write(Simulated(case, outcome, rates, {}), tmp_path / "recording", "Rig"))
    assert recording.loops is not None
    assert recording.specimen is not None
    assert recording.specimen.upper.contact_width == pytest.approx(case.stated.contact_width)
    assert recording.specimen.upper.youngs_modulus == pytest.approx(case.stated.youngs_modulus)
    assert recording.loops.repeats.tolist() == [case.repeats] * 2
    assert recording.loops.mean("displacement").shape[1] == case.plan.samples
    slid = np.ptp(recording.loops.mean("displacement"), axis=1)
    assert np.all(slid > 0.8 * SLIDING)
