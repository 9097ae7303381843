"""Diagnoses of damaged recordings of driven joints: a clear line or a warning, never a name for the damage.

What carries the weight: the joint is a slider, which the baseline explains, so that any effect named would be the
damage's own.
"""

import numpy as np
import pytest
from fretflow.core.errors import RecordingError
from fretflow.experiments.driven import data as driven
from fretflow.experiments.driven.run import diagnose_driven
from fretflow.inference.verdict import Verdict
from fretflow.recordings.recording import read_joint_recording

PERIOD = 200  # rows
TOML = """format = "fretflow-recording/1"
[test]
kind = "{kind}"
[series]
file = "series.csv"
time = {{ column = "t", unit = "s" }}
displacement = {{ column = "x", unit = "{unit}" }}
force = {{ column = "F", unit = "N" }}
"""
KINDS = ("imposed-displacement", "lumped")


def slider(cycles=8, kind="imposed-displacement"):
    """Return time in s, displacement in um or mm and force in N of a slider with a spring, or of a mass on a damper."""
    rng = np.random.default_rng(2)
    t = np.arange(cycles * PERIOD) / PERIOD
    if kind == "lumped":
        x, v, a = np.sin(6.0 * t), 6.0 * np.cos(6.0 * t), -36.0 * np.sin(6.0 * t)
        force = 3.0 * a + 40.0 * v
        return t, 1e3 * x, force + 0.3 * rng.standard_normal(len(t))
    x, force, held = 20.0 * np.sin(2.0 * np.pi * t), [], 0.0
    for step in np.diff(x, prepend=0.0):
        held = float(np.clip(held + 30.0 * step, -50.0, 50.0))
        force.append(held)
    return t, x + 0.02 * rng.standard_normal(len(t)), np.array(force) + 0.5 * rng.standard_normal(len(t))


@pytest.fixture
def diagnosed(tmp_path):
    def run(columns, kind="imposed-displacement", change=lambda text: text, toml=TOML):
        unit = "mm" if kind == "lumped" else "um"
        (tmp_path / "recording.toml").write_text(toml.format(kind=kind, unit=unit))
        lines = [",".join("" if np.isnan(v) else f"{v:.8g}" for v in row) for row in np.stack(columns, axis=1)]
        (tmp_path / "series.csv").write_text(change("\n".join([",".join("txF"[:len(columns)]), *lines]) + "\n"))
        return diagnose_driven(read_joint_recording(tmp_path), True, lambda share, text: None)

    return run


def damaged(name, t, x, force):
    """Return columns with one kind of damage."""
    x, force = x.copy(), force.copy()
    if name == "no numbers in the force":
        force[500:520] = np.nan
    if name == "no numbers in the displacement":
        x[11::9] = np.nan
    if name == "a gap":
        kept = np.delete(np.arange(len(t)), slice(620, 830))
        return t[kept], x[kept], force[kept]
    if name == "constant":
        return t, np.zeros_like(x), force
    return t, x, force


USABLE = {"no numbers in the force": ("force, rows 501-520", ""), "no numbers in the displacement": (
    "displacement, rows 12, 21, 30", "filled by interpolation"), "a gap": ("time, row 621", "gaps in time")}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", USABLE)
def test_what_can_be_used_is_used_with_a_warning(diagnosed, kind, name):
    diagnosis = diagnosed(damaged(name, *slider(kind=kind)), kind)
    where, text = USABLE[name]
    assert any(where in note and text in note for note in diagnosis.warnings)
    assert diagnosis.verdict is not Verdict.NAMED


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_is_cut_off_says_in_which_row(diagnosed, kind):
    diagnosis = diagnosed(slider(kind=kind), kind, lambda text: text[:len(text) * 3 // 4].rpartition(",")[0])
    assert any("the file is cut off within this row" in note for note in diagnosis.warnings)
    assert diagnosis.verdict is Verdict.NONE


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("change", "said"), [
    (lambda t, x, f: (t, 0.0 * x, f), "displacement, rows 1-1600: never changes"),
    (lambda t, x, f: (t, x, np.full_like(f, np.nan)), "force, rows 1-1600: no number"),
    (lambda t, x, f: (t, x), "has no column 'F'; it has t, x"),
    (lambda t, x, f: (t, 1e6 * x, f), "check its unit and column"),
    (lambda t, x, f: (t[:3], x[:3], f[:3]), "only 3 rows")])
def test_what_cannot_be_used_is_refused_in_one_line(diagnosed, kind, change, said):
    with pytest.raises(RecordingError) as error:
        diagnosed(change(*slider(kind=kind)), kind)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", [lambda t, x, f: (t, f, x), lambda t, x, f: (t, x, -f)])
def test_swapped_columns_and_wrong_signs_are_told_by_the_work(diagnosed, kind, change):
    with pytest.raises(RecordingError, match="check the sign of both, and whether their columns are swapped"):
        diagnosed(change(*slider(kind=kind)), kind)


def test_one_cycle_is_diagnosed_with_a_warning(diagnosed):
    diagnosis = diagnosed([column[:PERIOD + 20] for column in slider()])
    assert any("fewer than two whole cycles" in note for note in diagnosis.warnings)
    assert diagnosis.verdict is Verdict.NONE
    assert not any("fewer than" in note for note in diagnosed(slider()).warnings)


def test_a_few_whole_cycles_from_zero_are_all_cycles(diagnosed):
    """Of two that begin as the displacement rises through its middle none repeated: one lay between its passages."""
    later = [column[PERIOD:] for column in slider(cycles=3)]
    found = diagnosed([later[0] - later[0][0], *later[1:]])
    assert not any("fewer than" in note for note in found.warnings)
    assert found.verdict is Verdict.NONE


def test_a_very_long_record_is_thinned_no_further_than_its_cycles_bear(diagnosed, monkeypatch):
    """Four times the rows that are taken as they are: of two one is used, and what is left out is named."""
    monkeypatch.setattr(driven, "MOST_ROWS", 4000)
    monkeypatch.setattr(driven, "LEAST_OF_CYCLE", 100)
    diagnosis = diagnosed(slider(cycles=80))
    assert any("rows 8,001-16,000: not used" in note for note in diagnosis.warnings)
    assert any("every row of 2 is used" in note for note in diagnosis.warnings)
    assert diagnosis.verdict is Verdict.NONE
