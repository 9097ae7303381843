"""Files of recordings: every way in gives the same numbers, and every fault in them is named.

What carries the weight: the same loops written as text of several dialects, HDF5 and MATLAB structures of several
shapes come back equal; units of any kind agree with pint's own conversion; a fault names file, field, row and column.
"""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from fretflow.core.errors import (
    CorruptRecordingError,
    InputError,
    RecordingError,
    UnitError,
    UnreliableRecordingError,
    UnsupportedRecordingError,
)
from fretflow.core.units import registry
from fretflow.recordings.bare import Wanted, read_bare
from fretflow.recordings.blocks import _agree
from fretflow.recordings.channels import CHANNELS, INDICES, unit_size
from fretflow.recordings.headings import unit_in_heading
from fretflow.recordings.readers.tables import Table, read_table
from fretflow.recordings.recording import read_joint_recording
from fretflow.recordings.schema import DisplacementOf, MeasuredAt, name_of
from fretflow.recordings.series import loops_of_series
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

ROWS = np.column_stack([np.arange(20) * 0.5, np.sin(np.arange(20.0)), -1e-3 * np.arange(20.0) ** 2])
NAMES = ("time_s", "x [um]", "force N")


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def as_text(delimiter, comma=False, head=NAMES, before="", end="\n"):
    lines = [delimiter.join(f"{value:.9g}" for value in row) for row in ROWS]
    lines = [line.replace(".", ",") for line in lines] if comma else lines
    return before + end.join(([delimiter.join(head)] if head else []) + lines) + end


@pytest.mark.parametrize("text", [
    as_text(","), as_text(";"), as_text("\t"), as_text(";", comma=True), as_text("\t", comma=True),
    as_text(", "), as_text(",", end="\r\n"), as_text(",", before="# made by hand\n\n% twice\n"),
    as_text("  ", head=("time_s", "x", "force")), as_text(" ", comma=True, head=("time_s", "x", "force")),
    "\ufeff" + as_text(","), as_text(",").replace("\n0.5", "\n# a break\n\n0.5"),
    as_text(",").replace("\n0.5,", '\n"0.5",'), as_text(",").replace("\n", ",\n"),
])
def test_dialects_of_text_give_the_same_numbers(tmp_path, text):
    table = read_table(write(tmp_path / "a.csv", text))
    assert np.column_stack(list(table.columns.values())) == pytest.approx(ROWS, rel=1e-8)
    assert next(iter(table.columns)) == "time_s"


def test_points_may_part_thousands_where_commas_are_decimal(tmp_path):
    rows = ROWS * (1.0, 5432.1, 1e3)
    lines = [";".join(f"{value:,.4f}" for value in row).translate(str.maketrans(",.", ".,")) for row in rows]
    table = read_table(write(tmp_path / "a.csv", "\n".join(["Zeit;Weg;Kraft", *lines])))
    assert np.column_stack(list(table.columns.values())) == pytest.approx(rows, rel=1e-3, abs=1e-4)


def test_headings_in_a_comment_units_in_a_line_and_none_at_all(tmp_path):
    commented = read_table(write(tmp_path / "a.txt", as_text(" ", head=("# time", "x", "force")).replace("# ", "# ")))
    assert list(commented.columns) == ["time", "x", "force"]
    units = read_table(write(tmp_path / "b.csv", "time,x,force\n[s],[um],[N]\n" + as_text(",", head=())))
    assert units.units == {"time": "s", "x": "um", "force": "N"}
    bare = read_table(write(tmp_path / "c.csv", as_text(",", head=())))
    assert list(bare.columns) == ["1", "2", "3"]
    assert bare.column(2)[1] == pytest.approx(ROWS[:, 1], rel=1e-8)


def test_latin_micro_sign(tmp_path):
    table = read_table(write(tmp_path / "a.csv", as_text(",", head=("t (s)", "x (µm)", "F (N)")), "latin-1"))
    assert unit_in_heading("displacement", list(table.columns)[1]) == "µm"
    assert unit_size("displacement", "µm")[0] == pytest.approx(1e-6, rel=1e-12, abs=0.0)


