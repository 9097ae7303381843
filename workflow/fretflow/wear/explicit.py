"""The explicit cycle jump of Tubita et al., equations (10) and (11), kept within the stability bound.

The rate at the start of a jump holds for all its cycles, and the jump wears no node by more than
`max_depth_per_jump`. A jump beyond half the stability bound (see `feedback`), where the stiffest wear pattern
would overshoot, is split there. Without a `max_depth_per_jump` it is `Feedback.depth_scale`. Where there are
laws over cycles, a jump must also keep the error of the energy and of the volume within the tolerance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Generic, TypeVar

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.wear.history import WearStep
from fretflow.wear.scheme import WearingJoint, even_share, relative, resized
from fretflow.wear.slow import SlowState

S = TypeVar("S")
MAX_ATTEMPTS = 20


class Explicit(Generic[S]):
    """The explicit scheme: one periodic solution a jump."""

    def __init__(self, joint: WearingJoint[S]) -> None:
        self.joint = joint

    def advance(self, now: WearStep, state: S) -> tuple[WearStep, S]:
        """Jump at the present rate, then find the period of the worn contact.

        Raises
        ------
        NonConvergenceError
            If the laws over cycles let no jump meet the tolerance; its history is that of the errors over it.
        """
        jump, shortened = self.jump(now)
        if not self.joint.model.has_laws:
            return self.joint.settled(self.end(now, jump), state, now.solves + 1, shortened=shortened)
        errors: list[float] = []
        while len(errors) < MAX_ATTEMPTS:
            following, settled = self.joint.settled(self.end(now, jump), state, now.solves + len(errors) + 1,
                                                    shortened=shortened)
            errors.append(self.error(now, following, jump))
            factor = resized(errors[-1])
            if errors[-1] <= 1.0 or jump == 1:
                return replace(following, proposed_jump=factor * jump), settled
            jump = max(1, math.floor(factor * jump))
        raise NonConvergenceError(f"no explicit jump meets the tolerance in {MAX_ATTEMPTS} attempts; "
                                  "raise wear.tolerance", history=errors)

    def end(self, now: WearStep, jump: int) -> SlowState:
        """Return the slow state after `jump` cycles at the rate of `now`."""
        return self.joint.model.evolve(now.slow, jump, jump * now.rate, jump * now.response.dissipated_energy,
                                       now.response)

    def error(self, now: WearStep, end: WearStep, jump: int) -> float:
        """Return the error of energy and worn volume over the tolerance.

        It is measured by what the jump adds, since the errors of a scheme of first order add up from jump to jump.
        """
        areas, tolerance = self.joint.model.areas, self.joint.settings.tolerance
        errors = []
        for before, after, total in (
                (float(areas @ now.rate), float(areas @ end.rate), float(areas @ end.depth)),
                (now.response.dissipated_energy, end.response.dissipated_energy, end.slow.energy)):
            allowed = tolerance * (0.5 * jump * (before + after) + tolerance * total)
            errors.append(relative(0.5 * jump * abs(after - before), allowed))
        return max(errors)

    def jump(self, now: WearStep) -> tuple[int, bool]:
        """Return the cycles of the next jump and whether the stability bound shortened it.

        Raises
        ------
        InputError
            If not even one cycle is stable.
        """
        stable, asked = self.joint.stable_jump(now), self.joint.asked_jump(now)
        jump = min(stable, asked if math.isfinite(asked) else self.joint.shallow_jump(now))
        if jump < 1.0:
            most = float(now.rate.max())
            raise InputError(f"wear.coefficient: one cycle would wear {most:.3g} m, more than the "
                             f"{jump * most:.3g} m of a stable jump; check its unit and max_depth_per_jump")
        shortened = stable < asked < math.inf
        return even_share(self.joint.remaining(now), max(1.0, _least(jump, now.proposed_jump))), shortened


def _least(jump: float, proposed: float) -> float:
    return jump if math.isnan(proposed) else min(jump, proposed)
