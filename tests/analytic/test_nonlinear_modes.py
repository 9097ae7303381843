"""Property: frequency and damping of a mode over its amplitude are Iwan's closed form, right in limits, and balance."""

from __future__ import annotations

import numpy as np
import pytest
from fretflow.contact.coulomb import CoulombLaw
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.quasi_static import Loading, quasi_static_backbone
from fretflow.structure.reduction.contact_modes import reduce_structure

TOTAL, LONGEST, MASS, GROUND = 4e4, 1e-4, 2.0, 3e4  # N/m of all sliders, m at which the last slips, kg, N/m


def joint_of(structure, friction=0.4, bolt_load=8e3, **more):
    """Return a structure's joint under Coulomb friction."""
    return BoltedJoint(structure=reduce_structure(structure), bolt_load=bolt_load,
                       law=CoulombLaw(friction_coefficient=np.array(friction)), **more)


@pytest.fixture
def iwan(structures):
    """Return a function that makes 200 sliders whose slip displacements have the density ``phi^chi`` (Iwan)."""
    def make(chi):
        edges = np.linspace(0.0, 1.0, 201)
        stiffness = TOTAL * np.diff(edges**(chi + 1.0))
        slips = LONGEST * (chi + 1.0) / (chi + 2.0) * np.diff(edges**(chi + 2.0)) / np.diff(edges**(chi + 1.0))
        return joint_of(structures.sliders(stiffness, stiffness * slips, MASS, GROUND), 1.0, 1.0)

    return make


@pytest.mark.parametrize("chi", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("loading", Loading)
def test_iwans_power_law_of_dissipation_and_stiffness(iwan, chi, loading):
    joint = iwan(chi)
    mode = joint.linear_modes(1)[0]
    assert mode.frequency == pytest.approx(np.sqrt((TOTAL + GROUND) / MASS) / (2.0 * np.pi), rel=1e-9)
    asked = np.geomspace(0.15, 0.5, 9) * LONGEST * np.sqrt(MASS)
    found = quasi_static_backbone(joint, mode, asked, loading)
    x = found.amplitude / np.sqrt(MASS)
    # density R phi^chi of slider stiffness, T = int R phi^chi: D = 4 R x^(chi + 3) / ((chi + 2) (chi + 3))
    r = TOTAL * (chi + 1.0) / LONGEST**(chi + 1.0)
    assert found.dissipated == pytest.approx(4.0 * r * x**(chi + 3.0) / ((chi + 2.0) * (chi + 3.0)), rel=0.01)
    stiffness = GROUND + TOTAL - r * x**(chi + 1.0) * (1.0 / (chi + 1.0) - 1.0 / (chi + 2.0))
    assert found.frequency == pytest.approx(np.sqrt(stiffness / MASS) / (2.0 * np.pi), rel=2e-4)
    assert found.friction_damping == pytest.approx(found.dissipated / (2.0 * np.pi * stiffness * x**2), rel=2e-3)
    slope = np.polyfit(np.log(x), np.log(found.dissipated), 1)[0]
    assert slope == pytest.approx(3.0 + chi, abs=0.02)
    assert np.abs(found.outputs[:, 0]) == pytest.approx(x, rel=1e-9)


def test_small_amplitudes_are_the_linear_mode_and_large_ones_slide(iwan):
    joint = iwan(0.0)
    mode = joint.linear_modes(1)[0]
    small = quasi_static_backbone(joint, mode, np.array([1e-4 * LONGEST]))
    assert small.frequency[0] == pytest.approx(mode.frequency, rel=1e-4)
    assert small.friction_damping[0] < 1e-4
    large = quasi_static_backbone(joint, mode, np.array([200.0 * LONGEST * np.sqrt(MASS)]), Loading.CYCLES, 200)
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
    history = joint.follow(joint.bolts + level[:, None] * shape, joint.preloaded.slid[0], joint.preloaded.state[0])
    middle = 0.5 * (history.force[1:] + history.force[:-1])
    step = np.diff(history.displacement, axis=0)
    # forces outside, contact forces, and the strain energy: three ways to one balance, exact for trapezia
    outside = np.sum(0.5 * (level[1:] + level[:-1]) * (step @ shape) + step @ joint.bolts)
    strain = np.array([0.5 * u @ own.stiffness @ u for u in history.displacement])
    contact = np.sum(middle * step)
    assert outside + contact == pytest.approx(strain[-1] - strain[0], rel=1e-8)
    assert contact < 0.0


def test_whole_cycles_follow_faces_that_open_where_masings_rule_does_not(structures):
    joint = joint_of(structures.lap_beam())
    mode = joint.linear_modes(1)[0]
    asked = np.geomspace(1e-6, 1e-4, 7)
    coarse, fine, masing = (quasi_static_backbone(joint, mode, asked, *how) for how in (
        (Loading.CYCLES,), (Loading.CYCLES, 60), (Loading.MASING,)))
    assert fine.open.max() > 0
    assert coarse.frequency == pytest.approx(fine.frequency, rel=1e-4)
    assert coarse.friction_damping == pytest.approx(fine.friction_damping, rel=0.02)
    assert np.max(masing.friction_damping / fine.friction_damping) > 1.3


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
