"""A spring beside the contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, Array, Block, Effect, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.force_laws import ArmSupport
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState

STROKE = 10e-6  # m, x_0


class ParallelStiffness(Effect):
    """A spring from the moving specimen to the ground, in the force that is measured: ``T + k x (1 + h (x / x_0)^2)``.

    A seal, a cable, a leaf that guides the arm and hardens as it stretches, or the part of a joint that never slides.
    """

    id = "parallel-stiffness"
    title = "spring beside the contact"
    block = Block.RIG
    equation = "F = -k x (1 + h (x / x_0)^2) on the arm; T_meas = T - F; x_0 = 10 µm"
    formula = (r"T_\mathrm{meas} - T = -F_\mathrm{arm} = k\,x \left[1 + h\,(x / x_0)^2\right], \qquad "
               r"x_0 = 10\ \mu\mathrm{m}")
    source = ("second slope of the bilinear hysteresis: T. K. Caughey, J. Appl. Mech. 27 (1960), 640-643; hardening: "
              "G. Duffing, Erzwungene Schwingungen (1918)")
    told_from: ClassVar[Mapping[str, str]] = {
        "sensor-path-compliance": "loops of sticking contact at small amplitudes"}
    observables = ("slope of both plateaus of a loop, alike and positive",)
    kinds = ALL_KINDS

    stiffness: u.SignedStiffness = parameter(0.15e6, "k: stiffness of the spring", 0.05e6, 0.4e6, ge=0.0, neutral=0.0)
    hardening: float = parameter(0.0, "h: share by which it is stiffer at 10 µm, or softer", -0.3, 1.0, rig_only=True,
                                 gt=-1.0, logarithmic=False)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Hold the arm by the spring."""
        if self.stiffness == 0.0:
            return problem
        spring = ArmSupport(stiffness=self.stiffness, cubic=self.stiffness * self.hardening / STROKE**2)
        return replace(problem, structure=change_rig(problem.structure, forces=(spring,)))

    def sense(self, signals: Signals) -> Signals:
        """Add the spring's force to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self._force(signals.arm))

    def _force(self, x: Array) -> Array:
        return self.stiffness * (1.0 + self.hardening * (x / STROKE)**2) * x
