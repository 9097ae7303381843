"""What a mesh has to say to the rest: its file, its group names, its contact nodes."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import quantity, record

# Names of the physical groups that a mesh must have; a user's own mesh carries the same.
CONTACT_GROUP = "contact"
CLAMPED_GROUP = "clamped"
BODY_GROUP = "body"


class GroupTag(IntEnum):
    """Physical tags that fretflow's meshes carry."""

    CONTACT = 1
    CLAMPED = 2
    BODY = 3


@record
class MeshSummary:
    """A specimen's mesh, as the mesh stage reports it; the .msh file lies beside it.

    Contact nodes are sorted by x, then y. For a curved face `profile` is the distance of each contact node
    from the plane z = 0 (not negative), hence that body's part of the initial gap.
    """

    file: str  # name of the .msh file, in the same folder
    degree: int
    cells: int
    nodes: int
    contact_nodes: NDArray[np.float64] = quantity("m", "(contact nodes, 3)")
    profile: NDArray[np.float64] = quantity("m", "(contact nodes,)")
    observation_point: NDArray[np.float64] = quantity("m", "(3,)")
    min_scaled_jacobian: float = quantity("1")
    min_jacobian: float = quantity("m^3")


@record
class MeshGeometry:
    """Points and cells of a specimen's mesh for pictures; second-degree cells give their eight corners."""

    points: NDArray[np.float64] = quantity("m", "(points, 3)")
    hexahedra: NDArray[np.int64] = quantity("1", "(cells, 8), VTK order")
