"""Files for ParaView: both meshes, and the contact face over the cycles and over a period; all in SI, units in names.

Vectors of the contact are of the upper specimen: its displacement relative to the lower one, and the traction on it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pyvista as pv
from fretflow.core.records import Array
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ModeShapes
from fretflow.wear.archard import split_between_faces
from fretflow.wear.history import WearHistory
from numpy.typing import NDArray

from fretflow_post.contact_grid import contact_cells
from fretflow_post.scene import hexahedra
from fretflow_post.specimens import MeshedSpecimen

Fields = Mapping[str, NDArray[Any]]


def write_specimen(path: Path, specimen: MeshedSpecimen, fields: Fields) -> Path:
    """Write a specimen's mesh as VTU, with `fields` of its contact nodes and nan elsewhere.

    Parameters
    ----------
    path
        VTU to write.
    specimen
        Mesh and summary.
    fields
        Values of the contact nodes, (contact nodes,) or (contact nodes, 3), by array name with unit, such as
        ``wear_depth_m``.
    """
    grid = hexahedra(specimen.geometry.points, specimen.geometry.hexahedra)
    points = specimen.contact_points()
    here = points >= 0
    inside = np.zeros(grid.n_points, dtype=np.uint8)
    inside[points[here]] = 1
    grid.point_data["contact_face"] = inside
    for name, values in fields.items():
        spread = np.full((grid.n_points, *values.shape[1:]), np.nan)
        spread[points[here]] = values[here]
        grid.point_data[name] = spread
    return _save(grid, path)


def write_modes(path: Path, specimen: MeshedSpecimen, modes: ModeShapes) -> Path:
    """Write a specimen's mesh as VTU with each natural mode as a vector, its largest displacement 1, for warping."""
    grid, shapes = hexahedra(specimen.geometry.points, specimen.geometry.hexahedra), specimen.at_points(modes)
    for number, (frequency, shape) in enumerate(zip(modes.frequency, shapes, strict=True), 1):
        grid.point_data[f"mode_{number:02d}_{frequency:.0f}_Hz"] = shape
    return _save(grid, path)


def period_fields(period: PeriodicSolution, areas: Array, sample: int, sign: float = 1.0) -> dict[str, NDArray[Any]]:
    """Return motion and traction at a sample, of the lower specimen with `sign` -1; `areas` are (nodes,) in m^2."""
    return {"relative_displacement_m": sign * period.displacement[sample],
            "traction_Pa": sign * period.force[sample] / areas[:, None]}


def write_contact_face(path: Path, nodes: Array, fields: Fields) -> Path:
    """Write the contact face as VTU with `fields` of its nodes; `nodes` (nodes, 2) in m."""
    cells = contact_cells(nodes)
    kind = pv.CellType.QUAD if cells.shape[1] == 4 else pv.CellType.TRIANGLE
    connectivity = np.insert(cells, 0, cells.shape[1], axis=1).ravel()
    grid = pv.UnstructuredGrid(connectivity, np.full(len(cells), kind, dtype=np.uint8),
                               np.column_stack([nodes, np.zeros(len(nodes))]))
    for name, values in fields.items():
        grid.point_data[name] = values
    return _save(grid, path)


def write_wear_series(path: Path, nodes: Array, history: WearHistory) -> Path:
    """Write the PVD `path` and beside it the contact face at every row of the history; time is in cycles."""
    def worn(row: int) -> Fields:
        upper, lower = split_between_faces(history.depth[row], history.upper_share)
        zero = np.zeros(len(upper))
        return {"wear_depth_m": history.depth[row], "wear_depth_upper_m": upper, "wear_depth_lower_m": lower,
                "wear_rate_m_per_cycle": history.rate[row], "wear_of_upper_m": np.column_stack([zero, zero, upper]),
                "wear_of_lower_m": np.column_stack([zero, zero, -lower])}

    return _write_series(path, nodes, history.cycles, map(worn, range(len(history.cycles))))


def write_period_series(path: Path, nodes: Array, areas: Array, period: PeriodicSolution) -> Path:
    """Write the PVD `path` and beside it the contact face at every sample of `period`; time is in s.

    The state of a node is that of `ContactState`: 0 sticks, 1 slips, 2 is open.
    """
    return _write_series(path, nodes, period.time, (
        {**period_fields(period, areas, k), "state": state} for k, state in enumerate(period.state)))


def _write_series(path: Path, nodes: Array, times: NDArray[Any], moments: Iterable[Fields]) -> Path:
    folder = path.with_suffix("")
    files = [write_contact_face(folder / f"{row:04d}.vtu", nodes, fields) for row, fields in enumerate(moments)]
    rows = [f'    <DataSet timestep="{time}" part="0" file={quoteattr(f"{folder.name}/{file.name}")}/>'
            for time, file in zip(times.tolist(), files, strict=True)]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>", *rows,
             "  </Collection>", "</VTKFile>", ""]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _save(grid: Any, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    grid.save(path)
    return path
