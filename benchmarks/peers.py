"""fretflow's DLFT beside pyHarm's (pyHarm-os, SAFRAN, Apache 2.0; element `DLFT3D`) on the same matrices.

    .venv/bin/python benchmarks/peers.py [--nodes 9 36 121] [--force 75]

Both get the reduced matrices of the same two bodies, joined node to node, the same load, friction, harmonics, samples
and penalty; times are CPU seconds on one thread. fretflow starts from nothing; pyHarm from the joint with springs for
contacts, because from rest it divides by zero. pyHarm goes into an environment of its own beside the cache of meshes,
with JAX switched to 64 bits. With 121 nodes it needs some minutes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}

import numpy as np
from fretflow.solvers.dlft.solver import Variant, build_equations, solve_equations
from fretflow.structure.two_mass_rig.joint import _clamped, _on_rig
from growth_cases import CACHE, dlft_problem
from rich.console import Console
from rich.table import Table

PEER = "pyHarm-os==1.2.2"
MICROMETRE = 1e-6
HARMONICS, SAMPLES = 3, 128
FORCES_AGREE = 1e-6
TARGET = 200.0


def peer_python() -> Path:
    """Return the interpreter that has the peer; installed on the first call."""
    home = CACHE / "peers"
    python = home / "bin" / "python"
    marker = home / PEER
    if not marker.exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", home], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", PEER], check=True)
        marker.touch()
    return python


def write_problem(problem, penalty: float, path: Path, repeats: int) -> None:
    """Write the bodies' matrices in N and um, contact DOFs first, then block, arm and the rest."""
    joint = problem.structure
    bodies = {"upper": _on_rig(joint.upper, joint.rig), "lower": _clamped(joint.lower)}
    matrices = {f"{name}_{letter}": MICROMETRE * matrix for name, body in bodies.items()
                for letter, matrix in (("M", body.mass), ("C", body.damping), ("K", body.stiffness))}
    np.savez(path, **matrices, nodes=problem.interface.size, mu=problem.friction_coefficient, omega=problem.omega,
             penalty=MICROMETRE * penalty, harmonics=HARMONICS, samples=SAMPLES, excitation=problem.excitation,
             normal_load=problem.normal_load, repeats=repeats)


def best(work, repeats: int = 3):
    """Return the shortest CPU time of `work` in s, and its last result."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return min(times), result


def own_jacobian_error(equations, at: np.ndarray) -> float:
    """Return the largest relative error of products with the Jacobian against central differences."""
    rng, (apply, _) = np.random.default_rng(7), equations.linearise(equations.evaluate(at))
    errors = []
    for _ in range(4):
        v = rng.normal(size=at.shape)
        errors.append([])
        for step in np.abs(at).max() * np.array([1e-6, 1e-7, 1e-8]):
            difference = equations.evaluate(at + step * v).residual - equations.evaluate(at - step * v).residual
            difference = difference.ravel() / (2.0 * step)
            errors[-1].append(np.abs(apply(v.ravel()) - difference).max() / np.abs(difference).max())
    return max(min(tried) for tried in errors)  # a step that meets a change of state tells nothing


def compare(nodes: int, force: float) -> list[tuple[str, ...]]:
    """Run both codes and return the rows of the table."""
    problem = dlft_problem(nodes, force)
    equations = build_equations(problem, Variant(HARMONICS, SAMPLES, None))
    rest = np.zeros((2 * HARMONICS + 1, equations.load.shape[1]))

    def solve():
        fresh = build_equations(problem, Variant(HARMONICS, SAMPLES, None))
        return fresh, solve_equations(fresh, None, 1e-12, 60)

    once, _ = best(lambda: equations.linearise(equations.evaluate(rest)))
    solved, (equations, root) = best(solve)
    given, result = CACHE / "peer_problem.npz", CACHE / "peer_result.npz"
    write_problem(problem, equations.penalty, given, repeats=3 if nodes > 50 else 10)
    script = Path(__file__).resolve().with_name("peers_pyharm.py")
    subprocess.run([peer_python(), script, given, result], check=True, capture_output=True, cwd=CACHE)
    peer = np.load(result)
    own = equations.analysis @ root.state.force.reshape(SAMPLES, -1)
    apart = float(np.abs(peer["force"] - own).max() / np.abs(own).max())
    verdict = "agree" if apart <= FORCES_AGREE else "DO NOT AGREE"
    wrong = own_jacobian_error(equations, root.unknowns)
    label = f"{nodes} nodes, {force:g} N"
    return [
        (label, "unknowns", f"{root.unknowns.size}", f"{peer['unknowns']}", ""),
        ("", "residual and Jacobian", f"{once:.4f} s", f"{peer['once']:.4f} s", f"{peer['once'] / once:.0f} times"),
        ("", "converged point", f"{solved:.3f} s", f"{peer['solved']:.2f} s",
         f"{peer['solved'] / solved:.0f} times (target {TARGET:.0f})"),
        ("", "Newton iterations", f"{len(root.history) - 1}", f"{peer['iterations']}", ""),
        ("", "residual there", f"{np.linalg.norm(root.state.residual):.1e} N", f"{peer['residual']:.1e} N", ""),
        ("", "error of the Jacobian", f"{wrong:.1e}", f"{peer['error']:.1e}", ""),
        ("", "contact forces", "", f"{apart:.1e} apart", verdict)]


def main() -> int:
    """Print the table; the exit code tells whether all forces agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=int, nargs="+", default=[9, 36], help="squares of 3, 4, ...")
    parser.add_argument("--force", type=float, default=75.0, help="amplitude of the excitation in N")
    given = parser.parse_args()
    table = Table("problem", "what", "fretflow", PEER, "ratio", title="DLFT side by side")
    for nodes in given.nodes:
        for row in compare(nodes, given.force):
            table.add_row(*row)
    Console(width=120).print(table)
    return 0 if all("NOT" not in cell for column in table.columns for cell in column.cells) else 1


if __name__ == "__main__":
    sys.exit(main())