def test_empty_cells_are_missing_and_a_cut_row_is_noted(tmp_path):
    text = as_text(",").replace("\n1,", "\n,").rstrip("\n")
    table = read_table(write(tmp_path / "a.csv", text[:text.rindex(",")]))
    assert np.isnan(table.columns["time_s"][2])
    assert table.rows == 19
    assert [(n.rows, "cut off" in n.text) for n in table.notes] == [(((20, 20),), True)]
    text_column = as_text(",").replace("\n", ",left\n").replace("force N,left", "force N,side")
    table = read_table(write(tmp_path / "b.csv", text_column))
    assert list(table.columns) == list(NAMES)
    assert "text" in table.notes[0].text


@pytest.mark.parametrize(("text", "error", "message"), [
    ("", CorruptRecordingError, "no row of numbers"),
    ("a,b\n", CorruptRecordingError, "no row of numbers"),
    (as_text(",").replace("\n1,", "\nx1,"), CorruptRecordingError, r"row 3, column time_s: 'x1' is no number"),
    (as_text(",").replace("\n1,", "\n1,7,"), CorruptRecordingError, "row 3 has 4 values where the first has 3"),
    (as_text(",", comma=True), UnsupportedRecordingError, "row 1 has .* export it with semicolons"),
    (as_text(",", head=("a", "a", "b")), UnsupportedRecordingError, "two columns have one heading"),
    ("a\0b", UnsupportedRecordingError, "is no text"),
])
def test_text_that_cannot_be_read(tmp_path, text, error, message):
    if "row 1 has" in message:
        text = "a,b\n" + "\n".join(f"{j},5,{j},25" for j in range(20)) + "\n"
    with pytest.raises(error, match=message):
        read_table(write(tmp_path / "a.csv", text))


def test_files_that_are_none(tmp_path):
    with pytest.raises(CorruptRecordingError, match="there is no such file"):
        read_table(tmp_path / "a.csv")
    with pytest.raises(UnsupportedRecordingError, match=r"a file \.xls is not read"):
        read_table(write(tmp_path / "a.xls", "1"))
    for name in ("a.h5", "a.mat"):
        with pytest.raises(CorruptRecordingError, match=name):
            read_table(write(tmp_path / name, "no such thing at all" * 20))


@pytest.mark.parametrize("version", ["text", "hdf5", "mat5"])
def test_a_recording_in_any_form(tmp_path, make, version):
    made = make(noise=(1e-8, 0.1))
    folder = made.write(tmp_path / "a")
    expected = read_joint_recording(folder).loops
    toml = (folder / "recording.toml").read_text()
    if version == "hdf5":
        table = read_table(folder / "loops.csv")
        with h5py.File(folder / "loops.h5", "w") as file:
            for name, values in table.columns.items():
                file[name] = values
            file["displacement_um"].attrs["unit"] = "um"
        (folder / "recording.toml").write_text(toml.replace("loops.csv", "loops.h5"))
    seen = read_joint_recording(folder).loops
    assert seen.displacement == pytest.approx(expected.displacement, rel=1e-12, abs=0.0)
    assert seen.displacement_of == DisplacementOf(MeasuredAt.CONTACT_FACES)
    if version == "hdf5":
        with h5py.File(folder / "loops.h5", "a") as file:
            file["displacement_um"].attrs["unit"] = "mm"
        with pytest.raises(UnreliableRecordingError, match=r"displacement\.unit: is 'um', but the file .* says 'mm'"):
            read_joint_recording(folder)
        (folder / "loops.h5").write_bytes((folder / "loops.h5").read_bytes()[:3000])
        with pytest.raises(CorruptRecordingError, match=r"loops\.h5"):
            read_joint_recording(folder)


