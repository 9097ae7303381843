"""Both specimens reduced at once: where there is room for it, with the bits of one after the other."""

import multiprocessing
import os
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import load_case
from fretflow.core.errors import InputError
from fretflow.core.store import read_record
from fretflow.pipeline import estimate, stages
from fretflow.pipeline.ensemble import THREAD_VARIABLES
from fretflow.pipeline.ranks import SIZE_VARIABLES
from fretflow.pipeline.stage import StageContext
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen

pytestmark = pytest.mark.fem

QUICK = Path(__file__).parents[2] / "examples" / "quick.toml"


@pytest.fixture(scope="module")
def meshed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mesh")
    case = load_case(QUICK)
    stages.MESH.run(StageContext(case, folder, {}, lambda share, text: None))
    return case, folder


@pytest.fixture(autouse=True)
def worth(monkeypatch):
    """Call the smallest specimen worth a process, on a machine of two cores whose user limits no threads."""
    monkeypatch.setattr(stages, "WORTH_A_PROCESS", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    limit_threads(monkeypatch, "2")


def limit_threads(monkeypatch, count):
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, count)


def context(meshed, folder):
    folder.mkdir(exist_ok=True)
    return StageContext(meshed[0], folder, {"mesh": meshed[1]}, lambda share, text: None)


def test_two_processes_give_the_bits_of_one(meshed, tmp_path, monkeypatch):
    both, alone = (context(meshed, tmp_path / name) for name in ("both", "alone"))
    assert stages._at_once(both) == 2
    figures = stages.REDUCE.run(both)
    limit_threads(monkeypatch, "1")
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
