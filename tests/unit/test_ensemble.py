"""Many calls at once, on processes of this machine and on a real dask cluster.

What carries the weight: each call's own outcome arrives under its own index whatever happens to the others, errors
and dead processes included, and no worker takes more BLAS threads than its share of the cores.
"""

import json
import math
import operator
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fretflow import cli
from fretflow.core.errors import InputError, NonConvergenceError, PlatformError
from fretflow.pipeline.ensemble import THREAD_VARIABLES, Backend, LocalPool, Workers, run_ensemble, threads_each

HERE = Path(__file__).parent
QUICK = HERE.parents[1] / "examples" / "quick.toml"
PATIENCE = 60.0  # s


@pytest.fixture(autouse=True)
def calls(monkeypatch):
    """Return the module that the workers import too."""
    monkeypatch.syspath_prepend(HERE)
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    import ensemble_calls

    return ensemble_calls


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Return the address of a dask scheduler with one worker process of two threads."""
    if os.environ.get("CI", "").lower() in ("", "0", "false"):
        pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    options = {"cwd": folder, "stderr": subprocess.DEVNULL, "env": {**os.environ, "PYTHONPATH": str(HERE)}}
    command = [sys.executable, "-m", "dask"]
    ends = ["--scheduler-file", file, "--no-dashboard"]
    started = [
        subprocess.Popen([*command, "scheduler", *ends, "--host", "127.0.0.1", "--port", "0"], **options),
        subprocess.Popen([*command, "worker", *ends, "--nthreads", "2", "--local-directory", folder], **options)]
    try:
        deadline = time.monotonic() + PATIENCE
        while not (file.is_file() and file.read_text().strip()):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=PATIENCE)


@pytest.fixture(params=[Backend.LOCAL, Backend.DASK])
def workers(request):
    if request.param is Backend.LOCAL:
        return Workers(jobs=2)
    return Workers(Backend.DASK, address=request.getfixturevalue("scheduler"))


def outcomes(function, arguments, workers):
    """Return value or error of each call, in the order of the arguments."""
    by_index = {outcome.index: outcome for outcome in run_ensemble(function, arguments, workers)}
    assert sorted(by_index) == list(range(len(arguments)))
    return [by_index[k].value if by_index[k].error is None else by_index[k].error for k in range(len(arguments))]


def test_each_value_and_each_error_comes_back_in_its_place(workers):
    values = outcomes(math.sqrt, [4.0, -1.0, 9.0, "x"], workers)
    assert values[0] == 2.0
    assert isinstance(values[1], ValueError)
    assert values[2] == 3.0
    assert isinstance(values[3], TypeError)


def test_a_process_that_dies_harms_its_own_call_only(workers):
    values = outcomes(operator.call, [os.getpid, os.abort, os.getppid, os.getpid], workers)
    assert isinstance(values[1], PlatformError)
    assert "process" in str(values[1])
    others = [values[k] for k in (0, 2, 3)]
    assert all(isinstance(pid, int) for pid in others)
    assert os.getpid() not in (values[0], values[3])


def test_errors_keep_what_they_carry_and_stubborn_ones_their_words(workers, calls):
    [error] = outcomes(calls.raise_history, [[1.0, 0.25]], workers)
    assert isinstance(error, NonConvergenceError)
    assert error.history == (1.0, 0.25)
    [error] = outcomes(calls.raise_stubborn, ["left behind"], workers)
    assert isinstance(error, RuntimeError)
    assert str(error) == "Stubborn: left behind"


def test_noise_on_stdout_does_not_spoil_an_answer(workers, calls):
    assert outcomes(calls.chatter, ["well"], workers) == ["well"]


def test_an_error_ends_the_calls_under_way_and_leaves_the_rest_out(tmp_path):
    """The pool ends at once after it, with no error of its own: a cancelled call is none that died."""
    files = [tmp_path / f"{k}" for k in range(200)]
    with pytest.raises(FileNotFoundError), LocalPool(2) as pool:
        pool(Path.touch, [tmp_path / "no folder" / "file", *files])
    assert len(list(tmp_path.iterdir())) < 200


def test_processes_that_stay_return_values_in_order_and_errors_that_travel(calls):
    with LocalPool(2) as pool:
        seen = {pid for _ in range(4) for pid in pool(operator.call, [os.getpid] * 4)}
        assert len(seen) <= 2
        assert os.getpid() not in seen
        assert pool(math.sqrt, [9.0, 4.0, 1.0]) == [3.0, 2.0, 1.0]
        with pytest.raises(RuntimeError, match="Stubborn: left behind"):
            pool(calls.raise_stubborn, ["left behind", "left behind"])
        with pytest.raises(NonConvergenceError) as raised:
            pool(calls.raise_history, [[1.0, 0.25], [1.0]])
        assert raised.value.history == (1.0, 0.25)
        with pytest.raises(PlatformError, match="a process died"):
            pool(operator.call, [os.abort, os.abort])


def test_large_arrays_travel_once_and_none_is_taken_for_another(tmp_path, monkeypatch):
    """Arrays that have died leave their places in memory to others; a disk that takes nothing does no harm."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with LocalPool(2) as pool:
        for k in range(6):
            one, other = np.full((200, 300), float(k)), np.arange(60_000.0).reshape(200, 300).T
            assert pool(np.sum, [one, one, other, one]) == [60_000.0 * k, 60_000.0 * k, other.sum(), 60_000.0 * k]
            (folder,) = tmp_path.iterdir()
            assert len(list(folder.iterdir())) == 2
        with pytest.raises(ValueError, match="read-only"):
            one[0] = 7.0
        monkeypatch.setattr(np, "save", lambda path, array: os.open(tmp_path / "no" / "disk", os.O_RDONLY))
        full = np.full((200, 300), 0.5)
        assert pool(np.sum, [full, full]) == [30_000.0] * 2
    assert not list(tmp_path.iterdir())


