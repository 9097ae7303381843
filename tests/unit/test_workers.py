"""Processes that work for others: they know users' effects, and neither outlive who started them nor talk when stopped.

What carries the weight: real processes, killed and interrupted from outside as a terminal or a batch system does it.
"""

import operator
import os
import signal
import subprocess
import sys
import time

import fretflow as ff
import pytest
from fretflow.core.isolated import call_isolated
from fretflow.effects.catalogue import import_own
from fretflow.pipeline.ensemble import LocalPool

PATIENCE = 60.0  # s
OWN = "examples/own_effects"
# A command whose two workers tell their ids, then work for longer than anybody waits.
LASTING = """
import operator, os, sys, time
from fretflow.cli import app, main
from fretflow.pipeline.ensemble import LocalPool

def wait():
    with LocalPool(2) as pool:
        workers = set()
        while len(workers) < 2:
            workers |= set(pool(operator.call, [os.getpid] * 8))
        print(*workers, flush=True)
        pool(time.sleep, [600.0] * 2)

if __name__ == "__main__":
    app.command(wait)
    sys.argv[1:] = ["wait"]
    main()
"""


@pytest.fixture
def own(monkeypatch, request):
    """Return an effect of a user's own."""
    monkeypatch.setenv("FRETFLOW_EFFECTS", "")
    return ff.add_effects(request.config.rootpath / OWN)["friction-bump"](height=0.25)


def test_users_effects_travel_to_workers_and_back(own):
    with LocalPool(2) as pool:
        assert pool(operator.attrgetter("height"), [own, own]) == [0.25, 0.25]
        assert pool(operator.methodcaller("model_copy"), [own, own]) == [own, own]
    assert call_isolated(operator.methodcaller("model_copy"), own, before=import_own) == own


PLAIN = """
import operator, os
from fretflow.pipeline.ensemble import LocalPool
print("runs")
with LocalPool(2) as pool:
    assert os.getpid() not in pool(operator.call, [os.getpid] * 4)
"""


def test_a_plain_script_runs_once(tmp_path):
    """Without ``if __name__ == "__main__":``, as a newcomer writes it; its workers do not run it again."""
    (tmp_path / "plain.py").write_text(PLAIN)
    done = subprocess.run([sys.executable, tmp_path / "plain.py"], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.stdout, done.returncode) == ("runs\n", 0), done.stderr


@pytest.fixture
def lasting(tmp_path):
    """Return a process in a group of its own, as a terminal starts it, and the ids of its workers."""
    script = tmp_path / "lasting.py"
    script.write_text(LASTING)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          start_new_session=True) as process:
        try:
            workers = [int(text) for text in process.stdout.readline().split()]
            assert len(workers) == 2
            time.sleep(0.2)  # until both are at work
            yield process, workers
        finally:
            process.kill()


def have_ended(workers):
    """Return whether all workers end in time."""
    deadline = time.monotonic() + PATIENCE
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not any(map(alive, workers))


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


DYING = """
import os
from fretflow.core.errors import PlatformError
from fretflow.pipeline.ensemble import LocalPool

class Deadly(bytes):
    def __reduce__(self):
        return os.abort, ()

with LocalPool(2) as pool:
    try:
        pool(len, [bytes(2**20)] * 4 + [[Deadly(), bytes(2**20)]] * 4 + [bytes(2**20)] * 8)
    except PlatformError as error:
        print(error)
"""


def test_large_calls_that_nobody_reads_any_more_do_not_wait_for_ever(tmp_path):
    """A worker that died while the next call filled its pipe left the diagnosis standing, without a word."""
    (tmp_path / "dying.py").write_text(DYING)
    done = subprocess.run([sys.executable, tmp_path / "dying.py"], capture_output=True, text=True, timeout=PATIENCE)
    assert done.stdout.startswith("a process died"), done.stderr


def test_workers_end_with_who_started_them(lasting):
    process, workers = lasting
    process.kill()
    assert have_ended(workers)


@pytest.mark.parametrize("whom", [os.killpg, os.kill], ids=["terminal", "this process alone"])
def test_an_interruption_is_one_line_and_ends_the_workers(lasting, whom):
    process, workers = lasting
    whom(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=PATIENCE)
    assert error == "fretflow: interrupted; the same command goes on from what is complete\n"
    assert process.returncode == 130
    assert have_ended(workers)


SWALLOWING = """
import sys, time
from fretflow.cli import app, main

def wait():
    try:
        print("here", flush=True)
        time.sleep(600.0)
    except KeyboardInterrupt as error:
        {answer}
    time.sleep(600.0)

if __name__ == "__main__":
    app.command(wait)
    sys.argv[1:] = ["wait"]
    main()
"""


@pytest.mark.parametrize("answer", ["pass", "raise SystemError('returned a result with an exception set') from error"])
def test_an_interruption_is_not_lost_in_a_library(answer, tmp_path):
    script = tmp_path / "swallowing.py"
    script.write_text(SWALLOWING.format(answer=answer))
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        try:
            _, error = process.communicate(timeout=10)
        finally:
            process.kill()
    assert error == "fretflow: interrupted; the same command goes on from what is complete\n"
    assert process.returncode == 130


READ_LATE = """
import signal, sys
from importlib.abc import MetaPathFinder

class Finder(MetaPathFinder):  # the key is pressed while the first library is being read
    def find_spec(self, name, path, target=None):
        if name == "cyclopts":
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Finder())
from fretflow.cli import main
main()
"""


def test_an_interruption_before_the_command_has_begun_is_one_line():
    done = subprocess.run([sys.executable, "-c", READ_LATE], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.stderr, done.returncode) == ("fretflow: interrupted\n", 130)