def matlab_shapes(loops):
    """Return ways in which rigs store loops (N, 2) by cycle count."""
    counts = np.array(list(loops), dtype=float)
    cells = np.empty(len(loops), dtype=object)
    cells[:] = list(loops.values())
    return {
        "fields": {f"cycle_{count}": values for count, values in loops.items()},
        "nested": {"test": {"rig": {"loops": {f"N{count}": {"data": values} for count, values in loops.items()}}}},
        "cells": {"results": {"cycles": counts, "loops": cells}},
        "structures": {"HL": np.array([(v[:, 0], v[:, 1], float(c)) for c, v in loops.items()],
                                      dtype=[("displacement", "O"), ("force", "O"), ("cycle", "O")])},
        "pages": {"cycles": counts, "stack": np.stack(list(loops.values()), axis=2)},
        "transposed": {f"L_{count}": values.T for count, values in loops.items()},
    }


@pytest.mark.parametrize("shape", ["fields", "nested", "cells", "structures", "pages", "transposed"])
def test_matlab_structures(tmp_path, spring_slider, shape):
    turns = np.arange(120) / 120
    loops = {count: np.column_stack([1e6 * spring_slider(turns + 0.1)[0], spring_slider(turns + 0.1, mu=mu)[1]])
             for count, mu in ((100, 0.4), (20000, 0.5), (300000, 0.6))}
    savemat(tmp_path / "a.mat", matlab_shapes(loops)[shape])
    recording = read_bare(tmp_path / "a.mat", Wanted({"displacement": "[um]", "friction_force": "[N]"}))
    assert recording.loops.cycles.tolist() == [100, 20000, 300000]
    assert recording.loops.force.max(axis=(1, 2)) == pytest.approx([24.0, 30.0, 36.0], rel=1e-6)
    assert recording.loops.displacement.max() == pytest.approx(8e-6, rel=2e-3, abs=0.0)


def test_matlab_of_version_7_3(tmp_path, spring_slider):
    turns = np.arange(64) / 64
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        group = file.create_group("results")
        cells = [file.create_dataset(f"#refs#/{k}", data=np.stack(spring_slider(turns, mu=mu)))
                 for k, mu in enumerate((0.4, 0.6))]
        group["cycles"] = np.array([[10.0], [500.0]])
        group["loops"] = np.array([[cell.ref for cell in cells]], dtype=h5py.ref_dtype)
    data = (tmp_path / "a.mat").read_bytes()
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(head.ljust(512, b"\0") + data[512:])
    recording = read_bare(tmp_path / "a.mat", Wanted({"displacement": "[m]", "friction_force": "[N]"}))
    assert recording.loops.cycles.tolist() == [10, 500]
    assert recording.loops.force.max(axis=(1, 2)) == pytest.approx([24.0, 36.0], rel=1e-6)


def test_matlab_without_loops_or_counts(tmp_path, spring_slider):
    savemat(tmp_path / "a.mat", {"a": np.arange(5.0)})
    with pytest.raises(UnsupportedRecordingError, match="no N x 2 array"):
        read_table(tmp_path / "a.mat")
    loop = np.column_stack(spring_slider(np.arange(64) / 64))
    savemat(tmp_path / "b.mat", {"first": loop, "second": loop})
    table = read_table(tmp_path / "b.mat")
    assert np.unique(table.columns["cycle"]).tolist() == [0.0, 1.0]
    assert "not told" in table.notes[0].text


def test_bare_file_tells_its_units_in_headings(tmp_path, spring_slider):
    turns = np.arange(500) / 100 + 0.6
    x, force = spring_slider(turns)
    header = "# a figure\ndelta_mm,Ftr_kN,temperature"
    np.savetxt(tmp_path / "a.csv", np.column_stack([1e3 * x, 1e-3 * force, 20.0 + 0.0 * x]), delimiter=",", comments="",
               header=header)
    recording = read_bare(tmp_path / "a.csv", Wanted())
    loops, _ = loops_of_series(recording.series)
    assert loops.cycles.tolist() == [1, 2, 3, 4]
    assert loops.force.max() == pytest.approx(36.0, rel=1e-6)
    assert recording.arrays.sizes["cycles"] == 4
    assert float(recording.arrays.friction_force.max()) == pytest.approx(36.0, rel=1e-6)
    with pytest.raises(RecordingError, match="holds no loops"):
        _ = replace(recording, series=None).arrays
    assert [n.channel for n in recording.notes if "not used" in n.text] == ["temperature"]


