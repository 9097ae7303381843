"""The pictures, curves and ParaView files of a run, made from its result files alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from fretflow.case.config import Output
from fretflow.core.errors import InputError, did_you_mean
from fretflow.core.specimen_mesh import MeshGeometry
from fretflow.core.store import read_record
from fretflow.pipeline.ensemble import LocalPool, own_processes
from fretflow.pipeline.run_records import SIDES, RunRecords
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.archard import split_between_faces
from fretflow.wear.history import WearHistory
from numpy.typing import NDArray

from fretflow_post import curves, faces, paraview, specimens, style
from fretflow_post.contact_grid import state_shares
from fretflow_post.mode_shapes import plot_mode_shapes
from fretflow_post.offscreen import require_offscreen
from fretflow_post.period import plot_period
from fretflow_post.specimens import MeshedSpecimen

WORTH_A_PROCESS = 3  # pictures, which take as long as a process to start
PANELS = 4  # pairs of worn faces on one picture
NAMES = ("specimens", "contact_closeup", "modes", "mode_shapes", "pressure", "stick_slip_unworn", "stick_slip_worn",
         "loops", "period", "wear_depth", "wear_shape", "wear_volume", "response", "paraview")
Draw = Callable[[Path], Path | list[Path]]


@dataclass(frozen=True)
class DrawnRun(RunRecords):
    """The records of a run, its meshes among them, and the case's wishes for pictures."""

    output: Output

    @cached_property
    def meshed(self) -> tuple[MeshedSpecimen, ...]:
        """Return the meshed upper and lower specimen."""
        return tuple(MeshedSpecimen(read_record(self.folders["mesh"] / f"{side}_geometry.h5", MeshGeometry), summary)
                     for side, summary in zip(SIDES, self.meshes, strict=True))


def check_names(output: Output) -> None:
    """Refuse pictures that there are not.

    Raises
    ------
    InputError
        Naming the first, and those that there are.
    """
    wrong = [name for name in output.figures or () if name not in NAMES]
    if wrong:
        raise InputError(f"output.figures: {wrong[0]!r} is none of {', '.join(NAMES)}{did_you_mean(wrong[0], NAMES)}")


