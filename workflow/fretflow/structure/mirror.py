"""Mirror symmetry of faces: nodes that are alike on both sides of a plane y = const, and what is symmetric about it.

With the mirror image u(m') = S u(m), S = diag(1, -1, 1), of a node m at m', symmetric motions are u = E v of the nodes
on one side and on the plane, whose forces are E^T f: a joint with the stiffness E^T K E of half the nodes, of which
those beside the plane stand for two (A. Bossavit, Comput. Methods Appl. Mech. Eng. 56 (1986) 167-215, of the
one-dimensional representations of this group). On the plane nothing moves across it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fretflow.core.records import Array

ALIKE = 1e-9  # difference of both sides, of the largest of all, that is round-off
SIGNS = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class MirrorPlane:
    """The plane y = const through the middle of faces whose nodes lie alike on both sides, and the nodes of one side.

    Nodes `kept` (h,) have their images at the nodes `images` (h,): themselves on the plane.
    """

    kept: NDArray[np.intp]
    images: NDArray[np.intp]
    nodes: int  # of both sides

    @classmethod
    def through(cls, nodes: Array) -> MirrorPlane | None:
        """Return the plane in the middle of nodes (n, 2 or 3) in m; None where they differ across it."""
        width = float(np.ptp(nodes[:, :2], axis=0).max())
        middle = 0.5 * (nodes[:, 1].min() + nodes[:, 1].max())
        across = nodes[:, 1] - middle
        off, image = cKDTree(nodes[:, :2]).query(np.column_stack([nodes[:, 0], middle - across]))
        kept = np.flatnonzero(across <= ALIKE * width)
        if len(kept) == len(nodes) or off.max() > ALIKE * width or np.any(image[image] != np.arange(len(nodes))):
            return None
        return cls(kept, image[kept], len(nodes))

    @cached_property
    def times(self) -> Array:
        """Return how many nodes each of those kept stands for (h,)."""
        return np.where(self.kept == self.images, 1.0, 2.0)

    def is_kept_by(self, matrix: Array) -> bool:
        """Tell whether a matrix (3 n, 3 n) makes mirror images of mirror images."""
        any_other = np.random.default_rng(0).standard_normal(len(matrix))  # one that differs moves it as good as surely
        moved, mirrored = (matrix @ np.column_stack([any_other, self._mirrored(any_other)])).T
        return alike(moved, self._mirrored(mirrored))

    def is_symmetric(self, values: NDArray[Any]) -> bool:
        """Tell whether values (..., 3 n) of all DOFs are their own mirror image."""
        return alike(values, self._mirrored(values))

    def mean(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the means (..., 3 h) of values (..., 3 n) over both sides."""
        kept, images = self._dofs
        return np.asarray(0.5 * (np.take(values, kept, axis=-1) + self._signs * np.take(values, images, axis=-1)))

    def total(self, forces: NDArray[Any]) -> NDArray[Any]:
        """Return the forces (..., 3 h) on the nodes kept and on their images, of those (..., 3 n) of all."""
        return np.asarray(np.repeat(self.times, 3) * self.mean(forces))

    def whole(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return symmetric values (..., 3 n) of all DOFs from those (..., 3 h) of the nodes kept."""
        kept, images = self._dofs
        every = np.empty((*values.shape[:-1], 3 * self.nodes), dtype=values.dtype)
        every[..., images] = values * self._signs
        every[..., kept] = values
        return every

    def stiffness(self, whole: Array, across: float | None = None) -> Array:
        """Return E^T K E (3 h, 3 h) of the stiffness of all; `across` on the diagonal of what does not move.

        By default that is the mean of the diagonal.
        """
        times, (kept, _) = np.repeat(self.times, 3), self._dofs
        half = times[:, None] * self.mean(whole[kept]) * times
        still = np.flatnonzero((times == 1.0) & (self._signs < 0.0))
        half[still] = half[:, still] = 0.0
        half[still, still] = np.mean(np.diag(whole)) if across is None else across
        return np.asarray(0.5 * (half + half.T))

    @cached_property
    def _signs(self) -> Array:
        """Return by what the displacement of an image is that of its node kept, (3 h,)."""
        return np.tile(SIGNS, len(self.kept))

    def _mirrored(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the mirror images of values (..., 3 n)."""
        image: NDArray[np.intp] = np.empty(self.nodes, dtype=np.intp)
        image[self.kept], image[self.images] = self.images, self.kept
        return np.asarray(np.tile(SIGNS, self.nodes) * values[..., (3 * image[:, None] + np.arange(3)).ravel()])

    @cached_property
    def _dofs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the DOFs (3 h,) of the nodes kept and of their images."""
        kept, images = ((3 * nodes[:, None] + np.arange(3)).ravel() for nodes in (self.kept, self.images))
        return kept, images


def alike(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Tell whether two arrays differ by round-off."""
    return bool(np.abs(one - other).max(initial=0.0) <= ALIKE * np.abs(one).max(initial=0.0))
