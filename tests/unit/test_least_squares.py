"""The search for the most probable parameters, on models that are curved or that their own errors make rough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.least_squares import Fit, Fitter, _step
from fretflow.inference.parameters import FARTHEST, HALF, Coordinate, Parameters
from fretflow.inference.search import FAST, Search
from fretflow.inference.strategy import to_rest
from waves import BASELINE, Waves, cosine, measurement, wave

TRUE = np.array([1.0, 1.0])
SD = 0.05
ROUGH, FINE = 1.0, 0.1


@dataclass(frozen=True)
class Valley:
    """Rosenbrock's valley as an experiment, ``(z0, 3 (z1 - z0^2))``, with ripples that finer solutions make smaller."""

    ripple: float = 0.0
    tolerance: float = ROUGH
    finest: float = FINE
    bend: float = 3.0

    @property
    def measurement(self) -> Any:
        """Return what is measured at `TRUE`."""
        return SimpleNamespace(values=self.smooth(TRUE))

    def smooth(self, z: np.ndarray) -> np.ndarray:
        """Return the exact model's values (2,)."""
        return np.array([z[0], self.bend * (z[1] - z[0]**2)])

    def predict(self, point: Point, near: Any = None) -> Prediction:
        """Return the values with the ripples."""
        z, rough = point.z, self.ripple * self.tolerance
        return Prediction(point, self.smooth(z) + rough * np.array([np.sin(400.0 * z[1]), np.sin(900.0 * z[0])]))

    def changes(self, prediction: Prediction, points: Any) -> np.ndarray:
        """Return those of the exact model."""
        return np.column_stack([self.smooth(one.z) - self.smooth(prediction.point.z) for one in points])

    def finer(self) -> Valley | None:
        """Return the same with smaller ripples."""
        return replace(self, tolerance=self.finest) if self.tolerance > self.finest else None

    def corrected(self, prediction: Prediction) -> None:
        """Return nothing."""


def plane_of_coordinates() -> Any:
    """Return two coordinates without effects, which may go as far as any."""
    far = FARTHEST * np.ones(2)
    plane: Any = SimpleNamespace(effects=(), turned=lambda z: (plane, z), ends=np.array([-far, far]))
    return plane


def fit_of(valley: Valley, secants: bool = False, start: tuple[float, float] = (-1.2, 1.0)) -> Fit:
    """Return the fit from a start, on the other side of the valley by default, by 60 steps at most."""
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    experiment: Any = valley
    return Fitter(experiment, covariance, secants).fit(Point(plane, np.array(start)), None, 60)


def test_a_bent_valley_is_followed_to_its_end() -> None:
    """Whole Gauss-Newton steps leave the valley; damped ones stay in it."""
    end = fit_of(Valley())
    assert end.converged
    assert end.z == pytest.approx(TRUE, abs=0.05)
    assert end.chi_squared < 1.0


@dataclass(frozen=True)
class Lost(Valley):
    """A valley that finer steps do not find."""

    def predict(self, point: Point, near: Any = None) -> Prediction:
        """Return the values with the ripples, where steps are coarse."""
        if self.tolerance == self.finest:
            raise NonConvergenceError("lost")
        return super().predict(point, near)


def test_where_finer_steps_have_no_solution_the_fit_with_coarse_ones_stays() -> None:
    assert fit_of(Lost(ripple=0.3)).z == pytest.approx(fit_of(Valley(ripple=0.3, finest=ROUGH)).z)


def test_what_numerical_errors_make_rough_is_fitted_with_finer_ones() -> None:
    """Ripples of several sd stop the fit from three starts of five; those of a tenth from hardly any."""
    starts = [tuple(one) for one in 1.5 * np.random.default_rng(1).standard_normal((40, 2))]
    fine, rough = (sum(fit_of(Valley(ripple=0.3, finest=finest), start=one).chi_squared < 5.0 for one in starts)
                   for finest in (FINE, ROUGH))
    assert fine >= 36
    assert rough <= 24


