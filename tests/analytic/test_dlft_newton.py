"""Newton with GMRES: against dense algebra, and its ways out when the first guess or the iterations fail.

What carries the weight: the dense Jacobian, formed column by column, gives the same steps; three routes
(from sliding, from rest, by raising the load) end in one root.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from fretflow.case.config import PeriodicMethod, Solver
from fretflow.contact.interface import Interface
from fretflow.core.errors import AuditError, InputError, NonConvergenceError
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers import newton
from fretflow.solvers.dlft import preconditioner
from fretflow.solvers.dlft import solver as dlft
from fretflow.solvers.dlft.equations import DlftEquations
from fretflow.solvers.newton import _line_search, gmres, solve_newton
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

NODES = 5


@pytest.fixture(scope="module")
def problem():
    """Return a row of nodes on an elastic foundation with neighbours coupled and one node apart by a gap."""
    chain = 2.0 * np.eye(NODES) - np.eye(NODES, k=1) - np.eye(NODES, k=-1)
    stiffness = np.kron(5e6 * np.eye(NODES) + 1e7 * chain, np.array([[1, 0, 0.1], [0, 1, 0], [0.1, 0, 1.3]]))
    joint = QuasiStaticJoint.from_stiffness(stiffness, LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01))
    gap = np.array([0.0, 0.0, 0.0, 1e-7, 1e-3])
    interface = Interface(nodes=np.zeros((NODES, 2)), areas=np.full(NODES, 2e-7), gap=gap)
    return rig_problem(joint=joint, interface=interface, friction_coefficient=0.88, frequency=100.0,
                           excitation=60.0, normal_load=60.0)


@pytest.fixture(scope="module")
def equations(problem):
    return dlft.build_equations(problem, dlft.Variant(3, 128, None))


def test_gmres_solves_as_a_dense_solver():
    rng = np.random.default_rng(0)
    matrix, right = np.eye(40) + 0.3 * rng.normal(size=(40, 40)), rng.normal(size=40)
    x, iterations = gmres(lambda v: matrix @ v, right, lambda v: v / np.diag(matrix), 1e-12)
    assert x == pytest.approx(np.linalg.solve(matrix, right), rel=1e-9, abs=1e-11)
    assert iterations <= 40


def test_gmres_with_the_exact_inverse_needs_one_step():
    matrix = np.diag([1.0, 10.0, 1e4])
    x, iterations = gmres(lambda v: matrix @ v, np.ones(3), lambda v: v / np.diag(matrix), 1e-12)
    assert iterations == 1
    assert x == pytest.approx([1.0, 0.1, 1e-4], rel=1e-12)


@pytest.mark.parametrize(("slope", "share"), [
    (-1.0, 1.0),  # the full step leads to the root
    (-2.2, 0.5),  # beyond it, farther than before
    (5.0, 0.25),  # up, whatever the step: the least bad one
])
def test_the_step_that_a_line_search_takes(slope, share):
    """The residual is one at the start and has `slope` along the step; it does not creep."""
    class Line(NamedTuple):
        residual: np.ndarray

    class Equations:
        def evaluate(self, u):
            return Line(1.0 + slope * u)

    step, _ = _line_search(Equations(), np.zeros(1), np.ones(1), 1.0)
    assert step == pytest.approx([share])


def test_all_routes_lead_to_one_root(equations):
    rest = np.zeros((7, 3 * NODES))
    roots = [solve_newton(equations, guess, equations.scale, 1e-11, 100).unknowns
             for guess in (rest, dlft.free_sliding(equations))]
    roots.append(dlft._raise_load(equations, 1e-11, 60).unknowns)
    assert np.ptp(roots[0][:, 0]) > 1e-6  # it slides
    for other in roots[1:]:
        assert np.abs(other - roots[0]).max() < 1e-8 * np.abs(roots[0]).max()


@pytest.mark.parametrize("start", ["rest", "sliding"])
def test_kept_factors_lead_to_the_same_root(equations, monkeypatch, start):
    """At rest nothing is factored that sliding needs, so that factors are made anew; from sliding on they serve."""
    made = []
    factored = preconditioner._factored
    monkeypatch.setattr(preconditioner, "_factored", lambda *given: made.append(1) or factored(*given))
    first = np.zeros((7, 3 * NODES)) if start == "rest" else dlft.free_sliding(equations)
    anew = solve_newton(equations, first, equations.scale, 1e-11, 100)
    assert len(made) == len(anew.history) - 1
    made.clear()
    monkeypatch.setattr(newton, "LARGE", 0)
    kept = solve_newton(equations, first, equations.scale, 1e-11, 100)
    assert 0 < len(made) < len(kept.history) - 1
    assert np.abs(kept.unknowns - anew.unknowns).max() < 1e-8 * np.abs(anew.unknowns).max()


def test_factors_that_serve_badly_are_made_anew():
    """A cubic of many unknowns whose inverse `before` is that of its first iterate, which soon is far from right."""
    given, target = [], np.linspace(1.0, 30.0, newton.LARGE)

    class At(NamedTuple):
        u: np.ndarray
        residual: np.ndarray

    class Cubic:
        def evaluate(self, u):
            return At(u, u**3 + u - target)

        def linearise(self, at, before=None):
            given.append(before)
            slope = 3.0 * at.u**2 + 1.0
            return lambda v: slope * v, before or (lambda v: v / slope)

    solution = solve_newton(Cubic(), np.zeros(newton.LARGE), float(np.linalg.norm(target)), 1e-12, 60)
    assert solution.unknowns**3 + solution.unknowns == pytest.approx(target, rel=1e-10)
    assert any(given)
    assert sum(one is None for one in given[1:]) > 0


def test_convergence_at_the_end_is_quadratic(equations):
    history = dlft.solve_equations(equations, None, 1e-11, 60).history
    assert history[-1] < 1e-11
    last = [(before, after) for before, after in pairwise(history) if before < 1e-2]
    assert all(after < max(10.0 * before**2, 0.3 * 1e-11) for before, after in last)  # the linear solver's limit
    assert len(last) >= 2


def test_a_node_with_a_large_gap_never_touches(problem):
    period = dlft.DlftSolver(Solver(method=PeriodicMethod.DLFT, estimate_error=False)).solve(problem)
    assert np.all(period.force[:, 4] == 0.0)
    assert period.force[:, :, 2].sum(axis=1).mean() == pytest.approx(60.0, rel=1e-8)
    assert (problem.interface.gap[:3] + period.displacement[:, :3, 2]).min() > -1e-9


def test_motion_of_the_rig_balances_the_forces_in_time(problem):
    """The rig's equations of motion, the contact's harmonics in them, hold at every harmonic that is kept."""
    period = dlft.DlftSolver(Solver(method=PeriodicMethod.DLFT, estimate_error=False)).solve(problem)
    amplitudes = np.fft.rfft(period.rig_displacement, axis=0)[:4] / 64
    friction = np.fft.rfft(period.friction_force)[:4] / 64
    for h in (1, 2, 3):
        load = np.array([60.0 if h == 1 else 0.0, -friction[h]])
        impedance = problem.structure.rig.impedance(np.array([h * problem.omega]))[0]
        assert impedance @ amplitudes[h] == pytest.approx(load, abs=1e-6)


def test_a_period_that_breaks_the_contact_law_is_refused(problem, monkeypatch):
    """By a nanometre of penetration at a single sample."""
    lawful = DlftEquations.contact_displacement

    def unlawful(equations, at):
        moved = np.array(lawful(equations, at))
        moved[17, 1, 2] -= 1e-9
        return moved

    monkeypatch.setattr(DlftEquations, "contact_displacement", unlawful)
    with pytest.raises(AuditError, match="penetration"):
        dlft.DlftSolver(Solver(method=PeriodicMethod.DLFT, estimate_error=False)).solve(problem)


def test_failure_carries_its_history(problem):
    settings = Solver(method=PeriodicMethod.DLFT, max_iterations=1)
    with pytest.raises(NonConvergenceError, match="of the excitation") as caught:
        dlft.DlftSolver(settings).solve(problem)
    assert len(caught.value.history) == 2


def test_samples_must_tell_the_harmonics_apart(problem):
    with pytest.raises(InputError, match="samples"):
        dlft.build_equations(problem, dlft.Variant(3, 6, None))
    with pytest.raises(InputError, match="penalty"):
        dlft.build_equations(problem, dlft.Variant(3, 128, -1.0))


def test_default_penalty_is_the_largest_eigenvalue(equations):
    assert equations.penalty == pytest.approx(np.linalg.eigvalsh(equations.stiffness.real_part(0))[-1], rel=1e-10)


@pytest.mark.parametrize(("most", "way"), [(2, "after 2 iterations.*raise max_iterations"),
                                           (100, "not fallen for 15 iterations; start from a neighbour")])
def test_a_system_without_a_root_says_what_may_help(most, way):
    """u^2 + 1 has none: more iterations are offered where they ran out, another start where they go in circles."""
    class At(NamedTuple):
        u: np.ndarray
        residual: np.ndarray

    class Above:
        def evaluate(self, u):
            return At(u, u**2 + 1.0)

        def linearise(self, at, before=None):
            return lambda v: 2.0 * at.u * v, lambda v: v / (2.0 * at.u)

    with pytest.raises(NonConvergenceError, match=way) as raised:
        solve_newton(Above(), np.array([0.7]), 1.0, 1e-12, most)
    assert min(raised.value.history) > 1.0 - 1e-12
