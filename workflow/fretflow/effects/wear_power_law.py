"""Wear whose coefficient depends on pressure, sliding and frequency."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np

from fretflow.case.config import Case
from fretflow.core import units as u
from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState


class WearPowerLaw(Effect):
    """Wear coefficient with powers of pressure, sliding path and frequency; at their references it is the case's.

    The pressure of a node is that under which it slides, sum p |du| / sum |du|, its path s = sum |du| per cycle.
    """

    id: ClassVar[str] = "wear-power-law"
    title: ClassVar[str] = "wear coefficient with powers of pressure, sliding and frequency"
    block: ClassVar[Block] = Block.WEAR
    equation: ClassVar[str] = "K_w (p / p_0)^a (s / s_0)^b (f / f_0)^c"
    source: ClassVar[str] = ("S. Baydoun, S. Fouvry, S. Descartes, P. Arnaud, Wear 426-427 (2019) 676-693, weighted "
                             "friction energy")
    told_by: ClassVar[str] = "tests at other amplitudes and normal loads"
    observables: ClassVar[tuple[str, ...]] = ("worn volume of tests at other loads, amplitudes and frequencies",
                                              "wear map near the edges")

    pressure_exponent: float = parameter(0.25, "a: of the pressure", -0.5, 0.5)
    sliding_exponent: float = parameter(0.25, "b: of the sliding path", -0.5, 0.5)
    frequency_exponent: float = parameter(-0.25, "c: of the frequency", -0.5, 0.2)
    reference_pressure: u.Pressure = parameter(60e6, "p_0: pressure at which the coefficient is K_w", 10e6, 200e6)
    reference_sliding: u.Length = parameter(25e-6, "s_0: path per cycle likewise", 5e-6, 100e-6)
    reference_frequency: u.Frequency = parameter(100.0, "f_0: frequency likewise", 10.0, 500.0)

    @classmethod
    def neutral(cls, case: Case | None = None) -> Self:
        """Return Archard's law."""
        return cls(pressure_exponent=0.0, sliding_exponent=0.0, frequency_exponent=0.0)

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return the three powers at each node."""
        slides = response.pressure_sliding > 0.0
        path = np.where(slides, response.slip_path, self.reference_sliding)
        pressure = np.where(slides, response.pressure_sliding / path, self.reference_pressure)
        return np.asarray((pressure / self.reference_pressure)**self.pressure_exponent
                          * (path / self.reference_sliding)**self.sliding_exponent
                          * (problem.frequency / self.reference_frequency)**self.frequency_exponent)

    def sketch(self) -> Sketch:
        """Return each power against its quantity."""
        share = np.geomspace(0.2, 5.0, 200)
        exponents = {"pressure": self.pressure_exponent, "sliding": self.sliding_exponent,
                     "frequency": self.frequency_exponent}
        return Sketch("quantity over its reference", "wear coefficient over K_w",
                      {name: (share, share**exponent) for name, exponent in exponents.items()})
