"""What a diagnosis hands on: a case that `run` takes, bearing the recording's name, and what it took."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
import report_cases
from fretflow.case.casefile import dump_case
from fretflow.case.config import validate_case
from fretflow.effects.friction_run_in import FrictionRunIn
from fretflow.experiments.rig import run
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.experiments.rig.words import case_text
from fretflow.inference.verdict import Estimate
from fretflow.inference.words import cost
from fretflow.pipeline.diagnose import Stages, memory, runnable

CASE = dump_case(validate_case({
    "format": "fretflow-case/1", "name": "recorded", "title": "serial 20240117.12345 again",
    "test": {"excitation_amplitude": "53 N", "cycles": 100000},
    "specimen": {"youngs_modulus": "201226162482.7956 Pa"}, "wear": {"coefficient": "1.1049382716e-14 m^2/N"},
    "effects": {"friction-run-in": {"energy": "118782.44332862782 mJ"}}}))


@pytest.fixture
def diagnosis():
    estimate = Estimate(name="contact.friction_coefficient", value=0.83451234, low=0.8321, high=0.837, unit="1")
    return replace(report_cases.empty(), parameters=(estimate,), case_file=CASE)


def test_it_bears_the_recording_s_name_and_tells_what_was_fitted(diagnosis):
    text = runnable(diagnosis, "my recording/of May")
    case = validate_case(tomllib.loads(text))
    assert case.name == "my-recording-of-May"
    assert "# contact.friction_coefficient = 0.8345 (0.8321 to 0.8370)" in text
    assert case.title == "serial 20240117.12345 again"
    assert case.test.cycles == 100000


def test_what_is_fitted_has_six_figures_and_what_is_stated_all():
    stated = validate_case(tomllib.loads(CASE))
    effects = (FrictionRunIn().changed(energy=118.78244332862782),)
    text = case_text(stated, Hypothesis(effects, friction=1.0123456789), 0.8, 1.1049382716e-14)
    case = validate_case(tomllib.loads(text))
    assert case.specimen.upper.youngs_modulus == 201.226e9
    assert case.contact.friction_coefficient == pytest.approx(0.8 * 1.0123456789, rel=1e-5)
    assert 'energy = "118.782 J"' in text
    assert case.wear.coefficient == 1.10494e-14
    assert case.title == stated.title


@pytest.mark.parametrize("text", ["", "[effects.viscous]\ndamping = \"300 N*s/m\"\n", "# only = words\n", "= 5"])
def test_what_run_refuses_is_not_offered(diagnosis, text):
    assert runnable(replace(diagnosis, case_file=text), "a") == ""


def test_stages_are_timed_and_told(diagnosis, monkeypatch):
    """Each lasts until the next is told; one that comes again goes on."""
    now, told = [10.0], []
    monkeypatch.setattr("fretflow.pipeline.diagnose.monotonic", lambda: now[0])
    stages = Stages(lambda share, text: told.append(text))
    for text, seconds in (("reading", 0.5), ("fitting", 4.0), ("reading", 1.0)):
        stages(0.0, text)
        now[0] += seconds
    assert stages.ended() == {"reading": 1.5, "fitting": 4.0}
    assert told == ["reading", "fitting", "reading"]
    made = replace(diagnosis, seconds=5.5, stages=stages.ended(), memory=(1.24e9, 0.3e9))
    assert cost(made) == ("5.5 s; reading 1.5 s, fitting 4.0 s; 1.2 GB of memory, and up to 0.3 GB in each process")
    content = made.to_json()
    assert content["stages"] == {"reading": 1.5, "fitting": 4.0}
    assert content["memory"] == {"main": 1.24e9, "worker": 0.3e9}


def test_progress_never_falls():
    """Fits that moved are gone through once more, which told 33 % after 40 %."""
    told = []
    stages = Stages(lambda share, text: told.append(share))
    for share in (0.1, 0.40, 0.33, 0.45):
        stages(share, "fitting")
    assert told == [0.1, 0.40, 0.40, 0.45]


def test_a_doubt_is_told_at_once_and_names_no_stage(monkeypatch):
    doubt, told = "the moving mass would be 12 % above the file's: a displacement gain of 0.9 explains the same", []
    for name, value in (("case_of", None), ("faults", ()), ("doubts", (doubt,))):
        monkeypatch.setattr(run, name, lambda *given, value=value: value)
    monkeypatch.setattr(run, "experiment_of", lambda *given: 1 / 0)
    stages = Stages(lambda share, text: told.append(text))
    with pytest.raises(ZeroDivisionError):
        run.diagnose_rig(None, True, stages, None)
    assert doubt in told[-1]
    assert list(stages.ended()) == ["specimens on coarse meshes"]


def test_the_json_has_every_warning_and_note_of_the_terminal(diagnosis):
    """Those of joints that a motion drives and of wear series had been missing."""
    said = replace(diagnosis, warnings=("play stands at its bound",), notes=("1 N of noise",))
    assert said.to_json()["warnings"] == ["play stands at its bound", "1 N of noise"]


def test_memory_is_that_of_the_process():
    """The kernel's own account of it is the same."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    assert memory()[0] == pytest.approx(1024.0 * int(status["VmHWM"].split()[0]), rel=0.05)
