"""Friction that differs with the direction of sliding."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from fretflow.case.config import Case
from fretflow.effects.effect import (
    ALL_KINDS,
    OTHER_LOAD,
    Array,
    Block,
    Effect,
    Motion,
    RecordingKind,
    Sketch,
    parameter,
)
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class DirectionalFriction(Effect):
    """Friction ``mu (1 + d)`` where the upper face slides to positive x, ``mu (1 - d)`` to negative x.

    In between the limit follows the direction of the friction force t, ``mu (1 - d t_x)``.
    """

    id: ClassVar[str] = "directional-friction"
    title: ClassVar[str] = "friction that differs with the direction of sliding"
    block: ClassVar[Block] = Block.CONTACT
    equation: ClassVar[str] = "mu (1 - d t_x), t the direction of the friction force"
    formula: ClassVar[str] = r"\mu\,(1 - d\,t_x), \qquad \boldsymbol{t} \text{ the direction of the friction force}"
    source: ClassVar[str] = "A. Zmitrowicz, Int. J. Solids Struct. 25 (1989), anisotropic friction with an offset disc"
    told_by: ClassVar[str] = OTHER_LOAD
    observables: ClassVar[tuple[str, ...]] = ("mean of the friction force", "even harmonics")
    kinds: ClassVar[frozenset[RecordingKind]] = ALL_KINDS

    difference: float = parameter(0.05, "d: half the difference between both directions, over their mean", 0.01, 0.1,
                                  gt=-1.0, lt=1.0, logarithmic=False)

    @classmethod
    def neutral(cls, case: Case | None = None) -> Self:
        """Return friction alike in both directions."""
        return cls(difference=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Let friction follow the direction."""
        return replace(problem, law=replace(problem.law, asymmetry=problem.law.asymmetry + self.difference))

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factors for sliding to positive and to negative x."""
        return 1.0 + self.difference, 1.0 - self.difference

    def sketch(self) -> Sketch:
        """Return a loop with its two plateaus."""
        x, force = np.array([-1.0, -0.6, 1.0, 0.6, -1.0]), np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
        return Sketch("displacement", "friction force over mu N",
                      {"baseline": (x, force), "effect": (x, force + self.difference)})
