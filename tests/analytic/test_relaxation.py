"""Relaxation of an order against its rate law integrated step by step, and against the limits that have names."""

import numpy as np
import pytest
from fretflow.effects.friction_run_in import FrictionRunIn
from fretflow.effects.normal_load_drift import NormalLoadDrift
from fretflow.effects.relaxation import mean_left, share_left
from scipy.integrate import solve_ivp

PASSED = np.array([0.01, 0.3, 1.0, 3.0])


@pytest.mark.parametrize("order", [0.5, 0.9, 1.0, 1.4, 2.0, 3.0])
def test_the_share_and_its_mean_follow_the_rate_law(order):
    """dy/dx = -y^n, with the integral of y beside it; by an integrator that knows no closed form."""
    solution = solve_ivp(lambda x, y: [-max(y[0], 0.0)**order, max(y[0], 0.0)], (0.0, 3.0), [1.0, 0.0], t_eval=PASSED,
                         rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(share_left(PASSED, order), np.maximum(solution.y[0], 0.0), atol=1e-7)
    np.testing.assert_allclose(mean_left(PASSED, order), solution.y[1] / PASSED, atol=1e-7)


def test_orders_with_names():
    np.testing.assert_allclose(share_left(PASSED, 1.0), np.exp(-PASSED), rtol=1e-14)
    np.testing.assert_allclose(share_left(PASSED, 2.0), 1.0 / (1.0 + PASSED), rtol=1e-14)
    np.testing.assert_allclose(share_left(PASSED, 0.0), np.maximum(1.0 - PASSED, 0.0), atol=1e-14)
    assert np.isfinite(share_left(np.array([0.0, 1e9]), 0.5)).all()
    assert share_left(1e9, 0.5) == 0.0


def test_a_law_of_the_second_order_settles_late():
    """Half of friction's way takes E_0 instead of E_0 ln 2, and a tenth of it is left after 9 E_0."""
    late = FrictionRunIn().changed(initial=0.4, final=0.8, energy=30.0, order=2.0)
    assert late.coefficient(np.asarray(0.8), 30.0) == pytest.approx(0.6)
    assert late.coefficient(np.asarray(0.8), 270.0) == pytest.approx(0.76)
    assert NormalLoadDrift().changed(loss=0.2, settling=1e4, order=2.0).share(3e4) == pytest.approx(1.0 - 0.2 * 0.75)
