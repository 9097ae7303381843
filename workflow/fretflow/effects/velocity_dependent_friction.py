"""Friction that falls, or rises, with the sliding speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fretflow.contact.law import FactorAndSlopes
from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, OTHER_LOAD, OTHER_RATES, Array, Block, Effect, Motion, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


@dataclass(frozen=True)
class _SpeedFactor:
    """``1 + a exp(-|v| / v_s)`` of the moving specimen's speed: the contact nodes' own would jump (see the sheet)."""

    strength: float
    scale: float

    def __call__(self, position: Array, velocity: Array) -> FactorAndSlopes:
        more = self.strength * np.exp(-np.abs(velocity) / self.scale)
        return FactorAndSlopes(1.0 + more, np.zeros_like(position), -np.sign(velocity) * more / self.scale)


class VelocityDependentFriction(Effect):
    """Friction ``mu (1 + a exp(-|v| / v_s))``, v the moving specimen's speed.

    The speed is that of the specimen and not of each contact node: a node without inertia on a spring, whose friction
    falls with its own speed, jumps, and its force then depends on the time step.
    """

    id = "velocity-dependent-friction"
    title = "friction that depends on the sliding speed"
    block = Block.CONTACT
    equation = "mu (1 + a exp(-|v| / v_s))"
    formula = r"\mu \left(1 + a\,e^{-|v| / v_s}\right)"
    source = ("exponential form of the Stribeck curve: L. C. Bo, D. Pavelescu, Wear 82 (1982); "
              "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)")
    needs_time = True
    told_by = OTHER_RATES
    told_from: ClassVar[Mapping[str, str]] = {
        "viscous": OTHER_LOAD + ", with which friction changes and a dashpot does not,"}
    observables = ("friction force over the plateau of a loop", "loops at other amplitudes")
    kinds = ALL_KINDS

    strength: float = parameter(0.2, "a: friction at rest over that at high speed, less one", 0.05, 0.5, gt=-1.0,
                                neutral=0.0)
    speed_scale: u.Velocity = parameter(2e-3, "v_s: speed over which friction falls", 0.5e-3, 8e-3)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Let friction follow the speed."""
        if self.strength == 0.0:
            return problem
        return replace(problem, law=replace(problem.law, motion_factors=(
            *problem.law.motion_factors, _SpeedFactor(self.strength, self.speed_scale))))

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factor at the measured speed, alike in both directions."""
        factor = _SpeedFactor(self.strength, self.speed_scale)(motion.displacement, motion.velocity).factor
        return factor, factor

    def sketch(self) -> Sketch:
        """Return the factor against speed."""
        speed = np.linspace(0.0, 5.0 * self.speed_scale, 200)
        return Sketch("speed in mm/s", "factor on mu",
                      {"": (1e3 * speed, 1.0 + self.strength * np.exp(-speed / self.speed_scale))})
