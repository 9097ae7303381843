"""Tables of wear tests: what headings say, and what is wrong with a table.

What carries the weight: one table with one thing broken at a time; each ends in one line that names the column or the
row, and nothing is left out without a note.
"""

from pathlib import Path

import numpy as np
import pytest
from fretflow import cli
from fretflow.cli import app
from fretflow.core.errors import ConfigError, CorruptRecordingError, InputError, RecordingError
from fretflow.recordings.kinds import kind_at
from fretflow.recordings.kinds.wear_headings import Heading, roles_of, take_apart
from fretflow.recordings.kinds.wear_series import WEAR_SERIES, read_wear_series
from fretflow.recordings.recording import read_joint_recording

HEADINGS = ("test", "p_MPa", "delta_um", "f_Hz", "N_cycles", "E_J", "V_mm3")
TOML = """format = "fretflow-recording/1"
title = "Pins"
[test]
kind = "wear-series"
[wear_series]
file = "tests.csv"
"""


def rows(count=12):
    rng = np.random.default_rng(1)
    p, d, n = rng.uniform(50, 150, count), rng.uniform(20, 80, count), rng.choice([1e4, 2e4], count)
    energy = 3e-6 * p * d * n
    volume = 3e-5 * energy * np.exp(0.05 * rng.standard_normal(count))
    return [[f"T{k}", *(f"{x:.6g}" for x in values)]
            for k, values in enumerate(zip(p, d, np.full(count, 2.0), n, energy, volume, strict=True))]


def written(path, cells, headings=HEADINGS):
    path.write_text("\n".join([",".join(headings), *(",".join(row) for row in cells)]) + "\n")
    return path


@pytest.fixture
def table(tmp_path):
    return lambda cells, headings=HEADINGS: written(tmp_path / "tests.csv", cells, headings)


def text_of(error):
    said = str(error.value)
    assert "\n" not in said
    return said


@pytest.mark.parametrize(("heading", "name", "unit", "factor"), [
    ("V_mm3", "V", "mm^3", 1.0), ("SigmaEd_J", "SigmaEd", "J", 1.0), ("pmax_H_MPa", "pmax_H", "MPa", 1.0),
    ("Pmax_N_per_mm", "Pmax_N_per_mm", "", 1.0), ("phi_star_W_per_mm2", "phi_star", "W/mm^2", 1.0),
    ("alpha_1e-5_mm3_per_J", "alpha", "mm^3/J", 1e-5), ("Wear volume [10 um3]", "Wear volume", "um^3", 10.0),
    ("Pressure (MPa)", "Pressure", "MPa", 1.0), ("N_cycles", "N_cycles", "", 1.0), ("RP", "RP", "", 1.0),
    ("sd_V [mm^3]", "sd_V", "mm^3", 1.0)])
def test_headings_are_taken_apart(heading, name, unit, factor):
    assert take_apart(heading) == Heading(name, unit, factor)


def test_roles_go_by_dimension_and_then_by_name():
    names = ("R_mm", "delta_um", "V_mm3", "sd_V_mm3", "Q_MPa", "p_MPa", "N", "N_cycles", "Fn_N")
    roles = roles_of({name: take_apart(name) for name in names})
    assert roles["amplitude"] == ("delta_um",)
    assert roles["volume"] == ("V_mm3",)
    assert roles["volume_sd"] == ("sd_V_mm3",)
    assert roles["pressure"] == ("p_MPa", "Q_MPa")
    assert roles["load"] == ("Fn_N",)
    assert set(roles["cycles"]) == {"N", "N_cycles"}


def test_numbers_are_in_si(table):
    series = read_wear_series(table([["a", "100", "50", "2", "20000", "400", "0.012"]] * 6))
    assert series.volume == pytest.approx(np.full(6, 0.012e-9), abs=0.0)
    assert series.energy == pytest.approx(np.full(6, 400.0))
    assert {name: values[0] for name, values in series.states.items()} == pytest.approx(
        {"pressure": 1e8, "amplitude": 50e-6, "frequency": 2.0, "cycles": 2e4}, rel=1e-12, abs=0.0)
    assert [str(note) for note in series.notes] == ["tests.csv, test: holds text and is left out"]


def test_a_recording_names_the_table_and_its_columns(table, tmp_path):
    table(rows(), ("test", "a", "b", "f_Hz", "N_cycles", "E_J", "volume"))
    (tmp_path / "recording.toml").write_text(TOML + 'volume = { column = "volume", unit = "mm^3" }\n'
                                             'pressure = { column = "a", unit = "MPa" }\n'
                                             'amplitude = { column = 2, unit = "um" }\n')
    assert kind_at(tmp_path) is WEAR_SERIES
    assert kind_at(tmp_path / "recording.toml") is WEAR_SERIES
    series = read_wear_series(tmp_path)
    assert series.title == "Pins"
    assert series.states["pressure"].min() > 4e7
    assert series.states["amplitude"].max() < 1e-4
    with pytest.raises(ConfigError, match=r"test\.kind"):
        read_joint_recording(tmp_path)


@pytest.mark.parametrize(("line", "said"), [
    ('volume = { column = "V_mm3", unit = "N" }', "wear_series.volume.unit"),
    ('volumes = { column = "V_mm3" }', "wear_series.volumes"),
    ('volume = "V_mm3"', "wear_series.volume"),
    ('volume = { column = "W_mm3", unit = "mm^3" }', "no column 'W_mm3'"),
    ('volume = { column = "volume", units = "mm^3" }',
     "wear_series.volume.units: unknown key; there are column and unit; did you mean unit")])
