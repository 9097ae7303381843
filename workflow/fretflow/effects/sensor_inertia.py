"""A force sensor that carries a mass between itself and the contact."""

from __future__ import annotations

from dataclasses import replace

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, OTHER_RATES, Block, Effect, parameter
from fretflow.structure.sensors import Signals


class SensorInertia(Effect):
    """Measured force ``T + m a``, a the acceleration of the moving specimen.

    A lumped joint has a mass of its own, which would take m in.
    """

    id = "sensor-inertia"
    title = "mass between the contact and the force sensor"
    block = Block.SENSOR
    equation = "T_meas = T + m a"
    formula = r"T_\mathrm{meas} = T + m\,a"
    source = ("Newton's second law; mass cancellation: D. J. Ewins, Modal Testing: Theory, Practice and "
              "Application, 2nd ed., Research Studies Press (2000)")
    needs_time = True
    told_by = OTHER_RATES
    observables = ("slope of both plateaus of a loop, alike and negative", "high harmonics")
    kinds = INTERFACES
    sensed_at = 1

    mass: u.SignedMass = parameter(0.5, "m: mass that moves before the sensor", 0.1, 3.0, ge=0.0, neutral=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Add the inertia to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self.mass * signals.acceleration)
