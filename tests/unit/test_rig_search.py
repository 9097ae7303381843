"""Which sets of effects are chosen and how sure the verdict is, on fits whose evidence is given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.experiments.rig import run as rig_run
from fretflow.experiments.rig.coordinates import Space
from fretflow.experiments.rig.course import FAST, FULL, Effort, chosen_set, contenders, refine, start_search
from fretflow.experiments.rig.detection import GAINS
from fretflow.experiments.rig.screening import Signatures, Start, swapped
from fretflow.experiments.rig.search import LEAST_GAIN, SLACK, RigSearch
from fretflow.experiments.rig.verdict import UNLISTED, decide, held_to
from fretflow.inference.verdict import Detection, HeldOut, Verdict

EXPECTED = 1000.0


@dataclass(frozen=True, eq=False)
class FakeFit:
    """A fit of which only the misfit is known."""

    chi_squared: float
    converged: bool = True
    z: np.ndarray = field(default_factory=lambda: np.zeros(4))
    residual: np.ndarray = field(default_factory=lambda: np.zeros(2000))
    space: Any = field(default_factory=lambda: Space.of(()))
    simulation: Any = None
    whitened_jacobian: np.ndarray = field(default_factory=lambda: np.eye(2000, 4))

    @property
    def objective(self) -> float:
        """Return that of a fit at the middle of its ranges."""
        return self.chi_squared

    @property
    def log_evidence(self) -> float:
        """Return that of a fit whose parameters cost nothing."""
        return -0.5 * self.chi_squared


def searched(**fits: float) -> RigSearch:
    """Return a search with chi-squared by set: names joined by two underscores, `none` for the baseline."""
    observation = SimpleNamespace(noise=np.ones(int(EXPECTED)), smooth_share=0.05)
    fitter: Any = SimpleNamespace(rig=SimpleNamespace(observation=observation))
    names = {key: frozenset() if key == "none" else frozenset(key.split("__")) for key in fits}
    made: Any = {names[key]: FakeFit(value) for key, value in fits.items()}
    return RigSearch(fitter, lambda function, arguments: [function(one) for one in arguments], made)


def seen(p_value: float) -> Detection:
    """Return a detection with a p-value."""
    return Detection(p_value=p_value, statistic="s", tests={"s": p_value}, false_alarm_rate=0.05)


def test_one_effect_that_explains_all_is_named() -> None:
    """The baseline leaves nine times the noise, one effect nothing, the others most of it."""
    found = searched(none=9000.0, viscous=1010.0, backlash=7000.0)
    assert chosen_set(found) == {"viscous"}
    verdict = decide(found, chosen_set(found), seen(1e-9))
    assert verdict.verdict is Verdict.NAMED
    assert verdict.effects == ("viscous",)
    assert verdict.explained == pytest.approx(1.0)
    assert verdict.probability > 0.9
    misfits = [one.chi_squared / one.degrees_of_freedom for one in verdict.ranking]
    assert misfits == pytest.approx([1.01, 7.0, 9.0], rel=0.01)


def test_second_effect_must_earn_its_place() -> None:
    """What a second effect takes off a law that is not quite the catalogue's is no second effect."""
    assert chosen_set(searched(none=9000.0, viscous=1600.0, viscous__backlash=1500.0)) == {"viscous"}
    assert chosen_set(searched(none=9000.0, viscous=5000.0, viscous__backlash=1050.0)) == {"viscous", "backlash"}


def test_a_pair_that_falls_short_leaves_the_place_to_the_next_best() -> None:
    """The best pair's second effect explains a share too small; another pair's first effect leaves as much, and all."""
    fits = {"none": 9000.0, "viscous": 1400.0, "backlash": 8000.0, "viscous__third": 1210.0,
            "backlash__fourth": 1240.0, "fourth": 5000.0}
    assert chosen_set(searched(**fits)) == {"backlash", "fourth"}
    assert chosen_set(searched(**fits | {"viscous__third": 1130.0})) == {"viscous", "third"}


