"""The loops command: a table for people, a CSV and JSON for programs, a picture, and one line where it cannot.

What carries the weight: what the JSON and the CSV say are the readings in closed form with their deviations, and
what the user says never overrides the recording.
"""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow import cli
from fretflow.cli.loops import with_error
from fretflow.recordings import loop_sets
from fretflow.recordings.readings import LoopReading, Source
from fretflow_post.recorded_loops import Panel, _draw
from matplotlib.figure import Figure
from matplotlib.image import imread

NAMES = ("friction_coefficient", "tangential_stiffness", "sliding_distance", "dissipated_energy", "peak_to_peak")


def loops(*arguments):
    return cli.execute(["loops", *map(str, arguments)])


@pytest.fixture(scope="module")
def done(make, tmp_path_factory):
    """Return the folder of a run whose friction rises over three cycle counts."""
    home = tmp_path_factory.mktemp("loops")
    made = make(cycles=(0, 1000, 50000), repeats=3, noise=(3e-8, 0.3), mu=(0.4, 0.5, 0.6))
    made.extra = {"displacement": {"calibration_sd": 0.01}, "friction_force": {"calibration_sd": 0.02}}
    made.columns["friction_force"][[3, 4]] = np.nan
    assert loops(made.write(home / "rising"), "--out", home, "--json", home / "all.json") == 0
    return home


def test_json_holds_every_reading_with_its_deviation(done, exact):
    whole = json.loads((done / "all.json").read_text())
    assert whole["kind"] == "fretting-rig"
    assert whole["normal_load"] == {"value": 60.0, "unit": "N"}
    rows = whole["sets"][0]["loops"]
    assert [row["cycle"] for row in rows] == [0, 1000, 50000]
    for row, mu in zip(rows, (0.4, 0.5, 0.6), strict=True):
        for name in NAMES:
            reading = row[name]
            assert abs(reading["value"] - exact(mu)[name]) < 4.0 * reading["sd"], name
        assert row["friction_coefficient"]["sd"] == pytest.approx(0.02 * mu, rel=0.05)
        assert row["friction_coefficient"]["mostly_by"] == "calibration"
    floor = whole["sets"][0]["repeatability"]["friction_force"]
    assert floor["noise_sd"] == pytest.approx(0.3, rel=0.1)
    assert [(w["channel"], w["rows"]) for w in whole["warnings"]] == [("friction_force", [[4, 5]])]


