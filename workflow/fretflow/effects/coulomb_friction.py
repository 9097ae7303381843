"""Dry friction where the baseline has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from fretflow.core import units as u
from fretflow.effects.effect import LUMPED, Block, Effect, Sketch, parameter
from fretflow.structure.driven import Sliders


class CoulombFriction(Effect):
    """Friction ``F_c sign(v)``, as a stiff slider so that stops and reversals have their force too.

    Before it slides the joint moves by the reach d, elastically; the limit is that of Coulomb as d goes to 0.
    """

    id = "coulomb-friction"
    title = "dry friction"
    block = Block.CONTACT
    equation = "F_c sign(v), at rest between -F_c and F_c"
    formula = (r"F = F_c \operatorname{sgn}(v)\ \text{ for } v \neq 0, \qquad "
               r"|F| \le F_c\ \text{ for } v = 0")
    source = ("C. A. Coulomb, Theorie des machines simples (1785); presliding: P. R. Dahl, Aerospace "
              "Corp. report TOR-158(3107-18) (1968)")
    observables = ("force over the sign of the velocity", "force at standstill")
    kinds = frozenset({LUMPED})

    friction_limit: u.SignedForce = parameter(20.0, "F_c: friction force while it slides", 1.0, 200.0, ge=0.0,
                                              neutral=0.0)
    reach: u.Length = Field(1e-6, description="d: elastic motion before it slides")

    def sliders(self, sliders: Sliders) -> Sliders:
        """Add the slider."""
        return replace(sliders, stiffness=np.append(sliders.stiffness, self.friction_limit / self.reach),
                       reach=np.append(sliders.reach, self.reach))

    def sketch(self) -> Sketch:
        """Return the force over the velocity."""
        speed = np.array([-1.0, 0.0, 0.0, 1.0])
        return Sketch("velocity", "friction force in N",
                      {"baseline": (speed, 0.0 * speed),
                       "effect": (speed, self.friction_limit * np.array([-1.0, -1.0, 1.0, 1.0]))})
