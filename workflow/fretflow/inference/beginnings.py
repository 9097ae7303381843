"""Where effects are begun: at points of their ranges beside a fit, alone or as partners of what is fitted."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np
from scipy.stats import norm

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import in_sensors_alone
from fretflow.inference.experiment import Experiment, Point, Prediction
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import HALF, Array, Parameters, signed_fields
from fretflow.inference.search import Names, Search, Start, Task, basis, extends, has_moved
from fretflow.recordings.periods import LEVEL

FINE = 33  # points of a range of which neighbours are a fifth of its sd apart: a resonance of 5 % damping shows in one


@dataclass(frozen=True)
class Beginning:
    """A point beside a fit at which an effect is begun.

    First-order changes tell what it makes of the fit's motion there, its whole `change` (M,) and, where they are known,
    its derivative `slopes` (M, k) by the effect's own coordinates, in SI, and the point of its ranges at which it does
    `least`.
    """

    origin: Fit
    point: Point
    change: Array
    slopes: Array | None = None
    least: Point | None = None


def is_worth(search: Search, beginning: Beginning, fit: Fit) -> bool:
    """Tell whether an effect may be as probable as none, were all linear, beside the baseline that it was begun at."""
    return fit.promise < beginning.origin.promise - 2.0 * log(max(len(search.experiment.candidates()), 1))


def is_untold(search: Search, beginning: Beginning, fit: Fit | None) -> bool:
    """Tell whether first order is off, where an effect was begun, by more than all that there is to explain.

    Of a law that begins smooth it tells nothing of where that does.
    """
    if fit is None or any(catalogue()[name].smooth for name in fit.effects - beginning.origin.effects):
        return True
    told = beginning.origin.residual - search.fitter.covariance.whiten(np.nan_to_num(beginning.change))
    return abs(float(told @ told) - fit.chi_squared) > beginning.origin.objective


def elsewhere(fitter: Fitter, beginning: Beginning, fit: Fit | None) -> list[Task]:
    """Return an effect at the other points of its ranges than the one that it was begun at, and may have a fit of.

    Near that one they take a third of the time that they take near its origin, where they have a solution; those of a
    law that begins smooth lie too far from it.
    """
    point, origin = beginning.point, beginning.origin
    (name,) = point.effects - origin.effects
    near = (origin if fit is None or catalogue()[name].smooth else fit).prediction
    return [Task(fitter, one, near, 0)
            for one in _laid(fitter.experiment, origin, [name])
            if _signed(one) == _signed(point) and (one.z != point.z).any()]


def weigh_task(task: Task) -> tuple[float, Prediction] | None:
    """Return the objective of a point and its prediction, without derivatives; None where it has no solution."""
    try:
        predicted = task.fitter.experiment.predict(task.point, task.near)
    except NonConvergenceError:
        return None
    left = task.fitter.covariance.whiten(task.fitter.experiment.measurement.values - predicted.values)
    return float(left @ left + task.point.z @ task.point.z), predicted


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
    return replace(fitter.linearised(predicted, np.column_stack([slopes[one.name] for one in coordinates])),
                   provisional=True)


def beginnings_task(asked: tuple[Fitter, Fit, Sequence[str]]) -> dict[tuple[Hashable, ...], Beginning]:
    """Return where beside a fit each further one of some effects is begun, for either sign of what may have both.

    It is the best of several points of its ranges by what first-order changes at the fit's motion tell.
    """
    fitter, origin, effects = asked
    laid = list(_laid(fitter.experiment, origin, effects))
    if not laid:
        return {}
    changes = np.nan_to_num(fitter.experiment.changes(origin.prediction, laid))
    white = fitter.covariance.whiten(changes)
    rest = basis(origin.whitened_jacobian)
    left = origin.residual[:, None] - white
    reached = np.sum((left - rest @ (rest.T @ left))**2, axis=0)
    size = np.sum((white - rest @ (rest.T @ white))**2, axis=0)
    own: dict[tuple[Hashable, ...], list[int]] = {}
    for place, point in enumerate(laid):
        own.setdefault(_signed(point), []).append(place)
    best, least = ({key: min(places, key=lambda place: float(by[place])) for key, places in own.items()}
                   for by in (reached, size))
    sloping = _sloping(fitter.experiment, origin, [(laid[place], changes[:, place]) for place in best.values()])
    return {key: one if least[key] == best[key] else replace(one, least=laid[least[key]])
            for key, one in zip(best, sloping, strict=True)}


def _signed(point: Point) -> tuple[Hashable, ...]:
    """Return the effects of a point and the signs of what may have both."""
    return point.effects, tuple(point.parameters.signs.values())


def _sloping(experiment: Experiment, origin: Fit, points: Sequence[tuple[Point, Array]]) -> list[Beginning]:
    """Return beginnings at points, of each of which the change (M,) from `origin` is given."""
    own = [[one.name not in {known.name for known in origin.parameters.coordinates}
            for one in point.parameters.coordinates] for point, _ in points]
    beside = [point.beside() for point, _ in points]
    asked = [near for (around, _), mine in zip(beside, own, strict=True)
             for near, is_own in zip(around, mine, strict=True) if is_own]
    changes, at, beginnings = experiment.changes(origin.prediction, asked), 0, []
    for (point, change), (_, steps), mine in zip(points, beside, own, strict=True):
        count = sum(mine)
        slopes = (changes[:, at:at + count] - change[:, None]) / steps[mine]
        beginnings.append(Beginning(origin, point, change, slopes if np.isfinite(slopes).all() else None))
        at += count
    return beginnings


def is_told(point: Point, origin: Fit) -> bool:
    """Tell whether first-order changes at a fit's motion tell what the further effect of a point does."""
    (name,) = point.effects - origin.effects
    return catalogue()[name].first_order or in_sensors_alone(catalogue()[name])


