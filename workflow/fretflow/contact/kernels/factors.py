"""LU factors of the contact's equations that follow its state from sample to sample, and Newton's steps by them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.equations import SLIP, STICK, Array, Contact, Indices, States, add, change_of, dot
from fretflow.core.compiled import compiled, factorise, multiply_symmetric, substitute

NONE = -1  # size of factors that there are not, place of a DOF that is none of the unknowns
SECANTS = 12  # that are kept, and directions in which a step of Newton's is sought
OWN = 0.1  # share of a secant that those before must not tell already: a smaller one would amplify the curvature
CLOSE = 0.05  # residual of a step so found: about what kept factors contract by, so that less would gain nothing
HALFWAY = CLOSE**0.5  # that after half of the directions, beyond which they lead nowhere
WORTH = 100  # nodes from which factors are made to follow; below, new ones cost no more
STEPS = 50  # new factors of q equations cost q / 50 products with the stiffness: measured q / 26 to q / 62


class Factor(NamedTuple):
    """LU factors that follow the contact state (n,) by bordering.

    The matrix (3 n, 3 n) holds the factors of size[0] equations, `NONE` if there are none. At each place among them is
    a DOF, in `order` (3 n,), of a node in the state `kind` (3 n,), or ``-1 - p`` where the unknown of an earlier place
    p is one no more: a multiplier that keeps it still. What a change of the state asks for is appended as a block that
    begins at `block` (3 n,). `place` (3 n,) is where the equation of a DOF stands. Rows and columns of earlier blocks
    are those of earlier samples; whether they still serve, how fast Newton converges tells. size[2] counts the
    products that were spent on them as preconditioners since all were new.

    For Newton's steps they are in single precision, which takes half the time; derivatives need double. Those of Newton
    are corrected by secants, of which size[1] were seen: the change of the residual, orthonormal, and the `steps`
    (s, 3 n) that made it (V. Eyert, J. Comput. Phys. 124 (1996) 271-285).
    """

    matrix: NDArray[np.floating[Any]]
    pivots: NDArray[np.int32]
    state: States
    kind: States
    order: Indices
    block: Indices
    place: Indices
    size: Indices
    steps: Array
    changes: Array


def empty_factor(nodes: int, single: bool = False) -> Factor:
    """Return room for the factors of any state of n nodes, in double precision or single."""
    size = 3 * nodes
    matrix: NDArray[np.floating[Any]] = np.empty((size, size), dtype=np.float32 if single else np.float64)
    steps, changes = np.empty((2, SECANTS if single and nodes >= WORTH else 0, size))
    order, block, place = np.full((3, size), NONE, dtype=np.int64)
    return Factor(matrix, np.empty(size, dtype=np.int32), np.empty(nodes, dtype=np.int8), np.empty(size, dtype=np.int8),
                  order, block, place, np.full(3, NONE, dtype=np.int64), steps, changes)


@compiled
def alike(a: States, b: States) -> bool:
    """Tell whether two states are the same."""
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


@compiled
def copy_state(source: States, target: States) -> None:
    """Copy a state; plain loops compile faster than array assignments."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled
