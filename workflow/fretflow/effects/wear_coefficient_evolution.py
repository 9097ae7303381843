"""A wear coefficient that changes as the faces run in."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fretflow.effects.effect import OTHER_LENGTHS, Array, Block, Effect, Sketch, parameter
from fretflow.effects.relaxation import mean_left, order_of_relaxation, share_left
from fretflow.effects.volume_law import CYCLES, LawParameter, VolumeLaw, WornTests
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState


class WearCoefficientEvolution(Effect):
    """Wear coefficient that goes from the case's K_w to x times that, as severe wear turns mild or mild severe."""

    id = "wear-coefficient-evolution"
    title = "wear coefficient that changes over cycles"
    block = Block.WEAR
    equation = "K_w(n) = K_w (x + (1 - x) y(n / n_K)); dy/dx = -y^o, exp(-x) for o = 1"
    formula = r"K_w(n) = K_w \left[x + (1 - x)\,y(n / n_K)\right], \qquad y' = -y^o,\ y(0) = 1"
    source = "P. J. Blau, On the nature of running-in, Tribol. Int. 38 (2005) 1007-1012"
    told_by = OTHER_LENGTHS
    observables = ("approach over cycles", "worn volume of tests of other lengths")

    final_share: float = parameter(0.4, "x: coefficient in the end over that at the start", 0.2, 4.0, ge=0.0,
                                   neutral=1.0)
    settling: float = parameter(1e5, "n_K: cycles over which it changes", 1e4, 1e6, gt=0.0)
    order: float = order_of_relaxation()

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return K_w(n) over that at the start."""
        return self.share(slow.cycles)

    def share(self, cycles: Array | float) -> Array:
        """Return the coefficient after `cycles` over that at the start."""
        return np.asarray(self.final_share + (1.0 - self.final_share) * share_left(
            np.asarray(cycles) / self.settling, self.order))

    def mean_share(self, cycles: Array) -> Array:
        """Return the mean coefficient over the first `cycles` over that at the start."""
        return np.asarray(self.final_share + (1.0 - self.final_share) * mean_left(cycles / self.settling, self.order))

    @classmethod
    def volume_laws(cls, tests: WornTests) -> tuple[VolumeLaw, ...]:
        """Return the law over each test's cycles; two lengths of test do not tell when the coefficient settles."""
        if CYCLES not in tests.varied or len(np.unique(tests.states[CYCLES])) < 3:
            return ()

        def worn(plain: Array, states: Mapping[str, Array], values: Array) -> Array:
            return np.asarray(plain * cls().changed(final_share=values[0], settling=values[1])
                              .mean_share(states[CYCLES]))

        share, n = cls.priors()["final_share"], tests.states[CYCLES]
        own = (LawParameter("final_share", "1", "x: coefficient in the end over that at the start", share.low,
                            share.high),
               LawParameter("settling", "1", "n_K: cycles over which it changes", 0.1 * float(n.min()), float(n.max())))
        return (VolumeLaw(cls.id, own, worn),)

    def sketch(self) -> Sketch:
        """Return the coefficient against cycles."""
        cycles = np.linspace(0.0, 5.0 * self.settling, 200)
        return Sketch("cycles", "wear coefficient over that at the start", {"": (cycles, self.share(cycles))})
