"""Stability of a period by the Floquet multipliers of the linearised rig and contact.

The contact remembers: a perturbation is not only the rig's motion (four states) but also where the nodes have slid
to. At each time sample the exact tangent of the contact gives, linearly,

    du_j = A_j du_(j-1) + b_j dx_j,    dphi_j = c_j du_(j-1) + d_j dx_j

with dx the arm's perturbation and dphi that of the friction force. The rig is stepped from sample to sample by the
trapezoidal rule with dphi_j implicit, which adds no damping and stays stable where a mode of the rig is faster than
the samples. A turn of the period takes the perturbation to itself times the monodromy matrix.

Nodes that stick all the period are left out: what is locked in there neither grows nor decays (two multipliers of
exactly one for each), and belongs to a family of periods that differ by the traction locked in.

Under constant normal forces Coulomb friction and the springs lose of the energy of the difference of any two motions,
so that it cannot grow. Only what couples back can make a period unstable: normal forces that move with friction,
friction that falls with speed, forces on the rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.march import PeriodHistory
from fretflow.solvers.quasi_static.sample import STICK, Array, ContactSystem, Instant, SampleSolver
from fretflow.structure.two_mass_rig.lumped import LumpedRig

NEUTRAL = 1e-4  # slid positions may persist with a multiplier of one
RIG_STATES = 5  # block and arm position, their velocities, and the friction force at the last sample


@dataclass(frozen=True)
class Around:
    """What follows a motion about a period besides rig and contact, at N samples.

    `load` (N,) N and its `load_slope`, N/m; the factor `grip` (N,) on friction and its derivatives by the arm's
    position, 1/m, and velocity, s/m; the derivatives (N, 2, 2) of further forces on block and arm, N/m and N s/m.
    """

    load: Array
    load_slope: float
    grip: Array
    grip_by_position: Array
    grip_by_velocity: Array
    force_by_position: Array
    force_by_velocity: Array

    @classmethod
    def nothing(cls, load: float, samples: int) -> Around:
        """Return a constant load and no more."""
        none, forces = np.zeros(samples), np.zeros((samples, 2, 2))
        return cls(np.full(samples, load), 0.0, np.ones(samples), none, none, forces, forces)

    @classmethod
    def of(cls, problem: PeriodicProblem, motion: Array) -> Around:
        """Return what `problem` holds about the `motion` (N, 2) of block and arm, m."""
        plain = cls.nothing(problem.normal_load, len(motion))
        velocity, arm = time_derivative(motion, problem.omega), motion[:, 1]
        grip, by_position, by_velocity = plain.grip, plain.grip_by_position, plain.grip_by_velocity
        for factor in problem.motion_factors:
            value, own_by_position, own_by_velocity = factor(arm, velocity[:, 1])
            by_position = value * by_position + grip * own_by_position
            by_velocity = value * by_velocity + grip * own_by_velocity
            grip = grip * value
        force_by_position, force_by_velocity = plain.force_by_position, plain.force_by_velocity
        for force in problem.rig_forces:
            at = force(motion, velocity)
            force_by_position = force_by_position + at.by_displacement
            force_by_velocity = force_by_velocity + at.by_velocity
        return cls(plain.load + problem.load_slope * arm, problem.load_slope, grip, by_position, by_velocity,
                   force_by_position, force_by_velocity)

    def instant(self, j: int) -> Instant:
        """Return load and grip at sample j."""
        return Instant(float(self.load[j]), float(self.grip[j]))


def floquet_multipliers(rig: LumpedRig, system: ContactSystem, period: PeriodHistory, frequency: float,
                        around: Around | None = None) -> NDArray[np.complex128]:
    """Return the multipliers of a period, largest modulus first.

    Parameters
    ----------
    rig : LumpedRig
    system : ContactSystem
    period : PeriodHistory
        A period of the contact that repeats, N samples.
    frequency : float
        Hz.
    around : Around, optional
        What else follows the motion; by default nothing.
    """
    values = np.linalg.eigvals(monodromy_matrix(rig, system, period, frequency, around))
    return np.asarray(values[np.argsort(-np.abs(values))], dtype=complex)


def is_stable(multipliers: NDArray[np.complex128]) -> bool:
    """Tell whether no multiplier lies outside the unit circle; one on it is neutral, not unstable."""
    return bool(np.abs(multipliers).max(initial=0.0) <= 1.0 + NEUTRAL)


def monodromy_matrix(rig: LumpedRig, system: ContactSystem, period: PeriodHistory, frequency: float,
                     around: Around | None = None) -> Array:
    """Return the matrix that takes a perturbation over one period, (5 + 2 m, 5 + 2 m).

    Rows: block and arm displacement, their velocities, friction force, then the x and y displacements of the m nodes
    that do not stick throughout.
    """
    n, samples = system.size, len(period.arm)
    at = Around.nothing(system.load, samples) if around is None else around
    moving = np.flatnonzero(np.any(period.state != STICK, axis=0))
    memory = np.concatenate([moving, n + moving])
    size = RIG_STATES + len(memory)
    start = np.eye(size)
    position, velocity, friction = start[:2], start[2:4], start[4]
    slope: Array = np.zeros((3 * n, size))
    slope[memory] = start[RIG_STATES:]
    solver, step = SampleSolver(system), _TrapezoidalRig(rig, at, 1.0 / (frequency * samples))
    # two columns more: the arm's position and the friction's factor by its velocity, 1 m and 1 m/s
    arm, load = (np.concatenate([np.zeros(size), values]) for values in ([1.0, 0.0], [at.load_slope, 0.0]))
    for j in range(samples):
        history = np.column_stack([slope, np.zeros((3 * n, 2))])
        grip = np.concatenate([np.zeros(size), [at.grip_by_position[j], at.grip_by_velocity[j]]])
        moved, force = solver.tangent(period.sample(j), period.displacement[j - 1], history, arm, at.instant(j), load,
                                      grip)
        position, velocity = step.advance(j, position, velocity, friction, force)
        slope = moved[:, :-2] + np.outer(moved[:, -2], position[1]) + np.outer(moved[:, -1], velocity[1])
        friction = force[:-2] + force[-2] * position[1] + force[-1] * velocity[1]
    return np.vstack([position, velocity, friction, slope[memory]])


class _TrapezoidalRig:
    """Perturbations of the rig stepped by the trapezoidal rule.

    ``M (v1 - v0) / h + (C1 v1 + C0 v0) / 2 + (K1 x1 + K0 x0) / 2 = (phi0 + phi1) / 2`` with
    ``x1 - x0 = h (v0 + v1) / 2``; C and K less the slopes of further forces at the sample.
    """

    def __init__(self, rig: LumpedRig, around: Around, h: float) -> None:
        self.h = h
        self.momentum = 2.0 / h * rig.mass
        self.damping = rig.damping - around.force_by_velocity
        self.stiffness = rig.stiffness - around.force_by_position

    def advance(self, j: int, position: Array, velocity: Array, friction: Array, force: Array) -> tuple[Array, Array]:
        """Return x1 and v1 (2, p) at sample j.

        `friction` (p,) is that before, `force` (p + 2,) the one after: of the p perturbations with the arm held, and
        by the arm's position and velocity.
        """
        inert = self.momentum / self.h + self.damping[j] / self.h
        matrix = inert + 0.5 * self.stiffness[j]
        matrix[1, 1] -= 0.5 * (force[-2] + 2.0 / self.h * force[-1])
        push = (inert - 0.5 * self.stiffness[j - 1]) @ position
        push += (self.momentum - 0.5 * (self.damping[j - 1] - self.damping[j])) @ velocity
        push[1] += 0.5 * (friction + force[:-2] - force[-1] * (2.0 / self.h * position[1] + velocity[1]))
        moved: Array = np.asarray(np.linalg.solve(matrix, push), dtype=float)
        return moved, 2.0 / self.h * (moved - position) - velocity
