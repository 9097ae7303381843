"""The period of the contact forces marched in time: friction has memory, so samples come one after the other.

All derivatives march together. The state of a node is its tangential force, x + i y; the map of that state over one
period is not expansive, and its fixed point is found by Newton's method node by node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import ReturnTangent, return_tangent
from fretflow.contact.kernels.cone import SMALLEST
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.solvers.dlft.kernel import REMEMBERED, march_derivatives, period_maps, settle

ROUND_OFF = 1e-13
TOUCHING = 1e-11  # of the largest disc, a distance from its edge that counts as none; above the round-off
MAX_PERIODS = 200
NODES_AT_ONCE = 256  # bounds the memory of the marched derivatives


@record
class PeriodicFriction:
    """Periodic tangential forces and how they were reached."""

    trial: NDArray[np.complex128] = quantity("N", "(N, nodes), force that sticking would need")
    first_trial: NDArray[np.complex128] = quantity("N", "(N, nodes), the same in the first period")
    force: NDArray[np.complex128] = quantity("N", "(N, nodes)")
    periods: int


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
    tolerance = ROUND_OFF * max(float(np.max(limit)), SMALLEST)
    first, trial, force = (np.empty(drive.shape[::-1], dtype=complex) for _ in range(3))
    defects = np.zeros(MAX_PERIODS)
    count = settle(np.ascontiguousarray(drive.T), np.ascontiguousarray(limit.T), tolerance, first, trial, force,
                   defects)
    history = [float(defect) for defect in defects[:count]]
    if history[-1] > tolerance:
        raise NonConvergenceError("contact state does not repeat from period to period; raise samples", history)
    return PeriodicFriction(trial=trial.T, first_trial=first.T, force=force.T, periods=count + 1)


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
        (nodes, q, 3, q): node, coefficient of the force x + i y, component and coefficient of the drive.
    """
    trial, first = np.ascontiguousarray(friction.trial.T), np.ascontiguousarray(friction.first_trial.T)
    discs, rates = np.ascontiguousarray(limit.T), np.ascontiguousarray(limit_rate.T)
    tangent = _touching_tangent(trial, discs)
    nodes, q = limit.shape[1], basis.shape[1]
    derivative = np.zeros((nodes, q, 3, q), dtype=complex)
    derivative[:, :, 0], derivative[:, :, 1] = np.eye(q), 1j * np.eye(q)
    sticks = np.all(tangent.direct == 1.0, axis=1)
    cycling = np.flatnonzero(~sticks)
    settles = np.any(np.abs(first) > discs, axis=1)
    less = np.zeros((nodes, 2, 2))
    period_maps(tangent.direct, tangent.mirrored, less)
    settles[cycling] &= np.linalg.svd(less[cycling], compute_uv=False)[:, -1] <= REMEMBERED
    left = np.zeros((nodes, 2, 3 * q))  # of the force that slip in the first period has left
    for part in _parts(np.flatnonzero(settles)):
        own = return_tangent(first[part], discs[part])
        end = _march(own, rates[part], basis, left[part])[:, -1, :, :-2]
        left[part] = end - _last_drive(basis)
    derivative[sticks, 0] += (left[sticks, 0] + 1j * left[sticks, 1]).reshape(-1, 3, q)
    inverse = np.linalg.pinv(less, rcond=REMEMBERED)
    for part in _parts(cycling):
        own = ReturnTangent(tangent.direct[part], tangent.mirrored[part], tangent.radial[part])
        history = _march(own, rates[part], basis, left[part])
        start = inverse[part] @ (history[:, -1, :, :-2] - _last_drive(basis) - left[part])
        coefficients = analysis @ history.reshape(len(part), len(basis), -1)
        derivative[part] = _periodic(coefficients.reshape(len(part), q, 2, -1), start)
    return derivative


def _periodic(coefficients: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the derivatives (nodes, q, 3, q) with the first state moving by `start` (nodes, 2, 3 q)."""
    nodes, q = coefficients.shape[:2]
    moved = coefficients[..., :-2] + coefficients[..., -2:] @ start[:, None]
    return np.asarray((moved[:, :, 0] + 1j * moved[:, :, 1]).reshape(nodes, q, 3, q))


def _touching_tangent(trial: NDArray[np.complex128], limit: NDArray[np.float64]) -> ReturnTangent:
    """Return the tangent of slip also where the disc is just touched.

    There a node that slipped in earlier periods has come to rest, and stays on the disc as the drive changes; whether
    round-off leaves it inside or outside must not matter.
    """
    size = np.abs(trial)
    touches = size >= limit - TOUCHING * float(np.max(limit))
    return return_tangent(trial, np.where(touches, np.minimum(limit, size * (1.0 - np.finfo(float).eps)), limit))


def _parts(nodes: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return np.array_split(nodes, -(-nodes.size // NODES_AT_ONCE)) if nodes.size else []


def _last_drive(basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative (2, 3 q) of the last drive by its coefficients; the normal ones do not enter it."""
    last, none = basis[-1], np.zeros(basis.shape[1])
    return np.array([np.concatenate([last, none, none]), np.concatenate([none, last, none])])


def _march(tangent: ReturnTangent, limit_rate: NDArray[np.float64], basis: NDArray[np.float64],
           left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives (nodes, N, 2, 3 q + 2) of `march_derivatives`; they start with the drive's and `left`."""
    history = np.empty((len(left), len(basis), 2, left.shape[2] + 2))
    history[:, -1, :, :-2] = _last_drive(basis) + left
    history[:, -1, :, -2:] = np.eye(2)
    march_derivatives(tangent.direct, tangent.mirrored, tangent.radial * limit_rate, basis, history)
    return history
