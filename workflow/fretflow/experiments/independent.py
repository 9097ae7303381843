"""What no law tells where rows have no common course: of each row alone, its size inferred.

A loop's rows differ from a model smoothly, and `evidence.Discrepancy` knows how. Residuals of a record over the plane
of motion, or of wear tests at scattered conditions, follow no such functions. Each row then has a value of its own of
the sd tau times the size of its channel, and counts by its weight w, one over the rows that are alike with it (a power
of the likelihood: C. C. Holmes, S. G. Walker, Biometrika 104 (2017) 497-503)::

    log p = -1/2 sum_i w_i (log v_i + r_i^2 / v_i),    v_i = sd_i^2 + tau^2 size^2
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from fretflow.inference.decision import estimate
from fretflow.inference.diagnosis import estimated
from fretflow.inference.evidence import FORMS, SIZES, Discrepancy, Evidence, code_size, size_prior, sizes
from fretflow.inference.experiment import Experiment, Point
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import HALF, Array, Coordinate
from fretflow.inference.posterior import visible
from fretflow.inference.search import Names, Search, basis
from fretflow.inference.verdict import Estimate

FREEDOM = 5  # squares from which a standard deviation is known to a third, 1 / sqrt(2 n)
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class IndependentDiscrepancy(Discrepancy):
    """The general discrepancy of rows that are independent; their weights are the measurement's `repeatable`."""

    def evidence(self, fit: Fit, formed: Array | None = None, chance: Array | None = None) -> Evidence:
        """Return the evidence of a fitted hypothesis, as `Discrepancy` does."""
        own, weight, sd = self.measurement, self.measurement.repeatable, np.sqrt(self.measurement.variance)
        size = sizes(own) / (sd * np.sqrt(weight))
        blank = formed is None or not formed.shape[1]
        made, by_chance = (np.zeros((len(sd), 0)) if one is None else one for one in (formed, chance))
        start = own.values - fit.predicted + fit.jacobian @ fit.z
        every = np.column_stack([start, fit.jacobian, own.modes, own.code_error, by_chance, made]) / sd[:, None]
        count, forms = len(fit.z), FORMS[:1] if blank else FORMS
        scale = np.ones((len(forms), 1, every.shape[1] - 1))
        scale[:, :, every.shape[1] - 1 - made.shape[1]:] = forms[:, None, None]
        kept = 1.0 / (1.0 + np.square(np.outer(SIZES, size)))
        gram = np.array([every.T @ (one[:, None] * every) for one in kept])
        inner = np.eye(scale.shape[-1]) + scale[..., None] * gram[:, 1:, 1:] * scale[..., None, :]
        pulled = scale * gram[:, 1:, 0]
        inverse = np.linalg.inv(inner)
        mean = np.einsum("fkij,fkj->fki", inverse, pulled)
        table = -0.5 * (gram[:, 0, 0] - np.sum(mean * pulled, axis=-1) + np.linalg.slogdet(inner)[1]
                        - np.log(kept) @ weight)
        return Evidence(table=table, mean=mean[..., :count],
                        covariance=inverse[..., :count, :count])


class IndependentExperiment(Experiment, Protocol):
    """An experiment from whose laws the rows differ independently."""

    @property
    def modulations(self) -> Array:
        """Return what laws of another form follow (M, k), of unit variance in all."""
        ...

    def choice(self, effect: str) -> float:
        """Return the logarithm of how many laws of an effect the one that it has here was chosen from."""
        ...

    def described(self, coordinate: Coordinate) -> tuple[str, str]:
        """Return the unit and the meaning of a parameter."""
        ...


E = TypeVar("E", bound=IndependentExperiment)


class IndependentSearch(Search, Generic[E]):
    """A search among hypotheses from which the rows differ independently."""

    experiment: E

    @property
    def discrepancy(self) -> Discrepancy:
        """Return the general discrepancy."""
        own = self.experiment.measurement
        return IndependentDiscrepancy(own, own.covariance())

    def formed(self, names: Names, laws: Names | None = None) -> Array:
        """Return what other forms of the `laws` of a fitted set change (M, any): signatures, modulated."""
        return np.hstack([self.experiment.modulations * one[:, None] for one in self.signatures(names, laws).T])

    def evidence(self, names: Names, laws: Names | None = None) -> Evidence:
        """Return the evidence of a set, what the choice of its laws' forms costs taken off."""
        evidence, cost = super().evidence(names, laws), sum(self.experiment.choice(name) for name in names)
        return replace(evidence, table=evidence.table - cost) if cost else evidence

    def prior(self, names: Names, laws: Names | None = None, forms: Array | None = None) -> Array:
        """Return the prior (forms, sizes) of law-form errors and of the one general discrepancy."""
        errors, _ = self.prior_of_sizes(names, laws, forms)
        return np.asarray(errors[:, None] * size_prior(code_size(self.experiment.measurement)))

    def beyond_codes(self) -> Array:
        """Return the prior of sizes without effects where something is missing."""
        wide = np.where(code_size(self.experiment.measurement) < SIZES, 1.0, 0.0)
        return np.asarray((wide / wide.sum())[None, :])

    def any_size(self, names: Names) -> Array:
        """Return the prior (forms, sizes) where something is left out: a general discrepancy of any size."""
        forms = self.form_prior if names else np.ones(1)
        return np.outer(forms, np.full(len(SIZES), 1.0 / len(SIZES)))

    @property
    def fitter(self) -> Fitter:
        """Return what fits, under noise alone."""
        return Fitter(self.experiment, self.experiment.measurement.covariance())


def estimates(search: IndependentSearch[E], names: Names) -> tuple[Estimate, ...]:
    """Return the parameters of a fitted set with their 90 % intervals, discrepancies of any size in them."""
    mean, covariance = search.evidence(names).coordinates(search.any_size(names))
    return estimated(search.fits[names].parameters, mean, covariance, lambda one, z, half, draws: estimate(
        one, z, half, draws, search.experiment.described(one)))


def smallest_visible(search: IndependentSearch[E]) -> dict[str, float]:
    """Return the share of its plausible range at which each effect would have been as probable as none.

    The signature is that of the stronger end of the ranges, taken as linear in the effect's size.
    """
    experiment, base, shares = search.experiment, search.baseline, {}
    least, rest = visible(len(experiment.candidates())), basis(base.whitened_jacobian)
    for name in experiment.candidates():
        own, size = experiment.parameters([name]), 0.0
        for way in (-HALF, HALF):
            z = np.r_[base.z, np.full(own.size - len(base.z), way)]
            change = search.fitter.covariance.whiten(experiment.predict(Point(own, z)).values - base.predicted)
            size = max(size, float(np.linalg.norm(change - rest @ (rest.T @ change))))
        shares[name] = least / size if size > least else 1.0
    return shares


def at_rest(fitter: Fitter, point: Point) -> Fit:
    """Return the most probable parameters from a point, to round-off of what could be told of them."""
    fit = fitter.fit(point, None)
    while True:
        step = np.linalg.solve(fit.information, fit.whitened_jacobian.T @ fit.residual - fit.z)
        after = fitter.at(Point(fit.parameters, fit.z + step), None)
        if not after.objective < fit.objective * (1.0 - sys.float_info.epsilon):
            return fit
        fit = after


def in_turn(function: Callable[[T], R], arguments: Sequence[T]) -> list[R]:
    """Return the values of all calls; a prediction takes a millisecond, so that processes would not help."""
    return [function(one) for one in arguments]
