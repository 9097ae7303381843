"""A solved period of frictional contact differentiated in one march, compiled; see `contact.kernels.sample`.

The p columns are a motions of the internal coordinates, d parameters, and what the contact remembers before the first
sample. The normal load is one coordinate more, the last of the `Contact` given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fretflow.contact.kernels.sample import SLIP, Contact, Factor, Indices, PeriodHistory, States
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.compiled import compiled, multiply
from fretflow.core.records import Array


class Histories(NamedTuple):
    """What v of the parameters change differently at each sample: which they are (v,), and values (v, N, s)."""

    columns: Indices
    values: Array


class Acting(NamedTuple):
    """What the columns change by themselves.

    `motion` (N, e, a), of the coordinates by the motions, the last one being the load, and `friction_slope` (N, a), of
    the `factor` (N,) on friction. By the parameters `own_force` (3 n, d) N, the elastic contact force as far as it is
    the same at all samples, (0, d) if nothing changes that force; then what varies.
    """

    motion: Array
    friction_slope: Array
    factor: Array
    own_force: Array
    loads: Histories
    frictions: Histories
    forces: Histories


class Weights(NamedTuple):
    """What of each sample counts in the sums.

    Of r linear outputs `by_displacement`, `by_force` (r, 3 n) of displacements and given forces, and `by_coordinate`
    (r, e); `way`, `rubbing`, `working` (N, 2, n), by u_t, of path, of sliding and of work; of a slipping node's forces
    `length` |du|, and L over g mu and dL/df_z, `gripping`, `slope` (N, n).
    """

    by_displacement: Array
    by_force: Array
    by_coordinate: Array
    way: Array
    rubbing: Array
    working: Array
    length: Array
    gripping: Array
    slope: Array


class Sums(NamedTuple):
    """What is kept of the march by p columns; its size does not grow with nodes times samples times columns.

    `outputs` (N, r, p); `path`, `sliding` (n, p); `energy` (p,); and the sums of the displacement `moved` (3 n, p), of
    the coordinates `driven` (e, p) and of the normal forces by the parameters themselves `pressed` (n, d).
    """

    outputs: Array
    path: Array
    sliding: Array
    energy: Array
    moved: Array
    driven: Array
    pressed: Array


def empty_sums(shape: tuple[int, int, int], outputs: int, columns: int, parameters: int) -> Sums:
    """Return sums of nothing; the shape is (N, n, e)."""
    samples, nodes, coordinates = shape
    return Sums(np.zeros((samples, outputs, columns)), np.zeros((nodes, columns)), np.zeros((nodes, columns)),
                np.zeros(columns), np.zeros((3 * nodes, columns)), np.zeros((coordinates, columns)),
                np.zeros((nodes, parameters)))


@compiled
def march_columns(c: Contact, factor: Factor, period: PeriodHistory, acting: Acting, weights: Weights, first: int,
                  slope: Array, sums: Sums) -> Array:
    """March the `period` from sample `first` on, sum up, and return the derivative (3 n, p) of the last sample.

    `slope` (3 n, p) is the derivative of the sample before.
    """
    samples, n = period.state.shape
    p = slope.shape[1]
    slope, moved, pressing = slope.copy(), np.empty((3 * n, p)), np.empty((n, p))
    change = (np.zeros((acting.motion.shape[1], p)), np.zeros((n, p)), np.zeros((len(acting.own_force), p)))
    for step in range(samples):
        j = (first + step) % samples
        _change_coordinates(acting, j, change[0])
        _change_friction(c, acting, j, change[1])
        if len(change[2]):
            _change_force(acting, j, change[2])
        m = _slipping(period.state[j])
        differentiate(c, factor, acting.factor[j], period.displacement[j - 1], period, j, slope, change, moved,
                      pressing[:m])
        _sum_outputs(weights, j, acting.motion.shape[2], change, moved, sums)
        _sum_motion(weights, j, moved, sums)
        _sum_slip(weights, j, period.state[j], change[1], pressing, sums)
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
def _change_coordinates(acting: Acting, j: int, motion: Array) -> None:
    """Put what the columns change of coordinates and load at sample j into `motion` (e, p)."""
    load, a = acting.motion.shape[1] - 1, acting.motion.shape[2]
    for i in range(load + 1):
        for k in range(a):
            motion[i, k] = acting.motion[j, i, k]
    for v in range(len(acting.loads.columns)):
        motion[load, a + acting.loads.columns[v]] = acting.loads.values[v, j, 0]


@compiled
def _change_friction(c: Contact, acting: Acting, j: int, friction: Array) -> None:
    """Put what the columns change of g mu at sample j into `friction` (n, p)."""
    a, factor = acting.motion.shape[2], acting.factor[j]
    for i in range(len(friction)):
        for k in range(a):
            friction[i, k] = c.friction[i] * acting.friction_slope[j, k]
        for v in range(len(acting.frictions.columns)):
            friction[i, a + acting.frictions.columns[v]] = factor * acting.frictions.values[v, j, i]


@compiled
def _change_force(acting: Acting, j: int, force: Array) -> None:
    """Put what the parameters change of the elastic force at sample j into `force` (3 n, p)."""
    a = acting.motion.shape[2]
    for i in range(len(force)):
        for k in range(acting.own_force.shape[1]):
            force[i, a + k] = acting.own_force[i, k]
    for v in range(len(acting.forces.columns)):
        for i in range(len(force)):
            force[i, a + acting.forces.columns[v]] += acting.forces.values[v, j, i]


@compiled
def _sum_outputs(weights: Weights, j: int, a: int, change: tuple[Array, Array, Array], moved: Array, sums: Sums
                 ) -> None:
    """Take in the outputs of sample j; a motions of the coordinates."""
    motion, force, outputs, n = change[0], change[2], sums.outputs[j], len(sums.path)
    multiply(weights.by_displacement, moved, outputs)
    for i in range(len(motion)):
        for r in range(len(outputs)):
            for k in range(outputs.shape[1] if weights.by_coordinate[r, i] != 0.0 else 0):
                outputs[r, k] += weights.by_coordinate[r, i] * motion[i, k]
        for k in range(outputs.shape[1]):
            sums.driven[i, k] += motion[i, k]
    for r in range(len(outputs)):
        for i in range(len(force)):
            weight = weights.by_force[r, i]
            for k in range(sums.pressed.shape[1] if weight != 0.0 else 0):
                outputs[r, a + k] += weight * force[i, a + k]
    for i in range(n if len(force) else 0):
        for k in range(sums.pressed.shape[1]):
            sums.pressed[i, k] += force[3 * i + 2, a + k]


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
                motion = moved[3 * i + direction, k]
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
        length, gripping, slope = weights.length[j, i], weights.gripping[j, i], weights.slope[j, i]
        for k in range(len(sums.energy)):
            sums.sliding[i, k] += length * pressing[m, k]
            sums.energy[k] += length * (slope * pressing[m, k] + gripping * friction[i, k])
        m += 1
