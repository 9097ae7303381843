"""A normal load that falls over the test."""

from __future__ import annotations

import numpy as np

from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.effects.relaxation import order_of_relaxation, share_left
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class NormalLoadDrift(Effect):
    """Normal load that relaxes by a share of its value, as a clamped or bolted load does when its seats settle."""

    id = "normal-load-drift"
    title = "normal load that falls over cycles"
    block = Block.RIG
    equation = "N = N_0 (1 - a (1 - y(n / n_T))); dy/dx = -y^o, exp(-x) for o = 1"
    formula = r"N = N_0 \left[1 - a \left(1 - y(n / n_T)\right)\right], \qquad y' = -y^o,\ y(0) = 1"
    source = ("G. H. Junker, SAE Trans. 78 (1969), paper 690055, loss of clamping under transverse "
              "vibration; here a relaxation over the cycles")
    over_cycles = True
    told_by = "a record of the normal force over the test"
    observables = ("normal force over cycles", "friction force over cycles", "sliding over cycles")

    loss: float = parameter(0.15, "a: share of the load that is lost in the end", 0.04, 0.3, lt=1.0, neutral=0.0)
    settling: float = parameter(4e4, "n_T: cycles over which it is lost", 1e4, 1.5e5, gt=0.0)
    order: float = order_of_relaxation()

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Put the load at this cycle in."""
        return problem.vary(normal_load=problem.normal_load * float(self.share(slow.cycles)))

    def share(self, cycles: Array | float) -> Array:
        """Return the load after `cycles` over that at the start."""
        return np.asarray(1.0 - self.loss * (1.0 - share_left(np.asarray(cycles) / self.settling, self.order)))

    def sketch(self) -> Sketch:
        """Return the load against cycles."""
        cycles = np.linspace(0.0, 5.0 * self.settling, 200)
        return Sketch("cycles", "normal load over that at the start", {"": (cycles, self.share(cycles))})
