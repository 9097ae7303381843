"""What a user's own mesh must satisfy before it is used."""

from __future__ import annotations

from typing import Final

import numpy as np
from fretflow.core.errors import MeshError
from fretflow.core.specimen_mesh import CLAMPED_GROUP, CONTACT_GROUP
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fretflow_meshes.hexmesh import HexMesh, outer_faces

# Specimens of fretting rigs measure millimetres to centimetres; a mesh in mm read as metres is far outside.
_SMALLEST, _LARGEST = 1e-4, 0.5
# Allowed distance of the contact face from z = 0, as a share of the face's width.
_FLATNESS: Final = 1e-5


def check_user_mesh(mesh: HexMesh, upper: bool, name: str) -> None:
    """Check size, position, faces and connectedness of a user's mesh; `name` stands in errors.

    Raises
    ------
    MeshError
        With what is wrong and what to change.
    """
    _check_size(mesh, name)
    _check_position(mesh, upper, name)
    _check_faces(mesh, name)
    _check_connected(mesh, name)


def _check_size(mesh: HexMesh, name: str) -> None:
    size = float(np.ptp(mesh.points, axis=0).max())
    if not _SMALLEST <= size <= _LARGEST:
        raise MeshError(f"{name}: is {size:.4g} m large; where it counts in millimetres give mesh.unit = \"1 mm\"")


def _check_position(mesh: HexMesh, upper: bool, name: str) -> None:
    """Check that the contact face is the plane z = 0 and that the specimen lies on its side of it."""
    face = mesh.points[np.unique(mesh.contact)]
    tolerance = _FLATNESS * float(np.ptp(face[:, :2], axis=0).max())
    off = float(np.abs(face[:, 2]).max())
    if off > tolerance:
        raise MeshError(f"{name}: nodes of group contact lie up to {1e6 * off:.4g} µm from the plane z = 0; "
                        "move the face there, and give curvature by specimen.face and face_radius")
    height = mesh.points[:, 2] if upper else -mesh.points[:, 2]
    if height.min() < -tolerance:
        raise MeshError(f"{name}: has nodes on the other side of z = 0; the "
                        f"{'upper specimen lies in z > 0' if upper else 'lower specimen lies in z < 0'}")


def _check_faces(mesh: HexMesh, name: str) -> None:
    """Check that the quadrilaterals of both groups are outer faces of the hexahedra."""
    outer = {row.tobytes() for row in outer_faces(mesh.cells)}
    for group, faces in ((CONTACT_GROUP, mesh.contact), (CLAMPED_GROUP, mesh.clamped)):
        stray = sum(row.tobytes() not in outer for row in np.sort(faces[:, :4], axis=1))
        if stray:
            raise MeshError(f"{name}: {stray} of {len(faces)} elements of group {group} are no outer faces "
                            "of the body; remove duplicate nodes and put the group on the body's surface")


def _check_connected(mesh: HexMesh, name: str) -> None:
    """Check that all hexahedra hang together through shared nodes."""
    first = np.repeat(mesh.cells[:, 0], mesh.cells.shape[1] - 1)
    other = mesh.cells[:, 1:].ravel()
    graph = coo_array((np.ones(len(first)), (first, other)), shape=(len(mesh.points),) * 2)
    parts, _ = connected_components(graph, directed=False)
    if parts > 1:
        raise MeshError(f"{name}: the body falls into {parts} parts that share no nodes; "
                        "merge the duplicate nodes where they touch")
