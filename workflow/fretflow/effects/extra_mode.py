"""One more resonance between the contact and the force sensor."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from pydantic import Field

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, OTHER_RATES, Block, Effect, parameter
from fretflow.structure.sensors import Signals


class ExtraMode(Effect):
    """Measured force ``H T`` with H of an oscillator that the friction force drives: its spring's force over T."""

    id = "extra-mode"
    title = "one more resonance in the force path"
    block = Block.SENSOR
    equation = "T_meas = H T, H = 1 - r + r / (1 - (w/w_0)^2 + 2 i zeta w/w_0)"
    formula = (r"T_\mathrm{meas} = H\,T, \qquad "
               r"H = 1 - r + \frac{r}{1 - (\omega / \omega_0)^2 + 2 i \zeta\,\omega / \omega_0}")
    source = ("transfer function of one mode: D. J. Ewins, Modal Testing: Theory, Practice and "
              "Application, 2nd ed., Research Studies Press (2000)")
    first_order = False
    needs_time = True
    told_by = OTHER_RATES
    observables = ("ripple on the plateaus after a reversal", "high harmonics of the force")
    kinds = INTERFACES
    sensed_at = 1

    frequency: u.Frequency = parameter(450.0, "w_0 / 2 pi: frequency of the mode", 250.0, 900.0, logarithmic=True)
    damping_ratio: float = parameter(0.03, "zeta: its damping ratio", 0.01, 0.1, gt=0.0, lt=1.0)
    share: float = Field(1.0, ge=0.0, le=1.0, description="r: share of the force path's flexibility in this mode")

    @classmethod
    def neutral(cls) -> Self:
        """Return a mode that takes no part."""
        return cls(share=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Send the friction force through the mode."""
        if self.share == 0.0:
            return signals
        natural = 2.0 * np.pi * self.frequency
        below = np.array([1.0 / natural**2, 2.0 * self.damping_ratio / natural, 1.0])
        above = (1.0 - self.share) * below + self.share * np.array([0.0, 0.0, 1.0])
        return replace(signals, friction_force=signals.filtered(signals.friction_force, above, below))