def test_blas_gets_a_share_of_the_cores_and_the_user_may_ask_for_less(monkeypatch, calls):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(12)))
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    assert [threads_each(jobs) for jobs in (1, 3, 5, 12, 40)] == [12, 4, 2, 1, 1]
    assert outcomes(calls.blas_threads, THREAD_VARIABLES, Workers(jobs=2)) == ["6", "6"]
    assert not set(THREAD_VARIABLES) & set(os.environ)  # this process is as before
    monkeypatch.setenv(THREAD_VARIABLES[0], "12")  # as the command line sets it for a case by itself
    assert outcomes(calls.blas_threads, THREAD_VARIABLES, Workers(jobs=2)) == ["6", "6"]
    monkeypatch.setenv(THREAD_VARIABLES[0], "3")
    assert outcomes(calls.blas_threads, THREAD_VARIABLES, Workers(jobs=2)) == ["3", "3"]
    assert os.environ[THREAD_VARIABLES[0]] == "3"


@pytest.mark.parametrize(("executor", "jobs", "message"), [
    ("remote", 1, "choose local, mpi or dask=ADDRESS"), ("dask", 1, "dask=ADDRESS"), ("dask=", 1, "dask=ADDRESS"),
    ("local=x", 1, "choose local"), ("local", 0, "at least 1"), ("dask=tcp://h:1", 2, "leave it out"),
    ("mpi", 1, "mpirun -n")])
def test_an_executor_that_cannot_be_is_refused(executor, jobs, message):
    with pytest.raises(InputError, match=message):
        Workers.parse(executor, jobs)


def test_ranks_of_mpirun_are_not_mixed_with_other_workers(monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "3")
    assert Workers.parse("mpi", 1).place is Backend.MPI
    assert Workers.parse("local", 1).in_turn
    for executor, jobs in (("local", 2), ("dask=tcp://h:1", 1)):
        with pytest.raises(InputError, match="use --executor mpi"):
            Workers.parse(executor, jobs)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("fretflow.pipeline.ensemble.DASK_TIMEOUT", 0.5)
    with pytest.raises(InputError, match=r"dask=tcp://127\.0\.0\.1:9: no scheduler answers"):
        outcomes(math.sqrt, [4.0], Workers(Backend.DASK, address="tcp://127.0.0.1:9"))


def test_a_dask_worker_runs_a_real_case_into_the_user_s_folder(scheduler, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # the worker is in another one
    done = cli.execute(["run", str(QUICK), "--until", "mesh", "--executor", f"dask={scheduler}", "--out", "runs"])
    assert done == 0
    assert "1 of 1  quick  complete" in capsys.readouterr().out
    assert len(list(tmp_path.glob("runs/quick/mesh-*/*.msh"))) == 2
