"""The cost of a period of the default solver by load, from stuck over the transition to sliding.

    .venv/bin/python benchmarks/loads.py [--nodes 121] [--forces 36 39 42 45 48 51 54 57 60 63 66 69 72 75]

CPU seconds on one thread: from nothing, the joint's condensation with it; and from the period of a force 0.5 % lower.
"""

from __future__ import annotations

import argparse
import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import numpy as np
from dlft import NEARBY, timed
from fretflow.case.config import PeriodicMethod, Solver
from fretflow.contact.law import ContactState
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from growth_cases import problem
from rich.console import Console
from rich.table import Table

SMALL = 9  # nodes
COLD, WARM = 3.0, 1.0  # s, targets for 121 nodes


def row(solver: QuasiStaticSolver, nodes: int, force: float) -> tuple[str, ...]:
    """Return a line of the table."""
    given = problem(nodes, force, PeriodicMethod.QUASI_STATIC)
    try:
        cold, first = timed(lambda: solver.solve(given))
        near = solver.solve(given.vary(amplitude=NEARBY * force))
        warm, again = timed(lambda: solver.solve(given, near))
    except NonConvergenceError as error:
        return f"{force:g}", str(error), "", "", "", ""
    slips = float(np.mean(first.state == ContactState.SLIP))
    iterations = [str(len(solution.residual_history) - 1) for solution in (first, again)]
    return (f"{force:g}", f"{slips:.0%}", f"{cold:.2f}", f"{warm:.2f}", ", ".join(iterations),
            "yes" if cold <= COLD and warm <= WARM else "no")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, default=121)
    parser.add_argument("--forces", type=float, nargs="+", default=[float(force) for force in range(36, 76, 3)],
                        help="amplitudes of the excitation in N")
    given = parser.parse_args()
    solver = QuasiStaticSolver(Solver(estimate_error=False))
    solver.solve(problem(SMALL, given.forces[0], PeriodicMethod.QUASI_STATIC))  # loads the compiled loops
    table = Table("N", "slips", "cold, s", "warm, s", "iterations", f"within {COLD:g} and {WARM:g} s",
                  title=f"default solver, {given.nodes} nodes, {solver.settings.resolved_samples} samples")
    for force in given.forces:
        table.add_row(*row(solver, given.nodes, force))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
