"""Parameters identified from measurements, with what these determine and what they leave open.

All parameters and measured values are positive, so the logarithms are worked with. With a prior
``ln p ~ N(ln p_0, s_0^2)`` per parameter and ``z = (ln p - ln p_0) / s_0``, the best z minimises::

    |(ln y(z) - ln y_m) / sd|^2 + |z|^2

At the minimum the scaled sensitivities ``J = d(ln y / sd) / dz`` have the singular values g and right singular
vectors v. A direction v of g >> 1 is known from the data, by the factor sqrt(1 + g^2) better than before; one of
g << 1 is not touched by them (likelihood-informed directions: Spantini et al., SIAM J. Sci. Comput. 37 (2015)).
Posterior covariance of z: ``(1 + J^T J)^-1``, linearised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array, quantity, record

DIFFERENCE = 0.01  # of ln p: above the noise of a sampled period, below its curvature
TOLERANCE = 1e-6  # relative change of objective or coordinates at which to stop
TRUST = 3.0  # prior standard deviations that a parameter may move
MAX_ROUNDS = 20
SETTLED = 0.05  # standard deviations
LARGEST_CORRECTION = 5.0  # of ln y
DETERMINED = 1.0 / 3.0  # posterior over prior standard deviation, below which a parameter counts as determined
TWO_SIDED_95 = 1.959964  # of the normal distribution
SMALL_EXPONENT = 0.05


@record
class LogNormalPrior:
    """What is known of the parameters beforehand: ``ln p ~ N(ln value, ln(factor)^2)``."""

    names: tuple[str, ...]
    value: Array = quantity("SI", "(P,)")
    factor: Array = quantity("1", "(P,), one standard deviation up or down")

    def check(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            If a value is not positive or a factor not above 1.
        """
        if not (np.all(self.value > 0.0) and np.all(self.factor > 1.0)):
            raise InputError("prior: values must be positive and factors above 1")

    def parameters(self, z: Array) -> Array:
        """Return the parameters (P,) at the normalised coordinates `z` (P,)."""
        return np.asarray(self.value * self.factor**z)

    def coordinates(self, parameters: Array) -> Array:
        """Return the normalised coordinates (P,) of `parameters` (P,)."""
        return np.asarray(np.log(parameters / self.value) / np.log(self.factor))