@pytest.mark.parametrize(("head", "delimiter", "encoding"), [
    ("Zeit [s];Weg [µm];Reibkraft [N]", ";", "utf-8"), ("Zeit [s];Weg [µm];Reibkraft [N]", ";", "latin-1"),
    ("Zeit in s;Schwingweg in µm;Tangentialkraft in N", ";", "utf-8-sig"), ("t/s;s/µm;F/N", ";", "utf-16"),
    ("t / s\tx / μm\tF_R / N", "\t", "utf-8"), ("Zeit;Verschiebung;Reibungskraft\ns;µm;N", ";", "utf-8"),
    ("Zeit;Wegaufnehmer (um);Kraftmessdose (N)", ";", "utf-8"),
    ("Time (s);Relative Displacement (um);Friction Force (N)", ";", "utf-8"),
    ("time s;displacement µm;tangential-force N", ";", "utf-8"),
])
def test_usual_headings_tell_all_in_german_and_english(tmp_path, spring_slider, head, delimiter, encoding):
    """The closed form comes back from numbers with commas under headings that name channel and unit; a note says so."""
    turns = np.arange(500) / 100 + 0.6
    x, force = spring_slider(turns)
    rows = [delimiter.join(f"{value:.9g}" for value in row) for row in zip(turns, 1e6 * x, force, strict=True)]
    text = "\n".join(["Prüfstand 3", "", head, *(row.replace(".", ",") for row in rows)])
    recording = read_bare(write(tmp_path / "a.csv", text, encoding), Wanted())
    assert np.ptp(recording.series.channels["displacement"]) == pytest.approx(16e-6, rel=1e-3, abs=0.0)
    assert recording.series.channels["friction_force"].max() == pytest.approx(36.0, rel=1e-6)
    (taken,) = [note.text for note in recording.notes if "as the headings tell" in note.text]
    assert all(f"{channel} from " in taken for channel in ("displacement", "friction force"))


def test_a_unit_of_several_columns_tells_none_and_a_name_goes_first(tmp_path, spring_slider):
    turns = np.arange(500) / 100
    x, force = spring_slider(turns)
    columns = {"Probe [µm]": 2e6 * x, "Weg [µm]": 1e6 * x, "Kraft X [N]": force, "Normalkraft [N]": 60.0 + 0.0 * x}
    np.savetxt(tmp_path / "a.csv", np.column_stack(list(columns.values())), delimiter=";", comments="",
               header=";".join(columns), encoding="utf-8")
    series = read_bare(tmp_path / "a.csv", Wanted()).series
    assert np.ptp(series.channels["displacement"]) == pytest.approx(16e-6, rel=1e-3, abs=0.0)
    assert series.channels["friction_force"].max() == pytest.approx(36.0, rel=1e-6)
    assert series.channels["normal_force"] == pytest.approx(60.0)


@pytest.mark.parametrize("start", [0.0, 0.1, 0.35, 0.8])
def test_a_single_loop_may_start_anywhere(tmp_path, spring_slider, start):
    x, force = spring_slider(np.arange(60) / 60 + start)
    np.savetxt(tmp_path / "a.csv", np.column_stack([1e6 * x, force]), delimiter=",", comments="", header="x_um,F_N")
    loops, _ = loops_of_series(read_bare(tmp_path / "a.csv", Wanted()).series)
    assert loops.cycles.tolist() == [1]
    assert "normal_force" not in loops.channels
    assert np.argmax(loops.displacement[0, 0]) in (0, 1, 59)


