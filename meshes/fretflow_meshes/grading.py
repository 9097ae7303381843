"""Element sizes that grow away from the contact."""

from __future__ import annotations

import numpy as np
from fretflow.core.errors import MeshError
from numpy.typing import NDArray

BISECTIONS = 60
MAX_LAYERS = 100_000


def graded_sizes(length: float, first: float, growth: float, largest: float) -> NDArray[np.float64]:
    """Divide `length` into the fewest layers that start at `first` and grow by at most `growth`.

    Sizes are ``min(first r^k, largest)`` with the one ratio r <= growth that fills `length` exactly. When
    layers of constant size already exceed `length`, they are made equal and smaller than `first`.

    Returns
    -------
    ndarray, shape (layers,), unit of `length`
        Sizes from the contact outwards; their sum is `length` to rounding.

    Raises
    ------
    MeshError
        If there would be more than MAX_LAYERS layers.
    """
    largest = max(largest, first)

    def sizes(layers: int, ratio: float) -> NDArray[np.float64]:
        exponents = np.arange(layers)
        capped = np.log(largest / first) / np.log(ratio) if ratio > 1.0 else np.inf
        return np.asarray(np.minimum(first * ratio ** np.minimum(exponents, capped), largest))

    ends = np.cumsum(sizes(_most_layers(length, first, growth, largest), growth))
    layers = int(np.searchsorted(ends, length * (1.0 - 1e-9))) + 1
    low, high = 1.0, growth
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if sizes(layers, middle).sum() > length else (middle, high)
    result = sizes(layers, low)
    return np.asarray(result * (length / result.sum()))


def _most_layers(length: float, first: float, growth: float, largest: float) -> int:
    """Return a number of layers that is enough: constant ones, or those that grow to the largest and stay there."""
    needed = length / first
    if growth > 1.0:
        needed = min(needed, np.log(largest / first) / np.log(growth) + length / largest)
    if needed > MAX_LAYERS:
        raise MeshError(f"specimen: {length:.3g} m would be divided into {needed:.1e} layers from {first:.3g} m on, "
                        f"above {MAX_LAYERS:.0e}; check its lengths, or give a larger mesh.growth")
    return int(np.ceil(needed)) + 2


def levels(start: float, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the layer boundaries, shape (layers + 1,), that begin at `start`."""
    return start + np.concatenate(([0.0], np.cumsum(sizes)))


def subdivide(values: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Insert the nodes of elements of `degree` between their boundaries, shape (degree * elements + 1,)."""
    positions = np.arange(degree * (len(values) - 1) + 1) / degree
    return np.interp(positions, np.arange(len(values)), values)
