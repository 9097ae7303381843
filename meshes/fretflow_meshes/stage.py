"""The mesh stage: both specimens' meshes and what the later stages need to know of them."""

from __future__ import annotations

from pathlib import Path

from fretflow.case import config
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import write_record

from fretflow_meshes.specimen import Side, build_specimen, check_matching, mesh_geometry, read_specimen


def run_mesh(case: config.Case, out: Path) -> tuple[MeshSummary, MeshSummary]:
    """Make or read both meshes and write them to the folder `out`.

    Written for each side: ``<side>.msh``, ``<side>.h5`` (MeshSummary), ``<side>_geometry.h5`` (MeshGeometry).

    Returns
    -------
    tuple of MeshSummary
        The upper and the lower specimen's.

    Raises
    ------
    MeshError
        If a mesh cannot be made, read or used, or the contact nodes do not match.
    StoreError
        If a record cannot be written.
    """
    upper = _one(case.specimen.upper, case.mesh, case.mesh.upper, Side.UPPER, out)
    lower = _one(case.specimen.lower, case.mesh, case.mesh.lower, Side.LOWER, out)
    check_matching(upper, lower)
    return upper, lower


def _one(specimen: config.Specimen, mesh: config.Mesh, source: Path | None, side: Side, out: Path
         ) -> MeshSummary:
    path = out / f"{side}.msh"
    summary = (build_specimen(specimen, mesh, side, path) if source is None
               else read_specimen(source, specimen, mesh, side, path))
    write_record(out / f"{side}.h5", summary)
    write_record(out / f"{side}_geometry.h5", mesh_geometry(path))
    return summary
