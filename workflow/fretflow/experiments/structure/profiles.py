"""Worn profiles of a line contact under the inference engine: what Archard's march with laws of wear predicts.

The baseline refits one wear coefficient, and the friction where it is not known. Each profile is one group of rows; the
place across the scar stands for the phase of a loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log
from typing import ClassVar

import numpy as np

from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Array, Effect, Prior
from fretflow.effects.line_cycle import JUMPS, LineContact, LineCycle
from fretflow.experiments.rig.observation import DEFAULT_WEAR_SD
from fretflow.experiments.structure.experiment import STATED
from fretflow.experiments.structure.points import scatter
from fretflow.inference.experiment import Experiment, Measurement, Point, Prediction
from fretflow.inference.parameters import HALF, Coordinate, Parameters
from fretflow.recordings.kinds.structures import WornRecording
from fretflow.recordings.kinds.worn_profiles import WornArea

ROOM = 1.3  # times the half width of a scar that is worn without debris, where strips end
HELD_SHARE = 0.1  # relative sd of a worn area without one: repeats of fretting tests, ASTM G204


@dataclass(frozen=True)
class ProfileExperiment(Experiment):
    """Laws of wear against worn profiles."""

    recording: WornRecording
    jumps: int = JUMPS  # of the march; what twice as many change is an error of the prediction
    many: ClassVar[bool] = False  # predictions are quick

    @property
    def tests(self) -> tuple[WornArea, ...]:
        """Return the tests: those of profiles, then those of which the area alone is known."""
        return (*(one.test for one in self.recording.profiles), *self.recording.areas)

    @cached_property
    def measurement(self) -> Measurement:
        """Return depths of all profiles, m, then worn areas over the width of a scar, m."""
        profiles, areas = self.recording.profiles, self.recording.areas
        counts = [len(one.x) for one in profiles]
        values: Array = np.concatenate([*(one.depth for one in profiles), [one.area / self._width for one in areas]])
        sd: Array = np.concatenate([*(np.full(len(one.x), one.depth_sd or max(
            scatter(one.x, one.depth), DEFAULT_WEAR_SD * float(one.depth.max()))) for one in profiles),
            [(one.area_sd or HELD_SHARE * one.area) / self._width for one in areas]])
        group = np.repeat(np.arange(len(self.tests)), [*counts, *(1 for _ in areas)])
        gain = np.concatenate([*(one.calibration_sd * one.depth for one in profiles), np.zeros(len(areas))])
        phase = np.concatenate([*(0.5 * (one.x - one.x[0]) / float(np.ptp(one.x)) for one in profiles),
                                np.full(len(areas), np.nan)])
        alone = np.arange(len(values)) >= sum(counts)
        fine = replace(self, jumps=2 * self.jumps).first_prediction().values - self.first_prediction().values
        return Measurement.of(
            values, sd**2, modes=gain[:, None], code_error=fine[:, None], channel=alone.astype(np.int64),
            channels=("worn depth", "worn volume")[:2 if areas else 1], phase=phase, group=group, condition=group,
            groups=(*(one.name for one in profiles), *(f"test {k + 1}" for k in range(len(areas)))))

    @cached_property
    def _width(self) -> float:
        return 2.0 * max(float(np.abs(one.x).max()) for one in self.recording.profiles)

    @cached_property
    def _half_width(self) -> float:
        """Return half of where there are strips: the scar that most area makes without debris, and the profile."""
        own, area = self.recording.contact, max(one.area for one in self.tests)
        hertz = float(np.sqrt(4.0 * own.load * own.radius / (np.pi * self._modulus)))
        return float(max(0.5 * self._width, ROOM * (1.5 * area * own.radius)**(1.0 / 3.0) + hertz))

    @property
    def _modulus(self) -> float:
        own = self.recording.contact
        return 0.5 * own.youngs_modulus / (1.0 - own.poissons_ratio**2)

    def first_prediction(self) -> Prediction:
        """Return what the baseline predicts in the middle of its ranges."""
        space = self.parameters(())
        return self.predict(Point(space, np.zeros(space.size)))

    def candidates(self) -> tuple[str, ...]:
        """Return the effects that change how fast a place wears."""
        return tuple(name for name, kind in catalogue().items() if kind.wear_factor is not Effect.wear_factor)

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of the wear coefficient, of the friction, and of `effects`.

        The coefficient's range is that of the areas over load and path, and at least a decade either way.
        """
        load = self.recording.contact.load
        ratio = np.log([one.area / (load * 4.0 * one.amplitude * one.cycles) for one in self.tests])
        spread = max(float(np.ptp(ratio)), 2.0 * log(10.0))
        low, high = (log(end) for end in self.recording.friction)
        return Parameters.of([Coordinate("", "wear_coefficient", float(np.mean(ratio)), spread / (2.0 * HALF), True),
                              Coordinate("", "friction_coefficient", 0.5 * (low + high),
                                         max((high - low) / (2.0 * HALF), STATED), True)], effects, signs, self._scaled)

    def _scaled(self, effect: str, field: str, prior: Prior) -> Prior:
        deepest = max(float(one.depth.max()) for one in self.recording.profiles)
        return catalogue()[effect].worn_range(field, prior, deepest, max(one.cycles for one in self.tests))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the depths and areas of a hypothesis.

        Raises
        ------
        NonConvergenceError
            If a pressure is not found.
        """
        own, effects = point.parameters.values(point.z)[""], point.built()
        contact, made = self.recording.contact, []
        for k, test in enumerate(self.tests):
            line = LineContact(radius=contact.radius, modulus=self._modulus, load=contact.load,
                               amplitude=test.amplitude, frequency=test.frequency,
                               friction=own["friction_coefficient"], half_width=self._half_width)
            depth = LineCycle(line, effects).wear(own["wear_coefficient"], test.cycles, self.jumps).slow.depth
            if k < len(self.recording.profiles):
                made.append(np.interp(self.recording.profiles[k].x, line.interface.nodes[:, 0], depth))
            else:
                made.append(np.array([float(line.interface.areas @ depth) / self._width]))
        return Prediction(point, np.concatenate(made))
