"""A joint of fewer nodes to start a large one from: patches of the faces that move as one.

Nodes of a patch share a displacement, u = P v, and their forces add up, P^T f (Galerkin's condition). What the faces
do as a whole is what they do in the joint itself: stiffness against gross motion, coupling, friction limit; only how
slip spreads is coarser. So Newton for all nodes begins with the motion of the patches and the tangent of their force,
which is nested iteration (A. Brandt, Math. Comp. 31 (1977) 333-390).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.solvers.quasi_static.march import ContactMarch, Surroundings
from fretflow.solvers.quasi_static.sample import SEPARATION, STICK, Array, ContactSystem, SampleState

SIDE = 11  # patches along a side of the faces: so many nodes in all are solved in 0.1 s
FEWEST = 3  # nodes of a patch on average, below which patches cost too large a part of the joint's own time


@dataclass(frozen=True)
class Patches:
    """Patches of an interface: the patch of each node, `of_node` (n,), and the nodes' areas (n,) m^2."""

    of_node: NDArray[np.intp]
    areas: Array

    @classmethod
    def of(cls, interface: Interface) -> Patches | None:
        """Return patches, `SIDE` along the longer extent of the faces; None where that makes none of several nodes."""
        low, extent = interface.nodes.min(axis=0), np.ptp(interface.nodes, axis=0)
        sides = np.maximum(np.ceil(SIDE * extent / (extent.max() or 1.0) - 1e-9), 1.0)
        share = (interface.nodes - low) / np.where(extent > 0.0, extent, 1.0)
        row, column = np.minimum(share * sides, sides - 1.0).astype(np.intp).T
        patches, of_node = np.unique(SIDE * row + column, return_inverse=True)
        return cls(of_node, interface.areas) if 1 < len(patches) <= interface.size / FEWEST else None

    def joint(self, march: ContactMarch) -> ContactMarch:
        """Return the contact of the patches."""
        c, around = march.system, march.surroundings
        law = replace(c.law, friction_coefficient=self.mean(c.friction),
                      reference_force=self.sum(np.broadcast_to(c.law.reference_force, c.size)))
        system = ContactSystem.of_parts(
            self._sums(self._sums(c.stiffness).T), self._sums(c.coupling), self._means(c.transfer.T).T,
            self.mean(c.gap), law, self._sums(c.pull), c.load)
        if c.curvature is not None:
            system = replace(system, curvature=self._sums(c.curvature))
        return ContactMarch(system, Surroundings(around.law, around.omega, around.sliding, self._means(around.free)),
                            lambda: self.state(march.preloaded()))

    def state(self, sample: SampleState) -> SampleState:
        """Return the patches' sample: closed where a node of theirs is."""
        closed = self.sum(sample.state != SEPARATION) > 0.0
        return SampleState(self._means(sample.displacement), self._sums(sample.force),
                           np.where(closed, STICK, SEPARATION).astype(np.int8))

    def sum(self, values: NDArray[Any]) -> Array:
        """Return sums over patches of values (n,)."""
        return np.asarray(np.bincount(self.of_node, weights=values), dtype=float)

    def mean(self, values: Array) -> Array:
        """Return means over patches, by area, of values (n,)."""
        return self.sum(values * self.areas) / self.sum(self.areas)

    def _sums(self, values: Array) -> Array:
        """Return sums over patches of values (3 n, ...) by DOFs."""
        by_node = values.reshape(len(self.of_node), 3, *values.shape[1:])
        order = np.argsort(self.of_node, kind="stable")
        first = np.searchsorted(self.of_node[order], np.arange(self.of_node.max() + 1))
        summed = np.add.reduceat(by_node[order], first, axis=0)
        return np.asarray(summed.reshape(-1, *values.shape[1:]))

    def _means(self, values: Array) -> Array:
        counts = np.repeat(self.sum(np.ones(len(self.of_node))), 3)
        return self._sums(values) / counts.reshape(-1, *(1,) * (values.ndim - 1))
