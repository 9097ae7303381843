"""The explicit cycle jump of Tubita et al., equations (10) and (11), kept within the stability bound.

The rate at the start of a jump holds for all its cycles, and the jump wears no node by more than
`max_depth_per_jump`. A jump beyond half the stability bound (see `feedback`), where the stiffest wear pattern
would overshoot, is split there. Without a `max_depth_per_jump` it is `Feedback.depth_scale`.
"""

from __future__ import annotations

from typing import Generic, TypeVar

from fretflow.core.errors import InputError
from fretflow.wear.history import WearStep
from fretflow.wear.scheme import WearingJoint, even_share

S = TypeVar("S")


class Explicit(Generic[S]):
    """The explicit scheme: one periodic solution a jump."""

    def __init__(self, joint: WearingJoint[S]) -> None:
        self.joint = joint

    def advance(self, now: WearStep, state: S) -> tuple[WearStep, S]:
        """Jump at the present rate, then find the period of the worn contact."""
        jump, shortened = self.jump(now)
        depth = now.depth + jump * now.rate
        return self.joint.settled(now.cycles + jump, depth, state, now.solves + 1, shortened=shortened)

    def jump(self, now: WearStep) -> tuple[int, bool]:
        """Return the cycles of the next jump and whether the stability bound shortened it.

        Raises
        ------
        InputError
            If not even one cycle is stable.
        """
        stable, asked = self.joint.stable_jump(now), self.joint.asked_jump(now)
        jump = min(stable, self.joint.shallow_jump(now) if asked is None else asked)
        if jump < 1.0:
            most = float(now.rate.max())
            raise InputError(f"wear.coefficient: one cycle would wear {most:.3g} m, more than the "
                             f"{jump * most:.3g} m of a stable jump; check its unit and max_depth_per_jump")
        return even_share(self.joint.remaining(now), jump), asked is not None and stable < asked
