"""The worked examples of the contributor's guide do what it says, each in under 40 lines."""

import importlib
import re
from pathlib import Path

import fretflow as ff
import numpy as np
import pytest
from fretflow.effects.catalogue import FOLDERS
from fretflow.recordings.loop_sets import read_sets, recorded

GUIDE = Path(__file__).parents[2] / "CONTRIBUTING.md"
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), flags=re.DOTALL)


def block(name):
    """Return the code of the example whose first line names it."""
    [chosen] = [text for text in BLOCKS if text.startswith(f"# {name}")]
    return chosen


@pytest.mark.parametrize("text", BLOCKS, ids=lambda text: text.partition("\n")[0])
def test_examples_are_short(text):
    assert len(text.splitlines()) < 40
    assert max(map(len, text.splitlines())) <= 120


def test_an_effect(tmp_path, monkeypatch):
    (tmp_path / "friction_ramp.py").write_text(block("effects/friction_ramp.py"), encoding="utf-8")
    monkeypatch.setenv(FOLDERS, "")
    kind = ff.add_effects(tmp_path)["friction-ramp"]
    x = np.linspace(-5e-6, 5e-6, 11)
    motion = ff.Motion(step=1e-4, displacement=x, velocity=np.ones(11), acceleration=np.zeros(11))
    assert all(np.array_equal(factor, np.ones(11)) for factor in kind.neutral().limit(motion))
    factor, back = kind(rise=0.2, length="5 um").limit(motion)
    assert factor[[0, 5, 10]] == pytest.approx([1.2, 1.0, 1.2])
    assert np.array_equal(factor, back)
    assert ff.catalogue()["friction-ramp"] is kind
    assert set(kind().sketch().curves) == {"baseline", "effect"}


def test_a_kind_of_recordings(tmp_path, monkeypatch):
    kinds = importlib.import_module("fretflow.recordings.kinds")
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "torsion.py").write_text(block("recordings/kinds/torsion.py"), encoding="utf-8")
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(tmp_path / "room")])
    kinds.kinds.cache_clear()
    time = np.arange(400) / 2000.0
    angle = 5e-3 * np.sin(2.0 * np.pi * 10.0 * time)
    np.savetxt(tmp_path / "test.csv", np.column_stack([time, angle, 3.0 * np.sign(np.cos(20.0 * np.pi * time))]),
               delimiter=",", header="time_s,angle_rad,torque_Nm", comments="")
    (tmp_path / "recording.toml").write_text(
        'format = "fretflow-recording/1"\n[test]\nkind = "torsion"\n[torsion]\nfile = "test.csv"\nradius = "2 cm"\n',
        encoding="utf-8")
    try:
        recording = ff.read_recording(tmp_path)
        [loops], _ = read_sets(*recorded(tmp_path, {}, None, None))
    finally:
        kinds.kinds.cache_clear()
    assert recording.series.channels["displacement"].max() == pytest.approx(1e-4, rel=1e-3)  # 5 mrad at 2 cm
    assert recording.series.channels["force"].max() == pytest.approx(150.0)  # 3 N m at 2 cm
    assert loops.readings.friction_limit.value == pytest.approx(150.0, rel=1e-2)  # as `fretflow loops` reads it


def test_a_structure_from_matrices():
    made = {}
    exec(block("structure_from_matrices.py"), made)
    period, loop = made["period"], made["loop"]
    assert np.abs(period.friction_force).max() == pytest.approx(36.0, rel=1e-6)  # 0.6 times 60 N
    assert loop.friction_coefficient == pytest.approx(0.6, rel=0.01)
    # the work of the drive in the period is what friction and damping take
    phase = 2.0 * np.pi * np.arange(len(period.output("tip"))) / len(period.output("tip"))
    work = np.pi * 80.0 * 2.0 * np.mean(period.output("tip") * np.sin(phase))
    assert work > period.dissipated_energy > 0.8 * work
    other = ff.solve_periodic(made["problem"], "dlft", harmonics=15)
    assert np.ptp(other.output("tip")) == pytest.approx(np.ptp(period.output("tip")), rel=0.01)
