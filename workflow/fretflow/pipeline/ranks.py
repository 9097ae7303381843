"""The processes of a run: rank 0 leads, the others wait until a collective stage needs them.

Nothing here imports mpi4py unless mpirun started the process.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable
from typing import Any

from fretflow.core.errors import FretflowError, printable
from fretflow.core.provenance import PETSC_ARGUMENTS, RANK_VARIABLES, SIZE_VARIABLES, alone

POLL = 0.02  # s; a waiting rank sleeps between looks, so that it leaves its core to rank 0
FORWARDING = 0.5  # s that mpirun gets to pass on a message before it kills all ranks
GRACE = 5.0  # s for the other ranks to leave a collective call that failed on one of them

# No process that starts imports from the folder that it works in, nor takes numba's cache from a file there.
CLOSED = {"PYTHONSAFEPATH": "1", "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", "")}


def close_process() -> None:
    """Let this process and those that it starts import nothing from the working folder and listen to nobody.

    To be called before anything imports MPI. The ranks of mpirun have to listen to each other and go on to do so.
    """
    os.environ.update(CLOSED | alone())
    sys.path[:] = [folder for folder in sys.path if folder]


def started_size() -> int:
    """Return the number of ranks that mpirun started, 1 without it; from the environment, so it is free."""
    return _environment(SIZE_VARIABLES, 1)


def started_rank() -> int:
    """Return the rank that mpirun gave this process, 0 without it."""
    return _environment(RANK_VARIABLES, 0)


def _environment(variables: tuple[str, ...], default: int) -> int:
    for variable in variables:
        value = os.environ.get(variable, "")
        if value.isdigit():
            return int(value)
    return default


def keep_to_itself() -> None:
    """Let PETSc know this rank alone, where each rank of mpirun runs whole cases by itself.

    PETSc starts and ends with all ranks of its world together, and would wait for those that have no need of it. To be
    called before anything else starts PETSc.
    """
    import petsc4py
    from mpi4py import MPI

    petsc4py.init(PETSC_ARGUMENTS, comm=MPI.COMM_SELF)


class Ranks:
    """All processes of this run. A serial run is rank 0 of 1 and never touches MPI.

    Rank 0 hands out tasks and every rank reports back, error or not. An error that all ranks meet ends the
    run in order; where one rank is left waiting inside a collective call, all are aborted. A process that
    runs a whole case of its own beside the others is alone: `together` is False.
    """

    def __init__(self, together: bool = True) -> None:
        self.size = started_size() if together else 1
        self.rank = 0
        self.comm: Any = None
        self._control: Any = None
        if self.size > 1:
            from mpi4py import MPI

            self.comm = MPI.COMM_WORLD
            self._control = self.comm.Dup()
            self.size, self.rank = self.comm.size, self.comm.rank

    def lead(self, task: object, work: Callable[[], int]) -> int:
        """On rank 0: do `work` while every other rank does `task`; return the sum of what all report.

        Raises
        ------
        Exception
            The error of this rank, or else the first of another one.
        """
        others = range(1, self.size)
        for other in others:
            self._control.send(task, dest=other)
        try:
            total = work()
        except BaseException as error:  # also where the user interrupts: nobody may go on waiting
            self._abort_unless(error, lambda: all(self._control.iprobe(source=other) for other in others))
            for other in others:
                self._control.recv(source=other)
            raise
        reports = [self._control.recv(source=other) for other in others]
        for report in reports:
            if isinstance(report, Exception):
                raise report
        return total + sum(int(report) for report in reports)

    def serve(self, work: Callable[[Any], int]) -> None:
        """On the other ranks: do the tasks that rank 0 hands out until it says that the run is over."""
        while (task := self._next_task()) is not None:
            try:
                report: Any = work(task)
            except Exception as error:  # noqa: BLE001 - rank 0 raises it
                report = error
            self._control.send(report, dest=0)
            if isinstance(report, Exception):
                self._abort_unless(report, lambda: self._control.iprobe(source=0))

    def dismiss(self) -> None:
        """On rank 0: tell the other ranks that the run is over."""
        for other in range(1, self.size):
            self._control.send(None, dest=other)

    def _next_task(self) -> Any:
        while not self._control.iprobe(source=0):
            time.sleep(POLL)
        return self._control.recv(source=0)

    def _abort_unless(self, error: BaseException, settled: Callable[[], bool]) -> None:
        """Wait until the other side has left the failed call too; if it stays there, end every rank."""
        deadline = time.monotonic() + GRACE
        while not settled():
            if time.monotonic() > deadline:
                _report(error)
                self.comm.Abort(getattr(error, "exit_code", 1))
            time.sleep(POLL)


def _report(error: BaseException) -> None:
    if isinstance(error, FretflowError):
        sys.stderr.write(f"fretflow: {printable(str(error))}\n")
    else:
        traceback.print_exception(error)
    sys.stderr.flush()
    time.sleep(FORWARDING)
