"""The most probable parameters of a hypothesis: the one estimator of all experiments.

With whitened residual r(z) and coordinates z that are standard normal beforehand, ``|r|^2 + |z|^2`` is minimised by
Gauss-Newton. A step that makes the fit worse is damped (D. W. Marquardt, J. Soc. Ind. Appl. Math. 11 (1963) 431-441).
Derivatives that told what a step would bring are carried on by its secant (C. G. Broyden, Math. Comput. 19 (1965)
577-593); where these bring a fit to rest, its last step is by derivatives made there.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fretflow.core.errors import NonConvergenceError
from fretflow.inference.experiment import Covariance, Experiment, Point, Prediction, jacobian
from fretflow.inference.parameters import FARTHEST, HALF, Array, Parameters

# Fall of the objective that is not worth another prediction: a factor e in probability, "not worth more than a bare
# mention" (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795).
ENOUGH = 2.0
# Of a fall: what told as much is right about there, a quarter is too little (R. Fletcher, Practical Methods of
# Optimization (1980), 5.1)
TOLD = 0.75
# Of a step, tried in turn by Marquardt's factor of ten until one improves the fit: from one that leaves the step as it
# is to one that leaves a hundredth of it.
DAMPINGS = (0.0, 0.01, 0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its most probable parameters."""

    prediction: Prediction
    residual: Array  # whitened
    jacobian: Array  # (M, P) of the prediction, in SI, by z
    whitened_jacobian: Array
    converged: bool
    provisional: bool = False  # whether the derivatives are those of where it was begun
    secant: bool = False  # whether they were carried on by secants since they were made
    damping: int = 0  # place in `DAMPINGS` that the next step is first tried with

    @property
    def parameters(self) -> Parameters:
        """Return the hypothesis's coordinates."""
        return self.prediction.point.parameters

    @property
    def z(self) -> Array:
        """Return the coordinates (P,) of the fit."""
        return self.prediction.point.z

    @property
    def effects(self) -> frozenset[str]:
        """Return the hypothesis's effects."""
        return self.prediction.point.effects

    @property
    def held(self) -> NDArray[np.bool_]:
        """Return which coordinates (P,) stand at a limit of what a parameter may be, which nothing draws them from."""
        return np.asarray(_at_limits(self.prediction.point) & ~self.jacobian.any(axis=0))

    @property
    def predicted(self) -> Array:
        """Return the predicted values (M,)."""
        return self.prediction.values

    @property
    def chi_squared(self) -> float:
        """Return ``|r|^2``."""
        return float(self.residual @ self.residual)

    @property
    def objective(self) -> float:
        """Return ``|r|^2 + |z|^2``."""
        return self.chi_squared + float(self.z @ self.z)

    @property
    def information(self) -> Array:
        """Return ``1 + J^T J``, the inverse of the coordinates' covariance afterwards."""
        return np.asarray(np.eye(len(self.z)) + self.whitened_jacobian.T @ self.whitened_jacobian)

    @cached_property
    def promise(self) -> float:
        """Return the objective that the next step would reach if all were linear."""
        step = _step(self)
        return float(np.sum((self.residual - self.whitened_jacobian @ step)**2) + np.sum((self.z + step)**2))


