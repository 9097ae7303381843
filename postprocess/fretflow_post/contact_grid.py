"""The contact face: its cells to draw, and how each node spends the period (stick, slip, open)."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from fretflow.contact.law import ContactState
from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from fretflow.solvers.periodic import PeriodicSolution
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


class Regime(IntEnum):
    """What a node does over a whole period."""

    STICKS = 0
    STICKS_AND_SLIPS = 1
    SLIPS = 2
    LIFTS_OFF = 3
    STAYS_OPEN = 4


REGIME_WORDS = {
    Regime.STICKS: "sticks all the time",
    Regime.STICKS_AND_SLIPS: "sticks and slips in turn",
    Regime.SLIPS: "slips all the time",
    Regime.LIFTS_OFF: "lifts off at times",
    Regime.STAYS_OPEN: "open all the time",
}


@record
class StateShares:
    """Share of the period that each node sticks, slips and is open; they sum to one."""

    stick: NDArray[np.float64] = quantity("1", "(nodes,)")
    slip: NDArray[np.float64] = quantity("1", "(nodes,)")
    open: NDArray[np.float64] = quantity("1", "(nodes,)")
    regime: NDArray[np.int8] = quantity("1", "(nodes,), see Regime")


def state_shares(period: PeriodicSolution) -> StateShares:
    """Return how the nodes spend `period`."""
    stick, slip, opened = (np.mean(period.state == s, axis=0)
                           for s in (ContactState.STICK, ContactState.SLIP, ContactState.SEPARATION))
    regime = np.select(
        [opened == 1.0, opened > 0.0, slip == 1.0, slip > 0.0],
        [Regime.STAYS_OPEN, Regime.LIFTS_OFF, Regime.SLIPS, Regime.STICKS_AND_SLIPS], Regime.STICKS)
    return StateShares(stick=stick, slip=slip, open=opened, regime=regime.astype(np.int8))
