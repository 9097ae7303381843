"""The fits of sets of effects to a measurement, and what they are worth: the state of a search.

Sets are compared by their evidence (see `evidence`), the discrepancy of all hypotheses in it; `strategy` finds them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log, sqrt
from typing import Protocol, TypeVar

import numpy as np
from scipy.stats import chi2, norm

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.inference.evidence import (
    FORMS,
    SIZES,
    Discrepancy,
    Evidence,
    code_size,
    modulations,
    relative_size,
    size_prior,
    smooth_functions,
)
from fretflow.inference.experiment import Covariance, Experiment, Point, Prediction
from fretflow.inference.law_forms import density, law_form_errors
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import Array
from fretflow.inference.verdict import FALSE_ALARMS
from fretflow.recordings.periods import LEVEL

T = TypeVar("T")
R = TypeVar("R")
Names = frozenset[str]

NEGLIGIBLE = -log(LEVEL)  # of log evidence: "decisive" twice over (H. Jeffreys, Theory of Probability (1961), app. B)


class Pool(Protocol):
    """Calls a function of a module's top level on many arguments at once; the values come in their order."""

    def __call__(self, function: Callable[[T], R], arguments: Sequence[T], /) -> list[R]:
        """Return the values of all calls."""
        ...


@dataclass(frozen=True)
class Effort:
    """How much is fitted."""

    going: int  # effects that are fitted on from their starts, the most promising
    starts: int  # of every effect that first order does not tell, beside the one that it promises most of
    last_steps: int  # of those that may matter
    bases: int  # sets to which another effect is sought
    partners: int  # effects that are fitted beside each of them
    draws: int  # of the posterior of a part of the measurement, that are tried on more of it
    secants: bool = False  # whether derivatives are carried on where they told what a step would bring


FAST = Effort(going=10, starts=2, last_steps=8, bases=2, partners=3, draws=16)
FULL = Effort(going=20, starts=4, last_steps=12, bases=3, partners=3, draws=32)


@dataclass(frozen=True)
class Task:
    """A fit that a process is asked for."""

    fitter: Fitter
    point: Point
    near: Prediction | None
    steps: int
    slopes: Array | None = None  # (M, P) at the start, where they are known
    secant: bool = False  # whether by secants
    damping: int = 0  # of the first step


def fit_task(task: Task) -> Fit | None:
    """Return the fit that a task asks for; None where its start has no solution."""
    try:
        return task.fitter.fit(task.point, task.near, task.steps, task.slopes, task.secant, task.damping) if (
            task.steps) else task.fitter.at(task.point, task.near)
    except NonConvergenceError:
        return None


def predict_task(task: Task) -> Array | None:
    """Return what a point predicts; None where it has no solution."""
    try:
        return task.fitter.experiment.predict(task.point, task.near).values
    except NonConvergenceError:
        return None


@dataclass(frozen=True)
class Start:
    """An effect where it was begun: what it changes there, and how that goes on, whitened, the baseline projected out.

    The first column of `changes` (M, k) is the effect's whole change, the others are by its coordinates; `whole` (M, k)
    are these before the projection.
    """

    effect: str
    changes: Array
    whole: Array


