"""A kept factor of the contact's equations, corrected by secants."""

from __future__ import annotations

import numpy as np
import pytest
from fretflow.contact.kernels.sample import SECANTS, WORTH, Factor, empty_factor, learn, newton_step
from fretflow.core.compiled import factorise

SIZE = 6


def kept_factor(matrix: np.ndarray) -> Factor:
    """Return the factors of `matrix` as those of the last equations, no secant seen."""
    factor = empty_factor(WORTH, single=True)
    columns = factor.matrix[:matrix.size].reshape(matrix.shape)
    columns[:] = matrix.T
    assert factorise(columns, factor.pivots[:len(matrix)])
    factor.size[:] = len(matrix), 0
    return factor


@pytest.mark.parametrize("seen", [SIZE, 3 * SECANTS])
def test_secants_in_every_direction_replace_the_factor(seen):
    """With J s of as many steps as there are unknowns, Newton's step is that of J, whatever was factorised."""
    random = np.random.default_rng(0)
    now = np.eye(SIZE) + 0.3 * random.standard_normal((SIZE, SIZE))
    factor = kept_factor(now + 0.3 * random.standard_normal((SIZE, SIZE)))
    residual = random.standard_normal(SIZE)
    expected = -np.linalg.solve(now, residual)
    assert np.abs(newton_step(factor, residual) - expected).max() > 0.1 * np.abs(expected).max()
    for step in np.vstack([np.eye(SIZE), random.standard_normal((seen - SIZE, SIZE))]):
        learn(factor, step.copy(), now @ step)
    assert newton_step(factor, residual) == pytest.approx(expected, rel=1e-6)


def test_secant_that_is_known_already_is_not_taken_twice():
    """A step along one seen before tells only of the curvature, which would be blown up."""
    factor = kept_factor(np.eye(SIZE))
    step = np.arange(1.0, SIZE + 1.0)
    learn(factor, step.copy(), 2.0 * step)
    learn(factor, 1.001 * step, 2.01 * step)
    assert factor.size[1] == 1
    assert newton_step(factor, step) == pytest.approx(-0.5 * step)
