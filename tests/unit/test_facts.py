"""Facts as recordings: what is read, what is refused, and how one counts.

What carries the weight: units end in SI, a bound counts by the likelihood of its statement, and each refusal names the
field and the way out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.errors import ConfigError, CorruptRecordingError
from fretflow.experiments.facts.experiment import _row
from fretflow.experiments.facts.model import largest_motion
from fretflow.recordings.kinds import read_recording
from fretflow.recordings.kinds.facts import FACTS, QUANTITIES, Fact
from scipy.stats import norm

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper.toml"
HEAD = """format = "fretflow-recording/1"
[test]
kind = "facts"
excitation_frequency = "100 Hz"
excitation_amplitude = "53 N"
normal_load = "60 N"
cycles = 1000
"""
SLIDING = '[[facts]]\nquantity = "sliding-distance"\nvalue = "14 um"\nsd = "700 nm"\n'


def read(folder: Path, text: str):
    path = folder / "facts.toml"
    path.write_text(text, encoding="utf-8")
    return read_recording(path)


def test_the_paper_is_a_recording_like_any_other():
    recording = read_recording(EXAMPLE)
    assert recording.kind is FACTS
    assert {fact.quantity for fact in recording.file.facts} <= set(QUANTITIES)
    assert all(fact.says for fact in recording.file.facts)
    printed = next(fact for fact in recording.file.facts if fact.quantity == "wear-coefficient")
    ends = printed.stated * np.array([printed.factor, 1.0 / printed.factor])**norm.ppf(0.95)
    np.testing.assert_allclose(ends, [1.1e-11, 1.1e-17], rtol=0.02)  # a thousandfold either way by 90 %


def test_facts_are_in_si_and_fall_back_on_the_test(tmp_path):
    text = HEAD + '[unknown]\nmoving_mass = ["500 g", "20 kg"]\n' + SLIDING + SLIDING + (
        'excitation_amplitude = "0.06 kN"\ncycles = 10\n'
        '[[facts]]\nquantity = "corner-share"\nat_least = "50 %"\nsd = 0.1\n')
    file = read(tmp_path, text).file
    first, other, corner = file.facts
    assert (first.stated, first.sd) == pytest.approx((14e-6, 0.7e-6))
    assert file.condition_of(first) == (53.0, 60.0, 100.0)
    assert file.condition_of(other) == (60.0, 60.0, 100.0)
    assert (file.cycles_of(first), file.cycles_of(other)) == (1000, 10)
    assert (corner.stated, corner.side) == (0.5, 1)
    assert file.unknown.ranges() == {"moving_mass": (0.5, 20.0)}


@pytest.mark.parametrize(("text", "said"), [
    (HEAD, "facts: is required"),
    (HEAD.replace('"60 N"', '"60 um"') + SLIDING, "test.normal_load: '60 um' has the wrong dimension"),
    (HEAD + SLIDING.replace("sliding-distance", "sliding-distanse"), "did you mean sliding-distance?"),
    (HEAD + SLIDING.replace('"14 um"', '"14 N"'), "facts.0.value: '14 N' has the wrong dimension"),
    (HEAD + SLIDING.replace('"14 um"', "14e-6"), "facts.0.value: 1.4e-05 is not text with a number and its unit"),
    (HEAD + SLIDING.replace("value", "at_last"), "unknown key; docs/recordings.md lists those there are; "
                                                 "did you mean at_least?"),
    (HEAD + SLIDING + 'at_least = "1 um"\n', "facts.0: give one of value, at_least and at_most"),
    (HEAD + SLIDING.replace('sd = "700 nm"\n', ""), "facts.0: give one of sd and factor"),
    (HEAD + SLIDING.replace('"700 nm"', '"-1 um"'), "facts.0.sd: must be positive"),
    (HEAD + SLIDING + "cycles = 2000\n", "facts.0: cycles lie beyond the 1,000 of the test"),
    (HEAD + SLIDING + "since = 10\n", "since: belongs to a corner-depth-growth"),
    (HEAD + '[[facts]]\nquantity = "corner-depth-growth"\nat_most = 1.0\nsd = 0.1\n', "since: belongs to"),
    (HEAD + '[[facts]]\nquantity = "stick-share"\nvalue = 0.5\nsd = 0.1\ncycles = 3\n', "is of the unworn joint"),
    (HEAD + '[[facts]]\nquantity = "resonance-change"\nvalue = -0.01\nfactor = 2.0\n', "give an sd"),
    (HEAD + '[unknown]\nmoving_mass = ["20 kg", "5 kg"]\n' + SLIDING, "unknown.moving_mass: "),
    (HEAD + '[unknown]\nmoving_mass = "5 kg"\n' + SLIDING, "give its two ends"),
    (HEAD + '[unknown]\ndamping = [1, 2]\n' + SLIDING, "unknown.damping: unknown key"),
])
def test_bad_facts_are_refused_in_one_clear_line(tmp_path, text, said):
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, text)
    assert said in str(refused.value)
    assert str(tmp_path / "facts.toml") in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_is_no_toml_is_told(tmp_path):
    with pytest.raises((ConfigError, CorruptRecordingError)):
        read(tmp_path, HEAD + "[[facts]\n")


@pytest.mark.parametrize("side", [1, -1])
def test_half_of_the_square_of_a_bound_s_row_is_minus_the_log_of_its_probability(side):
    """A least-squares fit then maximises the likelihood; met by far, a bound pulls no more."""
    key = "at_least" if side > 0 else "at_most"
    bound = Fact(quantity="corner-share", sd=0.1, **{key: 0.5})
    for value in (0.2, 0.5, 0.55, 0.9):
        probability = norm.cdf(side * (value - 0.5) / 0.1)
        assert 0.5 * _row(bound, bound.distance(value))**2 == pytest.approx(-np.log(probability))
    assert abs(_row(bound, bound.distance(0.5 + side * 5.0))) < 1e-6
    assert _row(bound, bound.distance(0.5 - side * 0.3)) * side < 0.0  # below what is at least stated: too low


def test_a_fact_by_a_factor_is_compared_in_logarithms():
    fact = Fact(quantity="wear-coefficient", value="2e-14 m^2/N", factor=3.0)
    assert fact.distance(18e-14) == pytest.approx(2.0)
    assert fact.distance(2e-14 / 3.0) == pytest.approx(-1.0)


@dataclass(frozen=True)
class Peak:
    """A block whose motion is largest at 89.5 Hz on a flat peak with hills of four thousandths, 4 Hz apart."""

    frequency: float = 1.0

    def vary(self, frequency: float) -> Peak:
        return Peak(frequency)

    @property
    def rig_displacement(self) -> np.ndarray:
        size = 1.0 / (1.0 + ((self.frequency - 89.5) / 80.0)**2) + 4e-3 * np.cos(0.5 * np.pi * (self.frequency - 85.5))
        return np.column_stack([size * np.cos(2.0 * np.pi * np.arange(32) / 32.0), np.zeros(32)])


@pytest.mark.parametrize("start", [85.0, 85.5, 94.0])
def test_hills_on_a_flat_resonance_are_not_taken_for_it(start):
    """A search that goes down the next slope stops on the hill at 85.5 Hz."""
    assert largest_motion(lambda problem, near: problem, Peak(), np.array([start])) == pytest.approx(89.5, rel=0.005)
