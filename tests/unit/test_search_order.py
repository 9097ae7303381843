"""What a search spends its simulations on: in which order effects are looked at, and which pairs are followed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.inference import strategy
from fretflow.inference.beginnings import Beginning, beginnings_task, beside
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.least_squares import Fitter
from fretflow.inference.parameters import Coordinate, Parameters
from fretflow.inference.search import FAST, Search, Task
from fretflow.inference.strategy import beginnings_beside, fit_pairs, run_search, start_search, to_rest
from waves import BASELINE, Waves, cosine, judged, measurement, wave


def one_by_one(function: Any, arguments: Any) -> list[Any]:
    """Call a function on all arguments."""
    return [function(one) for one in arguments]


def started(experiment: Any) -> Search:
    """Return a search with its baseline fitted."""
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    return start_search(experiment, first, FAST, one_by_one)


@dataclass(frozen=True)
class Biased(Waves):
    """Waves whose coarse model adds a tenth of a wave to what any effect does, until that is corrected."""

    bias: float = 0.1

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves, and the bias."""
        prediction = super().predict(point, near)
        error = self.bias * wave("viscous") if point.effects else 0.0
        return Prediction(point, prediction.values + error)

    def corrected(self, prediction: Prediction) -> Biased:
        """Return the same without its error."""
        return Biased(self.measurement, self.listed, bias=0.0)


@pytest.mark.parametrize(("left", "elsewhere"), [(0.0, False), (0.4, True)])
def test_effects_are_begun_elsewhere_only_where_the_leading_ones_leave_more_once_they_are_right(
        left: float, elsewhere: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarse model's error is no reason to: points far off in a range cost as much as all other fits."""
    asked: list[Any] = []
    monkeypatch.setattr(strategy, "begin_elsewhere", lambda search, untold: asked.append(untold))
    values = cosine() + 0.6 * wave("sensor-inertia") + left * wave("parallel-stiffness")
    search = started(Biased(measurement(values), ("sensor-inertia",)))
    run_search(search, lambda share, text: None)
    assert bool(asked) is elsewhere


def test_effects_are_begun_in_two_parts_as_in_one() -> None:
    search = judged(cosine() + 0.6 * wave("viscous"))
    names = frozenset({"viscous"})
    fitter, fit = search.fitter_of(names), search.fits[names]
    whole = beginnings_task((fitter, fit, search.experiment.candidates()))
    (parts,) = beginnings_beside(search, [(fitter, fit)])
    assert parts.keys() == whole.keys()
    assert len(whole) == 3
    for key, one in whole.items():
        assert parts[key].point.effects == one.point.effects
        np.testing.assert_allclose(parts[key].point.z, one.point.z)
        np.testing.assert_allclose(parts[key].change, one.change, rtol=1e-12)


def test_a_partner_begins_where_it_promises_most_and_where_it_does_least() -> None:
    """What promises most by first order may do far too much; the pair goes on from the better start."""
    search = judged(cosine() + 0.6 * wave("viscous") + 0.2 * wave("sensor-inertia"))
    strong, pair = frozenset({"viscous"}), frozenset({"viscous", "sensor-inertia"})
    (laid,) = beginnings_beside(search, [(search.fitter, search.fits[strong])])
    own = next(one for one in laid.values() if one.point.effects == pair)
    weaker = replace(own.point, z=own.point.z - [1.0, 0.0, 0.0])
    tasks = beside(search, strong, [replace(own, least=weaker)])
    assert [list(task.point.z) for task in tasks] == [list(own.point.z), list(weaker.z)]
    gone: list[Any] = []
    search.pool = lambda function, asked: gone.append([one.point.z for one in asked]) or one_by_one(function, asked)
    for order in (tasks, tasks[::-1]):
        search.fits.pop(pair, None)
        gone.clear()
        fit_pairs(search, order)
        assert len(gone[0]) == 2
        best = min((search.fitter.at(task.point, None) for task in tasks), key=lambda fit: fit.objective)
        assert np.array_equal(gone[1], [best.z])


def test_a_pair_goes_on_from_beside_either_of_its_effects() -> None:
    """Which of two valleys is the deeper one does not show where they are begun."""
    search = judged(cosine() + 0.6 * wave("viscous") + 0.2 * wave("sensor-inertia"))
    one, other = frozenset({"viscous"}), frozenset({"sensor-inertia"})
    tasks = [Task(search.fitter, search.fits[one | other].prediction.point, search.fits[names].prediction, 0)
             for names in (one, other, one)]
    gone: list[int] = []
    search.pool = lambda function, asked: gone.append(len(asked)) or one_by_one(function, asked)
    search.fits.pop(one | other)
    fit_pairs(search, tasks)
    assert gone[:2] == [3, 2]


@pytest.mark.parametrize(("pair", "fitted"), [(-12.0, True), (-20.0, False), (1.0, True)])
def test_pairs_that_are_worse_than_one_effect_alone_are_not_fitted_to_rest(pair: float, fitted: bool) -> None:
    """By as much as counts for nothing, a factor of a thousand; the best effect alone has a log evidence of -10.

    Nor is a pair that another one is so much better than.
    """
    one, two, far = (frozenset(names) for names in (("viscous",), ("viscous", "backlash"), ("viscous", "scar-edge")))
    worth, asked = {one: -10.0, two: pair, far: pair - 10.0}, list[Any]()
    known: Any = SimpleNamespace(
        fits={names: SimpleNamespace(converged=False) for names in worth}, effort=FAST,
        best=lambda size: [one] if size == 1 else [two, far], log_evidence=lambda names, laws: worth[names],
        continue_fits=lambda sets, steps: asked.extend(sets))
    known.promising = lambda sets: Search.promising(known, sets)
    to_rest(known, 2)
    assert (two in asked) is fitted
    assert not {one, far} & {*asked}


def test_beginnings_of_nothing_that_first_order_tells_are_of_nothing() -> None:
    search = judged(cosine() + 0.6 * wave("viscous"))
    beginnings: dict[Any, Beginning] = beginnings_task((search.fitter, search.baseline, []))
    assert beginnings == {}


@dataclass(frozen=True)
class Strong(Waves):
    """Waves of effects with one strength, or with two that do alike."""

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the size of the cosine, and the strengths of the effects."""
        fields = {"initial-gap": ("crown", "cylinder"), "bending-gap": ("height",)}
        own = [Coordinate(name, field, 2e-6, 1e-6, False, 0.0) for name in sorted(effects) for field in fields[name]]
        return Parameters(tuple(sorted(effects)), (*BASELINE, *own))

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the cosine and a wave as strong as the effects."""
        own = point.parameters.values(point.z)
        strength = sum(value for name in point.effects for value in own[name].values())
        return Prediction(point, np.asarray(own[""]["friction"] * cosine() + 1e5 * strength * wave("viscous")))


def test_an_effect_of_several_strengths_is_begun_where_all_are_weak() -> None:
    """Beside the middle along one of them the others do as much as there; of a single one that is weak enough."""
    experiment: Any = Strong(measurement(cosine() + 0.07 * wave("viscous")))
    fitter = Fitter(experiment, experiment.measurement.covariance())
    origin = fitter.at(Point(experiment.parameters(()), np.zeros(1)), None)
    begun = {name: [one.point.z[1:] for one in beginnings_task((fitter, origin, [name])).values()]
             for name in ("initial-gap", "bending-gap")}
    assert begun["initial-gap"] == [pytest.approx([-1.645, -1.645], abs=1e-3)]
    assert begun["bending-gap"] == [pytest.approx([-1.349], abs=1e-3)]
