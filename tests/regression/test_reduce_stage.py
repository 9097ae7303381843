"""Both specimens reduced at once, with the bits of one after the other; one alone where both are alike."""

import multiprocessing
import os
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import load_case
from fretflow.core.errors import InputError, MeshError
from fretflow.core.store import read_record
from fretflow.pipeline import estimate, stages
from fretflow.pipeline.ranks import SIZE_VARIABLES
from fretflow.pipeline.stage import StageContext
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen

pytestmark = pytest.mark.fem

QUICK = Path(__file__).parents[2] / "examples" / "quick.toml"


@pytest.fixture(scope="module")
def meshed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mesh")
    case = load_case(QUICK)
    softer = case.specimen.lower.model_copy(update={"youngs_modulus": 0.9 * case.specimen.lower.youngs_modulus})
    case = case.model_copy(update={"specimen": case.specimen.model_copy(update={"lower": softer})})
    stages.MESH.run(StageContext(case, folder, {}, lambda share, text: None))
    return case, folder


@pytest.fixture(autouse=True)
def worth(monkeypatch):
    """Call the smallest specimen worth a process, on a machine of two cores whose user limits no threads."""
    monkeypatch.setattr(stages, "WORTH_A_PROCESS", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})


def context(meshed, folder):
    folder.mkdir(exist_ok=True)
    return StageContext(meshed[0], folder, {"mesh": meshed[1]}, lambda share, text: None)


def test_two_processes_give_the_bits_of_one(meshed, tmp_path, monkeypatch):
    both, alone = (context(meshed, tmp_path / name) for name in ("both", "alone"))
    assert stages._at_once(both) == 2
    figures = stages.REDUCE.run(both)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert stages._at_once(alone) == 1
    assert stages.REDUCE.run(alone) == figures
    for side in stages.SIDES:
        for name, kind in ((f"{side}.h5", ReducedSpecimen), (f"{side}_modes.h5", ModeShapes)):
            one, other = (read_record(where.folder / name, kind) for where in (both, alone))
            for field in fields(kind):
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


def test_one_after_the_other_where_there_is_no_room_for_both(meshed, tmp_path, monkeypatch):
    asked = context(meshed, tmp_path)
    one = estimate.REDUCING[0] * 1.5
    monkeypatch.setattr(estimate, "free_memory", lambda: one)
    assert stages._at_once(asked) == 1
    monkeypatch.setattr(estimate, "free_memory", lambda: 0.5 * one)
    with pytest.raises(InputError, match="mesh: DOF of a specimen = "):
        stages.REDUCE.run(asked)
    monkeypatch.setattr(estimate, "free_memory", lambda: 2.0 * one)
    assert stages._at_once(asked) == 2
    monkeypatch.setattr(stages, "WORTH_A_PROCESS", 10**9)
    assert stages._at_once(asked) == 1


def test_one_after_the_other_beside_other_processes(meshed, tmp_path, monkeypatch):
    """A worker, or a rank of mpirun, leaves the other cores to those that it shares the work with."""
    asked = context(meshed, tmp_path)
    with monkeypatch.context() as worker:
        worker.setattr(multiprocessing, "parent_process", multiprocessing.current_process)
        assert stages._at_once(asked) == 1
    monkeypatch.setenv(SIZE_VARIABLES[0], "2")
    assert stages._at_once(asked) == 1


def test_a_specimen_like_the_other_is_this_one_turned_over(meshed, tmp_path, monkeypatch):
    """What another factorisation gives of the other's own mesh is the same but for round-off and the modes' signs."""
    case = load_case(QUICK)
    turned, own = (context((case, meshed[1]), tmp_path / name) for name in ("turned", "own"))
    assert stages._reduced_sides(meshed[0]) == stages.SIDES
    assert stages._reduced_sides(case) == ("upper",)
    figures = stages.REDUCE.run(turned)
    monkeypatch.setattr(stages, "_reduced_sides", lambda case: stages.SIDES)
    assert stages.REDUCE.run(own).keys() == figures.keys()
    one, other = (read_record(where.folder / "lower.h5", ReducedSpecimen) for where in (turned, own))
    for name in ("contact_nodes", "contact_areas", "profile", "observation_point", "full_frequencies"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-12, abs=1e-15)
    for name in ("stiffness", "mass"):
        matrix, known = getattr(one, name), getattr(other, name)
        size = np.sqrt(np.outer(np.diag(known), np.diag(known)))
        boundary = slice(0, one.modal.start)
        assert np.abs(matrix - known)[boundary, boundary].max() < 1e-10 * size[boundary, boundary].max()
        assert (np.abs(np.abs(matrix) - np.abs(known)) / size).max() < 1e-9
    shapes, modes = (read_record(where.folder / "lower_modes.h5", ModeShapes) for where in (turned, own))
    assert np.array_equal(shapes.points, modes.points)
    assert np.abs(np.abs(shapes.shape) - np.abs(modes.shape)).max() < 1e-9 * np.abs(modes.shape).max()
    with pytest.raises(MeshError, match="are not those of the other turned over"):
        one.turned_over(1.01 * one.contact_nodes)