@pytest.mark.parametrize(("header", "options", "message"), [
    ("time_s,foo,bar", {}, "no column time_s, foo, bar is known as the displacement or the friction_force; name them: "
     r'--displacement "COLUMN \[um\]" --force "COLUMN \[N\]"'),
    ("t_s,Sensor A [um],Sensor B [um]", {}, r"Sensor A \[um\] and Sensor B \[um\] may both be the displacement"),
    ("time_s,x,force_N", {}, r'column x has no unit .* --displacement "x \[um\]"'),
    ("time_s,x_um,disp_um", {}, "columns x_um and disp_um may both be the displacement"),
    ("time_s,x_um,force_N", {"displacement": "y [um]"}, "--displacement: .* has no column 'y'"),
    ("time_s,x_um,force_N", {"displacement": "x_um [mm]"}, r"displacement\.unit: is 'mm', but the file .* says 'um'"),
    ("time_s,x_um,force_N", {"friction_force": "force_N [um]"}, "--force: .* wrong dimension"),
    ("time_s,x,y", {"displacement": "x [um]", "friction_force": "x [N]"},
     "column x is named as displacement and as friction_force of series; name a column for each"),
])
def test_bare_file_that_cannot_be_told(tmp_path, header, options, message):
    path = write(tmp_path / "a.csv", as_text(",", head=header.split(",")))
    with pytest.raises((UnsupportedRecordingError, UnreliableRecordingError, UnitError), match=message):
        read_bare(path, Wanted(options))


@pytest.mark.parametrize(("change", "message"), [
    (("[loops]", "[loop]"), r"recording\.toml: loop: unknown key where test\.kind is 'fretting-rig'; docs"),
    (("displacement = {", "displacment = {"), r"loops\.displacment: unknown key; channels are time, displacement"),
    (("displacement_of", "displacment_of"), r"loops\.displacment_of: unknown key; .*; did you mean displacement_of\?"),
    (('unit = "um"', 'unit = "N"'), r"loops\.displacement\.unit: .* wrong dimension"),
    (('unit = "um"', 'unit = "mm"'), r"loops\.displacement\.unit: is 'mm', but the file .* says 'um'"),
    (('unit = "um"', 'unti = "um"'), r"loops\.displacement\.unti: unknown key"),
    ((', unit = "um"', ""), r"loops\.displacement\.unit: is required"),
    (('"displacement_um"', '"displacement"'), r"loops\.displacement\.column: .* no column 'displacement'; it has"),
    (('"60 N"', "60"), r"test\.normal_load: 60 is not text"),
    (('"60 N"', '"60 mm"'), r"test\.normal_load: .* wrong dimension"),
    (('"contact-faces"', '"somewhere"'), r"loops\.displacement_of: 'somewhere' is none of"),
    (('displacement_of = "contact-faces"\n', ""), r"loops\.displacement_of: is required"),
    (('"fretting-rig"', '"other"'), r"test\.kind: .*imposed-displacement"),
    (('"fretting-rig"', '"imposed"'), r"did you mean imposed-displacement\?"),
    (("recording/1", "recording/9"), "format"),
    (('file = "loops.csv"', 'file = "none.csv"'), r"none\.csv: there is no such file"),
    (("cycles = 100000", "cycles = 500"), "goes up to 1000, but test.cycles is 500"),
    (("[test]", "[test"), "not valid TOML"),
    (('unit = "um"', 'unit = "um", sd = "3 N"'), r"loops\.displacement\.sd: .* wrong dimension"),
    (('unit = "um"', 'unit = "um", calibration_sd = -1'), r"loops\.displacement\.calibration_sd"),
])
def test_faults_of_the_description_name_their_field(tmp_path, make, change, message):
    folder = make().write(tmp_path)
    path = folder / "recording.toml"
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_joint_recording(folder)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


