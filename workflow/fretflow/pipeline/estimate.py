"""What a run takes, from the size of its contact, before anything is made: memory that there is not is refused.

Figures are those of `benchmarks/growth.md`. The matrices of the contact decide, 3 n by 3 n for n nodes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from fretflow.case.config import Case, PeriodicMethod, Solver
from fretflow.core.errors import InputError
from fretflow.core.units import pretty_number

REDUCED = 4.0  # matrices of the contact that the reduction holds: stiffness and mass of two specimens
REDUCING = (250e6, 600.0)  # bytes of a process that reduces, and for each DOF^(4/3), as a factor in space has entries
SOLVED = 16.0  # that a period takes with either method, and for each harmonic with DLFT:
BY_HARMONIC = 0.35
DERIVATIVES = 3.0  # derivatives of all contact forces by all coefficients, samples x 3 n x (2 H + 1), that DLFT takes
SPECTRA = 3.0  # matrices of samples by samples that the default method takes for the tangent of a backbone
SOLVING = ("solve", "wear", "response")
PERIOD = (76.0, 1681, 2.5)  # s of a period in gross slip, at so many nodes, and the exponent from there
PERIOD_SAMPLES = 256  # with which those were measured; each sample is a contact problem
PRODUCTS = 1e-8  # s of a period by DLFT for each sample x 3 n x (2 H + 1)^2
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
    size = contact_nodes(case) if nodes is None else nodes
    if solves:
        _check_samples(solver, size, free)
    count = REDUCED if not solves else SOLVED + (
        BY_HARMONIC * solver.resolved_harmonics if solver.method is PeriodicMethod.DLFT else 0.0)
    fewest, kept = kept_factors(solver) if solves else (0, 0.0)
    if (needed := count * 8.0 * (3.0 * size) ** 2 + (kept if size >= fewest else 0.0)) > free:
        without, most = ((max(room, 0.0) / count / 8.0) ** 0.5 / 3.0 for room in (free, free - kept))
        most = max(most, min(without, fewest - 1.0))
        if meshed:
            _refuse("mesh.contact_elements", case.mesh.contact_elements, needed, free,
                    (most**0.5 - 1.0) / case.mesh.degree)
        _refuse("mesh: nodes on each contact face", size, needed, free, most)


def reductions_at_once(dofs: Sequence[int]) -> int:
    """Return how many of the specimens with so many `dofs` fit into memory at once: all, or one after the other.

    The entries of a factor in space grow as DOF^(4/3) (J. R. Gilbert, R. E. Tarjan, Numer. Math. 50 (1987) 377).

    Raises
    ------
    InputError
        If not even one fits.
    """
    bare, each = REDUCING
    needed, free = [bare + each * size ** (4.0 / 3.0) for size in dofs], free_memory()
    if max(needed) > free:
        _refuse("mesh: DOF of a specimen", max(dofs), max(needed), free, (max(free - bare, 0.0) / each) ** 0.75)
    return len(dofs) if sum(needed) <= free else 1


def kept_factors(solver: Solver) -> tuple[int, float]:
    """Return the nodes from which the default method keeps factors of samples, and the most bytes of these."""
    from fretflow.solvers.quasi_static.kept_factors import MOST_BYTES, WORTH_KEEPING  # compiled loops: 0.5 s

    return (0, 0.0) if solver.method is PeriodicMethod.DLFT else (WORTH_KEEPING, float(MOST_BYTES))


def _check_samples(solver: Solver, nodes: int, free: float) -> None:
    """Check the memory that so many samples take: by their square, or with DLFT by nodes and harmonics."""
    samples = solver.resolved_samples
    if solver.method is PeriodicMethod.DLFT:
        each = DERIVATIVES * 8.0 * 3.0 * nodes * (2.0 * solver.resolved_harmonics + 1.0)
        needed, most = each * samples, free / each
    else:
        needed, most = SPECTRA * 8.0 * samples**2, (free / SPECTRA / 8.0) ** 0.5
    if needed > free:
        _refuse("solver.samples", samples, needed, free, most,
                f" with {solver.resolved_harmonics} harmonics" if solver.method is PeriodicMethod.DLFT else "")


def contact_nodes(case: Case) -> int:
    """Return the nodes that the mesh of a case will have on each contact face."""
    return int((case.mesh.contact_elements * case.mesh.degree + 1) ** 2)


def time_warning(case: Case) -> tuple[str, ...]:
    """Return how long a period takes where that is long; a wear history is some 20 to 100 of them."""
    seconds, size, exponent = PERIOD
    solver, nodes = case.solver, contact_nodes(case)
    samples, fields = solver.resolved_samples, {}
    if solver.method is PeriodicMethod.DLFT:
        fields[f"solver.samples = {samples:,} with {solver.resolved_harmonics} harmonics"] = (
            PRODUCTS * samples * 3.0 * nodes * (2.0 * solver.resolved_harmonics + 1.0) ** 2)
        samples = PERIOD_SAMPLES
    more = "" if samples <= PERIOD_SAMPLES else f" with {samples:,} samples"
    fields[f"mesh.contact_elements = {case.mesh.contact_elements}{more}"] = (
        seconds * (nodes / size) ** exponent * samples / PERIOD_SAMPLES)
    slowest = max(fields, key=lambda name: fields[name])
    if case.mesh.upper is not None or fields[slowest] < LONG:
        return ()
    hours = pretty_number(fields[slowest] / 3600.0, 2)
    return (f"{slowest}: a period takes some {hours} h, and the wear tens of periods",)


def free_memory() -> float:
    """Return the bytes that this process may still take: what the machine has free, or its container allows."""
    free = next((float(line.split()[1]) * 1024.0 for line in MEMORY.read_text(encoding="ascii").splitlines()
                 if line.startswith("MemAvailable:")), float("inf")) if MEMORY.exists() else float("inf")
    allowed = LIMIT.read_text(encoding="ascii").strip() if LIMIT.exists() else "max"
    return min(free, float(allowed) if allowed.isdigit() else float("inf"))


def _refuse(field: str, value: int, needed: float, free: float, most: float, beside: str = "") -> None:
    raise InputError(f"{field} = {value:,}{beside}: needs about {needed / 1e9:,.0f} GB of memory, of which "
                     f"{free / 1e9:,.0f} GB are free; the largest that fits is {int(most):,}")
