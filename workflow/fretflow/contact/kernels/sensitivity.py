"""A solved period of frictional contact differentiated in one march, compiled; see `contact_kernel`.

The p columns are a motions of the arm, d parameters, and what the contact remembers before the first sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fretflow.contact.kernels.sample import SLIP, Array, Contact, Factor, Indices, Marched, States
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.compiled import compiled, multiply


class Histories(NamedTuple):
    """What v of the parameters change differently at each sample: which they are (v,), and values (v, N, s)."""

    columns: Indices
    values: Array


class Springs(NamedTuple):
    """Springs in series with the DOFs by parameters: those from ``starts[k]`` to ``starts[k + 1]``, (d + 1,), are of k.

    `dofs`, `softness` (s,): where each is, and its compliance in m/N.
    """

    starts: Indices
    dofs: Indices
    softness: Array


class Acting(NamedTuple):
    """What the columns change by themselves.

    `arm`, `load`, `grip` (N, a): arm position in m, load in N and the factor on friction by the motions; `factor` (N,)
    on friction. By the parameters what is the same at all samples: `own_load` (d,) N, `own_friction` (n, d), and
    `own_force` (3 n, d) N, the elastic contact force, (0, d) if nothing changes that; then what is not.
    """

    arm: Array
    load: Array
    grip: Array
    factor: Array
    own_load: Array
    own_friction: Array
    own_force: Array
    loads: Histories
    frictions: Histories
    forces: Histories
    springs: Springs


class Weights(NamedTuple):
    """What of each sample counts in the sums.

    `mean` (1, n) of u_x; r sums of forces, by displacement and by given force (r, 3 n), by the arm's motion (r, 2);
    `way`, `rubbing`, `working` (N, 2, n), by u_t, of path, of sliding and of work; of a slipping node's forces `length`
    |du|, and L over g mu and dL/df_z, `grip`, `slope` (N, n).
    """

    mean: Array
    by_displacement: Array
    by_force: Array
    by_arm: Array
    way: Array
    rubbing: Array
    working: Array
    length: Array
    grip: Array
    slope: Array


class Sums(NamedTuple):
    """What is kept of the march by p columns; its size does not grow with nodes times samples times columns.

    `displacement`, `approach` (N, p); `forces` (N, r, p); `path`, `sliding` (n, p); `energy` (p,); and the sums of the
    displacement `moved` (3 n, p) and of the normal forces by the parameters themselves `pressed` (n, d).
    """

    displacement: Array
    approach: Array
    forces: Array
    path: Array
    sliding: Array
    energy: Array
    moved: Array
    pressed: Array


def empty_sums(samples: int, nodes: int, forces: int, columns: int, parameters: int) -> Sums:
    """Return sums of nothing."""
    return Sums(np.zeros((samples, columns)), np.zeros((samples, columns)), np.zeros((samples, forces, columns)),
                np.zeros((nodes, columns)), np.zeros((nodes, columns)), np.zeros(columns),
                np.zeros((3 * nodes, columns)), np.zeros((nodes, parameters)))


@compiled
def march_columns(c: Contact, factor: Factor, period: Marched, acting: Acting, weights: Weights, first: int,
                  slope: Array, sums: Sums) -> Array:
    """March the `period` from sample `first` on, sum up, and return the derivative (3 n, p) of the last sample.

    `slope` (3 n, p) is the derivative of the sample before.
    """
    samples, n = period.state.shape
    p = slope.shape[1]
    slope, moved, pressing = slope.copy(), np.empty((3 * n, p)), np.empty((n, p))
    change = (np.zeros(p), np.zeros(p), np.zeros((n, p)), np.zeros((len(acting.own_force), p)))
    for step in range(samples):
        j = (first + step) % samples
        _change_load(acting, j, change[0], change[1])
        _change_friction(c, acting, j, change[2])
        if len(change[3]):
            _change_force(c, acting, period.force[j], j, change[3])
        m = _slipping(period.state[j])
        differentiate(c, factor, acting.factor[j], period.displacement[j - 1], period, j, slope, change, moved,
                      sums.approach[j], pressing[:m])
        _sum_forces(weights, j, acting.arm.shape[1], change, moved, sums)
        _sum_motion(weights, j, moved, sums)
        _sum_slip(weights, j, period.state[j], change[2], pressing, sums)
        slope, moved = moved, slope
    return slope


@compiled
def _slipping(state: States) -> int:
    """Return the number of slipping nodes."""
    m = 0
    for i in range(len(state)):
        m += state[i] == SLIP
    return m


@compiled
def _change_load(acting: Acting, j: int, arm: Array, load: Array) -> None:
    """Put what the columns change of arm and load at sample j into `arm` and `load` (p,)."""
    a = acting.arm.shape[1]
    for k in range(a):
        arm[k], load[k] = acting.arm[j, k], acting.load[j, k]
    for k in range(len(acting.own_load)):
        load[a + k] = acting.own_load[k]
    for v in range(len(acting.loads.columns)):
        load[a + acting.loads.columns[v]] = acting.loads.values[v, j, 0]


@compiled
def _change_friction(c: Contact, acting: Acting, j: int, friction: Array) -> None:
    """Put what the columns change of g mu at sample j into `friction` (n, p)."""
    a, factor = acting.arm.shape[1], acting.factor[j]
    for i in range(len(friction)):
        for k in range(a):
            friction[i, k] = c.friction[i] * acting.grip[j, k]
        for k in range(len(acting.own_load)):
            friction[i, a + k] = factor * acting.own_friction[i, k]
        for v in range(len(acting.frictions.columns)):
            friction[i, a + acting.frictions.columns[v]] = factor * acting.frictions.values[v, j, i]


@compiled
def _change_force(c: Contact, acting: Acting, f: Array, j: int, force: Array) -> None:
    """Put what the parameters change of the elastic force at sample j, of forces f (3 n,), into `force` (3 n, p)."""
    a, springs = acting.arm.shape[1], acting.springs
    for i in range(len(force)):
        for k in range(len(acting.own_load)):
            force[i, a + k] = acting.own_force[i, k]
    for v in range(len(acting.forces.columns)):
        for i in range(len(force)):
            force[i, a + acting.forces.columns[v]] += acting.forces.values[v, j, i]
    for k in range(len(acting.own_load)):
        for s in range(springs.starts[k], springs.starts[k + 1]):
            row = springs.dofs[s]
            shorter = springs.softness[s] * f[row]
            for i in range(len(force)):
                force[i, a + k] -= c.stiffness[row, i] * shorter


@compiled
def _sum_forces(weights: Weights, j: int, a: int, change: tuple[Array, Array, Array, Array], moved: Array, sums: Sums
                ) -> None:
    """Take in the mean displacement and the forces of sample j; a motions of the arm."""
    arm, force, found, n = change[0], change[3], sums.forces[j], weights.mean.shape[1]
    multiply(weights.mean, moved[:n], sums.displacement[j:j + 1])
    multiply(weights.by_displacement, moved, found)
    for r in range(len(found)):
        for k in range(len(arm)):
            found[r, k] -= weights.by_arm[r, 0] * arm[k] + weights.by_arm[r, 1] * sums.approach[j, k]
        for i in range(len(force)):
            weight = weights.by_force[r, i]
            for k in range(sums.pressed.shape[1] if weight != 0.0 else 0):
                found[r, a + k] += weight * force[i, a + k]
    for i in range(n if len(force) else 0):
        for k in range(sums.pressed.shape[1]):
            sums.pressed[i, k] += force[2 * n + i, a + k]


@compiled
def _sum_motion(weights: Weights, j: int, moved: Array, sums: Sums) -> None:
    """Take in the motion of sample j; du_j counts in the increment that ends at j and in the next one."""
    n, p = len(sums.path), len(sums.energy)
    for i in range(len(moved)):
        for k in range(p):
            sums.moved[i, k] += moved[i, k]
    for direction in range(2):
        way, rubbing = weights.way[j, direction], weights.rubbing[j, direction]
        working = weights.working[j, direction]
        for i in range(n):
            counts = way[i] != 0.0 or rubbing[i] != 0.0 or working[i] != 0.0
            for k in range(p if counts else 0):
                motion = moved[direction * n + i, k]
                sums.path[i, k] += way[i] * motion
                sums.sliding[i, k] += rubbing[i] * motion
                sums.energy[k] += working[i] * motion


@compiled
def _sum_slip(weights: Weights, j: int, state: States, friction: Array, pressing: Array, sums: Sums) -> None:
    """Take in what the slipping nodes' forces at sample j change of sliding and work."""
    m = 0
    for i in range(len(state)):
        if state[i] != SLIP:
            continue
        length, grip, slope = weights.length[j, i], weights.grip[j, i], weights.slope[j, i]
        for k in range(len(sums.energy)):
            sums.sliding[i, k] += length * pressing[m, k]
            sums.energy[k] += length * (slope * pressing[m, k] + grip * friction[i, k])
        m += 1
