"""Friction that differs with the direction of sliding."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fretflow.contact.law import FactorAndSlopes
from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, OTHER_LOAD, Array, Block, Effect, Motion, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


@dataclass(frozen=True)
class _DirectionOfMotion:
    """``1 + d v / sqrt(v^2 + v_0^2)`` of the moving specimen's speed."""

    difference: float
    speed_scale: float

    def __call__(self, position: Array, velocity: Array) -> FactorAndSlopes:
        size = np.hypot(velocity, self.speed_scale)
        return FactorAndSlopes(1.0 + self.difference * velocity / size, np.zeros_like(position),
                               self.difference * self.speed_scale**2 / size**3)


class DirectionalFriction(Effect):
    """Friction ``mu (1 + d)`` where the upper face slides to positive x, ``mu (1 - d)`` to negative x.

    A face at rest goes no way. Its limit has a share r of the difference, by the direction of the friction force t:
    ``mu (1 - r d t_x)``. It follows that force with r = 1, and is mu itself, the mean of both ways, with r = 0. With
    r = -1 it goes by the motion of the specimen alone, whose speed makes the whole difference from some v_0 on, as in
    regularised laws of friction.
    """

    id = "directional-friction"
    title = "friction that differs with the direction of sliding"
    block = Block.CONTACT
    equation = ("mu (1 + d sign v); at rest mu (1 - r d t_x); t the direction of the friction force; "
                "in what goes by the motion, sign v is v / sqrt(v^2 + v_0^2)")
    formula = (r"\mu\,(1 + d\,\mathrm{sign}\,v), \quad \text{at rest}\ \mu\,(1 - r\,d\,t_x), "
               r"\quad \boldsymbol{t} \text{ the direction of the friction force}")
    source = ("A. Zmitrowicz, Int. J. Solids Struct. 25 (1989), anisotropic friction with an offset "
              "disc; by the speed: D. C. Threlfall, Mech. Mach. Theory 13 (1978) 475-483")
    told_by = OTHER_LOAD
    observables = ("mean of the friction force", "even harmonics")
    kinds = ALL_KINDS

    difference: float = parameter(0.05, "d: half the difference between both directions, over their mean", 0.01, 0.1,
                                  gt=-1.0, lt=1.0, logarithmic=False, neutral=0.0)
    rest: float = parameter(1.0, "r: share of the difference that is left at rest", -1.0, 1.0, ge=-1.0, le=1.0,
                            logarithmic=False, rig_only=True)
    speed_scale: u.Velocity = parameter(0.1e-3, "v_0: speed by which the motion of the specimen has a way", 0.05e-3,
                                        5e-3, rig_only=True)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Let friction follow the direction: of motion and of force with parts that add up in sliding."""
        by_force, by_motion = (0.5 * (1.0 + way * self.rest) * self.difference for way in (1.0, -1.0))
        law = replace(problem.law, asymmetry=problem.law.asymmetry + by_force)
        if by_motion:
            law = replace(law, motion_factors=(*law.motion_factors,
                                               _DirectionOfMotion(by_motion, self.speed_scale)))
        return replace(problem, law=law)

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factors for sliding to positive and to negative x."""
        return 1.0 + self.difference, 1.0 - self.difference

    def sketch(self) -> Sketch:
        """Return a loop with its two plateaus."""
        x, force = np.array([-1.0, -0.6, 1.0, 0.6, -1.0]), np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
        return Sketch("displacement", "friction force over mu N",
                      {"baseline": (x, force), "effect": (x, force + self.difference)})
