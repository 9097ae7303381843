"""Unilateral contact with Coulomb friction along x, one instant at a time: two small active-set problems.

With forces t (upper on lower, along x) and p (pressing apart) and a rigid position X of the arm, the faces move by
``u = X - Fxx t + Fxz p`` against each other. Friction holds t at ``kt (u - w)`` until it reaches its limit, then the
slip w follows. Friction first, with the pressure extrapolated from the two instants before, then pressure: both
are problems with a symmetric positive matrix, whose active sets change by a few nodes from step to step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fretflow_trial.joint import Joint

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

TOGETHER = 8  # rounds in which all nodes may change their state at once
MOST_ROUNDS = 200
EXACT = 1e-16  # m, of slip or gap
Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(loop: Loop) -> Loop:
    """Compile an inner loop at its first call; the machine code is kept where there is a folder for it."""
    try:
        return cast(Loop, njit(cache=True, error_model="numpy")(loop))
    except RuntimeError:
        return cast(Loop, njit(error_model="numpy")(loop))


class UnsettledContactError(RuntimeError):
    """The active set of an instant was not found."""


class Contact:
    """The joint with its asperity springs and, in sliding, the compliance of the rig over one step.

    Parameters
    ----------
    joint : Joint
    sliding_springs, normal_springs : ndarray, shape (n,)
        Asperity stiffness of each node in N/m.
    arm : float
        Displacement of the arm at the end of a step by a unit force there, m/N.
    """

    def __init__(self, joint: Joint, sliding_springs: Array, normal_springs: Array, arm: float) -> None:
        self.joint = joint
        self.springs = sliding_springs
        self.coupled = joint.sliding + np.diag(1.0 / sliding_springs) + arm
        self.normal = joint.normal + np.diag(1.0 / normal_springs)
        self._held: dict[bytes, Array] = {}
        self._pressed: dict[bytes, tuple[Array, Array, float]] = {}

    def friction(self, limit: Array, drive: Array, sliding: Array) -> tuple[Array, Array, Array]:
        """Return forces t (n,), the slip of this step (n,) and the new state.

        Parameters
        ----------
        limit : ndarray
            Friction limit of each node, N.
        drive : ndarray
            Displacement of the faces without friction, less the slip so far, m.
        sliding : ndarray
            Guess: -1, 0 (held) or 1, the sign of the friction force.
        """
        n = len(limit)
        for rounds in range(MOST_ROUNDS):
            force, left, over, back = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
            held = sliding == 0.0
            if slide(self.coupled, self._inverse_held(held), limit, drive, sliding, force, left, over, back):
                return force, left, sliding
            wrong = (over > 1e-12 * (1.0 + limit)) | (back > EXACT)
            if rounds >= TOGETHER:
                wrong = self._worst(over / (1e-12 + limit.max()), back / (1e-12 + np.abs(drive).max()))
            sliding = np.where(wrong, np.where(held, np.sign(force), 0.0), sliding)
        raise UnsettledContactError("friction: no state of the nodes fits; take shorter steps")

    def press(self, load: float, rise: Array, closed: Flags) -> tuple[Array, float, Flags]:
        """Return pressing forces (n,), the approach of the bodies and which nodes touch.

        `rise` (n,) in m is by how much each node stands out: friction's lift less the gap.
        """
        for rounds in range(MOST_ROUNDS):
            inverse, row, total = self._inverse_pressed(closed)
            force, pulled, through = np.empty(len(rise)), np.empty(len(rise)), np.empty(len(rise))
            approach = balance(self.normal, inverse, row, total, load, rise, closed, force, pulled, through)
            if not np.isnan(approach):
                return force, approach, closed
            approach = float((load - (inverse @ rise).sum()) / total)
            wrong = (pulled > 1e-12 * load) | (through > EXACT)
            if rounds >= TOGETHER:
                wrong = self._worst(pulled / load, through / np.abs(approach))
            closed = np.where(wrong, ~closed, closed)
            if not closed.any():
                closed = rise == rise.max()
        raise UnsettledContactError("pressure: no state of the nodes fits; take shorter steps")

    def reshaping(self, closed: Flags) -> Array:
        """Return by how much wear of each node (columns) takes pressing force off each node, (n, n) N/m."""
        inverse, row, total = self._inverse_pressed(closed)
        return np.asarray(inverse - np.outer(row, row) / total)

    @staticmethod
    def _worst(first: Array, second: Array) -> Flags:
        both = np.maximum(first, second)
        return np.asarray(np.arange(len(both)) == np.argmax(both))

    def _inverse_held(self, held: Flags) -> Array:
        key = held.tobytes()
        if key not in self._held:
            self._held[key] = padded_inverse(self.coupled, held)
        return self._held[key]

    def _inverse_pressed(self, closed: Flags) -> tuple[Array, Array, float]:
        key = closed.tobytes()
        if key not in self._pressed:
            inverse = padded_inverse(self.normal, closed)
            row = inverse.sum(axis=1)
            self._pressed[key] = inverse, row, float(row.sum())
        return self._pressed[key]


def padded_inverse(matrix: Array, part: Flags) -> Array:
    """Return the inverse of the rows and columns in `part`, zero elsewhere, (n, n)."""
    whole = np.zeros_like(matrix)
    pick = np.ix_(part, part)
    whole[pick] = np.linalg.inv(matrix[pick])
    return whole


@compiled
def slide(coupled: Array, inverse: Array, limit: Array, drive: Array, sliding: Array, force: Array, left: Array,
          over: Array, back: Array) -> bool:
    """Find forces (N) and slip (m) for a state of the nodes, all (n,); return whether the state fits.

    `over` is by how much a held node is beyond its limit, N, `back` by how much a sliding one slips the wrong way, m.
    """
    n, fits = len(limit), True
    for i in range(n):
        force[i] = limit[i] * sliding[i]
    for i in range(n):
        left[i] = drive[i]
        for k in range(n):
            left[i] -= coupled[i, k] * force[k]
    for i in range(n):
        if sliding[i] == 0.0:
            for k in range(n):
                force[i] += inverse[i, k] * left[k]
    for i in range(n):
        over[i], back[i], push = 0.0, 0.0, 0.0
        if sliding[i] == 0.0:
            over[i], left[i] = abs(force[i]) - limit[i], 0.0
            fits = fits and over[i] <= 1e-12 * (1.0 + limit[i])
        else:
            for k in range(n):
                push += coupled[i, k] * force[k]
            left[i] = drive[i] - push
            back[i] = -left[i] * sliding[i]
            fits = fits and back[i] <= EXACT
    return fits


@compiled
def balance(normal: Array, inverse: Array, row: Array, total: float, load: float, rise: Array, closed: Flags,
            force: Array, pulled: Array, through: Array) -> float:
    """Find the pressing forces (n,) for a state of the nodes; return the approach in m, nan if the state does not fit.

    `pulled` is how hard a closed node pulls, N, `through` how deep an open one penetrates, m.
    """
    n, whole, fits = len(rise), 0.0, True
    for i in range(n):
        force[i] = 0.0
        for k in range(n):
            force[i] += inverse[i, k] * rise[k]
        whole += force[i]
    approach = (load - whole) / total
    for i in range(n):
        force[i] += approach * row[i]
    for i in range(n):
        pulled[i], through[i] = 0.0, 0.0
        if closed[i]:
            pulled[i] = -force[i]
            fits = fits and pulled[i] <= 1e-12 * load
        else:
            gap = -rise[i] - approach
            for k in range(n):
                gap += normal[i, k] * force[k]
            through[i] = -gap
            fits = fits and through[i] <= EXACT
    return approach if fits else np.nan
