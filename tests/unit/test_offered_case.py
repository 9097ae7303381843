"""The case that a diagnosis offers is one that `run` takes, bears the recording's name and tells what was fitted."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from fretflow.case.casefile import dump_case
from fretflow.case.config import validate_case
from fretflow.inference.verdict import Estimate
from fretflow.pipeline.diagnose import runnable

CASE = dump_case(validate_case({
    "format": "fretflow-case/1", "name": "recorded", "test": {"excitation_amplitude": "53 N", "cycles": 100000},
    "specimen": {"youngs_modulus": "201226162482.7956 Pa"}, "wear": {"coefficient": "1.1049382716e-14 m^2/N"}}))


@pytest.fixture
def found(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import report_cases

    estimate = Estimate(name="contact.friction_coefficient", value=0.83451234, low=0.8321, high=0.837, unit="1")
    return replace(report_cases.empty(), parameters=(estimate,), case_file=CASE)


def test_it_bears_the_recording_s_name_and_tells_what_was_fitted(found):
    text = runnable(found, "my recording/of May")
    case = validate_case(tomllib.loads(text))
    assert case.name == "my-recording-of-May"
    assert "# contact.friction_coefficient = 0.8345 (0.8321 to 0.8370)" in text
    assert case.specimen.upper.youngs_modulus == pytest.approx(201226162482.7956, rel=1e-5)
    assert "201226162482" not in text
    assert case.wear.coefficient == pytest.approx(1.1049382716e-14, rel=1e-5, abs=0.0)
    assert case.test.cycles == 100000


@pytest.mark.parametrize("text", ["", "[effects.viscous]\ndamping = \"300 N*s/m\"\n", "# only = words\n", "= 5"])
def test_what_run_refuses_is_not_offered(found, text):
    assert runnable(replace(found, case_file=text), "a") == ""