SWEEP = """[sweep]
file = "sweep.csv"
same_channels_as = "loops"
condition = { column = "condition" }
[[sweep.conditions]]
id = 0
excitation_amplitude = "50 N"
[[sweep.conditions]]
id = 1
normal_load = "90 N"
excitation_frequency = "50 Hz"
[wear]
worn_volume = "0.01 mm^3"
worn_volume_sd = "1e-4 mm^3"
[specimen]
contact_width = "2 mm"
[specimen.lower]
youngs_modulus = "210 GPa"
[rig]
moving_mass = "11 kg"
[wear_depth]
file = "map.csv"
x = { column = 1, unit = "mm" }
depth = { column = 2, unit = "um", sd = "0.05 um" }
"""


def test_sweep_map_and_what_is_given(tmp_path, make):
    made = make()
    made.extra = {"displacement": {"sd": "0.03 um", "calibration_sd": 0.004}}
    made.tables = SWEEP
    folder = made.write(tmp_path)
    first, second = make(cycles=(0,)).columns, make(cycles=(1,), frequency=50.0).columns
    rows = {name: np.concatenate([first[name], second[name]]) for name in first}
    sweep = np.column_stack([rows["cycle"], rows["repeat"], rows["time"], rows["excitation"],
                             1e6 * rows["displacement"], rows["friction_force"]])
    np.savetxt(folder / "sweep.csv", sweep, delimiter=",", comments="",
               header="condition,repeat,time_s,excitation_N,displacement_um,force_N")
    (folder / "map.csv").write_text("0.0,10\n0.5,11\n1.0,\n")
    recording = read_joint_recording(folder)
    assert recording.loops.sd["displacement"] == pytest.approx(3e-8, rel=1e-12, abs=0.0)
    assert recording.loops.calibration_sd["displacement"] == 0.004
    assert [c.normal_load for c in recording.sweep.conditions] == [60.0, 90.0]
    assert [c.excitation_frequency for c in recording.sweep.conditions] == [100.0, 50.0]
    assert recording.sweep.loops.frequency.tolist() == [100.0, 50.0]
    assert recording.sweep.loops.repeats.tolist() == [2, 2]
    assert recording.wear_depth.channels["depth"] == pytest.approx([1e-5, 1.1e-5], rel=1e-12, abs=0.0)
    assert recording.wear_depth.sd["depth"] == pytest.approx(5e-8, rel=1e-12, abs=0.0)
    assert [n.rows for n in recording.notes if n.block == "wear_depth"] == [((3, 3),)]
    assert recording.wear.worn_volume == pytest.approx(1e-11, rel=1e-12, abs=0.0)
    assert recording.given["rig"] == {"moving_mass": 11.0}
    assert recording.given["specimen"] == {"lower": {"contact_width": 2e-3, "youngs_modulus": 210e9},
                                           "upper": {"contact_width": 2e-3}}
    with pytest.raises(ValueError, match="read-only"):
        recording.loops.displacement[0, 0, 0] = 1.0
    with pytest.raises(TypeError):
        recording.loops.channels["more"] = 1.0
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("id = 1", "id = 2"))
    with pytest.raises(UnreliableRecordingError, match=r"sweep\.conditions: none has the id 1"):
        read_joint_recording(folder)


@pytest.mark.parametrize(("unit", "fails"), [("um", False), ("mm", True), ("nm", True)])
def test_depth_and_worn_volume_are_of_one_order(tmp_path, make, unit, fails):
    made = make()
    made.tables = '[wear]\nworn_volume = "0.01 mm^3"\n[wear_depth]\nfile = "map.csv"\n' + "".join(
        f'{name} = {{ column = {k}, unit = "{u}" }}\n' for k, (name, u) in enumerate(
            (("x", "mm"), ("y", "mm"), ("depth", unit)), start=1))
    folder = made.write(tmp_path)
    (folder / "map.csv").write_text("".join(f"{x},{y},10\n" for x in (0, 0.5, 1) for y in (0, 0.5, 1)))
    if fails:
        with pytest.raises(UnreliableRecordingError, match=r"wear_depth: .* check the units of x, y and depth"):
            read_joint_recording(folder)
    else:
        assert len(read_joint_recording(folder).wear_depth.channels["depth"]) == 9


