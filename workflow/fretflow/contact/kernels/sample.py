"""The inner loops of quasi-static frictional contact, compiled: the data and one sample.

The equations and the choice of unknowns are those of `solvers.quasi_static.sample`; here are plain arrays and no
objects. DOF ``3 i + c`` is direction c of node i, as everywhere. With m slipping and o open nodes there are
q = 2 m + 3 o unknowns: x of the slipping nodes, their y, then x, y, z of the open ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.cone import limit
from fretflow.contact.law import ContactState
from fretflow.core.compiled import compiled, factorise, largest, multiply_symmetric, substitute
from fretflow.core.records import Array

States = NDArray[np.int8]
Indices = NDArray[np.int64]
STICK, SLIP, SEPARATION = int(ContactState.STICK), int(ContactState.SLIP), int(ContactState.SEPARATION)
MAX_ITERATIONS = 40
MOST_PARTS = 256  # of the change of the load on the faces in a sample
NONE = -1  # size of a factor that there is not
STALE = 0.4  # a kept factor must contract the residual at least by this; a new one costs some ten iterations
SECANTS = 8  # that correct a kept factor; their products cost little beside one with the stiffness
WORTH = 100  # nodes from which they do; below, a new factor costs no more
OWN = 0.1  # share of a secant that those before must not tell already: a smaller one would amplify the curvature


class Contact(NamedTuple):
    """The contact's data: elastic force ``f = K u - R q - r``, gap and the law of friction.

    `stiffness` K (3 n, 3 n), `coupling` R (3 n, d) and penalty rho in N/m, `gap` (n,) m; `felt` T K and `felt_coupling`
    T R give the force T f that the coordinates feel. `friction`, `reference` (n,): see `contact.coulomb`.
    """

    stiffness: Array
    coupling: Array
    felt: Array
    felt_coupling: Array
    gap: Array
    friction: Array
    reference: Array
    exponent: float
    asymmetry: float
    penalty: float


class Factor(NamedTuple):
    """The last LU factors, of the equations of the contact state (n,); size (2,) is q, `NONE` if there are none.

    For Newton's steps they are in single precision, which takes half the time; derivatives need double. Those of Newton
    are corrected by secants, of which size[1] were seen: the change of the residual, orthonormal, and the `steps`
    (s, 3 n) that made it (V. Eyert, J. Comput. Phys. 124 (1996) 271-285).
    """

    matrix: NDArray[np.floating[Any]]
    pivots: NDArray[np.int32]
    state: States
    size: Indices
    steps: Array
    changes: Array


class PeriodHistory(NamedTuple):
    """Samples of a period: internal coordinates q (N, d), u and f (N, 3 n), state (N, n)."""

    position: Array
    displacement: Array
    force: Array
    state: States


def empty_factor(nodes: int, single: bool = False) -> Factor:
    """Return room for the factors of any state of n nodes, in double precision or single."""
    size = 3 * nodes
    matrix: NDArray[np.floating[Any]] = np.empty(size * size, dtype=np.float32 if single else np.float64)
    steps, changes = np.empty((2, SECANTS if single and nodes >= WORTH else 0, size))
    return Factor(matrix, np.empty(size, dtype=np.int32), np.empty(nodes, dtype=np.int8),
                  np.full(2, NONE, dtype=np.int64), steps, changes)


def empty_period(samples: int, nodes: int, coordinates: int = 0) -> PeriodHistory:
    """Return room for a period."""
    return PeriodHistory(np.zeros((samples, coordinates)), np.zeros((samples, 3 * nodes)),
                         np.zeros((samples, 3 * nodes)), np.zeros((samples, nodes), dtype=np.int8))


@compiled
def alike(a: States, b: States) -> bool:
    """Tell whether two states are the same."""
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


@compiled
def copy_sample(source: PeriodHistory, a: int, target: PeriodHistory, b: int) -> None:
    """Copy sample a of `source` to sample b of `target`."""
    for i in range(source.displacement.shape[1]):
        target.displacement[b, i], target.force[b, i] = source.displacement[a, i], source.force[a, i]
    for i in range(source.state.shape[1]):
        target.state[b, i] = source.state[a, i]


@compiled
def law_at(c: Contact, i: int) -> tuple[float, float, float, float]:
    """Return the law of node i as `cone.limit` takes it."""
    return c.friction[i], c.reference[i], c.exponent, c.asymmetry


@compiled
def _hold(c: Contact, u: Array, f: Array, previous: Array, state: States, pull: Array, trial: Array, moved: bool
          ) -> None:
    """Put the known DOFs where their state wants them, closed at the gap, stuck where they were; f and tau follow.

    Where that moves none of them, f is what it was, unless others have `moved`.
    """
    for i in range(len(c.gap)):
        if state[i] != SEPARATION:
            moved |= u[3 * i + 2] != -c.gap[i]
            u[3 * i + 2] = -c.gap[i]
        if state[i] == STICK:
            moved |= u[3 * i] != previous[3 * i] or u[3 * i + 1] != previous[3 * i + 1]
            u[3 * i], u[3 * i + 1] = previous[3 * i], previous[3 * i + 1]
    if moved:
        multiply_symmetric(c.stiffness, u, f)
        for k in range(len(f)):
            f[k] -= pull[k]
        try_forces(c, u, f, previous, trial)


@compiled
def try_forces(c: Contact, u: Array, f: Array, previous: Array, trial: Array) -> None:
    """Put direction and size of the trial force tau into `trial` (3, n)."""
    for i in range(len(c.gap)):
        x = f[3 * i] - c.penalty * (u[3 * i] - previous[3 * i])
        y = f[3 * i + 1] - c.penalty * (u[3 * i + 1] - previous[3 * i + 1])
        size = max(np.hypot(x, y), 1e-300)
        trial[0, i], trial[1, i], trial[2, i] = x / size, y / size, size


@compiled
def _project(c: Contact, u: Array, f: Array, trial: Array, factor: float, state: States) -> bool:
    """Put the state that the trial forces ask for into `state`; return whether that is another one."""
    changed = False
    for i in range(len(c.gap)):
        pressing = f[3 * i + 2] - c.penalty * (c.gap[i] + u[3 * i + 2])
        radius, _ = limit(law_at(c, i), factor, max(pressing, 0.0), trial[0, i])
        asked = SEPARATION
        if pressing > 0.0:
            asked = SLIP if trial[2, i] > radius * (1.0 + 1e-12) else STICK
        if state[i] != asked:
            state[i], changed = asked, True
    return changed


@compiled
def turn_cone(c: Contact, f: Array, trial: Array, factor: float, cone: Array) -> None:
    """Put the friction limit L, its slope dL/df_z and how L t turns, two rows, into `cone` (4, n).

    L t changes by ``-across w`` where tau turns by w across t.
    """
    for i in range(len(c.gap)):
        x, y, d = trial[0, i], trial[1, i], c.asymmetry
        normal = max(f[3 * i + 2], 0.0)
        cone[0, i], cone[1, i] = limit(law_at(c, i), factor, normal, x)
        # dL/dt_x = -d L / (1 - d t_x), of the mean of both directions
        turned = cone[0, i] / trial[2, i]
        leaning = d * turned / (1.0 - d * x) * y
        cone[2, i] = turned * y - leaning * x
        cone[3, i] = -turned * x - leaning * y


@compiled
def unknowns(state: States) -> tuple[int, Indices]:
    """Return the number of slipping nodes and the unknown DOFs (q,)."""
    m, o = 0, 0
    for i in range(len(state)):
        m += state[i] == SLIP
        o += state[i] == SEPARATION
    unknown = np.empty(2 * m + 3 * o, dtype=np.int64)
    a, b = 0, 2 * m
    for i in range(len(state)):
        if state[i] == SLIP:
            unknown[a], unknown[m + a] = 3 * i, 3 * i + 1
            a += 1
        elif state[i] == SEPARATION:
            for k in range(3):
                unknown[b + k] = 3 * i + k
            b += 3
    return m, unknown


@compiled
def _residual(f: Array, trial: Array, cone: Array, m: int, unknown: Indices) -> Array:
    residual = np.empty(len(unknown))
    for k in range(m):
        i = unknown[k] // 3
        residual[k] = f[3 * i] - cone[0, i] * trial[0, i]
        residual[m + k] = f[3 * i + 1] - cone[0, i] * trial[1, i]
    for k in range(2 * m, len(unknown)):
        residual[k] = f[unknown[k]]
    return residual


@compiled
def factorise_state(c: Contact, trial: Array, cone: Array, m: int, unknown: Indices, state: States, factor: Factor
               ) -> bool:
    """Factorise the derivative of the residual by the unknowns; return whether it is regular."""
    q, rho = len(unknown), c.penalty
    columns = factor.matrix[:q * q].reshape(q, q)  # a row for each unknown: LAPACK's columns
    for r in range(q):
        row, g = columns[r], c.stiffness[unknown[r]]
        for k in range(m):
            i = unknown[k] // 3
            x, y, a, b = trial[0, i], trial[1, i], cone[2, i], cone[3, i]
            fx, fy, fz = g[3 * i], g[3 * i + 1], cone[1, i] * g[3 * i + 2]
            row[k] = fx * (1.0 - a * y) + fy * (a * x) - fz * x
            row[m + k] = fy * (1.0 + b * x) - fx * (b * y) - fz * y
        for k in range(2 * m, q):
            row[k] = g[unknown[k]]
    for k in range(m):
        i = unknown[k] // 3
        x, y, a, b = trial[0, i], trial[1, i], cone[2, i], cone[3, i]
        columns[k, k] += rho * a * y
        columns[m + k, k] -= rho * a * x
        columns[k, m + k] += rho * b * y
        columns[m + k, m + k] -= rho * b * x
    factor.size[0], factor.size[1] = q, 0
    for i in range(len(state)):
        factor.state[i] = state[i]
    return q == 0 or factorise(columns, factor.pivots[:q])


@compiled
def solve(factor: Factor, columns: NDArray[np.floating[Any]]) -> None:
    """Replace right-hand sides, by columns (p, q), by the solutions."""
    q = factor.size[0]
    if q > 0:
        substitute(factor.matrix[:q * q].reshape(q, q), factor.pivots[:q], columns)


@compiled
def learn(factor: Factor, step: Array, change: Array) -> None:
    """Take in that the residual changed by `change` (q,) with a `step` (q,) of the unknowns; both are overwritten."""
    q, place = len(step), factor.size[1] % len(factor.steps)
    size = np.sqrt(_dot(change, change))
    for k in range(min(factor.size[1], len(factor.steps))):
        if k != place:
            share = _dot(factor.changes[k, :q], change)
            _add(change, -share, factor.changes[k, :q])
            _add(step, -share, factor.steps[k, :q])
    rest = np.sqrt(_dot(change, change))
    if rest > OWN * size:
        for r in range(q):
            factor.changes[place, r], factor.steps[place, r] = change[r] / rest, step[r] / rest
        factor.size[1] += 1


@compiled
def newton_step(factor: Factor, residual: Array) -> Array:
    """Return the change of the unknowns (q,) that the secants, and for the rest the factors, expect of a residual."""
    q = len(residual)
    step, rest = np.zeros(q), residual.copy()
    for k in range(min(factor.size[1], len(factor.steps))):
        share = _dot(factor.changes[k, :q], rest)
        _add(rest, -share, factor.changes[k, :q])
        _add(step, -share, factor.steps[k, :q])
    answer = rest.astype(factor.matrix.dtype)
    solve(factor, answer.reshape(1, -1))
    for r in range(q):
        step[r] -= answer[r]
    return step


@compiled
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled
def _add(a: Array, share: float, b: Array) -> None:
    for k in range(len(a)):
        a[k] += share * b[k]


@compiled
def find(c: Contact, factor: Factor, pull: Array, friction_factor: float, previous: Array, sample: PeriodHistory,
         j: int, tolerance: float) -> bool:
    """Find sample j of `sample`, which holds the guess, after a displacement `previous`; return whether it was found.

    `pull` (3 n,) N is ``R q + r``; `tolerance` N at a node.
    """
    u, f, state = sample.displacement[j], sample.force[j], sample.state[j]
    n, last = len(state), np.inf
    trial, cone, new = np.empty((3, n)), np.empty((4, n)), np.empty(n, dtype=np.int8)
    m, unknown = unknowns(state)
    step = residual = np.empty(0)
    _hold(c, u, f, previous, state, pull, trial, True)
    for iteration in range(MAX_ITERATIONS):
        settled = False
        if iteration:
            _hold(c, u, f, previous, state, pull, trial, True)
            settled = not _project(c, u, f, trial, friction_factor, state)
            if not settled:
                last = np.inf
                m, unknown = unknowns(state)
                _hold(c, u, f, previous, state, pull, trial, False)
        turn_cone(c, f, trial, friction_factor, cone)
        before, residual = residual, _residual(f, trial, cone, m, unknown)
        error = largest(residual)
        if not np.isfinite(error):
            return False
        if error < tolerance:
            new[:] = state
            if settled or not _project(c, u, f, trial, friction_factor, new):
                return True
        stale = error > STALE * last or factor.size[0] == NONE or not alike(factor.state, state)
        if stale and not factorise_state(c, trial, cone, m, unknown, state, factor):
            factor.size[0] = NONE
            return False
        if len(factor.steps) and not stale and last < np.inf:
            learn(factor, step, residual - before)
        last = error
        step = newton_step(factor, residual)
        for k in range(len(unknown)):
            u[unknown[k]] += step[k]
    return False


@compiled
def find_in_parts(c: Contact, factor: Factor, pulls: tuple[Array, Array], friction_factor: float, previous: Array,
                  sample: PeriodHistory, j: int, tolerance: float) -> bool:
    """Find sample j as `find`; where that fails, pull there from the pull before in ever smaller parts.

    `pulls` are that before and that of the sample. The sample's own history stays: each part starts from the solution
    of the one before.
    """
    before, pull = pulls
    n = sample.state.shape[1]
    guess = PeriodHistory(np.empty((1, 0)), np.empty((1, 3 * n)), np.empty((1, 3 * n)),
                          np.empty((1, n), dtype=np.int8))
    copy_sample(sample, j, guess, 0)
    parts, converged, there = 1, False, np.empty(3 * n)
    while parts <= MOST_PARTS and not converged:
        if parts > 1:
            copy_sample(guess, 0, sample, j)
            for i in range(3 * n):
                sample.displacement[j, i] = previous[i]
            for i in range(n):
                sample.state[j, i] = STICK if guess.state[0, i] == SLIP else guess.state[0, i]
        converged = True
        for part in range(1, parts + 1):
            for i in range(3 * n):
                there[i] = pull[i] if part == parts else before[i] + (pull[i] - before[i]) * part / parts
            converged = converged and find(c, factor, there, friction_factor, previous, sample, j, tolerance)
        parts *= 2
    return converged
