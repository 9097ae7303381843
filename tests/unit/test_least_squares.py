"""The search for the most probable parameters, on models that are curved or that their own errors make rough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.inference.experiment import Point, Prediction
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
