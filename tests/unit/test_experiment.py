"""Parameters as coordinates, and derivatives of an experiment that has none of its own, against what is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Prior
from fretflow.effects.initial_gap import InitialGap
from fretflow.inference.experiment import Measurement, Point, Prediction, differences, jacobian, put_out
from fretflow.inference.parameters import Array, Coordinate, Parameters

BASELINE = (Coordinate("", "stiffness", log(2.0), 0.5, True), Coordinate("", "limit", 1.0, 0.1, False))


@dataclass(frozen=True)
class Line:
    """Three values, ``stiffness * (1, 2, 3) + limit``; a dashpot adds its share of the last."""

    measurement: Measurement

    def candidates(self) -> tuple[str, ...]:
        """Return the one effect."""
        return ("viscous",)

    def together(self, effects: Sequence[str]) -> bool:
        """Return that it may act."""
        return True

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return two coordinates of the baseline and those of effects."""
        return Parameters.of(BASELINE, effects, signs)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the line; none of a limit above 2."""
        own = point.parameters.values(point.z)
        if own[""]["limit"] > 1.2:
            raise NonConvergenceError("no line")
        return Prediction(point, own[""]["stiffness"] * np.arange(1.0, 4.0) + own[""]["limit"])

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return differences."""
        return differences(self, prediction, points)

    def before_jump(self, leading: Prediction) -> None:
        """Return nothing: no motion jumps."""

    def finer(self) -> None:
        """Return nothing: there are no numerical errors."""

    def corrected(self, prediction: Prediction) -> None:
        """Return nothing."""


def line() -> Line:
    """Return the experiment; what it measured plays no part."""
    return Line(Measurement.of(np.zeros(3), np.ones(3), channels=("a",), groups=("b",)))


def test_a_range_is_the_90_percent_interval_of_its_parameter() -> None:
    """Coordinates of 1.645 are the ends of a logarithmic range, by their definition."""
    kind = Parameters.of((), ["backlash"])
    (play,) = (one for one in kind.coordinates if one.field == "play")
    half = 1.6448536
    assert [play.value(-half), play.value(half)] == pytest.approx([exp(play.middle - half * play.size),
                                                                  exp(play.middle + half * play.size)])
    assert play.place(play.value(0.7)) == pytest.approx(0.7)


def test_ranges_at_another_size_follow_the_experiment() -> None:
    """A joint of ten times the size has ten times the range: the logarithm's middle moves, its width does not."""
    own, large = (Parameters.of((), ["backlash"], scaled=scaled).coordinates[0] for scaled in (
        None, lambda effect, field, prior: Prior(10.0 * prior.low, 10.0 * prior.high, prior.logarithmic, "")))
    if own.logarithmic:
        assert large.middle - own.middle == pytest.approx(log(10.0))
        assert large.size == pytest.approx(own.size)
    else:
        assert (large.middle, large.size) == pytest.approx((10.0 * own.middle, 10.0 * own.size))


def test_derivatives_by_differences_are_those_of_the_closed_form() -> None:
    """A stiffness changes the line by half its slope, a limit by a tenth; taken inward where there is a limit."""
    experiment = line()
    z = np.array([0.3, 1.99])  # a step further on, the line has no solution: derivatives are taken inward
    derivative = jacobian(experiment, experiment.predict(Point(experiment.parameters(()), z)))
    slope = 0.5 * exp(log(2.0) + 0.5 * 0.3) * np.arange(1.0, 4.0)
    assert derivative == pytest.approx(np.column_stack([slope, np.full(3, 0.1)]), rel=0.01)


def test_what_has_no_solution_is_told_by_nan() -> None:
    """A point beyond the limit has a column of nan, the one beside it its change."""
    experiment = line()
    own = experiment.parameters(())
    changes = differences(experiment, experiment.predict(Point(own, np.zeros(2))),
                          [Point(own, np.array([0.0, 3.0])), Point(own, np.array([0.0, 1.0]))])
    assert np.isnan(changes[:, 0]).all()
    assert changes[:, 1] == pytest.approx(np.full(3, 0.1))


def test_what_first_order_changes_do_not_know_is_differenced() -> None:
    """Changes of nan became a derivative of zero once, with which a fit ended where it began."""
    class Blind(Line):
        def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
            return np.full((len(prediction.values), len(points)), np.nan)

    derivative, known = (jacobian(one, one.predict(Point(one.parameters(()), np.zeros(2))))
                         for one in (Blind(line().measurement), line()))
    assert np.any(known)
    assert derivative == pytest.approx(known)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_an_effect_that_is_put_out_is_neutral_in_what_it_is_named_after(name: str) -> None:
    """Also where what makes it neutral has no range, as the share of an extra mode."""
    kind = catalogue()[name]
    plain, neutral, out = kind(), kind.neutral(), put_out(kind())
    off = [field for field in kind.model_fields if getattr(neutral, field) != getattr(plain, field)]
    assert off
    assert all(getattr(out, field) == getattr(neutral, field) for field in off)


def test_faces_of_which_any_form_is_put_out_are_flat() -> None:
    """Whatever is zero by default may have been fitted: tilt, crown, cylinder and flat at once."""
    space = Parameters.of((), ["initial-gap"])
    (fitted,) = space.built(np.full(space.size, 0.7))
    x = np.linspace(-1.0, 1.0, 5)
    assert isinstance(fitted, InitialGap)
    assert np.ptp(fitted._height(x, x[::-1])) > 1e-6
    assert put_out(fitted)._height(x, x[::-1]) == pytest.approx(np.zeros(5), abs=1e-15)


def test_a_fit_goes_on_on_the_side_of_zero_where_it_is() -> None:
    """A loss that is begun as a gain, and a logarithm, which has no other side."""
    space = Parameters.of((), ["normal-load-drift"], {"normal-load-drift.loss": -1.0})
    at = np.array([space.coordinates[0].place(0.25), 0.4, -0.3])
    turned, z = space.turned(at)
    name = "normal-load-drift"
    assert space.values(at)[name] == pytest.approx(turned.values(z)[name])
    assert turned.signs["normal-load-drift.loss"] == 1.0
    assert abs(z[0]) < 2.0 < abs(at[0])
    assert list(z[1:]) == [0.4, -0.3]
    assert turned.turned(z)[1] == pytest.approx(z)


def test_points_of_a_range_begin_from_the_first_of_them() -> None:
    """A range may lie far from the prediction that it is laid beside, and its points near each other."""
    experiment, neighbours = line(), []

    class Watched(Line):
        def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
            neighbours.append(near)
            return super().predict(point, near)

    own = Watched(experiment.measurement)
    origin = experiment.predict(Point(own.parameters(()), np.zeros(2)))
    space = own.parameters(("viscous",))
    laid = [Point(space, np.r_[0.0, 0.0, at * np.ones(space.size - 2)]) for at in (0.0, -1.0, 1.0)]
    changes = differences(own, origin, [*laid, Point(origin.point.parameters, np.ones(2))])
    assert neighbours[0] is origin
    assert neighbours[3] is origin
    assert neighbours[1] is neighbours[2]
    assert neighbours[1].point is laid[0]
    assert changes[:, -1] == pytest.approx(2.0 * (exp(0.5) - 1.0) * np.arange(1.0, 4.0) + 0.1)
