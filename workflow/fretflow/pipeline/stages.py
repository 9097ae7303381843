"""The pipeline: all stages in their order, meshes and pictures as other packages provide them.

What a stage depends on besides its inputs is its slice of the case. Every MPI rank reduces specimens; the preload is
the pressure before anything moves, the solved period that of the unworn joint.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fretflow.case.config import Case, PreloadContact, load_case
from fretflow.core.errors import MeshError, StoreError
from fretflow.core.plugins import FIGURES, MESHES, provided
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import read_record, write_record
from fretflow.pipeline import response
from fretflow.pipeline.ensemble import LocalPool, own_processes
from fretflow.pipeline.estimate import check_memory, reductions_at_once
from fretflow.pipeline.stage import CASE_FILE, CHECKPOINTS, RUN_FILE, Figures, Manifest, Stage, StageContext, sum_of
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen

if TYPE_CHECKING:
    from fretflow.solvers.periodic import PeriodicProblem
    from fretflow.structure.fem.preload import Preload

PICTURES = "pictures"
FULL = 2**16  # bytes free, or fewer
SIDES = ("upper", "lower")
WORTH_A_PROCESS = 20_000  # DOF of a specimen, reduced in 4 s where a process takes 2 s to start
MATERIAL = {"youngs_modulus", "poissons_ratio", "density"}


def pipeline() -> tuple[Stage, ...]:
    """Return all stages in their order."""
    return (MESH, REDUCE, PRELOAD, SOLVE, WEAR, response.STAGE, RENDER)


def _mesh_slice(case: Case) -> list[object]:
    """Return the geometry, and for the user's own meshes their content."""
    sides = (case.specimen.upper, case.specimen.lower)
    geometry = [side.model_dump(mode="json", exclude=MATERIAL) for side in sides]
    own = [
        hashlib.sha256(path.read_bytes()).hexdigest() for path in (case.mesh.upper, case.mesh.lower) if path
    ]
    return [geometry, case.mesh.model_dump(mode="json", exclude={"upper", "lower"}), own]


def _mesh(context: StageContext) -> Figures:
    context.progress(0.0, "meshing the specimens")
    try:
        upper, lower = provided(MESHES, "specimens")(context.case, context.folder)
    except MeshError as error:
        if shutil.disk_usage(context.folder).free > FULL:  # gmsh does not notice a full disk: it cannot read back
            raise
        raise StoreError(f"{context.folder}: the disk is full; free some space or choose another --out") from error
    if context.case.mesh.upper is not None:  # of a mesh that is made the case told the nodes before
        check_memory(context.case, ("reduce", "solve"), len(upper.contact_nodes))
    return {
        "upper_cells": upper.cells, "lower_cells": lower.cells, "contact_nodes": len(upper.contact_nodes),
        "upper_min_scaled_jacobian": upper.min_scaled_jacobian,
        "lower_min_scaled_jacobian": lower.min_scaled_jacobian}


MESH = Stage("mesh", 1, _mesh_slice, (), _mesh)


def _reduce_slice(case: Case) -> list[object]:
    materials = [getattr(case.specimen, side).model_dump(include=MATERIAL) for side in SIDES]
    return [materials, case.reduction]


def _reduce(context: StageContext) -> Figures:
    """Write ``upper.h5`` and ``lower.h5`` (ReducedSpecimen), ``upper_modes.h5`` and ``lower_modes.h5`` (ModeShapes)."""
    import fretflow.structure.reduction.reduce  # noqa: F401 - the manifest names the libraries that it loads

    context.progress(0.0, "reducing the specimens")
    sides = _reduced_sides(context.case)
    calls = [(context.case, side, context.inputs["mesh"], context.folder, context.comm) for side in sides]
    with LocalPool(_at_once(context)) as pool:
        by_side = pool(_reduce_side, calls)
    if by_side[0] and len(sides) < len(SIDES):
        by_side.append(_turned_over(*SIDES, context.inputs["mesh"], context.folder))
    return {name: value for figures in by_side for name, value in figures.items()}


def _reduced_sides(case: Case) -> tuple[str, ...]:
    """Return the specimens that are reduced: the lower one not where it is the upper one, turned over."""
    alike = case.specimen.upper == case.specimen.lower and case.mesh.upper is None and case.mesh.lower is None
    return SIDES[:1] if alike else SIDES


def _at_once(context: StageContext) -> int:
    """Return how many specimens are reduced at once, each in a process of its own if not one.

    Both, where they are worth it, memory and threads are there for both, and no other process shares this one's work.
    """
    meshes = [read_record(context.inputs["mesh"] / f"{side}.h5", MeshSummary)
              for side in _reduced_sides(context.case)]
    fitting = reductions_at_once([3 * mesh.nodes for mesh in meshes])
    worth = min(3 * mesh.nodes for mesh in meshes) >= WORTH_A_PROCESS
    return min(fitting, own_processes()) if worth else 1