@record
class Data:
    """Measured values with their relative standard deviations."""

    names: tuple[str, ...]
    value: Array = quantity("SI", "(D,)")
    relative_sd: Array = quantity("1", "(D,)")

    def check(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            If a value or a standard deviation is not positive.
        """
        if not (np.all(self.value > 0.0) and np.all(self.relative_sd > 0.0)):
            raise InputError("measured values and their standard deviations must be positive")


@record
class Identification:
    """The most probable parameters and how far the data determine them."""

    prior: LogNormalPrior
    data: Data
    value: Array = quantity("SI", "(P,)")
    predicted: Array = quantity("SI", "(D,)")
    covariance: Array = quantity("1", "(P, P), of ln p")
    strength: Array = quantity("1", "(min(D, P),), singular values g, descending")
    directions: Array = quantity("1", "(min(D, P), P), exponents of ln p, largest 1")
    direction_sd: Array = quantity("1", "(min(D, P),), posterior sd of ln of that product")

    @property
    def deviation(self) -> Array:
        """Return (D,) how many standard deviations each prediction is off."""
        return np.asarray(np.log(self.predicted / self.data.value) / self.data.relative_sd)

    @property
    def shrinkage(self) -> Array:
        """Return (P,) posterior over prior standard deviation: 1 where the data say nothing."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) / np.log(self.prior.factor))

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Return (P,) whether the data determine a parameter by itself."""
        return np.asarray(self.shrinkage < DETERMINED)

    @property
    def interval(self) -> tuple[Array, Array]:
        """Return the 95 % bounds (P,) of each parameter, linearised in its logarithm."""
        spread = np.exp(TWO_SIDED_95 * np.sqrt(np.diag(self.covariance)))
        return self.value / spread, self.value * spread

    @property
    def product_interval(self) -> tuple[Array, Array]:
        """Return the 95 % bounds (min(D, P),) of each product of powers, over its value."""
        spread = np.exp(TWO_SIDED_95 * self.direction_sd)
        return 1.0 / spread, spread

    def product(self, index: int) -> str:
        """Return direction `index` as a product of powers, such as ``moving_mass * damping_ratio^-0.21``."""
        terms = zip(self.prior.names, self.directions[index], strict=True)
        return " * ".join(name if np.isclose(power, 1.0, atol=5e-3) else f"{name}^{power:.2g}"
                          for name, power in terms if abs(power) >= SMALL_EXPONENT)


def identify(forward: Callable[[Array], Array], prior: LogNormalPrior, data: Data,
             starts: Sequence[Array] = ()) -> Identification:
    """Find the parameters that meet the data best.

    Parameters
    ----------
    forward : callable
        From parameters (P,) to predictions (D,), positive both.
    prior, data : LogNormalPrior, Data
    starts : sequence of ndarray, shape (P,)
        Parameters to start from; the best of them by the objective is taken. By default the prior's.
    """
    def residual(z: Array) -> Array:
        predicted = np.maximum(forward(prior.parameters(z)), np.finfo(float).tiny)
        return np.concatenate([np.log(predicted / data.value) / data.relative_sd, z])

    def jacobian(z: Array) -> Array:
        steps, here = DIFFERENCE / np.log(prior.factor), residual(z)
        columns = [(residual(z + h * e) - here) / h for h, e in zip(steps, np.eye(len(z)), strict=True)]
        return np.column_stack(columns)

    inside = 0.99 * TRUST
    points = [np.clip(prior.coordinates(start), -inside, inside) for start in starts or (prior.value,)]
    best = min(points, key=lambda z: float(np.sum(residual(z)**2)))
    fit = least_squares(residual, best, jac=jacobian, bounds=(-TRUST, TRUST), xtol=TOLERANCE,
                        ftol=TOLERANCE, gtol=TOLERANCE)
    best = np.asarray(fit.x)
    return _judge(best, jacobian(best)[:len(data.value)], forward, prior, data)


def identify_mapped(exact: Callable[[Array], Array], rough: Callable[[Array], Array], prior: LogNormalPrior, data: Data,
                    starts: Sequence[Array] = ()) -> Identification:
    """Find the parameters that meet the data best by a costly `exact` model, led by a cheap `rough` one.

    Output space mapping (Bandler et al., IEEE Trans. Microwave Theory Tech. 52 (2004)): the rough model is identified,
    corrected so that ``ln y`` is the exact one at the last parameters, and by Broyden's rule its change since the ones
    before; then again, until the prediction holds. The predictions are the exact model's in the end, the
    sensitivities the corrected model's.

    Raises
    ------
    NonConvergenceError
        If the predictions do not come to hold; the history is their error in standard deviations.
    """
    shift: Array = np.zeros(len(data.value))
    slope: Array = np.zeros((len(data.value), len(prior.value)))
    anchor: Array = np.zeros(len(prior.value))
    history: list[float] = []

    def corrected(p: Array) -> Array:
        correction = shift + slope @ (prior.coordinates(p) - anchor)
        return np.asarray(rough(p) * np.exp(np.clip(correction, -LARGEST_CORRECTION, LARGEST_CORRECTION)))

    for _ in range(MAX_ROUNDS):
        fit = identify(corrected, prior, data, starts)
        predicted, here = exact(fit.value), prior.coordinates(fit.value)
        miss, step = np.log(predicted / fit.predicted), here - anchor
        history.append(float(np.abs(miss / data.relative_sd).max()))
        if history[-1] < SETTLED:
            return replace(fit, predicted=predicted)
        # the rough model is wrong where it is anchored first, by its level and not by its slope
        if len(history) > 1 and step @ step > 0.0:
            slope = slope + np.outer(miss, step) / (step @ step)
        shift, anchor, starts = np.log(predicted / rough(fit.value)), here, [fit.value]
    raise NonConvergenceError(f"calibration: predictions still miss by {history[-1]:.2g} standard deviations after "
                              f"{MAX_ROUNDS} rounds; state larger standard deviations of what was measured", history)


def _judge(z: Array, scaled: Array, forward: Callable[[Array], Array], prior: LogNormalPrior,
           data: Data) -> Identification:
    """Return what the scaled sensitivities (D, P) say at the optimum `z`."""
    spread = np.log(prior.factor)
    _, strength, vectors = np.linalg.svd(scaled, full_matrices=False)
    # v^T z has the prior sd 1; as a product of powers of p its exponents are v / spread, scaled to a largest 1
    exponents = vectors / spread
    largest = exponents[np.arange(len(exponents)), np.abs(exponents).argmax(axis=1)]
    covariance: Array = np.asarray(np.linalg.inv(np.eye(len(z)) + scaled.T @ scaled), dtype=float)
    return Identification(
        prior=prior, data=data, value=prior.parameters(z), predicted=forward(prior.parameters(z)),
        covariance=covariance * np.outer(spread, spread), strength=strength, directions=exponents / largest[:, None],
        direction_sd=1.0 / (np.sqrt(1.0 + strength**2) * np.abs(largest)))
