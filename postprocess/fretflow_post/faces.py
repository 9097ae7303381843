"""Pictures of the contact faces: wear depth, normal pressure, stick and slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fretflow.contact.interface import area_mean
from fretflow.wear.archard import split_between_faces
from fretflow.wear.history import WearHistory
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.contact_grid import REGIME_WORDS, Regime, StateShares, contact_cells, node_patches
from fretflow_post.panels import axes_pixels, edge_label, inches, show_shot
from fretflow_post.scene import Layer, View, rim, shoot, skirt, surface

MM, UM, MPA = 1e3, 1e6, 1e-6
VISIBLE_SHARE = 0.25  # the deepest wear is drawn at most this deep, relative to the side of the contact
WEAR_VIEW = (0.6, -1.6, 1.0)
REGIME_COLOURS = {Regime.STICKS: style.BLUE, Regime.STICKS_AND_SLIPS: style.SKY, Regime.SLIPS: style.ORANGE,
                  Regime.LIFTS_OFF: style.PURPLE, Regime.STAYS_OPEN: "#F2F2F2"}
X_LABEL, Y_LABEL = "x, sliding direction (mm)", "y, lateral (mm)"


@dataclass(frozen=True)
class WearScale:
    """What all panels of the wear pictures share.

    `factor` is how many times the heights are exaggerated; `top` the depth in um at the end of the
    colour scale.
    """

    factor: float
    top: float
    ticks: list[float]


@dataclass(frozen=True)
class WornFace:
    """One face at one time: `upper` or lower, and its own depth in m, (nodes,)."""

    upper: bool
    cycles: int
    depth: NDArray[np.float64]


def worn_faces(history: WearHistory, row: int) -> tuple[WornFace, WornFace]:
    """Return the upper and the lower face at `row` of the history, each with its share of the depth."""
    cycles = int(history.cycles[row])
    upper, lower = split_between_faces(history.depth[row], history.upper_share)
    return WornFace(True, cycles, upper), WornFace(False, cycles, lower)


def wear_scale(nodes: NDArray[np.float64], profiles: NDArray[np.float64], history: WearHistory,
               rows: Sequence[int]) -> WearScale:
    """Return one scale for the faces at all `rows`; `profiles` (2, nodes) in m are upper, lower."""
    depth = np.stack(split_between_faces(history.depth[list(rows)], history.upper_share))
    height = float((profiles[:, None] + depth).max())
    side = float(np.ptp(nodes, axis=0).max())
    top, ticks = style.round_scale(float(depth.max()) * UM)
    return WearScale(style.round_factor(VISIBLE_SHARE * side / height) if height > 0.0 else 1.0, top, ticks)


def plot_wear(path: Path, nodes: NDArray[np.float64], profiles: NDArray[np.float64], history: WearHistory,
              rows: Sequence[int], scale: WearScale) -> Path:
    """Draw both worn faces side by side at up to four `rows` of the history.

    Parameters
    ----------
    path
        PNG to write.
    nodes
        Contact nodes in m, (nodes, 2), sorted by x, then y.
    profiles
        Distance of the unworn upper and lower face from their common plane in m, (2, nodes).
    history
        The wear history.
    rows
        Rows of the history to show, at most four.
    scale
        Exaggeration and colour scale, see `wear_scale`.
    """
    pairs_across = 1 if len(rows) <= 2 else 2
    lines = -(-len(rows) // pairs_across)
    height = 1.75 + {(1, 1): 6.2, (1, 2): 4.6}.get((pairs_across, lines), 4.0) * lines
    with style.styled():
        figure = style.new_figure("Wear depth of the two contact faces", _wear_subtitle(history, scale),
                                  height=height)
        bottom, top = 0.35 / height, 1.0 - 1.15 / height
        width, tall = 0.87 / (2 * pairs_across), (top - bottom) / lines
        for k, row in enumerate(rows):
            line, pair = divmod(k, pairs_across)
            for side, face in enumerate(worn_faces(history, row)):
                axes = figure.add_axes((0.01 + (2 * pair + side) * width, top - (line + 1) * tall,
                                        width, tall - 0.62 / height))
                _worn_panel(axes, face, nodes, profiles[side], scale)
                _worn_title(axes, face, fontsize=12.5 if pairs_across == 2 else 15.0)
        bar = figure.add_axes((0.905, bottom + 0.1 * (top - bottom), 0.016, 0.74 * (top - bottom)))
        style.add_colour_bar(figure, bar, style.DEPTH_MAP, scale.ticks, "wear depth of the face (µm)")
        return style.save_figure(figure, path)


def _wear_subtitle(history: WearHistory, scale: WearScale) -> str:
    return (f"heights exaggerated {style.counted(scale.factor)} times, colours on one scale for all times; "
            f"blue frame: the unworn face; "
            f"the upper face takes {100.0 * history.upper_share:g} % of the depth")


def _worn_panel(axes: Axes, face: WornFace, nodes: NDArray[np.float64], profile: NDArray[np.float64],
                scale: WearScale) -> None:
    """Draw one face with its solid below, as one sees it when it lies with the worn side up."""
    turn = -1.0 if face.upper else 1.0  # turned over about x, so that x still points right
    points = np.column_stack([nodes * MM * [1.0, turn], -(profile + face.depth) * scale.factor * MM])
    cells = contact_cells(nodes)
    side = float(np.ptp(points[:, :2], axis=0).max())
    low, high = points.min(axis=0), points.max(axis=0)
    low[2], high[2] = -(VISIBLE_SHARE + 0.1) * side, 0.0
    view = View(np.stack([low, high]), WEAR_VIEW, (0.0, 0.0, 1.0), axes_pixels(axes), margin=0.16)
    unworn = np.column_stack([points[:, :2], -profile * scale.factor * MM])
    image = shoot([
        Layer(surface(points, cells, depth=face.depth * UM),
              {"scalars": "depth", "cmap": style.DEPTH_MAP, "clim": (0.0, scale.top), "show_edges": True,
               "edge_color": "#E8E8E8", "line_width": 1.0}),
        Layer(skirt(points, cells, low[2]), {"color": "#D8D8D8"}),
        Layer(rim(unworn, cells), {"color": style.BLUE, "line_width": 3.0})], view)
    show_shot(axes, image, view)
    edge_label(axes, view, [low[0], low[1], low[2]], [high[0], low[1], low[2]],
                f"x, sliding direction, {high[0] - low[0]:.3g} mm")
    start, end = ([high[0], y, low[2]] for y in (low[1], high[1])[::int(turn)])
    edge_label(axes, view, start, end, f"y, {high[1] - low[1]:.3g} mm")


def _worn_title(axes: Axes, face: WornFace, fontsize: float) -> None:
    name = "Upper face, turned over" if face.upper else "Lower face"
    deepest = style.figures(float(face.depth.max()) * UM)
    axes.set_title(f"{name}\n{style.counted(face.cycles)} cycles, deepest {deepest} µm", fontsize=fontsize,
                   linespacing=1.3)


def plot_wear_shape(path: Path, nodes: NDArray[np.float64], areas: NDArray[np.float64], history: WearHistory,
                    rows: Sequence[int]) -> Path:
    """Draw where the faces wear first: depth over its area mean at `rows`, on one scale and each on its own."""
    means = [float(area_mean(history.depth[row], areas)) for row in rows]
    shapes = [history.depth[row] / mean for row, mean in zip(rows, means, strict=True)]
    limit = max(0.05, *(float(np.abs(shape - 1.0).max()) for shape in shapes))
    limit = style.round_scale(min(limit, 1.0))[0]
    pitch = 13.5 / max(len(rows), 2)
    side = pitch - 0.75
    height = max(2.0 * side + 4.55, 6.0)
    with style.styled():
        figure = style.new_figure(
            "Shape of the worn faces",
            "depth over its mean, both faces together: 1 is uniform; on one colour scale, and below each on its own",
            height=height)
        for k, (row, mean, shape) in enumerate(zip(rows, means, shapes, strict=True)):
            axes, own = (figure.add_axes(inches(1.05 + k * pitch, bottom, side, side, height))
                         for bottom in (side + 2.65, 0.85))
            _flat_panel(axes, nodes, shape, style.SHAPE_MAP, (1.0 - limit, 1.0 + limit))
            low, high = float(shape.min()), float(shape.max())
            _flat_panel(own, nodes, shape, style.DEPTH_MAP, (low, max(high, low + 1e-9)))
            own.set_title(f"{low:.4g} to {high:.4g}", fontsize=14)
            own.locator_params(nbins=3 if len(rows) > 3 else 6)
            axes.set_title(f"{style.counted(int(history.cycles[row]))} cycles\nmean {style.figures(mean * UM)} µm",
                           fontsize=14, linespacing=1.35)
            axes.locator_params(nbins=3 if len(rows) > 3 else 6)
            if k > 0:
                axes.set_ylabel("")
                own.set_ylabel("")
        bar = figure.add_axes(inches(14.65, side + 2.65, 0.23, side, height))
        ticks = [float(t) for t in np.linspace(1.0 - limit, 1.0 + limit, 5)]
        style.add_colour_bar(figure, bar, style.SHAPE_MAP, ticks, "depth over mean depth",
                             beyond=max(float(shape.max()) for shape in shapes) > 1.0 + limit)
        return style.save_figure(figure, path)


@dataclass(frozen=True)
class PressureMap:
    """Normal pressure in Pa at the contact nodes, (nodes,), and what it is."""

    title: str
    pressure: NDArray[np.float64]


def plot_pressure(path: Path, nodes: NDArray[np.float64], areas: NDArray[np.float64],
                  maps: Sequence[PressureMap]) -> Path:
    """Draw normal pressure `maps` side by side on one colour scale; `nodes` in m, `areas` in m^2."""
    top, _ = style.round_scale(max(float(m.pressure.max()) for m in maps) * MPA)
    pitch = 13.5 / max(len(maps), 2)
    side = pitch - 0.75
    height = side + 3.0
    with style.styled():
        figure = style.new_figure(
            "Normal contact pressure", "node force over node area; one colour scale, by the square root; "
            "on the rim of a flat contact pressure rises with a finer mesh", height=height)
        for k, panel in enumerate(maps):
            axes = figure.add_axes(inches(1.05 + k * pitch, 0.85, side, side, height))
            _flat_panel(axes, nodes, np.sqrt(np.maximum(panel.pressure, 0.0) * MPA / top), style.PRESSURE_MAP,
                        (0.0, 1.0))
            axes.set_title(_pressure_words(panel, areas), fontsize=14, linespacing=1.35)
            axes.locator_params(nbins=3 if len(maps) > 3 else 6)
            if k > 0:
                axes.set_ylabel("")
        bar = figure.add_axes(inches(14.65, 0.85, 0.23, side, height))
        style.add_colour_bar(figure, bar, style.PRESSURE_MAP, style.root_ticks(top), "normal pressure (MPa)", 0.5)
        return style.save_figure(figure, path)


def _pressure_words(panel: PressureMap, areas: NDArray[np.float64]) -> str:
    """Return what a map is, with its total force, mean over the loaded area and peak."""
    force, largest = float(panel.pressure @ areas), float(panel.pressure.max())
    mean = force / (float(areas[panel.pressure > 0.0].sum()) or 1.0)
    return (f"{panel.title}\ntotal {style.figures(force)} N\n"
            f"mean {style.figures(mean * MPA)}, largest {style.figures(largest * MPA)} MPa")


def _flat_panel(axes: Axes, nodes: NDArray[np.float64], values: NDArray[np.float64], colours: object,
                limits: tuple[float, float]) -> None:
    """Draw `values` seen from above, each filling the area of its node, with the cells of the face."""
    points = np.column_stack([nodes * MM, np.zeros(len(nodes))])
    cells = contact_cells(nodes)
    patches, quads, owner = node_patches(points, cells)
    view = View(np.stack([points.min(axis=0), points.max(axis=0)]), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0),
                axes_pixels(axes), margin=0.02)
    image = shoot([
        Layer(surface(patches, quads, value=values[owner]),
              {"scalars": "value", "cmap": colours, "clim": limits, "lighting": False}),
        Layer(surface(points, cells), {"style": "wireframe", "color": style.EDGE_COLOUR, "line_width": 1.0,
                                       "lighting": False, "opacity": 0.6})], view)
    half = view.half_height
    half_width = half * view.size[0] / view.size[1]
    x, y = view.focus[:2]
    axes.imshow(image, extent=(x - half_width, x + half_width, y - half, y + half), interpolation="antialiased")
    axes.grid(False)
    axes.set(xlabel=X_LABEL, ylabel=Y_LABEL)
    axes.locator_params(nbins=6)


def plot_states(path: Path, nodes: NDArray[np.float64], areas: NDArray[np.float64], shares: StateShares,
                when: str) -> Path:
    """Draw what each node does over a period, and its shares of stick, slip and open, `when` in the title."""
    side, pitch = 3.75, 4.95
    height = 2 * pitch + 1.35
    with style.styled():
        figure = style.new_figure(f"Stick and slip over one period, {when}",
                                  "each node fills the area around it", height=height)
        corners = [(4.3 + column * pitch, 0.85 + row * pitch) for row in (1, 0) for column in (0, 1)]
        panels = [figure.add_axes(inches(x, y, side, side, height)) for x, y in corners]
        colours = ListedColormap([REGIME_COLOURS[r] for r in Regime])
        _flat_panel(panels[0], nodes, shares.regime.astype(float), colours, (-0.5, len(Regime) - 0.5))
        panels[0].set_title("What each node does")
        _regime_legend(figure, shares, areas)
        for axes, word, share in zip(panels[1:], ("sticks", "slips", "is open"),
                                     (shares.stick, shares.slip, shares.open), strict=True):
            _flat_panel(axes, nodes, 100.0 * share, style.SHARE_MAP, (0.0, 100.0))
            axes.set_title(f"Share of the period it {word}")
        bar = figure.add_axes(inches(14.2, 1.8, 0.3, 7.0, height))
        style.add_colour_bar(figure, bar, style.SHARE_MAP, [0.0, 20.0, 40.0, 60.0, 80.0, 100.0],
                             "share of the period (%)")
        return style.save_figure(figure, path)


def _regime_legend(figure: Figure, shares: StateShares, areas: NDArray[np.float64]) -> None:
    """Explain the regimes' colours beside the map, with the share of the contact area of each."""
    handles = []
    for regime, words in REGIME_WORDS.items():
        part = float(areas[shares.regime == regime].sum() / areas.sum())
        handles.append(Patch(facecolor=REGIME_COLOURS[regime], edgecolor="black",
                             label=f"{words}\n{100.0 * part:.0f} % of the area"))
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.004, 0.87), frameon=False,
                  fontsize=13.5, handlelength=1.2, labelspacing=1.2)
