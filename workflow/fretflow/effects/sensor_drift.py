"""A force channel whose zero wanders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, UNLOADED, Block, Effect, Sketch, parameter
from fretflow.structure.sensors import Signals


class SensorDrift(Effect):
    """Measured force ``T + d s``, s the share of the test, or of the record, that is over."""

    id = "sensor-drift"
    title = "drift of the force channel"
    block = Block.SENSOR
    equation = "T_meas = T + d s, s from 0 to 1 over the test"
    formula = r"T_\mathrm{meas} = T + d\,s, \qquad s \text{ from 0 to 1 over the test}"
    source = "instrumental drift: International Vocabulary of Metrology, JCGM 200 (2012), 4.21"
    needs_time = True
    told_by = UNLOADED
    confirmed_by = "The channels at rest, before and after the test, would confirm that a sensor's zero moves."
    observables = ("mean of the friction force over cycles",)
    kinds = ALL_KINDS
    sensed_at = 2

    drift: u.SignedForce = parameter(1.0, "d: offset gained by the end of the test; of either sign", 0.1, 3.0,
                                     neutral=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Add the offset to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self.drift * signals.progress)

    def sketch(self) -> Sketch:
        """Return the offset over the test."""
        share = np.linspace(0.0, 1.0, 50)
        return Sketch("share of the test", "mean friction force in N",
                      {"baseline": (share, 0.0 * share), "effect": (share, self.drift * share)})
