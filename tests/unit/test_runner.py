"""The runner's promises, on stages of a few lines.

What carries the weight: a stage is computed again exactly when something that it depends on has changed, a
folder under its final name is always whole, and whatever goes wrong keeps what was complete.
"""

import hashlib
import json
import os
import shutil

import pytest
from fretflow.case.config import Solver, validate_case
from fretflow.core.errors import InputError, NonConvergenceError, StoreError
from fretflow.pipeline.ranks import Ranks
from fretflow.pipeline.runner import Runner
from fretflow.pipeline.stage import Manifest, Stage


class Silent:
    def begin(self, stage):
        pass

    def advance(self, stage, share, text):
        pass

    def end(self, result):
        pass

    def note(self, stage, text):
        self.notes = [*getattr(self, "notes", []), text]


class Pipeline:
    """Three stages in a chain, each of which counts its calls and writes what it read."""

    def __init__(self, root):
        self.root = root
        self.calls = []
        self.failing = {}
        self.stages = [self.stage("mesh", (), lambda case: case.mesh.degree),
                       self.stage("solve", ("mesh",), lambda case: case.contact.friction_coefficient),
                       self.stage("wear", ("solve",), lambda case: case.test.total_cycles)]

    def stage(self, name, needs, config_slice, version=1):
        def run(context):
            self.calls.append(name)
            read = [(context.inputs[need] / f"{need}.txt").read_text() for need in needs]
            (context.folder / f"{name}.txt").write_text(f"{config_slice(context.case)} {read}")
            if name in self.failing:
                raise self.failing[name]
            return {"residual": 1e-12}

        return Stage(name, version, config_slice, needs, run)

    def run(self, case, **options):
        self.calls.clear()
        watcher = Silent()
        try:
            return Runner(self.stages, self.root, Ranks(), watcher).run(case, **options)
        finally:
            self.notes = getattr(watcher, "notes", [])


def a_case(mu=0.88, cycles=10, degree=1):
    return validate_case({"format": "fretflow-case/1", "name": "small", "mesh": {"degree": degree},
                          "contact": {"friction_coefficient": mu},
                          "test": {"excitation_amplitude": "53 N", "cycles": cycles}})


@pytest.fixture
def pipeline(tmp_path):
    return Pipeline(tmp_path)


def test_only_what_depends_on_a_change_is_computed_again(pipeline):
    first = pipeline.run(a_case())
    assert pipeline.calls == ["mesh", "solve", "wear"]
    assert all(result.reused for result in pipeline.run(a_case()).values())
    assert pipeline.calls == []
    other = pipeline.run(a_case(mu=0.5))
    assert pipeline.calls == ["solve", "wear"]
    assert other["mesh"].folder == first["mesh"].folder
    assert other["wear"].folder != first["wear"].folder
    pipeline.run(a_case(cycles=20))
    assert pipeline.calls == ["wear"]
    pipeline.run(a_case())  # the first results are still there
    assert pipeline.calls == []


def test_a_new_schema_version_is_computed_again_with_what_depends_on_it(pipeline):
    pipeline.run(a_case())
    pipeline.stages[1] = pipeline.stage(
        "solve", ("mesh",), lambda case: case.contact.friction_coefficient, version=2
    )
    pipeline.run(a_case())
    assert pipeline.calls == ["solve", "wear"]


def test_force_computes_all_again_and_replaces_it(pipeline):
    first = pipeline.run(a_case())
    marker = first["mesh"].folder / "old"
    marker.touch()
    pipeline.run(a_case(), force=True)
    assert pipeline.calls == ["mesh", "solve", "wear"]
    assert not marker.exists()


def test_until_stops_there_and_keeps_what_is_known_of_later_stages(pipeline):
    pipeline.run(a_case())
    assert list(pipeline.run(a_case(), until="solve")) == ["mesh", "solve"]
    run = json.loads((pipeline.root / "small" / "run.json").read_text())
    assert set(run["stages"]) == {"mesh", "solve", "wear"}
    with pytest.raises(InputError, match="choose one of mesh, solve, wear"):
        pipeline.run(a_case(), until="polish")