@dataclass
class Search:
    """The fits of sets of effects so far, the baseline's among them.

    Fits are made under noise and what codes differ by; `Discrepancy` has the whole.
    """

    experiment: Experiment
    pool: Pool
    effort: Effort
    fits: dict[Names, Fit] = field(default_factory=dict)
    fitters: dict[Names, Fitter] = field(default_factory=dict)
    starts: list[Start] = field(default_factory=list)
    stated: Fit | None = None  # the baseline as it was stated
    settled: dict[Names, Array] = field(default_factory=dict)  # where numerical errors were put right at own fits
    exchanged: dict[tuple[Names, Names], Array] = field(default_factory=dict)  # where laws of sets were exchanged
    _signatures: dict[Names, tuple[Fit, Array]] = field(default_factory=dict)
    _chance: dict[Names, tuple[Fit, Array]] = field(default_factory=dict)
    _evidence: dict[tuple[Names, Names], tuple[Fit, Evidence]] = field(default_factory=dict)
    _averaged: dict[tuple[Names, Names | None], tuple[Evidence, float]] = field(default_factory=dict)

    @cached_property
    def discrepancy(self) -> Discrepancy:
        """Return the general discrepancy."""
        own = self.experiment.measurement
        return Discrepancy(own, own.covariance())

    @cached_property
    def fitter(self) -> Fitter:
        """Return what fits: under noise, and smooth differences of the size of what codes differ by."""
        own = self.experiment.measurement
        known, share = own.covariance(), code_size(own) / sqrt(2.0)  # in common, and of single loops
        return Fitter(self.experiment, Covariance(known.variance, np.hstack([
            known.modes, *(share * functions for functions in smooth_functions(own))])), self.effort.secants)

    @cached_property
    def form_prior(self) -> Array:
        """Return the prior of the relative law-form error of an effect of the catalogue."""
        return density(law_form_errors(), FORMS)

    def prior(self, names: Names, laws: Names | None = None, forms: Array | None = None) -> Array:
        """Return the prior of the discrepancies' sizes, of the shape of a set's evidence with the same `laws`.

        A law of another form by e changes all that its effect does by a share e of that, of any smooth shape.
        """
        errors, sizes = self.prior_of_sizes(names, laws, forms)
        return np.asarray(errors[:, None, None] * sizes[:, :, None] * sizes[:, None, :])

    def prior_of_sizes(self, names: Names, laws: Names | None, forms: Array | None) -> tuple[Array, Array]:
        """Return the priors of e (forms,) and of one general discrepancy at each (forms, sizes)."""
        code = code_size(self.experiment.measurement)
        if not (names if laws is None else laws):
            return np.ones(1), size_prior(code)
        own = relative_size(self.experiment.measurement, self.signatures(names, laws))
        return self.form_prior if forms is None else forms, size_prior(code, own * FORMS)

    def beyond_codes(self) -> Array:
        """Return the prior of sizes without effects where something is missing: log-uniform beyond what codes do."""
        known = min(code_size(self.experiment.measurement), SIZES[-2])  # codes may differ by more than there is
        wide = np.where(known < SIZES, 1.0, 0.0)
        return np.multiply.outer(np.ones(1), np.outer(wide, wide) / wide.sum()**2)

    @property
    def baseline(self) -> Fit:
        """Return the fit without effects."""
        return self.fits[frozenset()]

    def by_chance(self, names: Names) -> Array:
        """Return what a fitted set leaves to chance, (M, any) in SI, of unit variance."""
        fit, known = self.fits[names], self._chance.get(names)
        if known is None or known[0] is not fit:
            self._chance[names] = known = fit, self.fitter_of(names).experiment.by_chance(fit.prediction)
        return known[1]

    def chi_squared(self, names: Names) -> float:
        """Return what a set leaves under the errors of measurement and code, and what it leaves to chance."""
        own, chance = self.discrepancy.covariance, self.by_chance(names)
        if chance.shape[1]:
            own = own.with_modes(chance)
        rest = own.whiten(self.experiment.measurement.values - self.fits[names].predicted)
        return float(rest @ rest)

    def leaves_noise(self, names: Names) -> bool:
        """Tell whether what a set leaves passes for noise."""
        return self.passes_for_noise(self.chi_squared(names))

    def passes_for_noise(self, chi_squared: float) -> bool:
        """Tell whether a sum of squares passes for noise, by a test with the rate of false alarms."""
        return float(chi2.sf(chi_squared, self.experiment.measurement.expected)) > FALSE_ALARMS

    def explained(self, names: Names) -> float:
        """Return the share that a set explains of what the baseline leaves beyond the repeats' noise.

        Where a set leaves less than the noise is told to be, that is no more than what it leaves.
        """
        before, after = self.chi_squared(frozenset()), self.chi_squared(names)
        expected = min(self.experiment.measurement.expected, after)
        return float(np.clip(1.0 - (after - expected) / (before - expected), 0.0, 1.0)) if before > expected else 0.0

    def evidence(self, names: Names, laws: Names | None = None) -> Evidence:
        """Return the evidence of a set whose `laws` may be of another form, those of all its effects where None."""
        fit, laws = self.fits[names], names if laws is None else laws
        known = self._evidence.get((names, laws))
        if known is None or known[0] is not fit:
            own = self.formed(names, laws) if laws else None
            self._evidence[names, laws] = known = fit, self.discrepancy.evidence(fit, own, self.by_chance(names))
        return known[1]

    def log_evidence(self, names: Names, laws: Names | None = None) -> float:
        """Return the log evidence of a set if nothing is missing from it."""
        own, known = self.evidence(names, laws), self._averaged.get((names, laws))
        if known is None or known[0] is not own:
            self._averaged[names, laws] = known = own, own.averaged(self.prior(names, laws))
        return known[1]

    def formed(self, names: Names, laws: Names | None = None) -> Array:
        """Return what other forms of the `laws` of a fitted set change (M, any), in SI, at a law-form error of one."""
        own = self.experiment.measurement
        return np.hstack([np.zeros((len(own.values), 0)),
                          *(modulations(own, one) for one in self.signatures(names, laws).T)])

    def gain_beside(self, names: Names, columns: Array, beyond_forms: bool = False) -> float:
        """Return the gain in log evidence of whitened columns (M, k) beside a fitted set, whose parameters give way.

        What other forms of its laws may change counts for nothing where only what is `beyond_forms` is asked for.
        """
        fit, white = self.fits[names], self.fitter.covariance.whiten
        parts = columns, white(self.experiment.measurement.values - fit.predicted), fit.whitened_jacobian
        forms = basis(white(self.formed(names))) if beyond_forms else np.zeros((len(columns), 0))
        own, left, others = (part - forms @ (forms.T @ part) for part in parts)
        return log_gain(own, left, others, fit.z)

    def signatures(self, names: Names, of: Names | None = None) -> Array:
        """Return what each effect (sorted) `of` a fitted set, or of all of it, changes, (M, effects) in SI.

        It is zero where nothing tells.
        """
        if not names:
            return np.zeros((len(self.experiment.measurement.values), 0))
        self.compute_signatures([names])
        own = self._signatures[names][1]
        return own if of is None else own[:, [place for place, one in enumerate(sorted(names)) if one in of]]

    def compute_signatures(self, sets: Iterable[Names]) -> None:
        """Predict some sets with each of their effects out of work.

        Where that has no solution, what the others explain alone takes its place, if they were fitted.
        """
        asked = [(names, one) for names in dict.fromkeys(sets) if names and (
            names not in self._signatures or self._signatures[names][0] is not self.fits[names])
            for one in sorted(names)]
        tasks = [Task(self.fitter_of(names), replace(self.fits[names].prediction.point, neutral=frozenset({one})),
                      self.fits[names].prediction, 0) for names, one in asked]
        changes: dict[Names, list[Array]] = {}
        for (names, one), values in zip(asked, self.pool(predict_task, tasks), strict=True):
            others = self.fits.get(names - {one}, self.fits[names]).predicted if values is None else values
            changes.setdefault(names, []).append(self.fits[names].predicted - others)
        for names, columns in changes.items():
            self._signatures[names] = (self.fits[names], np.column_stack(columns))

    def shows(self, names: Names) -> dict[str, float]:
        """Return how many standard deviations each effect of a set is away from doing nothing."""
        fit, deviations = self.fits[names], {}
        for one, change in zip(sorted(names), self.signatures(names).T, strict=True):
            rest = basis(fit.whitened_jacobian[:, ~fit.parameters.own(one)])
            white = self.fitter.covariance.whiten(change)
            deviations[one] = float(np.linalg.norm(white - rest @ (rest.T @ white)))
        return deviations

    def fitter_of(self, names: Names) -> Fitter:
        """Return the fitter of a set: that of its fit where it has one, whose numerical steps may be finer."""
        return self.maker(self.fits[names]) if names in self.fits else self.fitters.get(names, self.fitter)

    def maker(self, fit: Fit) -> Fitter:
        """Return the fitter that a fit was made by: a finer one, where the set's own came to a halt."""
        own = self.fitters.get(fit.effects, self.fitter)
        finer = None if own.experiment.has_made(fit.prediction) else own.experiment.finer()
        return replace(own, experiment=finer) if finer is not None and finer.has_made(fit.prediction) else own

    def is_settled(self, names: Names) -> bool:
        """Tell whether a set's numerical errors were put right about where it is fitted now."""
        return not has_moved(self.fits[names], self.settled.get(names))

    def allowing(self, names: Names) -> Task:
        """Return the fit of a set under the discrepancies that it most probably has.

        What a law of another form leaves, its parameters would take up under small errors alone.
        """
        sizes = self.evidence(names).sizes(self.prior(names))
        covariance = self.discrepancy.of_sizes(sizes, self.formed(names), self.by_chance(names))
        task = self.further(self.fits[names], self.effort.last_steps)
        return replace(task, fitter=replace(task.fitter, covariance=covariance))

    def further(self, fit: Fit, steps: int) -> Task:
        """Return that a fit goes on from where it stands."""
        return Task(self.maker(fit), fit.prediction.point, fit.prediction, steps,
                    None if fit.provisional else fit.jacobian, fit.secant, fit.damping)

    def keep(self, fits: Iterable[Fit | None]) -> None:
        """Keep fits that are better than those that are known, or went on from these with finer steps."""
        for fit in fits:
            if fit is None:
                continue
            known, own = self.fits.get(fit.effects), self.fitters.get(fit.effects, self.fitter).experiment
            if known is not None and fit.objective >= known.objective:
                finer = own.has_made(known.prediction) and not own.has_made(fit.prediction)
                if not (fit.converged and np.array_equal(fit.z, known.z)) and not (
                        finer and not has_moved(fit, known.z)):
                    continue
            self.fits[fit.effects] = fit

    def keep_more_probable(self, fit: Fit, known_by: float = 0.0) -> None:
        """Keep a fit made under other errors in the place of the known one, unless that is the more probable one.

        Errors in proportion to what laws do at one fit are not those at another: the evidence of the set tells, where
        it is higher at the known fit by more than `known_by`.
        """
        names = fit.effects
        known, before, signed = self.fits[names], self.log_evidence(names), self._signatures.get(names)
        self.fits[names] = fit
        if self.log_evidence(names) < before - known_by:
            self.fits[names] = known
            if signed is not None:
                self._signatures[names] = signed

    def continue_fits(self, sets: Iterable[Names], steps: int) -> None:
        """Fit the sets that have not come to rest further."""
        self.keep(self.pool(fit_task, [
            self.further(self.fits[names], steps) for names in dict.fromkeys(sets)
            if names in self.fits and not self.fits[names].converged]))

    def best(self, size: int, containing: Names = frozenset()) -> list[Names]:
        """Return the sets of a size, the most probable by the catalogue's own laws first."""
        own = [names for names in self.fits if len(names) == size and containing <= names]
        return sorted(own, key=lambda names: -self.log_evidence(names, frozenset()))

    def promising(self, sets: Sequence[Names], unsure: float = 0.0) -> list[Names]:
        """Return the sets that may hold a share of the posterior, the most probable of `sets` first among them.

        That is as `unsure` as is told, of its log evidence.
        """
        if not sets:
            return []
        best = self.log_evidence(sets[0], frozenset())
        return [names for names in sets if self.log_evidence(names, frozenset()) > best - NEGLIGIBLE - unsure]


