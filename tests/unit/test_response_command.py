"""The response command on a joint of two nodes: curves, their table, files and picture, and what is refused.

What carries the weight: what stands in the files is what is read off the curves; each curve belongs to its own load
and wear, and is made once and again only when something that it depends on has changed.
"""

import csv
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import xarray as xr
from fretflow import cli
from fretflow.case.casefile import dump_case
from fretflow.case.config import Solver, validate_case
from fretflow.cli import response as cli_response
from fretflow.cli import terminal
from fretflow.cli.terminal import INTERRUPTED
from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError
from fretflow.core.store import read_record, write_record
from fretflow.effects.model import EffectModel
from fretflow.pipeline import response_curves as stage
from fretflow.pipeline.problem import rig_problem
from fretflow.pipeline.results import RunResults
from fretflow.pipeline.stage import CASE_FILE, RUN_FILE, Manifest, write_json
from fretflow.solvers.continuation import checkpoint
from fretflow.solvers.continuation.curve import ResponseCurve, SweepDirection, read_peak
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.history import WearHistory
from matplotlib.image import imread

NODES, CYCLES = 2, 5000
FLEXIBILITY = np.kron(2e-7 * np.eye(NODES) + 5e-8, np.eye(3))
PROBLEM = rig_problem(
    joint=QuasiStaticJoint.from_stiffness(np.linalg.inv(FLEXIBILITY),
                                          LumpedRig.from_modes(10.0, 0.5, 40.0, 900.0, 0.05)),
    interface=Interface(nodes=np.zeros((NODES, 2)), areas=np.full(NODES, 5e-7), gap=np.zeros(NODES)),
    friction_coefficient=0.88, frequency=100.0, excitation=75.0, normal_load=60.0)
CASE = validate_case({"format": "fretflow-case/1", "name": "toy",
                      "test": {"excitation_amplitude": "75 N", "cycles": CYCLES},
                      "output": {"frequency_response": {"start": "36 Hz", "stop": "54 Hz"}}})
DEPTH = np.array([0.0, 2e-5])  # so deep that the second node is out of reach


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Return the folder of a run of the toy joint, which opens as it wears."""
    monkeypatch.setattr(stage, "make_model", lambda case, folder: EffectModel.build(PROBLEM))
    monkeypatch.setattr(stage, "HARMONICS", 11)
    monkeypatch.setattr(stage, "SAMPLES", 192)
    home = tmp_path / "runs" / "toy"
    for name in ("reduce", "wear"):
        (home / name).mkdir(parents=True)
    none = np.zeros(2)
    write_record(home / "wear" / "history.h5", WearHistory(
        cycles=np.array([0, CYCLES]), depth=np.array([none, DEPTH]), rate=np.zeros((2, NODES)), volume=none,
        dissipated_energy=none, sliding_distance=none, energy=none, approach=none, upper_share=0.5, solves=2,
        stopped_by="cycles"))
    for name in ("reduce", "wear"):
        Manifest(name, 1, name, {}, {}, {}, None, 1, 0.0, 0, False, "").write(home / name)
    write_json(home / RUN_FILE, {"case": "toy", "stages": {"reduce": "reduce", "wear": "wear"}})
    case = CASE.model_copy(update={"solver": Solver(harmonics=11, samples=192)})
    (home / CASE_FILE).write_text(dump_case(case), encoding="utf-8")
    return home


def rows(path):
    with path.open(encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def test_the_command_makes_curves_and_reads_them_off(home, capsys):
    assert cli.execute(["response", str(home)]) == 0
    shown = capsys.readouterr().out
    folder = home / stage.FOLDER
    curves = {run.state: run for run in (read_record(path, stage.RunCurve) for path in folder.glob("*.h5"))}
    assert {state: run.cycles for state, run in curves.items()} == {"unworn": 0, "worn": CYCLES}
    with xr.open_dataset(next(folder.glob("unworn*.h5")), group="curve", engine="h5netcdf") as kept:
        block = kept.first_harmonic.sel(channels="block")
        assert block.dims == ("point",)
        assert block.values.tolist() == curves["unworn"].curve.first_harmonic[:, 0].tolist()
    peaks = {(row["state"], row["direction"]): row for row in rows(folder / "peaks.csv")}
    assert set(peaks) == {(state, way) for state in ("unworn", "worn") for way in ("up", "down")}
    for (state, way), row in peaks.items():
        peak = read_peak(curves[state].curve, "block", SweepDirection[way.upper()])
        assert float(row["frequency_Hz"]) == pytest.approx(peak.frequency)
        assert float(row["amplitude_m"]) == pytest.approx(peak.amplitude, abs=0.0)
        assert float(row["damping_ratio"]) == pytest.approx(peak.damping_ratio)
        assert 42.0 < peak.frequency < 45.0
        assert f"{peak.frequency:.2f} Hz" in shown
    points = rows(folder / "curves.csv")
    assert len(points) == sum(len(run.curve.frequency) for run in curves.values())
    assert {row["stable"] for row in points} == {"True"}
    assert all(float(row["residual"]) <= 1e-4 for row in points)
    assert imread(folder / "curves.png").shape[1] == 1600
    told = json.loads((folder / stage.PEAKS).read_text(encoding="utf-8"))
    assert told["stages"] == {"reduce": "reduce", "wear": "wear"}
    folders = {name: home / name for name in ("reduce", "wear")}
    names = [name for name, _, _ in stage.kept_peaks(folders)]
    assert names[0] == "unworn, 75 N, down"
    assert stage.kept_peaks({**folders, "wear": home / "wear-other"}) == []


def test_the_bar_of_a_curve_promises_no_time(home, capsys, monkeypatch):
    """A curve's points say nothing of how many follow: the bar had stood at "5 s left" for 20 minutes."""
    monkeypatch.setattr(terminal, "Terminal", partial(terminal.Terminal, force_terminal=True, width=100))
    assert cli.execute(["response", str(home), "--unworn", "--start", "39 Hz", "--stop", "41 Hz"]) == 0
    said = capsys.readouterr().out
    assert " Hz" in said
    assert "left " not in said


