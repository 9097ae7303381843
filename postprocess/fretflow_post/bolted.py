"""Pictures of a bolted structure: its mesh with the bolts, its contact, its curves, and its faces after wear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from fretflow.core.records import Array
from fretflow.core.units import readable_unit
from fretflow.pipeline.bolted import JointStudy
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fretflow_post import style
from fretflow_post.curves import readable_log
from fretflow_post.offscreen import require_offscreen
from fretflow_post.scene import Layer, View, shoot, surface

STATES = ("sticks", "slides", "opens at times", "stays open")
STATE_COLOURS = (style.BLUE, style.YELLOW, style.ORANGE, "#F2F2F2")
ROUND_OFF = 1e-9  # of a damping ratio by friction; below, nothing slides
APART = 1.2  # heights of the bodies by which they are drawn apart
LOOK = (-0.55, -1.0, 0.75)  # from the bodies to the eye


def draw_study(study: JointStudy, folder: Path) -> list[Path]:
    """Draw ``structure.png`` (where there is a mesh), ``contact.png`` and ``curves.png`` and return the files."""
    with style.styled():
        files = [style.save_figure(_contact(study), folder / "contact.png"),
                 style.save_figure(_curves(study), folder / "curves.png")]
        if study.surfaces is not None:
            files.insert(0, style.save_figure(_structure(study), folder / "structure.png"))
    return files


def _structure(study: JointStudy) -> Figure:
    """Return the whole mesh, and its joint with the bodies drawn apart and the pressure on the lower face."""
    require_offscreen()
    points, bodies, faces = study.surfaces  # type: ignore[misc]  # asked before
    points = 1e3 * points
    load = f"{1e-3 * study.joint.bolt_load:.3g} kN"
    bolts = f"the bolt and its pressure at {load}" if len(study.bolts) == 1 else (
        f"{len(study.bolts)} bolts and their pressure at {load} each")
    figure = style.new_figure(study.title, f"mesh, {bolts}; below, the bodies drawn apart")
    shanks = [_shank(points, faces[one.head], faces[one.nut]) for one in study.bolts]
    mesh = [Layer(surface(points, cells), {"color": colour, "show_edges": True, "edge_color": style.EDGE_COLOUR})
            for cells, colour in zip(bodies.values(), (style.LOWER_COLOUR, style.UPPER_COLOUR) * len(bodies),
                                     strict=False)]
    metal = {"color": style.VERMILLION, "smooth_shading": True}
    whole = np.stack([points.min(axis=0), points.max(axis=0)])
    _show(figure, (0.02, 0.52, 0.96, 0.36), [*mesh, *(Layer(one, metal) for one in shanks)], whole)
    around = 1e3 * study.joint.structure.points
    near = np.stack([around.min(axis=0), around.max(axis=0)])
    near += 0.15 * np.ptp(near, axis=0).max() * np.array([[-1.0], [1.0]])
    lift = APART * np.ptp(points[:, 2]) * np.array([0.0, 0.0, 1.0])
    lowest = min(bodies, key=lambda name: float(points[_over(points, bodies[name], near)][:, :, 2].mean()))
    layers = []
    for name, cells in bodies.items():
        up = name != lowest
        layers.append(Layer(surface(points + lift if up else points, _over(points, cells, near)), {
            "color": style.UPPER_COLOUR if up else style.LOWER_COLOUR, "show_edges": True,
            "edge_color": style.EDGE_COLOUR}))
    facets, pressure = _facets(study), _pressure(study)
    top, ticks = style.round_scale(1e-6 * float(pressure.max()))
    drawn = surface(1e3 * facets.reshape(-1, 3) + [0.0, 0.0, 0.05], np.arange(4 * len(facets)).reshape(-1, 4),
                    pressure=1e-6 * pressure)
    layers.append(Layer(drawn, {"scalars": "pressure", "cmap": style.PRESSURE_MAP, "clim": (0.0, top)}))
    near[1] += lift
    _show(figure, (0.02, 0.03, 0.86, 0.46), layers, near)
    style.add_colour_bar(figure, figure.add_axes((0.9, 0.1, 0.018, 0.32)), style.PRESSURE_MAP, ticks, "pressure (MPa)")
    return figure


def _show(figure: Figure, place: tuple[float, float, float, float], layers: list[Layer], bounds: Array) -> None:
    size = tuple(round(edge * pixels) for edge, pixels in zip(place[2:], (100 * style.WIDTH, 100 * style.HEIGHT),
                                                              strict=True))
    axes = figure.add_axes(place)
    axes.imshow(shoot(layers, View(bounds, LOOK, (0.0, 0.0, 1.0), (size[0], size[1]), margin=0.03)))
    axes.axis("off")


def _over(points: Array, cells: NDArray[np.int64], box: Array) -> NDArray[np.int64]:
    """Return those of the cells (k, 4) whose middle lies over the box (2, 3)."""
    middle = points[cells].mean(axis=1)[:, :2]
    return np.asarray(cells[np.all((middle > box[0, :2]) & (middle < box[1, :2]), axis=1)])


def _shank(points: Array, head: NDArray[np.int64], nut: NDArray[np.int64]) -> pv.PolyData:
    """Return a bolt as a cylinder as wide as the faces under its ends, mm, a little longer than its grip."""
    ends = [points[np.unique(face)] for face in (head, nut)]
    middle = [one.mean(axis=0) for one in ends]
    along = middle[0] - middle[1]
    radius = float(np.linalg.norm(ends[0] - middle[0], axis=1).max())
    return pv.Cylinder(center=0.5 * (middle[0] + middle[1]), direction=along, radius=0.9 * radius,
                       height=float(np.linalg.norm(along)) + radius)


def _pressure(study: JointStudy) -> Array:
    return np.asarray(study.joint.preloaded.force[0, 2::3] / study.joint.structure.areas)


def _facets(study: JointStudy) -> Array:
    """Return the corners (m, 4, 3) of the contact points' facets in m: of the mesh, or squares of their areas."""
    own = study.joint.structure
    if study.surfaces is not None:
        points, _, faces = study.surfaces
        every = np.vstack(list(faces.values()))
        distance, place = cKDTree(points[every].mean(axis=1)).query(own.points)
        if float(distance.max(initial=0.0)) < float(np.sqrt(own.areas.max())):
            return np.asarray(points[every[place]])
    half = 0.5 * np.sqrt(own.areas)[:, None, None]
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return np.asarray(own.points[:, None] + half * corners)


