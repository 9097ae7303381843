"""Forces on the two masses of the rig that depend on their motion at the same instant."""

from __future__ import annotations

from collections.abc import Iterable
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
    """A force without memory, linear or not; continuous, with a derivative almost everywhere.

    One whose attribute ``between_specimens`` is true is exchanged by the specimens, so that a sensor sees it with the
    friction force.
    """

    def __call__(self, displacement: NDArray[np.float64], velocity: NDArray[np.float64]) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        ...


def force_beside_friction(forces: Iterable[RigForce], displacement: NDArray[np.float64],
                          velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the x force of the upper specimen on the lower besides friction, (N,) in N, for a motion (N, 2)."""
    total = np.zeros(len(displacement))
    for force in forces:
        if getattr(force, "between_specimens", False):
            total -= force(displacement, velocity).force[:, 1]
    return total


@dataclass(frozen=True)
class ShareOfForce:
    """A share of another force (a `RigForce`)."""

    share: float
    whole: RigForce

    def __call__(self, displacement: NDArray[np.float64], velocity: NDArray[np.float64]) -> ForceAndSlopes:
        """Return the share of the other's force and slopes."""
        return ForceAndSlopes(*(self.share * part for part in self.whole(displacement, velocity)))
