"""What is said of a diagnosis of the rig: every verdict has a sentence, alternatives what would part them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.core.errors import UnreliableRecordingError
from fretflow.experiments.rig.observation import check_blocks
from fretflow.experiments.rig.words import next_measurement
from fretflow.experiments.words import at_bounds, sentence, unfinished
from fretflow.inference.decision import Decision, held_to
from fretflow.inference.parameters import Parameters
from fretflow.inference.posterior import Posterior
from fretflow.inference.verdict import Candidate, HeldOut, Location, Remainder, ResidualLaw, Verdict
from fretflow.inference.words import after_model, separating

PLACE = Location(block="contact law", channel="friction force", phase="knee", cycles=(0, 1000), zone="")
LAW = ResidualLaw(channel="friction_force", state="displacement", state_unit="m", channel_unit="N", x=np.zeros(1),
                  y=np.zeros(1), sd=np.zeros(1), explained=0.7)
REST = Remainder(share=0.07, times_noise=4.7, where="friction force, the knee")


def decision_of(verdict: Verdict, *sets: set[str], explained: float = 0.93, probability: float = 0.95) -> Decision:
    """Return a verdict on some alternatives; backlash explains 30 % in the ranking."""
    near = Candidate(effects=("backlash",), probability=0.1, explained=0.3, chi_squared=9.0, degrees_of_freedom=5,
                     log_evidence=0.0)
    names = tuple(map(frozenset, sets))
    return Decision(verdict, names, names[0] if names else frozenset(), explained, probability, (near,),
                    Posterior({frozenset(): 0.0}, 0.0, {}))


def test_a_pair_and_a_single_effect_are_named():
    """Of a pair each has its own probability: that of all sets that it is in."""
    pair = frozenset({"viscous", "backlash"})
    shares = Posterior({pair: 0.75, frozenset({"viscous"}): 0.21, frozenset(): 0.04}, 0.0, {})
    one, two = (sentence(replace(decision_of(Verdict.NAMED, names), posterior=shares), REST, PLACE, None) for names in (
        {"viscous"}, pair))
    assert "Very probably, the model leaves out viscous, which explains 93 %" in one
    assert "backlash (75 %) and viscous (96 %), which explain 93 %" in two


def test_nothing_by_the_tests_says_what_would_be_more_probable():
    """The posterior holds wear for more probable than nothing, and the tests see noise alone: both are told."""
    shares = Posterior({frozenset({"wear-power-law"}): 0.61, frozenset(): 0.35}, 0.04, {})
    by_tests = replace(decision_of(Verdict.NONE, probability=0.35), posterior=shares)
    assert "; wear-power-law would be more probable (61 %), but no test sees more than noise" in sentence(
        by_tests, REST, PLACE, None)
    assert sentence(replace(by_tests, probability=0.95), REST, PLACE, None).endswith("measurement and simulation.")


def test_what_remains_is_told_with_its_place():
    text = sentence(decision_of(Verdict.NAMED, {"viscous"}), REST, PLACE, None)
    assert "what remains (7 % of the difference, 4.7 times the noise) is not explained" in text
    assert "it lies in friction force, the knee" in text


def test_an_unknown_says_why_the_nearest_is_not_enough():
    plain = sentence(decision_of(Verdict.UNKNOWN), REST, PLACE, None)
    assert "backlash would explain 30 %, and what the nearest leaves (4.7 times the noise) is more than" in plain
    held = held_to(replace(decision_of(Verdict.NAMED, {"backlash"}), after=frozenset({"backlash"})),
                   HeldOut(what="", before=2.0, after=3.0, floor=1.0), 1000)
    assert sentence(held, REST, PLACE, None).endswith(
        "backlash would explain 30 %, but the nearest predicts what was held out worse than the baseline, and leaves "
        "4.7 times the noise.")


def test_a_remainder_that_rounds_to_nothing_is_not_called_unexplained():
    nothing = Remainder(share=0.002, times_noise=1.3, where="")
    text = sentence(decision_of(Verdict.NAMED, {"viscous"}, explained=0.998), nothing, PLACE, None)
    assert text.endswith("explains 99.8 % of the difference; 0.2 % of it remains, 1.3 times the noise.")


def test_a_remainder_of_the_noise_is_not_called_unexplained_and_lies_nowhere():
    for share, times, said in (
            (0.002, 1.0, "what remains (0.2 % of the difference) is no larger than the noise."),
            (0.011, 1.0, "what remains (1 % of the difference) is no larger than the noise."),
            (0.011, 1.1, "what remains (1 % of the difference, 1.1 times the noise) is not explained: it lies in "
                         "reversal.")):
        left = Remainder(share=share, times_noise=times, where="reversal")
        assert sentence(decision_of(Verdict.NAMED, {"viscous"}, explained=0.989), left, PLACE, None).endswith(said)


@pytest.mark.parametrize(("probability", "word"), [(0.995, "Almost surely"), (0.95, "Very probably"),
                                                   (0.8, "Probably"), (0.55, "Perhaps")])
def test_how_sure_it_is_has_a_word(probability, word):
    text = sentence(decision_of(Verdict.NAMED, {"viscous"}, probability=probability), REST, PLACE, None)
    assert text.startswith(word)


def test_what_all_alternatives_share_is_sure():
    decision = decision_of(Verdict.AMBIGUOUS, {"viscous", "backlash"}, {"channel-delay", "backlash"})
    text = sentence(decision, REST, PLACE, None)
    assert "leaves out backlash, and one of viscous, or channel-delay" in text


def test_an_unlisted_effect_is_told_by_its_place_law_and_nearest():
    text = sentence(decision_of(Verdict.UNKNOWN, explained=0.3), REST, PLACE, LAW)
    for part in ("not in the catalogue", "'contact law'", "friction force", "'knee'", "backlash would explain 30 %",
                 "4.7 times the noise", "follows the displacement"):
        assert part in text
    assert "displacement" in next_measurement(LAW)


def test_a_law_that_explains_little_is_not_told():
    weak = ResidualLaw(channel="friction_force", state="displacement", state_unit="m", channel_unit="N", x=np.zeros(1),
                       y=np.zeros(1), sd=np.zeros(1), explained=0.1)
    assert "follows" not in sentence(decision_of(Verdict.UNKNOWN), REST, PLACE, weak)


def test_nothing_found_says_so():
    assert "explains the recording" in sentence(decision_of(Verdict.NONE), REST, PLACE, None)


def test_parameters_far_outside_of_their_ranges_are_warned_of():
    space = Parameters.of((), ["backlash"])
    assert at_bounds(space, np.array([4.0, 0.0])) == [
        "backlash.play stands far outside of what is held plausible: the fit may stand for something else, or the "
        "range be too narrow"]
    assert at_bounds(space, np.array([1.0, 0.0])) == []


@pytest.mark.parametrize(("one", "other", "wanted"), [
    ("contact-stiffness", "sensor-path-compliance", "normal load"),
    ("friction-run-in", "normal-load-drift", "record of the normal force"),
    ("wear-threshold", "wear-power-law", "amplitudes"),
    ("viscous", "velocity-dependent-friction", "normal load"),
    ("channel-delay", "viscous", "frequency"),
    ("backlash", "distributed-micro-slip", "another amplitude, another normal load and another frequency")])
def test_alternatives_get_the_measurement_that_parts_them(one, other, wanted):
    text = separating([{one}, {other}])
    assert wanted in text
    assert f"{one} from {other}" in text
    assert separating([{other}, {one}]).split(" would")[0] == text.split(" would")[0]


def test_one_alternative_gets_what_would_confirm_it():
    assert separating([{"backlash"}]).endswith("another frequency would confirm backlash.")
    assert separating([{"viscous", "extra-mode"}]).endswith("would confirm extra-mode and viscous.")
    assert separating([()]) == ""


def test_what_a_zero_may_pretend_is_confirmed_at_rest():
    assert "at rest" in separating([{"force-offset"}])
    assert "at rest" in separating([{"viscous", "sensor-drift"}])


def test_what_a_larger_set_has_beside_is_told_from_the_smaller_alone():
    assert "force-offset from viscous alone" in separating([{"viscous", "force-offset"}, {"viscous"}])


@pytest.mark.parametrize(("verdict", "effects", "said"), [
    (Verdict.NONE, (), "baseline"),
    (Verdict.NAMED, ("viscous", "backlash"), "baseline + backlash + viscous"),
    (Verdict.AMBIGUOUS, ("viscous",), "baseline + viscous, one of the set"),
    (Verdict.UNKNOWN, ("viscous",), "baseline + viscous, the best of the catalogue"),
    (Verdict.UNKNOWN, (), "baseline")])
def test_what_after_is_predicted_with(verdict, effects, said):
    assert after_model(verdict, effects) == said


def test_fits_that_were_stopped_are_told():
    alone, beside = unfinished([frozenset({"viscous", "backlash"}), frozenset()])
    assert "baseline alone was stopped" in alone
    assert "baseline with backlash and viscous was stopped" in beside
    assert unfinished([]) == []


@pytest.mark.parametrize(("depth", "cycles"), [(None, 300_000), (object(), None)])
def test_what_a_rig_is_compared_by_is_asked_for(depth, cycles):
    bare = SimpleNamespace(path="my/recording", loops=None, wear_depth=depth, test=SimpleNamespace(cycles=cycles))
    with pytest.raises(UnreliableRecordingError, match=r"my/recording: has no \[loops\]; .* \[wear_depth\] alone"):
        check_blocks(bare)
    check_blocks(SimpleNamespace(**vars(bare) | {"wear_depth": object(), "test": SimpleNamespace(cycles=300_000)}))
