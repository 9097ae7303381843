"""The contact face as cells to draw: quads where the nodes form a grid, else triangles."""

from __future__ import annotations

import numpy as np
from fretflow.core.errors import MeshError
from numpy.typing import NDArray
from scipy.spatial import Delaunay


def contact_cells(nodes: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cells of a contact face, counter-clockwise seen from above.

    Parameters
    ----------
    nodes
        Node positions in m, (n, 2), sorted by x, then y.

    Returns
    -------
    ndarray
        Node numbers, (cells, 4) where the nodes form a full grid, else (cells, 3) of Delaunay triangles.

    Raises
    ------
    MeshError
        If the nodes span no area.
    """
    columns, rows = (_distinct(nodes[:, c]) for c in (0, 1))
    if min(columns, rows) < 2:
        raise MeshError(f"contact nodes: {len(nodes)} nodes span no area; the contact group must be a face")
    if columns * rows != len(nodes) or not _is_grid(nodes, columns, rows):
        return np.asarray(Delaunay(nodes).simplices, dtype=np.int64)  # these are counter-clockwise too
    number = np.arange(columns * rows).reshape(columns, rows)
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    cells: NDArray[np.int64] = np.stack([c.ravel() for c in corners], axis=1)
    return cells


def node_patches(points: NDArray[np.float64], cells: NDArray[np.int64]) -> tuple[
        NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Cut each cell into one quad per corner, so that a node's value can fill the area around it.

    Parameters
    ----------
    points
        Positions in m, (n, 3).
    cells
        Node numbers, (cells, 3 or 4).

    Returns
    -------
    points : ndarray
        Positions in m, (4 cells corners, 3).
    quads : ndarray
        Point numbers, (cells corners, 4).
    owner : ndarray
        Node that owns each quad, (cells corners,).
    """
    corner = points[cells]
    after = 0.5 * (corner + np.roll(corner, -1, axis=1))
    before = np.roll(after, 1, axis=1)
    centre = np.broadcast_to(corner.mean(axis=1, keepdims=True), corner.shape)
    patches = np.stack([corner, after, centre, before], axis=2).reshape(-1, 3)
    return patches, np.arange(len(patches)).reshape(-1, 4), cells.ravel()


def _distinct(values: NDArray[np.float64]) -> int:
    """Return the number of distinct coordinates, closer ones than 1e-6 of the span taken as one."""
    step = np.diff(np.sort(values))
    return 1 + int(np.count_nonzero(step > 1e-6 * max(float(np.ptp(values)), 1e-300)))


def _is_grid(nodes: NDArray[np.float64], columns: int, rows: int) -> bool:
    x, y = nodes[:, 0].reshape(columns, rows), nodes[:, 1].reshape(columns, rows)
    tolerance = 1e-6 * float(np.ptp(nodes, axis=0).max())
    return bool(np.all(np.ptp(x, axis=1) < tolerance) and np.all(np.ptp(y, axis=0) < tolerance))
