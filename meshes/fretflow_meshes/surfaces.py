"""The surfaces of a mesh of any bodies, for pictures: each body's own boundary and each named face."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from fretflow.core.errors import MeshError
from fretflow.core.records import Array
from fretflow.core.specimen_mesh import copied_mesh
from numpy.typing import NDArray

from fretflow_meshes.gmsh_files import gmsh_session

Indices = NDArray[np.int64]

# faces of an element by its number of corners, in gmsh's order; a triangle repeats its last corner
_SIDES = {8: [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]],
          4: [[0, 2, 1, 1], [0, 1, 3, 3], [1, 2, 3, 3], [0, 3, 2, 2]]}


def read_surfaces(path: Path) -> tuple[Array, dict[str, Indices], dict[str, Indices]]:
    """Return points (n, 3) in m, and corners (k, 4) of each body's boundary and of each named face.

    Raises
    ------
    MeshError
        If the file is missing, or a body has other elements than tetrahedra and hexahedra.
    """
    with copied_mesh(path) as copy, gmsh_session(path) as gmsh:
        gmsh.merge(str(copy))
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        order = np.argsort(tags)
        by_dimension: dict[int, dict[str, Indices]] = {2: {}, 3: {}}
        for dim, tag in gmsh.model.getPhysicalGroups():
            cells = [cell for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
                     for cell in _corners(gmsh, path, dim, int(entity))]
            if dim in by_dimension and cells:
                numbers = np.searchsorted(tags[order], np.vstack(cells))
                by_dimension[dim][gmsh.model.getPhysicalName(dim, tag)] = order[numbers]
    boundaries = {name: _outside(cells) for name, cells in by_dimension[3].items()}
    return coordinates.reshape(-1, 3), boundaries, by_dimension[2]


def _corners(gmsh: Any, path: Path, dim: int, entity: int) -> list[Indices]:
    """Return the corners of an entity's elements, (k, 4) of faces and sides of volumes."""
    parts = []
    for kind, _, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
        name, _, _, width, _, corners = gmsh.model.mesh.getElementProperties(kind)
        own = np.asarray(nodes, dtype=np.int64).reshape(-1, width)[:, :corners]
        if dim == 3 and corners not in _SIDES:
            raise MeshError(f"{path}: has elements of the kind {name!r}; give tetrahedra or hexahedra")
        parts.append(np.vstack([own[:, side] for side in _SIDES[corners]]) if dim == 3
                     else own[:, [0, 1, 2, corners - 1]])
    return parts


def _outside(sides: Indices) -> Indices:
    """Return those of the elements' sides that no other element shares."""
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(sides[first[count == 1]])
