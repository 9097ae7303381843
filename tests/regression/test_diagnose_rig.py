"""Diagnoses of the two recordings of a rig that an independent program made: nothing hidden, and friction that runs in.

In both the friction coefficient is known (0.84; from 0.40 to 0.88), so that its interval is judged as well.
"""

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real_data, pytest.mark.fem]
ROOT = Path(__file__).parents[2]


def diagnosed(recording: Path, out: Path) -> dict:
    """Return the JSON of ``fretflow diagnose --fast``, run as a user does."""
    subprocess.run([str(ROOT / "fretflow"), "diagnose", str(recording), "--fast", "--out", str(out)], check=True,
                   cwd=out.parent, capture_output=True)
    return json.loads((out / "diagnosis.json").read_text())


@pytest.fixture(scope="module")
def baseline(recordings, tmp_path_factory):
    out = tmp_path_factory.mktemp("baseline") / "out"
    return diagnosed(recordings / "example_baseline", out), out


def without(recordings: Path, home: Path, pattern: str) -> dict:
    """Return the diagnosis of the baseline's recording without a part of its description."""
    folder = shutil.copytree(recordings / "example_baseline", home / "part", copy_function=shutil.copyfile)
    folder.chmod(0o755)
    file = folder / "recording.toml"
    text, count = re.subn(pattern, "", file.read_text(), flags=re.DOTALL)
    assert count == 1
    file.write_text(text)
    return diagnosed(folder, home / "out")


@pytest.fixture(scope="module")
def undriven(recordings, tmp_path_factory):
    """Return the diagnosis of the loops alone, which tell no phase against the drive."""
    return without(recordings, tmp_path_factory.mktemp("undriven"), r'excitation = {[^}]*}\n')


def test_baseline_is_none_with_its_friction(baseline):
    diagnosis, out = baseline
    assert (diagnosis["verdict"], diagnosis["effects"]) == ("none", [])
    assert diagnosis["detection"]["p_value"] > 0.05
    friction = diagnosis["parameters"]["contact.friction_coefficient"]
    assert friction["high"] - friction["low"] < 0.04
    assert not (out / "case.toml").exists()


def test_baseline_is_none_without_a_record_of_its_drive(undriven):
    """The model then counts the phase from the displacement too."""
    assert (undriven["verdict"], undriven["effects"]) == ("none", [])


def test_the_worn_depth_alone_tells_the_wear(recordings, tmp_path):
    """Without loops friction is what dry contacts have, and the wear coefficient what makes the depth of it."""
    diagnosis = without(recordings, tmp_path, r"\[loops\].*(?=\[wear_depth\])")
    assert (diagnosis["verdict"], diagnosis["fit"]) == ("none", {})
    friction = diagnosis["parameters"]["contact.friction_coefficient"]
    assert friction["low"] < 0.84 < friction["high"]
    assert friction["high"] / friction["low"] > 1.2
    assert any(note.startswith("loops: are not in the file") for note in diagnosis["warnings"])


def test_friction_of_the_baseline_lies_within_its_interval(baseline, undriven):
    for diagnosis in (baseline[0], undriven):
        friction = diagnosis["parameters"]["contact.friction_coefficient"]
        assert friction["low"] < 0.84 < friction["high"]


def test_run_in_is_named_and_predicts_what_was_held_out(recordings, tmp_path):
    diagnosis = diagnosed(recordings / "example_run_in", tmp_path / "out")
    assert diagnosis["effects"] == ["friction-run-in"]
    assert diagnosis["verdict"] == "named"
    assert diagnosis["location"]["block"] == "contact law"
    assert diagnosis["parameters"]["friction-run-in.initial"]["value"] == pytest.approx(0.40, abs=0.03)
    assert diagnosis["parameters"]["contact.friction_coefficient"]["value"] == pytest.approx(0.88, abs=0.03)
    assert diagnosis["fit"]["after"] < 0.2 * diagnosis["fit"]["before"]
    case = tomllib.loads((tmp_path / "out" / "case.toml").read_text())
    assert set(case["effects"]) == {"friction-run-in"}
    subprocess.run([str(ROOT / "fretflow"), "show", str(tmp_path / "out" / "case.toml")], check=True,
                   capture_output=True)