def test_a_law_that_extends_another_must_earn_what_it_adds() -> None:
    """Springs that change explain a little more than springs: both stay open. They explain much more: no doubt."""
    narrow, wide = frozenset({"contact-stiffness"}), frozenset({"contact-stiffness-evolution"})
    for gain, chosen, verdict in ((2.0 * LEAST_GAIN - 2.0, narrow, Verdict.AMBIGUOUS),
                                  (8.0 * LEAST_GAIN, wide, Verdict.NAMED)):
        found = searched(none=9000.0)
        found.fits[narrow], found.fits[wide] = FakeFit(1200.0), FakeFit(1200.0 - gain)  # type: ignore[assignment]
        assert chosen_set(found) == chosen
        decided = decide(found, chosen_set(found), seen(1e-9))
        assert decided.verdict is verdict
        assert wide in decided.sets


def test_what_codes_differ_by_is_not_asked_of_a_second_effect() -> None:
    """One effect leaves a little more than codes differ by in the mean: what a second one takes is most of that."""
    assert chosen_set(searched(none=9000.0, viscous=1130.0, viscous__backlash=1090.0)) == {"viscous", "backlash"}
    assert chosen_set(searched(none=9000.0, viscous=1130.0, viscous__backlash=1100.0)) == {"viscous"}


def test_a_baseline_is_lost_only_where_nothing_explains_it() -> None:
    """Far off and half explained, it is; far off and all explained, or near, it is not."""
    assert searched(none=30000.0, viscous=15000.0).lost
    assert not searched(none=30000.0, viscous=1100.0).lost
    assert not searched(none=9000.0, viscous=5000.0).lost


@pytest.mark.parametrize(("best", "going_on"), [(1010.0, {"viscous", "backlash"}),
                                                (5000.0, {"viscous", "backlash", "third"})])
def test_what_cannot_come_near_is_not_fitted_further(best: float, going_on: set[str]) -> None:
    """Where one effect explains all, those that promise no half of its fit's quality stay; else all go on."""
    found = searched(none=30000.0, viscous=best, backlash=1900.0 + best - 1010.0, third=20000.0)
    found.fitter = SimpleNamespace(rig=found.fitter.rig, promise=lambda fit: fit.objective)  # type: ignore[assignment]
    assert {name for names in contenders(found, found.best(1, 3)) for name in names} == going_on


def test_what_looks_like_the_first_effect_must_explain_more() -> None:
    """A law that is wrong by a fifth leaves 4 %, and its nearest kin takes that; what looks otherwise is an effect."""
    space = Space.of(("viscous", "velocity-dependent-friction"))
    own = [one.effect for one in space.coordinates]
    apart = np.eye(2000, len(own))
    kin = apart.copy()
    kin[:, own.index("velocity-dependent-friction")] = np.sqrt(0.5) * (apart[:, own.index("viscous")] + apart[:, -1])
    chosen = []
    for white in (apart, kin):
        found = searched(none=31000.0, viscous=1950.0)
        found.fits[frozenset(own) - {""}] = FakeFit(1010.0, space=space, whitened_jacobian=white)  # type: ignore[assignment]
        chosen.append(chosen_set(found))
    assert chosen == [{"viscous", "velocity-dependent-friction"}, {"viscous"}]


def test_gain_within_what_codes_differ_by_is_no_effect() -> None:
    """An effect that takes off less than the least gain is not taken."""
    base = 1000.0 * SLACK
    assert chosen_set(searched(none=base, viscous=base - 2.0 * LEAST_GAIN + 2.0)) == frozenset()
    assert chosen_set(searched(none=base, viscous=base - 2.0 * LEAST_GAIN - 2.0)) == {"viscous"}


def test_two_that_explain_alike_are_ambiguous() -> None:
    """Evidence that differs by no more than codes do leaves both open."""
    found = searched(none=9000.0, viscous=1010.0, backlash=1014.0, third=6000.0)
    verdict = decide(found, chosen_set(found), seen(1e-9))
    assert verdict.verdict is Verdict.AMBIGUOUS
    assert set(verdict.sets) == {frozenset({"viscous"}), frozenset({"backlash"})}