def stands(z: np.ndarray, slopes: np.ndarray, residual: np.ndarray) -> Any:
    """Return what a step is told of where a fit stands, none of its coordinates at a limit."""
    far = FARTHEST * np.ones(len(z))
    return SimpleNamespace(z=z, whitened_jacobian=slopes, residual=residual, held=np.zeros(len(z), dtype=bool),
                           information=np.eye(len(z)) + slopes.T @ slopes,
                           parameters=SimpleNamespace(ends=np.array([-far, far])))


def test_a_step_is_the_best_of_those_that_lead_nothing_too_far() -> None:
    """Where the quadratic model is least in a box, its slope is zero along what is free and points out of the box."""
    rng, held = np.random.default_rng(2), 0
    for _ in range(100):
        size = rng.integers(1, 12)
        z = np.clip(3.0 * rng.standard_normal(size), -FARTHEST, FARTHEST)
        slopes, residual = rng.standard_normal((40, size)) * 10.0**rng.uniform(-2.0, 2.0, size), rng.standard_normal(40)
        now: Any = stands(z, slopes, 10.0 * residual)
        step = _step(now)
        least, most = (np.clip(z + way * HALF, -FARTHEST, FARTHEST) - z for way in (-1.0, 1.0))
        assert np.all((step >= least - 1e-9) & (step <= most + 1e-9))
        slope = (now.information @ step - slopes.T @ now.residual + z) / np.sqrt(np.diag(now.information))
        at_least, at_most = step < least + 1e-9, step > most - 1e-9
        assert slope[~at_least & ~at_most] == pytest.approx(0.0, abs=1e-6)
        assert np.all(slope[at_least] > -1e-6)
        assert np.all(slope[at_most] < 1e-6)
        held += np.count_nonzero(at_least | at_most)
    assert held > 50


@dataclass(frozen=True)
class Bent(Valley):
    """A saturating response of which nothing was measured, so that a whole step from one end leads to the other."""

    @property
    def measurement(self) -> Any:
        """Return nothing."""
        return SimpleNamespace(values=np.zeros(2))

    def smooth(self, z: np.ndarray) -> np.ndarray:
        """Return the exact model's values (2,)."""
        return np.array([np.tanh(3.0 * z[0]), z[1]])


def test_a_step_that_brings_less_than_a_quarter_of_what_it_told_is_tried_shorter() -> None:
    """Newton's step on tanh tells a fall to nothing, and from 1.08 ends nearly as high on the other side."""
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    fitter = Fitter(cast(Any, Bent()), covariance)
    start = fitter.at(Point(plane, np.array([0.36, 0.0])), None)

    def left(z: np.ndarray) -> float:
        return fitter.at(Point(plane, z), None).objective / start.objective

    assert start.promise < 1e-3 * start.objective
    assert 0.75 < left(start.z + _step(start)) < 1.0
    assert left(fitter.fit(start.prediction.point, None, 1).z) < 0.75


def test_a_step_along_slopes_that_are_alike_and_large_is_the_least_one() -> None:
    """Products of slopes of 1e9 leave nothing of a prior of one: the difference of two alike stays where it is."""
    slopes = 1e9 * np.outer(np.random.default_rng(3).standard_normal(40), [1.0, 1.0])
    z = np.array([0.5, -0.5])
    now: Any = stands(z, slopes, slopes @ [0.2, 0.2])
    assert _step(now) == pytest.approx(np.array([0.2, 0.2]) - z, abs=1e-3)


def test_what_the_next_step_promises_is_reached_by_a_linear_model() -> None:
    """The Gauss-Newton step of a straight valley ends where its promise was."""
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    experiment: Any = replace(Valley(), bend=0.0)
    fitter = Fitter(experiment, covariance)
    start = fitter.at(Point(plane, np.array([0.5, 0.5])), None)
    assert fitter.fit(Point(plane, np.array([0.5, 0.5])), None, 1).objective == pytest.approx(start.promise)


