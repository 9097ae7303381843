"""Bolts of one joint that do not pull alike."""

from __future__ import annotations

import numpy as np

from fretflow.effects.effect import STRUCTURES, Array, Block, Effect, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint

LEAST = 0.02  # of a bolt's force that is left


class BoltLoadSpread(Effect):
    """Force of the bolts ``P (1 + e x + m (1 - 2 |x|))``, x from -1 to 1 along the faces, the sum kept.

    A torque wrench leaves forces that differ by a quarter to a third of their mean; tightening one bolt loosens those
    beside it.
    """

    id = "bolt-load-spread"
    title = "bolts that pull unevenly"
    block = Block.CONTACT
    equation = "P (1 + e x + m (1 - 2 |x|)), x in [-1, 1], sum P"
    formula = r"P(x) \propto 1 + e\,x + m\,(1 - 2 |x|), \qquad x \in [-1, 1]"
    source = ("VDI 2230-1 (2015), table A8: scatter of tightening by torque; M. R. W. Brake (ed.), "
              "The Mechanics of Jointed Structures (Springer 2018)")
    told_by = "the force of each bolt, by its elongation or a washer that measures it"
    observables = ("damping over amplitude", "contact pressure")
    kinds = STRUCTURES

    ends: float = parameter(0.3, "e: half the difference between the bolts at both ends, over the mean", 0.05, 0.6,
                            gt=-1.0, lt=1.0, source="VDI 2230-1: tightening factor 1.4 to 1.6 of a torque wrench",
                            neutral=0.0)
    middle: float = parameter(0.0, "m: excess of the middle bolt over the mean", -0.3, 0.3, gt=-1.0, lt=1.0,
                              source="VDI 2230-1, and elastic interaction of neighbours", neutral=0.0)

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Let the bolts pull unevenly."""
        x = joint.across[:, 0]
        return joint.pressed(np.maximum(self._share(x), LEAST))

    def _share(self, x: Array) -> Array:
        return np.asarray(1.0 + self.ends * x + self.middle * (1.0 - 2.0 * np.abs(x)))

    def sketch(self) -> Sketch:
        """Return the force along the faces."""
        x = np.linspace(-1.0, 1.0, 101)
        return Sketch("place along the faces over half their length", "force over its mean", {"": (x, self._share(x))})