def _contact(study: JointStudy) -> Figure:
    """Return maps of pressure, state, opening and slip; after wear also of its depth and the pressure then."""
    cycle, joint = study.largest_cycle, study.joint
    slid = cycle.slid.reshape(len(cycle.slid), -1, 3)
    path = np.where(cycle.state[1:] < 2, np.hypot(*np.moveaxis(np.diff(slid[:, :, :2], axis=0), 2, 0)), 0.0).sum(axis=0)
    opening = np.maximum(slid[:, :, 2] + joint.clearance, 0.0).max(axis=0)
    maps = [("pressure of the bolts", _pressure(study), "Pa", style.PRESSURE_MAP), None,
            ("largest gap in that cycle", opening, "m", style.SHARE_MAP),
            ("slip path of that cycle", path, "m", style.DEPTH_MAP)]
    if study.worn is not None and study.worn_preload is not None:
        when = style.when_words(int(study.worn.cycles[-1]))
        maps += [(f"worn depth, {when}", study.worn.depth[-1], "m", style.DEPTH_MAP),
                 (f"pressure, tightened anew, {when}", study.worn_preload.force[0, 2::3] / joint.structure.areas, "Pa",
                  style.PRESSURE_MAP)]
    tip = 1e6 * abs(float(study.curve.outputs[-1, 0])) if study.curve.outputs.size else 0.0
    words = f"{study.curve.output_names[0]} at {tip:.3g} µm" if tip else "the largest amplitude"
    figure = style.new_figure(study.title, f"contact in its plane, mm; states, gap and slip in a cycle with {words}")
    rows = len(maps) // 2
    grid = figure.add_gridspec(rows, 2, left=0.04, right=0.9, bottom=0.06, top=0.86, hspace=0.45, wspace=0.2)
    facets = _in_plane(study, joint.interface.nodes)
    for k, one in enumerate(maps):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        if one is None:
            _states(axes, facets, study.states)
        else:
            _map(axes, facets, *one)
        axes.autoscale()
        axes.set(aspect="equal")
        axes.grid(False)
    return figure


def _in_plane(study: JointStudy, nodes: Array) -> Array:
    """Return the corners (m, 4, 2) of the facets in mm, in the plane of the contact."""
    own, facets = study.joint.structure.points, _facets(study)
    centred = own - own.mean(axis=0)
    axes = np.linalg.lstsq(centred, nodes, rcond=1e-9)[0]
    return np.asarray(1e3 * (facets - own.mean(axis=0)) @ axes)


