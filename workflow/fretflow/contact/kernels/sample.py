"""One sample of quasi-static frictional contact, compiled; see `contact.kernels.equations`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fretflow.contact.kernels.cone import limit
from fretflow.contact.kernels.equations import (
    SEPARATION,
    SLIP,
    STICK,
    Array,
    Contact,
    States,
    law_at,
    residual_of,
    try_forces,
    turn_cone,
    unknowns,
)
from fretflow.contact.kernels.factors import Factor, copy_state, learn, step_by
from fretflow.core.compiled import compiled, multiply_symmetric

MAX_ITERATIONS = 40
MOST_PARTS = 256  # of the change of the load on the faces in a sample
STALE = 0.4  # kept factors must contract the residual at least by this; new ones cost some ten iterations
ROUND_OFF = 1e-14  # of a displacement: the forces stay what they were


class PeriodHistory(NamedTuple):
    """Samples of a period: internal coordinates q (N, d), u and f (N, 3 n), state (N, n)."""

    position: Array
    displacement: Array
    force: Array
    state: States


def empty_period(samples: int, nodes: int, coordinates: int = 0) -> PeriodHistory:
    """Return room for a period."""
    return PeriodHistory(np.zeros((samples, coordinates)), np.zeros((samples, 3 * nodes)),
                         np.zeros((samples, 3 * nodes)), np.zeros((samples, nodes), dtype=np.int8))


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
def copy_sample(source: PeriodHistory, a: int, target: PeriodHistory, b: int) -> None:
    """Copy sample a of `source` to sample b of `target`."""
    for i in range(source.displacement.shape[1]):
        target.displacement[b, i], target.force[b, i] = source.displacement[a, i], source.force[a, i]
    for i in range(source.state.shape[1]):
        target.state[b, i] = source.state[a, i]


@compiled
def _hold(c: Contact, u: Array, f: Array, previous: Array, state: States, pull: Array, trial: Array, moved: bool
          ) -> None:
    """Put the known DOFs where their state wants them, closed at the gap, stuck where they were; f and tau follow.

    Where that moves none of them, f is what it was, unless others have `moved`.
    """
    for i in range(len(c.gap)):
        if state[i] != SEPARATION:
            moved |= abs(u[3 * i + 2] + c.gap[i]) > ROUND_OFF * abs(c.gap[i])
            u[3 * i + 2] = -c.gap[i]
        if state[i] == STICK:
            for k in range(3 * i, 3 * i + 2):
                moved |= abs(u[k] - previous[k]) > ROUND_OFF * abs(previous[k])
                u[k] = previous[k]
    if moved:
        multiply_symmetric(c.stiffness, u, f)
        for k in range(len(f)):
            f[k] -= pull[k]
        try_forces(c, u, f, previous, trial)


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
def _settle(c: Contact, u: Array, f: Array, previous: Array, state: States, pull: Array, trial: Array, factor: float
            ) -> bool:
    """Bring forces and state to the displacement u; return whether the state stayed."""
    _hold(c, u, f, previous, state, pull, trial, True)
    if not _project(c, u, f, trial, factor, state):
        return True
    _hold(c, u, f, previous, state, pull, trial, False)
    return False


@compiled
def _fits(c: Contact, u: Array, f: Array, trial: Array, factor: float, state: States) -> bool:
    """Tell whether the trial forces ask for no other state."""
    asked = np.empty(len(state), dtype=np.int8)
    copy_state(state, asked)
    return not _project(c, u, f, trial, factor, asked)


@compiled
def find(c: Contact, factor: Factor, pull: Array, friction_factor: float, previous: Array, sample: PeriodHistory,
         j: int, tolerance: float, follows: bool) -> bool:
    """Find sample j of `sample`, which holds the guess, after a displacement `previous`; return whether it was found.

    `pull` (3 n,) N is ``R q + r``; `tolerance` N at a node. Where the guess `follows` others, its forces are those of
    its displacement but for round-off; none are found by such.
    """
    u, f, state = sample.displacement[j], sample.force[j], sample.state[j]
    n, last = len(state), np.inf
    trial, cone = np.empty((3, n)), np.empty((4, n))
    m, unknown = unknowns(state)
    step = residual = np.empty(0)
    _hold(c, u, f, previous, state, pull, trial, not follows)
    try_forces(c, u, f, previous, trial)
    for iteration in range(MAX_ITERATIONS):
        settled = False
        if iteration:
            settled = _settle(c, u, f, previous, state, pull, trial, friction_factor)
            if not settled:
                last = np.inf
                m, unknown = unknowns(state)
        turn_cone(c, f, trial, friction_factor, cone)
        before, residual = residual, residual_of(f, trial, cone, m, unknown)
        error = _largest(residual)
        if error < tolerance and (iteration or not follows) and (
                settled or _fits(c, u, f, trial, friction_factor, state)):
            return True
        poor = error > STALE * last
        if last < np.inf and not poor:
            learn(factor, step, residual - before)
        regular, step = step_by(c, trial, cone, m, unknown, state, factor, residual, poor)
        if not (regular and np.isfinite(error)):
            return False
        last = error
        for k in range(len(unknown)):
            u[unknown[k]] += step[k]
    return False


@compiled
def find_in_parts(c: Contact, factor: Factor, pulls: tuple[Array, Array], friction_factor: float, previous: Array,
                  sample: PeriodHistory, j: int, tolerance: float, follows: bool) -> bool:
    """Find sample j as `find`; where that fails, pull there from the pull before in ever smaller parts.

    `pulls` are that before and that of the sample. The sample's own history stays: each part starts from the solution
    of the one before. `follows`: see `find`.
    """
    before, pull = pulls
    n = sample.state.shape[1]
    guess = PeriodHistory(np.empty((1, 0)), np.empty((1, 3 * n)), np.empty((1, 3 * n)),
                          np.empty((1, n), dtype=np.int8))
    copy_sample(sample, j, guess, 0)
    parts, found, there = 1, False, np.empty(3 * n)
    while parts <= MOST_PARTS and not found:
        if parts > 1:
            copy_sample(guess, 0, sample, j)
            for i in range(3 * n):
                sample.displacement[j, i] = previous[i]
            for i in range(n):
                sample.state[j, i] = STICK if guess.state[0, i] == SLIP else guess.state[0, i]
        found = True
        for part in range(1, parts + 1):
            for i in range(3 * n):
                there[i] = pull[i] if part == parts else before[i] + (pull[i] - before[i]) * part / parts
            found = found and find(c, factor, there, friction_factor, previous, sample, j, tolerance,
                                   follows and parts == 1)
        parts *= 2
    return found
