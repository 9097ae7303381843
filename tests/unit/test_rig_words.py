"""What is said of a diagnosis of the rig: every verdict has a sentence, alternatives what would part them."""

import numpy as np
import pytest
from fretflow.experiments.rig.words import next_measurement, sentence, separating, unfinished
from fretflow.inference.verdict import Location, ResidualLaw, Verdict
from fretflow.inference.words import after_model

PLACE = Location(block="contact law", channel="friction force", phase="knee", cycles=(0, 1000), zone="")
LAW = ResidualLaw(channel="friction_force", state="displacement", state_unit="m", channel_unit="N", x=np.zeros(1),
                  y=np.zeros(1), sd=np.zeros(1), explained=0.7)


def test_a_pair_and_a_single_effect_are_named():
    assert "leaves out viscous, which explains 93 %" in sentence(Verdict.NAMED, [{"viscous"}], 0.93, PLACE, None)
    assert "backlash and viscous, which explain 93 %" in sentence(
        Verdict.NAMED, [{"viscous", "backlash"}], 0.93, PLACE, None)


def test_what_all_alternatives_share_is_sure():
    text = sentence(Verdict.AMBIGUOUS, [{"viscous", "backlash"}, {"channel-delay", "backlash"}], 0.9, PLACE, None)
    assert "leaves out backlash, and one of viscous, or channel-delay" in text


def test_an_unlisted_effect_is_told_by_its_place_and_law():
    text = sentence(Verdict.UNKNOWN, [], 0.3, PLACE, LAW)
    for part in ("not in the catalogue", "'contact law'", "friction force", "'knee'", "30 %",
                 "follows the displacement"):
        assert part in text
    assert "displacement" in next_measurement(LAW)


def test_a_law_that_explains_little_is_not_told():
    weak = ResidualLaw(channel="friction_force", state="displacement", state_unit="m", channel_unit="N", x=np.zeros(1),
                       y=np.zeros(1), sd=np.zeros(1), explained=0.1)
    assert "follows" not in sentence(Verdict.UNKNOWN, [], 0.3, PLACE, weak)


def test_nothing_found_says_so():
    assert "explains the recording" in sentence(Verdict.NONE, [], 0.0, PLACE, None)


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


def test_one_alternative_needs_no_measurement():
    assert separating([{"viscous"}]) == ""


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


def test_an_unknown_that_is_explained_in_part_says_why_it_has_no_name():
    """More than the gate explained, and no name: the rest is no noise, or the motion does not repeat itself."""
    assert "explains 88 % of what the baseline leaves, but not down to the noise" in sentence(
        Verdict.UNKNOWN, [], 0.88, PLACE, None)
    assert "noise" not in sentence(Verdict.UNKNOWN, [], 0.5, PLACE, None)
    assert "does not repeat itself" in sentence(Verdict.UNKNOWN, [], 1.0, PLACE, None, repeats=False)


def test_an_effect_that_predicts_nothing_is_said_to():
    assert "predicts loops that it was not fitted to no better" in sentence(
        Verdict.UNKNOWN, [], 1.0, PLACE, None, predicts=False)
    assert "predicts" not in sentence(Verdict.UNKNOWN, [], 0.0, PLACE, None, predicts=False)  # nothing was chosen
