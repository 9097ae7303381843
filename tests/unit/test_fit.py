"""The search for the most probable parameters, on models that are curved or that their own errors make rough."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.experiments.rig import fit as fitting
from fretflow.experiments.rig.fit import Fitter
from fretflow.experiments.rig.model import WEAR_TOLERANCE

TRUE = np.array([1.0, 1.0])
SD = 0.05


@dataclass(frozen=True)
class Valley:
    """Rosenbrock's valley as a model, ``(z0, 3 (z1 - z0^2))``, with ripples of a size beside the wear tolerance."""

    ripple: float = 0.0
    wear_tolerance: float = WEAR_TOLERANCE
    bend: float = 3.0

    @property
    def observation(self) -> Any:
        """Return what is measured at `TRUE`."""
        return SimpleNamespace(values=self.smooth(TRUE))

    def smooth(self, z: np.ndarray) -> np.ndarray:
        """Return the exact model's values (2,)."""
        return np.array([z[0], self.bend * (z[1] - z[0]**2)])

    def simulate(self, z: np.ndarray, near: Any) -> np.ndarray:
        """Return the point itself."""
        return z

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Return the values with the ripples."""
        rough = self.ripple * self.wear_tolerance / WEAR_TOLERANCE
        return self.smooth(z) + rough * np.array([np.sin(400.0 * z[1]), np.sin(900.0 * z[0])])


@dataclass(frozen=True)
class Plane:
    """Two coordinates that are parameters."""

    size: int = 2

    def hypothesis(self, z: np.ndarray) -> np.ndarray:
        """Return the parameters."""
        return z

    def beside(self, z: np.ndarray, step: float) -> list[np.ndarray]:
        """Return the points beside `z`, towards the middle."""
        return [z + np.where(z[k] <= 0.0, step, -step) * np.eye(2)[k] for k in range(2)]


def fitter(rig: Valley, monkeypatch: pytest.MonkeyPatch) -> Fitter:
    """Return the fitter of a valley; its derivatives are those of the exact model."""
    monkeypatch.setattr(fitting, "neighbours", lambda rig, at, beside: np.column_stack([
        rig.smooth(one) - rig.smooth(at) for one in beside]))
    covariance: Any = SimpleNamespace(whiten=lambda values: values / SD)
    model: Any = rig
    return Fitter(model, covariance, np.zeros(2))


def found(rig: Valley, monkeypatch: pytest.MonkeyPatch) -> fitting.Fit:
    """Return the fit from the other side of the valley, by 60 steps at most."""
    plane: Any = Plane()
    return fitter(rig, monkeypatch).fit(plane, np.array([-1.2, 1.0]), None, 60)


def test_a_bent_valley_is_followed_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole Gauss-Newton steps leave the valley; damped ones stay in it."""
    end = found(Valley(), monkeypatch)
    assert end.converged
    assert end.z == pytest.approx(TRUE, abs=0.05)
    assert end.chi_squared < 1.0


def test_what_steps_of_wear_make_rough_is_fitted_with_finer_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ripples of several sd stop the fit; those of a tenth of the tolerance do not."""
    end = found(Valley(ripple=0.3), monkeypatch)
    assert end.z == pytest.approx(TRUE, abs=0.1)
    assert end.chi_squared < 5.0
    monkeypatch.setattr(fitting, "FINE", WEAR_TOLERANCE)
    assert found(Valley(ripple=0.3), monkeypatch).chi_squared > 20.0