def _reduce_side(call: tuple[Case, str, Path, Path, Any]) -> Figures:
    """Reduce one specimen of a case, meshed in one folder, into another one; on all ranks of a communicator."""
    from mpi4py import MPI

    from fretflow.structure.reduction.reduce import reduce_specimen

    case, side, meshes, folder, comm = call
    summary = read_record(meshes / f"{side}.h5", MeshSummary)
    reduced = reduce_specimen(meshes / summary.file, summary, getattr(case.specimen, side), case.reduction,
                              case.mesh.degree, comm or MPI.COMM_SELF)
    return _written(side, folder, *reduced) if reduced is not None else {}


def _turned_over(made: str, side: str, meshes: Path, folder: Path) -> Figures:
    """Write one side's specimen as the other's, which was reduced into `folder`, turned over."""
    reduced, shapes = (read_record(folder / f"{made}.h5", ReducedSpecimen),
                       read_record(folder / f"{made}_modes.h5", ModeShapes))
    summary = read_record(meshes / f"{side}.h5", MeshSummary)
    return _written(side, folder, reduced.turned_over(summary.contact_nodes), shapes.turned_over())


def _written(side: str, folder: Path, reduced: ReducedSpecimen, shapes: ModeShapes) -> Figures:
    write_record(folder / f"{side}.h5", reduced)
    write_record(folder / f"{side}_modes.h5", shapes)
    return {f"{side}_full_dofs": reduced.full_dofs, f"{side}_frequency_error": float(reduced.frequency_error.max())}


REDUCE = Stage("reduce", 2, _reduce_slice, ("mesh",), _reduce, collective=True)


def _preload_slice(case: Case) -> list[object]:
    frictional = case.contact.preload is PreloadContact.FRICTIONAL
    return [case.test.normal_load, case.contact.preload, case.contact.friction_coefficient if frictional else None,
            case.effects]


def _preload(context: StageContext) -> Figures:
    """Write ``preload.h5`` (Preload)."""
    from fretflow.pipeline.problem import make_model

    context.progress(0.0, "pressing the specimens together")
    model = make_model(context.case, context.inputs["reduce"])
    problem = model.problem(model.initial())
    preload = _press_with_friction(problem) if problem.preload.frictional else _press_without_friction(problem)
    write_record(context.folder / "preload.h5", preload)
    return {
        "load_N": float(preload.force.sum()),
        "largest_pressure_Pa": float(preload.pressure.max()),
        "area_in_contact_m2": float(problem.interface.areas[preload.force > 0.0].sum()),
    }


def _press_without_friction(problem: PeriodicProblem) -> Preload:
    from fretflow.structure.fem.preload import frictionless_preload

    flexibility = problem.boundary.flexibility[2::3, 2::3]
    return frictionless_preload(flexibility, problem.interface.gap, problem.interface.areas, problem.normal_load)


def _press_with_friction(problem: PeriodicProblem) -> Preload:
    from fretflow.solvers.quasi_static.march import press
    from fretflow.structure.fem.preload import Preload

    pressed, interface = press(problem), problem.interface
    normal, lift = pressed.force[2::3], pressed.displacement[2::3]
    boundary, still = problem.boundary, np.zeros((1, problem.boundary.size))
    approach = boundary.free_motion(still, pressed.displacement[None], problem.loads_at(np.zeros(1)))
    return Preload(force=normal.copy(), pressure=normal / interface.areas, gap=interface.gap + lift,
                   approach=-float(approach[0, 0]))


PRELOAD = Stage("preload", 2, _preload_slice, ("reduce",), _preload)


def _solve_slice(case: Case) -> list[object]:
    excitation = case.test.model_dump(include={"excitation_frequency", "excitation_amplitude", "normal_load"})
    return [excitation, case.rig, case.contact.friction_coefficient, case.solver, case.effects]


def _solve(context: StageContext) -> Figures:
    """Write ``solution.h5`` (PeriodicSolution) and ``rig_modes.h5`` (RigModes)."""
    from fretflow.contact.kernels.march import march
    from fretflow.core.compiled import is_compiled
    from fretflow.pipeline.problem import make_model
    from fretflow.solvers.quasi_static.solver import sliding_distance
    from fretflow.solvers.solve import make_solver
    from fretflow.structure.two_mass_rig.lumped import RigModes

    context.progress(0.0, "finding the steady period" if is_compiled(march) else
                     "compiling the inner loops, once")
    model = make_model(context.case, context.inputs["reduce"])
    problem = model.problem(model.initial())
    solution = make_solver(context.case.solver, estimate_error=True).solve(problem)
    write_record(context.folder / "solution.h5", solution)
    write_record(context.folder / "rig_modes.h5", RigModes.of(problem.boundary))
    return {"method": solution.method, "iterations": len(solution.residual_history) - 1,
            "residual": solution.residual_history[-1],
            "sliding_distance_m": sliding_distance(solution, problem.interface),
            "relative_error": solution.error_estimate}


