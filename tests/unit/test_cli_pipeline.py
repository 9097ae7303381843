"""The composed pipeline and the figures that it ends with.

What carries the weight: each stage's hash covers what its result depends on and nothing that it does not, which the
names of the stages' folders show.
"""

import json
import os
import shutil
from pathlib import Path

import pytest
from fretflow import cli
from fretflow.case.config import load_case
from fretflow.core.errors import InputError, MeshError, StoreError
from fretflow.pipeline import estimate
from fretflow.pipeline import stages as pipeline_stages
from fretflow.pipeline.ranks import Ranks
from fretflow.pipeline.runner import Runner
from fretflow.pipeline.stage import Manifest, StageContext, sum_of, sums_of

EXAMPLES = Path(__file__).parents[2] / "examples"
QUICK = EXAMPLES / "quick.toml"
STAGES = ["mesh", "reduce", "preload", "solve", "wear", "response", "render"]


def keys_of(path):
    return Runner(pipeline_stages.pipeline(), Path("unused"), Ranks(), None).keys(load_case(path))


def changed(tmp_path, old, new):
    """Return the stages whose hash differs after `old` in the quick example became `new`."""
    text = QUICK.read_text()
    assert old in text
    path = tmp_path / "case.toml"
    path.write_text(text.replace(old, new))
    before, after = keys_of(QUICK), keys_of(path)
    return [stage for stage in STAGES if before[stage] != after[stage]]


def test_the_stages_stand_in_an_order_that_their_needs_allow():
    names = [stage.name for stage in pipeline_stages.pipeline()]
    assert names == STAGES
    for index, stage in enumerate(pipeline_stages.pipeline()):
        assert set(stage.needs) <= set(names[:index])
    assert [stage.name for stage in pipeline_stages.pipeline() if stage.collective] == ["reduce"]


@pytest.mark.parametrize(("old", "new", "first"), [
    ("contact_elements = 4", "contact_elements = 5", "mesh"),
    ("[mesh]", "[specimen]\nyoungs_modulus = '200 GPa'\n[mesh]", "reduce"),
    ("[mesh]", "[reduction]\nfixed_interface_modes = 8\n[mesh]", "reduce"),
    ("cycles = 20_000", "cycles = 20_001", "wear"),
    ("1.1e-14", "1.2e-14", "wear"),
    ("loop_cycles = [10_000]", "loop_cycles = [9_000]", "wear"),
    ("points = ", "points = 1", "response"),
])
def test_a_change_reaches_the_stage_that_it_concerns_and_all_behind_it(tmp_path, old, new, first):
    expected = STAGES[STAGES.index(first):]
    if first == "wear":
        expected = ["wear", "response", "render"]
    assert changed(tmp_path, old, new) == expected


@pytest.mark.parametrize(("old", "new"), [
    ('excitation_amplitude = "75 N"', 'excitation_amplitude = "76 N"'), ("samples = 64", "samples = 128"),
    ("[mesh]", "[contact]\nfriction_coefficient = 0.8\n[mesh]"), ("[mesh]", "[rig]\narm_mass = '1 kg'\n[mesh]")])
def test_what_concerns_the_period_leaves_the_preload_alone(tmp_path, old, new):
    assert changed(tmp_path, old, new) == ["solve", "wear", "response", "render"]


def test_the_load_concerns_the_preload_and_the_period(tmp_path):
    assert changed(tmp_path, '"60 N"', '"61 N"') == STAGES[2:]


def test_names_and_titles_concern_no_result(tmp_path):
    assert changed(tmp_path, 'title = "A first look, coarse and short"', 'title = "Another"') == []


