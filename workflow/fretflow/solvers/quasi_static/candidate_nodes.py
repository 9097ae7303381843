"""Nodes within reach: of a curved face only some nodes ever touch, and the others need not be solved for.

A node that is open all the period carries no force, so the contact of the others is that of a smaller joint, whose
flexibility is theirs alone. The motion of the nodes left out follows from the forces and tells whether they stayed
open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import Rest
from fretflow.structure.structure import Complex, DynamicStiffness, MasslessBoundary, Structure, StructureMotion

MARGIN = 0.25  # of the largest elastic indentation; a Hertzian contact is taken up to 1.3 times its radius


@dataclass(frozen=True)
class PartOfFaces:
    """A structure by the massless boundary of a part of its contact nodes (a `Structure`)."""

    whole: Structure
    boundary: MasslessBoundary

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the loads."""
        return self.boundary.inputs

    @property
    def linear(self) -> bool:
        """Return whether the structure is linear."""
        return self.whole.linear

    def massless_boundary(self) -> MasslessBoundary:
        """Return the structure with a massless contact of that part of the nodes."""
        return self.boundary

    def dynamic_stiffness(self, frequency: float, loads: Complex) -> DynamicStiffness:
        """Refuse: the dynamic stiffness is that of all nodes."""
        raise NotImplementedError

    def motion_amplitudes(self, frequency: float, displacement: Complex, loads: Complex) -> StructureMotion:
        """Refuse: the dynamic stiffness is that of all nodes."""
        raise NotImplementedError


def candidate_nodes(problem: PeriodicProblem, start: PeriodicSolution | None) -> NDArray[np.bool_]:
    """Return the nodes (n,) that are likely to touch: closed in `start`, or closed or nearly so under the load."""
    gap = problem.interface.gap
    closed: NDArray[np.bool_] = np.zeros(len(gap), dtype=bool)
    if start is not None:
        closed = np.any(start.state != ContactState.SEPARATION, axis=0)
    if closed.all():
        return closed
    rest = Rest.of(problem)
    pressed = rest.settled(gap)
    bent = rest.flexibility[2::3, 2::3] @ pressed.force[2::3]
    opening = gap + pressed.displacement[2::3]
    near: NDArray[np.bool_] = closed | (opening <= max(MARGIN * bent.max(initial=0.0), opening.min()))  # one at least
    return near


def restrict(problem: PeriodicProblem, nodes: NDArray[np.bool_]) -> PeriodicProblem:
    """Return the problem of `nodes` (n,) alone, the others being free of force."""
    face, law = problem.interface, problem.nodal_law
    mu = np.broadcast_to(law.friction_coefficient, nodes.shape)[nodes]
    pressure = float(problem.normal_load / face.areas.sum())
    return replace(
        problem, structure=PartOfFaces(problem.structure, problem.boundary.part(nodes)),
        law=replace(problem.law, friction_coefficient=mu,
                    reference_pressure=pressure if law.reference_pressure is None else law.reference_pressure),
        interface=Interface(face.nodes[nodes], face.areas[nodes], face.gap[nodes]))


def restrict_solution(solution: PeriodicSolution, nodes: NDArray[np.bool_]) -> PeriodicSolution:
    """Return what `solution` says of `nodes` (n,)."""
    return replace(solution, displacement=solution.displacement[:, nodes], force=solution.force[:, nodes],
                   state=solution.state[:, nodes])


def extend_solution(part: PeriodicSolution, whole: PeriodicProblem, nodes: NDArray[np.bool_]) -> PeriodicSolution:
    """Return the solution for all nodes of `whole` from the `part` of `nodes` (n,); the others are open."""
    samples, b = len(part.state), whole.boundary
    touching = b.part(nodes)
    loads = whole.loads_at(2.0 * np.pi * np.arange(samples) / samples)
    s = touching.free_motion(part.internal, part.displacement.reshape(samples, -1), loads)
    force = np.zeros((samples, len(nodes), 3))
    force[:, nodes] = part.force
    moved = part.force.reshape(samples, -1) @ b.flexibility[np.repeat(nodes, 3)]
    moved += part.internal @ b.motion.T + s @ b.free.T + loads @ b.input_motion.T
    displacement = moved.reshape(samples, -1, 3)
    displacement[:, nodes] = part.displacement
    state = np.full((samples, len(nodes)), ContactState.SEPARATION, dtype=np.int8)
    state[:, nodes] = part.state
    return replace(part, displacement=displacement, force=force, state=state)


def penetrating(solution: PeriodicSolution, interface: Interface, nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which nodes besides `nodes` (n,) penetrate at some time."""
    opening = interface.gap + solution.displacement[:, :, 2].min(axis=0)
    missed: NDArray[np.bool_] = ~nodes & (opening < 0.0)
    return missed
