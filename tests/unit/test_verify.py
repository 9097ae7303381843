"""Checking a run's periods by time integration: what is compared, what is said, and the exit code.

What carries the weight: a true period passes, and one of few harmonics, or of another load, is found out with the
size of its error; the worn period is checked with its own gap.
"""

import csv
from dataclasses import replace

import numpy as np
import pytest
from fretflow import cli
from fretflow.case.casefile import dump_case
from fretflow.case.config import PeriodicMethod, Solver, validate_case
from fretflow.contact.interface import Interface
from fretflow.core.store import read_record, write_record
from fretflow.effects.cycle import PeriodicCycle
from fretflow.effects.model import EffectModel
from fretflow.pipeline import verify
from fretflow.pipeline.problem import rig_problem
from fretflow.pipeline.stage import CASE_FILE, RUN_FILE, Manifest, write_json
from fretflow.solvers.dlft.solver import DlftSolver
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver, sliding_distance
from fretflow.solvers.time_integration import integrate
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.history import WearHistory, WearSettings
from fretflow.wear.march import run_history

NODES = 4
FLEXIBILITY = np.kron(1e-8 * np.eye(NODES) + 4e-9 * np.ones((NODES, NODES)), np.eye(3))
SETTINGS = Solver(harmonics=40, samples=256, estimate_error=False)
PROBLEM = rig_problem(
    joint=QuasiStaticJoint.from_stiffness(np.linalg.inv(FLEXIBILITY),
                                          LumpedRig.from_modes(10.0, 0.5, 40.0, 900.0, 0.05)),
    interface=Interface(nodes=np.zeros((NODES, 2)), areas=np.full(NODES, 2.5e-7),
                        gap=1e-8 * np.arange(NODES)),
    friction_coefficient=0.88, frequency=100.0, excitation=75.0, normal_load=60.0)
CASE = validate_case({"format": "fretflow-case/1", "name": "toy",
                      "test": {"excitation_amplitude": "75 N", "cycles": 20000}})


@pytest.fixture(scope="module")
def true_period():
    return QuasiStaticSolver(SETTINGS).solve(PROBLEM)


@pytest.fixture(scope="module")
def rough_period():
    return DlftSolver(Solver(method=PeriodicMethod.DLFT, estimate_error=False)).solve(PROBLEM)


def test_a_true_period_is_confirmed_with_little_drift(true_period):
    check = verify.check_period("unworn", 0, PROBLEM, true_period)
    assert check.agrees
    assert check.error < 0.01
    assert check.sliding_distance[0] == pytest.approx(sliding_distance(true_period, PROBLEM.interface))
    assert check.steps_per_period == 1024
    assert check.drift[-1] < verify.SETTLED
    assert verify.verdict([check]) is None


def test_too_few_harmonics_are_found_out_with_the_size_of_their_error(true_period, rough_period):
    check = verify.check_period("unworn", 0, PROBLEM, rough_period)
    assert not check.agrees
    true = sliding_distance(true_period, PROBLEM.interface)
    assert check.sliding_distance[1] == pytest.approx(true, rel=0.01)  # followed to where it should be
    assert check.sliding_difference == pytest.approx(abs(1 - check.sliding_distance[0] / true), abs=2e-3)
    assert "unworn period off by" in verify.verdict([check])
    assert 'use method = "quasi-static"' in verify.verdict([check])


def test_a_period_of_another_load_is_found_out(true_period):
    check = verify.check_period("unworn", 0, PROBLEM.vary(amplitude=77.0), true_period)
    assert not check.agrees
    assert "use more samples" in verify.verdict([check])


def test_the_figures_are_those_of_the_histories(true_period):
    """On a lattice that both share, so that nothing is interpolated."""
    check = verify.check_period("unworn", 0, PROBLEM, true_period, periods=2, steps=512)
    count = len(check.drift) + 1
    history = integrate(PROBLEM, true_period, count, 512)
    friction = history.of_period(history.friction_force)[::2]
    np.testing.assert_allclose(check.integrated_force, friction, atol=1e-9)
    expected = np.sqrt(np.mean((true_period.friction_force - friction)**2)) / np.ptp(friction)
    assert check.force_difference == pytest.approx(expected, rel=1e-6)
    moved = true_period.displacement - np.roll(true_period.displacement, 1, axis=0)
    work = -np.sum(true_period.force[:, :, :2] * moved[:, :, :2])
    assert check.dissipated_energy[0] == pytest.approx(work, rel=1e-9)
    assert check.dissipated_energy[1] == pytest.approx(history.friction_work[-512:].sum(), rel=1e-9)