def test_where_a_step_has_no_solution_half_of_it_is_tried_next() -> None:
    """Nearly all of it would have none either."""
    tried: list[float] = []

    class Cliff(Valley):
        def predict(self, point: Point, near: Any = None) -> Prediction:
            tried.append(float(point.z[0]))
            if point.z[0] > 0.6:
                raise NonConvergenceError("beyond the cliff")
            return super().predict(point, near)

    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    experiment: Any = Cliff(bend=0.0)
    fit = Fitter(experiment, covariance).fit(Point(plane, np.array([0.0, 0.0])), None, 1)
    assert tried[1] > 0.6
    assert len(tried) == 3
    assert fit.z[0] == pytest.approx(0.5 * tried[1], rel=0.01)


def test_a_fit_that_goes_on_makes_no_derivatives_anew_where_it_stands() -> None:
    """Two fits of one step each are one of two, and the second differentiates at its end alone."""
    counted: list[Point] = []

    class Counting(Valley):
        def changes(self, prediction: Prediction, points: Any) -> np.ndarray:
            counted.append(prediction.point)
            return super().changes(prediction, points)

    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    experiment: Any = Counting()
    fitter, start = Fitter(experiment, covariance), Point(plane, np.array([-1.2, 1.0]))
    first, whole = fitter.fit(start, None, 1), fitter.fit(start, None, 2)
    counted.clear()
    second = fitter.fit(first.prediction.point, first.prediction, 1, first.jacobian)
    assert second.z == pytest.approx(whole.z, abs=1e-12)
    assert [one.z.tolist() for one in counted] == [second.z.tolist()]


def test_a_fit_by_single_steps_goes_the_way_of_one_of_many() -> None:
    """What damped a step damps the next one, also where another process goes on: nothing is tried twice."""
    seen: list[list[float]] = []

    class Counting(Valley):
        def predict(self, point: Point, near: Any = None) -> Prediction:
            seen.append(point.z.tolist())
            return super().predict(point, near)

    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane = plane_of_coordinates()
    experiment: Any = Counting()
    fitter, start = Fitter(experiment, covariance), Point(plane, np.array([-1.2, 1.0]))
    whole = fitter.fit(start, None, 8)
    at_once, seen[:] = list(seen), []
    part = fitter.fit(start, None, 1)
    for _ in range(7):
        part = fitter.fit(part.prediction.point, part.prediction, 1, part.jacobian, part.secant, part.damping)
    assert part.z == pytest.approx(whole.z, abs=1e-12)
    assert list(dict.fromkeys(map(tuple, seen))) == list(dict.fromkeys(map(tuple, at_once)))


@pytest.mark.parametrize("bend", [0.5, 3.0])
def test_derivatives_are_made_anew_where_they_told_too_little_and_where_a_fit_rests(bend: float) -> None:
    """Secants make the way in fewer derivatives than steps; both valleys' fits end where they should."""
    made: list[np.ndarray] = []
    seen: list[np.ndarray] = []

    class Counting(Valley):
        def changes(self, prediction: Prediction, points: Any) -> np.ndarray:
            made.append(prediction.point.z)
            return super().changes(prediction, points)

        def predict(self, point: Point, near: Any = None) -> Prediction:
            seen.append(point.z)
            return super().predict(point, near)

    end = fit_of(Counting(bend=bend), secants=True)
    assert end.converged
    assert not end.secant
    assert end.z == pytest.approx(TRUE, abs=0.05)
    np.testing.assert_array_equal(made[-1], end.z)
    assert len(made) < len(seen)


def test_a_fit_at_rest_is_known_as_such_when_a_process_returns_it() -> None:
    """A fit that came back at its own place, in a copy, says that it is at rest; a worse one says nothing."""
    fit = replace(fit_of(Valley()), converged=False)

    def returned(z: np.ndarray) -> bool:
        search: Any = SimpleNamespace(fits={fit.effects: fit}, fitters={}, fitter=SimpleNamespace(
            experiment=SimpleNamespace(has_made=lambda prediction: True)))
        point = Point(fit.prediction.point.parameters, z)
        Search.keep(search, [replace(fit, prediction=replace(fit.prediction, point=point), converged=True)])
        return bool(search.fits[fit.effects].converged)

    assert returned(fit.z.copy())
    assert not returned(2.0 * fit.z)