def test_an_interrupted_stage_gets_its_checkpoints_back(pipeline):
    pipeline.failing["wear"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(a_case())
    [partial] = pipeline.root.glob("small/wear-*")
    assert partial.suffix == ".partial"
    (partial / "checkpoint").write_text("step 3")
    pipeline.failing.clear()
    result = pipeline.run(a_case())["wear"]
    assert pipeline.calls == ["wear"]
    assert (result.folder / "checkpoint").read_text() == "step 3"
    assert result.manifest.resumed
    assert not partial.exists()


def test_a_complete_stage_that_was_not_renamed_yet_is_computed_anew_from_its_files(pipeline):
    result = pipeline.run(a_case())["wear"]
    result.folder.rename(result.folder.with_name(result.folder.name + ".partial"))
    again = pipeline.run(a_case())["wear"]
    assert again.folder == result.folder
    assert not again.reused


def test_force_after_a_kill_between_its_two_renames_loses_nothing(pipeline):
    result = pipeline.run(a_case())["wear"]
    shutil.copytree(result.folder, result.folder.with_name(result.folder.name + ".partial"))
    result.folder.rename(result.folder.with_name(result.folder.name + ".replaced"))
    again = pipeline.run(a_case())["wear"]
    assert (again.folder / "wear.txt").read_text()
    assert not list(pipeline.root.glob("small/*.replaced"))


def test_non_convergence_keeps_its_history_and_names_the_last_good_state(pipeline):
    pipeline.failing["solve"] = NonConvergenceError("no step helps", history=[1.0, 0.25])
    with pytest.raises(NonConvergenceError) as caught:
        pipeline.run(a_case())
    assert caught.value.history_file.read_text().split() == ["iteration,relative_residual", "0,1.0", "1,0.25"]
    assert (caught.value.last_good / "solve.txt").is_file()
    assert pipeline.calls == ["mesh", "solve"]
    pipeline.failing.clear()
    result = pipeline.run(a_case())
    assert pipeline.calls == ["solve", "wear"]
    assert not (result["solve"].folder / caught.value.history_file.name).exists()


def test_without_a_history_none_is_claimed_and_the_stage_before_is_the_last_good_state(pipeline):
    mesh = pipeline.run(a_case(), until="mesh")["mesh"].folder

    def fails_at_once(context):
        raise NonConvergenceError("no first residual")

    pipeline.stages[1] = Stage("solve", 1, lambda case: case.contact.friction_coefficient, ("mesh",), fails_at_once)
    with pytest.raises(NonConvergenceError) as caught:
        pipeline.run(a_case())
    assert caught.value.history_file is None
    assert caught.value.last_good == mesh


def flip(file):
    """Change one bit in the middle of `file`."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


DAMAGE = {"truncate": lambda file: os.truncate(file, file.stat().st_size // 2), "remove": lambda file: file.unlink(),
          "flip": flip}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", ["solve.txt", "manifest.json"])
def test_a_damaged_result_is_refused_by_name_and_computed_again(pipeline, damage, name):
    folder = pipeline.run(a_case())["solve"].folder
    whole = (folder / "solve.txt").read_bytes()
    DAMAGE[damage](folder / name)
    with pytest.raises(StoreError, match=rf"{name}: .*run again".replace(".", r"\.", 1)):
        Manifest.read(folder)
    pipeline.run(a_case())
    assert pipeline.calls == ["solve"]  # which gives the same, so that wear stands
    [line] = pipeline.notes
    assert name in line
    assert "computed again" in line
    assert (folder / "solve.txt").read_bytes() == whole
    Manifest.read(folder)


@pytest.mark.parametrize("content", ["[]", "5", '{"files": []}', None])
def test_a_manifest_of_other_kinds_is_damaged(pipeline, content):
    manifest = pipeline.run(a_case())["solve"].folder / "manifest.json"
    manifest.write_text(content or json.dumps({**json.loads(manifest.read_text()), "files": []}))
    with pytest.raises(StoreError, match=r"manifest\.json: (missing or )?damaged.*; run again"):
        Manifest.read(manifest.parent)
    pipeline.run(a_case())
    assert pipeline.calls == ["solve"]


def test_results_of_another_run_in_a_stage_s_folder_are_not_used(pipeline):
    other = pipeline.run(a_case(mu=0.5))["solve"].folder
    folder = pipeline.run(a_case())["solve"].folder
    whole = (folder / "solve.txt").read_bytes()
    shutil.rmtree(folder)
    shutil.copytree(other, folder)
    pipeline.run(a_case())
    assert pipeline.calls == ["solve"]
    assert f"holds the results of {other.name}" in pipeline.notes[0]
    assert (folder / "solve.txt").read_bytes() == whole


def test_a_file_of_another_run_is_not_used(pipeline):
    other = pipeline.run(a_case(mu=0.55))["solve"].folder
    folder = pipeline.run(a_case(mu=0.66))["solve"].folder
    shutil.copy(other / "solve.txt", folder / "solve.txt")  # as long as the one that it replaces
    pipeline.run(a_case(mu=0.66))
    assert pipeline.calls == ["solve"]


def test_what_was_made_from_results_that_are_others_now_is_computed_again(pipeline):
    """As after an update of a library that meshes or solves a little otherwise."""
    pipeline.run(a_case())
    mesh, solve = pipeline.stages[:2]

    def otherwise(context):
        figures = mesh.run(context)
        (context.folder / "mesh.txt").write_text("another mesh")
        return figures

    pipeline.stages[0] = Stage(mesh.name, mesh.version, mesh.config_slice, mesh.needs, otherwise)
    flip(next(pipeline.root.glob("small/mesh-*/mesh.txt")))
    results = pipeline.run(a_case())
    assert pipeline.calls == ["mesh", "solve", "wear"]
    assert "other results of the stage mesh" in pipeline.notes[1]
    assert "another mesh" in (results["solve"].folder / "solve.txt").read_text()
    assert solve.name == "solve"


def test_results_without_sums_are_computed_again(pipeline):
    """Those of a version that knew sizes only."""
    path = pipeline.run(a_case())["solve"].folder / "manifest.json"
    content = json.loads(path.read_text())
    for key in ("sums", "input_sums", "manifest_sum"):
        del content[key]
    path.write_text(json.dumps(content))
    pipeline.run(a_case())
    assert pipeline.calls == ["solve"]
    assert "without SHA-256 sums" in pipeline.notes[0]


def test_a_summary_of_another_case_does_not_outlive_a_run_that_fails(pipeline):
    from fretflow.pipeline.summary import write_summary

    home = pipeline.root / "small"
    pipeline.run(a_case())
    summary = write_summary(home, a_case(), {})
    pipeline.failing["wear"] = NonConvergenceError("no")
    with pytest.raises(NonConvergenceError):
        pipeline.run(a_case(), force=True)
    assert summary.exists()  # of the same case
    with pytest.raises(NonConvergenceError):
        pipeline.run(a_case(mu=0.3))
    assert not summary.exists()


def test_the_manifest_says_what_was_used_and_what_it_cost(pipeline):
    results = pipeline.run(a_case())
    manifest = Manifest.read(results["wear"].folder)
    assert manifest.figures == {"residual": 1e-12}
    assert manifest.inputs == {"solve": results["solve"].folder.name}
    assert {"fretflow", "python"} <= set(manifest.versions)
    assert manifest.ranks == 1
    assert manifest.seconds >= 0.0
    assert 1e6 < manifest.peak_memory < 1e11
    assert manifest.files == {"wear.txt": (results["wear"].folder / "wear.txt").stat().st_size}
    sums = {name: hashlib.sha256((results[name].folder / f"{name}.txt").read_bytes()).hexdigest()
            for name in ("wear", "solve")}
    assert manifest.sums == {"wear.txt": sums["wear"]}
    assert results["solve"].manifest.sums == {"solve.txt": sums["solve"]}
    assert manifest.input_sums == {"solve": results["solve"].manifest.sum}


def test_a_second_run_in_the_same_folder_is_told_so(pipeline):
    inner = []

    def run_again(context):
        with pytest.raises(InputError, match=rf"in use by another run \(process {os.getpid()}\)") as caught:
            Runner(pipeline.stages, pipeline.root, Ranks(), Silent()).run(a_case())
        inner.append(caught)
        return {}

    Runner([Stage("mesh", 1, lambda case: 0, (), run_again)], pipeline.root, Ranks(), Silent()).run(a_case())
    assert len(inner) == 1
    pipeline.run(a_case())  # the lock is free again


def test_a_full_disk_is_one_clear_error_and_complete_stages_stay(pipeline):
    pipeline.failing["solve"] = OSError(28, "No space left on device", "somewhere/solution.h5")
    with pytest.raises(
        StoreError, match=r"solution\.h5: cannot be written \(No space left on device\).*--out"
    ):
        pipeline.run(a_case())
    pipeline.failing.clear()
    pipeline.run(a_case())
    assert pipeline.calls == ["solve", "wear"]


def test_an_output_path_through_a_file_is_one_clear_error(pipeline, tmp_path):
    (tmp_path / "small").write_text("a file")
    with pytest.raises(StoreError, match="cannot be written"):
        pipeline.run(a_case())


@pytest.mark.parametrize("make", [os.symlink, os.link, lambda _, lock: os.mkfifo(lock), lambda _, lock: lock.mkdir()])
def test_a_lock_that_leads_elsewhere_is_refused_and_what_it_leads_to_stays(pipeline, tmp_path, make):
    """The lock once wrote its process number into whatever file a link named."""
    other = tmp_path / "other"
    other.write_text("precious")
    (tmp_path / "small").mkdir()
    make(other, tmp_path / "small" / ".lock")
    with pytest.raises(StoreError, match=r"\.lock: is .*no ordinary file; remove it"):
        pipeline.run(a_case())
    assert other.read_text() == "precious"
    assert pipeline.calls == []


def test_effects_that_the_solver_does_not_know_are_refused_before_the_mesh(tmp_path):
    """They were after minutes of meshing and reduction; one that it knows runs."""
    pipeline, case = Pipeline(tmp_path), a_case()

    def with_effect(**effect):
        return case.model_copy(update={"solver": Solver(method="dlft"), "effects": effect})

    with pytest.raises(InputError, match=r"method = .dlft. does not know friction that depends on the direction"):
        pipeline.run(with_effect(**{"directional-friction": {"difference": 0.1}}))
    assert not pipeline.calls
    pipeline.run(with_effect(**{"friction-run-in": {}}))
    assert pipeline.calls


def test_an_effect_that_does_nothing_in_the_rig_is_refused_before_the_mesh(tmp_path):
    """Its run was that of the baseline, and nothing said so."""
    pipeline = Pipeline(tmp_path)
    with pytest.raises(InputError, match=r"effects\.joint-damping: does nothing in a run of the rig"):
        pipeline.run(a_case().model_copy(update={"effects": {"joint-damping": {}}}))
    assert not pipeline.calls
