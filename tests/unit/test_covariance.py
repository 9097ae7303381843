"""Errors that samples share: what some rows tell about them."""

import numpy as np
import pytest
from fretflow.inference.experiment import Covariance


def test_shared_errors_are_the_conditional_mean():
    """For Gaussian errors e = B c + d the mean of c given e is B^T Sigma^-1 e, here with the dense Sigma."""
    generator = np.random.default_rng(3)
    modes, variance = generator.standard_normal((12, 3)), generator.uniform(0.5, 2.0, 12)
    error = generator.standard_normal(12)
    dense = np.diag(variance) + modes @ modes.T
    assert Covariance(variance, modes).shared(error) == pytest.approx(modes.T @ np.linalg.solve(dense, error))


def test_a_gain_that_many_samples_show_is_known():
    """A gain error of 3 % of a signal far above the noise is found almost whole; no rows, no news."""
    signal = 10.0 * np.sin(np.arange(200))
    known = Covariance(np.full(200, 0.01), 0.05 * signal[:, None])
    assert 0.05 * known.shared(0.03 * signal)[0] == pytest.approx(0.03, rel=1e-2)
    assert Covariance(np.full(200, 0.01), np.zeros((200, 1))).shared(signal) == pytest.approx([0.0])


def test_the_density_of_no_error_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(4)
    logs = []
    for scale in (0.1, 3.0):
        variance, modes = rng.uniform(0.5, 2.0, 7), scale * rng.standard_normal((7, 3))
        whole = -0.5 * np.linalg.slogdet(np.diag(variance) + modes @ modes.T)[1]
        logs.append(Covariance(variance, modes).log_density - whole)
    assert np.allclose(logs, 0.0)