def test_nothing_of_the_catalogue_is_unknown() -> None:
    """The best effect explains half of what is left."""
    found = searched(none=9000.0, viscous=5000.0, backlash=7000.0)
    verdict = decide(found, chosen_set(found), seen(1e-9))
    assert verdict.verdict is Verdict.UNKNOWN
    assert verdict.effects == ()
    assert verdict.explained == pytest.approx(4000.0 / (4000.0 + 5000.0 - SLACK * 1000.0))
    assert verdict.probability == UNLISTED


@pytest.mark.parametrize(("gains", "harmonics", "verdict"), [
    (0.008, 0.9, Verdict.NONE), (1e-9, 0.9, Verdict.UNKNOWN), (0.008, 0.009, Verdict.UNKNOWN)])
def test_a_promise_that_no_fit_keeps_is_nothing(gains: float, harmonics: float, verdict: Verdict) -> None:
    """Screening sees a little more than chance, and no fit does: nothing is left out.

    What chance does not make, or another test sees as well, stays unexplained.
    """
    found = searched(none=1200.0, viscous=1199.0)
    promise: Any = SimpleNamespace(columns={"viscous": None}, gain=lambda names: 9.0)
    found.screened[frozenset()] = promise
    assert chosen_set(found) == frozenset()
    detection = Detection(p_value=2.0 * gains, statistic=GAINS, tests={GAINS: gains, "harmonics": harmonics},
                          false_alarm_rate=0.05)
    assert decide(found, frozenset(), detection).verdict is verdict


def test_faint_effects_are_less_sure() -> None:
    """Where the baseline's misfit is within what codes differ by, the gate cannot tell listed from unlisted effects."""
    sure, faint = (decide(found, chosen_set(found), seen(1e-9)).probability for found in (
        searched(none=31000.0, viscous=1010.0), searched(none=1240.0, viscous=1010.0)))
    assert faint < 0.6 < 0.95 < sure


def test_a_bad_fit_is_no_name_though_it_explains_most() -> None:
    """Nine tenths of a misfit explained, and still more than noise left; or nearly all of a very large one."""
    for before, after, verdict in ((31000.0, 4000.0, Verdict.UNKNOWN), (9000.0, 1600.0, Verdict.UNKNOWN),
                                   (9000.0, 1450.0, Verdict.NAMED), (310000.0, 4000.0, Verdict.NAMED)):
        found = searched(none=before, viscous=after)
        assert decide(found, chosen_set(found), seen(1e-9)).verdict is verdict


def test_motion_that_does_not_repeat_itself_has_no_name() -> None:
    """Repeats that differ smoothly are beyond the catalogue, unless that is small beside what it explains."""
    for before, verdict in ((9000.0, Verdict.UNKNOWN), (310000.0, Verdict.NAMED)):
        found = searched(none=before, viscous=1010.0)
        found.fitter.rig.observation.smooth_share = 0.9  # type: ignore[misc]
        assert decide(found, chosen_set(found), seen(1e-9)).verdict is verdict


def test_intervals_widen_with_what_the_best_fit_leaves() -> None:
    """Parameters of a fit that leaves four times the noise are twice as uncertain."""
    found = searched(none=90000.0, viscous=4000.0)
    assert decide(found, chosen_set(found), seen(1e-9)).widened == pytest.approx(2.0)


class FakeFitter:
    """A fitter whose fits take off half of what is left above the noise at each step."""

    rig = SimpleNamespace(observation=SimpleNamespace(noise=np.ones(int(EXPECTED))))

    def __init__(self, start: float) -> None:
        self.start, self.steps = start, list[int]()

    def fit(self, space: Any, z: Any, near: Any, iterations: int, worth: float = np.inf) -> FakeFit:
        """Return a fit that has come to rest where less than a hundredth of the noise is left above it."""
        self.steps.append(iterations)
        left = (near.chi_squared if isinstance(near, FakeFit) else self.start) - EXPECTED
        found = FakeFit(EXPECTED + left / 2.0**iterations, left / 2.0**iterations < 0.01 * EXPECTED)
        return replace(found, simulation=found)


