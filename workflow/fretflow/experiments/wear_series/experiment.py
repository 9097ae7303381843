"""A series of wear tests under the inference engine: worn volumes, and those that one coefficient and effects predict.

The baseline is Archard's law in its energy form, ``V = alpha E``; the laws of the effects stand in their files. Scatter
grows with the volume by a power that is not known beforehand, so that both sides are transformed alike, see `scatter`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np

from fretflow.core.records import Array
from fretflow.core.units import pretty_quantity
from fretflow.effects.volume_law import UNITS, VolumeLaw
from fretflow.experiments.independent import IndependentExperiment
from fretflow.experiments.wear_series.data import WearData
from fretflow.inference.experiment import Measurement, Point, Prediction
from fretflow.inference.parameters import HALF, Coordinate, Parameters


@dataclass(frozen=True)
class WearSeriesExperiment(IndependentExperiment):
    """Laws of worn volumes against tests; `forms` holds the law that each effect has here."""

    data: WearData
    forms: Mapping[str, VolumeLaw]
    counts: Mapping[str, int]  # laws that each was chosen from

    @cached_property
    def measurement(self) -> Measurement:
        """Return the transformed volumes over their geometric mean; a test that stands k times counts as one."""
        tests = self.data.tests
        conditions, group = np.unique(self.data.condition, return_inverse=True)
        return Measurement.of(
            self._shown(tests.volume), (self.data.sd / tests.scale)**2 / tests.weight, repeatable=tests.weight,
            channels=("worn volume",), group=group, groups=tuple(f"condition {k + 1}" for k in conditions))

    def _shown(self, volume: Array) -> Array:
        tests = self.data.tests
        return np.asarray((tests.transformed(volume) - tests.transformed(np.full(len(volume), tests.scale)))
                          / tests.scale)

    @property
    def modulations(self) -> Array:
        """Return the logarithms of what varies, and of the energy: a law of another form bends over one of them."""
        tests = self.data.tests
        logs = np.stack([np.log(x) for x in (*(tests.states[name] for name in tests.varied), tests.energy)], axis=1)
        logs = logs - np.average(logs, axis=0, weights=tests.weight)
        spread = np.sqrt(np.average(logs**2, axis=0, weights=tests.weight))
        return np.asarray(logs / (np.maximum(spread, 1e-300) * np.sqrt(logs.shape[1])))

    def choice(self, effect: str) -> float:
        """Return the logarithm of how many laws an effect's was chosen from."""
        return log(self.counts[effect])

    def candidates(self) -> tuple[str, ...]:
        """Return the effects that have a law of such tests."""
        return tuple(self.forms)

    def together(self, effects: Sequence[str]) -> bool:
        """Tell whether effects may act at once: laws of one test's history are not told apart, nor more than tests."""
        size = 1 + sum(len(self.forms[name].parameters) for name in effects)
        return self.data.tests.count - size >= 2.0 and (
            len(effects) < 2 or (len(effects) == 2 and any(self.forms[name].powers for name in effects)))

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of the wear coefficient and the effects' laws.

        The range of the coefficient is that of worn volume over energy among the tests, and at least a decade.
        """
        ratio, weight = np.log(self.data.tests.volume / self.data.tests.energy), self.data.tests.weight
        middle, spread = float(np.average(ratio, weights=weight)), max(float(np.ptp(ratio)), log(10.0))
        own = [Coordinate("", "wear_coefficient", middle, spread / (2.0 * HALF), True),
               *(Coordinate.within(name, one.name, one.low, one.high, one.logarithmic)
                 for name in sorted(effects) for one in self.forms[name].parameters)]
        return Parameters(tuple(sorted(effects)), tuple(own), dict(signs or {}))

    def volumes(self, point: Point) -> Array:
        """Return the worn volumes (n,) of a hypothesis, m^3."""
        values, tests = point.parameters.values(point.z), self.data.tests
        volume = values[""]["wear_coefficient"] * tests.energy
        laws = [self.forms[name] for name in point.parameters.effects if name not in point.neutral]
        for law in sorted(laws, key=lambda one: one.of_volume):
            own = np.array([values[law.effect][parameter.name] for parameter in law.parameters])
            volume = law.wear(volume, tests.states, own)
        return volume

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the transformed volumes that a hypothesis predicts."""
        return Prediction(point, self._shown(self.volumes(point)))

    def described(self, coordinate: Coordinate) -> tuple[str, str]:
        """Return the unit and the meaning of a parameter."""
        if coordinate.effect:
            return next((one.unit, one.meaning) for one in self.forms[coordinate.effect].parameters
                        if one.name == coordinate.field)
        tests, series = self.data.tests, self.data.series
        at = ", ".join(f"{name} {pretty_quantity(tests.middle(name), UNITS[name], 3)}"
                       for law in self.forms.values() for name in law.powers)
        where = f", at {at}" if at else ""
        if not series.relative:
            return "m^3/J", f"worn volume per dissipated energy, K_w over the friction coefficient{where}"
        if "load" in series.states:
            return "m^2/N", f"K_w: worn volume per load and sliding{where}"
        return "m^2/Pa", f"worn volume per pressure and sliding, K_w times the area{where}"
