"""The most probable parameters of a hypothesis, and its evidence.

With whitened residual r(z) and coordinates z that are standard normal beforehand, ``|r|^2 + |z|^2`` is minimised by
Gauss-Newton, each Jacobian from one march of the simulated periods. A step that makes the fit worse is damped
(D. W. Marquardt, J. Soc. Ind. Appl. Math. 11 (1963) 431-441). Laplace's approximation gives the evidence::

    log Z = -(|r|^2 + |z|^2) / 2 - log det(1 + J^T J) / 2
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.experiments.rig.coordinates import FARTHEST, Space
from fretflow.experiments.rig.model import FINE, RigModel, Simulation
from fretflow.experiments.rig.observation import Array
from fretflow.experiments.rig.tangent import neighbours
from fretflow.inference.covariance import Covariance

STEP = 0.02  # of a coordinate, for derivatives
LONGEST = 1.5  # step of a coordinate at once
# fall of the objective, and share of it, that are not worth another simulation
ENOUGH, ENOUGH_SHARE = 2.0, 0.005
DAMPINGS = (0.0, 0.01, 0.1, 1.0, 10.0, 100.0)  # of a step, tried in turn until one improves the fit
FAR = 4.0  # times what another hypothesis reaches, from which a start leads nowhere


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its most probable parameters."""

    space: Space
    z: Array
    simulation: Simulation
    predicted: Array
    residual: Array  # whitened
    jacobian: Array  # (M, P) of the vector, in SI, by z
    whitened_jacobian: Array
    converged: bool

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

    @property
    def log_evidence(self) -> float:
        """Return log Z."""
        return -0.5 * self.objective - 0.5 * float(np.linalg.slogdet(self.information)[1])


@dataclass(frozen=True)
class Fitter:
    """Fits hypotheses of one rig to its observation; `correction` (M,) is what the coarse model leaves out."""

    rig: RigModel
    covariance: Covariance
    correction: Array

    def predict(self, simulation: Simulation) -> Array:
        """Return the vector (M,) of a simulation."""
        return self.rig.predict(simulation) + self.correction

    def fit(self, space: Space, z: Array, near: Simulation | None, iterations: int, worth: float = np.inf) -> Fit:
        """Return the most probable parameters from the start `z`.

        The search ends early where even the first-order prediction of its next step is above the objective `worth`,
        of the first one far above: a start may be a long way off.

        Raises
        ------
        NonConvergenceError
            If the start itself has no simulation.
        """
        now, first = self._at(space, z, near), 0
        for steps in range(iterations):
            expected = now.objective - self.promise(now)
            enough = max(ENOUGH, ENOUGH_SHARE * now.objective)
            if expected < enough:
                return _converged(now)
            if now.objective - expected > (worth if steps else FAR * worth):
                return now
            better, taken = self._improved(now, first)
            fell, now, first = now.objective - better.objective, better, max(0, taken - 1)
            if fell < enough:
                if taken and self.rig.wear_tolerance > FINE:
                    return self._finer().fit(space, now.z, now.simulation, iterations - steps, worth)
                return now if taken else _converged(now)
        return now

    def _finer(self) -> Fitter:
        return replace(self, rig=replace(self.rig, wear_tolerance=FINE))

    def promise(self, now: Fit) -> float:
        """Return the objective that the next step from a fit would reach if all were linear."""
        step = _step(now)
        return float(np.sum((now.residual - now.whitened_jacobian @ step)**2) + np.sum((now.z + step)**2))

    def _improved(self, now: Fit, first: int) -> tuple[Fit, int]:
        """Return the first better fit by the dampings from place `first` on, and its place; `now` if there is none."""
        for place in range(first, len(DAMPINGS)):
            z = np.clip(now.z + _step(now, DAMPINGS[place]), -FARTHEST, FARTHEST)
            try:
                simulation = self.rig.simulate(now.space.hypothesis(z), now.simulation)
            except NonConvergenceError:
                continue
            predicted = self.predict(simulation)
            residual = self.covariance.whiten(self.rig.observation.values - predicted)
            if float(residual @ residual + z @ z) < now.objective:
                return self._linearised(now.space, z, simulation, predicted, residual), place
        return now, len(DAMPINGS)

    def _at(self, space: Space, z: Array, near: Simulation | None) -> Fit:
        simulation = self.rig.simulate(space.hypothesis(z), near)
        predicted = self.predict(simulation)
        residual = self.covariance.whiten(self.rig.observation.values - predicted)
        return self._linearised(space, np.asarray(z, dtype=float), simulation, predicted, residual)

    def _linearised(self, space: Space, z: Array, simulation: Simulation, predicted: Array, residual: Array) -> Fit:
        moved = neighbours(self.rig, simulation, space.beside(z, STEP))
        ways = np.where(z <= 0.0, STEP, -STEP)
        jacobian = np.nan_to_num(moved) / ways
        return Fit(space, z, simulation, predicted, residual, jacobian, self.covariance.whiten(jacobian), False)


def _step(now: Fit, damping: float = 0.0) -> Array:
    """Return the Gauss-Newton step, damped by Marquardt's rule.

    No coordinate goes further than `LONGEST`, and none beyond its limit.
    """
    curved = now.information * (1.0 + damping * np.eye(len(now.z)))
    slope = now.whitened_jacobian.T @ now.residual - now.z
    free = ~((np.abs(now.z) >= FARTHEST) & (np.sign(slope) == np.sign(now.z)))
    step = np.zeros(len(now.z))
    for _ in range(len(step)):
        own = np.flatnonzero(free)
        if not len(own):
            break
        step = np.zeros(len(step))
        step[own] = np.linalg.solve(curved[np.ix_(own, own)], slope[own])
        step *= min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-300))
        beyond = free & (np.abs(now.z + step) > FARTHEST) & (np.abs(now.z) >= FARTHEST)
        if not beyond.any():
            break
        free &= ~beyond
    return step


def _converged(fit: Fit) -> Fit:
    return Fit(fit.space, fit.z, fit.simulation, fit.predicted, fit.residual, fit.jacobian, fit.whitened_jacobian, True)
