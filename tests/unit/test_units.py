"""Units at the boundary.

What carries the weight: no text gives a number unless it states a unit of the right dimension; known
conversions hold; any text whatever either parses or is refused in one way.
"""

import math

import pytest
from fretflow.core.units import (
    _READABLE,
    exact_quantity,
    format_quantity,
    parse_quantity,
    pretty_number,
    pretty_quantity,
    registry,
)
from hypothesis import example, given
from hypothesis import strategies as st


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("60 N", "N", 60.0),
        ("60N", "N", 60.0),
        (" 6e1 N ", "N", 60.0),
        ("0.06 kN", "N", 60.0),
        ("1_000 N", "N", 1000.0),
        (".5 mm", "m", 5e-4),
        ("5.5 h", "s", 19800.0),
        ("1 lbf", "N", 4.4482216152605),
        ("1 inch", "m", 0.0254),
        ("8 g/cm^3", "kg/m^3", 8000.0),
        ("28 N/um", "N/m", 28e6),
        ("193 GPa", "Pa", 193e9),
        ("60 kg*m/s^2", "N", 60.0),
        ("1e-14 m²/N", "m^2/N", 1e-14),
        ("1 1/s", "1/s", 1.0),
        ("1 Hz", "1/s", 1.0),
    ],
)
def test_known_conversions(text, unit, value):
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    "text",
    [
        "60",
        "60 ",
        "N",
        "",
        "60 kg",
        "60 blobs",
        "sixty N",
        "nan N",
        "inf N",
        "1e999 N",
        "60 N + 1 N",
        "60 +/- 1 N",
        "60 N N",
        "60 **",
        "60 (((",
        "60 N/0",
        "60 degC",
        "60 %",
        "60,5 N",
        "0x10 N",
        "1 2 N",
        "60 mN/m",
        60,
        60.0,
        True,
        None,
        ["60 N"],
    ],
)
def test_what_is_no_force_is_refused(text):
    with pytest.raises(ValueError, match=r'for example "1 N"|not a finite number'):
        parse_quantity(text, "N")


@pytest.mark.parametrize("text", ["1e25 N", "-1e25 N", "1e-25 N", "1e300 N", "1e-300 N"])
def test_beyond_what_any_joint_has(text):
    with pytest.raises(ValueError, match=f"'{text}' is beyond what any joint has; check the number"):
        parse_quantity(text, "N")


@pytest.mark.parametrize("text", ["628 rad/s", "6000 rpm", "1 revolution/s", "360 degree/s"])
def test_an_angular_frequency_is_no_frequency(text):
    with pytest.raises(ValueError, match="wrong dimension"):
        parse_quantity(text, "Hz")


@given(st.text(alphabet="0123456789.eE+-*/^() NmkgsPaHz_µ%[]{}'\"\\,=!", max_size=20))
@example("60 N[0]")
@example("1 __import__('os')")
def test_any_text_parses_or_is_refused(text):
    try:
        assert math.isfinite(parse_quantity(text, "N"))
    except ValueError:
        pass


@given(st.floats(1e-12, 1e12), st.sampled_from(["m", "Pa", "N/m", "N", "Hz", "kg", "s"]))
def test_readable_text_parses_back(value, unit):
    text = format_quantity(value, unit, digits=12)
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-11)


@given(st.floats(1e-12, 1e12), st.sampled_from(["m", "Pa", "N/m", "N", "Hz", "kg", "s", "m^2/N"]))
@example(193e9, "Pa")
def test_what_a_file_holds_reads_back_to_the_last_bit(value, unit):
    assert parse_quantity(exact_quantity(value, unit), unit) == value


@pytest.mark.parametrize(("value", "unit", "text"), [
    (193e9, "Pa", "193 GPa"), (0.0, "m", "0 m"), (60.0, "N", "60 N"), (1.1e-14, "m^2/N", "1.1e-14 m^2/N"),
    (1e-3, "m", "1 mm"), (201226162482.7956, "Pa", "201.2261624827956 GPa"),
    (0.7e-6, "m", "0.7 um"), (2270.0, "s", "2270 s"), (0.03202, "kg", "0.03202 kg"), (0.4448, "N", "0.4448 N"),
    (1.643e7, "N/m", "16.43 N/um"), (2.007e6, "Pa", "2007 kPa"),
    (199.724e9, "Pa", "199.724 GPa")])
def test_what_a_file_holds_is_what_one_would_type(value, unit, text):
    assert exact_quantity(value, unit) == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (14.2e-6, "m", "14.2 um"),
        (1e-3, "m", "1 mm"),
        (0.0, "m", "0 m"),
        (-2e-3, "m", "-2 mm"),
        (60e6, "Pa", "60 MPa"),
        (1.1e-14, "m^2/N", "1.1e-14 m^2/N"),
        (19800.0, "s", "5.5 h"),
        (0.5, "kg", "500 g"),
    ],
)
def test_readable_units(value, unit, text):
    assert format_quantity(value, unit) == text


@pytest.mark.parametrize(("value", "unit", "text"), [
    (14.2e-6, "m", "14.2 µm"), (1.1e-14, "m^2/N", "1.1e-14 m²/N"), (2.8e7, "N/m", "28 N/µm"),
    (2e15, "N/m^3", "2 MN/mm³"), (300.0, "N*s/m", "300 N·s/m")])
def test_what_is_printed_reads_back_too(value, unit, text):
    assert pretty_quantity(value, unit) == text
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-12)


def test_numbers_that_count_have_no_power_of_ten():
    assert [pretty_number(value) for value in (0.35, 12.0, 1e5, 1.9e6)] == ["0.35", "12", "100,000", "1,900,000"]
    assert [pretty_number(value, 3) for value in (20_000.0, -1234.5, 999.7, 1.1e-14)] == [
        "20,000", "-1,230", "1,000", "1.1e-14"]
    assert pretty_number(1234.5) == "1,234.5"
    assert [pretty_number(value, 2) for value in (184.0, 12.3, 99.7)] == ["180", "12", "100"]
    assert pretty_quantity(2e7, "kg/m^3", 3) == "20000000 kg/m³"
    assert pretty_quantity(5e5, "1", 3) == "500,000"


@pytest.mark.parametrize(("unit", "name", "size"), [
    (unit, name, size) for unit, choices in _READABLE.items() for name, size in choices])
def test_the_short_cut_for_common_units_agrees_with_pint(unit, name, size):
    assert registry().Quantity(1.0, name).to(unit).magnitude == pytest.approx(size, rel=1e-14)
    assert parse_quantity(f"3 {name}", unit) == pytest.approx(3.0 * size, rel=1e-15)
