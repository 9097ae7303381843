"""Faces that are alike on both sides of a plane are solved on one of them.

What carries the weight: the same period solved on all nodes, worn and with friction from place to place; work and
stiffness of symmetric motions; and that nothing is halved which differs across the plane.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.dlft.solver import DlftSolver
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.quasi_static.symmetry import OneSide
from fretflow.structure.mirror import MirrorPlane
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
SIDE, NODES = 7, 49
GRID = 1e-3 * np.stack(np.meshgrid(*2 * [np.linspace(-0.5, 0.5, SIDE)], indexing="ij"), axis=-1).reshape(-1, 2)
IMAGE = np.arange(NODES).reshape(SIDE, SIDE)[:, ::-1].ravel()
SIGNS = np.array([1.0, -1.0, 1.0])
ACROSS, MUCH = 1e-6 * GRID[:, 1] / 0.5e-3, 75.0


def mirrored(matrix):
    dofs, signs = (3 * IMAGE[:, None] + np.arange(3)).ravel(), np.tile(SIGNS, NODES)
    return signs[:, None] * matrix[np.ix_(dofs, dofs)] * signs


def problem(force=MUCH, gap=0.0, friction=0.88, lopsided=0.0):
    """Return a rig on a grid of 7 x 7 nodes, as stiff on both sides but for what is lopsided."""
    order = np.lexsort(np.round(DATA["x"][:, 1::-1].T, 6))
    dofs = (3 * order[:, None] + np.arange(3)).ravel()
    stiffness = 1e3 * DATA["K"][np.ix_(dofs, dofs)]
    stiffness = 0.5 * (stiffness + mirrored(stiffness))
    stiffness += lopsided * np.diag(np.diag(stiffness) * np.repeat(GRID[:, 1] > 0.0, 3))
    bare = QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T), RIG)
    joint = QuasiStaticJoint(stiffness=bare.stiffness, flexibility=bare.flexibility, motion=bare.motion, rig=RIG,
                             upper_compliance=0.3 * bare.flexibility[9:12], lower_compliance=bare.flexibility[-3:])
    areas = np.full(NODES, 1e-6 / NODES) * (1.0 + (GRID[:, 0] + 0.5e-3) / 1e-3)
    return rig_problem(joint=joint, interface=Interface(GRID, areas, np.broadcast_to(gap, NODES).copy()),
                       friction_coefficient=friction, frequency=100.0, excitation=force, normal_load=60.0)


def solve(given, start=None, whole=False):
    """Solve, on the `whole` of the nodes if so asked; return the nodes solved for as well."""
    sizes, near = [], QuasiStaticSolver._solve_near
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(QuasiStaticSolver, "_solve_near", lambda self, one, *rest: (
            sizes.append(one.interface.size), near(self, one, *rest))[1])
        if whole:
            patched.setattr(OneSide, "of", lambda *_: None)
        return QuasiStaticSolver(Solver(harmonics=15, samples=64, estimate_error=False)).solve(given, start), sizes


def same(one, other):
    assert np.array_equal(one.state, other.state)
    for name, unit in (("force", 1e-6), ("displacement", 1e-12), ("friction_force", 1e-5), ("internal", 1e-11)):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=0.0, abs=unit)
    for name in ("upper", "lower", "block"):
        assert one.output(name) == pytest.approx(other.output(name), rel=0.0, abs=1e-11)


@pytest.mark.parametrize("given", [
    problem(), problem(45.0), problem(gap=np.abs(ACROSS) + 0.3e-3 * GRID[:, 0]), problem(friction=0.8 + 1e6 * np.abs(
        ACROSS) * 0.2)], ids=["gross slip", "partial slip", "worn and tilted", "friction by place"])
def test_half_of_the_faces_moves_as_the_whole_does(given):
    half, sizes = solve(given)
    whole, all_sizes = solve(given, whole=True)
    assert (sizes, all_sizes) == ([28], [49])
    same(half, whole)
    assert half.force[:, IMAGE] == pytest.approx(SIGNS * half.force)
    again, sizes = solve(given.vary(amplitude=1.01 * given.excitation.amplitude), start=half)
    assert sizes == [28]
    same(again, solve(given.vary(amplitude=1.01 * given.excitation.amplitude), start=whole, whole=True)[0])


@pytest.mark.parametrize("given", [problem(gap=ACROSS), problem(friction=0.8 + 1e5 * ACROSS), problem(lopsided=1e-3)],
                         ids=["tilted across", "friction differs", "bodies differ"])
def test_what_differs_across_the_plane_is_not_halved(given):
    period, sizes = solve(given)
    assert sizes == [49]
    assert not np.allclose(period.force[:, IMAGE], SIGNS * period.force, rtol=1e-6)


@pytest.mark.parametrize(("given", "kept"), [
    (problem(), True), (problem(45.0, gap=np.abs(ACROSS) + 0.3e-3 * GRID[:, 0]), True),
    (problem(friction=0.8 + 1e6 * np.abs(ACROSS) * 0.2), True), (problem(gap=ACROSS), False)],
    ids=["gross slip", "worn and tilted", "friction by place", "tilted across"])
def test_dlft_solves_half_of_the_faces_where_they_are_alike(given, kept, monkeypatch):
    settings = Solver(method="dlft", harmonics=5, samples=64, penalty="1e7 N/m", tolerance=1e-10)
    solver = DlftSolver(settings)
    half = solver.solve(given)
    assert [one.plane is not None for one in solver._condensed.values()] == [kept]
    again = solver.solve(given.vary(amplitude=1.01 * given.excitation.amplitude), half)
    monkeypatch.setattr(MirrorPlane, "through", lambda *_: None)
    whole = DlftSolver(settings).solve(given)
    same(half, whole)
    assert half.error_estimate == pytest.approx(whole.error_estimate, rel=1e-5)
    same(again, DlftSolver(settings).solve(given.vary(amplitude=1.01 * given.excitation.amplitude), whole))


def test_a_start_that_differs_across_the_plane_is_kept_whole():
    lopsided, _ = solve(problem(gap=ACROSS))
    assert solve(problem(), start=lopsided)[1] == [49]


def test_symmetric_motions_take_as_much_work_on_half_the_nodes():
    """It is u K u = v K_h v and f G f = F G_h F of random symmetric motions and forces; G_h is the inverse of K_h."""
    given = problem()
    side = OneSide.of(given.boundary, given.interface)
    plane, half, random = side.plane, side.half(given).boundary, np.random.default_rng(2)
    moved = random.standard_normal((NODES, 3))
    moved = moved + SIGNS * moved[IMAGE]
    whole = given.boundary.stiffness
    kept = moved[plane.kept].ravel()
    assert kept @ half.stiffness @ kept == pytest.approx(moved.ravel() @ whole @ moved.ravel(), rel=1e-12)
    assert half.flexibility @ half.bare_stiffness == pytest.approx(np.eye(84), abs=1e-9)
    force = (whole @ moved.ravel()).reshape(NODES, 3)
    on_half = np.where(plane.kept == plane.images, 1.0, 2.0)[:, None] * force[plane.kept]
    assert on_half.ravel() @ half.flexibility @ on_half.ravel() == pytest.approx(
        force.ravel() @ moved.ravel(), rel=1e-12)
    assert side.half(given).interface.areas.sum() == pytest.approx(given.interface.areas.sum())


def test_nodes_that_lie_nowhere_or_in_a_line_have_no_plane():
    given = problem()
    numbers = replace(given.interface, nodes=np.zeros((NODES, 2)))
    assert OneSide.of(given.boundary, numbers) is None
    line = replace(given.interface, nodes=GRID * [1.0, 0.0] + np.arange(NODES)[:, None] * [1.0, 0.0])
    assert OneSide.of(given.boundary, line) is None
