"""Property: frequency and damping of a mode over its amplitude are Iwan's closed form, right in limits, and balance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.kernels.static import SLIP
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.periodic_mode import MasslessJoint, follow_mode, periodic_mode
from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone
from fretflow.solvers.nonlinear_modes.ring_down import instantaneous_mode, ring_down
from fretflow.structure.matrices import StructureMatrices
from fretflow.structure.reduction.contact_modes import reduce_structure
from scipy.special import gamma

TOTAL, LONGEST, MASS, GROUND = 4e4, 1e-4, 2.0, 3e4  # N/m of all sliders, m at which the last slips, kg, N/m
FIRM = 1e6  # N/m, a spring beside which sliders damp lightly


def joint_of(structure, friction=0.4, bolt_load=8e3, **more):
    """Return a structure's joint under Coulomb friction."""
    return BoltedJoint(structure=reduce_structure(structure), bolt_load=bolt_load,
                       law=Coulomb(friction_coefficient=np.array(friction)), **more)


@pytest.fixture
def iwan(structures):
    """Return a function that makes 200 sliders whose slip displacements have the density ``phi^chi`` (Iwan)."""
    def make(chi):
        edges = np.linspace(0.0, 1.0, 201)
        stiffness = TOTAL * np.diff(edges**(chi + 1.0))
        slips = LONGEST * (chi + 1.0) / (chi + 2.0) * np.diff(edges**(chi + 2.0)) / np.diff(edges**(chi + 1.0))
        return joint_of(structures.sliders(stiffness, stiffness * slips, MASS, GROUND), 1.0, 1.0)

    return make


def three_points(seed):
    """Return three contact points on bodies that couple all of their motions, tightened with friction."""
    rng = np.random.default_rng(seed)
    root, pull = rng.standard_normal((10, 10)), np.zeros(10)
    pull[3::3] = -rng.uniform(0.5, 1.5, 3)
    return joint_of(StructureMatrices(
        mass=np.diag(np.r_[2.0, np.full(9, 1e-3)]), stiffness=1e4 * root @ root.T + 3e4 * np.eye(10),
        contact_map=np.eye(9, 10, 1), areas=np.full(3, 1e-6), points=1e-3 * np.eye(3), preload=pull,
        outputs={"head": np.eye(1, 10)[0]}), 0.5, 5.0)


def test_a_body_that_bends_alike_both_ways_has_a_periodic_motion():
    """Its two modes have one frequency, at which what nothing pulls was divided by zero."""
    link, hold = np.diag([2e6, 2e6, 4e6]), np.diag([1e6, 1e6, 2e6])
    round_bar = StructureMatrices(
        mass=np.diag([1.0] * 3 + [0.2] * 3), stiffness=np.block([[link + hold, -link], [-link, link]]),
        contact_map=np.eye(3, 6, 3), areas=np.array([1e-4]), points=np.zeros((1, 3)), preload=-np.eye(6)[5],
        outputs={"tip": np.eye(6)[0]})
    joint = joint_of(round_bar, 0.5, 100.0)
    sticks, slides = follow_mode(joint, joint.linear_modes(1)[0], np.array([1e-5, 4e-5]))
    assert sticks.frequency == pytest.approx(np.sqrt(3e6) / (2.0 * np.pi), rel=1e-9)  # 3e6 N/m on 1 kg
    assert (sticks.damping, sticks.dissipated) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert slides.frequency < sticks.frequency
    assert slides.damping > 0.05


@pytest.mark.parametrize("seed", [3, 4])
def test_small_amplitudes_follow_the_preload_and_not_the_largest(seed):
    """What larger amplitudes leave in the faces, smaller ones that came before do not know."""
    joint = three_points(seed)
    mode = joint.linear_modes(1)[0]
    asked = np.geomspace(1e-5, 1e-4, 6)
    every = quasi_static_backbone(joint, mode, asked)
    for k, one in enumerate(asked):
        alone = quasi_static_backbone(joint, mode, np.array([one]))
        assert every.frequency[k] == pytest.approx(alone.frequency[0], rel=2e-3)
        assert every.damping[k] == pytest.approx(alone.damping[0], rel=0.05, abs=1e-4)


