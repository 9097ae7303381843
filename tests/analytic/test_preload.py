"""The static preload on given flexibilities.

What carries the weight: the same quadratic programme solved by another method (an active-set least-squares solver
of SciPy), and the contact conditions and symmetry on the flexibility of a pair of crossed ridges.
"""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from fretflow.core.errors import InputError
from fretflow.structure.fem.preload import frictionless_preload

pytestmark = pytest.mark.fem

DATA = Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz"
LOAD = 60.0


@pytest.fixture(scope="module")
def pair():
    """Return normal flexibility (m/N), node positions (m) and nodal areas (m^2) of crossed ridges, 7 x 7 nodes."""
    with np.load(DATA) as data:
        flexibility = np.linalg.inv(data["K"] * 1e3)[2::3, 2::3]
        positions = data["x"][:, :2] * 1e-3
    weights = np.where(np.arange(7) % 6 == 0, 0.5, 1.0)
    return flexibility, positions, np.outer(weights, weights).ravel() * 1e-6 / 36


def by_least_squares(flexibility, initial_gap, load):
    """Return the forces that minimise the energy at forces not negative with the given sum, by SciPy's NNLS.

    For each approach d, forces solve ``min |L^T f + L^-1 (g0 - d)|`` with ``C = L L^T``; d is found by bisection.
    """
    lower = np.linalg.cholesky(flexibility)

    def forces(approach):
        target = -scipy.linalg.solve_triangular(lower, initial_gap - approach, lower=True)
        return scipy.optimize.nnls(lower.T, target, maxiter=10000)[0]

    top = float(initial_gap.max() + load * flexibility.max())
    approach = scipy.optimize.brentq(lambda d: forces(d).sum() - load, initial_gap.min(), top, xtol=1e-18)
    return forces(approach), approach


@pytest.mark.parametrize(("curvature", "tilt", "load"), [
    (0.0, 0.0, 60.0), (50.0, 0.0, 60.0), (200.0, 0.0, 5.0), (0.0, 2e-3, 60.0), (100.0, 1e-3, 200.0),
    (0.0, 1.0, 1e-3)])
def test_forces_are_those_of_another_method(pair, curvature, tilt, load):
    flexibility, positions, areas = pair
    gap = 0.5 * curvature * np.sum(positions**2, axis=1) + tilt * positions[:, 0]
    preload = frictionless_preload(flexibility, gap, areas, load)
    force, approach = by_least_squares(flexibility, gap, load)
    assert preload.force == pytest.approx(force, abs=1e-8 * load)
    assert preload.approach == pytest.approx(approach, rel=1e-9)


@pytest.mark.parametrize("curvature", [0.0, 20.0, 80.0])
def test_contact_conditions(pair, curvature):
    flexibility, positions, areas = pair
    gap = 0.5 * curvature * np.sum(positions**2, axis=1)
    preload = frictionless_preload(flexibility, gap, areas, LOAD)
    assert preload.force.sum() == pytest.approx(LOAD, rel=1e-10)
    assert preload.pressure @ areas == pytest.approx(LOAD, rel=1e-10)
    assert preload.force.min() >= 0.0
    assert preload.gap.min() >= 0.0
    assert np.all(preload.force * preload.gap == 0.0)
    opening = gap - preload.approach + flexibility @ preload.force
    assert preload.gap == pytest.approx(np.maximum(opening, 0.0), abs=1e-16)


def test_flat_ridges_are_pressed_as_a_punch_and_symmetric(pair):
    flexibility, _, areas = pair
    pressure = frictionless_preload(flexibility, np.zeros(49), areas, LOAD).pressure.reshape(7, 7)
    assert pressure == pytest.approx(pressure.T, rel=1e-6)
    assert pressure == pytest.approx(pressure[::-1], rel=1e-6)
    assert pressure.argmax() in (0, 6, 42, 48)
    edges = np.concatenate([pressure[0], pressure[-1], pressure[1:-1, 0], pressure[1:-1, -1]])
    assert edges.min() > pressure[1:-1, 1:-1].max()
    assert pressure[3, 3] == pytest.approx(pressure.min(), rel=1e-12)


def test_load_scales_a_flat_contact_linearly_and_a_curved_one_as_a_homogeneous_law(pair):
    """Gap and displacement doubled need doubled forces, so (g0, N) and (2 g0, 2 N) are similar."""
    flexibility, positions, areas = pair
    gap = 40.0 * np.sum(positions**2, axis=1)
    one = frictionless_preload(flexibility, gap, areas, 10.0)
    two = frictionless_preload(flexibility, 2 * gap, areas, 20.0)
    assert two.force == pytest.approx(2 * one.force, rel=1e-9, abs=1e-12)
    assert two.approach == pytest.approx(2 * one.approach, rel=1e-12)


def test_a_shifted_gap_shifts_the_approach_alone(pair):
    flexibility, positions, areas = pair
    gap = 40.0 * np.sum(positions**2, axis=1)
    near = frictionless_preload(flexibility, gap, areas, 10.0)
    far = frictionless_preload(flexibility, gap + 1e-4, areas, 10.0)
    assert far.force == pytest.approx(near.force, abs=1e-8)
    assert far.approach - near.approach == pytest.approx(1e-4, rel=1e-9)


@pytest.mark.parametrize(("arguments", "reason"), [
    ((np.eye(3), np.zeros(2), np.ones(3), 1.0), "do not match"),
    ((np.eye(3), np.zeros(3), np.ones(3), 0.0), "normal_load must be positive"),
    ((np.eye(3), np.zeros(3), np.ones(3), float("nan")), "normal_load must be positive"),
    ((np.diag([1.0, -1.0, 1.0]), np.zeros(3), np.ones(3), 1.0), "not positive definite"),
])
def test_bad_input_is_named(arguments, reason):
    with pytest.raises(InputError, match=reason):
        frictionless_preload(*arguments)
