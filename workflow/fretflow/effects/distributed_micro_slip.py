"""Sliding that begins at some places before others."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from pydantic import PrivateAttr

from fretflow.effects.effect import INTERFACES, Array, Block, Effect, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.driven import Sliders
from fretflow.wear.slow import SlowState

ELEMENTS = 16
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class DistributedMicroSlip(Effect):
    """Slip limits that are spread about their mean, at equal stiffness and equal limit in all.

    The limit at the quantile q, from 0 to 1, is ``1 - w + w (1 + b) q^b`` of the mean. With b = 1 the limits are
    uniform in ``1 - w ... 1 + w``; with w = 1 their density falls as the power ``1 / b - 1``. A driven joint becomes
    16 sliders side by side. In the fretting rig the nodes differ in their friction coefficient, spread over the face
    by the golden ratio's sequence so that neighbours differ, and the area mean of the factors is 1. No real face is so
    even: which node has which limit is left to chance.
    """

    id = "distributed-micro-slip"
    title = "distributed slip limits"
    block = Block.CONTACT
    equation = "slip limit s (1 - w + w (1 + b) q^b), q uniform in 0...1"
    formula = r"s(q) = s \left[1 - w + w (1 + b)\,q^b\right], \quad q \in [0, 1]"
    source = "W. D. Iwan, J. Appl. Mech. 33 (1966); power law of limits: D. J. Segalman, J. Appl. Mech. 72 (2005)"
    observables = ("knee of a loop between stick and plateau", "dissipated energy over amplitude below gross slip")
    kinds = INTERFACES

    spread: float = parameter(0.8, "w: width of the distribution", 0.2, 1.0, ge=0.0, le=1.0, neutral=0.0)
    power: float = parameter(1.0, "b: 1 for a uniform distribution, more for many small limits", 0.5, 4.0,
                             ge=0.25, le=20.0, logarithmic=True)
    _node: int | None = PrivateAttr(None)  # whose limit is a standard deviation above its own

    def shares(self, quantile: Array) -> Array:
        """Return the slip limits over their mean at `quantile` (M,)."""
        return np.asarray(1.0 - self.spread + self.spread * (1.0 + self.power) * quantile**self.power)

    def sliders(self, sliders: Sliders) -> Sliders:
        """Return each slider as many."""
        if self.spread == 0.0:
            return sliders
        ends = np.arange(ELEMENTS + 1) / ELEMENTS
        # the mean over each element's quantiles, so that that of all is 1 exactly
        middle = 1.0 - self.spread + self.spread * ELEMENTS * np.diff(ends**(1.0 + self.power))
        return replace(sliders, stiffness=np.repeat(sliders.stiffness / ELEMENTS, ELEMENTS),
                       reach=np.outer(sliders.reach, middle).ravel())

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Spread the friction coefficients of the nodes."""
        if self.spread == 0.0:
            return problem
        return replace(problem, law=replace(problem.law, friction_coefficient=np.asarray(
            problem.friction_coefficient * self._factors(problem.interface.areas))))

    def by_chance(self, nodes: int) -> tuple[Self, ...]:
        """Return the effect with the limit of each node a standard deviation higher."""
        effects = tuple(self.model_copy() for _ in range(nodes))
        for node, one in enumerate(effects):
            one._node = node
        return effects

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Spread the friction coefficients of the contact points."""
        return self.bolted_anew(joint, 0)

    def bolted_anew(self, joint: BoltedJoint, draw: int) -> BoltedJoint:
        """Spread the friction coefficients of the contact points, which has which being drawn."""
        factors = self._factors(joint.structure.areas, draw)
        return replace(joint, law=replace(joint.law, friction_coefficient=joint.law.friction_coefficient * factors))

    def _factors(self, areas: Array, draw: int = 0) -> Array:
        """Return the factors on friction (nodes,), whose mean over the areas is 1; a sequence's, or drawn."""
        # ranks of the sequence instead of its values: even at few nodes
        order = np.argsort(np.argsort(GOLDEN * np.arange(1, len(areas) + 1) % 1.0))
        if draw:
            order = np.random.default_rng(draw).permutation(order)
        factors = self.shares((order + 0.5) / len(areas))
        if self._node is not None:
            factors[self._node] += factors.std()
        return np.asarray(factors / (factors @ areas / areas.sum()))
