"""Forces on the rig beside its contact (each a `rig.forces.RigForce`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.rig.forces import ForceAndSlopes

Array = NDArray[np.float64]
BLOCK, ARM = 0, 1


@dataclass(frozen=True)
class ArmSupport:
    """A spring of `stiffness` (N/m) and a dashpot of `damping` (N s/m) from the arm to the ground."""

    stiffness: float = 0.0
    damping: float = 0.0

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        found = _nothing(len(displacement))
        found.force[:, ARM] = -self.stiffness * displacement[:, ARM] - self.damping * velocity[:, ARM]
        found.by_displacement[:, ARM, ARM] = -self.stiffness
        found.by_velocity[:, ARM, ARM] = -self.damping
        return found


@dataclass(frozen=True)
class BlockPull:
    """A constant `force` (N) on the block."""

    force: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        found = _nothing(len(displacement))
        found.force[:, BLOCK] = self.force
        return found


@dataclass(frozen=True)
class HingePlay:
    """What play of `play` (m) from end to end takes off a linear hinge of `stiffness` (N/m).

    The hinge carries ``k d(delta)``, delta the arm's motion relative to the block and d zero within the play, delta
    less half the play beyond; so ``k (delta - d(delta))`` is taken off. Its damping stays.
    """

    stiffness: float
    play: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        found = _nothing(len(displacement))
        apart = displacement[:, ARM] - displacement[:, BLOCK]
        half = 0.5 * self.play
        on_arm = self.stiffness * np.clip(apart, -half, half)
        slope = np.where(np.abs(apart) < half, self.stiffness, 0.0)
        for i, sign in ((ARM, 1.0), (BLOCK, -1.0)):
            found.force[:, i] = sign * on_arm
            found.by_displacement[:, i, ARM] = sign * slope
            found.by_displacement[:, i, BLOCK] = -sign * slope
        return found


def _nothing(samples: int) -> ForceAndSlopes:
    return ForceAndSlopes(np.zeros((samples, 2)), np.zeros((samples, 2, 2)), np.zeros((samples, 2, 2)))
