"""The Fourier basis: analysis undoes synthesis, and the complex amplitudes reproduce the series in time."""

import numpy as np
import pytest
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix, to_complex, to_real


@pytest.mark.parametrize(("harmonics", "samples"), [(1, 3), (3, 7), (3, 128), (25, 256)])
def test_analysis_undoes_synthesis(harmonics, samples):
    product = analysis_matrix(harmonics, samples) @ synthesis_matrix(harmonics, samples)
    assert product == pytest.approx(np.eye(2 * harmonics + 1), abs=1e-13)


def test_samples_follow_the_stated_time_and_order():
    tau = 2 * np.pi * np.arange(16) / 16
    values = 3.0 - 2.0 * np.cos(tau) + 0.5 * np.sin(2 * tau)
    assert analysis_matrix(2, 16) @ values == pytest.approx([3.0, -2.0, 0.0, 0.0, 0.5], abs=1e-14)


def test_complex_amplitudes_are_the_same_series():
    rng = np.random.default_rng(0)
    a, tau = rng.normal(size=(7, 2)), 0.7
    amplitudes = to_complex(a)
    value = sum((amplitudes[k] * np.exp(1j * k * tau)).real for k in range(4))
    expected = a[0] + sum(a[2 * k - 1] * np.cos(k * tau) + a[2 * k] * np.sin(k * tau) for k in (1, 2, 3))
    assert value == pytest.approx(expected, abs=1e-14)
    assert to_real(amplitudes) == pytest.approx(a, abs=0)
