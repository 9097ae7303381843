"""Frictional contact under static loads, compiled: one step of load after another.

Contact forces ``f = K u - r`` under the load r (3 n,), DOF in component order as in `contact.kernels.sample`. The
unknowns are x and y of the slipping nodes and all of the open ones; Newton on them alternates with the states that the
trial forces ask for (P. Alart, A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353). A step where that goes
round in circles is made in parts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.cone import limit
from fretflow.contact.law import ContactState
from fretflow.core.compiled import compiled, factorise, largest, multiply_symmetric, substitute
from fretflow.core.records import Array

States = NDArray[np.int8]
Indices = NDArray[np.int64]
STICK, SLIP, SEPARATION = int(ContactState.STICK), int(ContactState.SLIP), int(ContactState.SEPARATION)
CAREFUL = 14  # iterations, after which one point changes its state at a time, as states go round in circles
PIVOTS = 3  # times as many iterations as there are points may follow
MOST_PARTS = 10  # of a step of load, which then is some eighth of it: beyond, no equilibrium is near


class StaticContact(NamedTuple):
    """Stiffness K (3 n, 3 n) in N/m, gap (n,) in m, Coulomb's law as in `contact.coulomb`, penalty in N/m."""

    stiffness: Array
    gap: Array
    friction: Array
    reference: Array
    exponent: float
    asymmetry: float
    penalty: float


@compiled
def _limit(c: StaticContact, i: int, normal: float, along: float) -> tuple[float, float]:
    """Return the friction limit at node i and its derivative by the normal force, direction of the force `along` x."""
    return limit((c.friction[i], c.reference[i], c.exponent, c.asymmetry), 1.0, normal, along)


@compiled
def _forces(c: StaticContact, load: Array, u: Array, f: Array, before: Array, state: States, trial: Array) -> None:
    """Put the known DOF where their state wants them; contact forces and trial forces (3, n) follow."""
    n = len(c.gap)
    for i in range(n):
        if state[i] != SEPARATION:
            u[2 * n + i] = -c.gap[i]
        if state[i] == STICK:
            u[i], u[n + i] = before[i], before[n + i]
    multiply_symmetric(c.stiffness, u, f)
    for i in range(3 * n):
        f[i] -= load[i]
    for i in range(n):
        x, y = f[i] - c.penalty * (u[i] - before[i]), f[n + i] - c.penalty * (u[n + i] - before[n + i])
        size = max(np.hypot(x, y), 1e-300)
        trial[0, i], trial[1, i], trial[2, i] = x / size, y / size, size


@compiled
def _asked(c: StaticContact, u: Array, f: Array, trial: Array, used: Array, state: States, tolerance: float, one: bool
           ) -> bool:
    """Put the states that the trial forces ask for into `state`; return whether any is another one.

    Within the tolerance a point keeps its state, as there both give the same forces. With `one` the point changes that
    violates its state most, and no other. One whose trial force turned against the direction `used` (3, n), in which it
    was to slide, would slide with its friction instead of against it: it sticks.
    """
    n, changed, most, place, its = len(c.gap), False, 0.0, -1, SEPARATION
    for i in range(n):
        pressing = f[2 * n + i] - c.penalty * (c.gap[i] + u[2 * n + i])
        asked, violation = SEPARATION, -pressing
        if pressing > (tolerance if state[i] == SEPARATION else -tolerance):
            beyond = trial[2, i] - _limit(c, i, max(pressing, 0.0), trial[0, i])[0]
            turned = state[i] == SLIP and trial[0, i] * used[0, i] + trial[1, i] * used[1, i] < 0.0
            asked = STICK if turned or beyond < (-tolerance if state[i] == SLIP else tolerance) else SLIP
            violation = pressing if state[i] == SEPARATION else abs(beyond)
        if state[i] != asked:
            changed = True
            if not one:
                state[i] = asked
            elif violation > most:
                most, place, its = violation, i, asked
    if place >= 0:
        state[place] = its
    return changed


@compiled
def _unknowns(state: States) -> tuple[int, Indices]:
    n = len(state)
    m, o = 0, 0
    for i in range(n):
        m += state[i] == SLIP
        o += state[i] == SEPARATION
    unknown = np.empty(2 * m + 3 * o, dtype=np.int64)
    a, b = 0, 2 * m
    for i in range(n):
        if state[i] == SLIP:
            unknown[a], unknown[m + a] = i, n + i
            a += 1
        elif state[i] == SEPARATION:
            unknown[b], unknown[b + o], unknown[b + 2 * o] = i, n + i, 2 * n + i
            b += 1
    return m, unknown


@compiled
def _residual(c: StaticContact, f: Array, trial: Array, m: int, unknown: Indices) -> Array:
    n, residual = len(c.gap), np.empty(len(unknown))
    for k in range(2 * m, len(unknown)):
        residual[k] = f[unknown[k]]
    for k in range(m):
        i = unknown[k]
        radius = _limit(c, i, max(f[2 * n + i], 0.0), trial[0, i])[0]
        residual[k], residual[m + k] = f[i] - radius * trial[0, i], f[n + i] - radius * trial[1, i]
    return residual


