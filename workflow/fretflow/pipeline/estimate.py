"""What a run takes, from the size of its contact, before anything is made: memory that there is not is refused.

Figures are those of `benchmarks/growth.md`. The matrices of the contact decide, 3 n by 3 n for n nodes.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from fretflow.case.config import Case, PeriodicMethod
from fretflow.core.errors import InputError

REDUCED = 4.0  # matrices of the contact that the reduction holds: stiffness and mass of two specimens
SOLVED = 16.0  # that a period takes with either method, and for each harmonic with DLFT:
BY_HARMONIC = 1.5
SPECTRA = 3.0  # matrices of samples by samples that the default method takes for the tangent of a backbone
SOLVING = ("solve", "wear", "response")
PERIOD = (122.0, 1681, 2.7)  # s of a period in gross slip, at so many nodes, and the exponent from there
LONG = 600.0  # s of a period that are told
MEMORY = Path("/proc/meminfo")
LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_memory(case: Case, stages: Collection[str], nodes: int | None = None) -> None:
    """Check that the machine has the memory that `stages` of a case need; with `nodes` on its face, else as meshed.

    Raises
    ------
    InputError
        Naming the field, and the largest value that fits.
    """
    free, meshed = free_memory(), nodes is None and case.mesh.upper is None
    if not {"reduce", *SOLVING} & {*stages} or (nodes is None and not meshed):
        return
    solves, solver = bool({*SOLVING} & {*stages}), case.solver
    if solves and solver.method is PeriodicMethod.QUASI_STATIC and (
            needed := SPECTRA * 8.0 * solver.resolved_samples**2) > free:
        _refuse("solver.samples", solver.resolved_samples, needed, free, (free / SPECTRA / 8.0) ** 0.5)
    count = REDUCED if not solves else SOLVED + (
        BY_HARMONIC * solver.resolved_harmonics if solver.method is PeriodicMethod.DLFT else 0.0)
    size = contact_nodes(case) if nodes is None else nodes
    if (needed := count * 8.0 * (3.0 * size) ** 2) > free:
        most = (free / count / 8.0) ** 0.5 / 3.0
        if meshed:
            _refuse("mesh.contact_elements", case.mesh.contact_elements, needed, free,
                    (most**0.5 - 1.0) / case.mesh.degree)
        _refuse("mesh: nodes on each contact face", size, needed, free, most)


def contact_nodes(case: Case) -> int:
    """Return the nodes that the mesh of a case will have on each contact face."""
    return int((case.mesh.contact_elements * case.mesh.degree + 1) ** 2)


def time_warning(case: Case) -> tuple[str, ...]:
    """Return how long a period takes where that is long; a wear history is some 20 to 100 of them."""
    seconds, size, exponent = PERIOD
    takes = seconds * (contact_nodes(case) / size) ** exponent
    if case.mesh.upper is not None or takes < LONG:
        return ()
    return (f"mesh.contact_elements = {case.mesh.contact_elements}: a period takes some {takes / 3600.0:.2g} h, and "
            "the wear tens of periods",)


def free_memory() -> float:
    """Return the bytes that this process may still take: what the machine has free, or its container allows."""
    free = next((float(line.split()[1]) * 1024.0 for line in MEMORY.read_text(encoding="ascii").splitlines()
                 if line.startswith("MemAvailable:")), float("inf")) if MEMORY.exists() else float("inf")
    allowed = LIMIT.read_text(encoding="ascii").strip() if LIMIT.exists() else "max"
    return min(free, float(allowed) if allowed.isdigit() else float("inf"))


def _refuse(field: str, value: int, needed: float, free: float, most: float) -> None:
    raise InputError(f"{field} = {value:,}: needs about {needed / 1e9:,.0f} GB of memory, of which "
                     f"{free / 1e9:,.0f} GB are free; the largest that fits is {int(most):,}")
