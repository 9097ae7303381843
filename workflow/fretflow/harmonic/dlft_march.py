"""The period of the contact forces marched in time: friction has memory, so samples come one after the other.

All nodes, and all derivatives, march together. The state of a node is its tangential force, x + i y; the map
of that state over one period is not expansive, and its fixed point is found by Newton's method node by node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import TINY, ReturnTangent, return_tangent
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record

ROUND_OFF = 1e-13
TOUCHING = 1e-11  # of the largest disc, a distance from its edge that counts as none; above the round-off
REMEMBERED = 1e-10  # of a state's change, below which a period does not reduce it
MAX_PERIODS = 200
NODES_AT_ONCE = 256  # bounds the memory of the marched derivatives
UNIT_STATES = np.array([1.0, 1.0j])


@record
class PeriodicFriction:
    """Periodic tangential forces and how they were reached."""

    trial: NDArray[np.complex128] = quantity("N", "(N, nodes), force that sticking would need")
    first_trial: NDArray[np.complex128] = quantity("N", "(N, nodes), the same in the first period")
    force: NDArray[np.complex128] = quantity("N", "(N, nodes)")
    defect: float = quantity("N")  # largest change of a node's state over the period
    periods: int


def march_period(state: NDArray[np.complex128], increments: NDArray[np.complex128], limit: NDArray[np.float64]
                 ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """March one period from `state` (nodes,); return trials and forces, (N, nodes) in N.

    Parameters
    ----------
    increments
        Change of the force that sticking would need since the sample before, (N, nodes) in N.
    limit
        Radius of the friction disc, (N, nodes) in N.
    """
    trial, force = np.empty_like(increments), np.empty_like(increments)
    size = np.empty(increments.shape[1])
    for j in range(len(increments)):
        np.add(state, increments[j], out=trial[j])
        np.abs(trial[j], out=size)
        np.maximum(size, TINY, out=size)
        np.divide(limit[j], size, out=size)
        np.minimum(size, 1.0, out=size)
        state = np.multiply(trial[j], size, out=force[j])
    return trial, force


def periodic_friction(drive: NDArray[np.complex128], limit: NDArray[np.float64]) -> PeriodicFriction:
    """Find the periodic friction force under a periodic `drive`.

    Parameters
    ----------
    drive
        Force that a node which never slipped would carry, (N, nodes) in N. That is also where the state
        starts.
    limit
        Radius of the friction disc, (N, nodes) in N.

    Raises
    ------
    NonConvergenceError
        If the state of a node does not repeat; the history holds the defects in N.
    """
    increments = drive - np.roll(drive, 1, axis=0)
    tolerance = ROUND_OFF * max(float(np.max(limit)), float(TINY))
    trial, force = march_period(drive[-1], increments, limit)
    first, start = trial, force[-1].copy()
    trial, force = march_period(start, increments, limit)
    defect = np.abs(force[-1] - start)
    history = [float(defect.max())]
    open_nodes = np.flatnonzero(defect > tolerance)
    while open_nodes.size:
        if len(history) >= MAX_PERIODS:
            raise NonConvergenceError("contact state does not repeat from period to period; raise samples",
                                      history)
        own = np.ix_(np.arange(len(limit)), open_nodes)
        end = force[-1, open_nodes]
        if len(history) % 2:  # a plain period between Newton steps keeps the map's non-expansion
            end = _newton_start(start[open_nodes], end, return_tangent(trial[own], limit[own]))
        start[open_nodes] = end
        trial[own], force[own] = march_period(start[open_nodes], increments[own], limit[own])
        defect[open_nodes] = np.abs(force[-1, open_nodes] - start[open_nodes])
        history.append(float(defect.max()))
        open_nodes = np.flatnonzero(defect > tolerance)
    return PeriodicFriction(trial=trial, first_trial=first, force=force, defect=history[-1],
                            periods=len(history) + 1)


def friction_derivative(friction: PeriodicFriction, limit: NDArray[np.float64],
                        limit_rate: NDArray[np.float64], basis: NDArray[np.float64],
                        analysis: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the derivative of the tangential forces' coefficients by those of the drive.

    Parameters
    ----------
    friction
        The periodic forces.
    limit, limit_rate
        Disc radius in N and its derivative by the normal drive, (N, nodes).
    basis, analysis
        Matrices from coefficients to samples (N, q) and back (q, N).

    Returns
    -------
    ndarray
        (nodes, q, q, 3): node, coefficient of the force x + i y, coefficient and component of the drive.
    """
    tangent = _touching_tangent(friction.trial, limit)
    nodes, q = limit.shape[1], basis.shape[1]
    derivative = np.zeros((nodes, q, q, 3), dtype=complex)
    derivative[:, :, :, 0], derivative[:, :, :, 1] = np.eye(q), 1j * np.eye(q)
    sticks = np.all(tangent.direct == 1.0, axis=0)
    cycling = np.flatnonzero(~sticks)
    settles = np.any(np.abs(friction.first_trial) > limit, axis=0)
    settles[cycling] &= _remembers(_of_nodes(tangent, cycling))
    left = np.zeros((nodes, 3 * q), dtype=complex)  # of the force that slip in the first period has left
    for part in _parts(np.flatnonzero(settles)):
        own = return_tangent(friction.first_trial[:, part], limit[:, part])
        end = _march_columns(own, limit_rate[:, part], basis, left[part])[-1, :, :-2]
        left[part] = end - _drive_columns(basis)[-1]
    derivative[sticks, 0] += left[sticks].reshape(-1, q, 3)
    for part in _parts(cycling):
        derivative[part] = _march_tangent(_of_nodes(tangent, part), limit_rate[:, part], basis, analysis, left[part])
    return derivative