def _map(axes: Axes, facets: Array, title: str, values: Array, unit: str, colours: str) -> None:
    name, size = readable_unit(float(values.max(initial=0.0)), unit)
    top, ticks = style.round_scale(float(values.max(initial=0.0)) / size, 4)
    drawn = axes.add_collection(PolyCollection(list(facets), array=values / size, cmap=colours,
                                               norm=Normalize(0.0, top), edgecolors="face", linewidths=0.2))
    bar = axes.figure.colorbar(drawn, ax=axes, ticks=ticks, fraction=0.025, pad=0.02)
    bar.set_label(name.replace("um", "µm"))
    axes.set_title(title)


def _states(axes: Axes, facets: Array, states: NDArray[np.int8]) -> None:
    drawn = axes.add_collection(PolyCollection(
        list(facets), array=states, cmap=ListedColormap(STATE_COLOURS), norm=BoundaryNorm(np.arange(-0.5, 4.0), 4),
        edgecolors="#909090", linewidths=0.3))
    bar = axes.figure.colorbar(drawn, ax=axes, ticks=range(4), fraction=0.025, pad=0.02)
    bar.ax.set_yticklabels(STATES)
    axes.set_title("what each point does in a cycle")


def _curves(study: JointStudy) -> Figure:
    """Return frequency, damping, energy of a cycle over amplitude, and the forced responses."""
    curve, motions = study.curve, study.motions
    name = curve.output_names[0] if curve.output_names else ""
    tip = 1e6 * np.abs(curve.outputs[:, 0]) if name else curve.amplitude
    place = f"amplitude of {name} (µm)" if name else "modal amplitude (m kg$^{1/2}$)"
    seen = np.array([1e6 * one.outputs[0] if name else one.amplitude for one in motions])
    circles = "; circles: periodic motions (extended periodic motion concept)" if motions else ""
    measured = "" if study.measured is None else "; black: measured"
    figure = style.new_figure(study.title, f"static loads in the shape of the mode{circles}{measured}")
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.97, bottom=0.09, top=0.86, hspace=0.33, wspace=0.24)
    panels = [("natural frequency (Hz)", curve.frequency, [one.frequency for one in motions], 1),
              ("damping ratio (%)", 100.0 * curve.damping, [100.0 * one.damping for one in motions], 2),
              ("energy of a cycle (J)", curve.dissipated, [one.dissipated for one in motions], None)]
    for k, (label, values, other, column) in enumerate(panels):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        axes.plot(tip, values, color=style.BLUE, label="predicted")
        axes.plot(seen, other, "o", color=style.VERMILLION, fillstyle="none", markersize=11)
        if study.measured is not None and column is not None:
            seen_there = study.measured[column] * (100.0 if column == 2 else 1.0)
            axes.plot(1e6 * study.measured[0], seen_there, ".", color=style.BLACK, label="measured")
        axes.set(xscale="log", xlabel=place, ylabel=label)
        readable_log(axes.xaxis, (1.0, 3.0))
        if column is None:
            if slides := curve.friction_damping.max() > ROUND_OFF:
                axes.set(yscale="log", ylim=(0.5 * values[values > 1e-6 * values.max()].min(), 2.0 * values.max()))
            if slides and np.isfinite(study.slope):
                axes.text(0.05, 0.9, f"power of the amplitude: {study.slope:.2f}", transform=axes.transAxes)
        elif study.measured is not None:
            axes.legend(loc="best")
    axes = figure.add_subplot(grid[1, 1])
    for k, one in enumerate(study.responses):
        colour, line = style.curve_look(k)
        axes.plot(one.frequency, 1e6 * one.outputs[:, 0] / one.force, color=colour, linestyle=line,
                  label=f"{one.force[0]:.3g} N")
    if study.responses:
        top = max(study.responses, key=lambda one: float(one.amplitude.max()))
        half = top.frequency[top.amplitude > 0.25 * top.amplitude.max()]
        low, high = float(half.min()), max(float(half.max()), study.mode.frequency)
        axes.set(xlabel="frequency (Hz)", ylabel=f"{name} per force (µm/N)", xlim=(low - 0.2 * (high - low),
                                                                                   high + 0.2 * (high - low)))
        axes.legend(loc="best", title="held force")
    else:
        axes.axis("off")
    return figure