def test_csv_and_picture(done, exact):
    folder = done / "rising-loops"
    with (folder / "loops_readings.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["cycles"] for row in rows] == ["0", "1000", "50000"]
    assert float(rows[2]["tangential_stiffness_N_per_m"]) == pytest.approx(
        exact()["tangential_stiffness"], abs=4.0 * float(rows[2]["tangential_stiffness_sd_N_per_m"]))
    with (folder / "loops.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 3 * 200
    image = imread(folder / "loops.png")
    assert image.shape[1] == 1600
    assert 0.01 < np.mean(image[..., :3].min(axis=2) < 0.9) < 0.6


def test_table_and_warnings_are_shown(make, tmp_path, capsys):
    made = make(noise=(3e-8, 0.3))
    made.columns["friction_force"][10] = np.nan
    assert loops(made.write(tmp_path / "a"), "--out", tmp_path) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "gross slip; ± one standard deviation, mostly noise" in shown
    assert "loops, friction_force, row 11: no number there; filled by interpolation" in shown


def test_a_lumped_record_tells_work_but_no_friction_law(make, tmp_path, capsys):
    made = make(cycles=(0,), repeats=1, periods=5.3, excitation=False)
    del made.columns["cycle"], made.columns["repeat"]
    made.test = {"kind": "lumped"}
    assert loops(made.write(tmp_path / "a", block="series"), "--out", tmp_path) == 0
    shown = capsys.readouterr().out
    assert "work of the force" in shown
    assert "friction coefficient" not in shown
    # Work 2 mu N s over twice the stroke 2 A: 36 N times 12.4 / 16.
    with (tmp_path / "a-loops" / "series_readings.csv").open(newline="") as file:
        assert {row["friction_limit_N"] for row in csv.DictReader(file)} == {"nan"}
    row = next(line for line in shown.splitlines() if line.startswith(" 1 "))
    mean = row.split()[-1].partition("±")[0]
    assert float(mean) == pytest.approx(27.9, rel=1e-3)


def test_bare_file_with_options(tmp_path, spring_slider, capsys):
    x, force = spring_slider(np.arange(700) / 200)
    np.savetxt(tmp_path / "a.txt", np.column_stack([np.arange(700) * 0.01, 1e3 * x, force]))
    options = ["--time", "1 [s]", "--displacement", "2 [mm]", "--force", "3 [N]", "--normal-load", "60 N"]
    assert loops(tmp_path / "a.txt", *options, "--out", tmp_path, "--json", tmp_path / "a.json") == 0
    rows = json.loads((tmp_path / "a.json").read_text())["sets"][0]["loops"]
    assert rows[0]["friction_coefficient"]["value"] == pytest.approx(0.6, rel=1e-3)
    assert loops(tmp_path / "a.txt", *options[:-2], "--out", tmp_path) == 0
    assert "the friction limit is given instead of a coefficient" in capsys.readouterr().out


@pytest.mark.parametrize(("options", "message"), [
    (["--normal-load", "50 N"], "--normal-load: 50 where the recording says 60"),
    (["--normal-load", "50"], "--normal-load: '50' has no unit"),
    (["--normal-load=-5 N"], "--normal-load: must be positive"),
    (["--frequency", "90 Hz"], "--frequency: 90 where the recording says 100"),
    (["--force", "x [N]"], "--force: columns are named in recording.toml already"),
])
def test_what_the_recording_says_wins(make, tmp_path, capsys, options, message):
    folder = make().write(tmp_path / "a")
    assert loops(folder, *options, "--out", tmp_path) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert loops(folder, "--normal-load", "60 N", "--out", tmp_path) == 0


@pytest.mark.parametrize(("load", "ratio"), [("60 kN", "0.0006"), ("60 mN", "600")])
def test_a_normal_load_of_another_unit_than_meant_is_named(make, tmp_path, capsys, load, ratio):
    made = make()
    made.test.pop("normal_load")
    folder = made.write(tmp_path / "a")
    assert loops(folder, "--normal-load", load, "--out", tmp_path) == 2
    error = capsys.readouterr().err
    assert f"{ratio} times the normal load of {load}" in error
    assert error.count("\n") == 1


def test_nothing_there(tmp_path, capsys):
    assert loops(tmp_path / "none") == 2
    assert "there is no such folder or file" in capsys.readouterr().err
    assert loops(tmp_path) == 2
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(("value", "sd", "text"), [
    (0.40031, 0.00172, "0.4003±0.0017"), (33.271, 0.162, "33.27±0.16"), (1234.0, 56.0, "1234±56"),
    (1234.0, 560.0, "1234±560"), (2.0, 0.0, "2"), (float("nan"), 1.0, "-"), (3.0, float("nan"), "3±?"),
    (241_000.0, 0.0, "241,000"),
])
def test_numbers_stop_where_their_deviation_does(value, sd, text):
    assert with_error(value, sd) == text


@pytest.mark.parametrize(("index", "width"), [("cycles", 1.2), ("conditions", 0.0)])
def test_conditions_have_no_order_to_join_them_by(index, width):
    at = np.arange(3)
    reading = LoopReading(value=at + 1.0, noise=np.full(3, 0.1), repeats=np.zeros(3), calibration=np.zeros(3))
    axes = Figure().add_subplot()
    names = ("excitation 53 N", "load 45 N", "80 Hz")
    loops_read = loop_sets.LoopsRead("sweep", index, names, None, SimpleNamespace(cycles=at))
    _draw(axes, Panel("friction", reading, "1"), loops_read, last=True)
    assert axes.lines[0].get_linewidth() == width
    shown = [label.get_text() for label in axes.get_xticklabels()]
    assert (shown == ["excitation\n53 N", "load\n45 N", "80 Hz"]) == (index == "conditions")


def test_conditions_are_called_by_what_differs_from_the_test(make, tmp_path, capsys):
    made = make(cycles=(0, 1, 2), repeats=2, noise=(3e-8, 0.3))
    made.columns["condition"] = made.columns.pop("cycle")
    made.tables = "".join(f"[[sweep.conditions]]\nid = {k}\n{keys}\n" for k, keys in enumerate(
        ("", 'excitation_amplitude = "55 N"', 'normal_load = "59 N"\nexcitation_frequency = "100 Hz"')))
    folder = made.write(tmp_path / "a", block="sweep")
    assert loops(folder, "--out", tmp_path, "--json", tmp_path / "a.json") == 0
    shown = capsys.readouterr().out
    assert all(text in shown for text in ("as the test", "excitation", "55 N", "load 59 N"))
    rows = json.loads((tmp_path / "a.json").read_text())["sets"][0]["loops"]
    assert [row["called"] for row in rows] == ["as the test", "excitation 55 N", "load 59 N"]


def test_readings_take_time_in_proportion_to_the_cycles(monkeypatch):
    """What dominates an uncertainty is found once for all cycles: each source is asked for a fixed number of times."""
    asked = []
    monkeypatch.setattr(np, "stack", lambda parts, stack=np.stack: asked.append(len(parts)) or stack(parts))
    many = np.linspace(1.0, 2.0, 50)
    reading = LoopReading(value=many, noise=0.1 * many, repeats=np.zeros(50), calibration=0.2 * many)
    assert [reading.dominated_by[k] for k in range(50)] == [Source.CALIBRATION] * 50
    assert asked == [3]


def test_friction_below_zero_is_refused(make, tmp_path, capsys, monkeypatch):
    """However samples are damaged: what no contact has is no result."""
    seen = loop_sets.read_recorded_loops

    def damaged(*arguments):
        read = seen(*arguments)
        return replace(read, friction_limit=replace(read.friction_limit, value=-read.friction_limit.value))

    monkeypatch.setattr(loop_sets, "read_recorded_loops", damaged)
    assert loops(make().write(tmp_path / "a"), "--out", tmp_path) == 2
    assert "friction force of loop 0: its plateaus are the wrong way round" in capsys.readouterr().err