@dataclass(frozen=True)
class Fitter:
    """Fits hypotheses of an experiment under a covariance of its errors."""

    experiment: Experiment
    covariance: Covariance
    secants: bool = False  # whether derivatives that told what a step would bring are carried on

    def fit(self, point: Point, near: Prediction | None, iterations: int = sys.maxsize, slopes: Array | None = None,
            secant: bool = False, damping: int = 0) -> Fit:
        """Return the most probable parameters from a start, by so many steps at most; each is worth `ENOUGH`.

        The derivatives there, (M, P) in SI, are made where they are not known, if by secants alone. Steps are damped as
        those before were, the first one by `damping`, and a place less (Marquardt's rule).

        Raises
        ------
        NonConvergenceError
            If the start itself has no solution.
        """
        now = replace(self.linearised(self.experiment.predict(point, near), slopes), secant=secant, damping=damping)
        for steps in range(iterations):
            if now.secant and now.objective - now.promise < ENOUGH:
                better, _ = self._improved(self.linearised(now.prediction))
                now = self.linearised(better.prediction) if better.secant else replace(better, damping=0)
            if now.objective - now.promise < ENOUGH:
                return replace(now, converged=True, damping=0)
            better, taken = self._improved(now)
            if now.secant and now.objective - better.objective < ENOUGH:
                now = self.linearised(better.prediction)
                continue
            fell, now = now.objective - better.objective, replace(better, damping=max(0, taken - 1))
            if fell < ENOUGH:
                finer = self.experiment.finer()
                if taken and finer is not None:
                    with suppress(NonConvergenceError):  # where finer steps have no solution, the coarse ones' stays
                        return replace(self, experiment=finer).fit(now.prediction.point, now.prediction,
                                                                   iterations - steps)
                return replace(now, converged=True, damping=0)
        return now

    def at(self, point: Point, near: Prediction | None) -> Fit:
        """Return a hypothesis where it stands, not fitted."""
        return self.linearised(self.experiment.predict(point, near))

    def linearised(self, prediction: Prediction, slopes: Array | None = None) -> Fit:
        """Return a prediction with its residual and derivatives, (M, P) in SI where they are known about.

        There is none by what stands at a limit and is drawn beyond.
        """
        by_z = jacobian(self.experiment, prediction) if slopes is None else slopes
        residual = self.covariance.whiten(self.experiment.measurement.values - prediction.values)
        white, z = self.covariance.whiten(by_z), prediction.point.z
        outward = _at_limits(prediction.point) & (np.sign(z) * (white.T @ residual - z) > 0.0)
        if outward.any():
            by_z, white = (np.where(outward, 0.0, one) for one in (by_z, white))
        return Fit(prediction, residual, by_z, white, False)

    def _improved(self, now: Fit) -> tuple[Fit, int]:
        """Return a better fit by the dampings from its own on, and that one's place; `now` if none is.

        It is the first that falls by a quarter of what it told, as less is of a place too far off, else the best.
        """
        place, best, least, taken = now.damping, None, now.objective, len(DAMPINGS)
        while place < len(DAMPINGS):
            step = _step(now, DAMPINGS[place])
            z = np.clip(now.z + step, *now.parameters.ends)
            try:
                prediction = self.experiment.predict(replace(now.prediction.point, z=z), now.prediction)
            except NonConvergenceError:  # half of the way may have a solution, and nearly all of it has none either
                place = max(place + 1, DAMPINGS.index(1.0))
                continue
            residual = self.covariance.whiten(self.experiment.measurement.values - prediction.values)
            objective = float(residual @ residual + z @ z)
            if objective < least:
                best, least, taken = prediction, objective, place
                told = now.residual - now.whitened_jacobian @ step
                if now.objective - objective >= (1.0 - TOLD) * (now.objective - float(told @ told + z @ z)):
                    break
            elif best is not None:
                break  # shorter steps are worse again
            place += 1
        if best is None:
            return now, taken
        return self._carried(now, replace(best, point=best.point.turned())), taken

    def _carried(self, now: Fit, prediction: Prediction) -> Fit:
        """Return a better prediction with derivatives: by a secant where those before told what it would bring."""
        if not self.secants or prediction.point.parameters != now.parameters:
            return self.linearised(prediction)
        moved = prediction.point.z - now.z
        missed = prediction.values - now.predicted - now.jacobian @ moved
        fit = self.linearised(prediction, now.jacobian + np.outer(missed, moved) / float(moved @ moved))
        told = now.residual - now.whitened_jacobian @ moved
        fall = now.objective - float(told @ told + fit.z @ fit.z)
        if now.objective - fit.objective >= TOLD * fall:
            return replace(fit, secant=True)
        return self.linearised(prediction)


def _step(now: Fit, damping: float = 0.0) -> Array:
    """Return the best step, damped by Marquardt's rule, of those that lead no coordinate further than may be.

    None goes further than half of its range at once, nor beyond its limit. What one may not do the others make good: a
    step shortened as a whole would wait for the one that goes farthest (P. B. Stark, R. L. Parker, Comput. Stat. 10
    (1995) 129-141).
    """
    step, free, ends = np.zeros(len(now.z)), ~now.held, now.parameters.ends
    if not free.any():
        return step
    z = now.z[free]
    least, most = (np.clip(np.clip(now.z, *ends) + way * HALF, *ends)[free] - z for way in (-1.0, 1.0))
    damped = np.diag(np.sqrt(damping * np.diag(now.information)[free]))
    turned, root = np.linalg.qr(np.vstack([now.whitened_jacobian[:, free], np.eye(len(z)), damped]))
    aimed = turned.T @ np.concatenate([now.residual, -z, np.zeros(len(z))])
    step[free] = lsq_linear(root, aimed, (least, most), method="bvls").x
    return step


def _at_limits(point: Point) -> NDArray[np.bool_]:
    """Return which coordinates (P,) stand at limits of what their parameters may be, not of how far any may go."""
    ends = point.parameters.ends
    return np.asarray(np.any((point.z == ends) & (np.abs(ends) < FARTHEST), axis=0))
