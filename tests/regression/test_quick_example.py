"""The quick example through the command line, from meshes to pictures.

What carries the weight: the load that went in comes out of the contact, the reduced models meet the full ones, wear
volume follows dissipated energy, loops are those of points 1 mm from the interface, and a second call computes nothing.
"""

import json
import os
import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fretflow import cli
from fretflow.case.config import load_case
from fretflow.core.store import read_record
from fretflow.pipeline import response
from fretflow.pipeline.results import RunResults
from fretflow.pipeline.run_records import ForcedResponse, LoopSeries
from fretflow.pipeline.stage import StageContext
from fretflow.pipeline.stages import complete_stages
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.fem.preload import Preload
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen
from fretflow.wear.checkpoint import kept_states
from fretflow.wear.history import WearHistory

pytestmark = [pytest.mark.fem, pytest.mark.render]

QUICK = Path(__file__).parents[2] / "examples" / "quick.toml"


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs")
    assert cli.execute(["run", str(QUICK), "--out", str(out)]) == 0
    return out / "quick"


def test_the_summary_holds_what_went_in_and_what_must_follow(home):
    summary = json.loads((home / "summary.json").read_text(), parse_constant=pytest.fail)  # NaN is no JSON
    values = {figure["name"]: figure["value"] for figure in summary["figures"]}
    assert values["static load"] == pytest.approx(60.0, rel=1e-10)
    assert values["mesh quality"] == pytest.approx(1.0, rel=1e-9)  # bricks
    assert 0.0 < values["Craig-Bampton error"] < 1e-3
    assert values["friction coefficient from the loop"] == pytest.approx(0.88, rel=0.01)
    assert 0.0 < values["mean wear depth"] <= values["largest wear depth"]
    assert values["wear volume"] == pytest.approx(values["mean wear depth"] * 1e-6, rel=1e-6)  # over 1 mm^2
    assert values["tangential stiffness from the loop"] is None  # the faces slide before the loop could show it
    assert [trend["met"] for trend in summary["trends"]] == [None]  # 20,000 cycles are too few for the sliding
    assert 0.0 < values["stick share"] < 0.3  # it slides as a whole for most of the period
    texts = {figure["name"]: figure["text"] for figure in summary["figures"]}
    assert re.search(r"quasi-static, estimated error \d+\.\d+ %", texts["sliding distance, unworn"])


def test_in_gross_slip_wear_volume_follows_dissipated_energy(home):
    case = load_case(QUICK)
    history = read_record(complete_stages(home)["wear"] / "history.h5", WearHistory)
    energy = np.sum(history.dissipated_energy[:-1] * np.diff(history.cycles))
    expected = case.wear.coefficient / case.contact.friction_coefficient * energy
    assert history.volume[-1] == pytest.approx(expected, rel=1e-6)


def specimens(home):
    folder = complete_stages(home)["reduce"]
    return [read_record(folder / f"{side}.h5", ReducedSpecimen) for side in ("upper", "lower")]


def observed(specimen, force):
    """Return the static x displacement (N,) of the observed point under contact forces (N, nodes, 3), by all DOFs."""
    free = np.delete(np.arange(len(specimen.stiffness)), np.arange(len(specimen.stiffness))[specimen.rigid])
    load = np.zeros((len(specimen.stiffness), len(force)))
    load[:specimen.contact_size] = force.reshape(len(force), -1).T
    return np.linalg.solve(specimen.stiffness[np.ix_(free, free)], load[free])[specimen.contact_size]


def test_loops_are_those_of_points_one_millimetre_from_the_interface(home):
    upper, lower = specimens(home)
    assert [upper.observation_point[2], lower.observation_point[2]] == pytest.approx([1e-3, -1e-3], rel=1e-9)
    stages = complete_stages(home)
    series, faces = (read_record(stages["response"] / f"loops_{name}.h5", LoopSeries) for name in ("observed", "faces"))
    periods = kept_states(stages["wear"] / "checkpoints", PeriodicSolution)
    assert series.cycles.tolist() == sorted(periods) == [0, 2_000, 10_000, 20_000]
    for cycles, measured in zip(series.cycles, series.peak_to_peak, strict=True):
        period = periods[int(cycles)]
        motion = period.rig_displacement[:, 1] + observed(upper, period.force) - observed(lower, -period.force)
        assert measured == pytest.approx(np.ptp(motion), rel=1e-9, abs=0.0)
    assert np.all(series.peak_to_peak > faces.peak_to_peak)  # by what lies between gives way


def test_the_worn_joint_responds_otherwise(home):
    unworn, worn = (read_record(complete_stages(home)["response"] / f"{name}.h5", ForcedResponse)
                    for name in ("unworn", "worn"))
    assert (unworn.cycles, worn.cycles) == (0, 20_000)
    assert worn.resonance != unworn.resonance
    assert worn.amplitude.max() != pytest.approx(unworn.amplitude.max(), rel=1e-6)


