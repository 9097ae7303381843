"""A force sensor that carries a mass between itself and the contact."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, OTHER_RATES, Block, Effect, RecordingKind, parameter
from fretflow.structure.sensors import Signals


class SensorInertia(Effect):
    """Measured force ``T + m a``, a the acceleration of the moving specimen.

    A lumped joint has a mass of its own, which would take m in.
    """

    id: ClassVar[str] = "sensor-inertia"
    title: ClassVar[str] = "mass between the contact and the force sensor"
    block: ClassVar[Block] = Block.SENSOR
    equation: ClassVar[str] = "T_meas = T + m a"
    formula: ClassVar[str] = r"T_\mathrm{meas} = T + m\,a"
    source: ClassVar[str] = ("Newton's second law; mass cancellation: D. J. Ewins, Modal Testing: Theory, Practice and "
                             "Application, 2nd ed., Research Studies Press (2000)")
    needs_time: ClassVar[bool] = True
    told_by: ClassVar[str] = OTHER_RATES
    observables: ClassVar[tuple[str, ...]] = ("slope of both plateaus of a loop, alike and negative", "high harmonics")
    kinds: ClassVar[frozenset[RecordingKind]] = INTERFACES
    sensed_at: ClassVar[int] = 1

    mass: u.SignedMass = parameter(0.5, "m: mass that moves before the sensor", 0.1, 3.0, ge=0.0, neutral=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Add the inertia to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self.mass * signals.acceleration)
