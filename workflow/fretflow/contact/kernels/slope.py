"""The derivative of one sample of quasi-static frictional contact, compiled; see `contact.kernels.sample`."""

from __future__ import annotations

import numpy as np

from fretflow.contact.kernels.cone import limit
from fretflow.contact.kernels.sample import (
    STICK,
    Contact,
    Factor,
    Indices,
    PeriodHistory,
    States,
    factorise_state,
    law_at,
    solve,
    try_forces,
    turn_cone,
    unknowns,
)
from fretflow.core.compiled import compiled, multiply
from fretflow.core.records import Array


@compiled
def differentiate(c: Contact, factor: Factor, friction_factor: float, previous: Array, sample: PeriodHistory, j: int,
                  history: Array, change: tuple[Array, Array, Array], moved: Array, pressing: Array) -> None:
    """Differentiate a found sample j by p parameters.

    Parameters
    ----------
    history : (3 n, p)
        Derivative of `previous`.
    change : (d, p), (n, p), (3 n, p) or (0, p)
        What the parameters change by themselves: coordinates, friction coefficient with its factor, elastic force.
    moved, pressing : (3 n, p), (m, p) or (0, p)
        Results: of the displacement, its z rows the opening; of the normal force at the m slipping nodes.
    """
    u, f, state = sample.displacement[j], sample.force[j], sample.state[j]
    n, p = len(state), history.shape[1]
    trial, cone = np.empty((3, n)), np.empty((4, n))
    try_forces(c, u, f, previous, trial)
    turn_cone(c, f, trial, friction_factor, cone)
    m, unknown = unknowns(state)
    q = len(unknown)
    factorise_state(c, trial, cone, m, unknown, state, factor)
    held = _held(state)
    remembered, df = np.empty((len(held), p)), np.empty((q + m, p))
    moved.fill(0.0)
    for r in range(len(held)):
        for k in range(p):
            remembered[r, k] = moved[held[r], k] = history[held[r], k]
    _pull(c, m, unknown, held, remembered, change, df)
    step = np.empty((p, q))
    _right_hand_sides(c, f, trial, cone, m, unknown, df, history, change[1], step)
    solve(factor, step)
    for k in range(p):
        for r in range(q):
            moved[unknown[r], k] = step[k, r]
    if len(pressing):
        _press(c, unknown, df, step, pressing)


@compiled
def _held(state: States) -> Indices:
    """Return the DOFs that stay where they were."""
    s = 0
    held = np.empty(2 * len(state), dtype=np.int64)
    for i in range(len(state)):
        if state[i] == STICK:
            held[s], held[s + 1] = 3 * i, 3 * i + 1
            s += 2
    return held[:s]


@compiled
def _row(r: int, m: int, unknown: Indices) -> int:
    """Return the DOF of row r of the forces that matter: x, y, z at the m slipping nodes, then at the open ones."""
    if r < 2 * m:
        return int(unknown[r])
    return int(unknown[r - 2 * m] + 2 if r < 3 * m else unknown[r - m])


@compiled
def _pull(c: Contact, m: int, unknown: Indices, held: Indices, remembered: Array, change: tuple[Array, Array, Array],
          df: Array) -> None:
    """Put the forces by the held DOFs' motions `remembered` (s, p) and by the changes into `df` (rows, p)."""
    motion, force = change[0], change[2]
    stiffness = np.empty((len(df), len(held)))
    for r in range(len(df)):
        row = _row(r, m, unknown)
        for k in range(len(held)):
            stiffness[r, k] = c.stiffness[row, held[k]]
    multiply(stiffness, remembered, df)
    for r in range(len(df)):
        row = _row(r, m, unknown)
        for i in range(len(motion)):
            coupling = c.coupling[row, i]
            for k in range(df.shape[1]):
                df[r, k] -= coupling * motion[i, k]
        for k in range(df.shape[1] if len(force) else 0):
            df[r, k] += force[row, k]


@compiled
def _right_hand_sides(c: Contact, f: Array, trial: Array, cone: Array, m: int, unknown: Indices, df: Array,
                      history: Array, friction: Array, columns: Array) -> None:
    """Put minus the derivative of the residual, the unknowns held, into `columns` (p, q); df (rows, p) N."""
    rho = c.penalty
    for r in range(m):
        i = unknown[r] // 3
        x, y, a, b, slope = trial[0, i], trial[1, i], cone[2, i], cone[3, i], cone[1, i]
        law = law_at(c, i)
        gripping, _ = limit((1.0, law[1], law[2], law[3]), 1.0, max(f[3 * i + 2], 0.0), x)
        for k in range(len(columns)):
            fx, fy, fz = df[r, k], df[m + r, k], slope * df[2 * m + r, k]
            turned = x * (fy + rho * history[3 * i + 1, k]) - y * (fx + rho * history[3 * i, k])
            wider = gripping * friction[i, k] + fz
            columns[k, r] = x * wider - fx - a * turned
            columns[k, m + r] = y * wider - fy - b * turned
    for r in range(2 * m, len(unknown)):
        for k in range(len(columns)):
            columns[k, r] = -df[m + r, k]


@compiled
def _press(c: Contact, unknown: Indices, df: Array, step: Array, pressing: Array) -> None:
    """Put the derivative of the normal force at the slipping nodes into `pressing` (m, p)."""
    m, last = len(pressing), len(unknown)
    by_unknown, pulled = np.empty((last, m)), np.empty((len(step), m))
    for k in range(m):
        z = unknown[k] + 2
        for r in range(last):
            by_unknown[r, k] = c.stiffness[z, unknown[r]]
    multiply(step, by_unknown, pulled)
    for k in range(m):
        for column in range(len(step)):
            pressing[k, column] = df[2 * m + k, column] + pulled[column, k]