def _touching_tangent(trial: NDArray[np.complex128], limit: NDArray[np.float64]) -> ReturnTangent:
    """Return the tangent of slip also where the disc is just touched.

    There a node that slipped in earlier periods has come to rest, and stays on the disc as the drive changes; whether
    round-off leaves it inside or outside must not matter.
    """
    size = np.abs(trial)
    touches = size >= limit - TOUCHING * float(np.max(limit))
    return return_tangent(trial, np.where(touches, np.minimum(limit, size * (1.0 - np.finfo(float).eps)), limit))


def _of_nodes(tangent: ReturnTangent, nodes: NDArray[np.int64]) -> ReturnTangent:
    return ReturnTangent(tangent.direct[:, nodes], tangent.mirrored[:, nodes], tangent.radial[:, nodes])


def _parts(nodes: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return np.array_split(nodes, -(-nodes.size // NODES_AT_ONCE)) if nodes.size else []


def _drive_columns(basis: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the derivative (N, 3 q) of the drive by its coefficients; the normal ones do not enter it."""
    columns = np.zeros((*basis.shape, 3), dtype=complex)
    columns[:, :, 0], columns[:, :, 1] = basis, 1j * basis
    return columns.reshape(len(basis), -1)


def _march_columns(tangent: ReturnTangent, limit_rate: NDArray[np.float64], basis: NDArray[np.float64],
                   left: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """March the derivatives of the state by all coefficients (3 q) and by the first state (2).

    Those by the coefficients start with the drive's and `left` (nodes, 3 q).
    """
    samples, nodes = limit_rate.shape
    drive = _drive_columns(basis)
    steps = np.hstack([drive - np.roll(drive, 1, axis=0), np.zeros((samples, 2))])
    direct, mirrored = tangent.direct[:, :, None], tangent.mirrored[:, :, None]
    radial = (tangent.radial * limit_rate)[:, :, None]
    history = np.empty((samples, nodes, steps.shape[1]), dtype=complex)
    current = np.hstack([drive[-1] + left, np.broadcast_to(UNIT_STATES, (nodes, 2))])
    scratch = np.empty_like(current)
    for j in range(samples):
        current = np.add(current, steps[j], out=history[j])
        np.conjugate(current, out=scratch)
        scratch *= mirrored[j]
        current *= direct[j]
        current += scratch
        current[:, 2:-2:3] += radial[j] * basis[j]
    return history


def _march_tangent(tangent: ReturnTangent, limit_rate: NDArray[np.float64], basis: NDArray[np.float64],
                   analysis: NDArray[np.float64], left: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the derivative (nodes, q, q, 3) of nodes that slip or open; `left` as in `_march_columns`."""
    samples, nodes = limit_rate.shape
    history = _march_columns(tangent, limit_rate, basis, left)
    change = history[-1, :, :-2] - _drive_columns(basis)[-1] - left
    start = _solve_state(history[-1, :, -2:], change)
    coefficients = (analysis @ history.reshape(samples, -1)).reshape(len(analysis), nodes, -1)
    result = coefficients[..., :-2]
    result = result + coefficients[..., -2:-1] * start.real + coefficients[..., -1:] * start.imag
    return np.asarray(result.transpose(1, 0, 2).reshape(nodes, len(analysis), -1, 3))


def _newton_start(start: NDArray[np.complex128], end: NDArray[np.complex128],
                  tangent: ReturnTangent) -> NDArray[np.complex128]:
    """Return the state (nodes,) that Newton's method expects to repeat."""
    return np.asarray(start + _solve_state(_period_map(tangent), (end - start)[:, None])[:, 0])


def _period_map(tangent: ReturnTangent) -> NDArray[np.complex128]:
    """Return the derivatives (nodes, 2) of the state after a period by the real and imaginary part of the first."""
    columns = np.broadcast_to(UNIT_STATES, (tangent.direct.shape[1], 2))
    for direct, mirrored in zip(tangent.direct, tangent.mirrored, strict=True):
        columns = direct[:, None] * columns + mirrored[:, None] * columns.conj()
    return columns


def _remembers(tangent: ReturnTangent) -> NDArray[np.bool_]:
    """Return the nodes whose map of a period keeps some direction of the state: the period does not determine it."""
    return np.asarray(np.linalg.svd(_less_map(_period_map(tangent)), compute_uv=False)[:, -1] <= REMEMBERED)


def _less_map(columns: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return ``I - G`` (nodes, 2, 2)."""
    return np.eye(2) - np.stack([columns.real, columns.imag], axis=1)


def _solve_state(columns: NDArray[np.complex128], change: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Solve ``(I - G) d = change`` per node; G (nodes, 2) are the period map's columns, change is (nodes, m).

    Directions in which the map is the identity (a node that sticks) are left alone.
    """
    inverse = np.linalg.pinv(_less_map(columns), rcond=REMEMBERED)
    real = inverse @ np.stack([change.real, change.imag], axis=1)
    return np.asarray(real[:, 0] + 1j * real[:, 1])
