"""Which effects could explain a measurement: every effect alone, then pairs, each fitted to rest.

Every effect of the catalogue is begun at several points of its ranges, beside the fitted baseline and beside the
baseline as it was stated, and fitted. Sets are compared by their evidence (see `evidence`), the discrepancy of all
hypotheses in it. Work stops where it cannot matter: a set whose evidence, linear about where it stands, is below the
best one's by `NEGLIGIBLE` holds no share of the posterior that would be told.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log, sqrt
from typing import Protocol, TypeVar

import numpy as np
from scipy.stats import norm

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import in_sensors_alone
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
from fretflow.inference.parameters import Array, signed_fields

T = TypeVar("T")
R = TypeVar("R")
Names = frozenset[str]
Progress = Callable[[float, str], None]

BENT = float(norm.ppf(0.9995))  # coordinate of the baseline that one in a thousand of its prior is beyond
FINE = 33  # points of a range of which neighbours are a fifth of its sd apart: a resonance of 5 % damping shows in one
QUARTILE = float(norm.ppf(0.75))  # coordinates of the points of a range at which an effect is begun, beside its middle
MOST_CORRECTIONS = 3  # of the numerical errors at fits that these move
NEGLIGIBLE = log(1e3)  # of log evidence: "decisive" twice over (H. Jeffreys, Theory of Probability (1961), app. B)


class Pool(Protocol):
    """Calls a function of a module's top level on many arguments at once; the values come in their order."""

    def __call__(self, function: Callable[[T], R], arguments: Sequence[T], /) -> list[R]:
        """Return the values of all calls."""
        ...


@dataclass(frozen=True)
class Effort:
    """How much is fitted."""

    going: int  # effects that are fitted on from their starts, the most promising first
    first_steps: int  # of each of these
    starts: int  # of every effect that are gone on with
    last_steps: int  # of those that may matter
    bases: int  # sets to which another effect is sought
    partners: int  # effects that are fitted beside each of them


FAST = Effort(going=10, first_steps=1, starts=1, last_steps=8, bases=2, partners=3)
FULL = Effort(going=20, first_steps=2, starts=2, last_steps=12, bases=3, partners=3)


@dataclass(frozen=True)
class Task:
    """A fit that a process is asked for."""

    fitter: Fitter
    point: Point
    near: Prediction
    steps: int


