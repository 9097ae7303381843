"""The contact's backbone under Masing's rule against the full contact and a closed form.

What carries the weight: where the whole contact slides the backbone must give the full solver's motion, though it
knows nothing of nodes; the tangent is that of central differences; one Jenkins element's loop has a closed form.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.fourier import synthesis_matrix
from fretflow.solvers.quasi_static.backbone import Backbone, BackboneSolver
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
MU, LOAD = 0.88, 60.0
JOINT = QuasiStaticJoint.from_stiffness(1e3 * DATA["K"], LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01))
NODES = len(DATA["x"])


def problem(force, frequency=100.0, mu=MU):
    interface = Interface(nodes=1e-3 * DATA["x"][:, :2], areas=np.full(NODES, 1e-6 / NODES), gap=np.zeros(NODES))
    return rig_problem(joint=JOINT, interface=interface, friction_coefficient=mu, frequency=frequency,
                           excitation=force, normal_load=LOAD)


@cache
def fast():
    return BackboneSolver.of(problem(53.0), 25, 128)


def test_the_backbone_has_the_stuck_stiffness_and_the_friction_limit():
    backbone = fast().backbone
    stuck = JOINT.motion[:, 0] @ JOINT.stiffness @ JOINT.motion[:, 0]
    assert backbone.limit.sum() == pytest.approx(MU * LOAD, rel=2e-4)
    assert backbone.stiffness.sum() == pytest.approx(stuck, rel=0.02)
    assert np.all(backbone.stiffness > 0.0)


@pytest.mark.parametrize(("force", "frequency"), [(53.0, 100.0), (60.0, 100.0), (75.0, 100.0), (75.0, 45.0)])
def test_a_sliding_contact_moves_as_the_full_one(force, frequency):
    given = problem(force, frequency)
    full = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(given)
    period = fast().solve(given)
    assert np.ptp(period.rig_displacement[:, 0]) == pytest.approx(np.ptp(full.rig_displacement[:, 0]), rel=0.01)
    assert np.ptp(period.rig_displacement[:, 1]) == pytest.approx(np.ptp(full.rig_displacement[:, 1]), rel=0.01)
    distance = period.friction_force - full.friction_force
    assert np.sqrt(np.mean(distance**2)) < 0.02 * np.ptp(full.friction_force)


def test_a_friction_that_depends_on_the_load_is_in_the_backbone():
    given = replace(problem(75.0), law=Coulomb(MU, exponent=0.2))
    full = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(given)
    solver = BackboneSolver.of(given, 25, 128)
    assert solver.backbone.limit.sum() == pytest.approx(np.abs(full.friction_force).max(), rel=0.01)
    assert solver.backbone.limit.sum() != pytest.approx(MU * LOAD, rel=0.03)
    moved = solver.solve(given).rig_displacement[:, 1]
    assert np.ptp(moved) == pytest.approx(np.ptp(full.rig_displacement[:, 1]), rel=0.01)


def test_one_element_makes_the_loop_of_jenkins():
    """Energy of a cycle of amplitude A: 4 s (A - s / k)."""
    stiffness, limit, amplitude = 2.0, 0.5, 1.2
    arm = amplitude * np.cos(2 * np.pi * np.arange(4096) / 4096)
    force, _ = Backbone(np.array([stiffness]), np.array([limit])).friction(arm, np.zeros((4096, 0)))
    steps = np.diff(arm, append=arm[:1])
    energy = -np.sum(0.5 * (force + np.roll(force, -1)) * steps)
    assert energy == pytest.approx(4 * limit * (amplitude - limit / stiffness), rel=1e-3)
    assert np.abs(force).max() == limit
    assert force[0] == -limit


def test_tangent_is_that_of_central_differences():
    synthesis = synthesis_matrix(5, 64)
    arm = np.zeros(11)
    arm[[1, 2, 5]] = 2e-6, 1e-7, 2e-7
    direction, h = np.random.default_rng(5).normal(size=11), 1e-13
    _, tangent = fast().backbone.friction(synthesis @ arm, synthesis)
    plus, minus = (fast().backbone.friction(synthesis @ (arm + s * h * direction), synthesis)[0] for s in (1, -1))
    expected = (plus - minus) / (2 * h)
    assert tangent @ direction == pytest.approx(expected, rel=1e-4, abs=1e-4 * np.abs(expected).max())


def test_a_stuck_contact_is_a_spring():
    period = fast().solve(problem(1.0))
    arm = period.rig_displacement[:, 1]
    assert -period.friction_force == pytest.approx(-fast().backbone.stiffness.sum() * arm, rel=0.02, abs=0.02)


def test_no_period_is_told_with_its_history():
    wild = BackboneSolver(Backbone(np.array([np.nan]), np.array([1.0])), 5, 32)
    with pytest.raises((NonConvergenceError, np.linalg.LinAlgError)):
        wild.solve(problem(53.0))