def _laid(experiment: Experiment, origin: Fit, effects: Iterable[str]) -> Iterator[Point]:
    """Return points of the ranges of each further one of some effects: the middle, the weak end, and beside the middle.

    A law that a parameter makes smooth is begun sharp and smooth in all others: where it is sharp, its objective has
    minima on the way (graduated non-convexity: A. Blake, A. Zisserman, Visual Reconstruction (1987)), and where it is
    smooth, valleys that lead past what is sharp. Of an effect with
    several strengths, such as heights of a gap, no point beside the middle is weak in all, and what it does there may
    have nothing to do with what it does at first.
    """
    known = dict(zip((one.name for one in origin.parameters.coordinates), origin.z, strict=True))
    for name in effects:
        if name in origin.effects or not experiment.together([*origin.effects, name]):
            continue
        signed = signed_fields(catalogue()[name])
        for sign in (1.0, -1.0) if signed else (1.0,):
            space = experiment.parameters([*origin.effects, name], {
                **origin.parameters.signs, **{f"{name}.{one}": sign for one in signed}})
            middle = np.array([known.get(one.name, 0.0) for one in space.coordinates])
            yield Point(space, middle)
            weakest = _weakest(space, name)
            if np.sum(np.abs(np.nan_to_num(weakest)) > 0.0) > 1:  # of one strength a point beside the middle is weak
                yield Point(space, np.where(np.isfinite(weakest), weakest, middle))
            if not catalogue()[name].first_order and in_sensors_alone(catalogue()[name]):  # a slope misses a resonance
                first = np.eye(len(middle))[int(np.argmax(space.own(name)))]
                end = norm.isf(0.5 * LEVEL)
                yield from (Point(space, middle + at * first) for at in np.linspace(-end, end, FINE))
            own = {space.coordinates[place].field: 2.0 * np.eye(len(middle))[place]
                   for place in np.flatnonzero(space.own(name) & ~space.chances)}
            smooth = own.pop(catalogue()[name].smooth, None)
            quartiles = norm.interval(0.5)
            begun = [middle] if smooth is None else [middle, *(middle + quartile * smooth for quartile in quartiles)]
            yield from (Point(space, one) for one in begun[1:])
            yield from (Point(space, one + quartile * step) for one in begun for step in own.values()
                        for quartile in quartiles)


def _weakest(space: Parameters, effect: str) -> Array:
    """Return the coordinates (size,) within an effect's ranges that are nearest to doing nothing; nan of all others."""
    neutral = catalogue()[effect].neutral()
    return np.array([np.clip(one.place(getattr(neutral, one.field)), -HALF, HALF)
                     if one.effect == effect and one.field in neutral.model_fields_set else np.nan
                     for one in space.coordinates])


def started(search: Search, origin: Fit, fit: Fit) -> Start:
    """Return what the further effect of a fit changes where it was begun."""
    (name,) = fit.effects - origin.effects
    rest = basis(origin.whitened_jacobian)
    columns = np.column_stack([search.fitter.covariance.whiten(fit.predicted - origin.predicted),
                               fit.whitened_jacobian[:, fit.parameters.own(name)]])
    return Start(name, columns - rest @ (rest.T @ columns), columns)


