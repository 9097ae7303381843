"""Play between the arm and its holder."""

from __future__ import annotations

from dataclasses import replace

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, Block, Effect, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.driven import Sliders
from fretflow.structure.two_mass_rig.force_laws import HingePlay
from fretflow.structure.two_mass_rig.joint import change_rig, rig_of
from fretflow.wear.slow import SlowState


class Backlash(Effect):
    """A gap that must be crossed, without force, each time the force between arm and holder changes its sign.

    In the rig the hinge between block and arm carries nothing within the play, and takes hold about its ends, as
    rounded faces and burrs touch by and by: with a stiffness that comes in over `rounding`. A driven joint has the play
    in series: its spring unloads, crosses the gap and loads again on the other side. With distributed slip limits each
    of the sliders has the play for itself.
    """

    id = "backlash"
    title = "play between arm and holder"
    block = Block.RIG
    equation = "k (|d| - g / 2) sign(d) where |d| > g / 2, else 0; dF/dd from 0 to k over (1 -+ r) g / 2"
    formula = (r"F = k \operatorname{sgn}(d)\,\max\left(|d| - \tfrac{g}{2},\ 0\right), \qquad "
               r"F'(d) \text{ from } 0 \text{ to } k \text{ over } |d| = (1 \mp r)\,\tfrac{g}{2}")
    source = ("dead zone in series with a spring: M. Nordin, P.-O. Gutman, Automatica 38 (2002), "
              "controlling mechanical systems with backlash; smooth ends of it: T. C. Kim, T. E. Rook, R. Singh, "
              "J. Sound Vib. 284 (2005) 933-958")
    first_order = False
    smooth = "rounding"
    observables = ("flat part of a loop where the force changes its sign",)
    kinds = INTERFACES

    play: u.SignedLength = parameter(2e-6, "g: play from end to end", 0.5e-6, 10e-6, ge=0.0, neutral=0.0)
    rounding: float = parameter(0.1, "r: share of half the play, to either side, over which the hinge takes hold", 0.1,
                                1.0, rig_only=True, ge=0.05, le=1.0, logarithmic=True,
                                source="from flat faces to round ones that touch from the middle on")

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Free the hinge within the play."""
        if self.play == 0.0:
            return problem
        hinge = rig_of(problem.structure).rig.hinge_stiffness
        play = HingePlay(hinge, self.play, self.rounding)
        return replace(problem, structure=change_rig(problem.structure, forces=(play,)))

    def sliders(self, sliders: Sliders) -> Sliders:
        """Put the play before the sliders."""
        return replace(sliders, play=sliders.play + self.play)
