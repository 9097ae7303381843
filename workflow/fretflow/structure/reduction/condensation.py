"""Static stiffness of a boundary and the inertia that goes with it, by block elimination of the inside.

With ``A(x) = K + x M`` the boundary's condensed matrix is ``S(x) = A_bb - A_bi A_ii^-1 A_ib``. S(0) is the stiffness
of the constraint modes Psi, its derivative ``S'(0) = [1; Psi]^T M [1; Psi]`` their mass (R. R. Craig, M. C. C. Bampton,
AIAA J. 6 (1968) 1313). Value and first derivative are carried through a nested dissection of the inside (A. George,
SIAM J. Numer. Anal. 10 (1973) 345), each separator being eliminated as one dense front (I. S. Duff, J. K. Reid, ACM
Trans. Math. Softw. 9 (1983) 302), so that no constraint mode is ever formed: three times the work of one factorisation,
instead of two solutions for all boundary DOF.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import blas, lapack

from fretflow.core.compiled import compiled
from fretflow.core.errors import AuditError
from fretflow.core.records import Array

Nodes = NDArray[np.int64]

LEAF = 50  # nodes eliminated at once without being divided further: 40 to 100 took the same time
SAME = 1e-9  # of a set's extent, below which nodes lie in one plane


class _Front(NamedTuple):
    """Nodes of a leaf, or of the separator between two parts that are eliminated before it."""

    own: Nodes
    parts: tuple[_Front, ...]


class _Condensed(NamedTuple):
    """What a part leaves on the DOF next to it: lower triangles of value and derivative; the next DOF in order."""

    rest: Nodes
    value: Array
    derivative: Array
    end: int


def condense(stiffness: sparse.csr_matrix, mass: sparse.csr_matrix, points: Array) -> tuple[Array, Array]:
    """Condense `stiffness` and `mass` onto their last DOF.

    Parameters
    ----------
    stiffness, mass : csr_matrix (3 n + b, 3 n + b)
        Symmetric, in N/m and kg; the inside's DOF first, x, y, z of a node, node after node.
    points : ndarray (n, 3)
        The inside's nodes in m, by which it is divided.

    Returns
    -------
    (ndarray (b, b), ndarray (b, b))
        Condensed stiffness and mass.

    Raises
    ------
    AuditError
        If the inside's stiffness is not positive definite.
    """
    inside = 3 * len(points)
    graph = sparse.csr_matrix(stiffness[:inside:3, :inside:3])
    tree = _divided(np.arange(len(points)), graph, points)
    nodes = np.concatenate(list(_own(tree)))
    order = np.concatenate([(3 * nodes[:, None] + np.arange(3)).ravel(), np.arange(inside, stiffness.shape[0])])
    pencil = tuple(sparse.csr_matrix(one[order][:, order]) for one in (stiffness, mass))
    left = _eliminated(tree, pencil, 0)
    whole = []
    for matrix, part in zip(pencil, (left.value, left.derivative), strict=True):
        lower = np.asfortranarray(np.tril(matrix[inside:, inside:].toarray()))
        add_lower(lower, part, left.rest - inside)
        whole.append(lower + np.tril(lower, -1).T)
    return whole[0], whole[1]


def _divided(nodes: Nodes, graph: sparse.csr_matrix, points: Array) -> _Front:
    """Divide `nodes` again and again at the median of the axis where fewest of them separate the halves."""
    best = None
    for axis in range(3) if len(nodes) > LEAF else ():
        place = points[nodes, axis]
        middle, near = float(np.median(place)), SAME * float(np.ptp(place))
        low = place <= middle + near
        if low.all():
            low = place < middle - near
        if not 0 < low.sum() < len(nodes):
            continue
        beyond = np.zeros(graph.shape[0])
        beyond[nodes[~low]] = 1.0
        between = low & (abs(graph[nodes]) @ beyond > 0.0)
        if best is None or between.sum() < best[1].sum():
            best = low, between
    if best is None:
        return _Front(nodes, ())
    low, between = best
    halves = (nodes[low & ~between], nodes[~low])
    return _Front(nodes[between], tuple(_divided(half, graph, points) for half in halves if half.size))


def _own(tree: _Front) -> list[Nodes]:
    return [nodes for part in tree.parts for nodes in _own(part)] + [tree.own]


def _eliminated(tree: _Front, pencil: tuple[sparse.csr_matrix, ...], start: int) -> _Condensed:
    """Eliminate a part whose DOF begin at `start`, those of the parts within first."""
    condensed = []
    for part in tree.parts:
        condensed.append(_eliminated(part, pencil, start))
        start = condensed[-1].end
    end = start + 3 * len(tree.own)
    rows = [sparse.coo_matrix(matrix[start:end]) for matrix in pencil]
    dofs = np.unique(np.concatenate([np.arange(start, end), *(one.col[one.col >= end] for one in rows),
                                     *(one.rest for one in condensed)]))
    fronts = [_front(one, dofs, start) for one in rows]
    while condensed:
        one = condensed.pop()
        places = np.searchsorted(dofs, one.rest)
        add_lower(fronts[0], one.value, places)
        add_lower(fronts[1], one.derivative, places)
    return _Condensed(dofs[end - start:], *_without(fronts, end - start), end)


def _front(rows: sparse.coo_matrix, dofs: Nodes, start: int) -> Array:
    """Return the lower triangle of a front: the DOF to be eliminated and all that they act on."""
    front = np.zeros((len(dofs), len(dofs)), order="F")
    later = rows.col >= start
    front[np.searchsorted(dofs, rows.col[later]), rows.row[later]] = rows.data[later]
    return front


def _without(fronts: list[Array], count: int) -> tuple[Array, Array]:
    """Eliminate the first `count` DOF of value and derivative, of which the lower triangles are given and returned.

    ``S = C - B A^-1 B^T``, with ``X = B A^-1``: ``S' = C' - X B'^T - B' X^T + X A' X^T``.
    """
    value, derivative = fronts
    fronts.clear()
    if count == 0:  # parts that nothing connects
        return value, derivative
    own, across = value[:count, :count], value[count:, :count]
    factor, failed = lapack.dpotrf(own, lower=1, clean=0)
    if failed:
        raise AuditError("reduction: the inside's stiffness is not positive definite; check the mesh")
    half = blas.dtrsm(1.0, factor, across, side=1, lower=1, trans_a=1)
    kept = np.asfortranarray(value[count:, count:])
    del value
    kept = blas.dsyrk(-1.0, half, beta=1.0, c=kept, lower=1, overwrite_c=1)
    share = blas.dtrsm(1.0, factor, half, side=1, lower=1, overwrite_b=1)
    moved = blas.dsymm(-0.5, derivative[:count, :count], share, side=1, lower=1, beta=1.0,
                       c=np.asfortranarray(derivative[count:, :count]), overwrite_c=1)
    changed = np.asfortranarray(derivative[count:, count:])
    del derivative
    return kept, blas.dsyr2k(-1.0, share, moved, beta=1.0, c=changed, lower=1, overwrite_c=1)


@compiled
def add_lower(front: Array, part: Array, places: Nodes) -> None:
    """Add the lower triangle of `part` (m, m) to `front` at the ascending `places` (m,); both in columns."""
    for j in range(len(places)):
        for i in range(j, len(places)):
            front[places[i], places[j]] += part[i, j]