def test_python_has_the_curves_asked_for_last_as_labelled_arrays(home, capsys):
    assert RunResults.of(home).response_curves == {}
    assert cli.execute(["response", str(home), "--excitation", "60 N", "--start", "38 Hz", "--stop", "40 Hz"]) == 0
    assert cli.execute(["response", str(home), "--stop", "52 Hz"]) == 0
    curves = RunResults.of(home).response_curves
    assert list(curves) == ["unworn, 75 N", "worn, 75 N"]
    peaks = {(row["state"], row["direction"]): row for row in rows(home / stage.FOLDER / "peaks.csv")}
    for name, curve in curves.items():
        up = curve.sel(channel="block").isel(point=curve.direction.values == 1)
        read = peaks[name.split(",")[0], "up"]
        top = int(np.argmax(up.amplitude.data))
        assert float(up.frequency[top]) == pytest.approx(float(read["frequency_Hz"]), rel=0.01)
        assert float(up.amplitude.max()) == pytest.approx(float(read["amplitude_m"]), rel=0.01)
        assert up.amplitude.attrs["units"] == "m"
        assert up.frequency.attrs["units"] == "Hz"
        assert 0.0 < float(up.phase[0]) < float(up.phase[-1]) < np.pi  # behind the force, more so past resonance
        assert curve.cycles == (0 if name.startswith("unworn") else CYCLES)
    write_json(home / RUN_FILE, {"case": "toy", "stages": {"reduce": "reduce"}})  # worn once more, otherwise
    assert RunResults.of(home).response_curves == {}


