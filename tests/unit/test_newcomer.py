"""What a newcomer types wrongly on the command line: one line that says so and the way out, with nothing computed.

What carries the weight: each mistake ends with exit code 2, nothing on standard output, and one line that names what
was meant, or what takes what was given.
"""

import subprocess
import sys

import pytest
from fretflow import __version__, cli
from fretflow.cli.terminal import show_files

CASE = """format = "fretflow-case/1"
name = "quick"
[test]
excitation_frequency = "100 Hz"
excitation_amplitude = "75 N"
normal_load = "60 N"
cycles = 20
"""


@pytest.fixture(scope="module")
def home(make, tmp_path_factory):
    """Return a folder with a case, a recording, its loops alone in another folder, and things that are neither."""
    folder = tmp_path_factory.mktemp("newcomer")
    make().write(folder / "rec")
    for name in ("alone", "empty"):
        (folder / name).mkdir()
    (folder / "loops.csv").write_text((folder / "rec" / "loops.csv").read_text())
    (folder / "alone" / "loops.csv").write_text((folder / "rec" / "loops.csv").read_text())
    (folder / "quick.toml").write_text(CASE)
    (folder / "cases").mkdir()
    (folder / "cases" / "mine.toml").write_text(CASE)
    (folder / "text.txt").write_text("hello\n")
    (folder / "file").write_text("")
    return folder


@pytest.mark.parametrize(("typed", "said"), [
    ("rn quick.toml", 'Did you mean "run"?; `fretflow --help` tells what there is'),
    ("run", "CASE requires an argument"),
    ("run quick", "quick: cannot be read (No such file or directory); a case is a TOML file, and `fretflow init` "
                  "writes one to start from; did you mean quick.toml?"),
    ("run cases", "cases: cannot be read (Is a directory), and holds mine.toml; a case is a TOML file"),
    ("run empty", "empty: cannot be read (Is a directory); a case is a TOML file, and `fretflow init` writes one"),
    ("run text.txt", "text.txt: not valid TOML: Expected '='"),
    ("run loops.csv", "a case is a TOML file, and `fretflow init` writes one"),
    ("run rec/recording.toml", "format: is a recording, which `fretflow loops` and `fretflow diagnose` take"),
    ("show rec/recording.toml", "format: is a recording, which `fretflow loops` and `fretflow diagnose` take"),
    ("diagnose quick.toml", "format: is a case, which `fretflow run` takes"),
    ("loops quick.toml", "format: is a case, which `fretflow run` takes"),
    ("loops alone", "which `fretflow init --recording FILE` writes for a file of loops"),
    ("diagnose empty", "which `fretflow init --recording FILE` writes for a file of loops"),
    ("diagnose cases", "for a file of loops, or one table of wear tests"),
    ("init --recording rec", "rec: is no file; name one of loops"),
    ("init nowhere/case.toml", "nowhere/case.toml: cannot be written"),
    ("loops loops.csv --displacement um", 'a unit alone stands in brackets, "[um]"'),
    ("diagnose rec --json empty", "for --json. empty is a folder; name a file"),
    ("diagnose rec --case file/x.toml", "for --case. "),
    ("loops rec --json empty", "for --json. empty is a folder; name a file"),
    ("run quick.toml --json file/x.json", "is no folder that may be written in; name another file"),
    ("diagnose rec --out file", "file: cannot be made"),
    ("run quick.toml --unti wear", "Did you mean --until?"),
    ("loops rec rec", "fretflow loops takes no 'rec' there; `fretflow loops --help` tells what there is"),
    ("verify empty --periods 0", "--periods 0: must be at least 1"),
    ("help", "`fretflow --help` tells what there is"),
    ("run quick.toml --until wera", "did you mean wear?"),
])
def test_a_slip_is_one_line_with_a_way_out(home, monkeypatch, capsys, typed, said):
    monkeypatch.chdir(home)
    assert cli.execute(typed.split()) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert said in output.err


@pytest.mark.parametrize(("typed", "said"), [("loops rec", "begins anew"), ("run quick.toml", "goes on from what")])
def test_an_interruption_says_whether_anything_is_kept(home, monkeypatch, capsys, typed, said):
    """A diagnosis, of which nothing is kept, said that it goes on from what is complete."""
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(home)
    monkeypatch.setattr("fretflow.recordings.loop_sets.read_sets", stopped)
    monkeypatch.setattr("fretflow.cli.run.load", stopped)
    assert cli.execute(typed.split()) == 130
    assert said in capsys.readouterr().err


def test_the_module_is_the_program():
    """``python -m fretflow`` was "a package and cannot be directly executed"."""
    done = subprocess.run([sys.executable, "-m", "fretflow", "--version"], capture_output=True, text=True, timeout=60)
    assert (done.stdout.strip(), done.stderr) == (__version__, "")


def test_pictures_are_listed_in_every_format_asked_for(tmp_path, monkeypatch, capsys):
    """Of ``FRETFLOW_FORMATS=svg,pdf`` both were written and one was listed."""
    files = [tmp_path / "loops.svg", tmp_path / "loops.csv"]
    monkeypatch.setenv("FRETFLOW_FORMATS", "svg, pdf")
    show_files([*files, tmp_path / "loops.pdf"], "pictures")
    listed = [line.split("/")[-1] for line in capsys.readouterr().out.splitlines()[1:]]
    assert listed == ["loops.svg", "loops.pdf", "loops.csv"]
    monkeypatch.setenv("FRETFLOW_FORMATS", "")
    show_files(files, "pictures")
    assert len(capsys.readouterr().out.splitlines()) == 3
