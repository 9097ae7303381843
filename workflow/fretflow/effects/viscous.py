"""A dashpot beside the contact."""

from __future__ import annotations

from dataclasses import replace

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, OTHER_RATES, Block, Effect, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.force_laws import ArmSupport
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState


class Viscous(Effect):
    """A dashpot from the moving specimen to the ground, in the force that is measured: ``T_meas = T + c v``.

    A lumped joint has a damper of its own.
    """

    id = "viscous"
    title = "dashpot beside the contact"
    block = Block.RIG
    equation = "force on the arm -c v; T_meas = T + c v"
    formula = r"F_\mathrm{arm} = -c\,v, \qquad T_\mathrm{meas} = T + c\,v"
    source = "combined Coulomb and viscous friction: J. P. Den Hartog, Trans. ASME 53 (1931), APM-53-9"
    needs_time = True
    told_by = OTHER_RATES
    observables = ("bulge of both plateaus of a loop", "loops at other frequencies")
    kinds = INTERFACES

    damping: u.SignedDamping = parameter(300.0, "c: force over velocity", 50.0, 3e3, ge=0.0, neutral=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Hold the arm by the dashpot."""
        if self.damping == 0.0:
            return problem
        return replace(problem, structure=change_rig(problem.structure, forces=(ArmSupport(damping=self.damping),)))

    def sense(self, signals: Signals) -> Signals:
        """Add the dashpot's force to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self.damping * signals.velocity)
