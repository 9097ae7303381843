"""Which effects a search begins, fits on and spares, on problems whose answer is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from fretflow.inference import corrections, strategy
from fretflow.inference.beginnings import beside
from fretflow.inference.decision import decide
from fretflow.inference.experiment import Point, Prediction, differences
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.search import FAST, Search, log_gain
from fretflow.inference.strategy import (
    allow_for_chance,
    begin_all,
    begin_elsewhere,
    beginnings_beside,
    exchange_laws,
    leading,
    may_hold,
    run_search,
    start_search,
)
from scipy.stats import multivariate_normal
from waves import BASELINE, LOOPS, SAMPLES, SD, Waves, cosine, judged, measurement, wave


@dataclass(frozen=True)
class Bent(Waves):
    """Waves as high as t^3 - t, t the coordinate: first order at the middle tells the wrong sign of the far ends."""

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves."""
        values = point.parameters.values(point.z)[""]["friction"] * cosine()
        for name, t in zip(sorted(point.effects - point.neutral), point.z[1:], strict=False):
            values = values + (t**3 - t) * wave(name)
        return Prediction(point, values)

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return what the slope in the middle promises of a further effect, else differences."""
        return np.column_stack([
            -point.z[-1] * wave(*point.effects) if point.effects > prediction.point.effects else
            self.predict(point).values - prediction.values for point in points])


def test_what_first_order_misses_is_begun_elsewhere_too() -> None:
    """The best start by first order ends on the wrong side, at a crest that is too low; another one is right."""
    experiment = Bent(measurement(cosine() + wave("viscous")), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    untold = begin_all(search)
    assert {task.near.point.effects for task in untold if task.near} == {frozenset({"viscous"})}  # near where it began
    begin_elsewhere(search, untold)
    fit = search.fits[frozenset({"viscous"})]
    assert fit.z[1] == pytest.approx(1.3247, abs=0.005)  # the real root of t^3 - t = 1
    assert fit.chi_squared < 0.01 * search.baseline.chi_squared


@dataclass(frozen=True)
class TwoCrests(Waves):
    """A wave as high as the coordinate's lower crest at -1 or higher one at 1; first order knows the lower alone."""

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves."""
        values = point.parameters.values(point.z)[""]["friction"] * cosine()
        for t in point.z[1:]:
            values = values + (0.8 * np.exp(-2.0 * (t + 1.0)**2) + np.exp(-2.0 * (t - 1.0)**2)) * wave("viscous")
        return Prediction(point, values)

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return differences, of a further effect none beyond the middle."""
        changes = differences(self, prediction, points)
        return np.where([point.effects > prediction.point.effects and point.z[-1] > -0.5 for point in points], 0.0,
                        changes)


@pytest.mark.parametrize(("effect", "crest"), [("backlash", 1.0), ("viscous", -1.0)])
def test_a_play_that_leads_is_begun_everywhere(effect: str, crest: float) -> None:
    """It has several minima, and came to rest in a wrong one; where first order tells, that would only take longer."""
    experiment = TwoCrests(measurement(cosine() + wave("viscous")), (effect,))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    begin_all(search)
    assert search.fits[frozenset({effect})].z[1] == pytest.approx(crest, abs=0.05)


def test_what_does_worse_than_nothing_and_promises_little_is_not_fitted_to_rest() -> None:
    """Two effects that never did better than the baseline took longest, beside one that explained nine tenths."""
    experiment = Waves(measurement(cosine() + wave("viscous") + 0.3 * wave("sensor-inertia")))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    point = {name: Point(experiment.parameters([name]), np.array([0.0, at])) for name, at in (
        ("viscous", 5.0), ("parallel-stiffness", 6.0), ("sensor-inertia", 0.0))}
    search.keep(search.fitter.at(one, first) for one in point.values())
    strategy.to_rest(search, 1)
    assert {name for name in point if search.fits[frozenset({name})].converged} == {"viscous", "sensor-inertia"}


