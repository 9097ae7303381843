"""Times of the pipeline at the paper's size: meshes and reduction, one period by each method, the whole of test 1.

    .venv/bin/python benchmarks/pipeline.py [--whole]

Needs a machine that does nothing else. Each figure is the best of its repeats; beside it the target.
The reduction is run once to warm dolfinx's form cache and timed the second time.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from fretflow.case.config import Case, PeriodicMethod, Solver, load_case
from fretflow.pipeline.problem import make_problem
from fretflow.solvers.dlft.solver import DlftSolver
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from rich.console import Console
from rich.table import Table
from scipy.linalg import lu_factor

ROOT = Path(__file__).parents[1]
TEST_1 = ROOT / "examples" / "test1.toml"


def best(work, repeats=3):
    """Return the shortest wall time of `work` in s, and its last result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


def run_until(stage: str, out: Path) -> float:
    """Run test 1 until `stage` from nothing and return the wall time in s."""
    start = time.perf_counter()
    command = [ROOT / "fretflow", "run", TEST_1, "--until", stage, "--out", out, "--force"]
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def periods(case: Case, reduced: Path) -> list[tuple[str, str, str]]:
    """Time one period at three amplitudes, from zero and from its neighbour, and DLFT against one dense LU."""
    rows = []
    for force in (53.0, 60.0, 75.0):
        test = case.test.model_copy(update={"excitation_amplitude": force})
        problem = make_problem(case.model_copy(update={"test": test}), reduced)
        solver = QuasiStaticSolver(Solver(estimate_error=False))
        cold, solution = best(lambda p=problem, s=solver: s.solve(p))
        bowl = 1e-8 * np.sum((problem.interface.nodes / 5e-4)**2, axis=1)  # as one wear jump leaves
        worn = replace(problem, interface=replace(problem.interface, gap=problem.interface.gap + bowl))
        warm, _ = best(lambda p=worn, s=solver, n=solution: s.solve(p, n))
        rows.append((f"period at {force:.0f} N, from zero", f"{cold:.2f} s", "3 s"))
        rows.append((f"period at {force:.0f} N, from its neighbour", f"{warm:.2f} s", "1 s"))
        dlft = DlftSolver(Solver(method=PeriodicMethod.DLFT, estimate_error=False))
        own, period = best(lambda p=problem, s=dlft: s.solve(p))
        size = 7 * 3 * problem.interface.size
        dense = np.random.default_rng(0).normal(size=(size, size)) + size * np.eye(size)
        factor, _ = best(lambda m=dense: lu_factor(m))
        rows.append((f"DLFT period at {force:.0f} N, {len(period.residual_history)} iterations",
                     f"{own:.2f} s, {own / factor:.2f} of a dense LU of {size}", "1 of it"))
    return rows


def main() -> None:
    """Print the table."""
    table = Table("what", "measured", "target", title="fretflow on test 1")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        run_until("reduce", out)
        table.add_row("mesh, assemble and reduce, warm, with start-up", f"{run_until('reduce', out):.1f} s", "15 s")
        reduced = next((out / "test1").glob("reduce-*"))
        for row in periods(load_case(TEST_1), reduced):
            table.add_row(*row)
        if "--whole" in sys.argv:
            start = time.perf_counter()
            subprocess.run([ROOT / "fretflow", "run", TEST_1, "--out", out / "whole"], check=True, capture_output=True)
            peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
            table.add_row("test 1 whole, from nothing", f"{time.perf_counter() - start:.0f} s, {peak:.0f} MiB",
                          "300 s, 2048 MiB")
    Console().print(table)


if __name__ == "__main__":
    main()
