"""Wear whose coefficient depends on pressure, sliding and frequency."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.effects.volume_law import FREQUENCY, POWER, PRESSURE, SLIDING, LawParameter, VolumeLaw, WornTests
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

LETTERS = {PRESSURE: "a", SLIDING: "b", FREQUENCY: "c", POWER: "a = b = c"}


class WearPowerLaw(Effect):
    """Wear coefficient with powers of pressure, sliding path and frequency; at their references it is the case's.

    The pressure of a node is that under which it slides, sum p |du| / sum |du|, its path s = sum |du| per cycle.
    """

    id = "wear-power-law"
    title = "wear coefficient with powers of pressure, sliding and frequency"
    block = Block.WEAR
    equation = "K_w (p / p_0)^a (s / s_0)^b (f / f_0)^c"
    formula = (r"K_w \left(\frac{p}{p_0}\right)^a \left(\frac{s}{s_0}\right)^b "
               r"\left(\frac{f}{f_0}\right)^c")
    source = "S. Baydoun, S. Fouvry, S. Descartes, P. Arnaud, Wear 426-427 (2019) 676-693, weighted friction energy"
    told_by = "tests at other amplitudes and normal loads"
    observables = ("worn volume of tests at other loads, amplitudes and frequencies", "wear map near the edges")

    pressure_exponent: float = parameter(0.25, "a: of the pressure", -0.5, 0.5, neutral=0.0)
    sliding_exponent: float = parameter(0.25, "b: of the sliding path", -0.5, 0.5, neutral=0.0)
    frequency_exponent: float = parameter(-0.25, "c: of the frequency", -0.5, 0.2, neutral=0.0)
    reference_pressure: u.Pressure = parameter(60e6, "p_0: pressure at which the coefficient is K_w", 10e6, 200e6)
    reference_sliding: u.Length = parameter(25e-6, "s_0: path per cycle likewise", 5e-6, 100e-6)
    reference_frequency: u.Frequency = parameter(100.0, "f_0: frequency likewise", 10.0, 500.0)

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return the three powers at each node."""
        slides = response.pressure_sliding > 0.0
        path = np.where(slides, response.slip_path, self.reference_sliding)
        pressure = np.where(slides, response.pressure_sliding / path, self.reference_pressure)
        return product_of_powers(
            {PRESSURE: pressure, SLIDING: path, FREQUENCY: np.full(len(path), problem.frequency)},
            {PRESSURE: self.reference_pressure, SLIDING: self.reference_sliding, FREQUENCY: self.reference_frequency},
            {PRESSURE: self.pressure_exponent, SLIDING: self.sliding_exponent, FREQUENCY: self.frequency_exponent})

    @classmethod
    def volume_laws(cls, tests: WornTests) -> tuple[VolumeLaw, ...]:
        """Return laws with powers of each set of the conditions that vary, or of their power density.

        The power density is pressure times path times frequency, so that all three then have one exponent.
        """
        own = [name for name in (PRESSURE, SLIDING, FREQUENCY) if name in tests.varied]
        sets = [names for size in range(1, len(own) + 1) for names in combinations(own, size)]
        return tuple(cls._law(names, tests) for names in sets + [(POWER,)] * (POWER in tests.varied))

    @classmethod
    def _law(cls, names: tuple[str, ...], tests: WornTests) -> VolumeLaw:
        at = {name: tests.middle(name) for name in tests.states if name in LETTERS}

        def worn(plain: Array, states: Mapping[str, Array], values: Array) -> Array:
            return np.asarray(plain * product_of_powers(states, at, dict(zip(names, values, strict=True))))

        made = [LawParameter(f"{name.replace(' ', '_')}_exponent", "1", f"{LETTERS[name]}: of the {name}", -1.0, 1.0,
                             logarithmic=False) for name in names]  # from one over the state to proportional to it
        return VolumeLaw(cls.id, tuple(made), worn, powers=names)

    def sketch(self) -> Sketch:
        """Return each power against its quantity."""
        share = np.geomspace(0.2, 5.0, 200)
        exponents = {"pressure": self.pressure_exponent, "sliding": self.sliding_exponent,
                     "frequency": self.frequency_exponent}
        return Sketch("quantity over its reference", "wear coefficient over K_w",
                      {name: (share, share**exponent) for name, exponent in exponents.items()})


def product_of_powers(states: Mapping[str, Array], references: Mapping[str, float], exponents: Mapping[str, float]
                      ) -> Array:
    """Return the product (n,) of ``(x / x_0)^a`` over the states that have an exponent."""
    return np.asarray(np.exp(np.sum([a * np.log(states[name] / references[name]) for name, a in exponents.items()],
                                    axis=0)))
