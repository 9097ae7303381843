"""Wear of the share of the contact that oxygen reaches: abrasive by oxides there, adhesive where it does not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import Field

from fretflow.core import units as u
from fretflow.effects.effect import OTHER_RATES, STRUCTURES, Array, Block, Effect, Sketch, parameter
from fretflow.effects.third_body import edge_position
from fretflow.effects.wear_threshold import frictional_power
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState


class OxygenLimitedWear(Effect):
    """Archard wear that falls to a share where fresh metal takes up the oxygen before it gets there.

    Oxygen diffuses in from both ends of the contact along the sliding and is taken up by the metal that friction lays
    bare: ``D c'' = k c`` with k in proportion to the frictional power density q. In a contact from -a to a, c = 1 at
    the ends, this has the solution ``c = cosh(x / d) / cosh(a / d)`` with the distance ``d = sqrt(D / k)``, which falls
    as q^-1/2. Oxides wear by K_w; bare metal, which adheres and is carried from face to face, by the share k_a of it.
    """

    id = "oxygen-limited-wear"
    title = "adhesive instead of abrasive wear where oxygen does not reach"
    block = Block.WEAR
    equation = ("K_w (k_a + (1 - k_a) c); c = cosh(x / d) / cosh(a / d); d = d_0 (q_0 / q)^(1/2); "
                "q mean frictional power per area of contact")
    formula = (r"K_w \left[k_a + (1 - k_a)\,\frac{\cosh(x / d)}{\cosh(a / d)}\right], \qquad "
               r"d = d_0 \sqrt{q_0 / q}")
    source = ("S. Fouvry, P. Arnaud, A. Mignot, P. Neubauer, Tribol. Int. 113 (2017) 460-473, contact "
              "oxygenation; P. Arnaud, S. Baydoun, S. Fouvry, Tribol. Int. 161 (2021) 107077, reaction "
              "and diffusion; E. W. Thiele, Ind. Eng. Chem. 31 (1939) 916, their balance")
    told_by = OTHER_RATES
    observables = ("worn profile: W at high power, U at low", "wear rate over power density")
    kinds = STRUCTURES

    distance: u.Length = parameter(1e-3, "d_0: distance that oxygen reaches at q_0", 0.1e-3, 5e-3,
                                   source="oxygenated borders of 0.1 mm to a few, Fouvry et al. (2017)")
    adhesive_share: float = parameter(0.2, "k_a: adhesive over abrasive wear coefficient", 0.02, 0.8, ge=0.0, le=1.0,
                                      source="wear rates of Ti-6Al-4V at the highest over those at the lowest power",
                                      neutral=1.0)
    # No range: it only says where d_0 is stated.
    reference_power: u.PowerDensity = Field(1e5, description="q_0: frictional power density at which d_0 is stated")

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return the mean coefficient by the oxygen that reaches each node, over K_w."""
        face, closed = problem.interface, response.contact_share > 0.0
        if not closed.any():
            return np.ones(face.size)
        power = float(np.average(frictional_power(response, problem)[closed], weights=face.areas[closed]))
        half = 0.5 * float(np.ptp(face.nodes[closed, 0]))
        depth = self.distance * np.sqrt(self.reference_power / max(power, 1e-300))
        oxygen = oxygen_share(edge_position(face.nodes, face.areas, closed), half / depth)
        return np.asarray(self.adhesive_share + (1.0 - self.adhesive_share) * oxygen)

    def sketch(self) -> Sketch:
        """Return the coefficient across a contact of 3 mm, by the frictional power."""
        place = np.linspace(-1.0, 1.0, 101)
        curves: Mapping[str, tuple[Array, Array]] = {
            f"{1e-6 * power:g} W/mm²": (1.5 * place, self.adhesive_share + (1.0 - self.adhesive_share) * oxygen_share(
                place, 1.5e-3 / self.distance * np.sqrt(power / self.reference_power))) for power in (5e3, 5e4, 5e5)}
        return Sketch("position along the sliding in mm", "coefficient over K_w", curves)


def oxygen_share(place: Array, width: float) -> Array:
    """Return the oxygen over that outside, at places from -1 to 1 of a contact of half width `width` (over d)."""
    inward = width * (1.0 - np.abs(place))
    return np.asarray(np.exp(-inward) * (1.0 + np.exp(-2.0 * width * np.abs(place))) / (1.0 + np.exp(-2.0 * width)))
