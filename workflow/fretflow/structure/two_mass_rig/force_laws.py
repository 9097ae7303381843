"""Forces on the rig beside its contact (each a `structure.internal_forces.InternalForce`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fretflow.core.records import Array
from fretflow.structure.internal_forces import ForceAndSlopes

BLOCK, ARM = 0, 1


@dataclass(frozen=True)
class ArmSupport:
    """A spring of `stiffness` (N/m) and `cubic` (N/m^3) from the arm to ground."""

    stiffness: float = 0.0
    cubic: float = 0.0

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        forces = _nothing(len(displacement))
        x = displacement[:, ARM]
        forces.force[:, ARM] = -(self.stiffness + self.cubic * x**2) * x
        forces.by_displacement[:, ARM, ARM] = -self.stiffness - 3.0 * self.cubic * x**2
        return forces


@dataclass(frozen=True)
class BlockPull:
    """A constant `force` (N) on the block."""

    force: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        forces = _nothing(len(displacement))
        forces.force[:, BLOCK] = self.force
        return forces


@dataclass(frozen=True)
class HingePlay:
    """What play of `play` (m) from end to end takes off a linear hinge of `stiffness` (N/m).

    The hinge carries ``k d(delta)``, delta the arm's motion relative to the block and d zero within the play, delta
    less half the play beyond; so ``k (delta - d(delta))`` is taken off. Its damping stays. The stiffness comes in
    linearly about the end of the play, as that of faces that come into touch, over `rounding` of half the play to
    either side; a jump would stall Newton's method.
    """

    stiffness: float
    play: float
    rounding: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, 2), m and m/s, of block and arm along x."""
        forces = _nothing(len(displacement))
        apart = displacement[:, ARM] - displacement[:, BLOCK]
        half = 0.5 * self.play
        if half == 0.0:
            return forces
        taken, share = _clipped(apart / half, self.rounding)
        on_arm, slope = self.stiffness * half * taken, self.stiffness * share
        for i, sign in ((ARM, 1.0), (BLOCK, -1.0)):
            forces.force[:, i] = sign * on_arm
            forces.by_displacement[:, i, ARM] = sign * slope
            forces.by_displacement[:, i, BLOCK] = -sign * slope
        return forces


def _clipped(value: Array, rounding: float) -> tuple[Array, Array]:
    """Return `value` (N,) clipped to -1 and 1 with corners rounded by parabolas, and its slope."""
    slope = np.clip((1.0 + rounding - np.abs(value)) / (2.0 * rounding), 0.0, 1.0)
    size = np.minimum(np.abs(value), 1.0 - rounding) + rounding * (1.0 - slope**2)
    return np.sign(value) * size, slope


def _nothing(samples: int) -> ForceAndSlopes:
    return ForceAndSlopes(np.zeros((samples, 2)), np.zeros((samples, 2, 2)), np.zeros((samples, 2, 2)))
