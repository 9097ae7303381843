"""A spring beside the contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, Block, Effect, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.force_laws import ArmSupport
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState


class ParallelStiffness(Effect):
    """A spring from the moving specimen to the ground, in the force that is measured: ``T_meas = T + k x``.

    A seal, a cable, a leaf that guides the arm, or the part of a joint that never slides.
    """

    id = "parallel-stiffness"
    title = "spring beside the contact"
    block = Block.RIG
    equation = "force on the arm -k x; T_meas = T + k x"
    formula = r"F_\mathrm{arm} = -k\,x, \qquad T_\mathrm{meas} = T + k\,x"
    source = "second slope of the bilinear hysteresis: T. K. Caughey, J. Appl. Mech. 27 (1960), 640-643"
    told_from: ClassVar[Mapping[str, str]] = {
        "sensor-path-compliance": "loops of sticking contact at small amplitudes"}
    observables = ("slope of both plateaus of a loop, alike and positive",)
    kinds = ALL_KINDS

    stiffness: u.SignedStiffness = parameter(0.15e6, "k: stiffness of the spring", 0.05e6, 0.4e6, ge=0.0, neutral=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Hold the arm by the spring."""
        if self.stiffness == 0.0:
            return problem
        return replace(problem, structure=change_rig(problem.structure, forces=(ArmSupport(stiffness=self.stiffness),)))

    def sense(self, signals: Signals) -> Signals:
        """Add the spring's force to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self.stiffness * signals.arm)
