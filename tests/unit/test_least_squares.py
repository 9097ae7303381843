"""The search for the most probable parameters, on models that are curved or that their own errors make rough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.inference.experiment import Covariance, Point, Prediction, secants
from fretflow.inference.least_squares import Fit, Fitter

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


def found(valley: Valley) -> Fit:
    """Return the fit from the other side of the valley, by 60 steps at most."""
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane: Any = SimpleNamespace(effects=(), turned=lambda z: (plane, z))
    experiment: Any = valley
    return Fitter(experiment, covariance).fit(Point(plane, np.array([-1.2, 1.0])), None, 60)


def test_a_bent_valley_is_followed_to_its_end() -> None:
    """Whole Gauss-Newton steps leave the valley; damped ones stay in it."""
    end = found(Valley())
    assert end.converged
    assert end.z == pytest.approx(TRUE, abs=0.05)
    assert end.chi_squared < 1.0


def test_what_numerical_errors_make_rough_is_fitted_with_finer_ones() -> None:
    """Ripples of several sd stop the fit; those of a tenth do not."""
    end = found(Valley(ripple=0.3))
    assert end.z == pytest.approx(TRUE, abs=0.1)
    assert end.chi_squared < 5.0
    assert found(Valley(ripple=0.3, finest=ROUGH)).chi_squared > 20.0


def test_what_the_next_step_promises_is_reached_by_a_linear_model() -> None:
    """The Gauss-Newton step of a straight valley ends where its promise was."""
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    plane: Any = SimpleNamespace(effects=(), turned=lambda z: (plane, z))
    experiment: Any = replace(Valley(), bend=0.0)
    fitter = Fitter(experiment, covariance)
    start = fitter.at(Point(plane, np.array([0.5, 0.5])), None)
    assert fitter.fit(Point(plane, np.array([0.5, 0.5])), None, 1).objective == pytest.approx(start.promise)


PLACES = np.linspace(-1.0, 1.0, 41)


class Product:
    """Values that two coordinates make by their sum alone, with a kink, and jumps of a hundredth of the noise."""

    @property
    def measurement(self) -> Any:
        """Return errors of 0.1."""
        return SimpleNamespace(covariance=lambda: Covariance(np.full(41, 0.01), np.zeros((41, 0))))

    def predict(self, point: Point, near: Any = None) -> Prediction:
        """Return the values with the jumps."""
        return Prediction(point, np.maximum(PLACES + point.z.sum(), 0.0) + 1e-3 * np.sign(
            np.sin(900.0 * point.z[0] + 7.0 * PLACES)))


def test_what_the_measurement_leaves_open_is_not_closed_by_kinks_and_jumps() -> None:
    space: Any = SimpleNamespace(size=2)
    experiment: Any = Product()
    here = experiment.predict(Point(space, np.array([0.3, -0.3])))
    step = 0.02
    slopes = np.column_stack([experiment.predict(Point(space, here.point.z + way * own)).values - here.values
                              for way, own in zip((-1.0, 1.0), np.eye(2) * step, strict=True)]) / [-step, step]

    def sd(derivative: np.ndarray, way: np.ndarray) -> float:
        information = np.eye(2) + derivative.T @ derivative / 0.01
        return float(np.sqrt(way @ np.linalg.solve(information, way)))

    apart, together = np.array([1.0, -1.0]) / np.sqrt(2.0), np.array([1.0, 1.0]) / np.sqrt(2.0)
    found = secants(experiment, here, slopes)
    assert sd(slopes, apart) < 0.3  # the sum alone is told: one, as beforehand
    assert sd(found, apart) > 0.9
    exact = np.where(PLACES > 0.0, 1.0, 0.0)[:, None] * np.ones((1, 2))
    assert sd(found, together) == pytest.approx(sd(exact, together), rel=0.2)
