"""The lumped rig: its eigenvalues are the two sliding modes it was identified from."""

import numpy as np
import pytest
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig, RigModes
from scipy.linalg import eigh


@pytest.mark.parametrize(("moving", "arm"), [(10.0, 0.5), (12.0, 0.4), (3.0, 1.0)])
def test_identified_springs_give_the_modes(moving, arm):
    rig = LumpedRig.from_modes(moving, arm, 40.0, 2500.0, 0.01)
    frequencies = np.sqrt(eigh(rig.stiffness, rig.mass, eigvals_only=True)) / (2 * np.pi)
    assert frequencies == pytest.approx([40.0, 2500.0], rel=3e-4)


def test_modal_damping_of_the_in_phase_mode_is_the_ratio_asked_for():
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    lam, phi = eigh(rig.stiffness, rig.mass)
    ratio = np.diag(phi.T @ rig.damping @ phi) / (2 * np.sqrt(lam))
    assert ratio[0] == pytest.approx(0.01, rel=1e-3)
    # the hinge dashpot goes with the arm's mass, so its ratio is larger by sqrt(1 + m_a / m_b)
    assert ratio[1] == pytest.approx(0.01 * np.sqrt(1.05), rel=5e-3)


def test_the_hinge_may_have_a_ratio_of_its_own():
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01, 0.03)
    lam, phi = eigh(rig.stiffness, rig.mass)
    ratio = np.diag(phi.T @ rig.damping @ phi) / (2 * np.sqrt(lam))
    assert ratio == pytest.approx([0.01, 0.03 * np.sqrt(1.05)], rel=5e-3)


def test_impedance_is_that_of_harmonic_motion():
    """Accelerations and velocities differenced in time give the force that the impedance gives."""
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    omega, amplitude, h = 2 * np.pi * 100.0, np.array([1.0 + 0.5j, -0.3 + 0.2j]), 1e-6

    def motion(t):
        return (amplitude * np.exp(1j * omega * t)).real

    force = (rig.mass @ (motion(h) - 2 * motion(0.0) + motion(-h)) / h**2
             + rig.damping @ (motion(h) - motion(-h)) / (2 * h) + rig.stiffness @ motion(0.0))
    assert (rig.impedance(np.array([omega]))[0] @ amplitude).real == pytest.approx(force, rel=1e-5)


def test_modes_of_the_rig_with_faces_apart_are_those_it_is_made_of():
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    joint = QuasiStaticJoint.from_stiffness(np.eye(3) * 1e7, rig)
    modes = RigModes.of(joint.massless_boundary())
    assert modes.apart_frequency == pytest.approx([40.0, 2500.0], rel=3e-3)
    assert modes.apart_shape[0] == pytest.approx([1.0, 1.0], abs=1e-3)  # in phase
    assert modes.apart_shape[1] == pytest.approx([-0.5 / 10.0, 1.0], abs=1e-3)  # about the centre of mass


def test_stuck_faces_are_a_spring_on_the_arm_and_rigid_ones_hold_it():
    """The product of both squares is det K / det M; behind an unyielding contact the block swings alone."""
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    ground, hinge = rig.ground_stiffness, rig.hinge_stiffness
    for contact in (3e7, 1e14):
        boundary = QuasiStaticJoint.from_stiffness(np.eye(3) * contact, rig).massless_boundary()
        modes = RigModes.of(boundary)
        squares = (2.0 * np.pi * modes.stuck_frequency) ** 2
        expected = ((ground + hinge) * (hinge + contact) - hinge**2) / (rig.moving_mass * rig.arm_mass)
        assert squares.prod() == pytest.approx(expected, rel=1e-6)
    assert squares[0] == pytest.approx((ground + hinge) / rig.moving_mass, rel=1e-5)
    assert abs(modes.stuck_shape[0, 1]) < 1e-5
