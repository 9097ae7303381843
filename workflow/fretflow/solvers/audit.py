"""The audit of a solved period: unilateral contact and Coulomb's cone at every node and sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample

from fretflow.contact.coulomb import ContactAudit, audit_contact
from fretflow.core.records import quantity, record
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.structure.internal_forces import FINER, total_force


def audit_period(problem: PeriodicProblem, solution: PeriodicSolution, tolerance: float) -> ContactAudit:
    """Check a period against the contact law of its problem.

    Friction is limited as in `contact.kernels.cone`, g the factor of the instant and t the direction of friction.

    Parameters
    ----------
    problem, solution
        What was solved, and its period.
    tolerance
        Violation allowed, relative to the largest force and the largest motion.

    Raises
    ------
    AuditError
        If a node pulls, penetrates, carries force while open, leaves the cone, or slides inside it or along it.
    """
    u, f = solution.displacement, solution.force
    moved = u[..., 0] + 1j * u[..., 1]
    limit = problem.nodal_law.directed_limit(f, friction_factor(problem, solution)[:, None])
    stiffest = float(problem.boundary.stiffness.diagonal().max())
    return audit_contact(problem.interface.gap + u[..., 2], f, moved - np.roll(moved, 1, axis=0), limit,
                         float(np.abs(f).max()) / stiffest, tolerance,
                         (problem.normal_load or problem.excitation.amplitude) / len(problem.interface.gap))


@record
class EnergyBalance:
    """Where the energy of a period goes, J: the excitation's work, what dashpots lose, what the contact takes.

    The contact's share is the work of its force on the internal coordinates, in their harmonics, and friction that of
    forces and slips sample by sample; elastic energy of the faces returns, so that both are one as the samples grow.
    """

    excitation: float = quantity("J")
    damping: float = quantity("J")
    contact: float = quantity("J")
    friction: float = quantity("J")

    @property
    def error(self) -> float:
        """Return what of the excitation's work is left unexplained, relative to it."""
        return abs(self.excitation - self.damping - self.contact) / (abs(self.excitation) or 1.0)


def energy_balance(problem: PeriodicProblem, solution: PeriodicSolution) -> EnergyBalance:
    """Return where the energy of a period goes; further forces on the structure count as excitation."""
    b, samples = problem.boundary, len(solution.state)
    velocity = time_derivative(solution.internal, problem.omega)
    loads = problem.loads_at(2.0 * np.pi * np.arange(samples) / samples) @ b.input_force.T
    loads = loads + further_force(problem, solution.internal)
    step = 1.0 / (problem.frequency * samples)
    contact = solution.force.reshape(samples, -1) @ b.transfer.T
    return EnergyBalance(
        excitation=float(np.sum(loads * velocity)) * step,
        damping=float(np.einsum("ji,ik,jk->", velocity, b.internal.damping, velocity)) * step,
        contact=-float(np.sum(contact * velocity)) * step, friction=solution.dissipated_energy)


def further_force(problem: PeriodicProblem, motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the further forces on the coordinates at a motion (N, d), m, in the harmonics of its samples, (N, d) N."""
    if not problem.boundary.forces:
        return np.zeros_like(motion)
    fine = resample(motion, FINER * len(motion))
    force = total_force(problem.boundary.forces, fine, time_derivative(fine, problem.omega)).force
    return np.asarray(resample(force, len(motion)))


def friction_factor(problem: PeriodicProblem, solution: PeriodicSolution) -> NDArray[np.float64]:
    """Return the factor on friction (N,) by how the faces move as a whole."""
    x = solution.internal @ problem.boundary.sliding
    return problem.law.factor(x, time_derivative(x, problem.omega)).factor
