"""The periodic solution as wear sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.harmonic.periodic import ContactState, PeriodicProblem, PeriodicSolution, PeriodicSolver
from fretflow.wear.cycle import CycleResponse, summarise_cycle


class PeriodicCycle:
    """A `wear.CycleModel` made of a periodic solver and the unworn problem; wear depth opens the gap."""

    state_type = PeriodicSolution

    def __init__(self, solver: PeriodicSolver, problem: PeriodicProblem) -> None:
        self.solver = solver
        self.problem = problem
        self.areas: NDArray[np.float64] = problem.interface.areas
        self.normal_flexibility: NDArray[np.float64] = problem.joint.quasi_static().flexibility[2::3, 2::3]

    def cycle(self, depth: NDArray[np.float64],
              start: PeriodicSolution | None) -> tuple[CycleResponse, PeriodicSolution]:
        """Return the steady period of the contact worn by `depth` (nodes,), m."""
        interface = self.problem.interface
        worn = replace(self.problem, interface=replace(interface, gap=interface.gap + depth))
        solution = self.solver.solve(worn, start)
        return respond(solution, worn.interface), solution


def respond(solution: PeriodicSolution, interface: Interface) -> CycleResponse:
    """Return what `solution` does to the contact `interface`, whose gap includes the wear."""
    return summarise_cycle(solution.displacement, solution.force, solution.slip_increments,
                           solution.state != ContactState.OPEN, interface.gap, interface.areas)
