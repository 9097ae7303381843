"""The audit of a solved period: unilateral contact and Coulomb's cone at every node and sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import ContactAudit, audit_contact
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution


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
                         float(np.abs(f).max()) / stiffest, tolerance)


def friction_factor(problem: PeriodicProblem, solution: PeriodicSolution) -> NDArray[np.float64]:
    """Return the factor on friction (N,) by how the faces move as a whole."""
    x = solution.internal @ problem.boundary.sliding
    return problem.law.factor(x, time_derivative(x, problem.omega)).factor
