"""A run killed at ten random moments, each resumed to its end.

What carries the weight: every resumed run ends with the numbers of the unbroken one, bit for bit, wherever SIGKILL
met it: before the first stage, between stages, in the middle of a wear step or of a file.
"""

import multiprocessing
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.store import read_record
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory

KILLS = 10
SEED = 20210
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def processes():
    """Return a way to start `kill_run.run` in a process that has its modules already and no threads."""
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.syspath_prepend(HERE)
    import kill_run

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["kill_run", "psutil"])
    yield lambda out: context.Process(target=kill_run.run, args=(out,))
    monkeypatch.undo()


def finish(process):
    """Run `process` to its end and return the seconds that it took."""
    start = time.perf_counter()
    process.start()
    process.join(timeout=60)
    assert process.exitcode == 0
    return time.perf_counter() - start


def results(out):
    """Return every number that a complete run leaves."""
    [solution], [history] = (list(out.glob(f"kill/{name}")) for name in ("solve-*/solution.h5", "wear-*/history.h5"))
    records = read_record(solution, PeriodicSolution), read_record(history, WearHistory)
    values = {f"{type(r).__name__}.{f.name}": getattr(r, f.name) for r in records for f in fields(r)}
    nested = {f"{name}.{key}": value for name, held in values.items() if isinstance(held, Mapping)
              for key, value in held.items()}
    return {name: held for name, held in values.items() if not isinstance(held, Mapping)} | nested


def jumps(out):
    return len(list(out.glob("kill/wear-*/checkpoints/jump-*.h5")))


def kill(process, out, wanted, delay):
    """Start `process`, kill it `delay` seconds after `wanted` jumps are on disk; return whether it was at work."""
    process.start()
    while process.is_alive() and jumps(out) < wanted:
        process.join(timeout=0.002)
    process.join(timeout=delay)
    process.kill()
    process.join()
    return process.exitcode != 0


def test_ten_random_kills_change_no_bit(processes, tmp_path):
    whole = tmp_path / "whole"
    finish(processes(tmp_path / "warm"))
    duration = finish(processes(whole))
    expected = results(whole)
    assert len(expected["WearHistory.cycles"]) > 12

    moments, kept_jumps, made = np.random.default_rng(SEED), [], len(expected["WearHistory.cycles"])
    for attempt in range(4 * KILLS):
        out = tmp_path / f"run{attempt}"
        # whole jumps say where, so that a busy machine does not move it; the rest of a jump is left to chance
        if kill(processes(out), out, int(moments.integers(0, made)), moments.uniform(0.0, duration / made)):
            kept_jumps.append(jumps(out))
            finish(processes(out))
            for name, value in results(out).items():
                np.testing.assert_array_equal(value, expected[name], err_msg=name)
        if len(kept_jumps) == KILLS:
            break
    assert len(kept_jumps) == KILLS
    assert len(set(kept_jumps)) >= 4, f"the kills met too few different moments: {kept_jumps} jumps were on disk"
