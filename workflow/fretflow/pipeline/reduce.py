"""The reduce stage: both specimens' meshes to Craig-Bampton matrices, with every MPI rank."""

from __future__ import annotations

from fretflow.case.config import Case
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import read_record, write_record
from fretflow.pipeline.stage import Figures, Stage, StageContext

SIDES = ("upper", "lower")


def _slice(case: Case) -> list[object]:
    materials = [getattr(case.specimen, side).model_dump(include=MATERIAL) for side in SIDES]
    return [materials, case.reduction]


MATERIAL = {"youngs_modulus", "poissons_ratio", "density"}


def _run(context: StageContext) -> Figures:
    """Write ``upper.h5`` and ``lower.h5`` (ReducedSpecimen)."""
    from mpi4py import MPI

    from fretflow.structure.reduction.reduce import reduce_specimen

    case, meshes = context.case, context.inputs["mesh"]
    figures: dict[str, float | int | str | None] = {}
    for index, side in enumerate(SIDES):
        context.progress(index / len(SIDES), f"reducing the {side} specimen")
        summary = read_record(meshes / f"{side}.h5", MeshSummary)
        reduced = reduce_specimen(
            meshes / summary.file,
            summary,
            getattr(case.specimen, side),
            case.reduction,
            case.mesh.degree,
            context.comm or MPI.COMM_SELF,
        )
        if reduced is not None:
            write_record(context.folder / f"{side}.h5", reduced)
            figures[f"{side}_full_dofs"] = reduced.full_dofs
            figures[f"{side}_frequency_error"] = float(reduced.frequency_error.max())
    return figures


STAGE = Stage("reduce", 1, _slice, ("mesh",), _run, collective=True)
