"""Friction that settles as the faces are rubbed clean and rough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from fretflow.case.config import ContactSection
from fretflow.core import units as u
from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.effects.relaxation import order_of_relaxation, share_left
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState

TYPICAL = float(ContactSection().friction_coefficient)


class FrictionRunIn(Effect):
    """Friction coefficient that goes from mu_0 to mu_inf with the energy E dissipated since the start.

    It takes the place of the case's coefficient, to which mu_inf is equal unless given.
    """

    id = "friction-run-in"
    title = "friction that settles with the dissipated energy"
    block = Block.CONTACT
    equation = "mu = mu_inf - (mu_inf - mu_0) y(E / E_0); dy/dx = -y^o, exp(-x) for o = 1"
    formula = r"\mu = \mu_\infty - (\mu_\infty - \mu_0)\,y(E / E_0), \qquad y' = -y^o,\ y(0) = 1"
    source = ("A. Fantetti et al., Tribol. Int. 138 (2019) 111-124, friction against dissipated energy; "
              "P. J. Blau, Tribol. Int. 38 (2005) 1007-1012, running-in")
    over_cycles = True
    told_from: ClassVar[Mapping[str, str]] = {
        "normal-load-drift": "a record of the normal force over the test",
        "contact-stiffness-evolution": "sticking loops of small amplitude, new and run in,"}
    observables = ("friction force on the plateau over cycles", "sliding over cycles", "dissipated energy over cycles")

    initial: float = parameter(0.35, "mu_0: coefficient of the new faces", 0.2, 0.5, gt=0.0, le=5.0, neutral=TYPICAL)
    final: float | None = parameter(None, "mu_inf: coefficient in the end; by default the case's", 0.6, 0.9,
                                    gt=0.0, le=5.0)
    energy: u.Energy = parameter(30.0, "E_0: energy over which it settles", 5.0, 150.0)
    order: float = order_of_relaxation()

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Put the coefficient at this energy in, of faces whose limits are scattered their mean."""
        areas, nodal = problem.interface.areas, problem.friction_coefficient
        mean = np.sum(nodal * areas) / areas.sum()
        settled = self.coefficient(mean if self.final is None else np.asarray(self.final), slow.energy)
        return problem.vary(friction_coefficient=nodal / mean * settled)

    def coefficient(self, final: Array, energy: Array | float) -> Array:
        """Return mu after `energy` in J, between the initial and the `final` one."""
        return np.asarray(final - (final - self.initial) * share_left(np.asarray(energy) / self.energy, self.order))

    def sketch(self) -> Sketch:
        """Return the coefficient against energy."""
        energy = np.linspace(0.0, 5.0 * self.energy, 200)
        final = np.asarray(TYPICAL if self.final is None else self.final)
        return Sketch("dissipated energy in J", "friction coefficient", {"": (energy, self.coefficient(final, energy))})