PREFIXES = st.sampled_from(["", "k", "m", "u", "n", "M"])
BASES = {"m": "m", "N": "N", "s": "s", "m/s": "m/s", "m/s^2": "m/s^2", "Hz": "Hz", "rad": "rad", "m/N": "m/N",
         "m/s/N": "m/s/N", "m/s^2/N": "m/s^2/N", "N/m": "N/m"}


@given(channel=st.sampled_from([name for name in CHANNELS if name not in INDICES]), prefix=PREFIXES,
       other=st.sampled_from(["kg", "K", "m^3", "Pa", "A"]), data=st.data())
def test_units_of_every_channel(channel, prefix, other, data):
    base = data.draw(st.sampled_from(CHANNELS[channel]))
    unit = prefix + BASES[base]
    size, si = unit_size(channel, unit)
    assert si == base
    assert size == pytest.approx(registry().Quantity(1.0, unit).to(base).magnitude, rel=1e-12, abs=0.0)
    with pytest.raises(UnitError):
        unit_size(channel, other)


@given(st.floats(-1e6, 1e6), st.sampled_from(["nm", "um", "mm", "cm", "m", "inch"]))
def test_numbers_do_not_depend_on_the_unit_they_are_written_in(tmp_path_factory, value, unit):
    path = tmp_path_factory.getbasetemp() / "unit.csv"
    size = unit_size("displacement", unit)[0]
    path.write_text(f"x [{unit}],F [N]\n" + "".join(f"{value * j / size!r},{j}\n" for j in range(3)))
    table = read_table(path)
    heading, column = table.column(1)
    read = column * unit_size("displacement", unit_in_heading("displacement", heading))[0]
    assert read == pytest.approx(value * np.arange(3), rel=1e-9, abs=1e-300)


def test_a_byte_order_mark_as_some_editors_write_it_is_no_key(make, tmp_path):
    folder = make().write(tmp_path)
    toml = folder / "recording.toml"
    toml.write_bytes(b"\xef\xbb\xbf" + toml.read_bytes())
    assert read_joint_recording(folder).loops.cycles.tolist() == [0, 1000]


@pytest.mark.parametrize(("at", "name"), [
    ("quick/recording", "quick-recording"), ("quick/recording/recording.toml", "quick-recording"),
    ("test4", "test4"), ("test4/loops.csv", "loops"), ("test4/recording.toml", "test4")])
def test_results_of_exports_do_not_overwrite_each_other(tmp_path, at, name):
    """All exports lie in folders of the same name, in those of their runs."""
    for folder in ("quick/recording", "test4"):
        (tmp_path / folder).mkdir(parents=True)
    assert name_of(tmp_path / at) == name


def test_vectors_of_one_length_are_columns_in_matlab_and_hdf5(tmp_path):
    a, f = np.arange(1.0, 5.0), np.arange(80.0, 84.0)
    savemat(tmp_path / "a.mat", {"a": a[:, None], "f": f, "one": 3.0, "short": a[:2]})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"], file["f"], file["both"] = a[:, None], f[None], np.c_[a, f]
    for name in ("a.mat", "a.h5"):
        table = read_table(tmp_path / name, ["a", "f"])
        assert table.column("a")[1] == pytest.approx(a)
        assert table.column("f")[1] == pytest.approx(f)
    with pytest.raises(UnsupportedRecordingError):
        read_table(tmp_path / "a.mat", ["a", "short"])
    with pytest.raises(UnsupportedRecordingError, match="'both' is no dataset of one row"):
        read_table(tmp_path / "a.h5", ["a", "both"])


def test_a_usual_name_that_ends_like_a_unit_states_none(tmp_path):
    table = Table(tmp_path / "a.csv", {"F_N": np.ones(3), "x_um": np.ones(3)})
    _agree(table, "loops", "normal_force", "F_N", "kN")
    with pytest.raises(UnreliableRecordingError, match="says 'um' of column x_um"):
        _agree(table, "loops", "displacement", "x_um", "mm")
