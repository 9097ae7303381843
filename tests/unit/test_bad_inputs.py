"""Inputs that no command can use: each is one line that names what is wrong, with exit code 2, and at once.

What carries the weight: nothing here is chosen to pass. Every key of a case file is given each value that its kind does
not take, and the files are those that broke, stopped or filled the machine before they were refused.
"""

import datetime
import os
import resource
import signal
import struct
import tomllib

import h5py
import numpy as np
import pytest
from fretflow import cli
from fretflow.case.casefile import entries, starting_case
from fretflow.case.config import validate_case

LONGEST = 20  # s, far more than any of them takes
MEMORY = 4 * 2**30  # bytes beyond what the process has
CASE = 'format = "fretflow-case/1"\nname = "c"\n[test]\nexcitation_amplitude = "53 N"\n'
TEST = 'format = "fretflow-recording/1"\n[test]\nkind = "fretting-rig"\n'
MATLAB = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
MOTION = np.cos(np.linspace(0.0, 2.0 * np.pi, 200))


@pytest.fixture(autouse=True)
def bounded():
    """Let nothing hang, nor take the machine's memory."""
    def hang(*_):
        pytest.fail(f"still busy after {LONGEST} s")

    before = signal.signal(signal.SIGALRM, hang)
    limits = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))
    signal.alarm(LONGEST)
    yield
    signal.alarm(0)
    resource.setrlimit(resource.RLIMIT_AS, limits)
    signal.signal(signal.SIGALRM, before)


