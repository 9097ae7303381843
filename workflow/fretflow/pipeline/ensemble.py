"""Many independent calls at once: parameter studies, several tests, fits, through one `concurrent.futures` executor.

Three executors do the same: processes on this machine, the ranks that mpirun started (mpi4py.futures), or the
workers of a dask cluster. An error of one call leaves the others alone. No worker's BLAS takes more than its share
of the cores.
"""

from __future__ import annotations

import copyreg
import functools
import multiprocessing
import os
import pickle
import signal
import sys
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from io import BytesIO
from itertools import count
from pathlib import Path
from select import PIPE_BUF
from tempfile import TemporaryDirectory
from threading import Thread
from types import ModuleType, TracebackType
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError, PlatformError
from fretflow.core.isolated import call_isolated
from fretflow.effects.catalogue import import_own
from fretflow.pipeline.ranks import CLOSED, started_rank, started_size

Array = NDArray[Any]
T = TypeVar("T")
R = TypeVar("R")
THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
DASK_TIMEOUT = 15  # s to reach the scheduler
LARGE = 2**17  # bytes of an array that is written faster than it is sent twice


class Backend(StrEnum):
    """Where the calls run."""

    LOCAL = "local"
    MPI = "mpi"
    DASK = "dask"


@dataclass(frozen=True)
class Workers:
    """Where the calls run, and on how many processes of this machine."""

    place: Backend = Backend.LOCAL
    jobs: int = 1
    address: str = ""

    @classmethod
    def parse(cls, executor: str, jobs: int) -> Workers:
        """Read the command line's ``local``, ``mpi`` or ``dask=ADDRESS``.

        Raises
        ------
        InputError
            If it is none of these, or does not fit the way in which this process was started.
        """
        name, has_address, address = executor.partition("=")
        if name not in list(Backend) or (name == Backend.DASK) != bool(address) or (has_address and not address):
            raise InputError(f"--executor {executor}: choose local, mpi or dask=ADDRESS "
                             "(for example dask=tcp://127.0.0.1:8786)")
        if jobs < 1:
            raise InputError(f"--jobs {jobs}: must be at least 1")
        place = Backend(name)
        if place is not Backend.LOCAL and jobs != 1:
            raise InputError(f"--jobs {jobs}: counts processes of this machine; with --executor {name} "
                             "as many run as were started, so leave it out")
        if place is Backend.MPI and started_size() < 2:
            raise InputError("--executor mpi: needs one rank that leads and at least one that works; "
                             "start it with mpirun -n 3 fretflow run ... (two cases at a time)")
        if place is not Backend.MPI and started_size() > 1 and (jobs > 1 or place is Backend.DASK):
            raise InputError(f"mpirun has started {started_size()} ranks already: use --executor mpi, "
                             "or start without mpirun")
        return cls(place, jobs, address)

    @property
    def in_turn(self) -> bool:
        """Return whether there is nothing to be gained over calling one after the other in this process."""
        return self.place is Backend.LOCAL and self.jobs == 1

    @property
    def leads(self) -> bool:
        """Return whether this process gets the outcomes, or is a rank that has worked for the one which does."""
        return self.place is not Backend.MPI or started_rank() == 0


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """How one call ended: its place among the arguments, and its value or its error."""

    index: int
    value: R | None = None
    error: Exception | None = None


def run_ensemble(function: Callable[[T], R], arguments: Sequence[T], workers: Workers) -> Iterator[Outcome[R]]:
    """Call `function` on each of `arguments` and yield the outcomes as they come.

    `function` is defined at the top of a module and, like its argument and value, can be pickled. Under mpirun with
    ``Backend.MPI`` every rank calls this; all but rank 0 work until all is done and get no outcomes.

    Raises
    ------
    InputError
        If the dask cluster cannot be reached.
    PlatformError
        If dask is not installed.
    """
    alone: list[int] = []
    with _executor(workers, len(arguments)) as executor:
        if executor is None:
            return
        for outcome in _gather(executor, function, dict(enumerate(arguments))):
            if workers.place is Backend.LOCAL and isinstance(outcome.error, BrokenExecutor):
                alone.append(outcome.index)
            else:
                yield outcome
    # A process that dies takes its pool along, and nothing tells which call it was: each gets a pool of its own.
    for index in sorted(alone):
        with _executor(Workers(), 1) as executor:
            for outcome in _gather(cast(Executor, executor), function, {index: arguments[index]}):
                yield _died(index) if isinstance(outcome.error, BrokenExecutor) else outcome


