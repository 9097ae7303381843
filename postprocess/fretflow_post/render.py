"""The pictures, curves and ParaView files of a run, made from its result files alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from fretflow.case.config import Output
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.core.store import read_record
from fretflow.pipeline.results import SIDES, RunRecords
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.archard import split_between_faces
from fretflow.wear.history import WearHistory
from numpy.typing import NDArray

from fretflow_post import curves, faces, paraview, specimens, style
from fretflow_post.contact_grid import state_shares
from fretflow_post.offscreen import require_offscreen
from fretflow_post.specimens import MeshedSpecimen

PANELS = 4  # pairs of worn faces on one picture


@dataclass(frozen=True)
class DrawnRun(RunRecords):
    """The records of a run, its meshes among them, and the case's wishes for pictures."""

    output: Output

    @cached_property
    def meshed(self) -> tuple[MeshedSpecimen, ...]:
        """Return the meshed upper and lower specimen."""
        mesh = self.folders["mesh"]
        return tuple(MeshedSpecimen(read_record(mesh / f"{side}_geometry.h5", MeshGeometry),
                                    read_record(mesh / f"{side}.h5", MeshSummary)) for side in SIDES)


def render_run(folders: Mapping[str, Path], out: Path, output: Output | None = None) -> list[Path]:
    """Draw everything that the complete stages of a run allow.

    Parameters
    ----------
    folders
        Result folder by stage name: mesh, reduce, preload, solve, wear, response; missing ones are left out.
    out
        Folder to write PNG pictures, CSV curves and the folder ``paraview`` to.
    output
        The case's wishes: which cycle counts to show.

    Returns
    -------
    list of Path
        The files written, pictures first.

    Raises
    ------
    PlatformError
        If nothing can draw without a display.
    StoreError
        If a result file is missing or damaged.
    """
    require_offscreen()
    run = DrawnRun(folders, output or Output())
    files: list[Path] = []
    if run.has("mesh"):
        files += [specimens.plot_specimens(out / "specimens.png", *run.meshed),
                  specimens.plot_contact_closeup(out / "contact_closeup.png", *run.meshed)]
    if run.has("reduce"):
        files += curves.plot_modes(out / "modes.png", *run.reduced)
    if run.has("reduce", "solve"):
        files += _contact_pictures(run, out)
    if run.has("reduce", "wear") and len(run.history.cycles) > 1:
        files += _wear_pictures(run, out)
    if run.responses:
        files += curves.plot_responses(out / "response.png", run.responses)
    if run.has("mesh", "reduce", "solve"):
        files += _paraview_files(run, out / "paraview")
    return sorted(files, key=lambda path: path.suffix != ".png")


def _contact_pictures(run: DrawnRun, out: Path) -> list[Path]:
    """Draw pressure, stick and slip, and loops of the kept periods."""
    first, last = min(run.periods), max(run.periods)
    files = [faces.plot_pressure(out / "pressure.png", run.nodes, run.areas, _pressures(run))]
    for cycles in sorted({first, last}):
        name = "unworn" if cycles == 0 else "worn"
        files.append(faces.plot_states(out / f"stick_slip_{name}.png", run.nodes, run.areas,
                                       state_shares(run.periods[cycles]), style.when_words(cycles)))
    shown = sorted({first, last, *run.output.loop_cycles} & set(run.periods))
    loops = [curves.loop_of(run.periods[cycles], run.areas, cycles) for cycles in shown]
    return files + curves.plot_loops(out / "loops.png", loops)


def _pressures(run: DrawnRun) -> list[faces.PressureMap]:
    """Return the pressure after the static load and over the first and the last period."""
    first, last = min(run.periods), max(run.periods)
    unworn = run.periods[first]
    moment = int(np.argmax(np.abs(unworn.friction_force)))
    maps = [faces.PressureMap("After the static load", run.static_pressure)] if run.has("preload") else []
    maps += [
        faces.PressureMap("Unworn, mean of the period", mean_pressure(unworn, run.areas)),
        faces.PressureMap("Unworn, at largest friction", unworn.force[moment, :, 2] / run.areas)]
    if last > first:
        title = f"{style.counted(last)} cycles, mean"
        maps.append(faces.PressureMap(title, mean_pressure(run.periods[last], run.areas)))
    return maps


def mean_pressure(period: PeriodicSolution, areas: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normal pressure averaged over `period` in Pa, (nodes,); `areas` in m^2."""
    return np.asarray(period.force[:, :, 2].mean(axis=0) / areas)


def shown_rows(history: WearHistory, asked: Sequence[int]) -> list[int]:
    """Return the rows of the history whose wear maps are shown: those `asked` for, and the last.

    When none is asked for, a tenth of the test stands beside its end.
    """
    end = int(history.cycles[-1])
    wanted = [c for c in asked if 0 < c < end] or ([end // 10] if len(history.cycles) > 2 else [])
    rows = {max(1, int(np.argmin(np.abs(history.cycles - c)))) for c in wanted}
    return sorted(rows | {len(history.cycles) - 1})


def _wear_pictures(run: DrawnRun, out: Path) -> list[Path]:
    """Draw the worn faces, up to four times on one picture and all on one scale, and the volume."""
    rows = shown_rows(run.history, run.output.wear_map_cycles)
    profiles = np.stack([specimen.profile for specimen in run.reduced])
    scale = faces.wear_scale(run.nodes, profiles, run.history, rows)
    files = []
    for page, start in enumerate(range(0, len(rows), PANELS)):
        name = "wear_depth.png" if len(rows) <= PANELS else f"wear_depth_{page + 1}.png"
        files.append(faces.plot_wear(out / name, run.nodes, profiles, run.history, rows[start:start + PANELS],
                                     scale))
    early = sorted({1, *rows})[:PANELS]
    files.append(faces.plot_wear_shape(out / "wear_shape.png", run.nodes, run.areas, run.history, early))
    return files + curves.plot_wear_volume(out / "wear_volume.png", run.history)


def _paraview_files(run: DrawnRun, out: Path) -> list[Path]:
    """Write both meshes with the last state of the contact, and the worn face over the cycles."""
    last = run.periods[max(run.periods)]
    shares = state_shares(last)
    depth = run.history.depth[-1] if run.has("wear") else np.zeros(len(run.areas))
    worn = split_between_faces(depth, run.history.upper_share if run.has("wear") else 0.5)
    files = []
    for side, specimen, own in zip(SIDES, run.meshed, worn, strict=True):
        files.append(paraview.write_specimen(out / f"{side}_specimen.vtu", specimen, {
            "wear_depth_um": own * 1e6, "mean_pressure_MPa": mean_pressure(last, run.areas) * 1e-6,
            "stick_percent": 100.0 * shares.stick, "slip_percent": 100.0 * shares.slip,
            "open_percent": 100.0 * shares.open}))
    if run.has("wear"):
        files.append(paraview.write_wear_series(out / "wear.pvd", run.nodes, run.history))
    return files
