"""Leaving out the nodes that never touch must not change the period, nor what is seen of it.

What carries the weight: the same period with every node solved for, and with too few of them taken at first.
"""

from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static import candidate_nodes as reach
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.quasi_static.symmetry import OneSide
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
PLACE = 1e-3 * (DATA["x"][:, :2] - DATA["x"][:, :2].mean(axis=0))
SETTINGS = Solver(harmonics=9, samples=64, estimate_error=False)


@pytest.fixture(autouse=True)
def _all_nodes(monkeypatch):
    """Solve for both sides of the faces, which are symmetric."""
    monkeypatch.setattr(OneSide, "of", lambda *_: None)


def problem(force=75.0):
    """Return a crown of 40 mm radius on the 1 mm square of 7 x 7 nodes; the observed points follow some nodes."""
    bare = QuasiStaticJoint.from_stiffness(1e3 * DATA["K"], RIG)
    joint = QuasiStaticJoint(stiffness=bare.stiffness, flexibility=bare.flexibility, motion=bare.motion, rig=RIG,
                             upper_compliance=0.3 * bare.flexibility[:3], lower_compliance=bare.flexibility[-3:])
    crown = Interface(nodes=PLACE, areas=np.full(49, 1e-6 / 49), gap=np.sum(PLACE**2, axis=1) / 0.08)
    return rig_problem(joint=joint, interface=crown, friction_coefficient=0.88, frequency=100.0,
                           excitation=force, normal_load=60.0)


def solve(monkeypatch, margin, first=None):
    """Solve with another margin, or with the nodes `first` at first; return the sizes of the contacts solved."""
    sizes = []

    def count(whole, nodes):
        sizes.append(int(nodes.sum()))
        return restrict(whole, nodes)

    restrict = reach.restrict
    with monkeypatch.context() as patched:
        patched.setattr(reach, "MARGIN", margin)
        patched.setattr("fretflow.solvers.quasi_static.solver.restrict", count)
        if first is not None:
            patched.setattr("fretflow.solvers.quasi_static.solver.candidate_nodes", lambda *_: first)
        return QuasiStaticSolver(SETTINGS).solve(problem()), sizes


def same(a, b):
    newton, metre = 1e-6, 1e-12
    for name in ("displacement", "rig_displacement", "upper_observation", "lower_observation"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=0.0, abs=metre)
    assert a.force == pytest.approx(b.force, rel=0.0, abs=newton)
    assert np.array_equal(a.state, b.state)


@pytest.fixture(scope="module")
def whole():
    with pytest.MonkeyPatch.context() as patch:
        period, sizes = solve(patch, np.inf)
    assert sizes == []  # every node was solved for
    return period


def test_nodes_out_of_reach_change_nothing(whole, monkeypatch):
    period, sizes = solve(monkeypatch, reach.MARGIN)
    touched = int(np.any(whole.state != ContactState.SEPARATION, axis=0).sum())
    assert touched <= sizes[0] < 25
    same(period, whole)


def test_nodes_that_touch_unforeseen_are_taken_in(whole, monkeypatch):
    middle = np.max(np.abs(PLACE), axis=1) < 2e-4
    period, sizes = solve(monkeypatch, reach.MARGIN, middle)
    assert sizes[0] == 9 < np.any(whole.state != ContactState.SEPARATION, axis=0).sum()
    same(period, whole)
