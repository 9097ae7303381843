"""How time and memory grow with the contact nodes and the harmonics: reduction, DLFT, the default solver.

    .venv/bin/python benchmarks/growth.py [--nodes 36 121] [--harmonics 3] [--force 60] [--what dlft quasi-static]
    .venv/bin/python benchmarks/growth.py --nodes 36 121 441 1681 --harmonics 3 7 15 --limit 600 --write growth.md

Every figure comes from a process of its own on one thread, so that its peak memory is its own: CPU seconds of the work
alone, the peak with all that was read for it. What takes longer than the limit is said so. The exponent is that of the
nodes in a power law fitted to the seconds. Meshes and reduced specimens are made once and kept in the cache.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

from fretflow.case.config import PeriodicMethod, Solver, load_case
from fretflow.core.errors import FretflowError
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import read_record
from growth_cases import case_file, meshed_folder, problem, reduced_folder
from growth_fit import markdown, rows
from rich.console import Console
from rich.table import Table

LIMIT = 3600.0  # s of wall time for one figure
SMALL = 9  # nodes
COLUMNS = ("what", "harmonics", "nodes", "CPU s", "again, s", "MiB", "DOFs or iterations", "exponent")


def reduction(nodes: int, _harmonics: int, _force: float) -> dict[str, float]:
    """Time the reduction of one specimen: assembly, constraint modes, frequencies."""
    from fretflow.structure.reduction.reduce import reduce_specimen
    from mpi4py import MPI

    case, meshes = load_case(case_file(nodes)), meshed_folder(nodes)
    summary = read_record(meshes / "upper.h5", MeshSummary)
    start = time.process_time()
    reduced, _ = reduce_specimen(meshes / summary.file, summary, case.specimen.upper, case.reduction, case.mesh.degree,
                                 MPI.COMM_SELF)
    return {"seconds": time.process_time() - start, "size": reduced.full_dofs}


def dlft(nodes: int, harmonics: int, force: float) -> dict[str, float]:
    """Time one DLFT period from nothing."""
    from fretflow.solvers.dlft.solver import DlftSolver

    settings = Solver(method=PeriodicMethod.DLFT, harmonics=harmonics, estimate_error=False)
    return period(DlftSolver(settings), nodes, force, PeriodicMethod.DLFT)


def quasi_static(nodes: int, _harmonics: int, force: float) -> dict[str, float]:
    """Time one period of the default solver from nothing; its harmonics are the rig's and cost nothing."""
    from fretflow.solvers.quasi_static.solver import QuasiStaticSolver

    return period(QuasiStaticSolver(Solver(estimate_error=False)), nodes, force, PeriodicMethod.QUASI_STATIC)


def period(solver, nodes: int, force: float, method: PeriodicMethod) -> dict[str, float]:
    """Time one period from nothing, and again from its solution."""
    solver.solve(problem(SMALL, force, method))  # loads the compiled loops
    given = problem(nodes, force, method)
    start = time.process_time()
    solution = solver.solve(given)
    cold = time.process_time() - start
    start = time.process_time()
    solver.solve(given, solution)
    return {"seconds": cold, "again": time.process_time() - start, "size": len(solution.residual_history) - 1}


WORK = {"reduction": reduction, "dlft": dlft, "quasi-static": quasi_static}


def measure(what: str, nodes: int, harmonics: int, force: float, limit: float) -> dict[str, float] | str:
    """Run one figure in a process of its own; return its figures, or why there are none."""
    command = [sys.executable, __file__, "--one", what, "--nodes", str(nodes), "--harmonics", str(harmonics),
               "--force", str(force)]
    try:
        if what != "reduction":
            reduced_folder(nodes, limit)
        done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=limit)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        Console(stderr=True).print(f"{what}, {nodes} nodes, {harmonics} harmonics: {error}\n{error.stderr or ''}")
        return f"over {limit:.0f}" if isinstance(error, subprocess.TimeoutExpired) else "failed"
    return dict(json.loads(done.stdout.splitlines()[-1]))


def report(what: str, nodes: int, harmonics: int, force: float) -> None:
    """Do one piece of work in this process and print its figures as JSON."""
    try:
        figures = WORK[what](nodes, harmonics, force)
    except FretflowError as error:
        sys.exit(str(error))
    print(json.dumps(figures | {"MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, nargs="+", default=[36, 121])
    parser.add_argument("--harmonics", type=int, nargs="+", default=[3])
    parser.add_argument("--force", type=float, default=60.0, help="amplitude of the excitation in N")
    parser.add_argument("--limit", type=float, default=LIMIT, help="wall time of one figure in s")
    parser.add_argument("--write", type=Path, help="file for the table in Markdown")
    parser.add_argument("--what", choices=WORK, nargs="+", default=list(WORK))
    parser.add_argument("--one", choices=WORK, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        report(given.one, given.nodes[0], given.harmonics[0], given.force)
        return
    table, lines = Table(*COLUMNS, title=f"growth, {given.force:g} N"), []
    for what in given.what:
        for harmonics in given.harmonics if what == "dlft" else given.harmonics[:1]:
            series = {nodes: measure(what, nodes, harmonics, given.force, given.limit) for nodes in given.nodes}
            lines += rows(what, harmonics if what == "dlft" else None, series)
            if given.write:
                given.write.write_text(markdown(f"Growth, {given.force:g} N", COLUMNS, lines))
    for line in lines:
        table.add_row(*line)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
