"""Mirror symmetry: where structure, faces and friction are alike on both sides of y = const, one half tells all.

With the mirror image u(m') = S u(m), S = diag(1, -1, 1), of a node m at m', symmetric motions are u = E v of the nodes
v on one side and on the plane, whose forces are E^T f: a joint with the stiffness E^T K E of half the nodes, of twice
the area each beside the plane. On the plane nothing moves across it (A. Bossavit, Comput. Methods Appl. Mech. Eng. 56
(1986) 167-215, of the one-dimensional representation of this group). What is symmetric at first remains so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fretflow.contact.interface import Interface
from fretflow.core.records import Array
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.candidate_nodes import PartOfFaces
from fretflow.structure.structure import MasslessBoundary

ALIKE = 1e-9  # difference of both sides, of the largest of all, that is round-off
SIGNS = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class MirrorPlane:
    """The plane y = const through the faces of a boundary that is symmetric about it, and the nodes kept on one side.

    Nodes `kept` (h,) have their images at the nodes `images` (h,): themselves on the plane.
    """

    boundary: MasslessBoundary
    kept: NDArray[np.intp]
    images: NDArray[np.intp]

    @classmethod
    def of(cls, boundary: MasslessBoundary, interface: Interface) -> MirrorPlane | None:
        """Return the plane in the middle of the faces; None where structure or nodes differ across it."""
        nodes, width = interface.nodes, float(np.ptp(interface.nodes, axis=0).max())
        middle = 0.5 * (nodes[:, 1].min() + nodes[:, 1].max())
        across = nodes[:, 1] - middle
        off, image = cKDTree(nodes).query(np.column_stack([nodes[:, 0], middle - across]))
        kept = np.flatnonzero(across <= ALIKE * width)
        if (len(kept) == len(nodes) or off.max() > ALIKE * width or np.any(image[image] != np.arange(len(nodes)))
                or not _alike(interface.areas, interface.areas[image])):
            return None
        dofs, signs = (3 * image[:, None] + np.arange(3)).ravel(), np.tile(SIGNS, len(image))
        force = np.random.default_rng(0).standard_normal(len(dofs))  # a matrix that differs moves any as good as surely
        moved, mirrored = boundary.flexibility @ np.column_stack([force, signs * force[dofs]]).T[:, :, None]
        if not all(_alike(one, signs[:, None] * other[dofs]) for one, other in (
                *((one, one) for one in (boundary.motion, boundary.transfer.T, boundary.free, boundary.input_motion)),
                (moved, mirrored))):
            return None
        return cls(boundary, kept, image[kept])

    def is_of(self, problem: PeriodicProblem, start: PeriodicSolution | None) -> bool:
        """Tell whether gaps, friction and a start of a problem are symmetric as well."""
        of_nodes = [problem.interface.gap, np.broadcast_to(problem.friction_coefficient, problem.interface.size)]
        moving = [] if start is None else [start.displacement, start.force]
        return all(_alike(one[self.kept], one[self.images]) for one in of_nodes) and all(
            _alike(one[:, self.kept], SIGNS * one[:, self.images]) for one in moving)

    def half(self, problem: PeriodicProblem) -> PeriodicProblem:
        """Return the problem of the nodes kept."""
        face, mu = problem.interface, problem.friction_coefficient
        law = problem.law if np.ndim(mu) == 0 else replace(problem.law, friction_coefficient=np.asarray(mu)[self.kept])
        return replace(problem, structure=PartOfFaces(problem.structure, self.half_boundary), law=law,
                       interface=Interface(face.nodes[self.kept], self._times * face.areas[self.kept],
                                           face.gap[self.kept]))

    @cached_property
    def half_boundary(self) -> MasslessBoundary:
        """Return the structure with the massless contact of the nodes kept."""
        b, (kept, images), times = self.boundary, self._dofs, np.repeat(self._times, 3)
        signs = np.tile(SIGNS, len(self.kept))

        def mean(values: Array) -> Array:
            """Return the means (..., 3 h) of values (..., 3 n) over both sides."""
            return np.asarray(0.5 * (values[..., kept] + signs * values[..., images]))

        stiffness = times[:, None] * mean(b.bare_stiffness[kept]) * times
        flexibility = mean(b.flexibility[kept])
        still = np.flatnonzero((times == 1.0) & (signs < 0.0))  # across the plane: moved by nothing else
        for matrix, diagonal in ((stiffness, np.mean(np.diag(b.bare_stiffness))),
                                 (flexibility, 1.0 / np.mean(np.diag(b.bare_stiffness)))):
            matrix[still] = matrix[:, still] = 0.0
            matrix[still, still] = diagonal
        outputs = {name: one if one.force is None else replace(one, force=mean(one.force))
                   for name, one in b.outputs.items()}
        return replace(b, flexibility=0.5 * (flexibility + flexibility.T), bare_stiffness=0.5 * (
            stiffness + stiffness.T), motion=mean(b.motion.T).T, free=mean(b.free.T).T, transfer=mean(b.transfer),
            contact_mass=None, whole_damping=None, input_motion=mean(b.input_motion.T).T, outputs=outputs)

    def half_solution(self, solution: PeriodicSolution) -> PeriodicSolution:
        """Return what a solution says of the nodes kept."""
        return replace(solution, displacement=solution.displacement[:, self.kept], state=solution.state[:, self.kept],
                       force=self._times[:, None] * solution.force[:, self.kept])

    def whole_solution(self, half: PeriodicSolution) -> PeriodicSolution:
        """Return the solution of all nodes from that of those kept."""
        return replace(half, displacement=self._whole(half.displacement, SIGNS), state=self._whole(half.state, 1),
                       force=self._whole(half.force / self._times[:, None], SIGNS))

    def _whole(self, values: NDArray[Any], signs: Any) -> NDArray[Any]:
        """Return values (N, n, ...) of all nodes from those (N, h, ...) of the nodes kept."""
        whole = np.empty((len(values), self.boundary.nodes, *values.shape[2:]), dtype=values.dtype)
        whole[:, self.images] = values * signs
        whole[:, self.kept] = values
        return whole

    @property
    def _times(self) -> Array:
        """Return how many nodes each of those kept stands for (h,)."""
        return np.where(self.kept == self.images, 1.0, 2.0)

    @property
    def _dofs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the DOFs (3 h,) of the nodes kept and of their images."""
        kept, images = ((3 * nodes[:, None] + np.arange(3)).ravel() for nodes in (self.kept, self.images))
        return kept, images


def halved(problem: PeriodicProblem) -> PeriodicProblem:
    """Return the problem of one side of a plane of symmetry, where there is one; else the problem itself."""
    plane = MirrorPlane.of(problem.boundary, problem.interface)
    return problem if plane is None or not plane.is_of(problem, None) else plane.half(problem)


def _alike(one: Array, other: Array) -> bool:
    """Tell whether two arrays differ by round-off."""
    return bool(np.abs(one - other).max(initial=0.0) <= ALIKE * np.abs(one).max(initial=0.0))
