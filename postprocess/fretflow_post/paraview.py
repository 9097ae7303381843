"""Files for ParaView: both meshes, and the contact face over the cycles; lengths in mm, units in names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pyvista as pv
from fretflow.wear.archard import split_between_faces
from fretflow.wear.history import WearHistory
from numpy.typing import NDArray

from fretflow_post.contact_grid import contact_cells
from fretflow_post.scene import hexahedra
from fretflow_post.specimens import MeshedSpecimen

MM, UM, NM = 1e3, 1e6, 1e9


def write_specimen(path: Path, specimen: MeshedSpecimen, fields: Mapping[str, NDArray[np.float64]]) -> Path:
    """Write a specimen's mesh as VTU, with `fields` of its contact nodes and nan elsewhere.

    Parameters
    ----------
    path
        VTU to write.
    specimen
        Mesh and summary.
    fields
        Values of the contact nodes, (contact nodes,), by array name with unit, such as ``wear_depth_um``.
    """
    grid = hexahedra(specimen.geometry.points * MM, specimen.geometry.hexahedra)
    points = specimen.contact_points()
    here = points >= 0
    inside = np.zeros(grid.n_points, dtype=np.uint8)
    inside[points[here]] = 1
    grid.point_data["contact_face"] = inside
    for name, values in fields.items():
        spread = np.full(grid.n_points, np.nan)
        spread[points[here]] = values[here]
        grid.point_data[name] = spread
    return _save(grid, path)


def write_contact_face(path: Path, nodes: NDArray[np.float64], fields: Mapping[str, NDArray[Any]]) -> Path:
    """Write the contact face as VTU with `fields` of its nodes; `nodes` (nodes, 2) in m."""
    cells = contact_cells(nodes)
    kind = pv.CellType.QUAD if cells.shape[1] == 4 else pv.CellType.TRIANGLE
    connectivity = np.insert(cells, 0, cells.shape[1], axis=1).ravel()
    grid = pv.UnstructuredGrid(connectivity, np.full(len(cells), kind, dtype=np.uint8),
                               np.column_stack([nodes * MM, np.zeros(len(nodes))]))
    for name, values in fields.items():
        grid.point_data[name] = values
    return _save(grid, path)


def write_wear_series(path: Path, nodes: NDArray[np.float64], history: WearHistory) -> Path:
    """Write the PVD `path` and beside it the contact face at every row of the history; time is in cycles."""
    folder = path.with_suffix("")
    files = []
    for row, depth in enumerate(history.depth):
        upper, lower = split_between_faces(depth, history.upper_share)
        zero = np.zeros(len(depth))
        files.append(write_contact_face(folder / f"{row:04d}.vtu", nodes, {
            "wear_depth_um": depth * UM, "wear_depth_upper_um": upper * UM, "wear_depth_lower_um": lower * UM,
            "wear_rate_nm_per_cycle": history.rate[row] * NM,
            "wear_of_upper_mm": np.column_stack([zero, zero, upper * MM]),
            "wear_of_lower_mm": np.column_stack([zero, zero, -lower * MM])}))
    rows = [f'    <DataSet timestep="{int(cycles)}" part="0" file={quoteattr(f"{folder.name}/{file.name}")}/>'
            for cycles, file in zip(history.cycles, files, strict=True)]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>", *rows,
             "  </Collection>", "</VTKFile>", ""]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _save(grid: Any, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    grid.save(path)
    return path
