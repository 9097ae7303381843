"""Numbers and names of the report: what a reader takes from them must be what the record says.

What carries the weight: rounding hardly changes an interval, whatever its unit and size, and what is not
known never looks like a number.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from fretflow.experiments.driven.views import two_stiffnesses
from fretflow.inference import words
from fretflow.inference.verdict import Estimate, Evolution
from hypothesis import given
from hypothesis import strategies as st


def plain(text):
    """Read a printed number back."""
    parts = re.fullmatch(r"([−\d.,]+)(?:·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", text)
    power = (parts[2] or "⁰").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    return float(parts[1].replace("−", "-").replace(",", "")) * 10.0 ** int(power)


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
    ((14.2e-6, 13.9e-6, 14.6e-6, "m"), ("14.20", "13.90", "14.60", "µm")),
    ((1.1e-14, 0.9e-14, 1.3e-14, "m^2/N"), ("1.10", "0.90", "1.30", "10⁻¹⁴ m²/N")),
    ((0.0, -0.01, 0.01, "1"), ("0", "−0.010", "0.010", "")),
    ((317.0, 125.0, 801.0, "kg"), ("317", "125", "801", "kg")),
    ((10.0, 0.5, 800.0, "1"), ("10", "0.50", "800", "")),  # low end was 0, and half of it all "± 4,000 %"
    ((28e6, math.nan, math.inf, "N/m"), ("28.0", "–", "–", "N/µm")),
])
def test_an_estimate_in_units_that_engineers_use(estimate, shown):
    value, low, high, unit = estimate
    interval = words.interval(Estimate(name="a.b", value=value, low=low, high=high, unit=unit))
    assert (interval.value, interval.low, interval.high, interval.unit) == shown


@pytest.mark.parametrize(("share", "text"), [
    (0.0, "0 %"), (1.0, "100 %"), (0.99997, "> 99.9 %"), (3e-5, "< 0.1 %"), (0.973, "97 %"),
    (0.993, "99.3 %"), (0.006, "0.6 %"), (0.314, "31 %"),
    (0.05, "5 %"), (-0.02, "−2 %"), (math.nan, "–")])
def test_percent(share, text):
    assert words.percent(share) == text


@pytest.mark.parametrize(("probability", "text"), [
    (0.0, "< 0.1 %"), (1e-300, "< 0.1 %"), (0.56, "56 %"), (1.0, "> 99.9 %"), (math.nan, words.NOTHING)])
def test_no_probability_is_none_or_all(probability, text):
    assert words.probability(probability) == text


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
    assert words.equation("k (1 -+ r), 1 +- s") == "k (1 ∓ r), 1 ± s"
    assert words.equation("(p / p_0)^-b < <i>") == "(p / p<sub>0</sub>)<sup>−b</sup> &lt; &lt;i&gt;"


def test_names_beyond_the_catalogue_are_let_through():
    assert words.effect_title("friction-run-in") == "friction that settles with the dissipated energy"
    assert words.effect_title("no-such-effect") == ""
    assert words.together(("a", "b")) == "a + b"
    assert words.parameter_words("friction-run-in.initial_friction") == "initial friction"


@pytest.mark.parametrize(("name", "value", "unit", "told"), [
    ("sensor-inertia.mass", 317.0, "kg", [
        "sensor-inertia.mass = 317 kg lies beyond the plausible 0.1 to 3 kg (engineering estimate for SS304, 60 N, "
        "1 mm², 100 Hz)"]),
    ("sensor-inertia.mass", 0.5, "kg", []),
    ("coulomb-friction.friction_limit", 4e3, "N", []),  # goes with the joint
    ("baseline.mass", 317.0, "kg", [])])
def test_an_instrument_of_no_plausible_size_is_said_to_be_so(name, value, unit, told):
    """Similarity takes a sensor's mass to half a tonne at a damper of 9 kN; no sensor has it."""
    assert words.implausible([Estimate(name=name, value=value, low=value, high=value, unit=unit)]) == told


def test_a_stiffness_read_off_loops_that_is_not_the_fitted_one_is_explained():
    """They stood side by side, 5.3 against 4.2 N/um with 3.8 to 4.6, without a word."""
    loops = np.full((3, 4), 5.3e6)
    readings = Evolution(cycles=np.arange(4.0), friction_limit=loops, tangential_stiffness=loops,
                         dissipated_energy=loops, sliding_distance=loops)
    fitted = Estimate(name="baseline.tangential_stiffness", value=4.2e6, low=3.8e6, high=4.6e6, unit="N/m")
    (told,) = two_stiffnesses(readings, [fitted])
    assert told.startswith("loops show a tangential stiffness of 5.30 N/µm right after their reversals")
    assert two_stiffnesses(readings, [replace(fitted, high=5.5e6)]) == []
    assert two_stiffnesses(None, [fitted]) == []
    scattered = replace(readings, tangential_stiffness=np.array([[5.3e6, 3.9e6, 6.1e6, 4.4e6]] * 3))
    assert two_stiffnesses(scattered, [fitted]) == []  # the median is 4.85 +- 0.7
