"""The audit of a solved period: unilateral contact and Coulomb's cone at every node and sample."""

from __future__ import annotations

import numpy as np

from fretflow.contact.coulomb import TINY, ContactAudit, audit_contact
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import Surroundings


def audit_period(problem: PeriodicProblem, solution: PeriodicSolution, tolerance: float) -> ContactAudit:
    """Check a period against the contact law of its problem.

    Friction is limited to ``g mu l(f_z) (1 - d t_x)`` (see `contact.coulomb`), g the factor of the instant and t the
    direction of the friction force.

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
    tangential, moved = f[..., 0] + 1j * f[..., 1], u[..., 0] + 1j * u[..., 1]
    arm = solution.rig_displacement[:, 1]
    under = Surroundings.of(problem).conditions(problem.normal_load, arm, np.zeros((len(arm), 0)))
    law = problem.law
    turned = 1.0 - law.asymmetry * tangential.real / np.maximum(np.abs(tangential), TINY)
    limit = under.grip[:, None] * law.slip_limit(np.maximum(f[..., 2], 0.0)) * turned
    stiffest = float(problem.joint.quasi_static().stiffness.diagonal().max())
    return audit_contact(problem.interface.gap + u[..., 2], f, moved - np.roll(moved, 1, axis=0), limit,
                         float(np.abs(f).max()) / stiffest, tolerance)
