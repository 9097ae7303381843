"""Real recordings, and two made by an independent rig in time, read as the command does.

What carries the weight: the friction that the independent rig was run with comes back within the stated deviation,
and measured loops that nobody prepared for this program are read, with what had to be left out.
"""

import json

import numpy as np
import pytest
from fretflow import cli
from fretflow.recordings import readings
from fretflow.recordings.bare import Wanted, read_bare
from fretflow.recordings.kinds.joints import FRETTING_RIG
from fretflow.recordings.readings import read_recorded_loops
from fretflow.recordings.recording import read_joint_recording
from fretflow.recordings.repeatability import repeatability
from fretflow.recordings.series import loops_of_series

pytestmark = pytest.mark.real_data


@pytest.fixture(autouse=True)
def _few_draws(monkeypatch, request):
    """Let noise be drawn less often where the deviations are not what is tested."""
    if request.function not in (test_run_in, test_baseline):
        monkeypatch.setattr(readings, "DRAWS", 20)


def read(loops, load=np.nan, **options):
    return read_recorded_loops(loops, np.full(len(loops.cycles), load), **options)


def test_run_in(recordings):
    recording = read_joint_recording(recordings / "example_run_in")
    assert recording.kind is FRETTING_RIG
    assert recording.notes == ()
    assert recording.loops.force.shape == (9, 3, 200)
    seen = read(recording.loops, 60.0).friction_coefficient
    mu = 0.88 - 0.48 * np.exp(-recording.loops.cycles / 6e4)
    assert np.all(np.abs(seen.value - mu) < 3.5 * seen.sd)
    assert np.all(seen.sd < 0.006)
    assert seen.value[0] == pytest.approx(0.40, abs=0.005)
    assert seen.value[-1] == pytest.approx(0.88, abs=0.012)


def test_baseline(recordings):
    recording = read_joint_recording(recordings / "example_baseline")
    seen = read(recording.loops, 60.0)
    assert seen.friction_coefficient.value == pytest.approx(np.full(9, 0.84), abs=0.01)
    # Nearly rigid asperities: the loop cannot tell their stiffness, only bounds.
    assert np.isnan(seen.tangential_stiffness.value).all()
    floor = repeatability(recording.loops.force)
    assert 0.3 < floor.noise_sd.mean() < 0.7
    assert 0.002 < floor.gain_sd < 0.008
    assert len(recording.sweep.conditions) == 5
    assert recording.wear_depth.channels["depth"].mean() == pytest.approx(1e-5, rel=0.05, abs=0.0)


@pytest.mark.parametrize(("name", "cycles", "limit"), [
    ("damper_d1_0p5Hz20lbtension", 6, 4.1e3), ("damper_d1_0p5Hz35lbtension", 6, 9.2e3),
    ("damper_d1_1Hz20lbtension", 6, 3.9e3), ("damper_d2_0p5Hz30lbtension1amplitude", 5, 9.4e3),
])
def test_damper(recordings, name, cycles, limit):
    recording = read_joint_recording(recordings / name)
    loops, notes = loops_of_series(recording.series)
    seen = read(loops, consecutive=True)
    assert len(seen.cycles) == cycles
    assert seen.friction_limit.value[2] == pytest.approx(limit, rel=0.03)
    assert seen.peak_to_peak.value[2] == pytest.approx(51.2e-3, rel=0.01, abs=0.0)
    # The loop lies within the rectangle of its limit and stroke, and fills most of it.
    filled = seen.dissipated_energy.value / (2.0 * seen.friction_limit.value * seen.peak_to_peak.value)
    assert np.all((filled > 0.7) & (filled < 1.0))
    assert any("not steady" in note.text for note in notes)


def test_drive_work_is_that_of_its_published_friction(recordings):
    recording = read_joint_recording(recordings / "drive_estimation")
    series = recording.series
    loops, _ = loops_of_series(series)
    seen = read(loops)
    # Coulomb 20.39 N over the way, viscous 203.5 N s/m; offset and inertia do no work in a closed cycle.
    velocity = np.gradient(loops.displacement[:, 0], axis=1) * loops.frequency[:, None] * len(loops.phase)
    way = np.abs(np.diff(loops.displacement[:, 0], axis=1)).sum(axis=1)
    work = 20.39 * way + 203.5 * (velocity**2).mean(axis=1) / loops.frequency
    assert seen.dissipated_energy.value == pytest.approx(work, rel=0.03)


@pytest.mark.parametrize(("name", "cycles", "force"), [("0p03", 1, 2.7e3), ("0p05", 2, 3.9e3)])
def test_bolted_joint(recordings, name, cycles, force):
    recording = read_bare(recordings / "bolted_joint_loops" / f"rousseau2025_loop_steel_amp{name}.csv", Wanted())
    loops, _ = loops_of_series(recording.series)
    seen = read(loops, 1e4)
    assert seen.regime == ("partial slip",) * cycles
    assert np.isnan(seen.friction_coefficient.value).all()
    assert loops.force.max() == pytest.approx(force, rel=0.05)
    assert np.all((seen.tangential_stiffness.value > 8e7) & (seen.tangential_stiffness.value < 1.6e8))


@pytest.mark.parametrize("name", ["example_run_in", "damper_d1_1Hz20lbtension", "drive_estimation"])
def test_command(recordings, tmp_path, name):
    file = tmp_path / "all.json"
    assert cli.execute(["loops", str(recordings / name), "--out", str(tmp_path), "--json", str(file)]) == 0
    assert json.loads(file.read_text())["sets"]
    assert len(list((tmp_path / f"{name}-loops").glob("*.png"))) == (2 if name.startswith("example") else 1)
