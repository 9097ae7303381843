"""Real Fourier series on equidistant samples of one period.

Coefficients are real, order ``[a0, c1, s1, c2, s2, ...]`` along the first axis:
``u(tau) = a0 + sum_k c_k cos(k tau) + s_k sin(k tau)``, tau in [0, 2 pi).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def synthesis_matrix(harmonics: int, samples: int) -> NDArray[np.float64]:
    """Return the matrix (samples, 2 harmonics + 1) to values at ``tau_j = 2 pi j / samples``."""
    tau = 2.0 * np.pi * np.arange(samples) / samples
    angles = np.outer(tau, np.arange(1, harmonics + 1))
    matrix = np.empty((samples, 2 * harmonics + 1))
    matrix[:, 0] = 1.0
    matrix[:, 1::2] = np.cos(angles)
    matrix[:, 2::2] = np.sin(angles)
    return matrix


def analysis_matrix(harmonics: int, samples: int) -> NDArray[np.float64]:
    """Return the matrix (2 harmonics + 1, samples) to coefficients, exact for ``samples > 2 harmonics``."""
    matrix = synthesis_matrix(harmonics, samples).T * (2.0 / samples)
    matrix[0] *= 0.5
    return matrix


def time_derivative(values: NDArray[np.float64], omega: float) -> NDArray[np.float64]:
    """Return the rate (N, ...) of samples of one period at angular frequency `omega`; the last harmonic has none."""
    amplitudes = np.fft.rfft(values, axis=0)
    turning: NDArray[np.complex128] = 1j * omega * np.arange(len(amplitudes))
    if len(values) % 2 == 0:
        turning[-1] = 0.0  # it has no phase
    return np.fft.irfft(turning.reshape(-1, *(1,) * (values.ndim - 1)) * amplitudes, len(values), axis=0)


def derivative_matrix(harmonics: int, omega: float) -> NDArray[np.float64]:
    """Return the matrix (2 H + 1, 2 H + 1) from coefficients to those of the time derivative."""
    matrix = np.zeros((2 * harmonics + 1,) * 2)
    cosine = np.arange(1, len(matrix), 2)
    order = omega * np.arange(1, harmonics + 1)
    matrix[cosine, cosine + 1], matrix[cosine + 1, cosine] = order, -order
    return matrix


def to_complex(coefficients: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return amplitudes (harmonics + 1, ...): ``u = Re sum_k U_k exp(i k tau)``, ``U_k = c_k - i s_k``."""
    return np.concatenate([coefficients[:1].astype(complex), coefficients[1::2] - 1j * coefficients[2::2]])


def to_real(amplitudes: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return real coefficients (2 harmonics + 1, ...) of complex amplitudes (harmonics + 1, ...)."""
    real = np.empty((2 * len(amplitudes) - 1, *amplitudes.shape[1:]))
    real[0] = amplitudes[0].real
    real[1::2] = amplitudes[1:].real
    real[2::2] = -amplitudes[1:].imag
    return real
