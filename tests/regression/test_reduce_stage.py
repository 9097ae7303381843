"""Both specimens reduced at once: where there is room for it, with the bits of one after the other."""

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
from fretflow.pipeline.ranks import Ranks
from fretflow.pipeline.run import leading
from fretflow.pipeline.runner import Runner, Silent
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
    """Call the smallest specimen worth a process."""
    monkeypatch.setattr(stages, "WORTH_A_PROCESS", 1)


def context(meshed, folder, processes):
    folder.mkdir(exist_ok=True)
    return StageContext(meshed[0], folder, {"mesh": meshed[1]}, lambda share, text: None, processes=processes)


def test_two_processes_give_the_bits_of_one(meshed, tmp_path):
    both, alone = (context(meshed, tmp_path / name, count) for name, count in (("both", 2), ("alone", 1)))
    assert [stages._at_once(one) for one in (both, alone)] == [2, 1]
    figures = stages.REDUCE.run(both)
    assert stages.REDUCE.run(alone) == figures
    for side in stages.SIDES:
        for name, kind in ((f"{side}.h5", ReducedSpecimen), (f"{side}_modes.h5", ModeShapes)):
            one, other = (read_record(where.folder / name, kind) for where in (both, alone))
            for field in fields(kind):
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


def test_one_after_the_other_where_there_is_no_room_for_both(meshed, tmp_path, monkeypatch):
    asked = context(meshed, tmp_path, 4)
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


def test_the_command_line_shares_work_out_and_a_script_does_not(tmp_path, monkeypatch):
    """A script's main module may not be meant to be imported again, which fresh interpreters do."""
    asked = []
    stage = stages.Stage("mesh", 1, lambda case: 0, (), lambda context: asked.append(context.processes) or {})
    monkeypatch.setattr(stages, "pipeline", lambda: (stage,))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    for threads in ("2", "1"):
        for name in THREAD_VARIABLES:
            monkeypatch.setenv(name, threads)
        with leading(tmp_path / threads, Silent()) as runner:
            runner.run(load_case(QUICK))
    Runner((stage,), tmp_path / "script", Ranks(), Silent()).run(load_case(QUICK))
    assert asked == [2, 1, 1]
