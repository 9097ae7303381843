"""The inner loops of quasi-static frictional contact, compiled: the data and one sample.

The equations and the choice of unknowns are those of `contact_sample`; here are plain arrays in component order (DOF
``c n + m`` is direction c of node m) and no objects. With m slipping and o open nodes there are q = 2 m + 3 o + 1
unknowns: x of the slipping nodes, their y, then x, y, z of the open ones, and the arm's q_z.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import SMALLEST_LOAD
from fretflow.contact.law import ContactState
from fretflow.core.compiled import compiled, factorise, multiply_symmetric, substitute

Array = NDArray[np.float64]
States = NDArray[np.int8]
Indices = NDArray[np.int64]
STICK, SLIP, SEPARATION = int(ContactState.STICK), int(ContactState.SLIP), int(ContactState.SEPARATION)
MAX_ITERATIONS = 40
MOST_PARTS = 256  # of a sample's step of the arm
STALE = 0.4  # a kept factor must contract the residual at least by this; a new one costs some ten iterations


class Contact(NamedTuple):
    """The contact's data: stiffness K (3 n, 3 n), K B_x and K B_z (3 n,) in N/m, gap (n,) m, and the law of friction.

    `friction`, `reference` (n,): coefficient and reference force, see `contact.coulomb`; `penalty` rho N/m.
    """

    stiffness: Array
    along: Array
    lift: Array
    gap: Array
    friction: Array
    reference: Array
    exponent: float
    asymmetry: float
    penalty: float


class Factor(NamedTuple):
    """The last LU factors, of the equations of the contact state (n,); size (1,) is q, 0 if there are none.

    For Newton's steps they are in single precision, which takes half the time; derivatives need double.
    """

    matrix: NDArray[np.floating[Any]]
    pivots: NDArray[np.int32]
    state: States
    size: Indices


class Marched(NamedTuple):
    """Samples of a period: u and f (N, 3 n), the arm's q_z (N,), state (N, n)."""

    displacement: Array
    force: Array
    approach: Array
    state: States


def empty_factor(nodes: int, single: bool = False) -> Factor:
    """Return room for the factors of any state of n nodes, in double precision or single."""
    size = 3 * nodes + 1
    matrix: NDArray[np.floating[Any]] = np.empty(size * size, dtype=np.float32 if single else np.float64)
    return Factor(matrix, np.empty(size, dtype=np.int32), np.empty(nodes, dtype=np.int8), np.zeros(1, dtype=np.int64))


def empty_march(samples: int, nodes: int) -> Marched:
    """Return room for a period."""
    return Marched(np.zeros((samples, 3 * nodes)), np.zeros((samples, 3 * nodes)), np.zeros(samples),
                   np.zeros((samples, nodes), dtype=np.int8))


@compiled
def total(values: Array, first: int) -> float:
    """Return the sum of the values from `first` on."""
    found = 0.0
    for i in range(first, len(values)):
        found += values[i]
    return found


@compiled
def _largest(values: Array) -> float:
    """Return the largest size, nan if there is any."""
    most = 0.0
    for value in values:
        if np.isnan(value):
            return np.nan
        most = max(most, abs(value))
    return most


@compiled
def alike(a: States, b: States) -> bool:
    """Tell whether two states are the same."""
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


@compiled
def copy_sample(source: Marched, a: int, target: Marched, b: int) -> None:
    """Copy sample a of `source` to sample b of `target`."""
    for i in range(source.displacement.shape[1]):
        target.displacement[b, i], target.force[b, i] = source.displacement[a, i], source.force[a, i]
    for i in range(source.state.shape[1]):
        target.state[b, i] = source.state[a, i]
    target.approach[b] = source.approach[a]


@compiled
def grips(c: Contact, i: int, normal: float) -> tuple[float, float]:
    """Return the friction limit over the coefficient at node i, N, and its derivative by the normal force."""
    if c.exponent == 0.0:
        return normal, 1.0
    share = normal / c.reference[i]
    factor = max(share, SMALLEST_LOAD)**-c.exponent
    return normal * factor, factor * (1.0 - c.exponent if share > SMALLEST_LOAD else 1.0)