def test_a_point_of_a_curve_is_the_period_that_the_solver_finds(home):
    assert cli.execute(["response", str(home), "--unworn"]) == 0
    (path,) = (home / stage.FOLDER).glob("*.h5")
    curve: ResponseCurve = read_record(path, stage.RunCurve).curve
    own = curve.along(SweepDirection.UP)
    for k in own[[1, len(own) // 2, -2]]:
        problem = PROBLEM.vary(frequency=float(curve.frequency[k]))
        samples = int(curve.samples[k])
        settings = Solver(harmonics=11, samples=samples, tolerance=1e-7, estimate_error=False)
        block = QuasiStaticSolver(settings).solve(problem).rig_displacement[:, 0]
        expected = 2.0 * np.fft.rfft(block)[1] / samples
        assert curve.first_harmonic[k, 0] == pytest.approx(expected, rel=1e-3, abs=0.0)


def test_a_curve_is_made_once_for_its_load(home, monkeypatch):
    made = []
    follow = stage.respond
    monkeypatch.setattr(stage, "respond", lambda problem, *settings: made.append(problem.excitation.amplitude)
                        or follow(problem, *settings))
    ask = ["response", str(home), "--unworn", "--stop", "41 Hz", "--start", "39 Hz"]
    assert cli.execute([*ask, "--excitation", "90 N"]) == 0
    assert cli.execute([*ask, "--excitation", "90 N", "--excitation", "0.08 kN"]) == 0
    assert made == [90.0, 80.0]
    levels = {row["excitation_N"] for row in rows(home / stage.FOLDER / "peaks.csv")}
    assert levels == {"80.0", "90.0"}


def test_neither_or_both_flags_mean_both_states():
    assert cli_response.states_of(False, False) == cli_response.states_of(True, True) == ("unworn", "worn")
    assert cli_response.states_of(True, False) == ("unworn",)
    assert cli_response.states_of(False, True) == ("worn",)


@pytest.mark.parametrize(("options", "words"), [
    (["--start", "20"], "--start: '20' has no unit"),
    (["--excitation", "3 mm"], "--excitation: "),
    (["--excitation", "0 N"], "must be positive"),
    (["--start", "50 Hz", "--stop", "40 Hz"], "start must be positive and below stop")])
def test_options_that_cannot_be_used_are_refused(home, capsys, options, words):
    assert cli.execute(["response", str(home), *options]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_run_without_wear_has_no_worn_curve(home):
    folders = {"reduce": home / "reduce"}
    sweep = stage.sweep_of(CASE, None, None)
    with pytest.raises(InputError, match="stage wear is not complete"):
        stage.asked_curves(CASE, folders, ("worn",), [75.0], sweep, home)
    assert len(stage.asked_curves(CASE, folders, ("unworn",), [53.0, 75.0], sweep, home)) == 2


def test_no_run_is_refused(tmp_path, capsys):
    assert cli.execute(["response", str(tmp_path)]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_gaps_in_a_curve_are_told(home, capsys):
    assert cli.execute(["response", str(home), "--unworn", "--start", "39 Hz", "--stop", "41 Hz"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "bridged" not in said
    assert "end of the frequency range --start and --stop widen the range" in said  # 39 to 41 Hz hold no peak
    (path,) = (home / stage.FOLDER).glob("*.h5")
    run = read_record(path, stage.RunCurve)
    bridged = np.zeros(len(run.curve.frequency), dtype=bool)
    bridged[run.curve.along(SweepDirection.UP)[1]] = True
    cli_response.show_peaks([replace(run, curve=replace(run.curve, bridged=bridged))])
    assert "unworn, 75 N, up: 1 gap bridged: there the curve could not be followed" in capsys.readouterr().out


def test_what_is_said_of_several_curves_is_said_once_with_the_way_out(home, capsys):
    assert cli.execute(["response", str(home), "--unworn", "--start", "39 Hz", "--stop", "41 Hz"]) == 0
    said = capsys.readouterr().out
    assert said.count("no damping") == said.count("--start and --stop widen") == 1


def test_an_interrupted_command_goes_on_from_its_points(home, monkeypatch):
    monkeypatch.setattr(checkpoint, "RARELY", 0.0)
    follow, points, last = stage.respond, [], 6

    def counted(problem, sweep, note, unfinished):
        def counting(direction, frequency):
            points.append(frequency)
            if len(points) == last:
                raise KeyboardInterrupt
            note(direction, frequency)

        return follow(problem, sweep, counting, unfinished)

    monkeypatch.setattr(stage, "respond", counted)
    ask = ["response", str(home), "--unworn", "--start", "38 Hz", "--stop", "42 Hz"]
    assert cli.execute(ask) == INTERRUPTED
    (part,) = (home / stage.FOLDER).glob(f"*{stage.UNFINISHED}")
    first, points[:], last = set(points[:-1]), [], -1
    assert cli.execute(ask) == 0
    (file,) = (home / stage.FOLDER).glob("*.h5")
    assert part.with_suffix(".h5") == file
    assert not part.exists()
    assert points[0] not in first
    kept, points[:] = file.read_bytes(), []
    file.unlink()
    assert cli.execute(ask) == 0
    assert file.read_bytes() == kept
    assert first < set(points)