class LocalPool:
    """Calls functions on many arguments at once, in processes that start with the first call and stay."""

    def __init__(self, processes: int) -> None:
        self.processes = processes
        self._stack = ExitStack()
        self._executor: Executor | None = None
        self._arrays = _Arrays()

    def __enter__(self) -> LocalPool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self._stack.__exit__(kind, error, traceback)

    def __call__(self, function: Callable[[T], R], arguments: Sequence[T], /) -> list[R]:
        """Return the values of all calls, in the order of the arguments.

        Raises
        ------
        PlatformError
            If a process died.
        """
        if self.processes < 2 or len(arguments) < 2:
            return [function(argument) for argument in arguments]
        if self._executor is None:
            self._stack.enter_context(self._arrays)
            self._executor = self._stack.enter_context(_executor(Workers(jobs=self.processes), self.processes))
        executor = cast(Executor, self._executor)
        try:
            futures = [executor.submit(_unpacked, function, self._arrays.pack(argument)) for argument in arguments]
            return _values(futures)
        except BrokenExecutor as error:
            raise PlatformError("a process died (killed, or out of memory); try again with fewer at a time") from error


def _values(futures: Sequence[Future[R]]) -> list[R]:
    """Return the values of calls; where one fails, those under way end before that is raised, and others never begin.

    A pool whose processes are ended while calls are cancelled ends with an error of its own (`InvalidStateError`).
    """
    try:
        return [future.result() for future in futures]
    except BrokenExecutor:
        raise
    except Exception:
        for future in futures:
            future.cancel()
        wait(futures)
        raise


class _Arrays:
    """What is too large to be sent: the calls, and arrays that they have in common.

    Each array is written once, for all processes to map into their memory.
    """

    def __init__(self) -> None:
        self._folder: TemporaryDirectory[str] | None = None
        self._written: dict[int, tuple[weakref.ref[Array], Path]] = {}
        self._places = count()

    def __enter__(self) -> None:
        self._folder = TemporaryDirectory(prefix="fretflow-arrays-", ignore_cleanup_errors=True)

    def __exit__(self, *_: object) -> None:
        cast(TemporaryDirectory[str], self._folder).cleanup()

    def pack(self, argument: object) -> bytes | Path:
        """Return an argument pickled, or where that is written.

        A message that fills its pipe waits there for ever when the process that reads it dies (CPython issue 94777).
        """
        packed = self.dumps(argument)
        if len(packed) > PIPE_BUF:
            path = self._path()
            with suppress(OSError):  # where a disk is full it is sent
                path.write_bytes(packed)
                return path
        return packed

    def dumps(self, argument: object) -> bytes:
        """Return an argument pickled, its large arrays by where they are written."""
        buffer = BytesIO()
        pickler = pickle.Pickler(buffer, pickle.HIGHEST_PROTOCOL)
        pickler.dispatch_table = {**copyreg.dispatch_table, np.ndarray: self._reduced}
        pickler.dump(argument)
        return buffer.getvalue()

    def _reduced(self, array: Array) -> tuple[Any, ...]:
        if array.nbytes >= LARGE and not array.dtype.hasobject:
            own, path = self._written.get(id(array), (None, None))
            if own is not None and own() is array:  # another one may have its place in memory by now
                return _mapped, (str(path),)
            path = self._path().with_suffix(".npy")
            with suppress(OSError):  # where a disk is full it is sent
                np.save(path, array)
                array.flags.writeable = False  # what is written stays as it is
                self._written[id(array)] = weakref.ref(array), path
                weakref.finalize(array, path.unlink, missing_ok=True)
                return _mapped, (str(path),)
        return cast(tuple[Any, ...], array.__reduce_ex__(pickle.HIGHEST_PROTOCOL))

    def _path(self) -> Path:
        return Path(cast(TemporaryDirectory[str], self._folder).name) / f"{next(self._places)}"


@functools.lru_cache(maxsize=256)
def _mapped(path: str) -> Array:
    return np.asarray(np.load(path, mmap_mode="r"))


def _unpacked(function: Callable[[Any], R], packed: bytes | Path) -> R:
    if isinstance(packed, Path):
        written = packed.read_bytes()
        packed.unlink()
        packed = written
    return guarded(function, pickle.loads(packed))


