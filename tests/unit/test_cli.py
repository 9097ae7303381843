"""The command line: what each command leaves behind, and how every kind of error reaches the user.

What carries the weight: an error is one line on stderr with its exit code and no traceback, and help and
`show` load no numerical library.
"""

import errno
import json
import os
import subprocess
import sys
import threading
import time
from functools import partial
from inspect import signature
from pathlib import Path

import pytest
from fretflow import __version__, cli
from fretflow.case.config import load_case
from fretflow.cli import terminal
from fretflow.cli.app import _limit_threads, app
from fretflow.core.errors import AuditError, MeshError, NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.pipeline import diagnose as pipeline_diagnose
from fretflow.pipeline import stages as pipeline_stages
from fretflow.pipeline.stage import Stage
from rich.console import Console

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "test1.toml")
CASE = """format = "fretflow-case/1"
name = "{name}"
[test]
excitation_amplitude = "53 N"
cycles = {cycles}
"""


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE.format(name="small", cycles=10))
    return path


def fretflow(*arguments):
    return cli.execute([str(argument) for argument in arguments])


def one_line(capsys):
    error = capsys.readouterr().err
    assert error.startswith("fretflow: ")
    assert error.endswith("\n")
    assert error.count("\n") == 1
    return error


@pytest.fixture
def failing(monkeypatch):
    """Replace the pipeline by a single stage that raises what it is given."""

    def prepare(error):
        def fail(context):
            (context.folder / "state").touch()
            raise error

        monkeypatch.setattr(pipeline_stages, "pipeline", lambda: (Stage("mesh", 1, lambda case: 0, (), fail),))

    return prepare


