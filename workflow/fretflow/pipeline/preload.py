"""The preload stage: the pressure of the static load, before anything moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fretflow.case.config import Case, PreloadContact
from fretflow.core.store import write_record
from fretflow.pipeline.stage import Figures, Stage, StageContext

if TYPE_CHECKING:
    from fretflow.solvers.periodic import PeriodicProblem
    from fretflow.structure.fem.preload import Preload


def _slice(case: Case) -> list[object]:
    frictional = case.contact.preload is PreloadContact.FRICTIONAL
    return [case.test.normal_load, case.contact.preload, case.contact.friction_coefficient if frictional else None,
            case.effects]


def _run(context: StageContext) -> Figures:
    """Write ``preload.h5`` (Preload)."""
    from fretflow.pipeline.problem import make_model

    context.progress(0.0, "pressing the specimens together")
    model = make_model(context.case, context.inputs["reduce"])
    problem = model.problem(model.initial())
    found = _with_friction(problem) if problem.preload.frictional else _without_friction(problem)
    write_record(context.folder / "preload.h5", found)
    return {
        "load_N": float(found.force.sum()),
        "largest_pressure_Pa": float(found.pressure.max()),
        "area_in_contact_m2": float(problem.interface.areas[found.force > 0.0].sum()),
    }


def _without_friction(problem: PeriodicProblem) -> Preload:
    from fretflow.structure.fem.preload import frictionless_preload

    flexibility = problem.boundary.flexibility[2::3, 2::3]
    return frictionless_preload(flexibility, problem.interface.gap, problem.interface.areas, problem.normal_load)


def _with_friction(problem: PeriodicProblem) -> Preload:
    from fretflow.solvers.quasi_static.solver import press
    from fretflow.structure.fem.preload import Preload

    pressed, interface = press(problem), problem.interface
    normal, lift = pressed.force[2::3], pressed.displacement[2::3]
    boundary, still = problem.boundary, np.zeros((1, problem.boundary.size))
    approach = boundary.free_motion(still, pressed.displacement[None], problem.loads_at(np.zeros(1)))
    return Preload(force=normal.copy(), pressure=normal / interface.areas, gap=interface.gap + lift,
                   approach=-float(approach[0, 0]))


STAGE = Stage("preload", 2, _slice, ("reduce",), _run)
