"""What the explicit and the implicit scheme share: one jump, from a worn contact to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.wear.archard import wear_rate
from fretflow.wear.cycle import CycleModel, settle
from fretflow.wear.feedback import Feedback
from fretflow.wear.history import WearSettings, WearStep

S = TypeVar("S")
OVERSHOOT_FREE = 0.5  # share of the stability bound


class Scheme(Protocol[S]):
    """Makes one jump."""

    def advance(self, now: WearStep, state: S) -> tuple[WearStep, S]:
        """Return the step after `now` and its state; it does not pass the next asked cycle count."""
        ...


@dataclass(frozen=True)
class WearingJoint(Generic[S]):
    """A vibrating joint that wears, and how."""

    model: CycleModel[S]
    settings: WearSettings
    feedback: Feedback

    def unworn(self) -> tuple[WearStep, S]:
        """Return step 0, the contact before any wear, and its state."""
        return self.settled(0, np.zeros_like(self.model.areas), None, solves=1)

    def settled(self, cycles: int, depth: NDArray[np.float64], state: S | None, solves: int,
                proposed_jump: float = math.nan, shortened: bool = False) -> tuple[WearStep, S]:
        """Return the step at `cycles` with its period found again at `depth` (nodes,), m, and its state."""
        response, settled = settle(self.model, depth, state)
        rate = wear_rate(self.settings.coefficient, response)
        return WearStep(cycles=cycles, depth=depth, rate=rate, response=response, proposed_jump=proposed_jump,
                        shortened=shortened, solves=solves), settled

    def remaining(self, now: WearStep) -> int:
        """Return the cycles to the next asked count."""
        return self.settings.next_stop(now.cycles) - now.cycles

    def stable_jump(self, now: WearStep) -> float:
        """Return the cycles of the longest explicit jump that does not overshoot; inf when nothing slides."""
        return OVERSHOOT_FREE * self.feedback.stability_bound(self.settings.coefficient, now.response)

    def shallow_jump(self, now: WearStep) -> float:
        """Return the cycles in which no node wears more than `Feedback.depth_scale`.

        Where little slides the stability bound allows much, yet such a jump would reshape the contact unseen.
        """
        return self.feedback.depth_scale(now.response) / float(now.rate.max())

    def asked_jump(self, now: WearStep) -> float | None:
        """Return the cycles in which the fastest node wears `max_depth_per_jump`, if that was given."""
        most = self.settings.max_depth_per_jump
        return None if most is None else most / float(now.rate.max())


def even_share(remaining: int, jump: float) -> int:
    """Divide `remaining` cycles evenly into jumps of at most `jump` >= 1 and return one of them."""
    if jump >= remaining:
        return remaining
    return math.ceil(remaining / math.ceil(remaining / math.floor(jump)))
