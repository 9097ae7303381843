"""The contact-law protocol: what periodic solvers need of a friction law.

Contact is unilateral and node to node; a tangential force is a complex number, ``x + i y``. A law is the
radius of the disc that the tangential force cannot leave, as a function of the normal force.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class ContactState(IntEnum):
    """State of a node at a time sample."""

    STICK = 0
    SLIP = 1
    SEPARATION = 2


class ContactLaw(Protocol):
    """A rate-independent friction law, isotropic in the tangential plane."""

    def slip_limit(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest tangential force in N for normal forces (..., nodes) in N; zero at zero."""
        ...

    def slip_limit_slope(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative of `slip_limit`, (..., nodes); it only matters where nodes touch."""
        ...


class FactorAndSlopes(NamedTuple):
    """A factor (N,) on the friction coefficient and its derivatives by position (1/m) and velocity (s/m)."""

    factor: NDArray[np.float64]
    by_position: NDArray[np.float64]
    by_velocity: NDArray[np.float64]


class MotionFactor(Protocol):
    """A factor on the friction coefficient that depends on how the specimens move as a whole."""

    def __call__(self, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> FactorAndSlopes:
        """Return the factor for positions and velocities (N,), m and m/s, of the moving specimen along x."""
        ...
