"""Stability of a period by the Floquet multipliers of the linearised structure and contact.

The contact remembers: a perturbation is not only the motion of the internal coordinates but also where the nodes have
slid to. At each time sample the exact tangent of the contact gives, linearly,

    du_j = A_j du_(j-1) + b_j dx_j,    dphi_j = c_j du_(j-1) + d_j dx_j

with dx the coordinates' perturbation and dphi that of the force they feel. The structure is stepped from sample to
sample by the trapezoidal rule with dphi_j implicit, which adds no damping and stays stable where a mode is faster than
the samples. A turn of the period takes the perturbation to itself times the monodromy matrix.

Nodes that stick all the period are left out: what is locked in there neither grows nor decays (two multipliers of
exactly one for each), and belongs to a family of periods that differ by the traction locked in.

Under constant normal forces Coulomb friction and the springs lose of the energy of the difference of any two motions,
so that it cannot grow. Only what couples back can make a period unstable: normal forces that move with friction,
friction that falls with speed, further forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.law import FactorAndSlopes
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.sample import STICK, Array, ContactSystem, PeriodHistory, SampleSolver, SampleState
from fretflow.structure.internal_forces import ForceAndSlopes, total_force
from fretflow.structure.structure import Internal

NEUTRAL = 1e-4  # slid positions may persist with a multiplier of one


@dataclass(frozen=True)
class Around:
    """What follows a motion about a period besides structure and contact, at N samples.

    The coordinates `seen` from the contact (d_a,) and the moving faces' x `sliding` (d_a,) by them; the `factor` on
    friction; further `forces` on all coordinates.
    """

    seen: NDArray[np.intp]
    sliding: Array
    factor: FactorAndSlopes
    forces: ForceAndSlopes

    @classmethod
    def of(cls, problem: PeriodicProblem, motion: Array) -> Around:
        """Return what `problem` holds about the `motion` (N, d) of its coordinates, m."""
        b, velocity = problem.boundary, time_derivative(motion, problem.omega)
        seen = seen_coordinates(b)
        return cls(seen, b.sliding[seen], problem.law.factor(motion @ b.sliding, velocity @ b.sliding),
                   total_force(b.forces, motion, velocity))


def floquet_multipliers(internal: Internal, system: ContactSystem, period: PeriodHistory, frequency: float,
                        around: Around) -> NDArray[np.complex128]:
    """Return the multipliers of a period, largest modulus first.

    Parameters
    ----------
    internal : Internal
    system : ContactSystem
    period : PeriodHistory
        A period of the contact that repeats, N samples.
    frequency : float
        Hz.
    around : Around
        What else follows the motion.
    """
    values = np.linalg.eigvals(monodromy_matrix(internal, system, period, frequency, around))
    return np.asarray(values[np.argsort(-np.abs(values))], dtype=complex)


def is_stable(multipliers: NDArray[np.complex128]) -> bool:
    """Tell whether no multiplier lies outside the unit circle; one on it is neutral, not unstable."""
    return bool(np.abs(multipliers).max(initial=0.0) <= 1.0 + NEUTRAL)


def monodromy_matrix(internal: Internal, system: ContactSystem, period: PeriodHistory, frequency: float,
                     around: Around) -> Array:
    """Return the matrix that takes a perturbation over one period, (2 d + d_a + 2 m, ...).

    Rows: displacements of the coordinates, their velocities, the contact's force on those that it sees, then the x and
    y displacements of the m nodes that do not stick throughout.
    """
    samples, d = len(period.state), len(internal.mass)
    sees = len(around.seen)
    moving = np.flatnonzero(np.any(period.state != STICK, axis=0))
    memory = np.concatenate([3 * moving, 3 * moving + 1])
    size = 2 * d + sees + len(memory)
    start = np.eye(size)
    position, velocity, felt = start[:d], start[d:2 * d], start[2 * d:2 * d + sees]
    slope: Array = np.zeros((3 * system.size, size))
    slope[memory] = start[2 * d + sees:]
    solver, step = SampleSolver(system), _TrapezoidalStep(internal, around, 1.0 / (frequency * samples))
    # columns more: each coordinate's position, 1 m, and the friction's factor by the faces' velocity, 1 m/s
    motion = np.hstack([np.zeros((sees, size)), np.eye(sees, sees + 1)])
    for j in range(samples):
        history = np.column_stack([slope, np.zeros((len(slope), sees + 1))])
        factor_slope = np.concatenate([np.zeros(size), around.factor.by_position[j] * around.sliding,
                                       [around.factor.by_velocity[j]]])
        moved, force = solver.tangent(SampleState.of(period, j), period.displacement[j - 1], history,
                                      system.moved(period.position[j], motion),
                                      float(around.factor.factor[j]), factor_slope)
        position, velocity = step.advance(j, position, velocity, felt, force)
        own = np.vstack([position[around.seen], around.sliding @ velocity[around.seen]])
        slope, felt = moved[:, :size] + moved[:, size:] @ own, force[:, :size] + force[:, size:] @ own
    return np.vstack([position, velocity, felt, slope[memory]])


class _TrapezoidalStep:
    """Perturbations of the structure stepped by the trapezoidal rule.

    ``M (v1 - v0) / h + (C1 v1 + C0 v0) / 2 + (K1 x1 + K0 x0) / 2 = (phi0 + phi1) / 2`` with
    ``x1 - x0 = h (v0 + v1) / 2``; C and K less the slopes of further forces at the sample.
    """

    def __init__(self, internal: Internal, around: Around, h: float) -> None:
        self.h, self.around = h, around
        self.momentum = 2.0 / h * internal.mass
        self.damping = internal.damping - around.forces.by_velocity
        self.stiffness = internal.stiffness - around.forces.by_displacement

    def advance(self, j: int, position: Array, velocity: Array, felt: Array, force: Array) -> tuple[Array, Array]:
        """Return x1 and v1 (d, p) at sample j.

        `felt` (d_a, p) is that before, `force` (d_a, p + d_a + 1) the one after: of the p perturbations with the
        coordinates held, by their positions, and by the faces' velocity.
        """
        seen, sliding, p = self.around.seen, self.around.sliding, felt.shape[1]
        by_position, by_velocity = force[:, p:-1], np.outer(force[:, -1], sliding)
        inert = self.momentum / self.h + self.damping[j] / self.h
        matrix = inert + 0.5 * self.stiffness[j]
        matrix[np.ix_(seen, seen)] -= 0.5 * (by_position + 2.0 / self.h * by_velocity)
        push = (inert - 0.5 * self.stiffness[j - 1]) @ position
        push += (self.momentum - 0.5 * (self.damping[j - 1] - self.damping[j])) @ velocity
        push[seen] += 0.5 * (felt + force[:, :p] - by_velocity @ (2.0 / self.h * position[seen] + velocity[seen]))
        moved: Array = np.asarray(np.linalg.solve(matrix, push), dtype=float)
        return moved, 2.0 / self.h * (moved - position) - velocity
