"""Quality of hexahedra by the Jacobian of their geometry."""

from __future__ import annotations

from typing import Final

import numpy as np
from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from numpy.typing import NDArray

from fretflow_meshes.hexmesh import HexMesh, lattice_positions

# Cells per block, so that the work arrays stay near 20 MB on meshes of any size.
_BLOCK: Final = 8192
_SAMPLES: Final = (0.0, 0.5, 1.0)


@record
class Quality:
    """Worst figures of each cell over its corners, edge middles, face middles and centre.

    The Jacobian maps the unit cube to the cell, so the determinant of a box is its volume; scaled means
    divided by the lengths of its three columns, so 1 is a box (Knupp 2000, Int. J. Numer. Meth. Engng 48,
    1165-1185).
    """

    jacobian: NDArray[np.float64] = quantity("m^3", "(cells,)")
    scaled_jacobian: NDArray[np.float64] = quantity("1", "(cells,)")


def measure(mesh: HexMesh) -> Quality:
    """Return the quality of every cell."""
    gradients = _gradients(mesh.degree)
    jacobian = np.empty(len(mesh.cells))
    scaled = np.empty(len(mesh.cells))
    for start in range(0, len(mesh.cells), _BLOCK):
        block = slice(start, start + _BLOCK)
        columns = np.einsum("qna,cnd->cqda", gradients, mesh.points[mesh.cells[block]], optimize=True)
        determinant = np.linalg.det(columns)
        lengths = np.prod(np.linalg.norm(columns, axis=2), axis=2)
        jacobian[block] = determinant.min(axis=1)
        ratio = np.divide(determinant, lengths, out=np.zeros_like(determinant), where=lengths > 0.0)
        scaled[block] = ratio.min(axis=1)
    return Quality(jacobian=jacobian, scaled_jacobian=scaled)


def refuse_inverted(mesh: HexMesh, quality: Quality, name: str) -> None:
    """Check that no cell is inverted or flat.

    Raises
    ------
    MeshError
        With the number of such cells and the centre of the worst one.
    """
    bad = np.flatnonzero(~(quality.jacobian > 0.0))
    if bad.size:
        worst = bad[np.argmin(quality.scaled_jacobian[bad])]
        x, y, z = 1e3 * mesh.points[mesh.cells[worst]].mean(axis=0)
        raise MeshError(f"{name}: {bad.size} of {len(mesh.cells)} cells are inverted or flat, the worst at "
                        f"({x:.4g}, {y:.4g}, {z:.4g}) mm; mesh that region anew, with right-handed hexahedra")


def _gradients(degree: int) -> NDArray[np.float64]:
    """Return reference gradients of the Lagrange basis, shape (27 samples, nodes, 3)."""
    nodes = np.linspace(0.0, 1.0, degree + 1)
    value, slope = (np.empty((len(_SAMPLES), degree + 1)) for _ in range(2))
    for n in range(degree + 1):
        others = np.delete(nodes, n)
        basis = np.poly1d(np.poly(others) / np.prod(nodes[n] - others))
        value[:, n], slope[:, n] = basis(_SAMPLES), basis.deriv()(_SAMPLES)
    i, j, k = lattice_positions(degree).T
    parts = [[slope if a == axis else value for a in range(3)] for axis in range(3)]
    grids = [np.einsum("an,bn,cn->abcn", x[:, i], y[:, j], z[:, k]).reshape(-1, len(i)) for x, y, z in parts]
    return np.stack(grids, axis=-1)
