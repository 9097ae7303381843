"""A constant force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, UNLOADED, Array, Block, Effect, Motion, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.two_mass_rig.force_laws import BlockPull
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState


class ForceOffset(Effect):
    """A constant force: on the rig's block, or in the force of a joint that a motion drives.

    An actuator's offset, a slope under gravity, a preloaded spring.
    """

    id = "force-offset"
    title = "constant force"
    block = Block.RIG
    equation = "F_0 besides all other forces"
    formula = r"F_0 = \text{const, besides all other forces}"
    source = ("offset of the drive force: A. Janot, M. Gautier, M. Brunot, Data Set and Reference "
              "Models of EMPS, Workshop on Nonlinear System Identification Benchmarks (2019)")
    told_by = UNLOADED
    confirmed_by = ("The displacement at rest, before and after the test, would tell a constant force "
                    "from a sensor that was not set to zero there.")
    told_from: ClassVar[Mapping[str, str]] = {
        "parallel-stiffness": "the same motion about another middle position, which changes the mean force of a spring "
                              "alone,"}
    observables = ("mean of the force",)
    kinds = ALL_KINDS

    force_offset: u.SignedForce = parameter(3.0, "F_0: the force along x", -30.0, 30.0, neutral=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Pull at the block."""
        if self.force_offset == 0.0:
            return problem
        return replace(problem, structure=change_rig(problem.structure, forces=(BlockPull(self.force_offset),)))

    def force(self, motion: Motion) -> Array | float:
        """Return the force."""
        return self.force_offset
