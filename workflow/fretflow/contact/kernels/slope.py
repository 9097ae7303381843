"""The derivative of one sample of quasi-static frictional contact by parameters, compiled; see `contact_kernel`."""

from __future__ import annotations

import numpy as np

from fretflow.contact.kernels.sample import (
    STICK,
    Array,
    Contact,
    Factor,
    Indices,
    Marched,
    States,
    factorise_state,
    grips,
    solve,
    total,
    try_forces,
    turn_cone,
    unknowns,
)
from fretflow.core.compiled import compiled, multiply


@compiled
def differentiate(c: Contact, factor: Factor, grip: float, previous: Array, sample: Marched, j: int, history: Array,
                  change: tuple[Array, Array, Array, Array], moved: Array, approach: Array, pressing: Array) -> None:
    """Differentiate a found sample j by p parameters.

    Parameters
    ----------
    history : (3 n, p)
        Derivative of `previous`.
    change : (p,), (p,), (n, p), (3 n, p) or (0, p)
        What the parameters change by themselves: arm, load, friction coefficient with its factor, elastic force.
    moved, approach, pressing : (3 n, p), (p,), (m, p) or (0, p)
        Results: of the displacement, its z rows the opening; of q_z; of the normal force at the m slipping nodes.
    """
    u, f, state = sample.displacement[j], sample.force[j], sample.state[j]
    n, p = len(state), history.shape[1]
    trial, cone = np.empty((3, n)), np.empty((4, n))
    try_forces(c, u, f, previous, trial)
    turn_cone(c, f, trial, grip, cone)
    m, unknown = unknowns(state)
    q = len(unknown) + 1
    factorise_state(c, trial, cone, m, unknown, state, factor)
    held = _held(state)
    remembered, df = np.empty((len(held), p)), np.empty((q - 1 + m, p))
    moved.fill(0.0)
    for r in range(len(held)):
        for k in range(p):
            remembered[r, k] = moved[held[r], k] = history[held[r], k]
    _pull(c, m, unknown, held, remembered, change, df)
    step = np.empty((p, q))
    _right_hand_sides(c, f, trial, cone, m, unknown, df, history, change[2], step)
    _last_equation(c, held, remembered, change, step)
    solve(factor, step)
    for k in range(p):
        for r in range(q - 1):
            moved[unknown[r], k] = step[k, r]
        approach[k] = step[k, q - 1]
    if len(pressing):
        _press(c, unknown, df, step, pressing)


@compiled
def _last_equation(c: Contact, held: Indices, remembered: Array, change: tuple[Array, Array, Array, Array],
                   columns: Array) -> None:
    """Put minus the derivative of the normal forces' sum less the load into the last row of `columns` (p, q)."""
    arm, load, force = change[0], change[1], change[3]
    along, last = total(c.along, 2 * len(c.gap)), columns.shape[1] - 1
    for k in range(len(columns)):
        value = load[k] + along * arm[k]
        for r in range(len(held)):
            value -= c.lift[held[r]] * remembered[r, k]
        for i in range(2 * len(c.gap), len(force)):
            value -= force[i, k]
        columns[k, last] = value


@compiled
def _held(state: States) -> Indices:
    """Return the DOFs that stay where they were."""
    n, s = len(state), 0
    held = np.empty(2 * n, dtype=np.int64)
    for i in range(n):
        if state[i] == STICK:
            held[s], held[s + 1] = i, n + i
            s += 2
    return held[:s]


@compiled
def _row(r: int, m: int, n: int, unknown: Indices) -> int:
    """Return the DOF of row r of the forces that matter: x, y, z at the m slipping nodes, then at the open ones."""
    if r < 2 * m:
        return int(unknown[r])
    return int(2 * n + unknown[r - 2 * m] if r < 3 * m else unknown[r - m])


@compiled
def _pull(c: Contact, m: int, unknown: Indices, held: Indices, remembered: Array,
          change: tuple[Array, Array, Array, Array], df: Array) -> None:
    """Put the forces by the held DOFs' motions `remembered` (s, p) and by the changes into `df` (rows, p)."""
    arm, force = change[0], change[3]
    stiffness = np.empty((len(df), len(held)))
    for r in range(len(df)):
        row = _row(r, m, len(c.gap), unknown)
        for k in range(len(held)):
            stiffness[r, k] = c.stiffness[row, held[k]]
    multiply(stiffness, remembered, df)
    for r in range(len(df)):
        row = _row(r, m, len(c.gap), unknown)
        for k in range(df.shape[1]):
            df[r, k] -= c.along[row] * arm[k]
        for k in range(df.shape[1] if len(force) else 0):
            df[r, k] += force[row, k]


@compiled
def _right_hand_sides(c: Contact, f: Array, trial: Array, cone: Array, m: int, unknown: Indices, df: Array,
                      history: Array, friction: Array, columns: Array) -> None:
    """Put minus the derivative of the residual, the unknowns held, into `columns` (p, q); df (rows, p) N."""
    n, rho = len(c.gap), c.penalty
    for r in range(m):
        i = unknown[r]
        x, y, a, b, slope = trial[0, i], trial[1, i], cone[2, i], cone[3, i], cone[1, i]
        gripping = grips(c, i, max(f[2 * n + i], 0.0))[0] * (1.0 - c.asymmetry * x)
        for k in range(len(columns)):
            fx, fy, fz = df[r, k], df[m + r, k], slope * df[2 * m + r, k]
            turned = x * (fy + rho * history[n + i, k]) - y * (fx + rho * history[i, k])
            wider = gripping * friction[i, k] + fz
            columns[k, r] = x * wider - fx - a * turned
            columns[k, m + r] = y * wider - fy - b * turned
    for r in range(2 * m, len(unknown)):
        for k in range(len(columns)):
            columns[k, r] = -df[m + r, k]


@compiled
def _press(c: Contact, unknown: Indices, df: Array, step: Array, pressing: Array) -> None:
    """Put the derivative of the normal force at the slipping nodes into `pressing` (m, p)."""
    n, m, last = len(c.gap), len(pressing), len(unknown)
    by_unknown, pulled = np.empty((last + 1, m)), np.empty((len(step), m))
    for k in range(m):
        z = 2 * n + unknown[k]
        for r in range(last):
            by_unknown[r, k] = c.stiffness[z, unknown[r]]
        by_unknown[last, k] = -c.lift[z]
    multiply(step, by_unknown, pulled)
    for k in range(m):
        for column in range(len(step)):
            pressing[k, column] = df[2 * m + k, column] + pulled[column, k]
