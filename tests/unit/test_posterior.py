"""What a verdict is held to: the test of the baseline, and what was held out.

What carries the weight: the odds of a p-value against the best of all alternatives ``f(p) = xi p^(xi - 1)``, found by
search; and how often rows of plain noise are said to be predicted worse.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from fretflow.experiments.wear_series.run import left_to_chance
from fretflow.inference import decision
from fretflow.inference import posterior as posteriors
from fretflow.inference.decision import Decision, beyond_noise, decide, detected, held_to, ruled_out
from fretflow.inference.parameters import Array, Parameters
from fretflow.inference.posterior import Posterior, beyond_forms, faint, largest_odds, taken_of_effects
from fretflow.inference.search import Search, Start
from fretflow.inference.verdict import Candidate, Detection, HeldOut, Verdict


def decision_of(verdict: Verdict, none: float = 0.2, explained: float = 0.9) -> Decision:
    """Return a verdict whose posterior gives nothing the probability `none`."""
    sets = () if verdict in (Verdict.NONE, Verdict.UNKNOWN) else (frozenset({"viscous"}),)
    return Decision(verdict, sets, frozenset({"viscous"}), explained, 0.7, (), Posterior({frozenset(): none}, 0.1, {}))


def detection_at(p: float) -> Detection:
    """Return a test of the baseline with that p-value."""
    return Detection(p_value=p, statistic="", tests={}, false_alarm_rate=0.05)


@pytest.mark.parametrize("p", [1e-6, 0.003, 0.05, 0.3])
def test_odds_of_a_p_value_are_those_of_the_best_alternative(p: float) -> None:
    """Under the null p is uniform."""
    shape = np.linspace(1e-4, 1.0, 200_001)
    assert largest_odds(p) == pytest.approx(np.max(shape * p**(shape - 1.0)), rel=1e-6)


def test_a_p_value_that_is_large_or_none_is_worth_nothing_or_all() -> None:
    """At 1 / e the best alternative is the null itself."""
    assert largest_odds(0.4) == largest_odds(1.0) == 1.0
    assert largest_odds(0.0) == np.inf


@pytest.mark.parametrize("verdict", [Verdict.NAMED, Verdict.AMBIGUOUS, Verdict.UNKNOWN])
def test_what_the_test_does_not_see_is_nothing(verdict: Verdict) -> None:
    """Its probability is at least what the test alone leaves to nothing."""
    held = detected(decision_of(verdict), detection_at(0.5))
    assert (held.verdict, held.effects, held.after) == (Verdict.NONE, (), frozenset())
    assert held.probability == 0.5
    assert detected(decision_of(verdict, none=0.6), detection_at(0.5)).probability == 0.6


def test_what_the_test_sees_is_left_to_the_posterior() -> None:
    """What codes differ by is not in the test's null: a clear p-value makes nothing of a verdict, and changes none."""
    for verdict, p in ((Verdict.NONE, 1e-30), (Verdict.NONE, 0.5), (Verdict.NAMED, 1e-3), (Verdict.UNKNOWN, 1e-3)):
        assert detected(decision_of(verdict), detection_at(p)) == decision_of(verdict)


def test_probabilities_leave_to_nothing_what_the_test_of_few_tests_leaves() -> None:
    """A p-value of 0.022 is worth odds of 4.4 at most: beside it nothing is not out of the question."""
    sets = {frozenset({"viscous"}): 0.899, frozenset(): 0.001}
    told = replace(decision_of(Verdict.NAMED), posterior=Posterior(sets, 0.1, {}))
    sure = replace(told, ranking=tuple(Candidate(
        effects=tuple(sorted(names)), probability=share, explained=0.0, chi_squared=0.0, degrees_of_freedom=1,
        log_evidence=0.0) for names, share in told.posterior.sets.items()))
    held = left_to_chance(sure, 0.022)
    assert held.posterior.none == pytest.approx(1.0 / (1.0 + largest_odds(0.022)), rel=1e-12)
    assert 0.18 < held.posterior.none < 0.19
    assert sum(held.posterior.sets.values()) + held.posterior.unlisted == pytest.approx(1.0)
    assert held.probability / sure.probability == pytest.approx((1.0 - held.posterior.none) / 0.999)
    for one in held.ranking:
        assert one.probability == held.posterior.sets[frozenset(one.effects)]
    assert left_to_chance(sure, 1e-9) == sure


