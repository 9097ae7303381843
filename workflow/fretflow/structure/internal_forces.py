"""Forces on the internal coordinates of a structure that depend on their motion at the same instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from fretflow.core.records import Array

# Times as many samples of forces without memory as of the contact: they cost little, and their kinks, as at the ends
# of a play or of a scar, fall between the contact's samples. Motions ten times a play cross its rounded ends in two.
FINER = 8


class ForceAndSlopes(NamedTuple):
    """Forces (N, d) in N on the coordinates, and their derivatives (N, d, d): force, then motion."""

    force: Array
    by_displacement: Array
    by_velocity: Array


class InternalForce(Protocol):
    """A force without memory, linear or not; continuous, with a derivative almost everywhere.

    One whose attribute ``between_specimens`` is true is exchanged by the specimens, so that a sensor sees it with the
    friction force.
    """

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the forces for displacements and velocities (N, d), m and m/s, of the coordinates."""
        ...


def total_force(forces: tuple[InternalForce, ...], displacement: Array, velocity: Array) -> ForceAndSlopes:
    """Return the sum of `forces` for a motion (N, d)."""
    samples, d = displacement.shape
    total = ForceAndSlopes(np.zeros((samples, d)), np.zeros((samples, d, d)), np.zeros((samples, d, d)))
    for force in forces:
        total = ForceAndSlopes(*(a + b for a, b in zip(total, force(displacement, velocity), strict=True)))
    return total


@dataclass(frozen=True)
class ShareOfForce:
    """A share of another force (an `InternalForce`)."""

    share: float
    whole: InternalForce

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the share of the other's force and slopes."""
        return ForceAndSlopes(*(self.share * part for part in self.whole(displacement, velocity)))


def force_beside_friction(forces: tuple[InternalForce, ...], displacement: Array, velocity: Array, sliding: Array
                          ) -> Array:
    """Return the x force of the upper specimen on the lower besides friction, (N,) in N, for a motion (N, d).

    `sliding` (d,) is how the upper specimen moves along x with the coordinates.
    """
    between = tuple(force for force in forces if getattr(force, "between_specimens", False))
    return np.asarray(-total_force(between, displacement, velocity).force @ sliding)
