"""The row of a case beside what was measured, and several cases with one command.

What carries the weight: a failing case neither stops the others nor hides behind them, whichever way they run, and
the regime is read off the contact states as defined.
"""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow import cli
from fretflow.case.config import SlidingRegime
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.pipeline import stages as pipeline_stages
from fretflow.pipeline.comparison import CaseComparison, sliding_regime
from fretflow.pipeline.stage import Stage

STICK, SLIP, SEPARATION = 0, 1, 2
CASE = 'format = "fretflow-case/1"\nname = "{0}"\ntitle = "{0}"\n[test]\nexcitation_amplitude = "1 N"\ncycles = 1\n'


@pytest.mark.parametrize(("state", "regime"), [
    ([[STICK, STICK], [STICK, SEPARATION]], SlidingRegime.STICK),
    ([[SLIP, STICK], [STICK, SLIP]], SlidingRegime.PARTIAL_SLIP),
    ([[SLIP, STICK], [SLIP, SLIP]], SlidingRegime.GROSS_SLIP),
    ([[SLIP, SEPARATION], [STICK, STICK]], SlidingRegime.GROSS_SLIP),
    ([[SEPARATION, SEPARATION], [STICK, STICK]], SlidingRegime.STICK)])
def test_gross_slip_is_an_instant_at_which_nothing_sticks(state, regime):
    assert sliding_regime(SimpleNamespace(state=np.array(state)), np.ones(2)) is regime


def test_a_node_without_area_does_not_count():
    state = np.array([[SLIP, STICK]])
    assert sliding_regime(SimpleNamespace(state=state), np.array([1.0, 0.0])) is SlidingRegime.GROSS_SLIP


def test_what_is_missed_is_remarked_upon():
    assert CaseComparison("a", sliding=35.7e-6, measured_sliding=22e-6).sliding_error == pytest.approx(0.6227, abs=1e-4)
    assert CaseComparison("a", sliding=35.7e-6, measured_sliding=22e-6).remarkable
    assert not CaseComparison("a", sliding=13e-6, measured_sliding=14e-6).remarkable
    assert CaseComparison("a", volume=1.2, measured_volume=1.0).remarkable
    assert not CaseComparison("a", sliding=13e-6).remarkable
    regimes = {"worn_regime": SlidingRegime.STICK, "measured_regime": SlidingRegime.GROSS_SLIP}
    assert CaseComparison("a", **regimes).remarkable


@pytest.fixture
def paths(tmp_path, monkeypatch):
    """Return three case files of a pipeline with one stage; of the second it does not converge."""

    def work(context):
        if context.case.name == "second":
            raise NonConvergenceError("no step helps", history=[1.0])
        if context.case.name == "third":
            raise InputError("third: has no mesh")
        return {}

    monkeypatch.setattr(pipeline_stages, "pipeline", lambda: (Stage("mesh", 1, lambda case: case.title, (), work),))
    made = []
    for name in ("first", "second", "third", "fourth"):
        made.append(tmp_path / f"{name}.toml")
        made[-1].write_text(CASE.format(name))
    return made


def test_failing_cases_do_not_stop_the_others_and_the_worst_gives_the_exit_code(paths, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.execute(["run", *map(str, paths), "--out", str(out)]) == 3
    shown = capsys.readouterr()
    assert "2 of 4 cases failed; second: no step helps" in shown.err.splitlines()[-1]
    assert [(out / name / "run.json").is_file() for name in ("first", "second", "third", "fourth")] == [
        True, False, False, True]
    rows = {row["case"]: row for row in csv.DictReader((out / "comparison.csv").read_text().splitlines())}
    assert [name for name, row in rows.items() if row["failure"]] == ["second", "third"]
    assert float(rows["first"]["time_s"]) >= 0.0
    assert cli.execute(["run", str(paths[0]), str(paths[3]), "--out", str(out)]) == 0
    assert cli.execute(["run", str(paths[2]), "--out", str(out)]) == 2


def test_cases_at_once_are_run_by_processes_of_their_own(tmp_path, capsys):
    # real processes know the real pipeline only: both stop at a mesh file that is none
    made = []
    for name in ("one", "two"):
        made.append(tmp_path / f"{name}.toml")
        (tmp_path / f"{name}.msh").write_text("no mesh")
        made[-1].write_text(CASE.format(name) + f'[mesh]\nupper = "{name}.msh"\nlower = "{name}.msh"\n')
    assert cli.execute(["run", *map(str, made), "--jobs", "2", "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr()
    assert "2 of 2  " in shown.out
    assert "2 of 2 cases failed; one: " in shown.err
    assert "one.msh: " in shown.err
    assert "two.msh: " in shown.err