def fit_task(task: Task) -> Fit | None:
    """Return the fit that a task asks for; None where its start has no solution."""
    try:
        return task.fitter.fit(task.point, task.near, task.steps) if task.steps else task.fitter.at(
            task.point, task.near)
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
    _signatures: dict[Names, tuple[Fit, Array]] = field(default_factory=dict)
    _evidence: dict[Names, tuple[Fit, bool, Evidence]] = field(default_factory=dict)

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
            known.modes, *(share * functions for functions in smooth_functions(own))])))

    @cached_property
    def form_prior(self) -> Array:
        """Return the prior of the relative law-form error of an effect of the catalogue."""
        return density(law_form_errors(), FORMS)

    def prior(self, names: Names, formed: bool = True, forms: Array | None = None) -> Array:
        """Return the prior of the discrepancies' sizes, of the shape of a set's evidence.

        A law of another form by e changes all that its effect does by a share e of that, of any smooth shape.
        """
        laws, sizes = self.prior_of_sizes(names, formed, forms)
        return np.asarray(laws[:, None, None] * sizes[:, :, None] * sizes[:, None, :])

    def prior_of_sizes(self, names: Names, formed: bool, forms: Array | None) -> tuple[Array, Array]:
        """Return the priors of e (forms,) and of one general discrepancy at each (forms, sizes)."""
        code = code_size(self.experiment.measurement)
        if not names or not formed:
            return np.ones(1), size_prior(code)
        own = relative_size(self.experiment.measurement, self.signatures(names))
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

    def chi_squared(self, names: Names) -> float:
        """Return what a set leaves under the errors of measurement and code."""
        return self.left(self.fits[names].predicted)

    def left(self, predicted: Array) -> float:
        """Return the chi-squared of a prediction (M,)."""
        rest = self.discrepancy.covariance.whiten(self.experiment.measurement.values - predicted)
        return float(rest @ rest)

    def explained(self, names: Names) -> float:
        """Return the share that a set explains of what the baseline leaves beyond the repeats' noise."""
        expected = self.experiment.measurement.expected
        before = self.chi_squared(frozenset()) - expected
        after = self.chi_squared(names) - expected
        return float(np.clip(1.0 - max(after, 0.0) / before, 0.0, 1.0)) if before > 0.0 else 0.0

    def evidence(self, names: Names, formed: bool = True) -> Evidence:
        """Return the evidence of a set, with law-form errors in it where `formed`."""
        fit = self.fits[names]
        known = self._evidence.get(names)
        if known is None or known[0] is not fit or known[1] != formed:
            own = self.formed(names) if formed and names else None
            self._evidence[names] = (fit, formed, self.discrepancy.evidence(fit, own))
        return self._evidence[names][2]

    def log_evidence(self, names: Names, formed: bool = True) -> float:
        """Return the log evidence of a set if nothing is missing from it."""
        return self.evidence(names, formed).averaged(self.prior(names, formed))

    def formed(self, names: Names) -> Array:
        """Return what other forms of the laws of a fitted set change (M, any), in SI, at a law-form error of one."""
        own = self.experiment.measurement
        return np.hstack([np.zeros((len(own.values), 0)), *(modulations(own, one) for one in self.signatures(names).T)])

    def explicable(self, names: Names) -> Array:
        """Return an orthonormal basis (M, any) of what a set's parameters and other forms of its laws can change."""
        formed = self.fitter.covariance.whiten(self.formed(names))
        return basis(np.column_stack([self.fits[names].whitened_jacobian, formed]))

    def signatures(self, names: Names) -> Array:
        """Return what each effect (sorted) of a fitted set changes, (M, effects) in SI; zero where nothing tells."""
        if not names:
            return np.zeros((len(self.experiment.measurement.values), 0))
        self.sign([names])
        return self._signatures[names][1]

    def sign(self, sets: Iterable[Names]) -> None:
        """Predict some sets with each of their effects out of work."""
        asked = [(names, one) for names in sets if names and (
            names not in self._signatures or self._signatures[names][0] is not self.fits[names])
            for one in sorted(names)]
        tasks = [Task(self.fitter_of(names), replace(self.fits[names].prediction.point, neutral=frozenset({one})),
                      self.fits[names].prediction, 0) for names, one in asked]
        found: dict[Names, list[Array]] = {}
        for (names, _), values in zip(asked, self.pool(predict_task, tasks), strict=True):
            predicted = self.fits[names].predicted
            found.setdefault(names, []).append(np.zeros(len(predicted)) if values is None else predicted - values)
        for names, columns in found.items():
            self._signatures[names] = (self.fits[names], np.column_stack(columns))

    def shows(self, names: Names) -> dict[str, float]:
        """Return how many standard deviations each effect of a set is away from doing nothing."""
        fit, found = self.fits[names], {}
        for one, change in zip(sorted(names), self.signatures(names).T, strict=True):
            rest = basis(fit.whitened_jacobian[:, ~fit.parameters.own(one)])
            white = self.fitter.covariance.whiten(change)
            found[one] = float(np.linalg.norm(white - rest @ (rest.T @ white)))
        return found

    def fitter_of(self, names: Names) -> Fitter:
        """Return the fitter of a set."""
        return self.fitters.get(names, self.fitter)

    def is_settled(self, names: Names) -> bool:
        """Tell whether a set's numerical errors were put right about where it is fitted now."""
        return not _moved(self.fits[names], self.settled.get(names))

    def allowing(self, names: Names) -> Task:
        """Return the fit of a set under the discrepancies that it most probably has.

        What a law of another form leaves, its parameters would take up under small errors alone.
        """
        at = self.fits[names].prediction
        sizes = self.evidence(names).sizes(self.prior(names))
        covariance = self.discrepancy.of_sizes(sizes, self.formed(names))
        return Task(replace(self.fitter_of(names), covariance=covariance), at.point, at, self.effort.last_steps)

    def keep(self, found: Iterable[Fit | None]) -> None:
        """Keep fits that are better than those that are known."""
        for fit in found:
            if fit is None:
                continue
            known = self.fits.get(fit.effects)
            if known is None or fit.objective < known.objective or (fit.converged and fit.z is known.z):
                self.fits[fit.effects] = fit

    def continue_fits(self, sets: Iterable[Names], steps: int) -> None:
        """Fit the sets that have not come to rest further."""
        self.keep(self.pool(fit_task, [
            Task(self.fitter_of(names), self.fits[names].prediction.point, self.fits[names].prediction, steps)
            for names in dict.fromkeys(sets) if names in self.fits and not self.fits[names].converged]))

    def best(self, size: int, containing: Names = frozenset(), formed: bool = False) -> list[Names]:
        """Return the sets of a size, the most probable first."""
        own = [names for names in self.fits if len(names) == size and containing <= names]
        return sorted(own, key=lambda names: -self.log_evidence(names, formed))

    def promising(self, sets: Sequence[Names]) -> list[Names]:
        """Return the sets that may hold a share of the posterior, the most probable of `sets` first among them."""
        if not sets:
            return []
        best = self.log_evidence(sets[0], False)
        return [names for names in sets if self.log_evidence(names, False) > best - NEGLIGIBLE]


