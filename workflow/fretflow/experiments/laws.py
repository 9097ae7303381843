"""What an unlisted effect does, from the data: what is left against the state behind it."""

from __future__ import annotations

from math import isqrt

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import Array
from fretflow.inference.verdict import ResidualLaw


def equal_bins(values: Array) -> list[NDArray[np.int64]]:
    """Return samples in bins of about equal count, equal values together: as many bins as each has samples."""
    share = np.linspace(0.0, 1.0, isqrt(len(values)) + 1)[1:-1]
    place = np.searchsorted(np.unique(np.quantile(values, share, method="nearest")), values)
    return [np.flatnonzero(place == k) for k in np.unique(place)]


def binned_law(names: dict[str, str], state: Array, left: Array, variance: Array, noise: float,
               correlation: float = 1.0) -> ResidualLaw:
    """Return the means of what is left (N,) over bins of a state (N,), and the share of squares that they take up.

    Parameters
    ----------
    names
        Of channel and state, and their units, as fields of the law.
    state, left
        The state, and what a prediction leaves.
    variance
        What squares are taken over (N,).
    noise
        What the sum of the squares would be of noise alone.
    correlation
        Samples that count as one.
    """
    groups = equal_bins(state)
    at, mean = (np.array([values[own].mean() for own in groups]) for values in (state, left))
    sd = np.array([left[own].std() / np.sqrt(max(1.0, len(own) / correlation)) for own in groups])
    inside = sum(float(np.sum((left[own] - left[own].mean())**2 / variance[own])) for own in groups)
    whole = float(np.sum(left**2 / variance))
    explained = 0.0 if whole <= noise else float(np.clip((whole - inside) / (whole - noise), 0.0, 1.0))
    return ResidualLaw(**names, x=at, y=mean, sd=sd, explained=explained)
