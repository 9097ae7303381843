"""Property: a baseline held in one minimum of the cost is found in a better one, along what is told least."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from fretflow.experiments.structure.run import begin_baselines, either, told_again
from fretflow.inference.experiment import Experiment, Measurement, Point, Prediction
from fretflow.inference.parameters import Coordinate, Parameters
from fretflow.inference.posterior import posterior
from fretflow.inference.search import FAST
from fretflow.inference.strategy import start_search
from waves import Waves, cosine, measurement

ROWS = 24
PLACE = np.linspace(0.0, 1.0, ROWS)
APART = 1.6  # of both coordinates, between the minima


@dataclass(frozen=True)
class Ridge(Experiment):
    """The sum of two coordinates is told well; their difference by a wave, which has minima, and a little by itself."""

    @cached_property
    def measurement(self) -> Measurement:
        """Return what the coordinates of `APART` beside zero would show, exactly."""
        return Measurement.of(
            self._values(np.array([0.5, -0.5]) * APART), np.ones(ROWS), code_error=np.full((ROWS, 1), 1e-6),
            channels=("values",), phase=0.5 * PLACE, groups=("all",))

    def parameters(self, effects: Any, signs: Any = None) -> Parameters:
        """Return both coordinates, in units of what is known of them beforehand."""
        return Parameters.of([Coordinate("", name, 0.0, 1.0, False) for name in ("first", "second")], effects, signs)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the values."""
        return Prediction(point, self._values(point.z))

    @staticmethod
    def _values(z: np.ndarray) -> np.ndarray:
        apart = z[0] - z[1]
        # of signs that change from row to row, as what is smooth counts as an error of the codes
        rough, other = (-1.0)**np.arange(ROWS), (-1.0)**(np.arange(ROWS) // 2)
        return 30.0 * z.sum() * other + rough * np.where(PLACE < 0.5, 3.0 * np.sin(np.pi * apart / APART), apart)

    def beginnings(self) -> list[Point]:
        """Return the middle alone, where a fit ends in the minimum there."""
        return [Point(self.parameters(()), np.zeros(2))]


def test_a_baseline_is_sought_beyond_the_minimum_in_which_it_begins():
    experiment: Any = Ridge()
    search = start_search(experiment, experiment.predict(experiment.beginnings()[0]), FAST,
                          lambda task, asked: [*map(task, asked)])
    assert abs(search.baseline.z[0] - search.baseline.z[1]) < 0.2 * APART
    begin_baselines(experiment, search)
    assert search.baseline.z[0] - search.baseline.z[1] == pytest.approx(APART, abs=0.1)


@dataclass(frozen=True)
class Told(Ridge):
    """The same, whose effects add a coordinate that does nothing, or are hopelessly far off."""

    asked: list[Point]
    matched: bool = True

    def parameters(self, effects: Any, signs: Any = None) -> Parameters:
        """Return both coordinates, and one of each effect."""
        both = [Coordinate("", name, 0.0, 1.0, False) for name in ("first", "second")]
        return Parameters(tuple(effects), (*both, *(Coordinate(name, "slope", 0.0, 1.0, False) for name in effects)))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the values; what is asked for is noted."""
        self.asked.append(point)
        return Prediction(point, self._values(point.z) + 1e3 * ("bending-gap" in point.effects) * (PLACE < 0.3))

    def candidates(self) -> tuple[str, ...]:
        """Return the effects."""
        return "joint-damping", "bending-gap"

    static, spacing = False, 1.0

    def readings(self) -> tuple[Told]:
        """Return the same."""
        return (self,)

    def told_at(self, prediction: Prediction) -> Told:
        """Return the same."""
        return self


def test_sets_that_are_hopeless_under_errors_told_anew_are_not_fitted_on():
    experiment: Any = Told(asked=[])
    here = Point(experiment.parameters(()), np.array([0.5, -0.5]) * APART)
    search = start_search(experiment, experiment.predict(here), FAST, lambda task, asked: [*map(task, asked)])
    for name in ("joint-damping", "bending-gap"):
        point = Point(experiment.parameters((name,)), np.r_[here.z, 1.0])
        search.keep([search.fitter.at(point, None)])
    experiment.asked.clear()
    _, again, _ = told_again(experiment, search)
    seen = [sum(name in point.effects for point in experiment.asked) for name in ("joint-damping", "bending-gap")]
    assert seen[0] > 3
    assert seen[1] == 2  # told where it stands, of matched matrices and of others, and no more
    assert again.fits[frozenset({"joint-damping"})].z[2] == pytest.approx(0.0, abs=1e-3)


@dataclass(frozen=True)
class Drawn(Told):
    """Levels about 1000 that are off by a share: matrices that are matched may be by 0.1 %, others by 2 %."""

    off: float = 0.0

    @cached_property
    def measurement(self) -> Measurement:
        """Return values of one level, with the matrices' error in common."""
        level = self._values(np.zeros(2))
        return replace(super().measurement, values=(1.0 + self.off) * level,
                       modes=(0.001 if self.matched else 0.02) * level[:, None])

    @staticmethod
    def _values(z: np.ndarray) -> np.ndarray:
        return 1000.0 + 50.0 * PLACE + Ridge._values(z)


@pytest.mark.parametrize("off", [0.0, 0.02])
def test_matrices_are_matched_to_the_parts_unless_the_level_is_far_off(off: float):
    """Errors of 2 % spread twenty times as far as those of 0.1 %, of which 2 % is twenty deviations."""
    experiment: Any = Drawn(asked=[], off=off)
    search = start_search(experiment, experiment.predict(experiment.beginnings()[0]), FAST,
                          lambda task, asked: [*map(task, asked)])
    told, _, ((other, _),) = told_again(experiment, search)
    assert told.matched is (off == 0.0)
    assert other == (pytest.approx(1.0 / 21.0, rel=0.2) if told.matched else pytest.approx(0.0, abs=0.02))


@dataclass(frozen=True)
class Bent(Told):
    """Values that bend as no parameter tells, and a mesh whose rough errors could take that up."""

    rough: float = 1e-3

    @cached_property
    def measurement(self) -> Measurement:
        """Return values that bend by thirty times their noise."""
        own = super().measurement
        return replace(own, values=30.0 + 30.0 * PLACE**2, code_error=self.rough * np.eye(ROWS))

    @staticmethod
    def _values(z: np.ndarray) -> np.ndarray:
        return 30.0 + z[0] + z[1] * PLACE

    def readings(self) -> tuple[Bent, ...]:
        """Return that of the matrices, and one on which every value may be anything."""
        return self, replace(self, rough=100.0)


def test_what_no_effect_does_is_no_error_of_another_mesh():
    experiment: Any = Bent(asked=[])
    here = Point(experiment.parameters(()), np.zeros(2))
    search = start_search(experiment, experiment.predict(here), FAST, lambda task, asked: [*map(task, asked)])
    told, *_ = told_again(experiment, search)
    assert told.rough == experiment.rough


@dataclass(frozen=True)
class Meshed(Bent):
    """The same, whose rough errors are those of a finer mesh."""

    spacing: float = 1.0
    or_finer: bool = False

    def readings(self) -> tuple[Bent, ...]:
        """Return that of the matrices, and that of the finer mesh, on which values may be anything to `rough` 100."""
        return self, replace(self, rough=self.rough * 1e5, spacing=0.0)

    def beginnings(self) -> list[Point]:
        """Return none: the baseline has one minimum."""
        return []

    def with_errors_at(self, prediction: Prediction) -> Meshed:
        """Return the same."""
        return self


@pytest.mark.parametrize(("rough", "noise"), [(1e-3, True), (1e-9, False)])
def test_what_a_finer_mesh_would_leave_nothing_of_is_said(rough: float, noise: bool):
    experiment: Any = Meshed(asked=[], rough=rough)
    here = Point(experiment.parameters(()), np.zeros(2))
    search = start_search(experiment, experiment.predict(here), FAST, lambda task, asked: [*map(task, asked)])
    told, *_ = told_again(experiment, search)
    assert told.spacing == 1.0
    assert told.or_finer is noise


@dataclass(frozen=True)
class Stated(Waves):
    """Loops of a cosine whose size is stated so well."""

    sd: float = 0.01

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the size of the cosine, and those of the effects."""
        return Parameters((), (Coordinate("", "friction", 0.0, self.sd, True),))


@pytest.mark.parametrize("sds", [(0.01, 1.0), (1.0, 0.01)])
def test_what_is_stated_and_what_is_free_share_as_their_densities_tell(sds: tuple[float, float]) -> None:
    """A value that was stated a hundred times as well, and is right, is a hundred times as probable."""
    searches = []
    for sd in sds:
        experiment: Any = Stated(measurement(cosine(), 1e-4), ("viscous",), sd)
        searches.append(start_search(experiment, experiment.predict(Point(experiment.parameters(()), np.zeros(1))),
                                     FAST, lambda function, arguments: [function(one) for one in arguments]))
    stated, free = ((one.experiment, one) for one in searches)
    _, search, ((share, known),) = either((*stated, []), (*free, []))
    assert search is searches[sds.index(0.01)]
    assert share == pytest.approx(1.0 / 101.0, rel=0.05)
    assert known.none == pytest.approx(posterior(search).none, abs=0.01)
