"""Asperity springs that stiffen as the faces bed in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from fretflow.core import units as u
from fretflow.effects.contact_stiffness import ContactStiffness, with_asperities
from fretflow.effects.effect import Array, Sketch, parameter
from fretflow.effects.relaxation import order_of_relaxation, share_left
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class ContactStiffnessEvolution(ContactStiffness):
    """The asperity springs of ``contact-stiffness``, stiffer by a factor that grows with the dissipated energy E.

    It holds those springs itself, so that its parameters are theirs and two more; with b = 0 it is that effect.
    """

    id = "contact-stiffness-evolution"
    title = "asperity springs that stiffen with the dissipated energy"
    equation = ("k_c (1 + b (1 - y(E / E_0))); dy/dx = -y^o, exp(-x) for o = 1; "
                "k_c = k_t (p / p_0)^m per area, normal ratio k_t")
    formula = (r"k_c = k_t \left(\frac{p}{p_0}\right)^m \left[1 + b \left(1 - y(E / E_0)\right)\right], \qquad "
               r"y' = -y^o,\ y(0) = 1")
    source = "A. Fantetti et al., Tribol. Int. 138 (2019) 111-124, contact stiffness against energy"
    over_cycles = True
    observables = ("slope of the stick portion of a loop over cycles", "first resonance over cycles")
    told_from: ClassVar[Mapping[str, str]] = {
        other: how for other, how in ContactStiffness.told_from.items() if other != "contact-stiffness-evolution"}
    excludes: ClassVar[Mapping[str, str]] = {
        "contact-stiffness": "contact-stiffness-evolution holds the springs itself; give their parameters there"}

    gain: float = parameter(1.5, "b: relative growth of the stiffness in the end", 0.5, 4.0, gt=-1.0)
    energy: u.Energy = parameter(50.0, "E_0: energy over which it grows", 5.0, 150.0)
    order: float = order_of_relaxation()

    @classmethod
    def plainest(cls) -> Self:
        """Return the springs as they are from the start."""
        return cls(gain=0.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Put the springs at this energy in."""
        asperities = self.asperities(problem.interface.areas)
        return with_asperities(problem, replace(asperities, stiffness=asperities.stiffness * float(
            self.growth(slow.energy))))

    def growth(self, energy: Array | float) -> Array:
        """Return the stiffness after `energy` in J over that at the start."""
        return np.asarray(1.0 + self.gain * (1.0 - share_left(np.asarray(energy) / self.energy, self.order)))

    def sketch(self) -> Sketch:
        """Return the stiffness against energy."""
        energy = np.linspace(0.0, 5.0 * self.energy, 200)
        return Sketch("dissipated energy in J", "tangential stiffness at p_0 in N/µm",
                      {"": (energy, 1e-6 * self.stiffness * self.growth(energy))})
