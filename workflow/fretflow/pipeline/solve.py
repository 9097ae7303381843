"""The solve stage: the steady period of the unworn joint, with the error of its sliding distance."""

from __future__ import annotations

from fretflow.case.config import Case
from fretflow.core.store import write_record
from fretflow.pipeline.stage import Figures, Stage, StageContext


def _slice(case: Case) -> list[object]:
    excitation = case.test.model_dump(include={"excitation_frequency", "excitation_amplitude", "normal_load"})
    return [excitation, case.rig, case.contact.friction_coefficient, case.solver, case.effects]


def _run(context: StageContext) -> Figures:
    """Write ``solution.h5`` (PeriodicSolution)."""
    from fretflow.pipeline.problem import make_model, make_solver
    from fretflow.solvers.quasi_static.solver import sliding_distance

    context.progress(0.0, "finding the steady period")
    model = make_model(context.case, context.inputs["reduce"])
    problem = model.problem(model.initial())
    solution = make_solver(context.case.solver, estimate_error=True).solve(problem)
    write_record(context.folder / "solution.h5", solution)
    return {"method": solution.method, "iterations": len(solution.residual_history) - 1,
            "residual": solution.residual_history[-1],
            "sliding_distance_m": sliding_distance(solution, problem.interface),
            "relative_error": solution.error_estimate}


STAGE = Stage("solve", 3, _slice, ("reduce",), _run)
