"""pyHarm's side of `peers.py`; runs in the virtual environment that has pyHarm, on the problem in an .npz file.

    python peers_pyharm.py PROBLEM.npz RESULT.npz

Lengths in micrometres, as in the file: pyHarm's tolerances are absolute.
"""

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)  # before pyHarm: its arithmetic is JAX's

import numpy as np  # noqa: E402
from pyHarm.Maestro import Maestro  # noqa: E402
from pyHarm.NonLinearSolver.NewtonRaphson import Solver_NewtonRaphson  # noqa: E402
from pyHarm.Solver import SystemSolution  # noqa: E402

JACOBIAN_DIRECTIONS, STEPS = 4, np.array([1e-6, 1e-7, 1e-8])


def body(problem, name, nodes):
    """Return the entry of a substructure: contact nodes first, everything else as its modes."""
    matrices = {letter: problem[f"{name}_{letter}"] for letter in "MCK"}
    return {"matrix": matrices, "ndofs": 3, "nmodes": len(matrices["K"]) - 3 * nodes}


def forcing(node, harmonic, amplitude):
    """Return a cosine load on a scalar DOF of the upper body."""
    return {"type": "GOForcing", "connect": {"upper": [node]}, "dirs": [-1], "dto": 0, "ho": harmonic,
            "amp": float(amplitude)}


def build_system(problem):
    nodes = int(problem["nodes"])
    contact = {"type": "DLFT3D", "dirs": [2, 0, 1], "mu": float(problem["mu"]), "N0": 0.0, "g": 0.0,
               "eps": float(problem["penalty"])}
    connectors = {f"contact_{m}": contact | {"connect": [("upper", [m]), ("lower", [m])]} for m in range(nodes)}
    connectors["drive"] = forcing(nodes, 1, problem["excitation"])  # the block
    connectors["weight"] = forcing(nodes + 2, 0, -problem["normal_load"])  # the arm, vertically
    data = {"system": {"type": "Base", "nh": int(problem["harmonics"]), "nti": int(problem["samples"])},
            "substructures": {name: body(problem, name, nodes) for name in ("upper", "lower")},
            "connectors": connectors}
    return Maestro(data).system


def best(work, repeats):
    """Return the shortest CPU time of `work` in s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def jacobian_error(residual, jacobian, at, contact):
    """Return the largest relative error of the Jacobian's `contact` rows and columns against central differences."""
    rng, exact = np.random.default_rng(7), jacobian(at)
    errors = []
    for _ in range(JACOBIAN_DIRECTIONS):
        v = np.zeros(at.size)
        v[contact] = rng.normal(size=contact.size)
        errors.append([])
        for step in np.abs(at[contact]).max() * STEPS:
            difference = (residual(at + step * v) - residual(at - step * v))[contact] / (2.0 * step)
            errors[-1].append(np.abs((exact @ v)[contact] - difference).max() / np.abs(difference).max())
    return max(min(tried) for tried in errors)  # a step that meets a change of state tells nothing


def contact_dofs(system, problem, name):
    """Return the unknowns of a body's contact nodes: by harmonic, then node, then direction."""
    table = system.expl_dofs
    return np.asarray(table[(table["sub"] == name) & (table["node_num"] < int(problem["nodes"]))].index)


def contact_forces(system, problem, x):
    """Return the coefficients (2 H + 1, 3 n) of the contact forces on the upper nodes, in N."""
    nodes, omega = int(problem["nodes"]), float(problem["omega"])
    full = np.append(x, omega)
    linear = system._residual(system.LE_extforcing, full) + system._residual(system.LE_linear, full)
    return linear[contact_dofs(system, problem, "upper")].reshape(-1, 3 * nodes)


def stuck(system, problem):
    """Return the motion (unknowns,) with springs of the penalty at the contact: from rest pyHarm divides by zero."""
    at = np.append(np.zeros(system.ndofs_solve), float(problem["omega"]))
    matrix, _ = system._jacobian(system.LE_linear, at)
    upper, lower = (contact_dofs(system, problem, name) for name in ("upper", "lower"))
    for sign, rows, columns in ((1, upper, upper), (1, lower, lower), (-1, upper, lower), (-1, lower, upper)):
        matrix[rows, columns] += sign * float(problem["penalty"])
    return np.linalg.solve(matrix, -system._residual(system.LE_extforcing, at))


def main():
    problem = np.load(sys.argv[1])
    omega = float(problem["omega"])
    system = build_system(problem)

    def residual(x, *_):
        return system.Residual(np.append(x, omega))

    def jacobian(x, *_):
        return system.Jacobian(np.append(x, omega))[0]

    def both():
        residual(start)
        jacobian(start)

    start = stuck(system, problem)
    both()  # compiles
    once = best(both, int(problem["repeats"]))
    # of its solvers the fastest here: its default, MINPACK's hybr, took as long with 36 nodes and far longer with 121
    solver = Solver_NewtonRaphson(residual, jacobian, {"tol_residual": 1e-9, "tol_delta_x": 1e-9, "max_iter": 200})
    start_time = time.process_time()
    solution = solver.Solve(SystemSolution(start), [])
    solved = time.process_time() - start_time
    x = solution.x_red
    np.savez(sys.argv[2], once=once, solved=solved, residual=np.linalg.norm(residual(x)), iterations=solution.iter_numb,
             force=contact_forces(system, problem, x), unknowns=x.size,
             error=jacobian_error(residual, jacobian, x, contact_dofs(system, problem, "upper")))


if __name__ == "__main__":
    main()
