"""The cost of a DLFT period against one dense LU factorisation of its own full Jacobian.

    .venv/bin/python benchmarks/dlft.py [--nodes 121] [--harmonics 3 7 15] [--force 45]

CPU seconds on one thread: from nothing; again from the period of a force 0.5 % lower; and of the factorisation, whose
time depends on the size of the matrix alone, so that its entries are drawn. At 45 N a third of the contact's area and
time slips.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import numpy as np
from fretflow.case.config import PeriodicMethod, Solver
from fretflow.contact.law import ContactState
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.dlft.solver import DlftSolver
from growth_cases import dlft_problem
from rich.console import Console
from rich.table import Table
from scipy.linalg import lu_factor

SAMPLES = 128
NEARBY = 0.995


def timed(work):
    """Return the CPU time of `work` in s, and its result."""
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def factorisation(size: int) -> float:
    """Return the CPU time of one dense LU factorisation, s."""
    matrix = np.asfortranarray(np.random.default_rng(7).normal(size=(size, size)))
    return timed(lambda: lu_factor(matrix, overwrite_a=True, check_finite=False))[0]


def row(nodes: int, harmonics: int, force: float) -> tuple[str, ...]:
    """Return a line of the table."""
    settings = Solver(method=PeriodicMethod.DLFT, harmonics=harmonics, samples=SAMPLES, estimate_error=False)
    solver, problem = DlftSolver(settings), dlft_problem(nodes, force)
    size = 3 * nodes * (2 * harmonics + 1)
    head = (str(harmonics), str(size))
    try:
        near = solver.solve(problem.vary(amplitude=NEARBY * force))
        cold, solution = timed(lambda: solver.solve(problem))
        warm, _ = timed(lambda: solver.solve(problem, near))
    except NonConvergenceError as error:
        return (*head, str(error), "", "", "", "", "")
    dense = factorisation(size)
    slips = float(np.mean(solution.state == ContactState.SLIP))
    return (*head, f"{slips:.0%}", str(len(solution.residual_history) - 1), f"{cold:.2f}", f"{warm:.2f}",
            f"{dense:.2f}", f"{cold / dense:.2f}, {warm / dense:.2f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, default=121)
    parser.add_argument("--harmonics", type=int, nargs="+", default=[3, 7])
    parser.add_argument("--force", type=float, default=45.0, help="amplitude of the excitation in N")
    given = parser.parse_args()
    table = Table("harmonics", "unknowns", "slips", "iterations", "cold, s", "warm, s", "one LU, s", "ratios",
                  title=f"DLFT, {given.nodes} nodes, {given.force:g} N, {SAMPLES} samples")
    for harmonics in given.harmonics:
        table.add_row(*row(given.nodes, harmonics, given.force))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