@pytest.mark.parametrize("seed", [3, 4])
def test_the_largest_amplitude_is_that_of_a_cycle_that_repeats(seed):
    """What three points on bodies that couple all of their motions hold from being tightened goes with a cycle."""
    joint = three_points(seed)
    mode = joint.linear_modes(1)[0]
    backbone = quasi_static_backbone(joint, mode, np.array([1e-4]))
    repeated = quasi_static_backbone(joint, mode, np.full(5, 1e-4))
    assert backbone.sliding[0] == 3
    assert backbone.frequency[0] == pytest.approx(repeated.frequency[-1], rel=1e-3)
    assert backbone.damping[0] == pytest.approx(repeated.damping[-1], rel=0.02)


@pytest.mark.parametrize("chi", [-0.5, 0.0, 0.5])
def test_iwans_power_law_of_dissipation_and_stiffness(iwan, chi):
    joint = iwan(chi)
    mode = joint.linear_modes(1)[0]
    assert mode.frequency == pytest.approx(np.sqrt((TOTAL + GROUND) / MASS) / (2.0 * np.pi), rel=1e-9)
    asked = np.geomspace(0.15, 0.5, 9) * LONGEST * np.sqrt(MASS)
    backbone = quasi_static_backbone(joint, mode, asked)
    x = backbone.amplitude / np.sqrt(MASS)
    # density R phi^chi of slider stiffness, T = int R phi^chi: D = 4 R x^(chi + 3) / ((chi + 2) (chi + 3))
    r = TOTAL * (chi + 1.0) / LONGEST**(chi + 1.0)
    assert backbone.dissipated == pytest.approx(4.0 * r * x**(chi + 3.0) / ((chi + 2.0) * (chi + 3.0)), rel=0.01)
    # of the loop that Masing's rule makes of x^p the first harmonic is that of (1 + cos)^p: Wallis' integrals
    p = chi + 2.0
    wallis = 4.0 / np.sqrt(np.pi) * gamma(p + 0.5) / gamma(p + 1.0) * p / (p + 1.0)
    stiffness = GROUND + TOTAL - wallis * r * x**(chi + 1.0) * (1.0 / (chi + 1.0) - 1.0 / (chi + 2.0))
    assert backbone.frequency == pytest.approx(np.sqrt(stiffness / MASS) / (2.0 * np.pi), rel=2e-4)
    assert backbone.friction_damping == pytest.approx(backbone.dissipated / (2.0 * np.pi * stiffness * x**2), rel=2e-3)
    slope = np.polyfit(np.log(x), np.log(backbone.dissipated), 1)[0]
    assert slope == pytest.approx(3.0 + chi, abs=0.02)
    assert np.abs(backbone.outputs[:, 0]) == pytest.approx(x, rel=1e-9)


def test_small_amplitudes_are_the_linear_mode_and_large_ones_slide(iwan):
    joint = iwan(0.0)
    mode = joint.linear_modes(1)[0]
    small = quasi_static_backbone(joint, mode, np.array([1e-4 * LONGEST]))
    assert small.frequency[0] == pytest.approx(mode.frequency, rel=1e-4)
    assert small.friction_damping[0] < 1e-4
    large = quasi_static_backbone(joint, mode, np.array([200.0 * LONGEST * np.sqrt(MASS)]), steps=200)
    assert large.frequency[0] == pytest.approx(np.sqrt(GROUND / MASS) / (2.0 * np.pi), rel=0.02)
    assert large.sliding[0] == 200
    x, limit = large.amplitude[0] / np.sqrt(MASS), float(joint.preloaded.force[0, 2::3].sum())
    assert large.dissipated[0] == pytest.approx(4.0 * limit * (x - LONGEST / 3.0 * 2.0), rel=0.01)


def test_work_of_a_cycle_is_what_friction_dissipates(structures):
    joint = joint_of(structures.lap_beam())
    mode = joint.linear_modes(1)[0]
    level = 40.0 * np.concatenate([np.linspace(0, 1, 41), np.linspace(1, -1, 81), np.linspace(-1, 1, 81)])
    own = joint.structure
    shape = own.boundary_mass @ mode.contact + own.coupling.T @ mode.modes
    history = joint.follow(joint.bolts + level[:, None] * shape, joint.preloaded)
    middle = 0.5 * (history.force[1:] + history.force[:-1])
    step = np.diff(history.displacement, axis=0)
    # forces outside, contact forces, and the strain energy: three ways to one balance, exact for trapezia
    outside = np.sum(0.5 * (level[1:] + level[:-1]) * (step @ shape) + step @ joint.bolts)
    strain = np.array([0.5 * u @ own.stiffness @ u for u in history.displacement])
    contact = np.sum(middle * step)
    assert outside + contact == pytest.approx(strain[-1] - strain[0], rel=1e-8)
    assert contact < 0.0


