"""A wear run killed at any moment goes on to the same numbers.

What carries the weight: after SIGKILL at several moments the resumed history equals the uninterrupted one bit
for bit, and the steps that were complete are not computed again.
"""

import os
import signal
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.store import read_record
from fretflow.pipeline.stage import Manifest
from fretflow.wear.history import WearHistory

SCRIPT = Path(__file__).with_name("wear_run.py")


def start(out):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, SCRIPT, out], stdout=subprocess.PIPE, text=True, env=environment)


def finish(process):
    """Return the lines of a run that ends by itself."""
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return output.splitlines()


def history_of(lines):
    folder = Path(lines[-1].removeprefix("end "))
    return read_record(folder / "history.h5", WearHistory), Manifest.read(folder)


def kill_after(process, steps, delay):
    """Read `steps` step reports, wait `delay` seconds and kill the process."""
    seen = []
    for line in process.stdout:
        seen.append(line.strip())
        if len(seen) > steps:
            break
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL, "the run ended before it was killed: kill it earlier"
    return seen


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    return finish(start(tmp_path_factory.mktemp("whole")))


def test_killed_again_and_again_it_reaches_the_same_numbers(tmp_path, uninterrupted):
    expected, manifest = history_of(uninterrupted)
    assert not manifest.resumed
    assert len(expected.cycles) > 20
    kill_after(start(tmp_path), 0, 0.0)  # before the first period
    for steps, delay in ((1, 0.0), (3, 0.013), (6, 0.05), (9, 0.002)):
        kill_after(start(tmp_path), steps, delay)
    lines = finish(start(tmp_path))
    history, manifest = history_of(lines)
    for f in fields(WearHistory):
        np.testing.assert_array_equal(getattr(history, f.name), getattr(expected, f.name), err_msg=f.name)
    assert manifest.resumed
    # four kills after 1 + 3 + 6 + 9 reported steps: the last part has at most the rest to do
    assert len(lines) - 2 <= len(expected.cycles) - 1 - 19


def test_a_complete_run_is_not_computed_again(tmp_path, uninterrupted):
    folder = Path(uninterrupted[-1].removeprefix("end "))
    lines = finish(start(folder.parents[1]))
    assert lines == [uninterrupted[-1]]


def test_a_truncated_checkpoint_is_refused_by_name(tmp_path):
    kill_after(start(tmp_path), 4, 0.0)
    newest = sorted(tmp_path.rglob("state-*.h5"))[-1]
    os.truncate(newest, newest.stat().st_size // 2)
    process = subprocess.run([sys.executable, SCRIPT, tmp_path], capture_output=True, text=True, timeout=60)
    assert process.returncode != 0
    assert f"{newest}: truncated or damaged" in process.stderr