@pytest.mark.parametrize(("start", "effort", "steps", "rest"), [
    (1.05, FAST, [4], True), (2.0, FAST, [4, 4], True), (90.0, FAST, [4], False), (90.0, FULL, [8], False)])
def test_a_baseline_goes_on_to_rest_unless_it_is_astray(start: float, effort: Effort, steps: list[int], rest: bool
                                                        ) -> None:
    """A screening fits four steps, and four more where the baseline may be all there is and has not come to rest."""
    fitter: Any = FakeFitter(start * EXPECTED)
    found = start_search(fitter, None, effort, lambda function, arguments: [function(one) for one in arguments])
    assert fitter.steps == steps
    assert found.baseline.converged is rest


def test_a_fit_that_is_carried_on_and_stays_has_come_to_rest() -> None:
    """Nothing is gained by more steps: the fit is kept as it was, and counts as finished."""
    found = searched(none=9000.0, viscous=1010.0)
    one = frozenset({"viscous"})
    kept: Any = replace(found.fits[one], converged=False)
    found.fits[one], found.fitter = kept, SimpleNamespace(fit=lambda *asked: FakeFit(1010.0))
    refine(found, one)
    assert found.fits[one].converged
    assert found.fits[one].z is kept.z


def test_polishing_nothing_leaves_the_baseline_alone() -> None:
    """What was screened stands beside the baseline as it was then."""
    found = searched(none=9000.0)
    before: Any = replace(found.baseline, converged=False)
    found.fits[frozenset()] = before
    refine(found, frozenset())
    assert found.baseline is before


def test_an_effect_gives_way_to_one_that_extends_its_law_and_back() -> None:
    """What both laws have stays as it was fitted, the baseline and other effects too; the rest is in the middle."""
    space = Space.of(("contact-stiffness", "viscous"))
    fit: Any = FakeFit(1.0, space=space, z=0.1 * np.arange(1.0, space.size + 1.0))
    at = {one.name.replace("contact-stiffness", "*"): z for one, z in zip(space.coordinates, fit.z, strict=True)}
    begun_at = swapped(fit)
    assert {one.effects for one, _ in begun_at} == {("contact-stiffness-evolution", "viscous")}
    for wider, z in begun_at:
        found = {one.name.replace("contact-stiffness-evolution", "*"): value
                 for one, value in zip(wider.coordinates, z, strict=True)}
        assert found == at | {"*.gain": 0.0, "*.energy": 0.0}
    back: Any = FakeFit(1.0, space=begun_at[0][0], z=begun_at[0][1])
    (narrower, z), = swapped(back)
    assert narrower.effects == space.effects
    assert z == pytest.approx(fit.z)
    assert swapped(FakeFit(1.0, space=Space.of(("backlash",)), z=np.zeros(9))) == []  # type: ignore[arg-type]


@pytest.mark.parametrize(("after", "verdict"), [(1.2, Verdict.NAMED), (1.5, Verdict.NAMED), (1.53, Verdict.UNKNOWN)])
def test_what_does_not_help_to_predict_is_not_named(after: float, verdict: Verdict) -> None:
    """An effect that fits the loops it was shown and predicts the others worse is no explanation."""
    found = searched(none=9000.0, viscous=1010.0)
    named = decide(found, chosen_set(found), seen(1e-9))
    held = held_to(named, HeldOut(what="loops", before=1.5, after=after, floor=1.0))
    assert held.verdict is verdict
    assert held.effects == (("viscous",) if verdict is Verdict.NAMED else ())
    assert held_to(named, None) is named


@pytest.mark.parametrize(("second", "verdict", "after"), [(1.2, Verdict.AMBIGUOUS, "channel-delay"),
                                                          (1.6, Verdict.UNKNOWN, "viscous")])