def test_a_verdict_that_is_held_back_has_its_probability_in_the_ranking_too() -> None:
    """What rejects a name leaves it no probability on the same page; what tells nothing gives that to nothing."""
    sets = {frozenset({"viscous"}): 0.7, frozenset({"backlash"}): 0.1, frozenset(): 0.05}
    told = replace(decision_of(Verdict.NAMED), posterior=Posterior(sets, 0.15, {}), ranking=tuple(Candidate(
        effects=tuple(sorted(names)), probability=share, explained=0.9, chi_squared=0.0, degrees_of_freedom=1,
        log_evidence=0.0) for names, share in sets.items()))
    for held, none in ((ruled_out(told, "explains nothing"), 0.05), (detected(told, detection_at(0.5)), 0.5)):
        shown = {one.effects: one.probability for one in held.ranking}
        assert shown[()] == none == held.posterior.none
        assert held.probability == pytest.approx(none if held.verdict is Verdict.NONE else 1.0 - none)
        assert sum(shown.values()) + held.posterior.unlisted == pytest.approx(1.0)
        assert shown[("viscous",)] == pytest.approx(0.0 if held.verdict is Verdict.UNKNOWN else 0.7 * 0.5 / 0.95)
        assert [one.probability for one in held.ranking] == sorted(shown.values(), reverse=True)


def test_effects_that_predict_worse_or_explain_nothing_are_not_named() -> None:
    """Better and equal predictions keep the name."""
    def error(after: float) -> HeldOut:
        return HeldOut(what="", before=2.0, after=after, floor=1.0)

    for after in (1.0, 2.0):
        assert held_to(decision_of(Verdict.NAMED), error(after), 1000).verdict is Verdict.NAMED
    for named, told, rows in (
            (decision_of(Verdict.NAMED), error(2.2), 10_000), (decision_of(Verdict.NAMED, explained=0.0), None, 1)):
        worse = held_to(named, told, rows)
        assert (worse.verdict, worse.effects, worse.probability) == (Verdict.UNKNOWN, (), pytest.approx(0.8))
    worse = held_to(decision_of(Verdict.NAMED), error(2.2), 1000)
    assert (worse.verdict, worse.effects) == (Verdict.UNKNOWN, ())
    assert 0.75 < worse.probability < 0.8
    assert held_to(decision_of(Verdict.NONE), error(9.0), 1000).verdict is Verdict.NONE
    assert held_to(decision_of(Verdict.NAMED), error(np.nan), 1000).verdict is Verdict.NAMED  # nothing was compared


def test_few_rows_that_are_predicted_worse_rule_little_out() -> None:
    """Of two errors one may be thrice the other by chance: F's tail of 4 at (2, 2) is 0.2; of a thousand it is none."""
    sets = {frozenset({"viscous"}): 0.9, frozenset(): 0.02}
    told = replace(decision_of(Verdict.NAMED), posterior=Posterior(sets, 0.08, {}))
    worse = HeldOut(what="", before=2.0, after=4.0, floor=1.0)
    few, many = (held_to(told, worse, rows) for rows in (2, 1000))
    assert few.verdict is many.verdict is Verdict.UNKNOWN
    assert few.posterior.listed == pytest.approx(0.98 / (1.0 + largest_odds(0.2)))
    assert few.probability == pytest.approx(1.0 - 0.02 - few.posterior.listed)
    assert 0.5 < few.probability < 0.55
    assert many.probability == pytest.approx(0.98)


