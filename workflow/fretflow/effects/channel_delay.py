"""A force channel that comes later than that of the displacement."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Self

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, OTHER_RATES, Block, Effect, RecordingKind, parameter
from fretflow.structure.sensors import Signals


class ChannelDelay(Effect):
    """Measured force ``T(t - tau)``: filters, multiplexed sampling, slow amplifiers; tau < 0 if x is the late one."""

    id: ClassVar[str] = "channel-delay"
    title: ClassVar[str] = "delay between the channels"
    block: ClassVar[Block] = Block.SENSOR
    equation: ClassVar[str] = "T_meas(t) = T(t - tau)"
    formula: ClassVar[str] = r"T_\mathrm{meas}(t) = T(t - \tau)"
    source: ClassVar[str] = ("shift theorem of the Fourier series: A. V. Oppenheim, R. W. Schafer, Discrete-Time "
                             "Signal Processing, Prentice Hall (1989)")
    needs_time: ClassVar[bool] = True
    told_by: ClassVar[str] = OTHER_RATES
    observables: ClassVar[tuple[str, ...]] = ("area of a loop that sticks", "force at reversal")
    kinds: ClassVar[frozenset[RecordingKind]] = ALL_KINDS
    sensed_at: ClassVar[int] = 2

    delay: u.SignedTime = parameter(100e-6, "tau: how much later the force comes", 20e-6, 300e-6)

    @classmethod
    def neutral(cls) -> Self:
        """Return channels in time."""
        return cls().changed(delay=0.0)

    def sense(self, signals: Signals) -> Signals:
        """Delay the friction force."""
        if self.delay == 0.0:
            return signals
        return replace(signals, friction_force=signals.delayed(signals.friction_force, self.delay))
