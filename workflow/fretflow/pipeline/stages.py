"""The pipeline: all stages in their order, meshes and pictures as other packages provide them."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from fretflow.case.config import Case, load_case
from fretflow.core.errors import MeshError, StoreError
from fretflow.core.plugins import FIGURES, MESHES, provided
from fretflow.pipeline import preload, reduce, response, solve, wear
from fretflow.pipeline.stage import CASE_FILE, RUN_FILE, Figures, Manifest, Stage, StageContext, sum_of

PICTURES = "pictures"
FULL = 2**16  # bytes free, or fewer


def pipeline() -> tuple[Stage, ...]:
    """Return all stages in their order."""
    return (MESH, reduce.STAGE, preload.STAGE, solve.STAGE, wear.STAGE, response.STAGE, RENDER)


def _mesh_slice(case: Case) -> list[object]:
    """Return the geometry, and for the user's own meshes their content."""
    sides = (case.specimen.upper, case.specimen.lower)
    geometry = [side.model_dump(mode="json", exclude=reduce.MATERIAL) for side in sides]
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
    return {
        "upper_cells": upper.cells, "lower_cells": lower.cells, "contact_nodes": len(upper.contact_nodes),
        "upper_min_scaled_jacobian": upper.min_scaled_jacobian,
        "lower_min_scaled_jacobian": lower.min_scaled_jacobian}


def _render(context: StageContext) -> Figures:
    context.progress(0.0, "drawing")
    return {"files": len(provided(FIGURES, "run")(context.inputs, context.folder, context.case.output))}


MESH = Stage("mesh", 1, _mesh_slice, (), _mesh)
RENDER = Stage(
    "render", 1, lambda case: case.output, ("mesh", "reduce", "preload", "solve", "wear", "response"), _render
)


def render_run(home: Path) -> list[Path]:
    """Draw the run in `home` again, into ``home/pictures``, as far as its stages are complete.

    Raises
    ------
    StoreError
        If there is no run, or a result file is missing or damaged.
    """
    files: list[Path] = provided(FIGURES, "run")(complete_stages(home), home / PICTURES,
                                                 load_case(home / CASE_FILE).output)
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