@compiled
def _hold(c: Contact, u: Array, f: Array, previous: Array, state: States, arm: float, approach: float,
          trial: Array) -> None:
    """Put the known DOFs where their state wants them, closed at the gap, stuck where they were; f and tau follow."""
    n = len(c.gap)
    for i in range(n):
        if state[i] != SEPARATION:
            u[2 * n + i] = -c.gap[i]
        if state[i] == STICK:
            u[i], u[n + i] = previous[i], previous[n + i]
    multiply_symmetric(c.stiffness, u, f)
    for i in range(3 * n):
        f[i] -= arm * c.along[i] + approach * c.lift[i]
    try_forces(c, u, f, previous, trial)


@compiled
def try_forces(c: Contact, u: Array, f: Array, previous: Array, trial: Array) -> None:
    """Put direction and size of the trial force tau into `trial` (3, n)."""
    n = len(c.gap)
    for i in range(n):
        x = f[i] - c.penalty * (u[i] - previous[i])
        y = f[n + i] - c.penalty * (u[n + i] - previous[n + i])
        size = max(np.hypot(x, y), 1e-300)
        trial[0, i], trial[1, i], trial[2, i] = x / size, y / size, size


@compiled
def _project(c: Contact, u: Array, f: Array, trial: Array, grip: float, state: States) -> bool:
    """Put the state that the trial forces ask for into `state`; return whether that is another one."""
    n, changed = len(c.gap), False
    for i in range(n):
        pressing = f[2 * n + i] - c.penalty * (c.gap[i] + u[2 * n + i])
        limit = grip * c.friction[i] * grips(c, i, max(pressing, 0.0))[0] * (1.0 - c.asymmetry * trial[0, i])
        asked = SEPARATION
        if pressing > 0.0:
            asked = SLIP if trial[2, i] > limit * (1.0 + 1e-12) else STICK
        if state[i] != asked:
            state[i], changed = asked, True
    return changed


@compiled
def turn_cone(c: Contact, f: Array, trial: Array, grip: float, cone: Array) -> None:
    """Put the friction limit L, its slope dL/df_z and how L t turns, two rows, into `cone` (4, n).

    L t changes by ``-across w`` where tau turns by w across t.
    """
    n = len(c.gap)
    for i in range(n):
        x, y, d = trial[0, i], trial[1, i], c.asymmetry
        gripping, slope = grips(c, i, max(f[2 * n + i], 0.0))
        share, limit = 1.0 - d * x, grip * c.friction[i] * gripping
        turned = limit / trial[2, i]
        cone[0, i], cone[1, i] = share * limit, share * grip * c.friction[i] * slope
        cone[2, i] = share * turned * y - d * turned * y * x
        cone[3, i] = -share * turned * x - d * turned * y * y


@compiled
def unknowns(state: States) -> tuple[int, Indices]:
    """Return the number of slipping nodes and the unknown DOFs (q - 1,)."""
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
def _residual(c: Contact, f: Array, trial: Array, cone: Array, m: int, unknown: Indices, load: float) -> Array:
    n = len(c.gap)
    residual = np.empty(len(unknown) + 1)
    for k in range(m):
        i = unknown[k]
        residual[k] = f[i] - cone[0, i] * trial[0, i]
        residual[m + k] = f[n + i] - cone[0, i] * trial[1, i]
    for k in range(2 * m, len(unknown)):
        residual[k] = f[unknown[k]]
    residual[-1] = total(f, 2 * n) - load
    return residual


