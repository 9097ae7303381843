"""Evidence of rows that differ from a law independently, against the density of a normal vector written out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from fretflow.experiments.independent import IndependentSearch, at_rest, estimates, in_turn, smallest_visible
from fretflow.inference.evidence import SIZES, sizes
from fretflow.inference.experiment import Measurement, Point, Prediction, differences
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.search import FAST
from scipy.stats import multivariate_normal

COUNT = 12
SLOPES = np.column_stack([np.ones(COUNT), np.linspace(-1.0, 1.0, COUNT)])


@dataclass(frozen=True)
class Linear:
    """A constant, to which one effect adds a slope; all coordinates are standard normal beforehand."""

    measurement: Measurement
    cost: float = 0.0

    @property
    def modulations(self) -> Array:
        """Return nothing that other forms would follow."""
        return np.zeros((COUNT, 0))

    def choice(self, effect: str) -> float:
        """Return what the choice of a law costs."""
        return self.cost

    def described(self, coordinate: Coordinate) -> tuple[str, str]:
        """Return no unit."""
        return "1", coordinate.field

    def candidates(self) -> tuple[str, ...]:
        """Return the effect that lends its name."""
        return ("viscous",)

    def together(self, effects: Sequence[str]) -> bool:
        """Tell that it may act."""
        return True

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return one coordinate, and one of the effect."""
        own = [Coordinate("", "level", 0.0, 1.0, False), *(Coordinate(name, "slope", 0.0, 1.0, False)
                                                           for name in effects)]
        return Parameters(tuple(effects), tuple(own))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the line."""
        return Prediction(point, SLOPES[:, :len(point.z)] @ point.z)

    def by_chance(self, prediction: Prediction) -> Array:
        """Return nothing."""
        return np.zeros((len(prediction.values), 0))

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return differences."""
        return differences(self, prediction, points)

    def has_made(self, prediction: Prediction) -> bool:
        """Tell that there is no other model."""
        return True

    def before_jump(self, leading: Prediction) -> None:
        """Return nothing: no motion jumps."""

    def finer(self) -> None:
        """Return nothing."""

    def corrected(self, prediction: Prediction) -> None:
        """Return nothing."""


def linear(weight: float = 1.0, cost: float = 0.0, modes: int = 0) -> Linear:
    """Return a noisy line with a slope of 1.5 and errors that rows share."""
    rng = np.random.default_rng(3)
    values = SLOPES @ np.array([0.4, 1.5]) + 0.1 * rng.standard_normal(COUNT)
    return Linear(Measurement.of(
        values, np.full(COUNT, 0.01 / weight), modes=0.05 * rng.standard_normal((COUNT, modes)),
        repeatable=np.full(COUNT, weight), channels=("a",), groups=("b",)), cost)


def search_of(experiment: Linear, effects: Sequence[str]) -> IndependentSearch:
    """Return a search with one set fitted."""
    search = IndependentSearch(experiment, in_turn, FAST)
    for names in ((), effects):
        own = experiment.parameters(names)
        search.keep([at_rest(search.fitter, Point(own, np.zeros(own.size)))])
    return search


@pytest.mark.parametrize("modes", [0, 2])
def test_the_evidence_is_the_density_of_a_normal_vector(modes):
    """Differences between sizes of the discrepancy, where constants of the recording cancel, to round-off."""
    experiment = linear(modes=modes)
    own = experiment.measurement
    table = search_of(experiment, ["viscous"]).evidence(frozenset({"viscous"}), laws=frozenset()).table[0]
    known = [multivariate_normal.logpdf(own.values, np.zeros(COUNT), np.diag(own.variance + (tau * sizes(own))**2)
                                        + SLOPES @ SLOPES.T + own.modes @ own.modes.T) for tau in SIZES]
    assert table - table[0] == pytest.approx(np.array(known) - known[0], abs=1e-8)


def test_rows_that_are_alike_count_as_one():
    """Four copies of each row at a quarter of the weight say what one says."""
    one, four = linear(), linear(0.25)
    repeated = Measurement(**{name: np.repeat(value, 4, axis=0) if isinstance(value, np.ndarray) else value
                              for name, value in vars(four.measurement).items()})
    slopes = np.repeat(SLOPES, 4, axis=0)

    class Copies(Linear):
        def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
            return Prediction(point, slopes[:, :len(point.z)] @ point.z)

        @property
        def courses(self) -> Array:
            return np.zeros((4 * COUNT, 0))

    tables = [search_of(own, ["viscous"]).evidence(frozenset({"viscous"}), laws=frozenset()).table[0]
              for own in (one, Copies(repeated))]
    assert tables[1] - tables[1][0] == pytest.approx(tables[0] - tables[0][0], abs=1e-8)


def test_the_choice_of_a_law_is_paid_and_intervals_hold():
    """A law chosen from several loses the logarithm of their number; the true slope lies in its interval."""
    free, paid = (search_of(linear(cost=cost), ["viscous"]) for cost in (0.0, np.log(8.0)))
    names = frozenset({"viscous"})
    tables = [one.evidence(names, frozenset()).table for one in (free, paid)]
    assert tables[0] - tables[1] == pytest.approx(np.log(8.0))
    slope = next(one for one in estimates(free, names) if one.name == "viscous.slope")
    assert slope.low < 1.5 < slope.high
    assert slope.high - slope.low < 0.8
    assert 0.0 < smallest_visible(free)["viscous"] < 1.0
