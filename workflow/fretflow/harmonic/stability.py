"""Stability of a period by the Floquet multipliers of the linearised rig and contact.

The contact remembers: a perturbation is not only the rig's motion (four states) but also where the nodes have slid
to. At each time sample the exact tangent of the contact gives, linearly,

    du_j = A_j du_(j-1) + b_j dx_j,    dphi_j = c_j du_(j-1) + d_j dx_j

with dx the arm's perturbation and dphi that of the friction force. The rig is stepped from sample to sample by the
trapezoidal rule with dphi_j implicit, which adds no damping and stays stable where a mode of the rig is faster than
the samples. A turn of the period takes the perturbation to itself times the monodromy matrix.

Nodes that stick all the period are left out: what is locked in there neither grows nor decays (two multipliers of
exactly one for each), and belongs to a family of periods that differ by the traction locked in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.harmonic.contact_march import Trajectory
from fretflow.harmonic.contact_sample import STICK, Array, ContactSystem, SampleSolver
from fretflow.rig.lumped import LumpedRig

NEUTRAL = 1e-4  # slid positions may persist with a multiplier of one
RIG_STATES = 5  # block and arm position, their velocities, and the friction force at the last sample


def floquet_multipliers(rig: LumpedRig, system: ContactSystem, period: Trajectory,
                        frequency: float) -> NDArray[np.complex128]:
    """Return the multipliers of a period, largest modulus first.

    Parameters
    ----------
    rig : LumpedRig
    system : ContactSystem
    period : Trajectory
        A period of the contact that repeats, N samples.
    frequency : float
        Hz.
    """
    values = np.linalg.eigvals(monodromy_matrix(rig, system, period, frequency))
    return np.asarray(values[np.argsort(-np.abs(values))], dtype=complex)


def is_stable(multipliers: NDArray[np.complex128]) -> bool:
    """Tell whether no multiplier lies outside the unit circle; one on it is neutral, not unstable."""
    return bool(np.abs(multipliers).max(initial=0.0) <= 1.0 + NEUTRAL)


def monodromy_matrix(rig: LumpedRig, system: ContactSystem, period: Trajectory, frequency: float) -> Array:
    """Return the matrix that takes a perturbation over one period, (5 + 2 m, 5 + 2 m).

    Rows: block and arm displacement, their velocities, friction force, then the x and y displacements of the m nodes
    that do not stick throughout.
    """
    n, samples = system.size, len(period.arm)
    moving = np.flatnonzero(np.any(period.state != STICK, axis=0))
    memory = np.concatenate([moving, n + moving])
    size = RIG_STATES + len(memory)
    start = np.eye(size)
    position, velocity, friction = start[:2], start[2:4], start[4]
    slope: Array = np.zeros((3 * n, size))
    slope[memory] = start[RIG_STATES:]
    solver, step = SampleSolver(system), _TrapezoidalRig(rig, 1.0 / (frequency * samples))
    unit = np.append(np.zeros(size), 1.0)
    for j in range(samples):
        history = np.column_stack([slope, np.zeros(3 * n)])
        moved, force = solver.tangent(period.sample(j), period.displacement[j - 1], history, unit)
        position, velocity = step.advance(position, velocity, friction + force[:-1], float(force[-1]))
        slope = moved[:, :-1] + np.outer(moved[:, -1], position[1])
        friction = force[:-1] + force[-1] * position[1]
    return np.vstack([position, velocity, friction, slope[memory]])


class _TrapezoidalRig:
    """Perturbations of the rig stepped by the trapezoidal rule.

    ``M (v1 - v0) / h + C (v0 + v1) / 2 + K (x0 + x1) / 2 = (phi0 + phi1) / 2`` with ``x1 - x0 = h (v0 + v1) / 2``.
    """

    def __init__(self, rig: LumpedRig, h: float) -> None:
        self.h = h
        self.momentum = 2.0 / h * rig.mass
        inert = self.momentum / h + rig.damping / h
        self.after, self.before = inert + 0.5 * rig.stiffness, inert - 0.5 * rig.stiffness

    def advance(self, position: Array, velocity: Array, force: Array, stiffness: float) -> tuple[Array, Array]:
        """Return x1 and v1 (2, p); ``phi0 + phi1 = force + stiffness * x1[arm]``."""
        matrix = self.after.copy()
        matrix[1, 1] -= 0.5 * stiffness
        push = self.before @ position + self.momentum @ velocity
        push[1] += 0.5 * force
        moved: Array = np.asarray(np.linalg.solve(matrix, push), dtype=float)
        return moved, 2.0 / self.h * (moved - position) - velocity