@compiled
def factorise_state(c: Contact, trial: Array, cone: Array, m: int, unknown: Indices, state: States, factor: Factor
               ) -> bool:
    """Factorise the derivative of the residual by the unknowns; return whether it is regular."""
    n, q, rho, lift = len(c.gap), len(unknown) + 1, c.penalty, total(c.lift, 2 * len(c.gap))
    columns = factor.matrix[:q * q].reshape(q, q)  # a row for each unknown: LAPACK's columns
    for r in range(q):
        row = columns[r]
        g, sign = (c.stiffness[unknown[r]], 1.0) if r < q - 1 else (c.lift, -1.0)
        for k in range(m):
            i = unknown[k]
            x, y, a, b = trial[0, i], trial[1, i], cone[2, i], cone[3, i]
            fx, fy, fz = sign * g[i], sign * g[n + i], sign * cone[1, i] * g[2 * n + i]
            row[k] = fx * (1.0 - a * y) + fy * (a * x) - fz * x
            row[m + k] = fy * (1.0 + b * x) - fx * (b * y) - fz * y
        for k in range(2 * m, q - 1):
            row[k] = sign * g[unknown[k]]
        row[q - 1] = c.lift[unknown[r]] if r < q - 1 else -lift
    for k in range(m):
        i = unknown[k]
        x, y, a, b = trial[0, i], trial[1, i], cone[2, i], cone[3, i]
        columns[k, k] += rho * a * y
        columns[m + k, k] -= rho * a * x
        columns[k, m + k] += rho * b * y
        columns[m + k, m + k] -= rho * b * x
    factor.size[0] = q
    for i in range(n):
        factor.state[i] = state[i]
    return factorise(columns, factor.pivots[:q])


@compiled
def solve(factor: Factor, columns: NDArray[np.floating[Any]]) -> None:
    """Replace right-hand sides, by columns (p, q), by the solutions."""
    q = factor.size[0]
    substitute(factor.matrix[:q * q].reshape(q, q), factor.pivots[:q], columns)


@compiled
def find(c: Contact, factor: Factor, under: tuple[float, float, float], previous: Array, sample: Marched, j: int,
         tolerance: float) -> bool:
    """Find sample j of `sample`, which holds the guess, after a displacement `previous`; return whether it was found.

    `under` is arm position (m), load (N) and the factor on friction; `tolerance` N at a node.
    """
    arm, load, grip = under
    u, f, state = sample.displacement[j], sample.force[j], sample.state[j]
    n, last = len(state), np.inf
    trial, cone, new = np.empty((3, n)), np.empty((4, n)), np.empty(n, dtype=np.int8)
    m, unknown = unknowns(state)
    _hold(c, u, f, previous, state, arm, sample.approach[j], trial)
    for iteration in range(MAX_ITERATIONS):
        settled = False
        if iteration:
            _hold(c, u, f, previous, state, arm, sample.approach[j], trial)
            settled = not _project(c, u, f, trial, grip, state)
            if not settled:
                last = np.inf
                m, unknown = unknowns(state)
                _hold(c, u, f, previous, state, arm, sample.approach[j], trial)
        turn_cone(c, f, trial, grip, cone)
        residual = _residual(c, f, trial, cone, m, unknown, load)
        error = _largest(residual)
        if not np.isfinite(error):
            return False
        if error < tolerance:
            new[:] = state
            if settled or not _project(c, u, f, trial, grip, new):
                return True
        stale = error > STALE * last or factor.size[0] == 0 or not alike(factor.state, state)
        if stale and not factorise_state(c, trial, cone, m, unknown, state, factor):
            factor.size[0] = 0
            return False
        last = error
        step = residual.astype(factor.matrix.dtype)
        solve(factor, step.reshape(1, -1))
        for k in range(len(unknown)):
            u[unknown[k]] -= step[k]
        sample.approach[j] -= step[-1]
    return False


@compiled
def find_in_parts(c: Contact, factor: Factor, under: tuple[float, float, float], before: float, previous: Array,
                  sample: Marched, j: int, tolerance: float) -> bool:
    """Find sample j as `find`; where that fails, move the arm there from `before` in ever smaller parts.

    The sample's own history stays: each part starts from the solution of the one before.
    """
    arm, load, grip = under
    n = sample.state.shape[1]
    guess = Marched(np.empty((1, 3 * n)), np.empty((1, 3 * n)), np.empty(1), np.empty((1, n), dtype=np.int8))
    copy_sample(sample, j, guess, 0)
    parts, found = 1, False
    while parts <= MOST_PARTS and not found:
        if parts > 1:
            copy_sample(guess, 0, sample, j)
            for i in range(3 * n):
                sample.displacement[j, i] = previous[i]
            for i in range(n):
                sample.state[j, i] = STICK if guess.state[0, i] == SLIP else guess.state[0, i]
        found = True
        for part in range(1, parts + 1):
            there = arm if part == parts else before + (arm - before) * part / parts
            found = found and find(c, factor, (there, load, grip), previous, sample, j, tolerance)
        parts *= 2
    return found