def test_both_responses_at_once_are_bit_by_bit_those_one_after_the_other(home, tmp_path, monkeypatch):
    inputs, told = complete_stages(home), []
    monkeypatch.setattr(response, "WORTH_A_PROCESS", 0)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    context = StageContext(load_case(QUICK), tmp_path, inputs, lambda share, text: told.append(text))
    figures = response.STAGE.run(context)
    assert told == ["frequency stepping, unworn and worn"]
    assert figures["worn_resonance_Hz"] == read_record(inputs["response"] / "worn.h5", ForcedResponse).resonance
    for name in ("unworn", "worn"):
        one, other = (read_record(folder / f"{name}.h5", ForcedResponse) for folder in (inputs["response"], tmp_path))
        for field in fields(one):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


def again(home, folder, old, new, until):
    """Run the example with `new` in place of `old`, in a copy of the first run, whose stages serve again."""
    assert old in QUICK.read_text()
    shutil.copytree(home, folder / "runs" / "quick")
    path = folder / "case.toml"
    path.write_text(QUICK.read_text().replace(old, new))
    assert cli.execute(["run", str(path), "--out", str(folder / "runs"), "--until", until]) == 0
    return folder / "runs" / "quick"


def test_a_load_pressed_on_against_friction_is_another_pressure_of_the_same_sum(home, tmp_path):
    rougher = again(home, tmp_path, "[mesh]", '[contact]\npreload = "frictional"\n[mesh]', "preload")
    smooth, rough = (read_record(complete_stages(run)["preload"] / "preload.h5", Preload) for run in (home, rougher))
    assert rough.force.sum() == pytest.approx(60.0, rel=1e-10)
    assert rough.force.min() > 0.0
    assert np.abs(rough.gap).max() < 1e-14
    assert 1e-3 < np.abs(rough.force - smooth.force).max() / smooth.force.max() < 0.2
    assert rough.approach < smooth.approach  # held laterally, the bodies are stiffer


def test_own_meshes_are_reduced_as_those_of_the_stage(home, tmp_path):
    for side in ("upper", "lower"):
        shutil.copy(complete_stages(home)["mesh"] / f"{side}.msh", tmp_path / f"my_{side}.msh")
    own = again(home, tmp_path, "[mesh]", '[mesh]\nupper = "my_upper.msh"\nlower = "my_lower.msh"', "reduce")
    assert complete_stages(own)["mesh"].name != complete_stages(home)["mesh"].name
    for ours, theirs in zip(specimens(own), specimens(home), strict=True):
        size = np.sqrt(np.diag(theirs.stiffness))
        assert np.abs((ours.stiffness - theirs.stiffness) / np.outer(size, size)).max() < 1e-9


def test_the_share_of_the_upper_face_reaches_the_results_and_changes_nothing_else(home, tmp_path):
    split = again(home, tmp_path, "[wear]", "[wear]\nupper_share = 0.3", "wear")
    even, uneven = (read_record(complete_stages(run)["wear"] / "history.h5", WearHistory) for run in (home, split))
    assert (even.upper_share, uneven.upper_share) == (0.5, 0.3)
    assert np.array_equal(uneven.depth, even.depth)


def test_pictures_and_curves_are_there_and_render_draws_them_again(home, capsys):
    folder = complete_stages(home)["render"]
    names = {path.name for path in folder.iterdir()}
    assert {"pressure.png", "wear_depth.png", "loops.csv", "response.csv", "modes.csv", "wear_volume.csv"} <= names
    assert cli.execute(["render", str(home)]) == 0
    assert {path.name for path in (home / "pictures").iterdir()} == names - {"manifest.json"}
    assert str(home / "pictures" / "pressure.png") in capsys.readouterr().out
    drawn = RunResults.of(home).render(["loops"], ["svg", "pdf"])
    assert [path.name for path in drawn] == ["loops.svg", "loops.pdf", "loops.csv"]


def test_pictures_of_every_format_are_listed(home, tmp_path, capsys):
    asked = '[output]\nfigures = ["loops", "period"]\nfigure_formats = ["svg"]'
    own = again(home, tmp_path, "[output]", asked, "render")
    said = capsys.readouterr().out
    assert all(str(complete_stages(own)["render"] / name) in said for name in ("loops.svg", "period.gif"))


def test_a_second_call_computes_nothing_and_modes_reuses_the_meshes(home, capsys):
    assert cli.execute(["run", str(QUICK), "--out", str(home.parent)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if re.match(r"\w+ +\S+ +/", line)]
    assert len(lines) == 7
    assert all(" reused " in line for line in lines)
    assert cli.execute(["modes", str(QUICK), "--out", str(home.parent)]) == 0
    said = capsys.readouterr().out
    assert "Craig-Bampton" in said
    assert re.search(r" \d{3},\d{3}\.\d\d ", said)  # large numbers as elsewhere
    assert (home / "modes.csv").is_file()
    assert (home / "modes.png").is_file()
