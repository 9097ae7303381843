"""The diagnose command: what it leaves behind and says, for every verdict, and when a recording cannot be used.

What carries the weight: the verdict does not change the exit code, the files hold what was found, and each kind of
error is one line.
"""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from fretflow import cli
from fretflow.core.errors import UnreliableRecordingError
from fretflow.inference.verdict import Estimate
from fretflow.recordings import kinds
from rich.console import Console

HERE = Path(__file__).parent
MAKERS = ("named", "none", "ambiguous", "unknown", "odd", "empty")


@pytest.fixture
def cases(monkeypatch):
    monkeypatch.syspath_prepend(HERE)
    import report_cases

    return report_cases


@pytest.fixture
def calls(monkeypatch, tmp_path):
    """Put a stand-in for the diagnosis; the list is filled with what it is called with."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    (tmp_path / "my rig").mkdir()
    seen = []

    def prepare(answer):
        def diagnose(recorded, fast, progress, tools):
            assert tools.pool(len, ["four"]) == [4]
            for share in (0.0, 0.4, 1.0):
                progress(share, f"step {share}")
            seen.append((recorded.path, fast))
            if isinstance(answer, Exception):
                raise answer
            return answer

        kind = SimpleNamespace(experiment="stand_in:diagnose")
        monkeypatch.setattr(kinds, "read_recording", lambda path: SimpleNamespace(path=path, kind=kind))
        monkeypatch.setitem(sys.modules, "stand_in", SimpleNamespace(diagnose=diagnose))
        return seen

    return prepare


@pytest.mark.parametrize("maker", MAKERS)
def test_every_verdict_ends_well_with_its_files(maker, cases, calls, tmp_path, capsys):
    diagnosis = getattr(cases, maker)()
    seen = calls(diagnosis)
    assert cli.execute(["diagnose", "my rig"]) == 0
    home = Path("runs/diagnosis/my rig")
    assert seen == [(Path("my rig"), False)]
    assert json.loads((home / "diagnosis.json").read_text())["verdict"] == diagnosis.verdict.value
    assert "</html>" in (home / "report.html").read_text(encoding="utf-8")
    with (home / "places.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["cut"] for row in rows] == [place.cut for place in diagnosis.location.places]
    assert (home / "case.toml").exists() == diagnosis.case_file.startswith("format")
    shown = " ".join(capsys.readouterr().out.split())
    assert diagnosis.sentence in shown
    assert all(str(home / name) in shown for name in ("report.html", "diagnosis.json", "places.csv"))


def test_what_is_printed_in_short(cases, calls, capsys):
    diagnosis = cases.named()
    calls(diagnosis)
    assert cli.execute(["diagnose", "my rig", "--fast"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for text in ("Missing physics named.", "friction-run-in 96 % 97 % fully",
                 "contact-stiffness-evolution < 0.1 % 31 % given up early", diagnosis.location.text,
                 "friction-run-in.energy 42.1", "38.7 to 46.0 J", "error 8.40 before, 1.06 after",
                 f"warning: {diagnosis.warnings[0]}", "something that the catalogue lacks",
                 diagnosis.separating_measurement, "p < 10⁻¹⁵"):
        assert text in shown
    assert "velocity-dependent-friction" not in shown, "only five are shown"
    assert "step" not in shown, "the bar is for terminals"


def test_what_stands_at_its_bound_has_no_interval(cases, calls, capsys):
    """It was told as "0 to 0"."""
    exponent = Estimate(name="wear-power-law.exponent", value=0.0, low=0.0, high=0.0, unit="1")
    calls(replace(cases.named(), parameters=(exponent,)))
    assert cli.execute(["diagnose", "my rig"]) == 0
    assert "wear-power-law.exponent 0 stands at its bound" in " ".join(capsys.readouterr().out.split())
    home = Path("runs/diagnosis/my rig")
    assert "stands at its bound" in (home / "report.html").read_text(encoding="utf-8")
    assert "# wear-power-law.exponent = 0 (stands at its bound)" in (home / "case.toml").read_text()


def test_fits_given_up_early_are_told_in_the_json(cases):
    told = cases.named().to_json()["ranking"]
    assert [one["given_up_early"] for one in told] == [not one.converged for one in cases.RANKING]


def test_further_copies_go_where_they_are_wanted(cases, calls, tmp_path, capsys):
    seen = calls(cases.named())
    arguments = ["diagnose", "my rig", "--fast", "--out", "here", "--json", "new/a.json", "--case", "new/b.toml"]
    assert cli.execute(arguments) == 0
    assert seen == [(Path("my rig"), True)]
    assert Path("new/a.json").read_bytes() == Path("here/diagnosis.json").read_bytes()
    assert 'name = "my-rig"' in Path("new/b.toml").read_text()
    calls(cases.unknown())
    assert cli.execute(["diagnose", "my rig", "--case", "other.toml"]) == 0
    assert not Path("other.toml").exists()
    assert "other.toml was not written" in capsys.readouterr().out


def test_progress_is_shown_on_a_terminal(cases, calls, monkeypatch, capsys):
    calls(cases.empty())
    monkeypatch.setenv("TERM", "xterm")  # on a dumb one no bar moves
    monkeypatch.setattr("fretflow.cli.terminal.Terminal", lambda **_: Console(force_terminal=True, width=100))
    assert cli.execute(["diagnose", "my rig"]) == 0
    assert "step 1.0" in capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "message"), [
    (["no such folder"], "no such folder: there is no such folder or file"),
    (["my rig", "--out", "file"], "file: cannot be made"),
    (["my rig"], "rows 3-9 of force are damaged"),
])
def test_what_cannot_be_used_is_one_line(arguments, message, calls, tmp_path, capsys):
    calls(UnreliableRecordingError("rows 3-9 of force are damaged"))
    (tmp_path / "file").touch()
    assert cli.execute(["diagnose", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"fretflow: {message}")
    assert error.count("\n") == 1