def test_noise_alone_is_seldom_a_worse_prediction() -> None:
    """Two independent draws of noise differ by more than their own spread in a quarter of cases at most."""
    rng = np.random.default_rng(0)
    squares = np.sqrt(np.mean(rng.standard_normal((2000, 2, 500))**2, axis=2))
    errors = [HeldOut(what="", before=a, after=b, floor=1.0) for a, b in squares]
    named = [held_to(decision_of(Verdict.NAMED), error, 500).verdict is Verdict.NAMED for error in errors]
    assert 0.7 < np.mean(named) < 0.82  # one-sided, at one over root two of its deviation: 0.76


@pytest.mark.parametrize(("gain", "weaker"), [
    (0.03, 1.0), (-0.03, 1.0), (0.6, 0.174), (0.8, 0.0), (2.0, 0.0)])
def test_a_law_that_adds_less_than_its_range_begins_is_the_law_it_extends(gain: float, weaker: float) -> None:
    """Springs that stiffen by 3 % where a range of 50-400 % is plausible are springs that do not stiffen.

    The 90 % interval of 3.5 is 3.29 sd of 1.064; known to a tenth of these, 60 % are 0.94 of that above its end.
    """
    names = frozenset({"contact-stiffness-evolution"})
    (name,) = names
    space = Parameters.of((), [name], {f"{name}.gain": float(np.sign(gain))})
    at = np.array([one.place(gain) if one.field == "gain" else 0.0 for one in space.coordinates])
    search = SimpleNamespace(fits={names: SimpleNamespace(parameters=space)}, prior=lambda _: None,
                             evidence=lambda _: SimpleNamespace(coordinates=lambda _: (at, 0.01 * np.eye(len(at)))))
    probability = faint(cast(Search, search), names, name)
    assert probability == pytest.approx(weaker, abs=0.005)
    assert (probability > 0.5) is (weaker > 0.5)


@pytest.mark.parametrize("sd", [0.05, 0.3, 2.0])
def test_how_weak_an_effect_is_counts_as_far_as_it_is_known(sd: float) -> None:
    """Springs that stiffen by 45 %, 10 % less than plausible ones begin, are those in as many draws as exceed it."""
    names = frozenset({"contact-stiffness-evolution"})
    (name,) = names
    space = Parameters.of((), [name], {f"{name}.gain": 1.0})
    own = next(one for one in space.coordinates if one.field == "gain")
    at = np.array([one.place(0.45) if one is own else 0.0 for one in space.coordinates])
    search = SimpleNamespace(fits={names: SimpleNamespace(parameters=space)}, prior=lambda _: None,
                             evidence=lambda _: SimpleNamespace(coordinates=lambda _: (at, sd**2 * np.eye(len(at)))))
    draws = own.place(0.45) + sd * np.random.default_rng(5).standard_normal(20_000)
    weaker = float(np.mean([own.value(z) < 0.5 for z in draws]))
    assert faint(cast(Search, search), names, name) == pytest.approx(weaker, abs=0.01)


@pytest.mark.parametrize(("first", "second", "third", "weak"), [
    (0.0, 1e-3, 0.06, False), (0.0, 0.06, 1e-3, False), (0.05, 1e-3, 1e-3, False), (0.005, 1e-3, 1e-3, True)])
def test_of_several_sizes_one_may_be_none(first: float, second: float, third: float, weak: bool) -> None:
    """A drive with a third harmonic and no second one is distorted; with neither, nor another amplitude, it is not."""
    names = frozenset({"excitation-distortion"})
    (name,) = names
    space = Parameters.of((), [name])
    sizes = {"fundamental": first, "second": second, "third": third, "fifth": 1e-4}
    at = np.array([one.place(sizes[one.field]) if one.field in sizes else 0.0 for one in space.coordinates])
    search = SimpleNamespace(fits={names: SimpleNamespace(parameters=space)}, prior=lambda _: None,
                             evidence=lambda _: SimpleNamespace(coordinates=lambda _: (at, 0.01 * np.eye(len(at)))))
    assert faint(cast(Search, search), names, name) == pytest.approx(float(weak), abs=0.01)


