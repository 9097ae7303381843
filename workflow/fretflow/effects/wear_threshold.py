"""Wear that needs a least frictional power."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import OTHER_LENGTHS, Array, Block, Effect, Sketch, parameter
from fretflow.effects.volume_law import POWER, LawParameter, VolumeLaw, WornTests
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

LEAST_SHARE = 0.02  # of a test's wear, below the threshold: what is lost or read there all the same, of some size


class WearThreshold(Effect):
    """Archard wear of the frictional power density beyond a threshold.

    With one friction coefficient a node dissipates q = mu f sum p |du| per area in the mean of a period at frequency f,
    so that Archard's rate is (K_w / (mu f)) q per cycle; here q - q_th takes the place of q. The power of a node is
    taken as its share, by sum p |du| a, of the whole dissipated power, which also holds where mu is not constant.
    """

    id = "wear-threshold"
    title = "no wear below a frictional power density"
    block = Block.WEAR
    equation = "K_w sum p |du| max(0, 1 - q_th / q), q frictional power per area"
    formula = (r"K_w \sum p\,|\mathrm{d}u|\,\max\left(0,\ 1 - \frac{q_\mathrm{th}}{q}\right), \qquad "
               r"q \text{ frictional power per area}")
    source = ("S. Fouvry, T. Liskiewicz, Ph. Kapsa, S. Hannel, E. Sauger, Wear 255 (2003) 287-298, "
              "energy wear approach with a threshold")
    told_by = OTHER_LENGTHS
    told_from: ClassVar[Mapping[str, str]] = {
        "wear-power-law": "tests at amplitudes and normal loads whose power density lies far below and far above those "
                          "recorded, where a threshold wears nothing or in proportion and a power does neither,"}
    observables = ("wear map: unworn zones", "worn volume of tests at other loads", "approach over cycles")

    power_density: u.PowerDensity = parameter(4e4, "q_th: power per area below which nothing wears", 1.3e4, 8e4,
                                              source="0.1 to 0.6 of 130 kW/m², test 1 in the mean of contact and time",
                                              neutral=0.0)

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return the share of the power beyond the threshold."""
        return self.share(frictional_power(response, problem))

    def share(self, power: Array) -> Array:
        """Return the share of a `power` density, W/m^2, that lies beyond the threshold."""
        below = np.divide(self.power_density, power, out=np.ones_like(power), where=power > self.power_density)
        return np.asarray(1.0 - below) if self.power_density > 0.0 else np.ones_like(power)

    @classmethod
    def volume_laws(cls, tests: WornTests) -> tuple[VolumeLaw, ...]:
        """Return the law at each test's power density; thresholds from a tenth of the least to 0.6 of the middle."""
        if POWER not in tests.varied:
            return ()

        def worn(plain: Array, states: Mapping[str, Array], values: Array) -> Array:
            return np.asarray(plain * np.maximum(cls().changed(power_density=values[0]).share(states[POWER]),
                                                 LEAST_SHARE))

        own = LawParameter("power_density", "W/m^2", "q_th: power per area below which nothing wears",
                           0.1 * float(tests.states[POWER].min()), 0.6 * tests.middle(POWER))
        return (VolumeLaw(cls.id, (own,), worn),)

    def sketch(self) -> Sketch:
        """Return the rate against power."""
        power = np.linspace(0.0, 4.0 * self.power_density, 200)
        return Sketch("frictional power density in kW/m²", "wear rate over Archard's at q_th", {
            "Archard": (1e-3 * power, power / self.power_density),
            "threshold": (1e-3 * power, np.maximum(power / self.power_density - 1.0, 0.0))})


def frictional_power(response: CycleResponse, problem: PeriodicProblem) -> Array:
    """Return the mean frictional power per area (nodes,), W/m^2; its integral is the whole dissipated power."""
    sliding = response.pressure_sliding
    total = float(problem.interface.areas @ sliding)
    if not total > 0.0:
        return np.zeros_like(sliding)
    return np.asarray(problem.frequency * response.dissipated_energy / total * sliding)
