"""Which effects could explain a measurement: every effect alone, then pairs, each fitted to rest.

Every effect of the catalogue is begun at the best of several points of its ranges, beside the fitted baseline, or
beside the stated one before a bent one, and fitted. Work stops where it cannot matter: a set whose evidence, linear
about where it stands, is below the best one's by `NEGLIGIBLE` holds no share of the posterior that would be told.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.core.progress import Progress
from fretflow.effects.catalogue import catalogue
from fretflow.inference.beginnings import (
    Beginning,
    begin_task,
    beginnings_task,
    beside,
    elsewhere,
    exchanged,
    is_told,
    is_untold,
    is_worth,
    started,
    weigh_task,
    without,
)
from fretflow.inference.corrections import MOST_CORRECTIONS, correct
from fretflow.inference.experiment import Experiment, Prediction
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import Array, is_bent
from fretflow.inference.search import NEGLIGIBLE, Effort, Names, Pool, Search, Task, fit_task, has_moved


def start_search(experiment: Experiment, first: Prediction, effort: Effort, pool: Pool) -> Search:
    """Return a search with the baseline fitted from its first prediction."""
    search = Search(experiment, pool, effort)
    search.stated = search.fitter.linearised(first)
    search.fits[frozenset()] = search.fitter.fit(first.point, first, effort.last_steps)
    return search


def run_search(search: Search, progress: Progress) -> None:
    """Fit all sets of effects that may explain the measurement."""
    progress(0.0, "beginning every effect")
    untold = begin_all(search)
    progress(0.3, "fitting the most promising")
    refine_leading(search)
    if not is_explained(search):  # first order, where effects were begun, may have told nothing of what it is
        progress(0.4, "beginning effects elsewhere")
        begin_elsewhere(search, untold)
        begin_before_jump(search)
        go_on(search, [fit for fit in search.fits.values() if is_where_begun(search, fit)], search.effort.last_steps)
        refine_leading(search)
    sought: dict[Names, Array] = {}
    for _ in range(MOST_CORRECTIONS):  # what leads may have moved where its numerical errors were put right
        lead = leading(search)
        search.continue_fits(lead, search.effort.last_steps)
        bases = [names for names in lead if has_moved(search.fits[names], sought.get(names))]
        if not bases:
            break
        sought.update({names: search.fits[names].z for names in bases})
        progress(0.6, "what could act beside them")
        seek_partners(search, bases)
        progress(0.85, "what the model's numbers leave out at the best")
        correct(search, [1, 2])
    if not search.leaves_noise(frozenset()):
        allow_for_chance(search)


def refine_leading(search: Search) -> None:
    """Fit the leading single effects, and put their numerical errors right."""
    to_rest(search, 1)
    exchange_laws(search, 1)
    correct(search, [0, 1])


def leading(search: Search) -> list[Names]:
    """Return the effects to which others are sought: the most probable, and those that explain most.

    These may be improbable for what they leave, as the stronger one of two is. Laws of other forms are allowed for.
    Where one leaves noise alone there is nothing that pairs without it could explain more of, and where none leaves
    that, nothing that two could. What leaves more than nothing does takes no other's place, however probable.
    """
    if search.leaves_noise(frozenset()):
        return []
    nothing = search.chi_squared(frozenset())
    singles = [names for names in search.best(1) if search.chi_squared(names) < nothing] or search.best(1)
    first = singles[:2 * search.effort.bases]
    if any(map(search.leaves_noise, first)):
        return search.promising(first)[:search.effort.bases]
    every = search.best(1)[:2 * search.effort.bases]
    search.compute_signatures([*first, *every])
    probable = [one for sets in (first, every)
                for one in sorted(sets, key=lambda names: -search.log_evidence(names))[:search.effort.bases]]
    return list(dict.fromkeys([*probable, *sorted(singles, key=search.chi_squared)[:search.effort.bases]]))


def seek_partners(search: Search, bases: Sequence[Names]) -> None:
    """Fit pairs of some effects with those that promise most beside them, and the pairs' members alone from there.

    Where none leaves noise alone, those follow that promise next beside the most probable and would be more probable.
    """
    search.compute_signatures(bases)
    laid = dict(zip(bases, beginnings_beside(search, [(search.fitter_of(one), search.fits[one]) for one in bases]),
                    strict=True))
    fit_pairs(search, [task for one in bases for task in beside(search, one, laid[one].values())])
    pairs = search.best(2)[:1]
    if pairs and bases and not search.leaves_noise(pairs[0]):
        first = max(bases, key=search.log_evidence)
        fit_pairs(search, beside(search, first, laid[first].values(), search.log_evidence(pairs[0])))
    to_rest(search, 2)
    exchange_laws(search, 2)
    for pair in search.promising([*search.best(1)[:1], *search.best(2)[:1]])[1:]:
        # one of the two may have brought the other out of a bad start
        search.keep(search.pool(fit_task, [without(search, pair, one) for one in sorted(pair)]))
    to_rest(search, 1)


def fit_pairs(search: Search, tasks: Sequence[Task]) -> None:
    """Begin pairs, and fit them as far as they may matter."""
    starts: dict[tuple[Names, Names], Fit] = {}  # the better start of each pair beside each of its sets
    for task, fit in zip(tasks, search.pool(fit_task, tasks), strict=True):
        key = task.point.effects, task.near.point.effects if task.near else frozenset()
        if fit is not None and (key not in starts or fit.objective < starts[key].objective):
            starts[key] = fit
    search.keep(starts.values())
    go_on(search, list(starts.values()), search.effort.last_steps)


def allow_for_chance(search: Search) -> None:
    """Fit sets that leave something to chance under that as an error: under others alone, parameters take it up.

    They are begun where they are fitted; single effects in the middle of their ranges too, beside the baseline: where
    they are fitted under other errors they may do nothing, and how probable they are does not show. What promises no
    more there than others reach without chance is hopeless.
    """
    middles = {}
    for names in search.best(1):
        point, there = search.fits[names].prediction.point, np.zeros(len(search.fits[names].z))
        there[:len(search.baseline.z)] = search.baseline.z
        if search.by_chance(names).shape[1]:
            middles[names] = Task(search.fitter_of(names), replace(point, z=there), search.fits[names].prediction, 0)
    begun = dict(zip(middles, search.pool(fit_task, list(middles.values())), strict=True))
    for fit in begun.values():
        if fit is not None:
            search.keep_more_probable(fit)
    sets = [names for names in may_hold(search, [*search.best(1), *search.best(2)[:search.effort.bases]])
            if search.by_chance(names).shape[1]]
    starts = [fit for names in sets for fit in (search.fits[names], begun.get(names)) if fit is not None]
    reached = min(fit.objective for fit in search.fits.values())
    tasks = [replace(search.further(fit, search.effort.last_steps // 2), slopes=None) for fit in starts
             if under_chance(search.maker(fit), fit).promise < reached]
    for fit in search.pool(chance_task, tasks):
        if fit is not None:
            search.keep_more_probable(fit)


def chance_task(task: Task) -> Fit | None:
    """Return a fit under what it leaves to chance, which goes with the parameters; None if it has no solution."""
    fitter, near = task.fitter, task.near
    try:
        near = fitter.experiment.predict(task.point, near)
        for _ in range(2):
            fit = allowing_chance(fitter, near).fit(near.point, near, task.steps)
            near = fit.prediction
    except NonConvergenceError:
        return None
    return replace(fitter.linearised(near, fit.jacobian), converged=fit.converged)


def under_chance(fitter: Fitter, fit: Fit) -> Fit:
    """Return a fit as it stands, under what it leaves to chance as well."""
    return allowing_chance(fitter, fit.prediction).linearised(fit.prediction, fit.jacobian)


def allowing_chance(fitter: Fitter, at: Prediction) -> Fitter:
    """Return a fitter under what a prediction leaves to chance as well."""
    return replace(fitter, covariance=fitter.covariance.with_modes(fitter.experiment.by_chance(at)))


def to_rest(search: Search, size: int) -> None:
    """Fit the leading sets of a size on until they have come to rest.

    Of single effects the first few whatever their distance, unless one explains all: how probable one is shows at rest
    only, and the foremost are fitted first. What does no better than nothing, and promises less than the best has, is
    hopeless, as are pairs that are worse than one effect alone.
    """
    def is_hopeless(fit: Fit) -> bool:
        return size == 1 and fit.objective >= search.baseline.objective and fit.promise > min(
            search.fits[names].objective for names in search.best(1))

    def moving() -> list[Names]:
        sets = may_hold(search, search.best(1)) if size == 1 else search.promising(
            [*search.best(1)[:1], *search.promising(search.best(size))])[1:]
        return [names for names in sets[:2 * search.effort.bases]
                if not search.fits[names].converged and not is_hopeless(search.fits[names])]

    for _ in range(2):
        foremost = moving()[:search.effort.bases]
        search.continue_fits(foremost, search.effort.last_steps // 2)
        search.continue_fits([names for names in moving() if names not in foremost], search.effort.last_steps // 2)


def exchange_laws(search: Search, size: int) -> None:
    """Fit the leading sets of a size with laws that extend theirs, or that theirs extend, from where they are."""
    sets = may_hold(search, search.best(size)[:search.effort.bases])
    search.keep(search.pool(fit_task, [task for names in sets for task in exchanged(search, names)]))


def begin_before_jump(search: Search) -> None:
    """Fit what explains a measurement until its motion jumps, if anything does, to all of it.

    The parameters with which a motion jumps when the recorded one did lie in a valley that is too narrow for starts
    from afar, and nearly straight before the jump. Where the leading fit jumps as well, nothing has to be led there.
    """
    leading = min(search.fits.values(), key=lambda fit: fit.objective)
    before = search.experiment.before_jump(leading.prediction)
    if before is None or search.stated is None:
        return
    point = search.stated.prediction.point
    part = start_search(before, before.predict(point), search.effort, search.pool)
    untold = begin_all(part)
    to_rest(part, 1)
    if not is_explained(part):
        begin_elsewhere(part, untold)
        to_rest(part, 1)
    lead = part.promising(part.best(1))[:search.effort.bases]
    if lead and part.log_evidence(lead[0]) > part.log_evidence(frozenset()) + NEGLIGIBLE:
        for names in lead:
            search.keep(carried_on(search, part.fits[names]))


def carried_on(search: Search, part: Fit) -> list[Fit | None]:
    """Return fits of a hypothesis that was fitted to a part of the measurement.

    They begin from the best of several draws of what the part leaves probable (N. Chopin, A sequential particle filter
    method for static models, Biometrika 89 (2002) 539-551).
    """
    point, spread = part.prediction.point, np.linalg.cholesky(np.linalg.inv(part.information))
    drawn = np.random.default_rng(0).standard_normal((search.effort.draws, len(point.z)))
    fits = search.pool(fit_task, [Task(search.fitter, replace(point, z=np.clip(
        point.z + spread @ one, *point.parameters.ends)), None, 0) for one in drawn])
    best = sorted((fit for fit in fits if fit is not None), key=lambda fit: fit.objective)[:search.effort.starts]
    return search.pool(fit_task, [search.further(fit, 2 * search.effort.last_steps) for fit in best])


def begin_all(search: Search) -> list[Task]:
    """Fit every effect from the best of its starts, and keep what it changes there.

    Other points are returned of the ranges of those that first order does not tell where they were begun. A baseline
    outside of its ranges is bent to explain what it cannot: effects are begun as it was stated, first, and beside it
    only where that leads to none that explains more.
    """
    origins = [search.baseline]
    if search.stated is not None and is_bent(search.baseline.z).any():
        origins.insert(0, search.stated)
    untold: list[Task] = []
    for origin in origins:
        left = begin_beside(search, origin)
        if is_explained(search):
            return []  # what may be left to tell is small, and of first order
        untold = untold or [task for one, fit in left for task in elsewhere(search.maker(origin), one, fit)]
        if min(fit.objective for fit in search.fits.values()) < search.baseline.objective - 2.0 * NEGLIGIBLE:
            break
    return untold


def begin_elsewhere(search: Search, untold: Sequence[Task]) -> None:
    """Fit effects from the best of some points of their ranges; a leader that first order does not tell from all."""
    untold = [replace(task, fitter=search.fitter_of(task.point.effects)) for task in untold]
    best: dict[Names, list[tuple[float, Task]]] = {}
    for task, weighed in zip(untold, search.pool(weigh_task, untold), strict=True):
        if weighed is not None:
            objective, predicted = weighed
            best.setdefault(task.point.effects, []).append((objective, replace(task, near=predicted)))
    starts = {names: [task for _, task in sorted(own, key=lambda one: one[0])] for names, own in best.items()}
    begin(search, [task for own in starts.values() for task in own[:search.effort.starts]])
    (leader,) = search.best(1)[:1] or [frozenset()]
    if not is_explained(search) and not all(catalogue()[one].first_order for one in leader):
        begin(search, starts.get(leader, [])[search.effort.starts:], search.effort.last_steps)


def begin(search: Search, tasks: Sequence[Task], steps: int = 0) -> None:
    """Fit effects from some starts so many steps, and on as far as they may matter.

    Where a start of an effect that first order does not tell leads shows after some steps alone.
    """
    fits = search.pool(fit_task, [replace(task, steps=steps) for task in tasks])
    search.keep(fits)
    go_on(search, [fit for fit in fits if fit is not None], search.effort.last_steps)


def beginnings_beside(search: Search, asked: Sequence[tuple[Fitter, Fit]]
                      ) -> list[dict[tuple[Hashable, ...], Beginning]]:
    """Return where each further effect is begun beside every one of some fits, each in two parts, for two processes."""
    candidates = search.experiment.candidates()
    parts = [candidates[0::2], candidates[1::2]]
    beginnings = search.pool(beginnings_task, [(fitter, fit, part) for fitter, fit in asked for part in parts])
    return [even | odd for even, odd in zip(beginnings[0::2], beginnings[1::2], strict=True)]


def begin_beside(search: Search, origin: Fit) -> list[tuple[Beginning, Fit | None]]:
    """Fit every effect from its best start beside a baseline; return the starts of which first order does not tell.

    With them comes what they are there, None where that has no solution.
    """
    fitter = search.maker(origin)  # what the origin's model leaves out is no effect's change
    (beginnings,) = beginnings_beside(search, [(fitter, origin)])
    laid = list(beginnings.values())
    first_fits = search.pool(begin_task, [(fitter, one) for one in laid])
    # an effect that does more than first order tells may be worth it where it does least
    anew = {place: replace(one, point=one.least, slopes=None)
            for place, (one, fit) in enumerate(zip(laid, first_fits, strict=True))
            if one.least is not None and (fit is None or not is_worth(search, one, fit))}
    weaker = dict(zip(anew, search.pool(begin_task, [(fitter, one) for one in anew.values()]), strict=True))
    going = []
    for place, (one, first) in enumerate(zip(laid, first_fits, strict=True)):
        fit = min((own for own in (first, weaker.get(place)) if own is not None), key=lambda own: own.promise,
                  default=None)
        if fit is not None:
            search.starts.append(started(search, origin, fit))
            if is_worth(search, one, fit):
                going.append(fit)
            search.keep([fit])
    go_on(search, sorted(going, key=lambda one: one.promise)[:search.effort.going], search.effort.last_steps)
    begun = begin_untold_leader(search, fitter, zip(laid, first_fits, strict=True))
    return [(one, fit) for one, fit in zip(laid, first_fits, strict=True)
            if one.point.effects not in begun and is_untold(search, one, fit)]


def begin_untold_leader(search: Search, fitter: Fitter, laid: Iterable[tuple[Beginning, Fit | None]]) -> set[Names]:
    """Fit an effect that leads from the other points of its ranges too, where first order tells nothing of it.

    Of a play, objectives have several minima. Where it does not lead from where it is weak, this would take long.
    That effect is returned, as it needs no other start.
    """
    if is_explained(search):
        return set()
    leader = search.best(1)[:1]
    untold = [(one, fit) for one, fit in laid
              if [one.point.effects] == leader and not is_told(one.point, one.origin)]
    begin(search, [task for one, fit in untold for task in elsewhere(fitter, one, fit)], search.effort.last_steps)
    return {one.point.effects for one, _ in untold}


def may_hold(search: Search, sets: Sequence[Names]) -> Sequence[Names]:
    """Return the sets that may hold a share of the posterior: all of them, as long as none explains all."""
    if not is_explained(search):
        return sets
    held = search.promising([*search.best(1)[:1], *sets])
    return [names for names in sets if names in held]


def is_explained(search: Search) -> bool:
    """Tell whether a set leaves no more than what passes for noise."""
    return search.passes_for_noise(min(fit.chi_squared for fit in search.fits.values()))


def is_where_begun(search: Search, fit: Fit) -> bool:
    """Tell whether an effect was never fitted: the baseline's parameters are those that it was begun beside."""
    return bool(fit.effects) and any(origin is not None and np.array_equal(fit.z[:len(origin.z)], origin.z)
                                     for origin in (search.baseline, search.stated))


def go_on(search: Search, going: Sequence[Fit], steps: int) -> None:
    """Fit some sets of a size on step by step, those that may become the best of that size, or of smaller ones.

    They fall by factors that would bring them there in the steps that are left, or are better than all that they are
    made of and still move through their ranges, so that nobody knows where they will end, and nothing explains all.
    """
    def is_more(fit: Fit) -> bool:
        return fit.objective < min(less.objective for names, less in search.fits.items() if names < fit.effects)

    for left in reversed(range(steps)):
        fits = search.pool(fit_task, [search.further(one, 1) for one in going])
        search.keep(fits)
        best = {size: min(one.objective for names, one in search.fits.items() if 0 < len(names) <= size)
                for size in {len(fit.effects) for fit in going}}
        going = [fit for before, fit in zip(going, fits, strict=True) if fit is not None and not fit.converged and (
            (is_more(fit) and has_moved(fit, before.z) and not is_explained(search))
            or fit.objective * (fit.objective / before.objective)**left <= best[len(fit.effects)])]