def test_a_joint_that_sticks_has_no_energy_to_differ_in():
    stuck = replace(PROBLEM.vary(amplitude=5.0), interface=replace(PROBLEM.interface, gap=np.zeros(NODES)))
    check = verify.check_period("unworn", 0, stuck, QuasiStaticSolver(SETTINGS).solve(stuck))
    assert check.energy_difference < 1e-3
    assert check.agrees


@pytest.fixture
def run(tmp_path, monkeypatch, true_period):
    """Return a function that makes the folder of a run of the toy problem."""
    monkeypatch.setattr(verify, "make_model", lambda case, folder: EffectModel.build(PROBLEM))

    def make(solution=true_period, worn=False):
        home = tmp_path / "runs" / "toy"
        stages = ["reduce", "solve", *(["wear"] if worn else [])]
        for stage in stages:
            (home / stage).mkdir(parents=True)
            Manifest(stage, 1, stage, {}, {}, {}, None, 1, 0.0, 0, False, "").write(home / stage)
        write_record(home / "solve" / "solution.h5", solution)
        if worn:
            model = PeriodicCycle(QuasiStaticSolver(SETTINGS), PROBLEM)
            settings = WearSettings(coefficient=1.1e-14, cycles=CASE.test.total_cycles)
            write_record(home / "wear" / "history.h5", run_history(model, settings, home / "wear" / "checkpoints"))
        write_json(home / RUN_FILE, {"case": "toy", "stages": {stage: stage for stage in stages}})
        (home / CASE_FILE).write_text(dump_case(CASE), encoding="utf-8")
        return home

    return make


def figures(home):
    with (home / "verify" / "checks.csv").open(encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def test_the_command_confirms_the_unworn_and_the_worn_period(run, capsys):
    home = run(worn=True)
    assert cli.execute(["verify", str(home)]) == 0
    shown = capsys.readouterr().out
    assert "confirms the periodic solution within 1 %" in shown
    rows = figures(home)
    assert [(row["name"], row["cycles"]) for row in rows] == [("unworn", "0"), ("worn", "20000")]
    depth = read_record(home / "wear" / "history.h5", WearHistory).depth[-1]
    assert depth.max() > 1e-8
    curves = np.genfromtxt(home / "verify" / "worn.csv", delimiter=",", names=True)
    assert len(curves) == 256
    rms = np.sqrt(np.mean((curves["periodic_friction_N"] - curves["integrated_friction_N"])**2))
    assert rms / np.ptp(curves["integrated_friction_N"]) == pytest.approx(float(rows[1]["force_difference"]), rel=1e-6)


def test_the_worn_period_is_checked_with_its_own_gap(run, monkeypatch):
    home, seen = run(worn=True), {}

    def note(name, cycles, problem, solution, periods, steps):
        seen[name] = problem.interface.gap
        return name

    monkeypatch.setattr(verify, "check_period", note)
    folders = {stage: home / stage for stage in ("reduce", "solve", "wear")}
    assert verify.verify_run(CASE, folders, 3, None, lambda text: None) == ["unworn", "worn"]
    depth = read_record(home / "wear" / "history.h5", WearHistory).depth[-1]
    np.testing.assert_allclose(seen["worn"] - seen["unworn"], depth, rtol=1e-12)


def test_the_command_says_what_differs_and_exits_with_1(run, rough_period, capsys):
    home = run(rough_period)
    assert cli.execute(["verify", str(home)]) == 1
    told = capsys.readouterr()
    assert told.err.startswith("fretflow: periodic solution and time integration differ: unworn period off by")
    assert told.err.count("\n") == 1
    assert "dlft" in figures(home)[0]["method"]
    assert figures(home)[0]["agrees"] == "False"


def test_a_case_file_stands_for_its_run(run, tmp_path, capsys):
    home = run()
    path = tmp_path / "toy.toml"
    path.write_text(dump_case(CASE), encoding="utf-8")
    options = ["--out", str(home.parent), "--periods", "1", "--steps", "512"]
    assert cli.execute(["verify", str(path), *options]) == 0
    changed = CASE.model_copy(update={"title": "another"})
    path.write_text(dump_case(changed), encoding="utf-8")
    assert cli.execute(["verify", str(path), *options]) == 2
    assert "run the case again" in capsys.readouterr().err


def test_what_cannot_be_checked_is_refused(run, tmp_path, capsys):
    assert cli.execute(["verify", str(tmp_path / "nothing")]) == 2
    home = run()
    write_json(home / RUN_FILE, {"case": "toy", "stages": {"reduce": "reduce"}})
    assert cli.execute(["verify", str(home)]) == 2
    assert "no solved period yet" in capsys.readouterr().err
    assert cli.execute(["verify", str(home), "--periods", "0"]) == 2
    assert "--periods 0: must be at least 1" in capsys.readouterr().err