def test_a_wrong_key_is_named(table, tmp_path, line, said):
    table(rows())
    (tmp_path / "recording.toml").write_text(TOML + line + "\n")
    with pytest.raises(InputError) as error:
        read_wear_series(tmp_path)
    assert said in text_of(error)


def test_energy_that_is_not_given_is_worked_out_and_said(table):
    cells = [[*row, ""] for row in rows()]
    for k in (2, 3):
        cells[k][5], cells[k][7] = "", "3"
    cells[7][5] = ""
    series = read_wear_series(table(cells, (*HEADINGS, "alpha_1e-5_mm3_per_J")))
    said = [str(note) for note in series.notes]
    assert "tests.csv, energy, rows 3-4: is taken as volume over coefficient" in said
    assert "tests.csv, energy, row 8: is taken in proportion to load or pressure times sliding" in said
    assert series.energy[2] == pytest.approx(series.volume[2] / 3e-14)
    assert series.energy[7] == pytest.approx(float(rows()[7][5]), rel=0.05)


def test_rows_without_a_number_are_named(table):
    cells = rows()
    cells[3][6], cells[4][6], cells[5][1], cells[8][6] = "", "nan", "", "-0.01"
    series = read_wear_series(table(cells))
    assert list(series.rows) == [1, 2, 3, 7, 8, 10, 11, 12]
    said = [str(note) for note in series.notes]
    assert "tests.csv, worn volume, rows 4-5: has no number: the test is left out" in said
    assert "tests.csv, pressure, row 6: has no number: the test is left out" in said
    assert "tests.csv, worn volume, row 9: is not above zero: the test is left out" in said


def test_a_table_that_is_cut_off_says_so(table):
    path = table(rows())
    path.write_text(path.read_text()[:-12])
    series = read_wear_series(path)
    assert any("row 12: the file is cut off within this row" in str(note) or "row 12" in str(note)
               for note in series.notes)
    assert len(series.rows) == 11


def without(column):
    keep = [k for k in range(len(HEADINGS)) if HEADINGS[k] != column]
    return [[row[k] for k in keep] for row in rows()], tuple(HEADINGS[k] for k in keep)


def changed(column, change):
    place = HEADINGS.index(column)
    return [[change(cell) if k == place else cell for k, cell in enumerate(row)] for row in rows()], HEADINGS


BROKEN = {
    "no volume": (without("V_mm3"), "is a worn volume with its unit"),
    "volume in a length": ((rows(), (*HEADINGS[:6], "V_mm")), "is a worn volume with its unit"),
    "no energy": (([[row[3], row[6]] for row in rows()], ("f_Hz", "V_mm3")), "need a dissipated energy"),
    "swapped": ((rows(), (*HEADINGS[:5], "V_mm3", "E_J")), "no wear that is known"),
    "volume in m3": ((rows(), (*HEADINGS[:6], "V_m3")), "no wear that is known"),
    "one test": ((rows(1), HEADINGS), "1 of 1 tests"),
    "zero motion": (changed("delta_um", lambda _: "0"), "0 of 12 tests"),
    "all empty": (changed("V_mm3", lambda _: "nan"), "0 of 12 tests"),
    "text": (changed("V_mm3", lambda cell: "x" if cell == rows()[4][6] else cell), "row 5, column V_mm3: 'x'"),
    "two of one name": ((rows(), (*HEADINGS[:5], "V_mm3", "V_mm3")), "two columns have one heading"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(table, name):
    (cells, headings), said = BROKEN[name]
    path = table(cells, headings)
    with pytest.raises(RecordingError) as error:
        read_wear_series(path)
    assert said in text_of(error)
    assert str(path) in text_of(error)


def test_a_stated_coefficient_that_contradicts_is_named(table):
    cells = [[*row, "3"] for row in rows()]
    cells[4][7] = "3000"
    with pytest.raises(RecordingError, match=r"row 5: volume over energy is .* times smaller"):
        read_wear_series(table(cells, (*HEADINGS, "alpha_1e-5_mm3_per_J")))


def test_a_long_record_is_no_series(table):
    path = table(rows() * 1000)
    with pytest.raises(RecordingError, match="12,000 rows are no wear series"):
        read_wear_series(path)


def test_one_test_that_stands_six_times_is_no_series(tmp_path, capsys):
    """It ended in a singular matrix."""
    path = tmp_path / "tests.csv"
    path.write_text("V_mm3,E_J\n" + "0.1,100\n" * 6)
    assert cli.execute(["diagnose", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "1 different conditions are too few" in capsys.readouterr().err


def test_a_missing_table_is_named(tmp_path):
    (tmp_path / "recording.toml").write_text(TOML)
    with pytest.raises(CorruptRecordingError, match=r"tests\.csv: there is no such file"):
        read_wear_series(tmp_path)


def test_the_command_takes_a_table(table, tmp_path, capsys, monkeypatch):
    """Seen as a user does: verdict on the terminal, a page with the volumes and without loops."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    from report_cases import drawn

    out = tmp_path / "out"
    app(["diagnose", str(table(rows(24))), "--out", str(out), "--fast"])
    assert "No missing physics seen" in capsys.readouterr().out
    page = (out / "report.html").read_text()
    assert 'id="tests"' in page
    assert 'id="loops"' not in page
    assert len(drawn(page, "predicted volume before over measured volume of each test")["before"]["x"]) == 24
