"""One half of a joint that is symmetric about a plane tells all of it, see `structure.mirror`.

What is symmetric at first remains so: where structure, faces, friction and start are, the period is found for the
nodes on one side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fretflow.contact.interface import Interface
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.candidate_nodes import PartOfFaces
from fretflow.structure.mirror import MirrorPlane
from fretflow.structure.structure import MasslessBoundary


@dataclass(frozen=True)
class OneSide:
    """A boundary that is symmetric about a plane."""

    boundary: MasslessBoundary
    plane: MirrorPlane

    @classmethod
    def of(cls, boundary: MasslessBoundary, interface: Interface) -> OneSide | None:
        """Return the boundary's plane; None where it or the nodes differ across every one."""
        plane, b = MirrorPlane.through(interface.nodes), boundary
        if plane is None or not plane.is_kept_by(b.flexibility):
            return None
        symmetric = all(map(plane.is_symmetric, (b.motion.T, b.transfer, b.free.T, b.input_motion.T)))
        return cls(boundary, plane) if symmetric else None

    def is_of(self, problem: PeriodicProblem, start: PeriodicSolution | None) -> bool:
        """Tell whether faces, friction and a start of a problem are symmetric as well."""
        moving = [] if start is None else [start.displacement, start.force]
        return problem.is_symmetric(self.plane) and all(
            self.plane.is_symmetric(one.reshape(len(one), -1)) for one in moving)

    def half(self, problem: PeriodicProblem) -> PeriodicProblem:
        """Return the problem of the nodes kept."""
        return problem.half(self.plane, PartOfFaces(problem.structure, self.half_boundary))

    @cached_property
    def half_boundary(self) -> MasslessBoundary:
        """Return the structure with the massless contact of the nodes kept."""
        b, mean = self.boundary, self.plane.mean
        stiffness = self.plane.stiffness(b.bare_stiffness)
        outputs = {name: one if one.force is None else replace(one, force=mean(one.force))
                   for name, one in b.outputs.items()}
        times = np.repeat(self.plane.times, 3)
        flexibility = self.plane.stiffness(b.flexibility, 1.0 / float(np.mean(np.diag(b.bare_stiffness)))) / np.outer(
            times, times)
        return replace(b, flexibility=flexibility, bare_stiffness=stiffness, motion=mean(b.motion.T).T,
                       free=mean(b.free.T).T, transfer=mean(b.transfer), contact_mass=None, whole_damping=None,
                       input_motion=mean(b.input_motion.T).T, outputs=outputs)


def halved(problem: PeriodicProblem) -> PeriodicProblem:
    """Return the problem of one side of a plane of symmetry, where there is one; else the problem itself."""
    side = OneSide.of(problem.boundary, problem.interface)
    return problem if side is None or not side.is_of(problem, None) else side.half(problem)