def test_alternatives_are_held_to_what_they_predict_in_turn(monkeypatch: pytest.MonkeyPatch, second: float,
                                                            verdict: Verdict, after: str) -> None:
    """Of two effects that fit alike, one predicts held-out loops badly; the verdict stands on the other, if it can."""
    found = searched(none=9000.0, viscous=1010.0, **{"channel-delay": 1010.5})
    alike = decide(found, chosen_set(found), seen(1e-9))
    assert (alike.verdict, alike.after) == (Verdict.AMBIGUOUS, frozenset({"viscous"}))
    errors = {"viscous": 2.0, "channel-delay": second}

    def held_out(looked: RigSearch, names: frozenset[str]) -> Any:
        return SimpleNamespace(error=HeldOut(what="loops", before=1.5, after=errors[min(names)], floor=1.0))

    monkeypatch.setattr(rig_run, "held_out", held_out)
    held, unseen = rig_run._held(found, alike)
    assert held.verdict is verdict
    assert held.after == {after}
    assert unseen.error.after == errors[after]


def test_effect_that_is_linear_begins_between_its_starts() -> None:
    """Data made of a tilt and a crown are met at once, although no start has both; bent columns keep their start."""
    rng = np.random.default_rng(4)
    space = Space.of(("initial-gap",))
    own = [one for one in space.coordinates if one.effect]
    slopes = 1e8 * rng.standard_normal((60, len(own)))  # by the parameters in m, whitened
    points = [way * np.eye(len(own))[i] for i in range(len(own)) for way in (0.0, 1.2, -1.2)]
    starts = tuple(Start("initial-gap", z, {}) for z in points)
    columns = np.column_stack([slopes @ [one.value(at) for one, at in zip(own, z, strict=True)] for z in points])
    true = np.array([-0.9e-6, 0.0, 1.4e-6, 0.0])
    begun_at = Signatures(slopes @ true, {"initial-gap": columns}, {"initial-gap": starts}).begin("initial-gap")
    assert len(begun_at) == 1
    found = [one.value(at) for one, at in zip(own, begun_at[0].z, strict=True)]
    assert found == pytest.approx(true, abs=5e-8)
    bent = columns + 0.5 * np.abs(columns)
    kept = Signatures(slopes @ true, {"initial-gap": bent}, {"initial-gap": starts}).begin("initial-gap")
    assert any(np.array_equal(kept[0].z, z) for z in points)


def test_effect_that_another_brought_out_of_a_bad_start_is_fitted_again_alone() -> None:
    """Alone it is stuck far off, beside a second effect that does nothing it explains all: it needs no second one."""
    both = Space.of(("channel-delay", "support-nonlinearity"))
    found = searched(none=9000.0)
    delay, support = frozenset({"channel-delay"}), frozenset({"support-nonlinearity"})
    pair = delay | support
    found.fits |= {delay: FakeFit(8800.0), support: FakeFit(9100.0),  # type: ignore[dict-item]
                   pair: FakeFit(1010.0, z=np.arange(float(both.size)), space=both,
                                 whitened_jacobian=np.eye(2000, both.size))}
    assert chosen_set(found) == pair
    began: dict[frozenset[str], list[float]] = {}

    def fit(space: Space, z: np.ndarray, *_rest: object) -> FakeFit:
        began[frozenset(space.effects)] = list(z)
        return FakeFit(1015.0 if "support-nonlinearity" in space.effects else 8700.0, z=z, space=space)

    found.fitter.fit = fit  # type: ignore[method-assign,assignment]
    found.fitters[support] = SimpleNamespace()  # type: ignore[assignment]
    found.thin(pair, 3)
    assert chosen_set(found) == support
    assert found.fitter_of(support) is found.fitter_of(pair)  # its numbers are of that one's corrections
    kept = [at for at, one in enumerate(both.coordinates) if one.effect != "channel-delay"]
    assert began[support] == [float(at) for at in kept]