def reusable(factor: Factor, state: States) -> int:
    """Return how many places of the factors, by whole blocks, the factors of `state` begin with at the least cost."""
    places, away = factor.size[0], 0  # away: unknowns by which the places so far and the state differ
    for i in range(len(state)):
        away += 0 if state[i] == STICK else 2 if state[i] == SLIP else 3
    best, least = 0, 2.0 / 3.0 * away**3
    for p in range(1, places + 1):
        its = factor.order[p - 1]
        own = its if its >= 0 else factor.order[-1 - its]
        kind = factor.kind[p - 1 if its >= 0 else -1 - its]
        away += 1 if (its >= 0) != (state[own // 3] == kind) else -1
        if (p == places or factor.block[p] == p) and p + away <= len(factor.order):
            cost = 2.0 * p * away * (p + away) + 2.0 / 3.0 * away**3
            if cost <= least:
                best, least = p, cost
    return best


@compiled
def _append(factor: Factor, state: States, kept: int) -> int:
    """Append to the first `kept` places, as one block, what makes their unknowns those of `state`; return the sum."""
    order, block, place, q = factor.order, factor.block, factor.place, kept
    for k in range(len(place)):
        place[k] = NONE
    for p in range(kept):
        if order[p] >= 0:
            place[order[p]] = p
        else:
            place[order[-1 - order[p]]] = NONE
    for p in range(kept):
        if order[p] >= 0 and place[order[p]] == p and state[order[p] // 3] != factor.kind[p]:
            order[q], block[q], place[order[p]] = -1 - p, kept, NONE
            q += 1
    for i in range(len(state)):
        if state[i] != STICK and place[3 * i] == NONE:
            for k in range(2 if state[i] == SLIP else 3):
                order[q], block[q], factor.kind[q], place[3 * i + k] = 3 * i + k, kept, state[i], q
                q += 1
    return q


@compiled
def _derive(c: Contact, trial: Array, cone: Array, factor: Factor, p: int, first: int,
            column: NDArray[np.floating[Any]]) -> None:
    """Put the derivative of the equations from place `first` on, by the unknown at place p, into its column (q,)."""
    order, rho, r = factor.order, c.penalty, first
    if order[p] < 0:
        for r in range(first, len(column)):
            column[r] = 1.0 if r == -1 - order[p] else 0.0
        return
    g, own = c.stiffness[order[p]], order[p] // 3
    while r < len(column):
        if order[r] < 0:
            column[r] = 1.0 if -1 - order[r] == p else 0.0
            r += 1
            continue
        i = order[r] // 3
        if factor.kind[r] != SLIP:
            for k in range(3):
                column[r + k] = g[3 * i + k]
            r += 3
            continue
        x, y, a, b = trial[0, i], trial[1, i], cone[2, i], cone[3, i]
        fx, fy, fz = g[3 * i], g[3 * i + 1], cone[1, i] * g[3 * i + 2]
        column[r] = fx * (1.0 - a * y) + fy * (a * x) - fz * x
        column[r + 1] = fy * (1.0 + b * x) - fx * (b * y) - fz * y
        if i == own:
            across = rho * (y if order[p] == 3 * i else -x)
            column[r] += a * across
            column[r + 1] += b * across
        r += 2


@compiled
def factorise_state(c: Contact, trial: Array, cone: Array, state: States, factor: Factor, kept: int) -> bool:
    """Factorise the derivative of the residual by the unknowns of `state`; return whether it is regular.

    The first `kept` places stay as they are; there has to be a block's end.
    """
    q = _append(factor, state, kept)
    columns = factor.matrix[:q]
    for p in range(q):
        _derive(c, trial, cone, factor, p, kept if p < kept else 0, columns[p, :q])
    factor.size[0], factor.size[1] = q, 0
    if kept == 0:
        factor.size[2] = 0
    copy_state(state, factor.state)
    return q == kept or factorise(columns, factor.pivots[:q], kept)


@compiled
def solve(factor: Factor, unknown: Indices, columns: Array) -> None:
    """Replace right-hand sides of the equations of `unknown` (q,), by columns (p, q), by the solutions."""
    p, q = columns.shape
    if q == 0:
        return
    placed = np.zeros((p, factor.size[0]), dtype=factor.matrix.dtype)
    for k in range(p):
        for r in range(q):
            placed[k, factor.place[unknown[r]]] = columns[k, r]
    substitute(factor.matrix[:factor.size[0]], factor.pivots[:factor.size[0]], placed)
    for k in range(p):
        for r in range(q):
            columns[k, r] = placed[k, factor.place[unknown[r]]]


@compiled
def learn(factor: Factor, step: Array, change: Array) -> None:
    """Take in that the residual changed by `change` (q,) with a `step` (q,) of the unknowns; both are overwritten."""
    if not len(factor.steps):
        return
    q, place = len(step), factor.size[1] % len(factor.steps)
    size = np.sqrt(dot(change, change))
    for k in range(min(factor.size[1], len(factor.steps))):
        if k != place:
            share = dot(factor.changes[k, :q], change)
            add(change, -share, factor.changes[k, :q])
            add(step, -share, factor.steps[k, :q])
    rest = np.sqrt(dot(change, change))
    if rest > OWN * size:
        for r in range(q):
            factor.changes[place, r], factor.steps[place, r] = change[r] / rest, step[r] / rest
        factor.size[1] += 1


@compiled
def newton_step(factor: Factor, unknown: Indices, residual: Array) -> Array:
    """Return the change of the unknowns (q,) that the secants, and for the rest the factors, expect of a residual."""
    q = len(residual)
    step, rest = np.zeros(q), residual.copy()
    for k in range(min(factor.size[1], len(factor.steps))):
        share = dot(factor.changes[k, :q], rest)
        add(rest, -share, factor.changes[k, :q])
        add(step, -share, factor.steps[k, :q])
    solve(factor, unknown, rest.reshape(1, -1))
    for r in range(q):
        step[r] -= rest[r]
    return step


@compiled
def krylov_step(c: Contact, trial: Array, cone: Array, m: int, unknown: Indices, factor: Factor, residual: Array
                ) -> tuple[bool, Array]:
    """Return whether Newton's step (q,) was found with the factors as preconditioner, and that step.

    By generalised conjugate residuals (S. C. Eisenstat, H. C. Elman, M. H. Schultz, SIAM J. Numer. Anal. 20 (1983)
    345-357) of the derivative here, which the factors only resemble; its directions are the secants henceforth.
    """
    q, rest, step = len(residual), residual.copy(), np.zeros(len(residual))
    u, f, change = np.zeros(3 * len(c.gap)), np.empty(3 * len(c.gap)), np.empty(q)
    size = np.sqrt(dot(rest, rest))
    factor.size[1] = 0
    for k in range(len(factor.steps)):
        trying = rest.copy()
        solve(factor, unknown, trying.reshape(1, -1))
        for r in range(q):
            u[unknown[r]] = trying[r]
        multiply_symmetric(c.stiffness, u, f)
        change_of(c, trial, cone, m, unknown, trying, f, change)
        learn(factor, trying, change)
        factor.size[2] += 1
        if factor.size[1] == k:
            break
        share = dot(factor.changes[k, :q], rest)
        add(rest, -share, factor.changes[k, :q])
        add(step, -share, factor.steps[k, :q])
        left = np.sqrt(dot(rest, rest))
        if left < CLOSE * size:
            return True, step
        if 2 * (k + 1) >= len(factor.steps) and left > HALFWAY * size:
            break
    return False, step


@compiled
def step_by(c: Contact, trial: Array, cone: Array, m: int, unknown: Indices, state: States, factor: Factor,
            residual: Array, poor: bool) -> tuple[bool, Array]:
    """Return whether the equations are regular, and a step (q,) of Newton's by the factors, which follow the state.

    Where they are `poor`, having contracted the residual too little, or bordered, they only precondition; they are made
    anew where that fails, or has cost as much as new ones since they were.
    """
    known = factor.size[0] != NONE and alike(factor.state, state)
    if known and not poor:
        return True, newton_step(factor, unknown, residual)
    if len(factor.steps) and factor.size[0] != NONE and factor.size[2] * STEPS <= len(unknown):
        kept = factor.size[0] if known else reusable(factor, state)
        if kept and (known or factorise_state(c, trial, cone, state, factor, kept)):
            found, step = krylov_step(c, trial, cone, m, unknown, factor, residual)
            if found:
                return True, step
    if not factorise_state(c, trial, cone, state, factor, 0):
        factor.size[0] = NONE
        return False, residual
    return True, newton_step(factor, unknown, residual)
