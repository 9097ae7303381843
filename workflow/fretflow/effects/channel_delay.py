"""A force channel that comes later than that of the displacement."""

from __future__ import annotations

from dataclasses import replace

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, OTHER_RATES, Block, Effect, parameter
from fretflow.structure.sensors import Signals


class ChannelDelay(Effect):
    """Measured force ``T(t - tau)``: multiplexed sampling, filters, slow amplifiers; tau < 0 if x is the late one.

    A filter rounds what it delays. Of n equal low-passes in a row with tau / n each, ``s = 1 / n`` tells the kind: 1 is
    a single one, and 0 is the delay alone that ever more of them tend to. The displacement is smooth: a late one is
    late alone.
    """

    id = "channel-delay"
    title = "delay between the channels"
    block = Block.SENSOR
    equation = "T_meas = H T, H = (1 + i w s tau)^(-1 / s), for s = 0 T(t - tau)"
    formula = (r"T_\mathrm{meas} = H\,T, \qquad H = (1 + i\,\omega\,s\,\tau)^{-1/s} \to "
               r"e^{-i\,\omega\,\tau}\ \text{for}\ s \to 0")
    source = ("shift theorem of the Fourier series: A. V. Oppenheim, R. W. Schafer, Discrete-Time "
              "Signal Processing, Prentice Hall (1989); equal low-passes in a row: A. I. Zverev, "
              "Handbook of Filter Synthesis, Wiley (1967)")
    needs_time = True
    told_by = OTHER_RATES
    observables = ("area of a loop that sticks", "force at reversal")
    kinds = ALL_KINDS
    sensed_at = 2

    delay: u.SignedTime = parameter(100e-6, "tau: how much later the force comes", 20e-6, 300e-6, neutral=0.0)
    rounding: float = parameter(0.0, "s: one over the number of equal low-passes that delay it, 0 for a mere delay",
                                0.0, 1.0, ge=0.0, le=1.0, rig_only=True,
                                source="from a mere delay to a single low-pass, all that there is")

    def sense(self, signals: Signals) -> Signals:
        """Delay the friction force."""
        if self.delay == 0.0:
            return signals
        force = signals.friction_force
        return replace(signals, friction_force=signals.delayed(force, self.delay) if self.delay < 0.0 else
                       signals.smoothed(force, self.delay, self.rounding))
