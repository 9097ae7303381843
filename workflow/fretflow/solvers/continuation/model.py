"""A model of one coordinate on its contact that is cheap to solve, and how its defect is corrected.

To make R(y) = 0, whose derivative is dear, a model R_m close to it is solved instead, and its defect corrected
(K. Boehmer, P. Hemker and H. Stetter, The defect correction approach, 1984):

    R_m(y_(k+1)) = d_k,    d_k = R_m(y_k) - R(y_k)

Differences of former iterates extrapolate d (D. G. Anderson, J. ACM 12 (1965)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.quasi_static.backbone import Backbone, newton_across_kinks
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.sample import Array

SMALL = 1e-9  # m, the scale of an arm at rest
FORMER = 10  # iterates, also of the points before, that extrapolate the defect
DISTINCT = 0.01  # changes of the residual that differ by less are one


@dataclass(frozen=True)
class Plane:
    """The points y with ``row . (y - unknowns) / scales = 0``."""

    unknowns: Array
    row: Array
    scales: Array

    @classmethod
    def of_frequency(cls, omega: float, arm: Array) -> Plane:
        """Return the plane of one frequency (rad/s); `arm` is the guess on it."""
        row = np.zeros(len(arm) + 1)
        row[-1] = 1.0
        return cls(np.append(arm, omega), row, np.append(np.full(len(arm), max(float(np.linalg.norm(arm)), SMALL)),
                                                          omega))

    def distance(self, y: Array) -> float:
        """Return how far y is off the plane, in scaled unknowns."""
        return float(self.row @ ((y - self.unknowns) / self.scales))

    def solver(self, matrix: Array) -> Callable[[Array], Array]:
        """Return what takes a residual to how far it is off within the plane, in scaled unknowns.

        `matrix` (2 H + 1, 2 H + 2) is the residual's derivative.
        """
        factors = lu_factor(np.vstack([matrix * self.scales, self.row]))
        return lambda residual: np.asarray(lu_solve(factors, np.append(residual, 0.0)))


@dataclass(frozen=True)
class Secants:
    """Changes of the defect and of the residual from iterate to iterate, (2 H + 1, m) each, scaled by the latter's."""

    defects: Array
    residuals: Array

    @classmethod
    def none(cls, size: int) -> Secants:
        """Return no changes of residuals (size,)."""
        return cls(np.zeros((size, 0)), np.zeros((size, 0)))

    def forgotten(self) -> Secants:
        """Return no changes."""
        return self.none(len(self.residuals))

    def with_pair(self, defect: Array, residual: Array) -> Secants:
        """Return the last changes and these, (2 H + 1,) each."""
        size = max(float(np.linalg.norm(residual)), float(np.finfo(float).tiny))
        return Secants(np.column_stack([self.defects, defect / size])[:, -FORMER:],
                       np.column_stack([self.residuals, residual / size])[:, -FORMER:])

    def extrapolate(self, defect: Array, residual: Array) -> Array:
        """Return the defect where the residual is expected to be smallest."""
        share = np.linalg.lstsq(self.residuals, residual, rcond=DISTINCT)[0]
        return np.asarray(defect - self.defects @ share)


@dataclass(frozen=True)
class OnBackbone:
    """One linear coordinate on a backbone instead of the contact."""

    backbone: Backbone
    excitation: float

    def residual(self, equations: InternalEquations, arm: Array) -> Array:
        """Return R_m (2 H + 1,) in N."""
        e = equations
        friction, _ = self.backbone.friction(e.synthesis @ arm, np.zeros((len(e.synthesis), 0)))
        return np.asarray(e.impedance @ arm - e.load - e.analysis @ friction)

    def solve(self, equations: Callable[[float], InternalEquations], defect: Array, plane: Plane, guess: Array,
              tolerance: float) -> Array:
        """Return y with ``R_m(y) = defect`` on `plane`.

        `equations` are those of a frequency in rad/s; `tolerance` is relative to the excitation.

        Raises
        ------
        NonConvergenceError
            If the root is not found.
        """
        def evaluate(scaled: Array) -> tuple[Array, Array]:
            y = plane.scales * scaled
            if not y[-1] > 0.0:
                raise NonConvergenceError("forced response: the frequency would not be positive")
            e = equations(float(y[-1]))
            friction, tangent = self.backbone.friction(e.synthesis @ y[:-1], e.synthesis)
            residual = e.impedance @ y[:-1] - e.load - e.analysis @ friction - defect
            by_omega, load_by_omega = e.rates()
            matrix = np.column_stack([e.impedance - e.analysis @ tangent, by_omega @ y[:-1] - load_by_omega])
            return (np.append(residual / self.excitation, plane.distance(y)),
                    np.vstack([matrix * plane.scales / self.excitation, plane.row]))

        return plane.scales * newton_across_kinks(evaluate, guess / plane.scales, tolerance)