def extends(wider: str, plainer: str) -> bool:
    """Tell whether the law of one effect holds that of another."""
    kinds = catalogue()
    return wider != plainer and issubclass(kinds[wider], kinds[plainer])


def has_moved(fit: Fit, since: Array | None) -> bool:
    """Tell whether a fit is elsewhere in its ranges than it was: half of them is no further from their middle."""
    return since is None or bool(np.abs(fit.z - since).max() >= norm.ppf(0.75))


def log_gain(columns: Array, left: Array, others: Array, at: Array) -> float:
    """Return the gain in log evidence of whitened columns (M, k) with standard normal weights beside others (M, n).

    The latter, fitted `at` (n,) with such weights so that (M,) is `left`, give way: what bends one of them far from its
    middle does so no longer where a new column does it.
    """
    across = others.T @ columns
    way = np.linalg.solve(np.eye(len(at)) + others.T @ others, np.column_stack([across, others.T @ left - at]))
    inner = np.eye(columns.shape[1]) + columns.T @ columns - across.T @ way[:, :-1]
    pulled = columns.T @ left - across.T @ way[:, -1]
    return float(0.5 * pulled @ np.linalg.solve(inner, pulled) - 0.5 * np.linalg.slogdet(inner)[1])


def basis(columns: Array) -> Array:
    """Return an orthonormal basis (M, r) of the space of columns."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-8 * max(float(size.max(initial=0.0)), 1e-300)])