def test_what_effects_take_of_each_other_is_the_square_of_the_cosine_between_their_changes() -> None:
    """At 60 degrees a quarter; what the fit tells itself and laws that hold each other are left out.

    An effect along the diagonal of space is too small to be seen, but takes a third of what lies along an axis.
    """
    changes = {"viscous": (100.0, 0.0, 0.0, 7.0), "parallel-stiffness": (50.0, 50.0 * np.sqrt(3.0), 0.0, 3.0),
               "contact-stiffness": (0.0, 0.0, 50.0, 0.0), "contact-stiffness-evolution": (0.0, 0.0, 80.0, 1.0),
               "channel-delay": (0.5, 0.5, 0.5, 0.0)}
    fit = SimpleNamespace(whitened_jacobian=np.array([[0.0, 0.0, 0.0, 2.0]]).T)
    names = frozenset({"backlash"})

    def shares(*effects: str) -> Array:
        starts = [Start(one, np.array([changes[one]]).T, np.array([changes[one]]).T) for one in effects]
        search = SimpleNamespace(fits={names: fit}, starts=starts,
                                 experiment=SimpleNamespace(candidates=lambda: ("any",) * 20))
        return taken_of_effects(cast(Search, search), names)

    assert shares("viscous", "parallel-stiffness") == pytest.approx([0.25, 0.25], rel=1e-9)
    assert shares("contact-stiffness", "contact-stiffness-evolution") == pytest.approx([0.0, 0.0])
    assert shares("contact-stiffness", "channel-delay") == pytest.approx([1.0 / 3.0], rel=1e-9)


@pytest.mark.parametrize(("left", "outside", "others", "odds"), [
    (97.0, 99.0, 10**6, 0.0), (93.0, 99.0, 10**6, 0.1), (60.0, 99.0, 10**6, 14.2), (60.0, 4.0, 10**6, 4.6),
    (60.0, -1.0, 10**6, 0.6), (60.0, 99.0, 99, 5.2), (60.0, 99.0, 1, 1.3)])
