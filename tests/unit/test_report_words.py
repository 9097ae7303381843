"""Numbers and names of the report: what a reader takes from them must be what the record says.

What carries the weight: rounding hardly changes an interval, whatever its unit and size, and what is not
known never looks like a number.
"""

import math
import re

import pytest
from fretflow.inference import words
from fretflow.inference.verdict import Estimate
from hypothesis import given
from hypothesis import strategies as st


def plain(text):
    """Read a printed number back."""
    found = re.fullmatch(r"([−\d.,]+)(?:·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", text)
    power = (found[2] or "⁰").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    return float(found[1].replace("−", "-").replace(",", "")) * 10.0 ** int(power)


@given(st.floats(1e-15, 1e12), st.booleans())
def test_a_number_is_read_back_to_three_figures(value, negative):
    value = -value if negative else value
    assert plain(words.number(value)) == pytest.approx(value, rel=5.1e-3, abs=0.0)


@given(st.floats(1e-14, 1e9), st.floats(1e-3, 0.5), st.sampled_from(["m", "N/m", "1", "m^2/N", "s", "J"]))
def test_an_interval_is_rounded_to_a_small_part_of_itself(value, share, unit):
    ends = {"low": value * (1 - share), "high": value * (1 + share)}
    shown = words.interval(Estimate(name="a.b", value=value, unit=unit, **ends))
    low, middle, high = map(plain, (shown.low, shown.value, shown.high))
    half = 0.5 * (high - low)
    assert half / middle == pytest.approx(share, rel=0.075, abs=0.0)
    assert len(shown.value) < 15


@pytest.mark.parametrize(("estimate", "shown"), [
    ((14.2e-6, 13.9e-6, 14.6e-6, "m"), ("14.20", "13.90", "14.60", "µm", "± 2.5 %")),
    ((1.1e-14, 0.9e-14, 1.3e-14, "m^2/N"), ("1.10", "0.90", "1.30", "10⁻¹⁴ m²/N", "± 18 %")),
    ((0.0, -0.01, 0.01, "1"), ("0", "−0.010", "0.010", "", "–")),
    ((28e6, math.nan, math.inf, "N/m"), ("28.0", "–", "–", "N/µm", "–")),
])
def test_an_estimate_in_units_that_engineers_use(estimate, shown):
    value, low, high, unit = estimate
    found = words.interval(Estimate(name="a.b", value=value, low=low, high=high, unit=unit))
    assert (found.value, found.low, found.high, found.unit, found.relative) == shown


@pytest.mark.parametrize(("share", "text"), [
    (0.0, "0 %"), (1.0, "100 %"), (0.99997, "> 99.9 %"), (3e-5, "< 0.1 %"), (0.973, "97 %"),
    (0.993, "99.3 %"), (0.006, "0.6 %"), (0.314, "31 %"),
    (0.05, "5 %"), (-0.02, "−2 %"), (math.nan, "–")])
def test_percent(share, text):
    assert words.percent(share) == text


@pytest.mark.parametrize(("p", "text"), [(0.041, "0.041"), (3.2e-7, "3·10⁻⁷"), (0.0, "< 10⁻¹⁵"), (math.nan, "–")])
def test_p_value(p, text):
    assert words.p_value(p) == text


@pytest.mark.parametrize(("seconds", "text"), [
    (0.0, ""), (3.24, "3.2 s"), (42.0, "42 s"), (372.0, "6 min 12 s"), (7200.0, "2.0 h"), (math.nan, "")])
def test_duration(seconds, text):
    assert words.duration(seconds) == text


def test_equations_are_printed_and_cannot_inject():
    assert words.equation("mu_inf - (mu_inf - mu_0) exp(-E / E_0)") == (
        "μ<sub>∞</sub> − (μ<sub>∞</sub> − μ<sub>0</sub>) exp(−E / E<sub>0</sub>)")
    assert words.equation("(p / p_0)^-b < <i>") == "(p / p<sub>0</sub>)<sup>−b</sup> &lt; &lt;i&gt;"


def test_names_beyond_the_catalogue_are_let_through():
    assert words.effect_title("friction-run-in") == "friction that settles with the dissipated energy"
    assert words.effect_title("no-such-effect") == ""
    assert words.together(("a", "b")) == "a + b"
    assert words.parameter_words("friction-run-in.initial_friction") == "initial friction"
