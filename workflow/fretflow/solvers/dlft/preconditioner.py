"""Approximate inverse of the DLFT Jacobian ``J = (I - D) Z + eps D``, D being block diagonal by nodes.

Split the stiffness into a part of each node by itself, kappa, and the rest. The node's own part of the Jacobian, ``L =
(I - D) kappa + eps D``, is inverted exactly with all harmonics and directions coupled, which leaves ``L^-1 J = I + S (Z
- kappa)`` with ``S = L^-1 (I - D)``. Of S the blocks that couple harmonics are dropped there. The others differ little:
from the fourth harmonic on they are averaged over each octave (4 to 7, 8 to 15, ...), and one real matrix is factored
for each of these bands, and one for each lower harmonic, at which the rig moves differently. It is exact where nodes
stick (S = 0) and where they slide freely or are open (D = 0).

Where S is zero (normal DOFs in contact all the time, stuck nodes) the row is that of the identity, and the DOF is not
factored. Damping is left out and precision is single; both cost a few iterations. So does keeping these matrices where
states have changed since they were factored, if L is made anew: it holds what changes most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

OWN_SHARE = 0.5  # of a node's stiffness with its neighbours held that kappa takes; least iterations, 0.25 to 1 tried
ALONE = 4  # harmonics from 0 on with matrices of their own, a power of two; with 1 a fifth more iterations
HELD = 1e-5  # of S relative to 1 / kappa: below it, in single precision, a DOF is held

Single = NDArray[np.float32]


class _KeptFactors(NamedTuple):
    """DOFs that were factored or held, and for each band the factors and the rows across (free, held)."""

    free: NDArray[np.int64]
    held: NDArray[np.int64]
    factors: list[tuple[Single, NDArray[np.int32]]]
    across: list[Single]

    def cover(self, free: NDArray[np.int64]) -> bool:
        """Return whether these are the factors of most DOFs that are free now."""
        return bool(2 * np.isin(free, self.free, assume_unique=True).sum() >= free.size)


class NodePreconditioner:
    """Applies the approximate inverse to flat vectors (2 H + 1, 3 n).

    Parameters
    ----------
    derivative
        D (nodes, 2 H + 1, 3, 2 H + 1, 3).
    stiffness
        Real parts of Z, (3 n, 3 n) in N/m at the first harmonic of each band.
    penalty
        eps in N/m, () or (nodes,).
    before
        Another state's, of the same joint, whose factors are kept; else they are made.
    """

    def __init__(self, derivative: NDArray[np.float64], stiffness: Sequence[Single],
                 penalty: NDArray[np.float64] | float, before: NodePreconditioner | None = None) -> None:
        nodes, q = derivative.shape[:2]
        self._shape = (nodes, q)
        own = OWN_SHARE * stiffness[-1].reshape(nodes, 3, nodes, 3)[np.arange(nodes), :, np.arange(nodes)]
        single = derivative.astype(np.float32)
        self._inverse, sliding = _node_inverses(single, own, np.broadcast_to(np.float32(penalty), nodes))
        shares = _shares(self._inverse, sliding)
        size = np.abs(shares).max(axis=(0, 3)) * np.abs(own).max(axis=(1, 2))[:, None]
        free = np.flatnonzero((size > HELD).ravel())
        self._kept: _KeptFactors = (before._kept if before is not None and before._kept.cover(free)
                                 else _factored(shares, stiffness, own, free))

    def __call__(self, flat: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the approximate solution of ``J x = flat``."""
        nodes, q = self._shape
        right = flat.reshape(q, nodes, 3).transpose(1, 0, 2).reshape(nodes, 3 * q, 1).astype(np.float32)
        v = (self._inverse @ right).reshape(nodes, q, 3).transpose(1, 0, 2).reshape(q, 3 * nodes)
        free, held = self._kept.free, self._kept.held
        for first, end, factor, across in zip(*bands(q // 2), self._kept.factors, self._kept.across,
                                              strict=bool(free.size)):
            part = slice(max(0, 2 * first - 1), 2 * end - 1)
            known = v[part, free] - v[part, held] @ across.T
            v[part, free] = lu_solve(factor, known.T, overwrite_b=True, check_finite=False).T
        return np.asarray(v.ravel(), dtype=float)


def bands(harmonics: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the first of 0..`harmonics` that share a matrix, and the harmonics at which these bands end."""
    octaves = (2**i for i in range(ALONE.bit_length() - 1, harmonics.bit_length()))
    first = (*range(min(ALONE, harmonics + 1)), *octaves)
    return first, (*first[1:], harmonics + 1)


def _factored(shares: Single, stiffness: Sequence[Single], own: Single, free: NDArray[np.int64]) -> _KeptFactors:
    """Factor the rows of the `free` DOFs, one matrix a band."""
    held, factors, across = np.setdiff1d(np.arange(3 * len(own)), free), [], []
    for first, end, matrix in zip(*bands(len(shares) - 1), stiffness, strict=True) if free.size else ():
        rows = _rest(shares[first:end].mean(axis=0), matrix, own, free)
        inner = rows[:, free]
        inner[np.arange(len(inner)), np.arange(len(inner))] += np.float32(1.0)
        factors.append(lu_factor(inner, overwrite_a=True, check_finite=False))
        across.append(rows[:, held])
    return _KeptFactors(free, held, factors, across)


def _rest(share: Single, matrix: Single, own: Single, free: NDArray[np.int64]) -> Single:
    """Return the rows of the `free` DOFs of ``S (Z - kappa)``; `share` is S by node, (nodes, 3, 3)."""
    nodes = len(own)
    product = (share @ matrix.reshape(nodes, 3, -1)).reshape(nodes, 3, nodes, 3)
    product[np.arange(nodes), :, np.arange(nodes)] -= share @ own
    return np.asarray(product.reshape(3 * nodes, -1)[free])


def _node_inverses(derivative: Single, own: Single, penalty: Single) -> tuple[Single, Single]:
    """Return L^-1 and ``I - D``, (nodes, 3 q, 3 q)."""
    nodes, q = derivative.shape[:2]
    contact = derivative.reshape(nodes, 3 * q, 3 * q)
    sliding = np.eye(3 * q, dtype=np.float32) - contact
    local = (sliding.reshape(nodes, 3 * q * q, 3) @ own).reshape(nodes, 3 * q, 3 * q) + penalty[:, None, None] * contact
    return np.linalg.inv(local), sliding


def _shares(inverse: Single, sliding: Single) -> Single:
    """Return the blocks of S on the diagonal, (H + 1, nodes, 3, 3)."""
    nodes, q = len(inverse), inverse.shape[1] // 3
    left, right = inverse.reshape(nodes, q, 3, 3 * q), sliding.reshape(nodes, 3 * q, q, 3)
    shares = left.transpose(1, 0, 2, 3) @ right.transpose(2, 0, 1, 3)
    return np.concatenate([shares[:1], np.float32(0.5) * (shares[1::2] + shares[2::2])])