def test_cycles_of_faces_that_open_converge_with_the_steps(structures):
    joint = joint_of(structures.lap_beam())
    mode = joint.linear_modes(1)[0]
    asked = np.geomspace(1e-6, 1e-4, 7)
    coarse, fine = quasi_static_backbone(joint, mode, asked), quasi_static_backbone(joint, mode, asked, steps=60)
    assert fine.open.max() > 0
    assert coarse.frequency == pytest.approx(fine.frequency, rel=5e-4)
    assert coarse.friction_damping == pytest.approx(fine.friction_damping, rel=0.02)


def test_springs_in_series_soften_the_joint_and_rigid_ones_do_nothing(structures):
    beam = structures.lap_beam()
    rigid, stiff, soft = (joint_of(beam, springs=springs) for springs in (
        None, np.full(75, 1e-20), np.full(75, 1e-7)))
    first = [joint.linear_modes(1)[0].frequency for joint in (rigid, stiff, soft)]
    assert first[1] == pytest.approx(first[0], rel=1e-9)
    assert first[2] < 0.999 * first[0]
    mode = soft.linear_modes(1)[0]
    small = quasi_static_backbone(soft, mode, np.array([1e-9]))
    assert small.frequency[0] == pytest.approx(mode.frequency, rel=1e-4)


def test_amplitude_zero_missing_preload_and_gross_motion_are_told(structures):
    beam = structures.lap_beam()
    joint = joint_of(beam)
    mode = joint.linear_modes(1)[0]
    with pytest.raises(InputError, match="amplitudes: must be positive"):
        quasi_static_backbone(joint, mode, np.array([0.0]))
    with pytest.raises(NonConvergenceError, match="slides or opens as a whole"):
        quasi_static_backbone(joint, mode, np.array([1.0]))
    from dataclasses import replace
    with pytest.raises(InputError, match="preload: is required"):
        joint_of(replace(beam, preload=None))
    with pytest.raises(InputError, match="no path through the joint"):
        joint_of(replace(beam, preload=-beam.preload)).linear_modes(1)


def sprung(beam):
    """Return the beam's joint with asperities soft enough that many points share what slides."""
    return joint_of(beam, springs=np.full(3 * beam.contacts, 2e-9 * beam.contacts / 25.0))


def test_a_periodic_motion_agrees_with_static_loads_in_its_shape(structures):
    joint = sprung(structures.lap_beam(61))
    mode = joint.linear_modes(1)[0]
    static = quasi_static_backbone(joint, mode, np.geomspace(1.5e-5, 8e-5, 6))
    periodic = follow_mode(joint, mode, static.amplitude)
    assert np.array([one.frequency for one in periodic]) == pytest.approx(static.frequency, rel=1e-3)
    assert np.array([one.damping for one in periodic]) == pytest.approx(static.damping, rel=0.05)
    assert np.array([one.outputs[0] for one in periodic]) == pytest.approx(np.abs(static.outputs[:, 0]), rel=5e-3)
    for one in periodic:  # energy: what damping gives back in a period is what friction takes
        given = 2.0 * np.pi * one.damping * (2.0 * np.pi * one.frequency * one.amplitude)**2
        assert one.dissipated == pytest.approx(given, rel=1e-2)


def pushed(joint, size):
    """Return loads of the joint that swing in the shape of its first mode."""
    mode = joint.linear_modes(1)[0]
    return joint.bolts + size * np.sin(np.linspace(0.0, 7.0, 40))[:, None] * (
        joint.structure.boundary_mass @ mode.contact + joint.structure.coupling.T @ mode.modes)


def test_points_that_keep_their_state_are_condensed_until_they_move(structures):
    """A hump lets the ends of the lap gape, and large loads close them: as if nothing had been condensed."""
    hump = np.linspace(-1.0, 1.0, 25)**2
    joint = joint_of(structures.lap_beam(), gap=2e-6 * hump)
    assert 0 < np.sum(~joint.closed) < 25
    for size in (1.0, 400.0):
        loads = pushed(joint, size)
        history = joint.follow(loads, joint.preloaded)
        busy = len(next(iter(joint._contacts.values())).dofs) // 3
        assert 0 < busy < (12 if size == 1.0 else 25)  # small loads move few points, large ones not all
        whole = joint._follow_busy(loads, joint.preloaded, np.full(25, SLIP, dtype=np.int8), None)
        assert history.force == pytest.approx(whole.force, abs=1e-6 * np.abs(whole.force).max())
        assert history.slid == pytest.approx(whole.slid, abs=1e-6 * np.abs(whole.slid).max())
        assert np.all(history.slid[:, 2::3] >= -joint.clearance - 1e-12)