def threads_each(processes: int) -> int:
    """Return the BLAS threads of each of `processes`: its share of the cores, or fewer where the user said so."""
    share = max(1, len(os.sched_getaffinity(0)) // processes)
    asked = [int(value) for name in THREAD_VARIABLES if (value := os.environ.get(name, "")).isdigit()]
    return max(1, min([share, *asked]))


def own_processes() -> int:
    """Return how many processes may work at once here: one a core, or this one alone where others share its work."""
    alone = started_size() == 1 and multiprocessing.parent_process() is None
    return len(os.sched_getaffinity(0)) if alone else 1


def guarded(function: Callable[[T], R], argument: T) -> R:
    """Return ``function(argument)``; an error that could not travel back from a worker becomes one that can."""
    try:
        return function(argument)
    except Exception as error:  # whatever a worker's function raises is told to who asked for it
        if _travels(error):
            raise
        raise RuntimeError(f"{type(error).__name__}: {error}") from error


def _travels(error: Exception) -> bool:
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - classes may fail here in any way
        return False
    return True


def _gather(executor: Executor, function: Callable[[T], R], arguments: dict[int, T]) -> Iterator[Outcome[R]]:
    futures: dict[Future[R], int] = {}
    for index, argument in arguments.items():
        try:
            futures[executor.submit(guarded, function, argument)] = index
        except BrokenExecutor as error:
            yield Outcome(index, error=error)
    try:
        for future in as_completed(futures):
            failure = future.exception()
            if failure is None:
                yield Outcome(futures[future], future.result())
            elif isinstance(failure, Exception):
                yield Outcome(futures[future], error=failure)
            else:
                raise failure
    finally:
        for future in futures:
            future.cancel()


def _died(index: int) -> Outcome[Any]:
    return Outcome(index, error=PlatformError(
        "its process died (killed, or out of memory); the same command continues where it stopped"))


@contextmanager
def _executor(workers: Workers, calls: int) -> Iterator[Executor | None]:
    """Open the executor; None on the ranks that have worked for it."""
    if workers.place is Backend.MPI:
        with _mpi() as executor:
            yield executor
    elif workers.place is Backend.DASK:
        with _dask(workers.address) as executor:
            yield executor
    else:
        with _processes(max(1, min(workers.jobs, calls))) as pool:
            yield pool


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    """Open `count` processes that import users' effects, and end with this one and where it is interrupted."""
    others = set(multiprocessing.active_children())
    # Fresh interpreters: a fork would inherit MPI and BLAS threads, which do not survive it. The first pool starts one
    # more, which keeps its semaphores, so that it too begins within `_threads`.
    with (_threads(threads_each(count)),
          _Quiet(count, multiprocessing.get_context("spawn"), initializer=_begin) as pool):
        try:
            yield pool
        except BaseException:  # nobody waits for what they still do
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


class _Quiet(ProcessPoolExecutor):
    """Processes that an interruption from the terminal, which reaches them too, ends without a word.

    They do not import the script that started them, which would run all of it again.
    """

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, until `_begin`
        script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
        try:
            return super().submit(function, *args, **kwargs)
        finally:
            sys.modules["__main__"] = script
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Begin a process: what refers to users' effects can be unpickled, and who started it is not outlived."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    Thread(target=_end_with_parent, daemon=True).start()
    import_own()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _mpi() -> Iterator[Executor | None]:
    from mpi4py.futures import MPICommExecutor

    with MPICommExecutor() as executor:
        yield executor if started_rank() == 0 else None


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as error:
        raise PlatformError("--executor dask: dask is not installed; pip install 'fretflow[dask]'") from error
    try:
        client = Client(address, timeout=DASK_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--executor dask={address}: no scheduler answers there ({error}); start one with "
                         "`dask scheduler` and workers with `dask worker ADDRESS`") from error
    with client:
        yield _Isolated(client.get_executor(pure=False))


class _Isolated(Executor):
    """Calls in interpreters of their own: dask's workers call from threads, where gmsh and PETSc cannot start."""

    def __init__(self, inner: Executor) -> None:
        self._inner = inner

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return self._inner.submit(call_isolated, function, *args, before=import_own, **kwargs)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Let processes that start meanwhile use `count` BLAS threads each, and import nothing from the working folder."""
    variables = {**dict.fromkeys(THREAD_VARIABLES, str(count)), **CLOSED}
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