@dataclass(frozen=True)
class Rough(Waves):
    """Waves of a coarse model, whose error a finer one tells where it is asked."""

    told: float = 0.0

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the waves with as much of the error as was put right."""
        plain = super().predict(point, near)
        return Prediction(point, plain.values + self.told * np.sin(16.0 * np.pi * self.measurement.phase + 0.3))

    def corrected(self, prediction: Prediction) -> Rough:  # type: ignore[override]
        """Return the same with the error put right."""
        return replace(self, told=0.05)


@pytest.mark.parametrize("bent", [False, True])
def test_what_is_begun_beside_the_baseline_is_put_right_as_that_is(bent: bool) -> None:
    """Errors that were told at a first baseline had made all effects six times e as probable as nothing."""
    generator = np.random.default_rng(4)
    noise = SD * generator.standard_normal(LOOPS * SAMPLES)
    experiment = Rough(measurement((5.0 if bent else 1.0) * cosine() + noise))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    begin_all(search)
    before = {names: search.log_evidence(names) for names in search.fits}
    corrections.correct(search, [0])
    put_right = [names for names in before if names and names in search.fitters]
    assert bool(put_right) is not bent
    moved = {names: search.log_evidence(names) - before[names] for names in search.fits}
    assert abs(moved[frozenset()]) > 3.0
    for names in put_right:
        assert moved[names] == pytest.approx(moved[frozenset()], abs=1.0)


@dataclass(frozen=True)
class Scattered(Waves):
    """Waves of which one comes with a ripple whose size is left to chance."""

    def by_chance(self, prediction: Prediction) -> Array:
        """Return the ripple of a standard deviation, where the wave is."""
        ripple = 0.3 * np.sin(14.0 * np.pi * self.measurement.phase)[:, None]
        return ripple if "viscous" in prediction.point.effects else ripple[:, :0]


@pytest.mark.parametrize(("made", "fitted"), [("viscous", True), ("support-nonlinearity", False)])
def test_what_is_left_to_chance_is_fitted_where_it_promises_more_than_others_reach(made: str, fitted: bool) -> None:
    """Nothing that is listed explains all, so that every set may hold a share."""
    values = cosine() + wave(made) + 0.4 * np.sin(14.0 * np.pi * measurement().phase) + 0.3 * wave("sensor-inertia")
    experiment = Scattered(measurement(values), ("viscous", "support-nonlinearity"))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    asked: list[str] = []

    def pool(function: Any, arguments: Sequence[Any]) -> list[Any]:
        asked.extend(function.__name__ for _ in arguments)
        return [function(one) for one in arguments]

    search = start_search(experiment, first, FAST, pool)
    begin_all(search)
    assert {frozenset({"viscous"}), frozenset({"support-nonlinearity"})} < set(search.fits)
    assert not strategy.is_explained(search)
    asked.clear()
    allow_for_chance(search)
    assert ("chance_task" in asked) == fitted


@pytest.mark.parametrize(("height", "left", "baselines"), [
    (1.0, 1.0, "baseline"), (50.0, 1.0, "stated, baseline"), (50.0, 0.5, "stated")])
def test_effects_are_begun_beside_a_bent_baseline_where_the_stated_one_led_to_none_that_explains_more(
        height: float, left: float, baselines: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No truth is near it where one does; a hundred fits from a bent one came before those from the stated one."""
    experiment = Waves(measurement(height * cosine()), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search: Any = start_search(
        experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    origins: list[Fit] = []

    def begin(search: Any, origin: Fit) -> list[Any]:
        origins.append(origin)
        objective = left * search.baseline.objective
        search.fits[frozenset({"viscous"})] = SimpleNamespace(objective=objective, chi_squared=1e9)
        return []

    monkeypatch.setattr(strategy, "begin_beside", begin)
    monkeypatch.setattr(strategy, "is_explained", lambda search: False)
    begin_all(search)
    assert origins == [search.stated if name == "stated" else search.baseline for name in baselines.split(", ")]


def test_what_explains_all_beside_the_stated_baseline_needs_no_other_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a bent one, where it leads."""
    experiment = Waves(measurement(50.0 * cosine()), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    origins: list[Fit] = []
    monkeypatch.setattr(strategy, "begin_beside", lambda search, origin: origins.append(origin) or [])
    monkeypatch.setattr(strategy, "is_explained", lambda search: True)
    begin_all(search)
    assert origins == [search.stated]


@pytest.mark.parametrize("hidden", [(), ("viscous",), ("viscous", "support-nonlinearity")])
def test_pairs_are_sought_where_something_is_left_to_explain(hidden: tuple[str, ...]) -> None:
    """None where the baseline leaves noise, and none without it where one effect does; of two the pair is named."""
    noise = SD * np.random.default_rng(11).standard_normal(LOOPS * SAMPLES)
    search = judged(cosine() + 0.5 * sum(map(wave, hidden)) + noise)
    assert all(names & set(hidden) for names in (*leading(search), *search.best(2)))
    assert decide(search).effects == tuple(sorted(hidden))


@pytest.mark.parametrize("hidden", [("viscous",), ("viscous", "support-nonlinearity")])
def test_where_one_explains_all_the_hopeless_are_spared(hidden: tuple[str, ...]) -> None:
    """Of two effects neither alone explains all, and nobody knows of any yet what it may do with another."""
    noise = SD * np.random.default_rng(11).standard_normal(LOOPS * SAMPLES)
    search = judged(cosine() + 0.5 * sum(map(wave, hidden)) + noise)
    search.fits = {names: fit for names, fit in search.fits.items() if len(names) < 2}
    alone = search.best(1)
    assert len(alone) > 1
    assert list(may_hold(search, alone)) == ([frozenset(hidden)] if len(hidden) == 1 else alone)


@dataclass(frozen=True)
class Coarse(Waves):
    """Waves whose coarse model loses a share of what an effect does that grows with it; `restored` of it is known."""

    restored: float = 0.0

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves without what is missing."""
        own, exact = point.parameters.values(point.z), super().predict(point)
        missing = [(0.15 * own[name]["size"]**2 - self.restored) * wave(name) for name in point.effects - point.neutral]
        return replace(exact, values=exact.values - sum(missing, np.zeros(len(exact.values))))

    def corrected(self, prediction: Prediction) -> Coarse:
        """Return the same with what is lost at a prediction."""
        own = prediction.point.parameters.values(prediction.point.z)
        return replace(self, restored=sum(0.15 * own[name]["size"]**2 for name in prediction.point.effects))


def test_numerical_errors_are_put_right_where_the_fit_has_moved_to() -> None:
    """The error at the first fit alone would leave the size at 0.584."""
    experiment: Any = Coarse(measurement(cosine() + 0.6 * wave("viscous")), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    run_search(search, lambda share, text: None)
    fit = search.fits[frozenset({"viscous"})]
    assert fit.parameters.values(fit.z)["viscous"]["size"] == pytest.approx(0.6, abs=0.006)


def test_a_fit_under_other_errors_is_kept_where_it_is_more_probable_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under what its law might be off by, friction that falls with speed went to a rig ten times as damped."""
    experiment: Any = Coarse(measurement(cosine() + 0.6 * wave("viscous")), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    run_search(search, lambda share, text: None)
    names = frozenset({"viscous"})
    best = search.fits[names]
    away = search.fitter_of(names).at(replace(best.prediction.point, z=best.z + np.array([0.0, 8.0])), None)
    search.settled.clear()
    monkeypatch.setattr(corrections, "fit_task", lambda task: away)
    corrections.correct(search, [1])
    assert search.fits[names].z == pytest.approx(best.z, abs=0.1)
    search.fits[names] = away
    search.keep_more_probable(best)
    assert search.fits[names] is best


def test_pairs_are_begun_where_they_promise_to_reach_what_one_effect_alone_does() -> None:
    """Beside the strong one the weak one, beside that, which is more probable, whatever helps, beside another none."""
    noise = SD * np.random.default_rng(3).standard_normal(LOOPS * SAMPLES)
    search = judged(cosine() + 0.6 * wave("viscous") + 0.2 * wave("sensor-inertia") + noise)
    strong, weak, other = (frozenset({name}) for name in ("viscous", "sensor-inertia", "parallel-stiffness"))
    partners = {names: {task.point.effects - names for task in beside(
        search, names, beginnings_beside(search, [(search.fitter, search.fits[names])])[0].values())}
        for names in (strong, weak, other)}
    assert search.best(1)[0] == weak  # by what it leaves, which is smoother
    assert weak in partners[strong]
    assert partners[weak] == {strong, frozenset({"support-nonlinearity"})}
    assert partners[other] == set()  # with the weak one it explains more than alone, and less than the strong one
    laid = beginnings_beside(search, [(search.fitter, search.fits[weak])])[0].values()
    assert beside(search, weak, laid, search.log_evidence(weak)) == []  # those that promise more are fitted
    search.fits.pop(strong | weak)
    assert {task.point.effects for task in beside(search, weak, laid, search.log_evidence(weak))} == {strong | weak}
    assert beside(search, weak, laid, search.fits[weak].objective) == []  # no pair can be so probable


def test_those_that_explain_most_are_bases_beside_those_that_are_most_probable() -> None:
    """What leaves little may be less probable than what leaves more, as that is smoother, and as much as nothing."""
    names = [frozenset({name}) for name in (
        "backlash", "viscous", "scar-edge", "sensor-inertia", "extra-mode", "parallel-stiffness")]
    worth = dict(zip(names, (-1.0, -2.0, -3.0, -4.0, -5.0, -0.5), strict=True))
    left = {frozenset(): 95.0} | dict(zip(names, (90.0, 80.0, 70.0, 20.0, 30.0, 99.0), strict=True))
    search = SimpleNamespace(
        best=lambda size: sorted(names, key=lambda one: -worth[one]), leaves_noise=lambda own: False, effort=FAST,
        compute_signatures=lambda sets: None, log_evidence=worth.__getitem__, chi_squared=left.__getitem__,
        promising=lambda sets: sets)
    assert leading(cast(Search, search)) == [names[0], names[1], names[5], names[3], names[4]]


@pytest.mark.parametrize(("noise", "asked"), [(False, [None, None, -20.0]), (True, [None, None])])
def test_further_partners_follow_where_no_pair_leaves_noise(
        noise: bool, asked: list[float | None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the most probable of the bases, with the best pair's log evidence to go beyond."""
    one, other, pair = frozenset({"viscous"}), frozenset({"backlash"}), frozenset({"viscous", "scar-edge"})
    worth, calls = {one: -40.0, other: -30.0, pair: -20.0}, []
    search = SimpleNamespace(
        experiment=SimpleNamespace(candidates=tuple), compute_signatures=lambda sets: None, fits=worth,
        fitter_of=lambda names: None, best=lambda size: [pair] if size == 2 else [],
        pool=lambda function, tasks: [{} for _ in tasks], keep=lambda fits: None, effort=FAST,
        promising=lambda sets: sets, log_evidence=worth.__getitem__, leaves_noise=lambda names: noise)
    monkeypatch.setattr(strategy, "beside", lambda _, names, laid, beyond=None: calls.append((names, beyond)) or [])
    for name in ("to_rest", "exchange_laws"):
        monkeypatch.setattr(strategy, name, lambda *_: None)
    strategy.seek_partners(cast(Search, search), [one, other])
    assert [beyond for _, beyond in calls] == asked
    assert [names for names, _ in calls] == [one, other, other][:len(asked)]


def test_an_effect_that_was_never_fitted_stands_where_it_was_begun() -> None:
    """Beside the stated baseline or the fitted one; the baseline itself is none, nor is what took a step."""
    at = {"stated": np.zeros(2), "baseline": np.array([1.0, 2.0])}
    search = SimpleNamespace(**{name: SimpleNamespace(z=z) for name, z in at.items()})

    def never_fitted(z: Sequence[float], *effects: str) -> bool:
        return strategy.is_where_begun(cast(Search, search), cast(Fit, SimpleNamespace(z=np.array(z), effects=effects)))

    assert never_fitted([0.0, 0.0, -1.3], "viscous")
    assert never_fitted([1.0, 2.0, 0.5], "viscous")
    assert not never_fitted([0.1, 0.0, -1.3], "viscous")
    assert not never_fitted([1.0, 2.0])


@pytest.mark.parametrize(("effects", "objective", "ratio", "steps"), [
    ({"viscous"}, 300.0, 0.95, 1), ({"viscous"}, 90.0, 0.95, 4), ({"viscous"}, 300.0, 0.4, 4),
    ({"viscous", "backlash"}, 90.0, 0.95, 1), ({"viscous", "backlash"}, 49.0, 0.999, 4),
    ({"viscous", "backlash"}, 90.0, 0.8, 4)])
def test_what_is_worse_than_its_parts_goes_on_where_it_falls_as_it_must_alone(
        effects: set[str], objective: float, ratio: float, steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing leaves 100, backlash 50: where a set moves through its ranges, but not down, it is left."""
    monkeypatch.setattr(strategy, "is_explained", lambda search: False)
    names, taken = frozenset(effects), []

    def fit(objective: float, z: float) -> Any:
        return SimpleNamespace(effects=names, objective=objective, z=np.array([z]), converged=False)

    def pool(function: Any, asked: list[Any]) -> list[Any]:
        taken.extend(asked)
        return [fit(ratio * one.objective, one.z[0] + 1.0) for one in asked]

    search: Any = SimpleNamespace(
        pool=pool, further=lambda one, count: one, keep=lambda fits: None,
        fits={frozenset(own): SimpleNamespace(objective=left) for own, left in (((), 100.0), ({"backlash"}, 50.0))})
    strategy.go_on(search, [fit(objective, 0.0)], 4)
    assert len(taken) == steps


def test_how_much_corrections_change_is_how_far_another_set_may_be_behind() -> None:
    """A set e^20 less probable holds no share of the posterior, unless errors of as much are put right."""
    search = judged(cosine() + 0.6 * wave("viscous"))
    best, other = frozenset({"viscous"}), frozenset({"sensor-inertia"})
    behind = search.log_evidence(best, frozenset()) - search.log_evidence(other, frozenset())
    assert behind > 20.0
    assert search.promising([best, other]) == [best]
    assert search.promising([best, other], behind - 20.0) == [best]
    assert search.promising([best, other], behind) == [best, other]


@dataclass(frozen=True)
class Halting(Waves):
    """Waves whose predictions are of the model with finer steps alone, as those of a fit that came to a halt."""

    fine: bool = False

    def has_made(self, prediction: Prediction) -> bool:
        """Tell whether it is the finer model."""
        return self.fine

    def finer(self) -> Any:
        """Return the finer model; None of that itself."""
        return None if self.fine else replace(self, fine=True)


def test_a_fit_that_came_to_a_halt_stays_with_the_finer_steps_that_went_on() -> None:
    """Else what an effect does would be told by the difference of two models, and each further step be made twice."""
    experiment: Any = Halting(measurement(cosine() + 0.6 * wave("viscous")), ("viscous",))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    own: Any = search.fitter_of(frozenset()).experiment
    assert own.fine
    again: Any = search.further(search.baseline, 1).fitter.experiment
    assert again.fine
    missing: Any = search.fitter_of(frozenset({"viscous"})).experiment
    assert not missing.fine
    asked: list[Any] = []

    def begin(function: Any, arguments: Sequence[Any]) -> list[Any]:
        asked.extend(one[0].experiment.fine for one in arguments if isinstance(one, tuple))
        return [function(one) for one in arguments]

    search.pool = begin
    begin_all(search)
    assert asked
    assert all(asked)  # effects begin with the steps of the fit that they begin beside


@dataclass(frozen=True)
class Springs(Waves):
    """Loops whose first wave an asperity law adds, growing by `gain` over the test where it evolves."""

    listed: tuple[str, ...] = ("contact-stiffness", "contact-stiffness-evolution", "viscous")

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the size of the cosine, the stiffness and how much that grows."""
        fields = {"contact-stiffness": ("stiffness",), "contact-stiffness-evolution": ("stiffness", "gain"),
                  "viscous": ("damping",)}
        own = tuple(Coordinate.within(name, field, *(0.01, 1.0) if field == "gain" else (1.0, 10.0), True)
                    for name in sorted(effects) for field in fields[name])
        return Parameters(tuple(sorted(effects)), (*BASELINE, *own))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves."""
        own, share = point.parameters.values(point.z), self.measurement.cycles
        values = own[""]["friction"] * cosine() + own.get("viscous", {}).get("damping", 0.0) * wave("viscous")
        for name in ("contact-stiffness", "contact-stiffness-evolution"):
            if name in point.effects:
                growth = 1.0 + own[name].get("gain", 0.0) * share
                values = values + own[name]["stiffness"] * growth * wave("support-nonlinearity")
        return Prediction(point, values)


@pytest.mark.parametrize("beside", [(), ("viscous",)])
@pytest.mark.parametrize(("known", "stuck"), [
    ("contact-stiffness", "contact-stiffness-evolution"), ("contact-stiffness-evolution", "contact-stiffness")])
def test_a_law_is_begun_where_one_that_it_extends_or_that_extends_it_was_fitted(
        known: str, stuck: str, beside: tuple[str, ...]) -> None:
    """A fit that stands still far off is no reason not to: alone, or beside another effect."""
    bare = Springs(measurement(cosine()))
    there = bare.parameters([known, *beside])
    wanted = np.array([0.2, *(0.4 for one in there.coordinates[1:])])
    wanted[[one.field == "gain" for one in there.coordinates]] = -4.0  # 0.1 per cent
    experiment = Springs(measurement(bare.predict(Point(there, wanted)).values))
    search = Search(experiment, lambda function, arguments: [function(one) for one in arguments], FAST)
    space = experiment.parameters([stuck, *beside])
    for point in (Point(experiment.parameters(()), np.zeros(1)), Point(there, wanted),
                  Point(space, np.full(space.size, 3.0))):
        fit = search.fitter.at(point, None)
        search.fits[point.effects] = replace(fit, converged=True)
    both = [frozenset([one, *beside]) for one in (known, stuck)]
    assert search.fits[both[1]].chi_squared > 100.0 * search.fits[both[0]].chi_squared + 1e4
    exchange_laws(search, len(both[0]))
    assert search.fits[both[1]].chi_squared == pytest.approx(search.fits[both[0]].chi_squared, abs=3.0)
    before = search.fits[both[1]]
    exchange_laws(search, len(both[0]))
    assert search.fits[both[1]] is before


@dataclass(frozen=True)
class Untold(Waves):
    """Loops of whose first wave derivatives know nothing."""

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return differences, none by that wave."""
        changes = differences(self, prediction, points)
        beside = [point.effects > prediction.point.effects and "viscous" in point.effects for point in points]
        return np.where(beside, 0.0, changes)


def test_an_effect_of_which_first_order_promises_nothing_is_fitted_where_nothing_else_explains_all() -> None:
    """Where it is begun it does twice as much as it should, and no slope leads away; another explains more."""
    experiment = Untold(measurement(cosine() + 0.3 / 2.2 * wave("viscous") + 0.3 * wave("parallel-stiffness")))
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, replace(FAST, bases=0, partners=0), lambda function, arguments: [
        function(one) for one in arguments])
    run_search(search, lambda share, text: None)
    assert search.fits[frozenset({"parallel-stiffness"})].objective < 500.0
    assert not search.fits[frozenset({"viscous"})].provisional


@pytest.mark.parametrize("bend", [0.0, 6.0])
def test_what_bent_parameters_leave_to_a_new_effect_is_what_the_whole_density_tells(bend: float) -> None:
    """Beside a parameter bent six standard deviations an effect that does the same is worth e^15, and nothing at none.

    Both densities are those of the whole covariance, written out.
    """
    rng = np.random.default_rng(0)
    others = 5.0 * rng.normal(size=(40, 3))
    columns = np.column_stack([3.0 * others[:, 0] + 0.2 * rng.normal(size=40), rng.normal(size=40)])
    values = others @ [bend, -0.3, 0.2] + rng.normal(size=40)
    at = np.linalg.solve(np.eye(3) + others.T @ others, others.T @ values)

    def density(all_columns: np.ndarray) -> float:
        return float(multivariate_normal.logpdf(values, cov=np.eye(40) + all_columns @ all_columns.T))

    gain = log_gain(columns, values - others @ at, others, at)
    assert gain == pytest.approx(density(np.hstack([others, columns])) - density(others), abs=1e-8)
    assert (gain > 10.0) is (bend > 0.0)


def test_an_effect_without_which_there_is_no_solution_shows_by_what_the_others_explain() -> None:
    """It showed nothing, and a pair of which either half explained too little was no pair."""
    names, alone = frozenset({"backlash", "viscous"}), frozenset({"backlash"})
    fits = {one: SimpleNamespace(prediction=SimpleNamespace(point=Point(Parameters((), {}), np.zeros(0))),
                                 predicted=np.full(3, size)) for one, size in ((names, 5.0), (alone, 2.0))}
    search: Any = SimpleNamespace(fits=fits, _signatures={}, fitter_of=lambda names: None,
                                  pool=lambda function, tasks: [np.full(3, 4.0) if "viscous" not in task.point.neutral
                                                                else None for task in tasks])
    Search.compute_signatures(search, [names])
    assert np.array_equal(search._signatures[names][1], np.column_stack([np.full(3, 1.0), np.full(3, 3.0)]))
    del fits[alone]
    search._signatures = {}
    Search.compute_signatures(search, [names])
    assert np.array_equal(search._signatures[names][1][:, 1], np.zeros(3))