def test_no_guess_of_the_states_changes_what_friction_allows(structures):
    """Balance of forces, no penetration, Coulomb's cone and no work by friction, whatever states were guessed."""
    joint = joint_of(structures.lap_beam())
    loads = pushed(joint, 100.0)
    plain = joint.follow(loads, joint.preloaded)
    anything = np.random.default_rng(3).integers(0, 3, plain.state.shape).astype(np.int8)
    for guess in (plain.state, anything, np.zeros_like(plain.state), plain.state[:7]):
        history = joint.follow(loads, joint.preloaded, guess)
        small = 1e-9 * np.abs(joint.bolts).max()
        assert np.abs(history.slid @ joint.structure.stiffness - loads - history.force).max() < small
        force = history.force.reshape(len(loads), -1, 3)
        assert force[..., 2].min() > -small
        assert np.max(np.hypot(force[..., 0], force[..., 1]) - 0.4 * force[..., 2]) < small
        assert np.all(history.slid[:, 2::3] > -1e-15)
        moved = np.diff(history.slid, axis=0).reshape(len(loads) - 1, -1, 3)
        closed = force[1:, :, 2] > small
        work = np.sum(force[1:, :, :2] * moved[..., :2], axis=2)[closed]
        assert work.max() < small * np.abs(moved).max()
        assert work.min() < -1e3 * small * np.abs(moved).max()
        assert history.force == pytest.approx(plain.force, abs=1e-6 * np.abs(plain.force).max())


def test_a_small_periodic_motion_is_the_linear_mode(structures):
    joint = sprung(structures.lap_beam(25))
    for mode in joint.linear_modes(2):
        motion = periodic_mode(joint, mode, 1e-8)
        assert motion.frequency == pytest.approx(mode.frequency, rel=1e-3)  # the boundary's mass is left out
        assert abs(motion.damping) < 1e-9


def test_energy_of_a_period_balances_to_round_off(structures):
    joint = sprung(structures.lap_beam(25))
    mode = joint.linear_modes(1)[0]
    motion = periodic_mode(joint, mode, 4e-5, tolerance=1e-10, harmonics=9)
    massless = MasslessJoint.of(joint, motion.modes.shape[1])
    # the work of y on the contact over a period against that of contact forces, by the same trapezia
    y, u = (np.vstack([values, values[:1]]) for values in (motion.modes, motion.history.displacement))
    pull = massless.pulled(motion.history)
    pull = np.vstack([pull, pull[:1]])
    force = np.vstack([motion.history.force, motion.history.force[:1]])
    middle = [0.5 * (values[1:] + values[:-1]) for values in (y, pull, force)]
    work = np.sum(massless.eigenvalues * middle[0] * np.diff(pull, axis=0))
    dissipated = -np.sum(middle[2] * np.diff(u, axis=0))
    assert work == pytest.approx(dissipated, rel=1e-8, abs=1e-8 * abs(dissipated))


def test_a_decay_in_time_has_the_modes_frequency_and_damping(structures):
    joint = sprung(structures.lap_beam(61))
    mode = joint.linear_modes(1)[0]
    decay = ring_down(joint, mode, 9e-5, 120, modes=3)
    seen = instantaneous_mode(decay.time, decay.outputs[:, 0], mode.frequency)
    curve = quasi_static_backbone(joint, mode, np.geomspace(1e-5, 9e-5, 60), steps=60)
    order = np.argsort(np.abs(curve.outputs[:, 0]))
    inside = (seen.amplitude > 3e-5) & (seen.amplitude < 1.1e-4)
    assert inside.sum() > 5
    frequency, damping = (np.interp(seen.amplitude[inside], np.abs(curve.outputs[order, 0]), values[order])
                          for values in (curve.frequency, curve.damping))
    assert seen.frequency[inside] == pytest.approx(frequency, rel=5e-3)
    assert np.mean(seen.damping[inside] / damping) == pytest.approx(1.0, abs=0.03)


