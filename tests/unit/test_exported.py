"""A run as a recording: what `loops` reads off it is what went in.

What carries the weight: the periods are those of a spring and slider in closed form, whose readings come back through
the files, the noise included that was asked for.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from fretflow import cli
from fretflow.case.config import validate_case
from fretflow.core.errors import InputError
from fretflow.pipeline.exported import export_recording
from fretflow.pipeline.results import RunResults
from fretflow.recordings.loop_sets import read_sets
from fretflow.recordings.recording import read_joint_recording
from fretflow.structure.sensors import Signals

MU = {0: 0.4, 5000: 0.5}
DISTORTED = 10.0  # N, third harmonic of the drive that acted


@pytest.fixture
def run(spring_slider):
    """Return what a run holds: two periods, and wear in a corner."""
    def period(mu):
        x, force = spring_slider(np.arange(200) / 200, mu=mu)
        place = np.outer(x, [1.0, 0.0, 0.0])
        return SimpleNamespace(upper_observation=0.75 * place, lower_observation=-0.25 * place, friction_force=force)

    def signals(period):
        phase = 2.0 * np.pi * np.arange(200) / 200
        return Signals(step=5e-5, displacement=period.upper_observation[:, 0] - period.lower_observation[:, 0],
                       friction_force=period.friction_force, arm=np.zeros(200), normal_force=np.full(200, 60.0),
                       excitation=50.0 * np.cos(phase) + DISTORTED * np.cos(3.0 * phase))

    case = validate_case({"format": "fretflow-case/1", "name": "made", "title": 'of "mine"', "test": {
        "excitation_frequency": "100 Hz", "excitation_amplitude": "50 N", "normal_load": "60 N", "cycles": 5000}})
    history = SimpleNamespace(volume=np.array([0.0, 2e-12]), depth=np.array([[0.0] * 4, [0.0, 0.0, 0.0, 8e-6]]))
    nodes = np.array([[x, y] for x in (-1e-3, 1e-3) for y in (-1e-3, 1e-3)])
    periods = {cycles: period(mu) for cycles, mu in MU.items()}
    return SimpleNamespace(case=case, periods=periods, nodes=nodes, history=history, has=lambda stage: stage == "wear",
                           channels={cycles: signals(own) for cycles, own in periods.items()})


def exported(run, folder, noise=0.0):
    return export_recording(run.case, run, run.channels, folder, noise)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_what_is_read_is_what_was_run(run, exact, tmp_path, noise):
    files = exported(run, tmp_path / "a", noise)
    assert [file.name for file in files] == ["recording.toml", "loops.csv", "wear_depth.csv"]
    recording = read_joint_recording(tmp_path / "a")
    assert recording.title == 'of "mine"'
    assert "as stiff as 10 by 10 elements of degree 1" in (tmp_path / "a" / "recording.toml").read_text()
    assert recording.test.cycles == 5000
    assert recording.rig == run.case.rig
    assert recording.wear.worn_volume == pytest.approx(2e-12, rel=1e-12)
    assert recording.wear_depth.channels["depth"].tolist() == pytest.approx([0.0, 0.0, 0.0, 8e-6])
    (loop_set,), _ = read_sets(recording, recording.test.normal_load)
    assert loop_set.loops.displacement_of.distance == run.case.specimen.upper.observation_distance
    assert loop_set.loops.repeats.tolist() == [3 if noise else 1] * 2
    for name in ("friction_coefficient", "tangential_stiffness", "dissipated_energy", "peak_to_peak"):
        reading, wanted = getattr(loop_set.readings, name), [exact(mu)[name] for mu in MU.values()]
        assert np.all(np.abs(reading.value - wanted) < 4.0 * reading.sd + 5e-3 * np.array(wanted)), name
    thirds = np.fft.rfft(loop_set.loops.mean("excitation"), axis=1)[:, 3].real / 100
    assert thirds == pytest.approx(np.full(2, DISTORTED), rel=1e-6)
    force = loop_set.loops.force
    scatter = np.std(force - force.mean(axis=1, keepdims=True), axis=(1, 2)) * np.sqrt(3 / 2)
    assert scatter == pytest.approx([noise * mu * 60.0 for mu in MU.values()], rel=0.1)


def test_a_run_and_its_recording_stand_over_one_phase(run, tmp_path, monkeypatch):
    exported(run, tmp_path / "a")
    for period in run.periods.values():
        period.displacement = period.upper_observation[:, None]
    monkeypatch.setattr(RunResults, "periods", run.periods)
    monkeypatch.setattr(RunResults, "areas", np.ones(1))
    own, read = RunResults({}, run.case, tmp_path).loops, read_joint_recording(tmp_path / "a").arrays
    assert own.phase.values == pytest.approx(read.phase.values, abs=1e-9)
    assert own.phase.attrs["units"] == read.phase.attrs["units"] == "rad"
    assert own.friction_force.values == pytest.approx(read.friction_force.values[:, 0], abs=1e-6)


def test_a_run_that_cannot_be_one_is_refused(run, tmp_path, capsys, monkeypatch):
    exported(run, tmp_path)
    with pytest.raises(InputError, match="exists and is left as it is"):
        exported(run, tmp_path)
    with pytest.raises(InputError, match="share from 0 to below 1"):
        exported(run, tmp_path / "b", float("nan"))
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["export", "nothing"]) == 2
    assert "holds no run" in capsys.readouterr().err
    results = RunResults({}, run.case, tmp_path)
    monkeypatch.setattr(RunResults, "of", lambda home: results)
    monkeypatch.setattr(RunResults, "channels", run.channels)
    assert cli.execute(["export", "run", "--to", "given"]) == 0
    assert "of one with --noise, diagnose explains it" in capsys.readouterr().out
    assert cli.execute(["export", "run", "--to", "noisy", "--noise", "0.01"]) == 0
    assert "`fretflow diagnose noisy` explains it" in capsys.readouterr().out
    assert not (tmp_path / "given" / "wear_depth.csv").exists()
