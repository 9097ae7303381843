"""Hexahedral meshes as arrays: node orders of gmsh, stacking of a plan into a specimen, outer faces."""

from __future__ import annotations

from typing import Final

import numpy as np
from fretflow.case.config import Mesh, Specimen
from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from fretflow.core.specimen_mesh import TURN
from numpy.typing import NDArray

from fretflow_meshes.grading import graded_sizes, levels, subdivide
from fretflow_meshes.plan import Plan, largest_size, make_plan

# Beyond this neither the assembly nor a factorisation fits in the memory of any workstation.
MAX_NODES: Final = 3_000_000

# gmsh's numbering of the hexahedron (reference manual, "Node ordering"): corners, edges, faces, centre.
_CORNERS: Final = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
_EDGES: Final = ((0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3),
                 (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7))
FACES: Final = ((0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 7, 3), (1, 2, 6, 5), (2, 3, 7, 6), (4, 5, 6, 7))
_QUAD_EDGES: Final = ((0, 1), (1, 2), (2, 3), (3, 0))


@record
class HexMesh:
    """Hexahedra of degree 1 (8 nodes) or 2 (27 nodes) and their tagged faces, in gmsh's node order."""

    points: NDArray[np.float64] = quantity("m", "(points, 3)")
    cells: NDArray[np.int64] = quantity("1", "(cells, (degree + 1)^3)")
    contact: NDArray[np.int64] = quantity("1", "(faces, (degree + 1)^2)")
    clamped: NDArray[np.int64] = quantity("1", "(faces, (degree + 1)^2)")

    @property
    def degree(self) -> int:
        """Return the degree of the hexahedra's geometry."""
        return 1 if self.cells.shape[1] == len(_CORNERS) else 2


def lattice_positions(degree: int) -> NDArray[np.int64]:
    """Return each node's place in the hexahedron, 0..degree along each axis, shape ((degree + 1)^3, 3)."""
    corners = 2 * np.array(_CORNERS)
    if degree == 1:
        return corners // 2
    groups = [*_EDGES, *FACES, tuple(range(len(_CORNERS)))]
    return np.vstack((corners, [corners[list(g)].mean(axis=0).astype(int) for g in groups]))


def _quad_positions(degree: int) -> NDArray[np.int64]:
    """Return each node's place in the quadrilateral, 0..degree along each axis, shape ((degree + 1)^2, 2)."""
    corners = 2 * np.array(_CORNERS)[:4, :2]
    if degree == 1:
        return corners // 2
    groups = [*_QUAD_EDGES, (0, 1, 2, 3)]
    return np.vstack((corners, [corners[list(g)].mean(axis=0).astype(int) for g in groups]))


def specimen_mesh(specimen: Specimen, mesh: Mesh) -> HexMesh:
    """Return the upper specimen: ridge along x in 0 <= z <= ridge_height, body above, interface at z = 0.

    The first layer of z is as high as a contact element, the others grow; one level lies at ridge_height.

    Raises
    ------
    MeshError
        If the mesh would have more than MAX_NODES nodes.
    """
    plan = make_plan(specimen, mesh)
    element = specimen.contact_width / mesh.contact_elements
    largest = largest_size(specimen)
    ridge = graded_sizes(specimen.ridge_height, element, mesh.growth, largest)
    body = graded_sizes(specimen.body_height, min(ridge[-1] * mesh.growth, largest), mesh.growth, largest)
    z = np.concatenate((levels(0.0, ridge)[:-1], levels(specimen.ridge_height, body)))
    nodes = len(plan.points) * (mesh.degree * (len(z) - 1) + 1)
    if nodes > MAX_NODES:
        raise MeshError(f"mesh.contact_elements = {mesh.contact_elements} with growth = {mesh.growth:g} and "
                        f"degree = {mesh.degree} asks for some {nodes:.1e} nodes, above {MAX_NODES:.0e}; "
                        "give fewer elements or a larger growth")
    return _stack(plan, subdivide(z, mesh.degree), len(ridge), 0.5 * specimen.contact_width)


def turned_over(upper: HexMesh) -> HexMesh:
    """Return the mesh as the lower specimen: turned half round about x = y, so (x, y, z) -> (y, x, -z)."""
    return HexMesh(points=upper.points @ TURN.T, cells=upper.cells, contact=upper.contact, clamped=upper.clamped)


def _stack(plan: Plan, z: NDArray[np.float64], ridge_layers: int, half: float) -> HexMesh:
    """Extrude the plan over the levels `z`: the strip ``|y| < half`` in the ridge, all of it above."""
    degree, size = plan.degree, len(plan.points)
    centres = plan.centres
    strip = np.abs(centres[:, 1]) < half
    square = strip & (np.abs(centres[:, 0]) < half)
    layers = (len(z) - 1) // degree
    bottom = np.concatenate([degree * size * k + plan.quads[strip] if k < ridge_layers
                             else degree * size * k + plan.quads for k in range(layers)])
    cells = _in_gmsh_order(bottom, degree, size)
    faces = _quad_positions(degree) @ (degree + 1, 1)
    contact = plan.quads[square][:, faces]
    clamped = size * (len(z) - 1) + plan.quads[:, faces]
    used = np.unique(cells)
    number = np.zeros(size * len(z), dtype=np.int64)
    number[used] = np.arange(len(used))
    points = np.column_stack((plan.points[used % size], z[used // size]))
    return HexMesh(points=points, cells=number[cells], contact=number[contact], clamped=number[clamped])


def _in_gmsh_order(bottom: NDArray[np.int64], degree: int, size: int) -> NDArray[np.int64]:
    """Return the hexahedra over their bottom faces, with levels `size` node numbers apart."""
    i, j, k = lattice_positions(degree).T
    return np.asarray(bottom[:, i * (degree + 1) + j] + size * k)


def outer_faces(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted corner nodes of the faces that belong to one cell only, shape (faces, 4)."""
    faces = np.sort(cells[:, np.array(FACES)].reshape(-1, 4), axis=1)
    unique, counts = np.unique(faces, axis=0, return_counts=True)
    return np.asarray(unique[counts == 1])
