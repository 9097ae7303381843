"""Sliding that begins at some places before others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.effects.effect import INTERFACES, Array, Block, Effect, Prior, RecordedSize, parameter
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
    even. As the pressure moves with the direction of sliding, what friction differs by between the ends of the stroke
    makes the whole's differ with the direction, as in `directional-friction`; c stands for that. As wear takes the
    pressure from the rim, what friction differs by between rim and middle makes the whole's drift early in a test: the
    factors are times ``exp(e w u)``, u the square of the distance from the middle, of no mean and unit rms over the
    face. Of n places drawn at random the correlation with u has an sd of ``1 / sqrt(n)``, from which e has its range.
    """

    id = "distributed-micro-slip"
    title = "distributed slip limits"
    block = Block.CONTACT
    equation = "slip limit s (1 - w + w (1 + b) q^b), q uniform in 0...1; rig: times (1 - c t_x) exp(e w u)"
    formula = (r"s(q) = s \left[1 - w + w (1 + b)\,q^b\right], \quad q \in [0, 1]; \qquad "
               r"\text{on the rig: times } (1 - c\,t_x)\,e^{e w u}")
    source = "W. D. Iwan, J. Appl. Mech. 33 (1966); power law of limits: D. J. Segalman, J. Appl. Mech. 72 (2005)"
    observables = ("knee of a loop between stick and plateau", "dissipated energy over amplitude below gross slip")
    extends = frozenset({"directional-friction"})  # by c
    kinds = INTERFACES

    spread: float = parameter(0.8, "w: width of the distribution", 0.2, 1.0, ge=0.0, le=1.0, neutral=0.0)
    power: float = parameter(1.0, "b: 1 for a uniform distribution, more for many small limits", 0.5, 4.0,
                             ge=0.25, le=20.0, logarithmic=True)
    lean: float = parameter(0.0, "c: half the difference between both directions of sliding, over the mean", -0.1, 0.1,
                            gt=-1.0, lt=1.0, rig_only=True)
    rim: float = parameter(0.0, "e: how much more friction the rim has than the middle, over the spread", -0.1, 0.1,
                           gt=-2.0, lt=2.0, rig_only=True)

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
        if self.spread == self.lean == 0.0:
            return problem
        areas = problem.interface.areas
        factors = self._factors(areas) * np.exp(self.rim * self.spread * _outwards(problem.interface.nodes, areas))
        factors /= factors @ areas / areas.sum()
        return replace(problem, law=replace(
            problem.law, friction_coefficient=np.asarray(problem.friction_coefficient * factors),
            asymmetry=problem.law.asymmetry + self.lean))

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Spread the friction coefficients of the contact points."""
        return self.bolted_anew(joint, 0)

    def bolted_anew(self, joint: BoltedJoint, draw: int) -> BoltedJoint:
        """Spread the friction coefficients of the contact points, which has which being drawn."""
        factors = self._factors(joint.structure.areas, draw)
        return replace(joint, law=replace(joint.law, friction_coefficient=joint.law.friction_coefficient * factors))

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior | None:
        """Return the ranges of the distribution: limits of bolted faces know neither direction nor rim."""
        return None if field in ("lean", "rim") else prior

    def _factors(self, areas: Array, draw: int = 0) -> Array:
        """Return the factors on friction (nodes,), whose mean over the areas is 1; a sequence's, or drawn."""
        # ranks of the sequence instead of its values: even at few nodes
        order = np.argsort(np.argsort(GOLDEN * np.arange(1, len(areas) + 1) % 1.0))
        if draw:
            order = np.random.default_rng(draw).permutation(order)
        factors = self.shares((order + 0.5) / len(areas))
        return np.asarray(factors / (factors @ areas / areas.sum()))


def _outwards(nodes: Array, areas: Array) -> Array:
    """Return the square of the distance of `nodes` (nodes, 2) from their middle, of no mean and unit rms (nodes,)."""
    shares = areas / areas.sum()
    square = np.sum((nodes - shares @ nodes)**2, axis=1)
    mean = shares @ square
    rms = float(np.sqrt(shares @ (square - mean)**2))
    # nodes that are all as far out, as two are, have no rim
    return np.asarray((square - mean) / rms) if rms > np.sqrt(np.finfo(float).eps) * mean else np.zeros(len(nodes))
