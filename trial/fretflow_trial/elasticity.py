"""The specimens' compliance at the contact, from spectral elements.

One specimen is a body of 6 x 6 x 5 mm with a ridge of 6 x 1 x 1 mm across it. Elements of third order with nodes and
quadrature at the Gauss-Lobatto-Legendre points (A. T. Patera, J. Comput. Phys. 54 (1984) 468-488); 7 x 7 contact
nodes, denser at the edges. ``python -m fretflow_trial.elasticity`` writes ``specimens.npz`` anew (half a minute).
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FILE = Path(__file__).with_name("specimens.npz")
ORDER = 3
POISSONS_RATIO = 0.29
HALF = 0.5e-3  # of the contact square, m
# Element boundaries in mm: along the ridge, across it, and from the contact upwards.
ALONG = (-3.0, -1.6, -0.8, -0.5, 0.0, 0.5, 0.8, 1.6, 3.0)
ACROSS = (-3.0, -1.5, -0.5, 0.0, 0.5, 1.5, 3.0)
UPWARDS = (0.0, 0.25, 0.6, 1.0, 1.6, 3.0, 6.0)
RIDGE_TOP = 1.0
MM = 1e-3


@dataclass(frozen=True)
class Grid:
    """One direction: element boundaries, all nodes (m) and, by element, the nodes' numbers (elements, order + 1)."""

    nodes: Array
    sizes: Array
    members: Index


def lobatto() -> tuple[Array, Array, Array]:
    """Return the points in [-1, 1], their weights and the derivative matrix of Lagrange's polynomials, order 3."""
    inner = 1.0 / np.sqrt(5.0)
    points = np.array([-1.0, -inner, inner, 1.0])
    weights = np.array([1.0, 5.0, 5.0, 1.0]) / 6.0
    derivative = np.empty((ORDER + 1, ORDER + 1))
    for j in range(ORDER + 1):
        lagrange = np.poly1d(np.poly(np.delete(points, j)))
        derivative[:, j] = np.polyval(lagrange.deriv() / lagrange(points[j]), points)
    return points, weights, derivative


def grid(bounds: tuple[float, ...]) -> Grid:
    """Return the nodes of elements between `bounds` in mm."""
    edges = MM * np.array(bounds)
    points = lobatto()[0]
    inner = [a + 0.5 * (b - a) * (1.0 + points[:-1]) for a, b in itertools.pairwise(edges)]
    members = ORDER * np.arange(len(edges) - 1)[:, None] + np.arange(ORDER + 1)
    return Grid(np.append(np.concatenate(inner), edges[-1]), np.diff(edges), members)


def element_stiffness(size: Array, young: float, poisson: float) -> Array:
    """Return the stiffness of a brick of `size` (3,) in m, (192, 192) in N/m, node by node x, y, z."""
    _, weights, derivative = lobatto()
    shear = young / (2.0 * (1.0 + poisson))
    lame = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    elastic = np.zeros((6, 6))
    elastic[:3, :3] = lame
    elastic[range(3), range(3)] += 2.0 * shear
    elastic[range(3, 6), range(3, 6)] = shear
    one = np.eye(ORDER + 1)
    gradients = [2.0 / size[0] * np.einsum("ai,bj,ck->abcijk", derivative, one, one),
                 2.0 / size[1] * np.einsum("ai,bj,ck->abcijk", one, derivative, one),
                 2.0 / size[2] * np.einsum("ai,bj,ck->abcijk", one, one, derivative)]
    count = (ORDER + 1)**3
    gx, gy, gz = (g.reshape(count, count) for g in gradients)
    strain = np.zeros((count, 6, count, 3))
    for row, column, g in ((0, 0, gx), (1, 1, gy), (2, 2, gz), (3, 0, gy), (3, 1, gx), (4, 1, gz), (4, 2, gy),
                           (5, 0, gz), (5, 2, gx)):
        strain[:, row, :, column] = g
    volume = np.einsum("a,b,c->abc", weights, weights, weights).ravel() * size.prod() / 8.0
    flat = strain.reshape(count, 6, 3 * count)
    return np.asarray(np.einsum("qri,rs,qsj,q->ij", flat, elastic, flat, volume, optimize=True))


def specimen_compliance(along: tuple[float, ...] = ALONG, across: tuple[float, ...] = ACROSS,
                        upwards: tuple[float, ...] = UPWARDS, poisson: float = POISSONS_RATIO, half: float = HALF,
                        ridge: float = RIDGE_TOP * MM) -> tuple[Array, Array]:
    """Return the contact nodes (n, 2) in m and the compliance of the upper specimen times Young's modulus.

    The ridge is 2 `half` wide and `ridge` high, in m. The compliance (3 n, 3 n), 1/m, has x along the ridge, y across
    it and z up; the top is clamped.
    """
    grids = grid(along), grid(across), grid(upwards)
    shape = tuple(len(one.nodes) for one in grids)
    number = np.arange(np.prod(shape)).reshape(shape)
    whole, used = _assemble(grids, number, poisson, half, ridge)
    clamped = (3 * number[:, :, -1].ravel()[:, None] + np.arange(3)).ravel()
    free = np.setdiff1d(used, clamped)
    inside = [np.abs(one.nodes) < half * 1.001 for one in grids[:2]]
    touching = number[np.ix_(*inside)][:, :, 0].ravel()
    contact = np.searchsorted(free, (3 * touching[:, None] + np.arange(3)).ravel())
    forces = np.zeros((len(free), len(contact)))
    forces[contact, np.arange(len(contact))] = 1.0
    factors = splu(whole[free][:, free], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    displacements = factors.solve(forces)
    x, y, _ = np.unravel_index(touching, shape)
    compliance = displacements[contact]
    return np.stack([grids[0].nodes[x], grids[1].nodes[y]], axis=1), 0.5 * (compliance + compliance.T)


def _assemble(grids: tuple[Grid, Grid, Grid], number: Index, poisson: float, half: float, ridge: float
              ) -> tuple[csc_matrix, Index]:
    """Return the stiffness for E = 1 over all DOFs of the grid, and those DOFs that are in body or ridge."""
    places, values = [], []
    along, across, upwards = grids
    for j, in_y in enumerate(across.members):
        for k, in_z in enumerate(upwards.members):
            beside = abs(across.nodes[in_y].mean()) > half
            if beside and upwards.nodes[in_z].mean() < ridge:
                continue
            for i, in_x in enumerate(along.members):
                nodes = number[np.ix_(in_x, in_y, in_z)].ravel()
                places.append((3 * nodes[:, None] + np.arange(3)).ravel())
                size = np.array([along.sizes[i], across.sizes[j], upwards.sizes[k]])
                values.append(element_stiffness(size, 1.0, poisson).ravel())
    dofs = np.array(places)
    rows, columns = np.repeat(dofs, dofs.shape[1], axis=1), np.tile(dofs, (1, dofs.shape[1]))
    count = 3 * number.size
    return csc_matrix((np.concatenate(values), (rows.ravel(), columns.ravel())), (count, count)), np.unique(dofs)


def write(path: Path = FILE) -> None:
    """Write the nodes and the upper triangle of the compliance times Young's modulus."""
    nodes, compliance = specimen_compliance()
    np.savez_compressed(path, nodes=nodes, compliance=compliance[np.triu_indices(len(compliance))])
    sys.stdout.write(f"{path} written: {len(nodes)} contact nodes\n")


if __name__ == "__main__":
    write()
