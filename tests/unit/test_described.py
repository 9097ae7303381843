"""A recording.toml for a file of loops: what headings tell is read as the file by itself is, the rest is asked for.

What carries the weight: the closed form of a spring and slider comes back through the file that was written, with the
sign of a reversed force turned.
"""

import tomllib

import numpy as np
import pytest
from fretflow import cli
from fretflow.recordings.loop_sets import read_sets, recorded
from fretflow.recordings.recording import read_joint_recording


@pytest.fixture
def series(make, tmp_path):
    """Return a writer of a long record under headings of its own, without a recording.toml."""
    def write(headings, force=1.0, name="record.csv"):
        made = make(cycles=(0,), repeats=1, periods=6.5)
        columns = [made.columns["time"], made.columns["displacement"] * 1e6, force * made.columns["friction_force"]]
        np.savetxt(tmp_path / name, np.column_stack(columns), delimiter=",", comments="", header=headings)
        return tmp_path / name

    return write


def init(*arguments):
    return cli.execute(["init", *map(str, arguments)])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_headings_tell_is_enough(series, exact, capsys, sign):
    file = series("time_s,x [um],Ft [N]", sign)
    assert init("--recording", file) == 0
    toml = file.with_name("recording.toml")
    said = capsys.readouterr().out
    assert f"fretflow diagnose {toml}" in said
    assert "displacement from 'x [um]', friction force from 'Ft [N]', time from 'time_s'" in said
    given = tomllib.loads(toml.read_text())
    assert given["test"]["excitation_frequency"] == "100 Hz"
    assert given["series"]["friction_force"] == {"column": "Ft [N]", "unit": "N", "scale": sign}
    (read,) = read_sets(read_joint_recording(toml), 60.0)[0]
    assert read.readings.friction_coefficient.value == pytest.approx(exact()["friction_coefficient"], rel=5e-3)
    assert read.readings.dissipated_energy.value == pytest.approx(exact()["dissipated_energy"], rel=5e-3)
    if sign > 0.0:
        (bare,) = read_sets(*recorded(file, {}, 60.0, None))[0]
        assert read.readings.friction_limit.value == pytest.approx(bare.readings.friction_limit.value, rel=1e-12)


def test_what_they_do_not_tell_is_asked_for(series, capsys):
    file = series("t_s,laser,load_cell")
    toml = file.with_name("recording.toml")
    assert init("--recording", file) == 0
    assert "tell the column and unit of displacement and friction_force in it" in capsys.readouterr().out
    text = toml.read_text()
    assert "its column: one of t_s, laser, load_cell; its unit, such as um" in text
    assert '# not read: "laser"' in text
    assert cli.execute(["loops", str(toml)]) == 2
    assert "series.displacement.unit: is required" in capsys.readouterr().err
    text = text.replace('displacement = { column = "", unit = ""', 'displacement = { column = "laser", unit = "um"')
    toml.write_text(text.replace('column = "load_cell", unit = ""', 'column = "load_cell", unit = "N"'))
    assert len(read_joint_recording(toml).series.channels) == 2


def test_columns_that_may_be_one_channel_are_left_to_the_user(series, capsys):
    file = series("time_s,A [um],B [um]")
    assert init("--recording", file) == 0
    assert "tell the column and unit of displacement and friction_force in it" in capsys.readouterr().out
    assert "its column: one of A [um], B [um]; its unit, such as um" in file.with_name("recording.toml").read_text()


def test_loops_of_several_cycle_counts_and_a_folder_elsewhere(make, tmp_path):
    folder = make().write(tmp_path / "a")
    (folder / "recording.toml").unlink()
    (tmp_path / "b").mkdir()
    assert init(tmp_path / "b" / "recording.toml", "--recording", folder / "loops.csv") == 0
    given = tomllib.loads((tmp_path / "b" / "recording.toml").read_text())
    assert given["loops"]["file"] == "../a/loops.csv"
    assert read_joint_recording(tmp_path / "b").loops.cycles.tolist() == [0, 1000]


def test_what_is_there_stays_and_what_is_no_loop_is_refused(series, capsys, tmp_path):
    file = series("time_s,x_um,force_N")
    (tmp_path / "recording.toml").write_text("mine")
    assert init("--recording", file) == 2
    assert "exists and is left as it is" in capsys.readouterr().err
    assert (tmp_path / "recording.toml").read_text() == "mine"
    assert init("--recording", tmp_path / "none.csv") == 2
    assert "there is no such file" in capsys.readouterr().err


def test_a_scale_of_zero_is_none(make, tmp_path, capsys):
    made = make()
    made.extra = {"displacement": {"scale": 0.0}}
    assert cli.execute(["loops", str(made.write(tmp_path))]) == 2
    assert "displacement.scale: must not be zero" in capsys.readouterr().err