SOLVE = Stage("solve", 4, _solve_slice, ("reduce",), _solve)


def _stops(case: Case) -> tuple[int, ...]:
    """Return the cycle counts to land on, ascending, besides the end."""
    asked = {*case.output.loop_cycles, *case.output.wear_map_cycles}
    return tuple(sorted(asked - {0, case.test.total_cycles}))


def _wear_slice(case: Case) -> list[object]:
    return [case.wear, case.test.total_cycles, list(_stops(case)), case.effects]


def _wear(context: StageContext) -> Figures:
    """Write ``history.h5`` (WearHistory) and, in ``checkpoints``, the period at each asked cycle count."""
    from fretflow.effects.catalogue import parse_effects
    from fretflow.effects.cycle import march_wear
    from fretflow.pipeline.problem import make_problem
    from fretflow.solvers.solve import make_solver
    from fretflow.wear.archard import Archard

    case = context.case
    history = march_wear(
        make_problem(case, context.inputs["reduce"]), Archard(case.wear.coefficient, upper_share=case.wear.upper_share),
        case.test.total_cycles, effects=parse_effects(case.effects),
        solver=make_solver(case.solver, keeps_tangents=True), folder=context.folder / CHECKPOINTS,
        scheme=case.wear.scheme, stops=_stops(case), tolerance=case.wear.tolerance,
        max_depth_per_jump=case.wear.max_depth_per_jump, vanishing_rate=case.wear.vanishing_rate,
        progress=lambda done, asked: context.progress(done / max(asked, 1), f"{done:,} of {asked:,} cycles"))
    write_record(context.folder / "history.h5", history)
    return {"jumps": len(history.cycles) - 1, "solutions": history.solves, "stopped_by": history.stopped_by,
            "shortened_jumps": history.shortened_jumps, "volume_m3": float(history.volume[-1]),
            "largest_depth_m": float(history.depth[-1].max())}


WEAR = Stage("wear", 3, _wear_slice, ("reduce", "solve"), _wear)


def _render(context: StageContext) -> Figures:
    context.progress(0.0, "drawing")
    return {"files": len(provided(FIGURES, "run")(context.inputs, context.folder, context.case.output))}


RENDER = Stage("render", 1, lambda case: case.output, ("mesh", "reduce", "preload", "solve", "wear", "response"),
               _render)


def render_run(home: Path, figures: Sequence[str] = (), formats: Sequence[str] = ()) -> list[Path]:
    """Draw the run in `home` again, into ``home/pictures``, as far as its stages are complete.

    Parameters
    ----------
    home
        Folder of the run.
    figures, formats
        Pictures by name, and their formats; the case's wishes where they are not given.

    Raises
    ------
    InputError
        If there is no such picture or format.
    StoreError
        If there is no run, or a result file is missing or damaged.
    """
    asked = {name: tuple(given) for name, given in (("figures", figures), ("figure_formats", formats)) if given}
    folders = complete_stages(home)
    output = load_case(home / CASE_FILE).output.model_copy(update=asked)
    files: list[Path] = provided(FIGURES, "run")(folders, home / PICTURES, output)
    return files


def complete_stages(home: Path) -> dict[str, Path]:
    """Return the folder of each complete stage of the run in `home`, its files checked.

    Raises
    ------
    StoreError
        If there is no run, or a result file is missing or damaged.
    """
    try:
        content = json.loads((home / RUN_FILE).read_text(encoding="utf-8"))
        folders = {stage: home / Path(folder).name for stage, folder in content["stages"].items()}
        same = "case_sum" not in content or content["case_sum"] == sum_of(home / CASE_FILE)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        if (home / "backbone.csv").is_file():
            raise StoreError(f"{home}: is of a bolted structure, whose curves are backbone.csv and responses.csv; "
                             "run its case with other forces for others") from error
        raise StoreError(
            f"{home}: holds no run ({RUN_FILE} is missing or damaged); give a folder such as runs/test1, "
            "made by `fretflow run`"
        ) from error
    if not same:
        raise StoreError(f"{home / CASE_FILE}: changed since the run, or of another one; run the case again")
    manifests = {stage: Manifest.read(folder) for stage, folder in folders.items()}
    for stage, manifest in manifests.items():
        manifest.check_inputs(folders[stage], {name: manifests[name] for name in manifest.inputs if name in manifests})
    return folders
