"""What the rig does under a hypothesis: its periods, its wear, and with which effects and parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fretflow.contact.interface import Interface
from fretflow.core.records import Array
from fretflow.effects.effect import Effect
from fretflow.effects.model import EffectModel
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.wear.history import WearStep


@dataclass(frozen=True)
class Hypothesis:
    """Factors on friction, wear coefficient, moving mass, the specimens' compliance and the hinge's damping.

    Effects are sorted by id.
    """

    effects: tuple[Effect, ...] = ()
    friction: float = 1.0
    wear: float = 1.0
    mass: float = 1.0
    compliance: float = 1.0
    damping: float = 1.0


class Resolution(NamedTuple):
    """How finely a simulation is made: a simulation of another one is a start, and not the same prediction."""

    nodes: int
    samples: int
    wear_tolerance: float


@dataclass(frozen=True)
class Period:
    """One solved period of a simulation, and the joint it is of."""

    problem: PeriodicProblem
    solution: PeriodicSolution
    step: WearStep
    elapsed: float
    condition: PeriodicProblem  # the baseline's, at the period's drive, load and frequency


@dataclass(frozen=True)
class Simulation:
    """All that a recording shows of a hypothesis."""

    hypothesis: Hypothesis
    model: EffectModel
    coefficient: float
    loops: tuple[Period, ...]
    sweep: tuple[Period, ...]
    steps: tuple[WearStep, ...]
    resolution: Resolution

    @property
    def depth(self) -> Array:
        """Return the depth (nodes,) at the end, m."""
        return self.steps[-1].depth

    def has_effects_of(self, hypothesis: Hypothesis) -> bool:
        """Tell whether its periods are good guesses at other conditions of a hypothesis: those of the same effects."""
        return [one.id for one in self.hypothesis.effects] == [one.id for one in hypothesis.effects]

    def on_mesh(self, interface: Interface) -> Simulation:
        """Return it with periods, for others to begin from, on another mesh of the faces: by nearest nodes.

        The rig moves as it did. Wear is left on the mesh that it was found on.
        """
        own = self.loops[0].problem.interface
        if len(own.nodes) == len(interface.nodes):
            return self
        nearest = cKDTree(own.nodes).query(interface.nodes)[1]
        share = (interface.areas / own.areas[nearest])[:, None]

        def moved(period: Period) -> Period:
            solution = period.solution
            return replace(period, solution=replace(
                solution, displacement=solution.displacement[:, nearest], force=solution.force[:, nearest] * share,
                state=solution.state[:, nearest]))

        return replace(self, loops=tuple(map(moved, self.loops)), sweep=tuple(map(moved, self.sweep)))


def asperity_motion(period: Period, problem: PeriodicProblem, without: PeriodicProblem) -> Array:
    """Return by how much springs between the faces that `problem` has make these slide more than they move, (N,) m.

    A sensor sees the faces of the bodies, on either side of asperities and debris. The same problem `without` has none.
    """
    bare, sprung = without.boundary.flexibility, problem.boundary.flexibility
    if sprung is bare:
        return np.zeros(len(period.solution.force))
    soft = np.diag(sprung)[::3] - np.diag(bare)[::3]
    areas = problem.interface.areas
    return np.asarray(period.solution.force[:, :, 0] @ (soft * areas / areas.sum()))


def arm_approach(period: Period) -> Array:
    """Return how far the specimens' backs have come toward each other, (N,) m, from where they would just touch."""
    solution, joint = period.solution, rig_of(period.problem.structure).quasi_static()
    bulk = solution.force.reshape(len(solution.state), -1) @ joint.upper_compliance[2]
    return np.asarray(bulk - solution.upper_observation[:, 2])