def refused(capsys, *arguments):
    """Return the one line with which a command refuses its input."""
    assert cli.execute([str(argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("fretflow: ")
    assert error.count("\n") == 1
    assert "unexpected" not in error
    assert len(error) < 1100
    return error


# Values that a key does not take, by its kind.
NO_QUANTITY = ["5.0", "true", '"5"', '"5 flurbs"', '"five UNIT"', '"nan UNIT"', '"1e30 UNIT"', '"5 kelvin"', "[]", "{}",
               "1979-05-27"]
NO = {bool: ['"yes"', "1", "0.0", "[]", "{}"],
      int: ["true", '"5"', "1.5", "nan", "[]", "{}", "1979-05-27"],
      float: ["true", '"0.5"', "nan", "inf", "[]", "{}", "1979-05-27"],
      str: ["5", "true", "[]", "{}", "1979-05-27"],
      tuple: ['["5"]', "[true]", "[1.5]", "[-1]", '"5"', "5", "{}"]}
NO_FILES = ("upper", "lower")  # of meshes, which are looked for


def bad_values():
    """Return (path of a key, value) for every key of a case file."""
    values = []
    for entry in entries(validate_case(tomllib.loads(starting_case()))):
        of_default = entry.resolved if entry.unit == "" else 0.0
        kind = next((kind for kind in NO if isinstance(of_default, kind)), None)
        if entry.table[:2] != ("specimen", "lower") and entry.key not in NO_FILES and kind is not None:
            path = (*(part for part in entry.table if part != "upper"), entry.key)
            values += [(path, value.replace("UNIT", entry.unit)) for value in (NO_QUANTITY if entry.unit else NO[kind])]
    return values


@pytest.mark.parametrize(("path", "value"), bad_values(),
                         ids=lambda part: ".".join(part) if isinstance(part, tuple) else part)
def test_every_key_refuses_what_it_does_not_take(tmp_path, capsys, path, value):
    *table, key = path
    lines = [line for line in f"{CASE}cycles = 5".splitlines() if not line.startswith(f"{key} =")]
    content = [f"{key} = {value}", *lines] if not table else [
        *lines, *([] if table == ["test"] else [f"[{'.'.join(table)}]"]), f"{key} = {value}"]
    (tmp_path / "case.toml").write_text("\n".join(content) + "\n")
    assert f"case.toml: {'.'.join(path)}" in refused(capsys, "show", tmp_path / "case.toml").replace(".upper.", ".")


def hdf5(path, fill):
    with h5py.File(path, "w") as file:
        fill(file)


def matlab(path, fill):
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    path.write_bytes(MATLAB.ljust(512, b"\0") + path.read_bytes()[512:])


def claiming(rows):
    """Make a few kB that claim to hold two columns of so many rows."""
    def fill(file):
        for name, unit in (("displacement", "um"), ("force", "N")):
            file.create_dataset(name, shape=(rows,), dtype="f8", chunks=(1000,)).attrs["unit"] = unit

    return fill


def with_unit(unit):
    def fill(file):
        for name in ("displacement", "force"):
            file[name] = MOTION
            file[name].attrs["unit"] = unit

    return fill


def referring(kind):
    """Make cells that refer to themselves, to nothing, to what was removed, or to each other without end."""
    def fill(file):
        cell = file.create_dataset("a", (3,), dtype=h5py.ref_dtype)
        if kind == "itself":
            cell[0] = cell.ref
        elif kind == "removed":
            file["b"] = MOTION
            cell[0] = file["b"].ref
            del file["b"]
        elif kind == "many":
            cell[:] = [file.create_group("leaf").ref] * 3
            for level in range(12):
                last, cell = cell, file.create_dataset(f"l{level}", (30,), dtype=h5py.ref_dtype)
                cell[:] = [last.ref] * 30

    return fill


def nested_groups(file):
    for _ in range(2000):
        file = file.create_group("g")


def element(kind, content):
    """Return an element of a MATLAB file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def cells_in_cells(path, depth):
    """Write cells of flags, shape, name and a cell: ten times as many would end the process that reads them."""
    item = element(9, struct.pack("<d", 1.0))
    for level in range(depth):
        flags = struct.pack("<II", 1 if level else 6, 0)
        item = element(14, element(6, flags) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"") + item)
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + item)


def named_in_bytes(file):
    file.create_dataset(b"\xff\xfe", data=MOTION)


def many_columns(file):
    for k in range(1001):
        file[f"c{k}"] = MOTION[:2]


def deep_data(file):
    for _ in range(1_200):
        file = file.create_group("g")
    file["a"] = np.column_stack([MOTION, MOTION]).T


def letters(values):
    def fill(file):
        file["a"] = values
        file["a"].attrs["MATLAB_class"] = np.bytes_(b"char")

    return fill


def sparse_in_words(file):
    file.create_group("a").attrs["MATLAB_sparse"] = [1, 2]


def loops_with(unit='"um"', test=""):
    """Return a recording.toml of a file of loops, so far as it is not what is refused."""
    return (f'{TEST}normal_load = "60 N"\n{test}[loops]\nfile = "a.csv"\n'
            'displacement_of = "contact-faces"\n'
            f'displacement = {{ column = "x", unit = {unit} }}\nfriction_force = {{ column = "f", unit = "N" }}\n')


DEEP, NO_UNIT, UNWRITTEN = "deep in each other", "no unit that is known", "next to nothing was ever written"
FILES = {
    # commands, name, content (text, bytes or a function of the path), words of the refusal
    "nested arrays": ("show diagnose loops", "recording.toml", "x = " + "[" * 20000 + "]" * 20000, DEEP),
    "nested tables": ("show diagnose loops", "recording.toml", "x = " + "{a=" * 3000 + "1" + "}" * 3000, DEEP),
    "thousands of digits": ("show diagnose loops", "recording.toml", "x = " + "9" * 5000, "5000 digits"),
    "no text": ("show diagnose loops", "recording.toml", b"\xff\xfe\0\0", "not valid TOML"),
    "half a table": ("show diagnose loops", "recording.toml", "[test", "not valid TOML"),
    "a wear series nested": ("diagnose", "recording.toml", '[test]\nkind = "wear-series"\nx = ' + "[" * 9999, DEEP),
    "a structure's digits": ("diagnose", "recording.toml", '[test]\nkind = "structure"\nx = ' + "9" * 5000, "digits"),
    "a pipe": ("show run modes diagnose loops", "recording.toml", os.mkfifo, "is no file but a pipe"),
    "a long value": ("show", "case.toml", CASE + f'cycles = "{"a" * 5_000_000}"', "must be a number without quotes"),
    "a long key": ("show", "case.toml", CASE + f'cycles = 5\n{"k" * 5_000_000} = 1', "test.kkk"),
    "a long number": ("show", "case.toml", CASE.replace("53", "5" * 5000) + "cycles = 5", "excitation_amplitude"),
    "a large file": ("show", "case.toml", "# " + "a" * 20_000_000, "MB are no file of keys"),
    "springs too far apart": ("show", "case.toml", CASE + 'cycles = 5\n[rig]\nin_phase_frequency = "1e-20 Hz"\n'
                              'out_of_phase_frequency = "1e20 Hz"', "at most a million times"),
    "an empty table": ("loops diagnose", "a.csv", "", "holds no row of numbers"),
    "headings alone": ("loops", "a.csv", "displacement_um,force_N\n", "holds no row of numbers"),
    "a wide table": ("loops", "a.csv", "displacement_um,force_N\n" + "1," * 300_000 + "\n", "300,000 values"),
    "a long cell": ("loops", "a.csv", "displacement_um,force_N\n" + "1,2\n" * 40 + "a" * 5_000_000 + ",3\n", "row 41"),
    "a long heading": ("loops", "a.csv", "a" * 5_000_000 + ",force_N\n" + "1,2\n" * 40, "no column aaa"),
    "a table's pipe": ("loops diagnose", "a.csv", os.mkfifo, "is no file"),
    "an HDF5 pipe": ("loops", "a.h5", os.mkfifo, "is no file"),
    "a MATLAB pipe": ("loops", "a.mat", os.mkfifo, "is no file"),
    "bytes that are no text": ("loops init", "a.csv", b"displacement_um,force_N\n" + b"1,2\n" * 30_000 + b"\xff,3\n",
                               "is no utf-8 text"),
    "half a letter": ("loops", "a.csv", ("displacement_um,force_N\n" + "1,2\n" * 300).encode("utf-16")[:-1],
                      "no utf-16"),
    "a long unit": ("loops diagnose", "recording.toml", loops_with('"' + "m" * 100_000 + '"'), "known unit"),
    "a unit of powers": ("loops", "recording.toml", loops_with('"m**9**9**9"'), "known unit"),
    "a unit of numbers' powers": ("loops", "recording.toml", loops_with('"((9^99)^99)^99 m"'), "known unit"),
    "a long title": ("loops", "recording.toml", 'title = "' + "a" * 4_000_000 + '"\n' + loops_with(), "200 characters"),
    "a case's long title": ("show", "case.toml", CASE.replace("[test]", f'title = "{"a" * 300}"\n[test]'),
                            "200 characters"),
    "a block of nothing": ("loops", "recording.toml", TEST + '[series]\nfile = "a.csv"', "series: names no column"),
    "a load's deviation in kN": ("loops", "recording.toml", loops_with(test='normal_load_sd = "60 kN"\n'),
                                 "check its unit"),
    "a slip in a kind": ("loops", "recording.toml", loops_with().replace("fretting", "freting"), "mean fretting-rig?"),
    "a slip in a choice": ("show", "case.toml", CASE + 'cycles = 5\n[wear]\nscheme = "implicid"', "mean implicit?"),
    "no conditions": ("loops", "recording.toml", loops_with() + '[sweep]\nfile = "a.csv"\n'
                      'same_channels_as = "loops"\nconditions = []', "one at least"),
    "no HDF5": ("loops", "a.h5", b"no HDF5", "cannot be read"),
    "no MATLAB": ("loops", "a.mat", b"no MATLAB" * 100, "no whole MATLAB file"),
    "rows never written": ("loops", "a.h5", lambda path: hdf5(path, claiming(1_400_000_000)), UNWRITTEN),
    "1e11 rows": ("loops", "a.h5", lambda path: hdf5(path, claiming(10**11)), UNWRITTEN),
    "2^59 rows": ("loops", "a.h5", lambda path: hdf5(path, claiming(2**59)), UNWRITTEN),
    "a unit of numbers": ("loops", "a.h5", lambda path: hdf5(path, with_unit(np.array([1, 2]))), NO_UNIT),
    "a unit of texts": ("loops", "a.h5", lambda path: hdf5(path, with_unit([b"um", b"N"])), NO_UNIT),
    "a unit in Latin-1": ("loops", "a.h5", lambda path: hdf5(path, with_unit(np.bytes_(b"\xb5m"))), NO_UNIT),
    "a unit that is a number": ("loops", "a.h5", lambda path: hdf5(path, with_unit(5)), NO_UNIT),
    "an empty unit": ("loops", "a.h5", lambda path: hdf5(path, with_unit(h5py.Empty("S1"))), NO_UNIT),
    "a unit without end": ("loops", "a.h5", lambda path: hdf5(path, with_unit("m" * 60_000)), NO_UNIT),
    "a name in bytes": ("loops", "a.h5", lambda path: hdf5(path, named_in_bytes), "no UTF-8 text"),
    "a thousand columns": ("loops", "a.h5", lambda path: hdf5(path, many_columns), "1,001 items"),
    "groups without end": ("loops", "a.h5", lambda path: hdf5(path, nested_groups), "cannot be read"),
    "a cell in itself": ("loops", "a.mat", lambda path: matlab(path, referring("itself")), "refers to itself"),
    "a cell of nothing": ("loops", "a.mat", lambda path: matlab(path, referring("nothing")), "refers to nothing"),
    "a cell of what is gone": ("loops", "a.mat", lambda path: matlab(path, referring("removed")), "refers to nothing"),
    "cells without end": ("loops", "a.mat", lambda path: matlab(path, referring("many")), "cells and fields"),
    "data below groups without end": ("loops", "a.mat", lambda path: matlab(path, deep_data), DEEP),
    "cells in cells": ("loops", "a.mat", lambda path: cells_in_cells(path, 2_000), DEEP),
    "an element of no kind": ("loops", "a.mat", lambda path: path.write_bytes(
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element(14, element(6, struct.pack("<II", 6, 0)) + element(
            5, struct.pack("<ii", 20, 2)) + element(1, b"a") + element(200, bytes(320)))), "of kind 200"),
    "an array of more than there is": ("loops", "a.mat", lambda path: path.write_bytes(
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element(14, element(6, struct.pack("<II", 1, 0)) + element(
            5, struct.pack("<ii", 2**15, 2**14)) + element(1, b"a"))), "536,870,912 items"),
    "letters beyond all": ("loops", "a.mat", lambda path: matlab(path, letters(np.array([2**40], dtype="u8"))),
                           "no N x 2"),
    "letters that are none": ("loops", "a.mat", lambda path: matlab(path, letters(np.array([np.nan, 1.5]))),
                              "no N x 2"),
    "a sparse matrix of two heights": ("loops", "a.mat", lambda path: matlab(path, sparse_in_words), "no N x 2"),
    "a matrix never written": ("loops", "a.mat", lambda path: matlab(path, lambda file: file.create_dataset(
        "a", shape=(2, 10**11), dtype="f8", chunks=(2, 1000))), UNWRITTEN),
}


@pytest.mark.parametrize(("command", "what"), [(command, what) for what, row in FILES.items()
                                               for command in row[0].split()])
def test_files_that_are_none(tmp_path, capsys, command, what):
    _, name, content, words = FILES[what]
    path = tmp_path / name
    if callable(content):
        content(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    arguments = {"show": [path], "init": [tmp_path / "b.toml", "--recording", path]}.get(
        command, [path, "--out", tmp_path / "out"])
    assert words in refused(capsys, command, *arguments)


@pytest.mark.parametrize("command", ["show", "run", "modes", "calibrate", "response", "verify", "loops", "diagnose"])
@pytest.mark.parametrize("path", ["a\0b", "/nowhere/case.toml", 300 * "x"], ids=["null", "nowhere", "long"])
def test_paths_of_nothing(tmp_path, capsys, command, path):
    error = refused(capsys, command, path, *([] if command == "show" else ["--out", tmp_path / "out"]))
    assert path.split("\0")[0][:100] in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [
    "trial --seed -1", "trial --cases 0", "trial --jobs 0", "verify . --periods 0", "response . --excitation 5",
    "response . --start 0_Hz", "loops . --normal-load -5_N", "loops . --frequency five", "effects third-bodi"])
def test_values_on_the_command_line(tmp_path, capsys, arguments, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [part.replace("_", " ") for part in arguments.split()]
    error = refused(capsys, *words)
    assert next((word for word in words if word.startswith("--")), words[-1]).lstrip("-") in error
    assert not any(tmp_path.iterdir())


def test_dates_are_no_text():
    """What TOML calls a date is one here too, so that the table above means what it says."""
    assert tomllib.loads("a = 1979-05-27")["a"] == datetime.date(1979, 5, 27)
