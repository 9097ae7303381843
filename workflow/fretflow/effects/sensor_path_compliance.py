"""A displacement sensor that sees, besides the joint, the spring of what the force goes through."""

from __future__ import annotations

from dataclasses import replace

from fretflow.core import units as u
from fretflow.effects.effect import Block, Effect, parameter
from fretflow.structure.sensors import Signals


class SensorPathCompliance(Effect):
    """Measured displacement ``x + c T``: the slope while the joint sticks falls from k to ``1 / (1 / k + c)``.

    Only where the model knows the joint's own compliance: a slider that a measured motion drives takes c into its
    stiffness.
    """

    id = "sensor-path-compliance"
    title = "compliance between the contact and the displacement sensor"
    block = Block.SENSOR
    equation = "x_meas = x + c T"
    formula = r"x_\mathrm{meas} = x + c\,T"
    source = ("springs in series; the compliance of the apparatus in measured fretting loops: S. "
              "Fouvry, P. Kapsa, L. Vincent, Wear 185 (1995)")
    observables = ("slope of the stick portion of a loop", "peak-to-peak displacement")

    compliance: u.SignedCompliance = parameter(2e-8, "c: displacement that a force adds", 6e-9, 6e-8, ge=0.0,
                                               neutral=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Add the path's stretch to the displacement."""
        return replace(signals, displacement=signals.displacement + self.compliance * signals.friction_force)
