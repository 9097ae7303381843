"""What effects cost: one period with three effects against the baseline's, on one reduced model, in one run.

Usage: .venv/bin/python benchmarks/effects.py [--elements 10] [--repeats 3]
The model is made by `fretflow run` in a temporary folder; times are CPU seconds, their ratio is what counts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")  # as the command line does; a second one spins

from fretflow.case.config import load_case
from fretflow.effects.catalogue import catalogue
from fretflow.effects.derivative import effect_direction
from fretflow.effects.model import EffectModel
from fretflow.pipeline.problem import make_problem
from fretflow.solvers.sensitivity import sensitivities
from fretflow.solvers.solve import make_solver

ROOT = Path(__file__).parents[1]
SETS = (("velocity-dependent-friction", "contact-stiffness", "normal-load-coupling"),
        ("third-body", "friction-run-in", "directional-friction"),
        ("load-dependent-friction", "initial-gap", "excitation-distortion"),
        ("viscous", "parallel-stiffness", "support-nonlinearity"))


def cpu(call):
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def problem_of(elements, folder):
    case = folder / "case.toml"
    case.write_text('format = "fretflow-case/1"\nname = "effects"\n[test]\nexcitation_amplitude = "60 N"\ncycles = 1\n'
                    f"[mesh]\ncontact_elements = {elements}\n")
    subprocess.run([ROOT / "fretflow", "run", case, "--until", "reduce", "--out", folder], check=True,
                   stdout=subprocess.DEVNULL)
    parsed = load_case(case)
    return parsed, make_problem(parsed, next((folder / "effects").glob("reduce-*")))


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--elements", type=int, default=10, help="elements a side of the contact")
    arguments.add_argument("--repeats", type=int, default=3)
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        case, problem = problem_of(asked.elements, Path(folder))
    solver = make_solver(case.solver)
    base = [cpu(lambda: solver.solve(problem)) for _ in range(asked.repeats)]
    plain = statistics.median(seconds for seconds, _ in base)
    print(f"{problem.interface.size} nodes, baseline from nothing: {plain:.2f} s")
    for names in SETS:
        measure(case, EffectModel.build(problem, [catalogue()[name]() for name in names]), plain, asked.repeats)


def measure(case, model, plain, repeats):
    solver, slow = make_solver(case.solver), model.initial()
    times = [cpu(lambda: solver.solve(model.problem(slow))) for _ in range(repeats)]
    own, period = statistics.median(seconds for seconds, _ in times), times[-1][1]
    print(f"{' + '.join(one.id for one in model.effects):<75} {own:.2f} s, {own / plain:.2f} of the baseline")
    parameters = [(one.id, name) for one in model.effects for name in one.priors() if getattr(one, name) is not None]
    seconds, _ = cpu(lambda: sensitivities(
        model.problem(slow), period, [effect_direction(model, slow, period, *one) for one in parameters],
        case.solver.resolved_harmonics))
    print(f"{'':<8}derivatives by their {len(parameters)} parameters: {seconds:.2f} s")


if __name__ == "__main__":
    main()
