"""Joints of many nodes: patches of the faces, from which their solution starts, and factors kept from period to period.

What carries the weight: where nodes happen to move as one, patches are the joint itself; the period found with both is
that found without, audited, and its friction takes what the excitation puts in.
"""

from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.contact.kernels.sample import alike
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.audit import audit_period, energy_balance
from fretflow.solvers.quasi_static import march, patches
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.kept_factors import KeptFactors
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.patches import Patches
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.quasi_static.symmetry import OneSide
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
JOINT = QuasiStaticJoint.from_stiffness(1e3 * DATA["K"], RIG)
LOAD, NODES = 60.0, 49
SIDE = 4  # patches along a side of seven nodes


@pytest.fixture(autouse=True)
def _all_nodes(monkeypatch):
    """Solve for all nodes of the faces, which are symmetric."""
    monkeypatch.setattr(OneSide, "of", lambda *_: None)


def problem(force):
    interface = Interface(1e-3 * DATA["x"][:, :2], np.full(NODES, 1e-6 / NODES), np.zeros(NODES))
    return rig_problem(joint=JOINT, interface=interface, friction_coefficient=0.88, frequency=100.0,
                       excitation=force, normal_load=LOAD)


def solution(given):
    return QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(given)


def contact():
    given = problem(75.0)
    return given, ContactMarch.of(given, InternalEquations.of(given, 5, 32).seen)


def patched(monkeypatch):
    """Return the joint of 49 nodes, and that of its 16 patches."""
    monkeypatch.setattr(patches, "SIDE", SIDE)
    given, marching = contact()
    joint_patches = Patches.of(given.interface)
    return marching, joint_patches, joint_patches.joint(marching)


def test_nodes_that_move_as_one_are_a_patch(monkeypatch):
    """Work in any motion of the patches, forces of coordinates and loads, and the whole's stiffness are the joint's."""
    whole, of, few = patched(monkeypatch)
    assert few.system.size == SIDE**2
    random = np.random.default_rng(1)
    moved = random.standard_normal((few.system.size, 3))
    spread = moved[of.of_node].ravel()
    for name, one in (("stiffness", spread), ("pull", 1.0), ("coupling", 1.0)):
        fine, coarse = getattr(whole.system, name), getattr(few.system, name)
        assert moved.ravel() @ (coarse @ moved.ravel() if name == "stiffness" else coarse) == pytest.approx(
            spread @ (fine @ one if name == "stiffness" else fine), rel=1e-10)
    assert few.system.felt_stiffness == pytest.approx(whole.system.felt_stiffness, rel=1e-10)
    pressed, all_pressed = few.preloaded(), whole.preloaded()
    assert pressed.force.reshape(-1, 3)[:, 2].sum() == pytest.approx(LOAD)
    assert all_pressed.force[2::3].sum() == pytest.approx(LOAD)


def test_faces_whose_nodes_lie_nowhere_or_are_few_have_no_patches(monkeypatch):
    assert Patches.of(Interface(np.arange(400), np.ones(400), np.zeros(400))) is None  # numbers of nodes
    assert Patches.of(problem(75.0).interface) is None
    monkeypatch.setattr(patches, "SIDE", SIDE)
    assert Patches.of(problem(75.0).interface) is not None


@pytest.mark.parametrize("force", [75.0, 45.0])
def test_period_of_a_large_joint_is_that_of_the_small_one(monkeypatch, force):
    """The same joint solved as if its nodes were many."""
    given = problem(force)
    expected = solution(given)
    reused, chosen = [], KeptFactors.choose

    def choose(self, j, state):
        reused.append(j in self.of_sample and alike(self.of_sample[j].state, state))
        return chosen(self, j, state)

    monkeypatch.setattr(KeptFactors, "choose", choose)
    monkeypatch.setattr(march, "WORTH_KEEPING", 2)
    monkeypatch.setattr(patches, "SIDE", SIDE)
    period = solution(given)
    assert any(reused)
    audit_period(given, period, 1e-9)
    assert energy_balance(given, period).error < 1e-8
    assert np.abs(period.friction_force - expected.friction_force).max() < 1e-8 * np.ptp(expected.friction_force)
    assert np.abs(period.force - expected.force).max() < 1e-8 * np.abs(expected.force).max()


def test_a_neighbouring_period_needs_no_tangent_of_its_own(monkeypatch):
    """The patches go most of the way that the load does, with a tangent that serves in place of that of all nodes.

    Without them all of the change of the load is left at first.
    """
    given = problem(75.0)
    near, expected = solution(given.vary(amplitude=74.8)), solution(given)
    monkeypatch.setattr(patches, "SIDE", SIDE)
    columns, passed = [], ContactMarch._pass

    def recorded(self, position, forcing, *others):
        columns.append((self.system.size, forcing.directions.shape[2]))
        return passed(self, position, forcing, *others)

    monkeypatch.setattr(ContactMarch, "_pass", recorded)
    period = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(given, near)
    assert (SIDE**2, 51) in columns
    assert (NODES, 51) not in columns
    assert period.residual_history[0] < 0.1 * (1.0 - 74.8 / 75.0)
    assert np.abs(period.friction_force - expected.friction_force).max() < 1e-8 * np.ptp(expected.friction_force)
