"""What an effect does to the worn volumes of whole tests, in the mean of each contact.

A series of wear tests is predicted by ``V = alpha E``, alpha one wear coefficient and E the dissipated energy, on which
the effects act by the same laws that they have at a node of the contact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fretflow.core.records import Array

PRESSURE, SLIDING, FREQUENCY, POWER, CYCLES = "pressure", "sliding", "frequency", "power density", "cycles"
UNITS = {PRESSURE: "Pa", SLIDING: "m", FREQUENCY: "Hz", POWER: "W/m^2", CYCLES: "1"}


@dataclass(frozen=True)
class WornTests:
    """What n tests were made at and wore; `varied` are the states that tell their laws apart."""

    volume: Array  # (n,), m^3
    energy: Array  # (n,), J
    states: Mapping[str, Array]  # by the names above, each (n,), SI
    varied: tuple[str, ...]
    weight: Array  # (n,), one over how often a test stands in the table

    def middle(self, state: str) -> float:
        """Return the geometric mean of a state."""
        return float(np.exp(np.average(np.log(self.states[state]), weights=self.weight)))


@dataclass(frozen=True)
class LawParameter:
    """A parameter of a law and its plausible range at the size of the tests."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    logarithmic: bool = True


@dataclass(frozen=True)
class VolumeLaw:
    """A law of an effect; `powers` names the states that it has powers of, each its own exponent."""

    effect: str
    parameters: tuple[LawParameter, ...]
    wear: Callable[[Array, Mapping[str, Array], Array], Array]  # volumes without it (n,), states, values (p,): (n,)
    powers: tuple[str, ...] = ()
    of_volume: bool = False  # whether it follows the worn volume itself: it then acts after the others