def test_what_is_taken_of_mere_noise_counts_by_wilks_test_and_as_another_form(
        left: float, outside: float, others: int, odds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 95 where 100 are expected: more is left, two less are taken by two parameters, 35 less by these.

    Wilks' p is ``exp(-g / 2)`` for a gain g by two parameters, worth at most ``2 exp(g / 2) / (e g)``. What another
    form of the plainer law does as well counts no more than what none does; nor does what would be first of 100 effects
    count for more than 100 (4.6), whatever noise the repeats tell. Half of the published forms differ by 35: 0.6 more.
    """
    monkeypatch.setattr(posteriors, "_outside_forms", lambda *_: outside)
    monkeypatch.setattr(posteriors, "taken_by_chance", lambda *_: np.array([0.01, 0.02]))
    monkeypatch.setattr(posteriors, "taken_of_effects", lambda *_: np.broadcast_to(0.0, others))
    monkeypatch.setattr(posteriors, "form_changes", lambda *_: np.array([10.0]))
    monkeypatch.setattr(posteriors, "law_form_errors", lambda: np.arange(0.1, 1.05, 0.1))
    fewer, wider = frozenset({"viscous"}), frozenset({"viscous", "backlash"})
    search = SimpleNamespace(
        fits={fewer: SimpleNamespace(z=np.zeros(3)), wider: SimpleNamespace(z=np.zeros(5))},
        chi_squared=lambda names: 95.0 if names == fewer else left, by_chance=lambda _: np.zeros((9, 0)),
        experiment=SimpleNamespace(measurement=SimpleNamespace(expected=100.0)))
    assert beyond_forms(cast(Search, search), fewer, wider) == pytest.approx(odds, abs=0.05)


def test_a_pair_is_no_other_form_of_the_effect_that_does_nothing_for_it() -> None:
    """One of two does as much as both do; the other, e^36 less probable by itself, took what both were worth."""
    one, other, third = (frozenset({name}) for name in ("viscous", "backlash", "scar-edge"))
    worth: dict[frozenset[str], float] = {one: -512.0, other: -548.0, third: -515.0, one | other: -510.0}
    search = cast(Search, SimpleNamespace(log_evidence=worth.__getitem__))
    assert posteriors._likeliest(search, one | other, [other, one, third]) == [one, third]
    worth[one | other] = -480.0  # none of them does as much
    assert posteriors._likeliest(search, one | other, [other, one, third]) == [other, one, third]
    assert posteriors._likeliest(search, one | other, []) == []


def test_another_form_of_a_law_is_as_far_out_of_its_ranges_as_the_law_is() -> None:
    """A load that rose by half of itself, where clamps lose a fifth, stood in for friction that runs in."""
    means = {1: np.array([0.0, 4.0]), 2: np.array([0.0, 1.0, 1.0])}
    wider = frozenset({"normal-load-drift", "friction-run-in"})
    search = cast(Search, SimpleNamespace(prior=lambda names: None, evidence=lambda names: SimpleNamespace(
        coordinates=lambda prior: (means[len(names)], None))))
    for name in wider:
        assert posteriors.farther_out(search, frozenset({name}), wider) == pytest.approx(7.0)
    means[1] = np.array([0.0, 1.0])  # nearer than the wider set, which is no merit of it
    assert posteriors.farther_out(search, frozenset({"friction-run-in"}), wider) == 0.0


@pytest.mark.parametrize(("shares", "verdict", "named", "probability"), [
    ((0.3, 0.28, 0.12), Verdict.NAMED, ("viscous",), 0.58),
    ((0.1, 0.6, 0.1), Verdict.NAMED, ("backlash", "viscous"), 0.6),
    ((0.4, 0.05, 0.38), Verdict.AMBIGUOUS, ("scar-edge", "viscous"), 0.78)])
def test_what_acts_whatever_acts_beside_it_is_named(monkeypatch: pytest.MonkeyPatch, shares: tuple[float, ...],
                                                    verdict: Verdict, named: tuple[str, ...],
                                                    probability: float) -> None:
    """Of viscous, viscous with backlash, and a scar's edge: the first alone, or with the second, counts for it."""
    sets = [frozenset({"viscous"}), frozenset({"viscous", "backlash"}), frozenset({"scar-edge"})]
    known = {**dict(sorted(zip(sets, shares, strict=True), key=lambda one: -one[1])), frozenset(): 0.05}
    monkeypatch.setattr(decision, "posterior", lambda _: Posterior(known, 0.95 - sum(shares), {}))
    monkeypatch.setattr(decision, "_ranking", lambda *_: ())
    said = decide(cast(Search, SimpleNamespace(explained=lambda _: 1.0)))
    assert (said.verdict, said.effects) == (verdict, named)
    assert said.probability == pytest.approx(probability)


def test_of_many_sets_those_that_hold_next_to_nothing_are_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all together hold less than half, no number of them would."""
    shares = {"viscous": 0.3, "backlash": 0.15, "scar-edge": 0.01, "extra-mode": 0.001}
    known = {frozenset({name}): share for name, share in shares.items()} | {frozenset(): 0.25}
    monkeypatch.setattr(decision, "posterior", lambda _: Posterior(known, 1.0 - sum(known.values()), {}))
    monkeypatch.setattr(decision, "_ranking", lambda *_: ())
    said = decide(cast(Search, SimpleNamespace(explained=lambda _: 1.0)))
    assert (said.verdict, said.effects) == (Verdict.AMBIGUOUS, ("backlash", "viscous"))


def test_what_is_probable_is_a_mean_over_the_readings_of_a_recording() -> None:
    """Nothing is missing on a finer mesh, something unlisted on the same one; which it is nobody knows."""
    nothing, viscous = frozenset[str](), frozenset({"viscous"})
    finer, same = Posterior({nothing: 0.96}, 0.04, {}), Posterior({nothing: 0.0, viscous: 0.2}, 0.8, {})
    mean = posteriors.averaged(finer, [(0.25, same), (0.25, same)])
    assert mean.none == pytest.approx(0.48)
    assert mean.sets[viscous] == pytest.approx(0.1)
    assert mean.unlisted == pytest.approx(0.42)
    assert posteriors.averaged(finer, []) == finer


@pytest.mark.parametrize(("before", "after", "share"), [
    (300.0, 150.0, 0.75), (95.0, 80.0, 1.0), (95.0, 95.0, 0.0), (95.0, 96.0, 0.0), (300.0, 90.0, 1.0)])
def test_the_share_explained_is_of_what_no_set_shows_to_be_noise(before: float, after: float, share: float) -> None:
    """Of 100 expected: where a set leaves 80 there is no more noise than that."""
    search = SimpleNamespace(chi_squared=lambda names: after if names else before,
                             experiment=SimpleNamespace(measurement=SimpleNamespace(expected=100.0)))
    assert Search.explained(cast(Search, search), frozenset({"viscous"})) == pytest.approx(share)


@pytest.mark.parametrize(("left", "after", "chance", "verdict", "probability"), [
    (90.0, 89.0, 0, Verdict.NONE, 0.5), (90.0, 84.0, 0, Verdict.NONE, 0.493), (90.0, 50.0, 0, Verdict.NAMED, 0.8),
    (90.0, 50.0, 25, Verdict.NONE, 0.5), (130.0, 124.0, 0, Verdict.NAMED, 0.8)])
def test_where_no_more_than_noise_is_left_nothing_is_named(left: float, after: float, chance: int, verdict: Verdict,
                                                           probability: float) -> None:
    """Of 100 that repeats explain 90 are left: their p-value of 0.75 is worth no odds against nothing.

    One parameter takes 6 of noise with a p-value of 0.0143, the best of 20 such with one of 0.286; and never 40, which
    it takes with 25 limits that are left to chance with a p-value of 0.037.
    """
    told = replace(decision_of(Verdict.NAMED), probability=0.8)
    fits = {frozenset(): SimpleNamespace(z=np.zeros(2)), told.after: SimpleNamespace(z=np.zeros(3))}
    search = SimpleNamespace(
        chi_squared=lambda names: after if names else left, fits=fits,
        by_chance=lambda names: np.zeros((9, chance if names else 0)),
        experiment=SimpleNamespace(measurement=SimpleNamespace(expected=100.0), candidates=lambda: ["one"] * 20))
    said = beyond_noise(told, cast(Search, search))
    assert (said.verdict, said.probability) == (verdict, pytest.approx(probability, abs=5e-4))


def test_rivals_are_those_that_a_twentieth_is_left_to() -> None:
    """A name with 0.6 of 0.9 has two; what holds less than all but a twentieth of that together is none."""
    tilt, slope, play = (frozenset({name}) for name in ("friction-tilt", "normal-load-coupling", "backlash"))
    sets = {tilt: 0.6, slope: 0.26, play: 0.04, frozenset[str](): 0.05}
    told = replace(decision_of(Verdict.NAMED), sets=(tilt,), posterior=Posterior(sets, 0.05, {}))
    assert told.rivals == (tilt, slope)
    assert replace(told, posterior=Posterior({**sets, tilt: 0.5, play: 0.14}, 0.05, {})).rivals == (tilt, slope, play)
    assert replace(told, posterior=Posterior({tilt: 0.88, slope: 0.02, frozenset(): 0.05}, 0.05, {})).rivals == (tilt,)
    assert decision_of(Verdict.UNKNOWN).rivals == ()