def start_search(experiment: Experiment, first: Prediction, effort: Effort, pool: Pool) -> Search:
    """Return a search with the baseline fitted from its first prediction."""
    found = Search(experiment, pool, effort)
    found.stated = found.fitter.linearised(first)
    found.fits[frozenset()] = found.fitter.fit(first.point, first, effort.last_steps)
    return found


def search(found: Search, progress: Progress) -> None:
    """Fit all sets of effects that may explain the measurement."""
    progress(0.0, "beginning every effect")
    begin_all(found)
    progress(0.35, "fitting the most promising")
    to_rest(found, 1)
    correct(found, [0, 1])
    sought: dict[Names, Array] = {}
    for _ in range(MOST_CORRECTIONS):  # what leads may have moved where its numerical errors were put right
        lead = leading(found)
        found.continue_fits(lead, found.effort.last_steps)
        bases = [names for names in lead if _moved(found.fits[names], sought.get(names))]
        if not bases:
            break
        sought.update({names: found.fits[names].z for names in bases})
        progress(0.6, "what could act beside them")
        seek_partners(found, bases)
        progress(0.85, "what the model's numbers leave out at the best")
        correct(found, [1, 2])


def _moved(fit: Fit, since: Array | None) -> bool:
    """Tell whether a fit is elsewhere in its ranges than it was."""
    return since is None or bool(np.abs(fit.z - since).max() >= QUARTILE)


def leading(found: Search) -> list[Names]:
    """Return the effects to which others are sought: the most probable, and the one that explains most.

    That may be improbable for what it leaves, as the stronger one of two is. Laws of other forms are allowed for.
    """
    first = found.best(1)[:2 * found.effort.bases]
    found.sign(first)
    probable = sorted(first, key=lambda names: -found.log_evidence(names))[:found.effort.bases]
    return list(dict.fromkeys([*probable, min(found.best(1), key=found.chi_squared)]))


def seek_partners(found: Search, bases: Sequence[Names]) -> None:
    """Fit pairs of some effects with those that promise most beside them, and the pairs' members alone from there."""
    found.sign(bases)
    laid = found.pool(beginnings_task, [(found.fitter_of(names), found.fits[names]) for names in bases])
    found.keep(found.pool(fit_task, [task for names, beginnings in zip(bases, laid, strict=True)
                                     for task in beside(found, names, beginnings.values())]))
    to_rest(found, 2)
    for pair in found.promising([*found.best(1)[:1], *found.best(2)[:1]])[1:]:
        # one of the two may have brought the other out of a bad start
        found.keep(found.pool(fit_task, [without(found, pair, one) for one in sorted(pair)]))
    to_rest(found, 1)


def correct(found: Search, of: Sequence[int]) -> None:
    """Put the numerical errors of the leading sets of some sizes right at their own fits, and of those that lead then.

    What a set explains by the errors of a coarse model is no longer explained, and another leads. Sets that are less
    probable than smaller ones need none. Where a fit moves far, its errors are put right once more.
    """
    for _ in range(MOST_CORRECTIONS):
        leading = [names for size in of for names in found.best(size)[:found.effort.bases]
                   if not found.is_settled(names) and all(
                       found.log_evidence(names, False) > found.log_evidence(one, False)
                       for less in range(size) for one in found.best(less)[:1])]
        if not leading:
            break
        put_right = found.pool(correct_task, [(found.fitter_of(names), found.fits[names]) for names in leading])
        found.settled.update({names: found.fits[names].z for names in leading})
        found.fitters.update({names: own for names, own in zip(leading, put_right, strict=True) if own is not None})
        again = [names for names, own in zip(leading, put_right, strict=True) if own is not None]
        for names, fit in zip(again, found.pool(fit_task, [found.allowing(one) for one in again]), strict=True):
            if fit is not None:
                found.fits[names] = replace(found.fitter_of(names).linearised(fit.prediction, fit.jacobian),
                                            converged=fit.converged)


