"""The growth benchmark's table: what carries the weight is a series of known exponent, with a hole in it."""

import importlib.util
import math
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def fit():
    spec = importlib.util.spec_from_file_location("growth_fit", BENCHMARKS / "growth_fit.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def figures(seconds):
    return {"seconds": seconds, "again": 0.5, "MiB": 100.0, "size": 7.0}


def test_the_exponent_of_a_power_law(fit):
    assert fit.exponent([36, 121, 441], [2e-3 * n**1.7 for n in (36, 121, 441)]) == pytest.approx(1.7, rel=1e-12)


def test_one_size_has_no_exponent(fit):
    assert math.isnan(fit.exponent([36], [1.0]))
    assert fit.rows("dlft", 3, {36: figures(1.0)})[0][-1] == ""


def test_a_size_that_failed_is_shown_and_not_fitted(fit):
    lines = fit.rows("dlft", 15, {100: figures(1.0), 200: "over 60", 400: figures(4.0)})
    assert [line[2:4] for line in lines] == [("100", "1.00"), ("200", "over 60"), ("400", "4.00")]
    assert [line[-1] for line in lines] == ["", "", "1.00"]


def test_what_has_no_harmonics_shows_none(fit):
    whole = {key: value for key, value in figures(3.0).items() if key != "again"}
    assert fit.rows("reduction", None, {36: whole}) == [("reduction", "", "36", "3.00", "", "100", "7", "")]


def test_the_table_in_markdown(fit):
    assert fit.markdown("Growth", ("what", "s"), [("dlft", "1.0")]).splitlines() == [
        "# Growth", "", "| what | s |", "|---|---|", "| dlft | 1.0 |"]