def beside(search: Search, names: Names, beginnings: Iterable[Beginning], beyond: float | None = None) -> list[Task]:
    """Return where the fits of a set with the effects beside it begin that promise most of what it leaves.

    These begin where they explain most and where they do least, as more than first order tells may be too much. What
    each changes is known to first order at the set's own fit, or where it was begun beside the baseline. Pairs that
    promise no more than one effect alone reaches are begun beside the most probable one only, and one that first order
    does not tell where it is fitted alone, if that explains more. Where log evidence is
    given that pairs are to go `beyond`, it is those that promise to, and are not fitted yet.
    """
    fit, white = search.fits[names], search.fitter.covariance.whiten
    reached = np.inf if names == search.best(len(names))[0] else min(
        one.objective for effects, one in search.fits.items() if len(effects) == len(names))
    known = dict(zip((one.name for one in fit.parameters.coordinates), fit.z, strict=True))
    promised: dict[str, tuple[float, list[Point]]] = {}

    def weigh(effect: str, columns: Array, *points: Point | None) -> None:
        beyond_forms, gain = (search.gain_beside(names, columns, beyond) for beyond in (True, False))
        least = log(len(search.experiment.candidates()))  # what the choice costs
        if fit.objective - 2.0 * gain < reached and beyond_forms > promised.get(effect, (least, points))[0]:
            promised[effect] = (beyond_forms, [one for one in points if one is not None])

    told = set(names)
    for one in beginnings:
        (effect,) = one.point.effects - names
        alone = search.fits.get(frozenset({effect}))
        if alone is not None and not is_told(one.point, one.origin) and alone.objective < fit.objective:
            told.add(effect)
        elif one.slopes is not None:
            weigh(effect, white(np.column_stack([one.change, one.slopes])), one.point, one.least)
            told.add(effect)
    for start in search.starts:
        alone = search.fits.get(frozenset({start.effect}))
        if alone is not None and start.effect not in told and search.experiment.together([*names, start.effect]):
            space = search.experiment.parameters([*names, start.effect], {
                **fit.parameters.signs, **alone.parameters.signs})
            own = dict(zip((one.name for one in alone.parameters.coordinates), alone.z, strict=True)) | known
            weigh(start.effect, start.changes, Point(space, np.array([own[one.name] for one in space.coordinates])))
    best = [points for promise, points in sorted(promised.values(), key=lambda one: -one[0]) if beyond is None or (
        points[0].effects not in search.fits and search.log_evidence(names) + promise > beyond)]
    starting_points = [point for points in best[:search.effort.partners] for point in points]
    for point in starting_points:
        if point.effects not in search.settled:
            search.fitters[point.effects] = search.fitter_of(names)
    return [Task(search.fitter_of(names), point, fit.prediction, 0) for point in starting_points]


def without(search: Search, names: Names, effect: str) -> Task:
    """Return the fit of a set without one of its effects, from where the rest was fitted beside it."""
    fit = search.fits[names]
    kept = ~fit.parameters.own(effect)
    signs = {name: sign for name, sign in fit.parameters.signs.items() if name.split(".")[0] != effect}
    space = search.experiment.parameters(sorted(names - {effect}), signs)
    return Task(search.fitter_of(names - {effect}), Point(space, fit.z[kept]), fit.prediction,
                search.effort.last_steps // 2)


def exchanged(search: Search, names: Names) -> list[Task]:
    """Return fits with a law that extends one of a fitted set's, or that this extends, from where the set is fitted.

    A wider law does all that a plainer one does, and is begun where it does little more: a step from its range's end.
    """
    fit, tasks = search.fits[names], []
    for one in sorted(names):
        for other in search.experiment.candidates():
            swapped = names - {one} | {other}
            known = search.fits.get(swapped)
            if other in names or not (extends(one, other) or extends(other, one)) or (
                    known is not None and known.objective <= fit.objective) or not (
                    has_moved(fit, search.exchanged.get((names, swapped))) and search.experiment.together([*swapped])):
                continue
            search.exchanged[names, swapped] = fit.z
            if swapped not in search.settled:
                search.fitters[swapped] = search.fitter_of(names)
            tasks.append(Task(search.fitter_of(swapped), _exchanged(search, fit, one, other), fit.prediction,
                              search.effort.last_steps))
    return tasks


def _exchanged(search: Search, fit: Fit, one: str, other: str) -> Point:
    """Return the point of a fit with another law in the place of `one`, which does as much as that, or little more."""
    space = search.experiment.parameters(sorted(fit.effects - {one} | {other}), {
        f"{other}.{name.removeprefix(f'{one}.')}" if name.startswith(f"{one}.") else name: sign
        for name, sign in fit.parameters.signs.items()})
    z = dict(zip((own.name for own in fit.parameters.coordinates), fit.z, strict=True))
    plainest, far = catalogue()[other].plainest(), 2.0 * HALF
    values = {name: getattr(plainest, name) for name in plainest.model_fields_set} | fit.parameters.values(fit.z)[one]
    return Point(space, np.array([
        min(max(own.place(values[own.field]), -far), far) if own.effect == other and own.field in values
        else z.get(own.name, 0.0) for own in space.coordinates]))