def test_backbone_of_sliders_is_that_of_a_decay_by_another_integrator(structures):
    rng = np.random.default_rng(5)
    stiffness, limits = rng.uniform(500.0, 1500.0, 40), rng.uniform(0.005, 0.1, 40)
    joint = joint_of(structures.sliders(stiffness, limits, MASS, FIRM), 1.0, 1.0)
    mode = joint.linear_modes(1)[0]
    step = 1.0 / (400.0 * mode.frequency)
    decay = structures.newmark(MASS, FIRM, stiffness, limits, 8e-5, step, 400 * 100)
    seen = instantaneous_mode(step * np.arange(len(decay)), decay, mode.frequency)
    curve = quasi_static_backbone(joint, mode, np.geomspace(1e-5, 9e-5, 60) * np.sqrt(MASS), steps=60)
    inside = (seen.amplitude > 3.5e-5) & (seen.amplitude < 7e-5)
    order = np.argsort(curve.amplitude)
    frequency, damping = (np.interp(seen.amplitude[inside] * np.sqrt(MASS), curve.amplitude[order], values[order])
                          for values in (curve.frequency, curve.damping))
    assert inside.sum() > 4
    assert seen.frequency[inside] == pytest.approx(frequency, rel=0.01)
    assert seen.damping[inside] == pytest.approx(damping, rel=0.05)
    assert np.mean(seen.damping[inside] / damping) == pytest.approx(1.0, abs=0.01)


def test_a_decay_of_strong_sliders_is_read_as_their_loss_over_the_stiffness(structures):
    """A closed form: of W. D. Iwan's sliders, a fifth of the stiffness, each takes ``4 f (a - f / k)`` a cycle."""
    ground, stiffness, limits = 1e6, np.full(40, 5e3), np.linspace(0.02, 1.0, 40) * 5e-4
    natural = np.sqrt((ground + stiffness.sum()) / MASS) / (2.0 * np.pi)
    step = 1.0 / (200.0 * natural)
    decay = structures.newmark(MASS, ground, stiffness, limits, 1.5e-7, step, 200 * 90)
    seen = instantaneous_mode(step * np.arange(len(decay)), decay, natural)
    inside = (seen.amplitude > 1.5e-8) & (seen.amplitude < 9e-8)
    at = seen.amplitude[inside][:, None]
    free = np.minimum(limits / stiffness, at)
    turn = np.arccos(1.0 - 2.0 * free / at)
    whole = ground + np.sum(stiffness / np.pi * (turn - 0.5 * np.sin(2.0 * turn)), axis=1)
    loss = np.sum(4.0 * limits * (at - free), axis=1) / (2.0 * np.pi * whole * at[:, 0]**2)
    assert inside.sum() > 4
    assert np.mean(seen.damping[inside] / loss) == pytest.approx(1.0, abs=0.01)


def test_a_decay_is_read_at_its_start_and_its_end():
    """A closed form: a linear decay, of 0.5 % damping, under which another mode rings."""
    time = np.arange(0.0, 1.2, 1e-4)
    signal = np.exp(-0.005 * 2.0 * np.pi * 80.0 * time) * np.cos(2.0 * np.pi * 80.0 * np.sqrt(1.0 - 0.005**2) * time)
    seen = instantaneous_mode(time, signal + 0.05 * np.exp(-3.0 * time) * np.sin(2.0 * np.pi * 290.0 * time), 79.0)
    assert seen.frequency == pytest.approx(80.0, rel=2e-4)
    assert seen.damping == pytest.approx(0.005, rel=0.03)

def test_what_moved_before_changes_nothing_but_round_off(structures):
    structure, curves = reduce_structure(structures.lap_beam(25)), []
    for before in ([], [3e-4], [2e-5, 1e-6]):
        joint = BoltedJoint(structure=structure, law=Coulomb(0.45), bolt_load=6e3)
        mode = joint.linear_modes(1)[0]
        for amplitude in before:
            quasi_static_backbone(joint, mode, np.array([amplitude]))
        curves.append(quasi_static_backbone(joint, mode, np.geomspace(2e-6, 1.5e-4, 8)))
    for other in curves[1:]:
        assert np.array_equal(other.states, curves[0].states)
        assert np.allclose(other.frequency, curves[0].frequency, rtol=1e-11)
        assert np.allclose(other.friction_damping, curves[0].friction_damping, rtol=0.0, atol=1e-11)


def test_damping_that_the_matrices_tell_is_the_joint_s(structures):
    """It was left out without a word, where it was not told again."""
    told = replace(structures.sliders(np.array([4e4]), np.array([50.0]), MASS, GROUND), modal_damping=0.02)
    for joint, ratio in ((joint_of(told), 0.02), (joint_of(told, modal_damping=0.01), 0.01)):
        curve = quasi_static_backbone(joint, joint.linear_modes(1)[0], np.array([1e-9]))
        assert curve.damping == pytest.approx(ratio, rel=1e-9)
