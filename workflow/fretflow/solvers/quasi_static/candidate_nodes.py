"""Nodes within reach: of a curved face only some nodes ever touch, and the others need not be solved for.

A node that is open all the period carries no force, so the contact of the others is that of a smaller joint, whose
flexibility is theirs alone. The motion of the nodes left out follows from the forces and tells whether they stayed
open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import frictionless_preload
from fretflow.solvers.quasi_static.sample import ContactSystem
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint

MARGIN = 0.25  # of the largest elastic indentation; a Hertzian contact is taken up to 1.3 times its radius


def candidate_nodes(problem: PeriodicProblem, joint: QuasiStaticJoint,
                 start: PeriodicSolution | None) -> NDArray[np.bool_]:
    """Return the nodes (n,) that are likely to touch: closed in `start`, or closed or nearly so under the load."""
    gap, normal = problem.interface.gap, joint.flexibility[2::3, 2::3]
    system = ContactSystem.of(problem, joint.stiffness)
    force, approach, _ = frictionless_preload(system, normal)
    bent = normal @ force
    near: NDArray[np.bool_] = gap + approach + bent < MARGIN * bent.max()
    return near if start is None else near | np.any(start.state != ContactState.SEPARATION, axis=0)


def restrict(problem: PeriodicProblem, joint: QuasiStaticJoint, nodes: NDArray[np.bool_]) -> PeriodicProblem:
    """Return the problem of `nodes` (n,) alone, the others being free of force."""
    face = problem.interface
    pressure = problem.reference_pressure
    return replace(
        problem, joint=joint.part(nodes),
        friction_coefficient=np.broadcast_to(problem.friction_coefficient, nodes.shape)[nodes],
        reference_pressure=problem.normal_load / float(face.areas.sum()) if pressure is None else pressure,
        interface=Interface(nodes=face.nodes[nodes], areas=face.areas[nodes], gap=face.gap[nodes]))


def restrict_solution(solution: PeriodicSolution, nodes: NDArray[np.bool_]) -> PeriodicSolution:
    """Return what `solution` says of `nodes` (n,)."""
    return replace(solution, displacement=solution.displacement[:, nodes], force=solution.force[:, nodes],
                   state=solution.state[:, nodes])


def extend_solution(part: PeriodicSolution, joint: QuasiStaticJoint, nodes: NDArray[np.bool_]) -> PeriodicSolution:
    """Return the solution for all nodes of `joint` from the `part` of `nodes` (n,); the others are open."""
    samples, dofs = len(part.state), np.repeat(nodes, 3)
    force = np.zeros((samples, len(nodes), 3))
    force[:, nodes] = part.force
    bent = part.force.reshape(samples, -1) @ joint.flexibility[dofs]
    arm = np.stack([part.rig_displacement[:, 1], np.zeros(samples)], axis=1)
    displacement = (bent + arm @ joint.motion.T).reshape(samples, -1, 3)
    displacement[:, :, 2] += np.mean(part.displacement[:, :, 2] - displacement[:, nodes, 2], axis=1)[:, None]
    displacement[:, nodes] = part.displacement
    state = np.full((samples, len(nodes)), ContactState.SEPARATION, dtype=np.int8)
    state[:, nodes] = part.state
    return replace(part, displacement=displacement, force=force, state=state)


def penetrating(solution: PeriodicSolution, interface: Interface, nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which nodes besides `nodes` (n,) penetrate at some time."""
    opening = interface.gap + solution.displacement[:, :, 2].min(axis=0)
    missed: NDArray[np.bool_] = ~nodes & (opening < 0.0)
    return missed
