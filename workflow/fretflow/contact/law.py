"""The contact-law protocol: what periodic solvers need of a friction law.

Contact is unilateral and node to node; a tangential force is a complex number, ``x + i y``. A law is the
radius of the disc that the tangential force cannot leave, as a function of the normal force.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ContactLaw(Protocol):
    """A rate-independent friction law, isotropic in the tangential plane."""

    def slip_limit(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest tangential force in N for normal forces (..., nodes) in N; zero at zero."""
        ...

    def slip_limit_slope(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative of `slip_limit`, (..., nodes); it only matters where nodes touch."""
        ...
