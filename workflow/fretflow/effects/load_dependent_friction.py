"""Friction whose coefficient falls with the pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.contact.coulomb import Coulomb
from fretflow.core import units as u
from fretflow.effects.effect import OTHER_LOAD, RIG_ONLY, Block, Effect, Prior, RecordedSize, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class LoadDependentFriction(Effect):
    """Friction ``mu (p / p_0)^-b`` at each node, p its pressure at each instant.

    Elastic contact of spheres makes friction grow with the two-thirds power of the load (b = 1/3); many asperities make
    it proportional (b = 0). Below a thousandth of p_0 the coefficient stays what it is there.
    """

    id = "load-dependent-friction"
    title = "friction that falls with the pressure"
    block = Block.CONTACT
    equation = "mu (p / p_0)^-b"
    formula = r"\mu \left(\frac{p}{p_0}\right)^{-b}"
    source = ("F. P. Bowden, D. Tabor, The Friction and Lubrication of Solids (1950); "
              "J. F. Archard, Proc. R. Soc. A 243 (1957)")
    told_by = OTHER_LOAD
    observables = ("friction force at other normal loads", "wear map near the edges")
    kinds = RIG_ONLY

    exponent: float = parameter(0.15, "b: how fast friction falls with pressure", 0.06, 0.33, ge=0.0, lt=1.0,
                                neutral=0.0)
    reference_pressure: u.Pressure | None = parameter(
        60e6, "p_0: pressure at which friction is that of the contact table", 10e6, 200e6, gt=0.0,
        source="the load of the paper's test 1 over its area; fixed, so that tests at other loads can be compared")

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Let friction follow the pressure."""
        return replace(problem, law=replace(problem.law, exponent=self.exponent,
                                            reference_pressure=self.reference_pressure))

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior:
        """Return a reference pressure about the mean one."""
        if field == "reference_pressure":
            return replace(prior, low=joint.bolted_pressure / 1.5, high=joint.bolted_pressure * 1.5)
        return prior

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Let friction follow the pressure."""
        areas = joint.structure.areas
        pressure = joint.bolted_pressure if self.reference_pressure is None else self.reference_pressure
        return replace(joint, law=replace(joint.law, exponent=self.exponent, reference_force=pressure * areas))

    def sketch(self) -> Sketch:
        """Return the factor against pressure."""
        share = np.linspace(0.05, 3.0, 200)
        law = Coulomb(friction_coefficient=np.ones(()), exponent=self.exponent)
        return Sketch("pressure over p_0", "factor on mu", {"": (share, law.slip_limit(share) / share)})
