"""A support of the driven block that stiffens or softens with its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.internal_forces import ForceAndSlopes
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState


@dataclass(frozen=True)
class _CubicSpring:
    """Force ``-k_3 x^3`` on the block."""

    stiffness: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        force, slope = np.zeros_like(displacement), np.zeros((len(displacement), 2, 2))
        force[:, 0] = -self.stiffness * displacement[:, 0]**3
        slope[:, 0, 0] = -3.0 * self.stiffness * displacement[:, 0]**2
        return ForceAndSlopes(force, slope, np.zeros_like(slope))


class SupportNonlinearity(Effect):
    """A cubic spring between the block and the ground, beside the linear one."""

    id = "support-nonlinearity"
    title = "cubic spring of the support"
    block = Block.RIG
    equation = "F = k_g x + k_3 x^3"
    formula = r"F = k_g x + k_3 x^3"
    source = "G. Duffing, Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz (1918)"
    observables = ("displacement at other amplitudes and frequencies", "odd harmonics of the displacement")

    stiffness: u.CubicStiffness = parameter(2e15, "k_3: force over displacement cubed", 2e14, 1e16,
                                            source="3 to 150 % of the paper's linear support at 10 µm", neutral=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Add the spring."""
        if self.stiffness == 0.0:
            return problem
        return replace(problem, structure=change_rig(problem.structure, forces=(_CubicSpring(self.stiffness),)))

    def sketch(self) -> Sketch:
        """Return the cubic force against displacement."""
        x = np.linspace(-10e-6, 10e-6, 101)
        return Sketch("displacement in µm", "force of the cubic spring in N", {"": (1e6 * x, self.stiffness * x**3)})
