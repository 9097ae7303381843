"""A normal load that follows the motion: a wedge, a tilted guide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import ALL_KINDS, Array, Block, Effect, Motion, Sketch, parameter
from fretflow.effects.sketches import AMPLITUDE
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.two_mass_rig.joint import change_rig, rig_of
from fretflow.wear.slow import SlowState


class NormalLoadCoupling(Effect):
    """Normal load ``N_0 + s x (1 + k x)``, x the position of the moving specimen, k how a guide is curved.

    Where a measured motion drives the joint, the friction limit follows as ``1 + s x / N_0``, with N_0 given here.
    """

    id = "normal-load-coupling"
    title = "normal load that follows the motion"
    block = Block.CONTACT
    equation = "N = N_0 + s x (1 + k x)"
    formula = r"N = N_0 + s\,x\,(1 + k\,x)"
    source = ("C.-H. Menq, J. H. Griffin, J. Bielak, J. Sound Vib. 107 (1986), variable normal load; "
              "wedge of half-angle a on a support of stiffness k_n: s = k_n tan a")
    told_by = "a record of the normal force over the loops"
    observables = ("slope of both plateaus of a loop, opposite in sign", "normal force")
    kinds = ALL_KINDS

    slope: u.SignedStiffness = parameter(0.3e6, "s: change of the load with the position", 0.05e6, 1.5e6, neutral=0.0)
    mean_load: u.Force = parameter(60.0, "N_0 where no normal load is known (driven joints)", 10.0, 200.0,
                                  held=True)
    curvature: u.SignedCurvature = parameter(0.0, "k: of the guide, by which its slope differs over a length",
                                             -5e4, 5e4, rig_only=True)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Let the load follow the arm."""
        rig = rig_of(problem.structure).rig
        return replace(problem, structure=change_rig(
            problem.structure, load_slope=rig.load_slope + self.slope,
            load_curvature=rig.load_curvature + self.slope * self.curvature))

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factor at each position; a load cannot pull."""
        centred = motion.displacement - motion.displacement.mean()
        factor = np.maximum(1.0 + self.slope * centred / self.mean_load, 0.0)
        return factor, factor

    def sketch(self) -> Sketch:
        """Return a loop whose plateaus open towards one side."""
        x, force = np.array([-1.0, -0.6, 1.0, 0.6, -1.0]), np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
        steep = force * (1.0 + self.slope * AMPLITUDE * x / self.mean_load)
        return Sketch("displacement over 7 µm", "friction force over mu N_0",
                      {"baseline": (x, force), "effect": (x, steep)})
