"""Forces on the two masses of the rig that depend on their motion at the same instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class ForceAndSlopes(NamedTuple):
    """Forces (N, 2) in N on block and arm, and their derivatives (N, 2, 2): force, then motion, block first."""

    force: NDArray[np.float64]
    by_displacement: NDArray[np.float64]
    by_velocity: NDArray[np.float64]


class RigForce(Protocol):
    """A force without memory, linear or not; continuous, with a derivative almost everywhere."""

    def __call__(self, displacement: NDArray[np.float64], velocity: NDArray[np.float64]) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        ...


@dataclass(frozen=True)
class ShareOfForce:
    """A share of another force (a `RigForce`)."""

    share: float
    whole: RigForce

    def __call__(self, displacement: NDArray[np.float64], velocity: NDArray[np.float64]) -> ForceAndSlopes:
        """Return the share of the other's force and slopes."""
        return ForceAndSlopes(*(self.share * part for part in self.whole(displacement, velocity)))