@pytest.mark.parametrize(("steps", "moved", "kept"), [
    ("fine", 0.1, True), ("fine", 1.0, False), ("coarse", 0.1, False)])
def test_a_fit_that_went_on_with_finer_steps_is_kept_where_it_was(steps: str, moved: float, kept: bool) -> None:
    """Though it leaves a little more, which coarse steps hid; of another place in its ranges a better one is known."""
    known = fit_of(Valley())
    at = replace(known.prediction.point, z=known.z + moved)
    own = replace(known, residual=known.residual + 0.1, prediction=replace(known.prediction, point=at, state=steps))
    search: Any = SimpleNamespace(fits={known.effects: known}, fitters={}, fitter=SimpleNamespace(
        experiment=SimpleNamespace(has_made=lambda prediction: prediction.state != "fine")))
    assert own.objective > known.objective
    Search.keep(search, [own])
    assert (search.fits[known.effects] is own) is kept


@pytest.mark.parametrize(("left", "fitted"), [(10.0, ["near"]), (19.0, ["near", "far"]), (1000.0, ["near", "far"])])
def test_where_one_effect_explains_all_hopeless_ones_are_not_fitted_to_rest(left: float, fitted: list[str]) -> None:
    """`left` of ten squares of noise, one of twenty such above 18.3; how probable an effect is shows at rest only."""
    asked: list[str] = []
    names = [frozenset({"near"}), frozenset({"far"})]
    search: Any = SimpleNamespace(
        fits={one: SimpleNamespace(converged=False, chi_squared=left, objective=left, promise=left) for one in names},
        baseline=SimpleNamespace(objective=np.inf),
        effort=SimpleNamespace(bases=2, last_steps=2), best=lambda size: names, promising=lambda sets: sets[:1],
        experiment=SimpleNamespace(measurement=SimpleNamespace(expected=10.0)),
        passes_for_noise=lambda own: Search.passes_for_noise(search, own),
        continue_fits=lambda sets, steps: asked.extend(one for own in sets for one in own))
    to_rest(search, 1)
    assert list(dict.fromkeys(asked)) == fitted


@dataclass(frozen=True)
class Limited(Waves):
    """Loops of a cosine with a wave whose height is its coordinate, of a parameter that may not be less than -1."""

    lowest: float = -1.0

    def parameters(self, effects: Any, signs: Any = None) -> Parameters:
        """Return the size of the cosine, and the wave's."""
        return Parameters(tuple(effects), (*BASELINE, Coordinate("viscous", "size", 0.0, 1.0, False, self.lowest)))


@pytest.mark.parametrize("height", [-2.0, -0.5])
@pytest.mark.parametrize("start", [-1.0, 0.5])
def test_a_parameter_ends_at_the_limit_of_what_it_may_be_and_leaves_it(height: float, start: float) -> None:
    """Beyond it nothing changed any more, and it stayed there and was told as if nothing were known of it."""
    experiment: Any = Limited(measurement(cosine() + 0.1 * cosine() + height * wave("viscous")), ("viscous",))
    point = Point(experiment.parameters(["viscous"]), np.array([0.0, start]))
    search = Search(experiment, lambda function, arguments: [function(one) for one in arguments], FAST)
    fit = search.fitter.fit(point, None)
    assert fit.converged
    assert fit.z[1] == pytest.approx(max(height, -1.0), abs=0.02)
    evidence = search.discrepancy.evidence(fit)
    mean, covariance = evidence.coordinates(np.full(evidence.table.shape, 1.0 / evidence.table.size))
    assert list(fit.held) == [False, height < -1.0]
    assert mean[1] == pytest.approx(fit.z[1], abs=0.05)
    assert (np.abs(covariance[1]).max() < 1e-12) == (height < -1.0)
