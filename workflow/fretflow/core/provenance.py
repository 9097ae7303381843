"""Where a result comes from: versions, commit, machine, and what it cost."""

from __future__ import annotations

import multiprocessing
import os
import platform
import subprocess
import sys
import threading
import time
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# Results depend on no .petscrc of the working folder or the user, and a reader of the output that leaves, as `head`
# does, is no crash.
PETSC_ARGUMENTS = ["fretflow", "-skip_petscrc", "-no_signal_handler"]
# By any of these mpirun, or what stands in for it, tells a process its place.
SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "MPI_LOCALNRANKS")
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MPI_LOCALRANKID")
SAMPLING_INTERVAL = 0.05  # s, between two looks at the memory

# Module name (looked for among those loaded) and the distribution that states its version.
_WITNESSES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "h5py": "h5py",
    "dolfinx": "fenics-dolfinx",
    "petsc4py": "petsc4py",
    "slepc4py": "slepc4py",
    "mpi4py": "mpi4py",
    "gmsh": "gmsh",
    "pyvista": "pyvista",
}


def alone() -> dict[str, str]:
    """Return variables with which Open MPI keeps to this process; none where mpirun has started it.

    Otherwise it starts a daemon beside a single process, and both listen on every network of the machine.
    """
    if any(variable in os.environ for variable in SIZE_VARIABLES + RANK_VARIABLES):
        return {}
    return {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self"}


def own_version() -> str:
    """Return the version of fretflow that is installed, "0+unknown" in a source tree that never was."""
    try:
        return version("fretflow")
    except PackageNotFoundError:
        return "0+unknown"


def versions() -> dict[str, str]:
    """Return the versions of fretflow, Python and those libraries that this process has loaded."""
    by_name = {"fretflow": own_version(), "python": platform.python_version()}
    for module, distribution in _WITNESSES.items():
        if module in sys.modules:
            by_name[module] = _version(module, distribution)
    return by_name


def _version(module: str, distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:  # Debian ships some modules without metadata
        return str(getattr(sys.modules[module], "__version__", "unknown"))


@cache
def commit() -> str | None:
    """Return the git commit of the checkout that fretflow runs from, ``-dirty`` if edited; None outside."""
    source = Path(__file__).resolve().parents[1]
    if not any((parent / ".git").exists() for parent in source.parents):
        return None
    command = ["git", "-C", str(source), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


class CostMeter:
    """Measures wall time and peak resident memory of this process and its workers while a ``with`` block runs.

    Memory is sampled by a thread, so that a stage's own peak is found and not that since the process began.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.peak_memory = 0  # bytes
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> CostMeter:
        self._start = time.perf_counter()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.seconds = time.perf_counter() - self._start
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        import psutil

        while True:
            stopped = self._stop.wait(SAMPLING_INTERVAL)
            self.peak_memory = max(self.peak_memory, sum(_resident(psutil, pid) for pid in (
                os.getpid(), *(worker.pid for worker in multiprocessing.active_children()))))
            if stopped:
                return


def _resident(psutil: Any, pid: int | None) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.NoSuchProcess:  # it has just ended
        return 0
