"""Sliding that begins at some places before others."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import PrivateAttr

from fretflow.contact.interface import Interface
from fretflow.effects.effect import INTERFACES, Array, Block, Effect, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.driven import Sliders
from fretflow.wear.slow import SlowState

ELEMENTS = 16
SIDE = 5  # places along each side of a face, each with one limit whatever the mesh
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class DistributedMicroSlip(Effect):
    """Slip limits that are spread about their mean, at equal stiffness and equal limit in all.

    The limit at the quantile q, from 0 to 1, is ``1 - w + w (1 + b) q^b`` of the mean. With b = 1 the limits are
    uniform in ``1 - w ... 1 + w``; with w = 1 their density falls as the power ``1 / b - 1``. A driven joint becomes
    16 sliders side by side. In the fretting rig 25 places of the face differ in their friction coefficient, by the
    golden ratio's sequence so that neighbours differ, and the area mean of the factors is 1. No real face is so even:
    which place has which limit is left to chance.
    """

    id = "distributed-micro-slip"
    title = "distributed slip limits"
    block = Block.CONTACT
    equation = "slip limit s (1 - w + w (1 + b) q^b), q uniform in 0...1"
    formula = r"s(q) = s \left[1 - w + w (1 + b)\,q^b\right], \quad q \in [0, 1]"
    source = "W. D. Iwan, J. Appl. Mech. 33 (1966); power law of limits: D. J. Segalman, J. Appl. Mech. 72 (2005)"
    observables = ("knee of a loop between stick and plateau", "dissipated energy over amplitude below gross slip")
    kinds = INTERFACES
    chances: ClassVar[int] = SIDE**2

    spread: float = parameter(0.8, "w: width of the distribution", 0.2, 1.0, ge=0.0, le=1.0, neutral=0.0)
    power: float = parameter(1.0, "b: 1 for a uniform distribution, more for many small limits", 0.5, 4.0,
                             ge=0.25, le=20.0, logarithmic=True)
    _off: tuple[float, ...] = PrivateAttr((0.0,) * SIDE**2)  # standard deviations of each place's limit from its own

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
        face = problem.interface
        known, place = np.unique(places(face), return_inverse=True)
        limits = self._limits(len(known), 0)
        factors = np.maximum(limits + limits.std() * np.array(self._off)[known], 0.0)[place]
        return replace(problem, law=replace(problem.law, friction_coefficient=np.asarray(
            problem.friction_coefficient * factors / (factors @ face.areas / face.areas.sum()))))

    def drawn(self, deviations: Array) -> Self:
        """Return the effect with the limit of each place so many standard deviations off its own."""
        one = self.model_copy()
        one._off = tuple(map(float, deviations)) or one._off
        return one

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Spread the friction coefficients of the contact points."""
        return self.bolted_anew(joint, 0)

    def bolted_anew(self, joint: BoltedJoint, draw: int) -> BoltedJoint:
        """Spread the friction coefficients of the contact points, which has which being drawn."""
        areas, limits = joint.structure.areas, self._limits(len(joint.structure.areas), draw)
        return replace(joint, law=replace(joint.law, friction_coefficient=joint.law.friction_coefficient * (
            limits / (limits @ areas / areas.sum()))))

    def _limits(self, count: int, draw: int) -> Array:
        """Return the limits (count,) of as many places over their mean, in the order of a sequence, or drawn."""
        # ranks of the sequence instead of its values: even at few places
        order = np.argsort(np.argsort(GOLDEN * np.arange(1, count + 1) % 1.0))
        if draw:
            order = np.random.default_rng(draw).permutation(order)
        return self.shares((order + 0.5) / count)


def places(face: Interface) -> NDArray[np.int64]:
    """Return in which of its places each node of a face is, (nodes,); nodes that lie nowhere follow one another."""
    extent = np.ptp(face.nodes, axis=0)
    if not extent.any():
        return np.arange(face.size) % SIDE**2
    along, across = np.round((face.nodes - face.nodes.min(axis=0)) / np.where(extent > 0.0, extent, 1.0)
                             * (SIDE - 1)).astype(np.int64).T
    return np.asarray(SIDE * along + across)
