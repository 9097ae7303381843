"""A catalogue of waves: a linear problem with a discrepancy, whose posterior and search are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from fretflow.inference.experiment import Measurement, Point, Prediction, differences
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.search import FAST, Search
from fretflow.inference.strategy import run_search, start_search

LOOPS, SAMPLES = 6, 24
BASELINE = (Coordinate("", "friction", 0.0, 0.3, True),)
SD = 0.02


def measurement(values: Array | None = None, sd: float = SD) -> Measurement:
    """Return six loops of one channel, of size one, with noise of two hundredths and code errors of one."""
    size = LOOPS * SAMPLES
    phase, loop = np.tile(np.arange(SAMPLES) / SAMPLES, LOOPS), np.repeat(np.arange(LOOPS), SAMPLES)
    own = np.sqrt(2.0) * np.cos(2.0 * np.pi * phase) if values is None else values
    return Measurement.of(
        own, np.full(size, sd**2), code_error=0.01 * np.sin(16.0 * np.pi * phase + 0.3)[:, None], channels=("force",),
        phase=phase, group=loop, groups=tuple(map(str, range(LOOPS))), cycles=loop / (LOOPS - 1.0))


SHAPES = {"viscous": lambda phase, share: np.sin(2.0 * np.pi * phase),
          "support-nonlinearity": lambda phase, share: np.cos(6.0 * np.pi * phase),
          "parallel-stiffness": lambda phase, share: share * np.cos(4.0 * np.pi * phase),
          "sensor-inertia": lambda phase, share: np.sin(10.0 * np.pi * phase)}


@dataclass(frozen=True)
class Waves:
    """Loops that are a cosine; each effect adds a wave of its own, of a size as large as its coordinate."""

    measurement: Measurement
    listed: tuple[str, ...] = tuple(SHAPES)

    def candidates(self) -> tuple[str, ...]:
        """Return the effects that are listed."""
        return self.listed

    def together(self, effects: Sequence[str]) -> bool:
        """Return that all may act at once."""
        return True

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the size of the cosine, and those of the effects."""
        own = tuple(Coordinate(name, "size", 0.3, 0.1, False, 0.0) for name in sorted(effects))
        return Parameters(tuple(sorted(effects)), (*BASELINE, *own))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves."""
        own = point.parameters.values(point.z)
        values = own[""]["friction"] * cosine()
        for name in point.effects - point.neutral:
            values = values + own[name]["size"] * wave(name)
        return Prediction(point, values)

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return differences."""
        return differences(self, prediction, points)

    def by_chance(self, prediction: Prediction) -> np.ndarray:
        """Return that nothing is left to chance."""
        return np.zeros((len(prediction.values), 0))

    def before_jump(self, leading: Prediction) -> None:
        """Return nothing: no motion jumps."""

    def has_made(self, prediction: Prediction) -> bool:
        """Return that every prediction is of the model."""
        return True

    def finer(self) -> None:
        """Return nothing."""

    def corrected(self, prediction: Prediction) -> None:
        """Return nothing."""


def cosine() -> Array:
    """Return the baseline's loops."""
    return np.asarray(np.sqrt(2.0) * np.cos(2.0 * np.pi * measurement().phase))


def wave(name: str) -> Array:
    """Return what an effect of size one adds."""
    own = measurement()
    return np.asarray(SHAPES[name](own.phase, own.cycles))


def judged(values: Array, listed: tuple[str, ...] = tuple(SHAPES), sd: float = SD) -> Search:
    """Return the finished search in a recording."""
    experiment = Waves(measurement(values, sd), listed)
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    run_search(search, lambda share, text: None)
    return search