def test_own_meshes_count_by_their_content(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(QUICK.read_text().replace("[mesh]", '[mesh]\nupper = "u.msh"\nlower = "l.msh"'))
    for name in ("u.msh", "l.msh"):
        (tmp_path / name).write_text("first")
    before = keys_of(path)
    assert keys_of(path) == before
    (tmp_path / "l.msh").write_text("second")
    assert keys_of(path)["mesh"] != before["mesh"]


@pytest.mark.parametrize("name", ["quick", "test1", "test2", "test3", "test4", "test5"])
def test_every_example_is_valid_and_bears_its_file_s_name(name):
    assert load_case(EXAMPLES / f"{name}.toml").name == name


def test_the_five_tests_are_the_paper_s():
    tests = [load_case(EXAMPLES / f"test{k}.toml") for k in range(1, 6)]
    assert [t.test.excitation_amplitude for t in tests] == [53.0, 53.0, 75.0, 75.0, 75.0]
    hours = [t.test.total_cycles / (3600 * 100) for t in tests]
    assert hours == pytest.approx([5.28, 5.5, 0.6, 3.6, 9.0], abs=0.01)  # test 1 ends at the paper's last map
    for t in tests:
        assert (t.test.normal_load, t.contact.friction_coefficient, t.wear.coefficient) == (60.0, 0.88, 1.1e-14)
        assert (t.mesh.contact_elements + 1) ** 2 == 121


@pytest.mark.parametrize("side", ["upper", "lower"])
def test_the_mesh_stage_reports_the_quality_of_both_meshes(tmp_path, side):
    path = tmp_path / "case.toml"
    path.write_text(QUICK.read_text().replace("[mesh]", f"[specimen.{side}]\nbody = 'round'\n[mesh]"))
    figures = pipeline_stages.MESH.run(StageContext(load_case(path), tmp_path, {}, lambda share, text: None))
    quality = {name: figures[f"{name}_min_scaled_jacobian"] for name in ("upper", "lower")}
    assert 0.7 < quality.pop(side) < 0.9  # of the angles outside of the core's corners, halved from 270 degrees
    assert next(iter(quality.values())) == pytest.approx(1.0, abs=1e-9)  # bricks
    assert figures["contact_nodes"] == 25


def test_a_picture_that_there_is_not_is_refused_before_anything_is_made(tmp_path, capsys):
    """It was after all else had been computed."""
    path = tmp_path / "case.toml"
    path.write_text((EXAMPLES / "quick.toml").read_text().replace("[output]", '[output]\nfigures = ["lops"]'))
    assert cli.execute(["run", str(path), "--until", "mesh", "--out", str(tmp_path / "runs")]) == 2
    assert "output.figures: 'lops' is none of" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_mesh_that_is_made_alone_needs_no_memory_for_what_would_follow(tmp_path, monkeypatch):
    monkeypatch.setattr(estimate, "free_memory", lambda: 1e5)
    pipeline_stages.MESH.run(StageContext(load_case(QUICK), tmp_path, {}, lambda share, text: None))
    own = tmp_path / "own.toml"
    own.write_text(QUICK.read_text().replace("[mesh]", "[mesh]\nupper = 'upper.msh'\nlower = 'lower.msh'"))
    with pytest.raises(InputError, match="nodes on each contact face = 25: needs"):
        pipeline_stages.MESH.run(StageContext(load_case(own), tmp_path, {}, lambda share, text: None))


def test_a_full_disk_is_named_where_gmsh_only_fails_to_read_back(tmp_path, monkeypatch):
    import fretflow_meshes

    def fail(case, folder):
        raise MeshError("upper.msh: could not read nodes")

    monkeypatch.setattr(fretflow_meshes, "run_mesh", fail)
    context = StageContext(load_case(QUICK), tmp_path, {}, lambda share, text: None)
    with pytest.raises(MeshError, match="could not read nodes"):
        pipeline_stages.MESH.run(context)
    usage = type("Usage", (), {"free": 0})
    monkeypatch.setattr(pipeline_stages.shutil, "disk_usage", lambda path: usage)
    with pytest.raises(StoreError, match="the disk is full"):
        pipeline_stages.MESH.run(context)


def test_a_folder_without_a_run_or_with_a_truncated_result_is_refused(tmp_path):
    (tmp_path / "beam").mkdir()
    (tmp_path / "beam" / "backbone.csv").write_text("")
    with pytest.raises(StoreError, match=r"beam: is of a bolted structure, whose curves are backbone\.csv"):
        pipeline_stages.complete_stages(tmp_path / "beam")
    with pytest.raises(StoreError, match=r"holds no run \(run\.json"):
        pipeline_stages.complete_stages(tmp_path)
    stage = tmp_path / "mesh-1"
    stage.mkdir()
    (tmp_path / "run.json").write_text(json.dumps({"case": "x", "stages": {"mesh": "mesh-1"}}))
    with pytest.raises(StoreError, match=r"manifest\.json: missing or damaged"):
        pipeline_stages.complete_stages(tmp_path)
    os.truncate(tmp_path / "run.json", 5)
    with pytest.raises(StoreError, match="holds no run"):
        pipeline_stages.complete_stages(tmp_path)


def made(home, name, text, inputs=()):
    """Make the folder of a complete stage `name` in `home`; return its manifest."""
    folder = home / f"{name}-1"
    folder.mkdir(parents=True)
    (folder / f"{name}.txt").write_text(text)
    sizes, sums = sums_of(folder)
    manifest = Manifest(name, 1, folder.name, {i.stage: i.folder for i in inputs}, {}, {}, None, 1, 0.0, 0, False, "",
                        sizes, sums, {i.stage: i.sum for i in inputs})
    manifest.write(folder)
    return manifest


def test_a_stage_or_case_of_another_run_beside_the_others_is_refused(tmp_path):
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    for home, text in ((ours, "one"), (theirs, "two")):
        made(home, "solve", text, [made(home, "mesh", text)])
        (home / "case.toml").write_text(text)
        stages = {"mesh": "mesh-1", "solve": "solve-1"}
        run = {"case": "x", "case_sum": sum_of(home / "case.toml"), "stages": stages}
        (home / "run.json").write_text(json.dumps(run))
    assert list(pipeline_stages.complete_stages(ours)) == ["mesh", "solve"]
    (ours / "case.toml").write_text("two")
    with pytest.raises(StoreError, match=r"case\.toml: changed since the run"):
        pipeline_stages.complete_stages(ours)
    (ours / "case.toml").write_text("one")
    shutil.rmtree(ours / "mesh-1")
    shutil.copytree(theirs / "mesh-1", ours / "mesh-1")
    with pytest.raises(StoreError, match=r"solve-1: was made from other results of the stage mesh"):
        pipeline_stages.complete_stages(ours)
