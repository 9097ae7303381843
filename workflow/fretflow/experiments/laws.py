"""What an unlisted effect does, from the data: what is left against the state behind it."""

from __future__ import annotations

from math import isqrt

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import Array


def equal_bins(values: Array) -> list[NDArray[np.int64]]:
    """Return samples in bins of about equal count, equal values together: as many bins as each has samples."""
    share = np.linspace(0.0, 1.0, isqrt(len(values)) + 1)[1:-1]
    place = np.searchsorted(np.unique(np.quantile(values, share, method="nearest")), values)
    return [np.flatnonzero(place == k) for k in np.unique(place)]