def render_run(folders: Mapping[str, Path], out: Path, output: Output | None = None) -> list[Path]:
    """Draw everything that the complete stages of a run allow.

    Parameters
    ----------
    folders
        Result folder by stage name: mesh, reduce, preload, solve, wear, response; missing ones are left out.
    out
        Folder to write pictures, CSV curves and the folder ``paraview`` to.
    output
        The case's wishes: which pictures in which formats, and which cycle counts to show.

    Returns
    -------
    list of Path
        The files written, pictures first.

    Raises
    ------
    InputError
        If a picture is asked for that there is not.
    PlatformError
        If nothing can draw without a display.
    StoreError
        If a result file is missing or damaged.
    """
    require_offscreen()  # of the processes that draw as well
    run = DrawnRun(folders, output or Output())
    check_names(run.output)
    names = [name for name, _ in _pictures(run) if run.output.figures is None or name in run.output.figures]
    processes = min(own_processes(), len(names) // WORTH_A_PROCESS)
    with style.saved_as(run.output.figure_formats), LocalPool(processes) as pool:
        files = [file for drawn in pool(_draw, [(run, name, out) for name in names]) for file in drawn]
    further = run.output.figure_formats[1:]
    files += [file.with_suffix(f".{suffix}") for file in files for suffix in further
              if file.suffix == f".{run.output.figure_formats[0]}"]
    return sorted(files, key=lambda path: path.suffix[1:] not in style.METADATA)


def _draw(call: tuple[DrawnRun, str, Path]) -> list[Path]:
    """Draw one picture of a run into a folder; return its files."""
    run, wanted, out = call
    with style.saved_as(run.output.figure_formats):
        drawn = next(draw for name, draw in _pictures(run) if name == wanted)(out / f"{wanted}.png")
    return [drawn] if isinstance(drawn, Path) else drawn


def _pictures(run: DrawnRun) -> Iterator[tuple[str, Draw]]:
    """Yield the name of each picture that the complete stages allow, and what draws it."""
    if run.has("mesh"):
        yield "specimens", lambda path: specimens.plot_specimens(path, *run.meshed)
        yield "contact_closeup", lambda path: specimens.plot_contact_closeup(path, *run.meshed)
    if run.has("reduce"):
        rig = run.rig_modes if run.has("solve") else None
        yield "modes", lambda path: curves.plot_modes(path, *run.reduced, rig)
    if run.has("mesh", "reduce"):
        yield "mode_shapes", lambda path: plot_mode_shapes(path, run.meshed, list(run.mode_shapes.values()))
    if run.has("reduce", "solve"):
        yield from _contact_pictures(run)
    if run.has("reduce", "wear") and len(run.history.cycles) > 1:
        yield from _wear_pictures(run)
    if run.responses:
        yield "response", lambda path: curves.plot_responses(path, run.responses)
    if run.has("mesh", "reduce", "solve"):
        yield "paraview", lambda path: _paraview_files(run, path.with_suffix(""))


def _contact_pictures(run: DrawnRun) -> Iterator[tuple[str, Draw]]:
    """Yield pressure, stick and slip, loops and the last of the kept periods."""
    first, last = min(run.periods), max(run.periods)
    yield "pressure", lambda path: faces.plot_pressure(path, run.nodes, run.areas, _pressures(run))
    for name, cycles in {"unworn": first, "worn": last}.items():
        if cycles or name == "unworn":
            yield f"stick_slip_{name}", partial(_stick_slip, run, cycles)
    shown = sorted({first, last, *run.output.loop_cycles} & set(run.periods))
    yield "loops", lambda path: curves.plot_loops(path, [
        curves.loop_of(run.periods[cycles], run.areas, cycles) for cycles in shown])
    yield "period", lambda path: plot_period(path, run.nodes, run.areas, run.periods[last], style.when_words(last))


def _stick_slip(run: DrawnRun, cycles: int, path: Path) -> Path:
    return faces.plot_states(path, run.nodes, run.areas, state_shares(run.periods[cycles]), style.when_words(cycles))


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


def _wear_pictures(run: DrawnRun) -> Iterator[tuple[str, Draw]]:
    """Yield the worn faces, up to four times on one picture and all on one scale, their shape and the volume."""
    rows = shown_rows(run.history, run.output.wear_map_cycles)
    profiles = np.stack([specimen.profile for specimen in run.reduced])

    def depths(path: Path) -> list[Path]:
        scale = faces.wear_scale(run.nodes, profiles, run.history, rows)
        pages = range(0, len(rows), PANELS)
        names = [path.name if len(pages) == 1 else f"{path.stem}_{page + 1}.png" for page in range(len(pages))]
        return [faces.plot_wear(path.with_name(name), run.nodes, profiles, run.history, rows[start:start + PANELS],
                                scale) for name, start in zip(names, pages, strict=True)]

    yield "wear_depth", depths
    early = sorted({1, *rows})[:PANELS]
    yield "wear_shape", lambda path: faces.plot_wear_shape(path, run.nodes, run.areas, run.history, early)
    yield "wear_volume", lambda path: curves.plot_wear_volume(path, run.history)


def _paraview_files(run: DrawnRun, out: Path) -> list[Path]:
    """Write both meshes with the last state of the contact, the last period, and the worn face over the cycles.

    Vectors on the meshes are those at the largest friction force.
    """
    last = run.periods[max(run.periods)]
    moment = int(np.argmax(np.abs(last.friction_force)))
    shares = state_shares(last)
    depth = run.history.depth[-1] if run.has("wear") else np.zeros(len(run.areas))
    worn = split_between_faces(depth, run.history.upper_share if run.has("wear") else 0.5)
    files = [paraview.write_modes(out / f"{side}_modes.vtu", specimen, run.mode_shapes[side])
             for side, specimen in zip(SIDES, run.meshed, strict=True)]
    for side, specimen, own, sign in zip(SIDES, run.meshed, worn, (1.0, -1.0), strict=True):
        files.append(paraview.write_specimen(out / f"{side}_specimen.vtu", specimen, {
            **paraview.period_fields(last, run.areas, moment, sign), "wear_depth_m": own,
            "mean_pressure_Pa": mean_pressure(last, run.areas),
            "stick_percent": 100.0 * shares.stick, "slip_percent": 100.0 * shares.slip,
            "open_percent": 100.0 * shares.open}))
    files.append(paraview.write_period_series(out / "period.pvd", run.nodes, run.areas, last))
    if run.has("wear"):
        files.append(paraview.write_wear_series(out / "wear.pvd", run.nodes, run.history))
    return files
