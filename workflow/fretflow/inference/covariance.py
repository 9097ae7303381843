"""Covariance of a whole recording: independent noise, and modes that many samples share.

``Sigma = D + B B^T`` with D diagonal and few columns of B (gains, offsets, solver error, each of unit variance). With
``U = D^-1/2 B = V s W^T``, the inverse root is ``(1 - V (1 - (1 + s^2)^-1/2) V^T) D^-1/2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Covariance:
    """`variance` (M,) of independent noise and `modes` (M, B)."""

    variance: Array
    modes: Array

    @cached_property
    def _shared(self) -> tuple[Array, Array]:
        scaled = self.modes / np.sqrt(self.variance)[:, None]
        if not scaled.size:
            return np.zeros((len(self.variance), 0)), np.zeros(0)
        left, size, _ = np.linalg.svd(scaled, full_matrices=False)
        return left, 1.0 - 1.0 / np.sqrt(1.0 + size**2)

    def whiten(self, values: Array) -> Array:
        """Return `values` (M, ...) in units of which each is independent with unit variance."""
        flat = values.reshape(len(values), -1) / np.sqrt(self.variance)[:, None]
        left, damping = self._shared
        flat = flat - left @ (damping[:, None] * (left.T @ flat))
        return np.asarray(flat.reshape(values.shape))

    def shared(self, error: Array) -> Array:
        """Return the most probable size (B,) of each shared mode in an `error` (M,), in standard deviations."""
        scaled = self.modes / np.sqrt(self.variance)[:, None]
        inner = np.eye(scaled.shape[1]) + scaled.T @ scaled
        return np.asarray(np.linalg.solve(inner, scaled.T @ (error / np.sqrt(self.variance))))

    def draw(self, generator: np.random.Generator, count: int) -> Array:
        """Return `count` samples of the error, (M, count)."""
        alone = generator.standard_normal((len(self.variance), count)) * np.sqrt(self.variance)[:, None]
        return np.asarray(alone + self.modes @ generator.standard_normal((self.modes.shape[1], count)))