@compiled
def _differentiate(c: StaticContact, f: Array, trial: Array, m: int, unknown: Indices, columns: Array) -> None:
    """Put the derivative of the residual into `columns` (q, q), a row for each unknown."""
    n, q, rho = len(c.gap), len(unknown), c.penalty
    for r in range(q):
        g = c.stiffness[unknown[r]]
        for k in range(2 * m, q):
            columns[r, k] = g[unknown[k]]
    for k in range(m):
        i = unknown[k]
        x, y = trial[0, i], trial[1, i]
        radius, slope = _limit(c, i, max(f[2 * n + i], 0.0), x)
        # tau turns by w across itself: the limit's force changes by w times the direction below
        turned = radius / trial[2, i]
        plain = radius / max(1.0 - c.asymmetry * x, 1e-300)
        ax = -turned * y + c.asymmetry * plain / trial[2, i] * y * x
        ay = turned * x + c.asymmetry * plain / trial[2, i] * y * y
        for r in range(q):
            g = c.stiffness[unknown[r]]
            fx, fy, fz = g[i], g[n + i], slope * g[2 * n + i]
            if unknown[r] == i:
                fx_t, fy_t = fx - rho, fy
            elif unknown[r] == n + i:
                fx_t, fy_t = fx, fy - rho
            else:
                fx_t, fy_t = fx, fy
            turn = -y * fx_t + x * fy_t
            columns[r, k] = fx - fz * x - ax * turn
            columns[r, m + k] = fy - fz * y - ay * turn


@compiled
def _step(c: StaticContact, load: Array, before: Array, u: Array, f: Array, state: States, tolerance: float,
          careful: int, most: int) -> bool:
    """Find displacement, force and state under `load` after the displacement `before`; they hold the guess.

    After `careful` of at `most` so many iterations one point changes its state at a time.
    """
    n = len(state)
    trial, used = np.empty((3, n)), np.zeros((3, n))
    matrix, pivots = np.empty(9 * n * n), np.empty(3 * n, dtype=np.int32)
    _forces(c, load, u, f, before, state, trial)
    for iteration in range(most):
        settled = iteration > 0 and not _asked(c, u, f, trial, used, state, tolerance, iteration > careful)
        if iteration > 0 and not settled:
            _forces(c, load, u, f, before, state, trial)
        used[:] = trial
        m, unknown = _unknowns(state)
        q = len(unknown)
        residual = _residual(c, f, trial, m, unknown)
        if settled and largest(residual) < tolerance:
            return True
        if q > 0:
            columns = matrix[:q * q].reshape(q, q)
            _differentiate(c, f, trial, m, unknown, columns)
            if not factorise(columns, pivots[:q]):
                return False
            substitute(columns, pivots[:q], residual.reshape(1, -1))
            for k in range(q):
                u[unknown[k]] -= residual[k]
        _forces(c, load, u, f, before, state, trial)
    return False


@compiled
def _hold_still(state: States) -> None:
    """Let nothing slide in a guess of the states, as where loads turn back."""
    for i in range(len(state)):
        if state[i] == SLIP:
            state[i] = STICK


@compiled
def follow_loads(c: StaticContact, loads: Array, start: Array, under: Array, first: States, guess: States,
                 tolerance: float, u: Array, f: Array, state: States) -> int:
    """Find contact displacement and force under each of the `loads` (S, 3 n) in turn, from `start` (3 n,) on.

    Parameters
    ----------
    start, under, first
        Displacement before the first load, the load there (3 n,), and a guess of the states (n,) under it.
    guess
        Of the states under each load (S, n), tried before those of the load before until one is wrong; or none (0, n).
    tolerance
        Of the forces, N.
    u, f, state
        Results (S, 3 n), (S, 3 n), (S, n); u is what slid where springs are in series.

    Returns
    -------
    int
        The number of loads that were found.
    """
    steps, guessing = len(state), len(guess) > 0
    from_load, reached, held, more = under.copy(), start.copy(), first.copy(), PIVOTS * len(first)
    for j in range(steps):
        parts, converged = 0 if guessing else 1, False
        while parts <= MOST_PARTS and not converged:
            if parts < 2:
                u[j], state[j] = reached, held if parts else guess[j]
                converged = _step(c, loads[j], reached, u[j], f[j], state[j], tolerance, CAREFUL,
                                  CAREFUL + more * parts)
            else:
                here, state[j] = reached.copy(), held
                converged = True
                for part in range(1, max(parts, 3) - 1):
                    if converged:
                        load = from_load + (loads[j] - from_load) * (part / (max(parts, 3) - 2))
                        _hold_still(state[j])
                        u[j] = here
                        careful = CAREFUL if parts == 2 else 0
                        converged = _step(c, load, here, u[j], f[j], state[j], tolerance, careful, careful + more)
                        here = u[j].copy()
            parts = parts + 1 if parts < 3 else 2 * parts - 2  # one part thrice: as before, still, carefully
        if not converged:
            return j
        guessing = guessing and parts == 1
        from_load, reached, held = loads[j].copy(), u[j].copy(), state[j].copy()
    return steps