def test_init_writes_a_case_to_start_from_and_leaves_an_existing_one_alone(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    assert fretflow("init", path) == 0
    assert load_case(path).test.cycles == 100_000
    assert f"fretflow run {path}" in capsys.readouterr().out
    path.write_text("mine")
    assert fretflow("init", path) == 2
    assert "exists and is left as it is" in one_line(capsys)
    assert path.read_text() == "mine"
    assert fretflow("init", tmp_path / "no" / "case.toml") == 2
    assert "cannot be written" in one_line(capsys)


def test_show_lists_every_value_in_readable_units(case, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    assert fretflow("show", case) == 0
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["excitation_amplitude", "53", "N", "amplitude"] == next(
        line[:4] for line in shown if line[:1] == ["excitation_amplitude"])
    assert ["youngs_modulus", "193", "GPa", "default"] in [line[:4] for line in shown]
    assert ["harmonics", "40", "default"] in [line[:3] for line in shown]
    assert ["estimate_error", "true", "default"] in [line[:3] for line in shown]  # as a case file takes it


def test_help_is_wrapped_once_and_offers_nothing_without_use(capsys, monkeypatch):
    monkeypatch.setattr(app, "console", Console(width=300))  # which keeps the width that it was first used with
    for command in ("run", "response", "diagnose"):
        assert fretflow(command, "--help") == 0
        shown = capsys.readouterr().out
        assert "--empty" not in shown
        assert "[default: False]" not in shown
        assert "With --quiet a command says errors alone" in shown
        paragraphs = [line for line in shown.splitlines() if line[:1] not in ("╭", "│", "╰", "") and line.strip()]
        assert all(line.strip().endswith((".", "]", "CASE", "RUN", "RECORDING", "[ARGS...]")) for line in paragraphs)
    assert fretflow("run", "--help") == 0
    assert "OUT/NAME" in capsys.readouterr().out  # what looks like a tag is none


def test_every_command_keeps_what_it_found_or_wrote_as_json(case, capsys, tmp_path):
    for name in app.resolved_commands():
        if not name.startswith("-"):
            assert "json" in signature(app[name].default_command).parameters, name
    (tmp_path / "loop.csv").write_text("x_um,Kraft\n" + "1,2\n" * 20)
    written = tmp_path / "recording.toml"
    assert fretflow("init", "--recording", tmp_path / "loop.csv", "--json", tmp_path / "i.json", "--quiet") == 0
    assert json.loads((tmp_path / "i.json").read_text()) == {
        "file": str(written), "taken": {"displacement": "x_um", "friction_force": "Kraft"}, "lacks": ["friction_force"]}
    assert fretflow("show", case, "--quiet", "--json", tmp_path / "deep" / "a.json") == 0
    assert capsys.readouterr().out == ""
    whole = json.loads((tmp_path / "deep" / "a.json").read_text())
    assert {"table": "test", "key": "cycles", "value": 10, "unit": "", "default": False,
            "meaning": "length of the test in cycles"} in whole["values"]
    assert fretflow("effects", "viscous", "--out", tmp_path, "--json", tmp_path / "b.json") == 0
    (sheet,) = json.loads((tmp_path / "b.json").read_text())
    assert sheet["parameters"][0]["plausible"] == [50.0, 3000.0]
    assert fretflow("show", case, "--json", case / "a.json") == 2
    assert "--json" in one_line(capsys)


def test_version(capsys):
    assert fretflow("--version") == 0
    assert capsys.readouterr().out.strip() == __version__


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["polish"], "polish"),
        (["run"], "CASE"),
        (["run", "{case}", "--untill", "mesh"], "untill"),
        (["run", "{case}", "--until", "polish"], "choose one of mesh"),
        (["show", "absent.toml"], "absent.toml"),
        (["render", "{case}"], "holds no run"),
        (["run", "{case}", "{case}"], "'small' is the name of several cases"),
        (["run", "{case}", "--out", "{case}"], "cannot be written"),
        (["run", "{case}", "--out", 300 * "x"], "cannot be written (File name too long)"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(case, capsys, arguments, message):
    assert fretflow(*(argument.format(case=case) for argument in arguments)) == 2
    assert message in one_line(capsys)


def test_a_bad_case_is_one_line_that_names_file_and_field(case, capsys):
    case.write_text(CASE.format(name="small", cycles=-1))
    for command in ("run", "show", "modes"):
        assert fretflow(command, case) == 2
        assert f"{case}: test.cycles: " in one_line(capsys)


@pytest.mark.parametrize(("error", "code"), [
    (MeshError("upper.msh: has no group contact;\nname it"), 2), (AuditError("friction cone: violated"), 3)])
def test_errors_on_purpose_keep_their_exit_code(case, failing, capsys, tmp_path, error, code):
    failing(error)
    assert fretflow("run", case, "--out", tmp_path / "runs") == code
    assert " ".join(str(error).split()) in one_line(capsys)


def test_non_convergence_names_the_history_and_the_last_good_state(case, failing, capsys, tmp_path):
    failing(NonConvergenceError("period: no step helps", history=[1.0, 0.5]))
    assert fretflow("run", case, "--out", tmp_path / "runs") == 3
    line = one_line(capsys)
    words = line.split()
    history = Path(words[words.index("history") + 2].rstrip(";"))
    assert history.read_text().splitlines()[-1] == "1,0.5"
    assert (Path(words[-1]) / "state").exists()


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_full_disk_anywhere_is_one_line_that_names_the_file(capsys, monkeypatch, tmp_path, code):
    """Also in the cache, where the diagnosis keeps its specimens."""
    def fails(*_arguments):
        raise OSError(code, os.strerror(code), "/full/cache/models")

    monkeypatch.setattr(pipeline_diagnose, "kept_models", fails)
    (tmp_path / "recording.toml").write_text("")
    assert fretflow("diagnose", tmp_path, "--out", tmp_path / "out") == 2
    line = one_line(capsys)
    assert "/full/cache/models" in line
    assert "free some space" in line
    assert "Traceback" not in line


def test_an_interrupt_says_that_the_run_goes_on_where_it_stopped(case, failing, capsys, tmp_path):
    failing(KeyboardInterrupt())
    assert fretflow("run", case, "--out", tmp_path / "runs") == 130
    assert "goes on from what is complete" in one_line(capsys)


def test_the_unexpected_is_one_line_with_its_traceback_in_a_file(case, failing, capsys, tmp_path):
    failing(ZeroDivisionError("oh"))
    assert fretflow("run", case, "--out", tmp_path / "runs") == 1
    line = one_line(capsys)
    assert "unexpected ZeroDivisionError: oh" in line
    kept = Path(line.split()[-1])
    assert "Traceback" in kept.read_text()
    assert "raise error" in kept.read_text()
    kept.unlink()


@pytest.mark.parametrize("arguments", [["--help"], ["show", "{case}"], ["show", EXAMPLE]])
def test_help_and_show_load_no_numerical_library(case, arguments):
    arguments = [argument.format(case=case) for argument in arguments]
    program = (
        "import sys; from fretflow import cli\n"
        "try:\n    cli.execute(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'scipy', 'h5py', 'mpi4py', 'dolfinx', 'gmsh', 'pyvista', 'matplotlib'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("given", "expected"), [({}, "1"), ({"OMP_NUM_THREADS": "7"}, "7")])
def test_one_blas_thread_unless_the_user_has_chosen(monkeypatch, given, expected):
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(variable, raising=False)
    for variable, value in given.items():
        monkeypatch.setenv(variable, value)
    _limit_threads()
    assert os.environ["OMP_NUM_THREADS"] == expected


@pytest.mark.parametrize(("arguments", "meant"), [
    (["run", "{case}", "--until", "redcue"], "did you mean reduce?"),
    (["effects", "third-boddy"], "did you mean third-body?"),
    (["run", "{case}", "--until", "pictures"], "choose one of mesh, reduce")])
def test_a_slip_of_a_name_is_answered_with_the_nearest(case, capsys, tmp_path, arguments, meant):
    arguments = [argument.format(case=case) for argument in arguments]
    assert fretflow(*arguments, "--out", tmp_path / "runs") == 2
    assert meant in one_line(capsys)


@pytest.mark.parametrize(("written", "meant"), [
    ("[test]\nexitation_amplitude = \"53 N\"\ncycles = 1", "did you mean excitation_amplitude?"),
    ("[test]\nexcitation_amplitude = \"53 N\"\ncycles = 1\n[wear]\ncoeficient = \"1e-14 m^2/N\"", "coefficient?"),
    ("[test]\nexcitation_amplitude = \"53 N\"\ncycles = 1\n[specimen.upper]\nyoung_modulus = \"1 GPa\"",
     "youngs_modulus?"),
    ("[test]\nexcitation_amplitude = \"53 N\"\ncycles = 1\n[effects.viscous]\ndampin = \"1 N*s/m\"", "damping?")])
def test_a_slip_of_a_key_is_answered_with_the_nearest(capsys, tmp_path, written, meant):
    path = tmp_path / "slip.toml"
    path.write_text(f'format = "fretflow-case/1"\nname = "slip"\n{written}\n')
    assert fretflow("show", path) == 2
    assert meant in one_line(capsys)


def test_quiet_says_errors_alone(tmp_path, capsys):
    assert fretflow("--quiet", "init", tmp_path / "case.toml") == 0
    assert capsys.readouterr().out == ""
    assert fretflow("init", tmp_path / "case.toml", "--quiet") == 2
    assert "exists and is left as it is" in one_line(capsys)
    assert fretflow("show", tmp_path / "case.toml") == 0
    assert "excitation_amplitude" in capsys.readouterr().out


def test_a_log_without_a_terminal_gets_a_line_a_minute(capsys, monkeypatch):
    """Also where a step takes longer than that: a diagnosis said one line in five minutes."""
    monkeypatch.setattr(terminal, "TOLD_EVERY", 0.05)
    before = set(threading.enumerate())
    with terminal.Progress() as progress:
        progress.begin("wear")
        progress.advance("wear", 0.41, "jump 7")
        said, latest = [], time.monotonic() + 60.0
        while len(said) < 2 and time.monotonic() < latest:
            said += capsys.readouterr().out.splitlines()
    assert len(said) >= 2
    assert {tuple(line.split()) for line in said} == {("wear", "41", "%", "0", "min", "jump", "7")}
    for one in set(threading.enumerate()) - before:  # it ends with the stage
        one.join(60.0)
        assert not one.is_alive()


@pytest.mark.parametrize("steady", [True, False])
def test_time_left_is_told_only_where_the_share_grows_steadily(capsys, monkeypatch, steady):
    monkeypatch.setattr(terminal, "Terminal", partial(terminal.Terminal, force_terminal=True, width=100))
    with terminal.Progress() as progress:
        progress.begin("response", steady=steady)
        progress.advance("response", 0.5, "50 Hz")
    said = capsys.readouterr().out
    assert "50 Hz" in said
    assert ("left" in said) == steady


@pytest.mark.parametrize("width", ["60", "80"])
def test_names_that_are_copied_are_never_broken(capsys, monkeypatch, width, tmp_path):
    monkeypatch.setenv("COLUMNS", width)
    assert fretflow("effects", "third-body", "--out", tmp_path) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in catalogue()["third-body"].model_fields)
    assert " um" not in said
    assert "e+0" not in said


@pytest.mark.parametrize("name", catalogue())
def test_equations_are_broken_between_their_parts_alone(name, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("fretflow.core.plugins.provided", lambda *_: lambda *_: tmp_path)
    assert fretflow("effects", name) == 0
    said = capsys.readouterr().out
    assert all(part in said for part in catalogue()[name].equation.split("; "))


def test_a_sheet_shows_no_markup_of_a_docstring(capsys, tmp_path):
    assert fretflow("effects", "channel-delay", "--out", tmp_path) == 0
    said = capsys.readouterr().out
    assert "Measured force T(t - tau): " in said
    assert "`" not in said


@pytest.mark.parametrize("words", [("effects",), ("effects", "third-body")])
@pytest.mark.parametrize("width", ["60", "70", "90"])
def test_a_narrow_terminal_breaks_no_word(capsys, monkeypatch, words, width, tmp_path):
    said = []
    for columns in ("300", width):
        monkeypatch.setenv("COLUMNS", columns)
        assert fretflow(*words, "--out", tmp_path) == 0
        said.append({word for word in capsys.readouterr().out.split() if not word.startswith("─")})
    assert said[0] <= said[1]


@pytest.mark.parametrize(("shell", "file"), [("bash", ".local/share/bash-completion/completions/fretflow"),
                                             ("zsh", ".zsh/completions/_fretflow"),
                                             ("fish", ".config/fish/completions/fretflow.fish")])
def test_names_are_completed_in_three_shells(shell, file, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # whose files are told to read the script
    made = tmp_path / file
    made.parent.mkdir(parents=True)
    assert fretflow("--install-completion", "--shell", shell, "--output", made) == 0
    script = made.read_text()
    assert all(word in script for word in ("diagnose", "export", "until"))
    capsys.readouterr()
