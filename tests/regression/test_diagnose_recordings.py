"""Diagnoses of measured joints that a motion drives.

What carries the weight: what others found in the same recordings. The authors of the damper's name backlash; those of
the drive publish its mass, its friction and its offset, and that a Stribeck curve adds nothing; a bolted joint slips
bit by bit.
"""

from functools import cache
from pathlib import Path

import pytest
from fretflow.cli import app
from fretflow.core.errors import InputError
from fretflow.inference.verdict import Verdict
from fretflow.pipeline.diagnose import diagnose

pytestmark = pytest.mark.real_data
PUBLISHED = {"baseline.mass": 95.11, "baseline.damping": 203.5, "coulomb-friction.friction_limit": 20.39,
             "force-offset.force_offset": -3.16}
BOLTED = """format = "fretflow-recording/1"
title = "Bolted joint"
[test]
kind = "imposed-displacement"
[series]
file = "{}"
displacement = {{ column = "delta_mm", unit = "mm" }}
force = {{ column = "Ftr_kN", unit = "kN" }}
"""


@cache
def diagnosed(path: Path, fast: bool = False):
    return diagnose(path, fast=fast)


def test_the_drive_lacks_dry_friction_and_an_offset_of_the_published_size(recordings):
    diagnosis = diagnosed(recordings / "drive_estimation")
    assert diagnosis.verdict is Verdict.NAMED
    assert set(diagnosis.effects) == {"coulomb-friction", "force-offset"}
    values = {one.name: one for one in diagnosis.parameters}
    for name, value in PUBLISHED.items():
        assert values[name].low < value < values[name].high
        assert values[name].high - values[name].low < 0.4 * abs(value)
    assert diagnosis.held_out.after < 0.35 * diagnosis.held_out.before
    assert diagnosis.seconds < 60.0


def test_a_damper_with_backlash_is_not_just_a_slider(recordings):
    diagnosis = diagnosed(recordings / "damper_d2_0p5Hz30lbtension1amplitude")
    assert diagnosis.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert "backlash" in diagnosis.effects
    assert diagnosis.detection.p_value < 1e-6
    assert diagnosis.held_out.after < 0.6 * diagnosis.held_out.before
    assert next(one for one in diagnosis.parameters if one.name == "backlash.play").low > 2e-3


@pytest.mark.parametrize("name", ["damper_d1_0p5Hz20lbtension", "damper_d1_1Hz20lbtension"])
def test_each_best_explanation_of_a_damper_has_backlash(recordings, name):
    """Two effects at most: whether they are enough for a name or not, play is one of them."""
    diagnosis = diagnosed(recordings / name, True)
    assert diagnosis.verdict is not Verdict.NONE
    assert diagnosis.verdict is not Verdict.NAMED or "backlash" in diagnosis.effects
    assert "backlash" in next(one.effects for one in diagnosis.ranking if one.effects)


def bolted(recordings, folder, name):
    (folder / name).write_bytes((recordings / "bolted_joint_loops" / name).read_bytes())
    (folder / "recording.toml").write_text(BOLTED.format(name))
    return diagnosed(folder)


def test_a_bolted_joint_slips_bit_by_bit(recordings, tmp_path):
    """Loops without a time axis; what needs one is not looked at, and that is said."""
    diagnosis = bolted(recordings, tmp_path, "rousseau2025_loop_steel_amp0p05.csv")
    assert diagnosis.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert "distributed-micro-slip" in diagnosis.effects
    assert diagnosis.held_out.after < 0.8 * diagnosis.held_out.before
    assert any("no time axis" in note for note in diagnosis.warnings)


def test_a_single_small_loop_of_a_bolted_joint_is_seen_to_differ_but_names_nothing_else(recordings, tmp_path):
    """It has one whole cycle of 43 points: too few to tell distributed slip from what the figure's lines do."""
    diagnosis = bolted(recordings, tmp_path, "rousseau2025_loop_steel_amp0p03.csv")
    assert diagnosis.verdict is not Verdict.NONE
    assert not diagnosis.effects or "distributed-micro-slip" in diagnosis.effects


def test_the_command_writes_a_report_of_the_drive(recordings, tmp_path, capsys):
    out = tmp_path / "out"
    app(["diagnose", str(recordings / "drive_estimation"), "--fast", "--out", str(out)], result_action="return_value")
    assert "coulomb-friction" in capsys.readouterr().out
    assert not (out / "case.toml").exists()  # no case that `run` would take describes a drive
    assert "<svg" in (out / "report.html").read_text()
    again = tmp_path / "again.json"
    diagnosed(recordings / "drive_estimation").to_json(again)
    assert '"verdict": "named"' in again.read_text()


def test_what_cannot_be_diagnosed_is_told_in_one_line(tmp_path):
    with pytest.raises(InputError, match="there is no such folder or file"):
        diagnose(tmp_path / "absent")