def correct_task(asked: tuple[Fitter, Fit]) -> Fitter | None:
    """Return a fitter with the numerical errors put right at a fit; None where nothing finer tells them."""
    fitter, fit = asked
    experiment = fitter.experiment.corrected(fit.prediction)
    return None if experiment is None else replace(fitter, experiment=experiment)


def to_rest(found: Search, size: int) -> None:
    """Fit the leading sets of a size on until they have come to rest.

    Of single effects the first few whatever their distance: how probable one is shows at rest only.
    """
    for _ in range(2):
        sets = found.best(size) if size == 1 else found.promising(found.best(size))
        open_ = [names for names in sets[:2 * found.effort.bases] if not found.fits[names].converged]
        if not open_:
            break
        found.continue_fits(open_, found.effort.last_steps // 2)


@dataclass(frozen=True)
class Beginning:
    """A point beside a fit at which an effect is begun.

    Where first-order changes tell it, its whole `change` (M,) and its derivative `slopes` (M, k) by the effect's own
    coordinates at the fit's motion, in SI, are known, and the point of its ranges at which it does `least`.
    """

    origin: Fit
    point: Point
    change: Array | None = None
    slopes: Array | None = None
    least: Point | None = None


def begin_all(found: Search) -> None:
    """Fit every effect from the best of its starts, and keep what it changes there."""
    origins = [found.baseline]
    if found.stated is not None and np.any(np.abs(found.baseline.z) > BENT):
        origins.append(found.stated)  # a baseline outside of its ranges is bent to explain what it cannot
    laid = {(place, *key): one for place, beginnings in enumerate(found.pool(
        beginnings_task, [(found.fitter, one) for one in origins])) for key, one in beginnings.items()}
    first_fits = found.pool(begin_task, [(found.fitter, one) for one in laid.values()])
    # an effect that does more than first order tells may be worth it where it does least
    anew = {key: Beginning(one.origin, one.least) for (key, one), fit in zip(laid.items(), first_fits, strict=True)
            if one.least is not None and (fit is None or not _worth(found, one, fit))}
    weaker = dict(zip(anew, found.pool(begin_task, [(found.fitter, one) for one in anew.values()]), strict=True))
    best: dict[Hashable, dict[Hashable, list[Fit]]] = {place: {} for place in range(len(origins))}
    for (key, one), first in zip(laid.items(), first_fits, strict=True):
        fit = min((own for own in (first, weaker.get(key)) if own is not None), key=lambda own: own.promise,
                  default=None)
        if fit is not None:
            found.starts.append(_start(found, one.origin, fit))
            if _worth(found, one, fit) or not _tells(fit.prediction.point, found.baseline):
                best[key[0]].setdefault(key[:3], []).append(fit)
            found.keep([fit])
    for at_origin, origin in zip(best.values(), origins, strict=True):
        starts = [fit for own in at_origin.values()
                  for fit in sorted(own, key=lambda one: one.promise)[:found.effort.starts]]
        going = sorted(starts, key=lambda one: one.promise)[:found.effort.going]
        # what first order tells beside a baseline that fits far less than it may is the direction alone
        steps = found.effort.first_steps if origin is found.baseline else found.effort.last_steps // 2
        for _ in range(steps):  # the better half of them further each time
            fits = [fit for fit in found.pool(fit_task, [
                Task(found.fitter, one.prediction.point, one.prediction, 1) for one in going]) if fit is not None]
            found.keep(fits)
            going = sorted((fit for fit in fits if not fit.converged), key=lambda one: one.promise)
            going = going[:(len(going) + 1) // 2]


def _worth(found: Search, beginning: Beginning, fit: Fit) -> bool:
    """Tell whether an effect may be as probable as none, were all linear, beside the baseline that it was begun at."""
    return fit.promise < beginning.origin.promise - 2.0 * log(max(len(found.experiment.candidates()), 1))


def begin_task(asked: tuple[Fitter, Beginning]) -> Fit | None:
    """Return a beginning simulated, with the derivatives that are known before; None where it has no solution."""
    fitter, beginning = asked
    try:
        predicted = fitter.experiment.predict(beginning.point, beginning.origin.prediction)
    except NonConvergenceError:
        return None
    if beginning.slopes is None:
        return fitter.linearised(predicted)
    coordinates = beginning.point.parameters.coordinates
    origin = beginning.origin
    slopes = dict(zip((one.name for one in origin.parameters.coordinates), origin.jacobian.T, strict=True))
    own = (one.name for one in coordinates if one.name not in slopes)
    slopes.update(zip(own, beginning.slopes.T, strict=True))
    return fitter.linearised(predicted, np.column_stack([slopes[one.name] for one in coordinates]))


def beginnings_task(asked: tuple[Fitter, Fit]) -> dict[tuple[Hashable, ...], Beginning]:
    """Return where beside a fit each further effect is begun, for either sign of what may have both.

    Where first-order changes tell what an effect does, it is the best of several points of its ranges; else its middle
    and a point near their lower end.
    """
    fitter, origin = asked
    laid = list(_laid(fitter.experiment, origin))
    told = [point for point in laid if _tells(point, origin)]
    changes = np.nan_to_num(fitter.experiment.changes(origin.prediction, told))
    white = fitter.covariance.whiten(changes)
    rest = basis(origin.whitened_jacobian)
    left = origin.residual[:, None] - white
    reached = np.sum((left - rest @ (rest.T @ left))**2, axis=0)
    size = np.sum((white - rest @ (rest.T @ white))**2, axis=0)
    own: dict[tuple[Hashable, ...], list[int]] = {}
    for place, point in enumerate(told):
        own.setdefault((point.effects, tuple(point.parameters.signs.values())), []).append(place)
    best = {key: min(places, key=lambda place: float(reached[place])) for key, places in own.items()}
    least = {key: min(places, key=lambda place: float(size[place])) for key, places in own.items()}
    sloping = _sloping(fitter.experiment, origin, [(told[place], changes[:, place]) for place in best.values()])
    found: dict[tuple[Hashable, ...], Beginning] = {
        key: one if least[key] == best[key] else replace(one, least=told[least[key]])
        for key, one in zip(best, sloping, strict=True)}
    for point in laid:  # of the others nothing is known before they are simulated
        at = point.z[len(origin.z):]
        if not _tells(point, origin) and np.sum(np.abs(at) > 0.0) < 2:
            found[point.effects, tuple(point.parameters.signs.values()), tuple(at)] = Beginning(origin, point)
    return found


def _sloping(experiment: Experiment, origin: Fit, points: Sequence[tuple[Point, Array]]) -> list[Beginning]:
    """Return beginnings at points, of each of which the change (M,) from `origin` is given."""
    own = [[one.name not in {known.name for known in origin.parameters.coordinates}
            for one in point.parameters.coordinates] for point, _ in points]
    beside = [point.beside() for point, _ in points]
    asked = [near for (around, _), mine in zip(beside, own, strict=True)
             for near, is_own in zip(around, mine, strict=True) if is_own]
    changes, at, found = experiment.changes(origin.prediction, asked), 0, []
    for (point, change), (_, steps), mine in zip(points, beside, own, strict=True):
        count = sum(mine)
        slopes = (changes[:, at:at + count] - change[:, None]) / steps[mine]
        found.append(Beginning(origin, point, change, slopes if np.isfinite(slopes).all() else None))
        at += count
    return found


def _tells(point: Point, origin: Fit) -> bool:
    (name,) = point.effects - origin.effects
    return catalogue()[name].first_order or in_sensors_alone(catalogue()[name])


def _laid(experiment: Experiment, origin: Fit) -> Iterator[Point]:
    """Return points of each further effect's ranges: the middle, and beside it along each coordinate."""
    known = dict(zip((one.name for one in origin.parameters.coordinates), origin.z, strict=True))
    for name in experiment.candidates():
        if name in origin.effects or not experiment.together([*origin.effects, name]):
            continue
        signed = signed_fields(catalogue()[name])
        for sign in (1.0, -1.0) if signed else (1.0,):
            space = experiment.parameters([*origin.effects, name], {
                **origin.parameters.signs, **{f"{name}.{one}": sign for one in signed}})
            middle = np.array([known.get(one.name, 0.0) for one in space.coordinates])
            yield Point(space, middle)
            if not catalogue()[name].first_order and in_sensors_alone(catalogue()[name]):  # a slope misses a resonance
                first = np.eye(len(middle))[int(np.argmax(space.own(name)))]
                yield from (Point(space, middle + at * first) for at in np.linspace(-BENT, BENT, FINE))
            for place in np.flatnonzero(space.own(name)):
                for way in (-2.0 * QUARTILE, 2.0 * QUARTILE):
                    yield Point(space, middle + way * np.eye(len(middle))[place])


def _start(found: Search, origin: Fit, fit: Fit) -> Start:
    (name,) = fit.effects - origin.effects
    rest = basis(origin.whitened_jacobian)
    columns = np.column_stack([found.fitter.covariance.whiten(fit.predicted - origin.predicted),
                               fit.whitened_jacobian[:, fit.parameters.own(name)]])
    return Start(name, columns - rest @ (rest.T @ columns), columns)


def beside(found: Search, names: Names, beginnings: Iterable[Beginning]) -> list[Task]:
    """Return the fits of a set with the effects beside it that promise most of what it leaves.

    What each changes is known to first order at the set's own fit, or where it was begun beside the baseline.
    """
    fit, white = found.fits[names], found.fitter.covariance.whiten
    rest, free = found.explicable(names), np.array([one.name for one in fit.parameters.coordinates])
    left = white(found.experiment.measurement.values - fit.predicted)
    left -= rest @ (rest.T @ left)
    known = dict(zip(free, fit.z, strict=True))
    promised: dict[str, tuple[float, Point]] = {}

    def weigh(effect: str, columns: Array, point: Point) -> None:
        gain = log_gain(columns - rest @ (rest.T @ columns), left)
        if gain > promised.get(effect, (log(len(found.experiment.candidates())), point))[0]:  # what the choice costs
            promised[effect] = (gain, point)

    told = set(names)
    for one in beginnings:
        if one.change is not None and one.slopes is not None:
            (effect,) = one.point.effects - names
            weigh(effect, white(np.column_stack([one.change, one.slopes])), one.point)
            told.add(effect)
    for start in found.starts:
        alone = found.fits.get(frozenset({start.effect}))
        if alone is not None and start.effect not in told and found.experiment.together([*names, start.effect]):
            space = found.experiment.parameters([*names, start.effect], {
                **fit.parameters.signs, **alone.parameters.signs})
            own = dict(zip((one.name for one in alone.parameters.coordinates), alone.z, strict=True)) | known
            weigh(start.effect, start.changes, Point(space, np.array([own[one.name] for one in space.coordinates])))
    best = sorted(promised.values(), key=lambda one: -one[0])[:found.effort.partners]
    for _, point in best:
        if point.effects not in found.settled:
            found.fitters[point.effects] = found.fitter_of(names)
    return [Task(found.fitter_of(names), point, fit.prediction, found.effort.last_steps // 2) for _, point in best]


def without(found: Search, names: Names, effect: str) -> Task:
    """Return the fit of a set without one of its effects, from where the rest was fitted beside it."""
    fit = found.fits[names]
    kept = ~fit.parameters.own(effect)
    signs = {name: sign for name, sign in fit.parameters.signs.items() if name.split(".")[0] != effect}
    space = found.experiment.parameters(sorted(names - {effect}), signs)
    return Task(found.fitter_of(names - {effect}), Point(space, fit.z[kept]), fit.prediction,
                found.effort.last_steps // 2)


def log_gain(columns: Array, left: Array) -> float:
    """Return the gain in log evidence over nothing of whitened columns (M, k) with standard normal weights."""
    inner = np.eye(columns.shape[1]) + columns.T @ columns
    pulled = columns.T @ left
    return float(0.5 * pulled @ np.linalg.solve(inner, pulled) - 0.5 * np.linalg.slogdet(inner)[1])


def basis(columns: Array) -> Array:
    """Return an orthonormal basis (M, r) of the space of columns."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-8 * max(float(size.max(initial=0.0)), 1e-300)])
