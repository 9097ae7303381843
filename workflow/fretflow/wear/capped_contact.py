"""Normal contact whose pressure is capped where the faces wear.

At a uniform wear rate r the pressure of a wearing node is r / (K_w s), s its slip path. So the worn face is
that of a contact with a pressure cap, the wear depth being the multiplier of the cap, as plastic
indentation would be::

    gap_m = base_m + w_m + q + (F f)_m >= 0,   0 <= f_m <= r cap_m,   sum f = N
    gap_m > 0: f_m = 0 (open);   w_m > 0: f_m = r cap_m (worn);   else closed, w_m = 0

which for a given r is a convex quadratic programme, and for a given volume has one r more to find. Where the
surroundings hold the faces instead of the load N, there is no q. It is solved by changing the three sets until they
hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import NonConvergenceError

MAX_SET_CHANGES = 200


@dataclass(frozen=True)
class CappedContact:
    """The contact problem; arrays (nodes,) unless noted.

    Attributes
    ----------
    flexibility : ndarray, shape (nodes, nodes), m/N
        Normal flexibility F.
    base : ndarray, m
        Gap without forces, wear or vertical motion; a constant in it does not matter.
    cap : ndarray, N cycle/m
        Largest force per wear rate, ``a / (K_w s)``; inf at a node that sticks, which never wears.
    areas : ndarray, m^2
        Contact areas.
    load : float or None, N
        Normal load; None where the surroundings hold the faces, so that there is no vertical motion q either.
    """

    flexibility: NDArray[np.float64]
    base: NDArray[np.float64]
    cap: NDArray[np.float64]
    areas: NDArray[np.float64]
    load: float | None


@dataclass(frozen=True)
class CappedSolution:
    """Forces (nodes,), N, depths (nodes,), m, and the uniform rate in m/cycle."""

    force: NDArray[np.float64]
    depth: NDArray[np.float64]
    rate: float


def solve_capped_contact(contact: CappedContact, volume: float, worn: NDArray[np.bool_],
                         closed: NDArray[np.bool_]) -> CappedSolution:
    """Return the face worn by `volume` (m^3) at a uniform rate, or by less at a rate of zero.

    Where sticking nodes can carry the load alone, wear ends at a finite volume: the wearing nodes then just
    touch. A larger `volume` gives that face. `worn` and `closed` (closed but not worn) are the sets to
    begin with.

    Raises
    ------
    NonConvergenceError
        If the sets do not settle.
    """
    wearable = np.isfinite(contact.cap)
    cap = np.where(wearable, contact.cap, 0.0)
    worn, closed = worn & wearable, closed | (worn & ~wearable)
    ended = False
    for _ in range(MAX_SET_CHANGES):
        force, overlap, rate = _hold_sets(contact, cap, np.inf if ended else volume, worn, closed)
        if rate < 0.0:
            ended = True
            continue
        now_worn = wearable & ((worn & (overlap > 0.0)) | (closed & (force > rate * cap)))
        now_closed = ~now_worn & ((closed & (force > 0.0)) | (~closed & ~worn & (overlap > 0.0)) | worn)
        if np.array_equal(now_worn, worn) and np.array_equal(now_closed, closed):
            return CappedSolution(force, np.where(worn, overlap, 0.0), rate)
        worn, closed = now_worn, now_closed
    raise NonConvergenceError(f"uniformly worn contact: no sets hold after {MAX_SET_CHANGES} changes")


def _hold_sets(contact: CappedContact, cap: NDArray[np.float64], volume: float, worn: NDArray[np.bool_],
               closed: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return forces, overlaps ``-(base + q + F f)`` and the rate with both sets held; volume inf: rate 0.

    Unknowns: forces of the closed nodes, q and the rate; equations: no gap there, the load, the volume.
    """
    c, v = np.flatnonzero(closed), np.flatnonzero(worn)
    flexibility, areas = contact.flexibility, contact.areas
    by_rate = flexibility[:, v] @ cap[v]
    matrix = np.zeros((c.size + 2, c.size + 2))
    matrix[:-2] = np.column_stack([flexibility[np.ix_(c, c)], np.ones(c.size), by_rate[c]])
    held = contact.load is not None
    matrix[-2] = np.r_[np.ones(c.size), 0.0, cap[v].sum()] if held else np.r_[np.zeros(c.size), 1.0, 0.0]
    right = np.r_[-contact.base[c], contact.load if held else 0.0, 0.0]
    if np.isfinite(volume) and v.size:
        matrix[-1] = -np.r_[areas[v] @ flexibility[np.ix_(v, c)], areas[v].sum(), areas[v] @ by_rate[v]]
        right[-1] = volume + areas[v] @ contact.base[v]
    else:
        matrix[-1, -1] = 1.0
    *closed_forces, q, rate = np.linalg.solve(matrix, right)
    force = np.zeros(len(cap))
    force[c], force[v] = closed_forces, rate * cap[v]
    return force, -(contact.base + q + flexibility @ force), float(rate)
