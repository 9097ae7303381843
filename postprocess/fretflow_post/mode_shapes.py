"""Pictures of natural modes: the shapes of both specimens, and of the rig's block and arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from fretflow.core.records import Array
from fretflow.structure.reduction.reduced_specimen import ModeShapes
from fretflow.structure.two_mass_rig.lumped import RigModes
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from fretflow_post import style
from fretflow_post.panels import axes_pixels, axis_arrows, show_shot
from fretflow_post.scene import Layer, View, shoot, surface
from fretflow_post.specimens import MM, MeshedSpecimen

SHOWN = 5  # modes of each specimen, in a row
REACH = 0.12  # largest displacement that is drawn, of the body's largest size
UPPER_FROM, LOWER_FROM = (0.75, -1.3, -0.5), (0.75, -1.3, 0.5)  # so that the ridge is seen
COLOURS = "viridis"


def plot_mode_shapes(path: Path, specimens: Sequence[MeshedSpecimen], modes: Sequence[ModeShapes]) -> Path:
    """Draw the lowest natural modes of the upper and the lower specimen, clamped at the back.

    Parameters
    ----------
    path
        Picture to write.
    specimens, modes
        Mesh and modes of both.
    """
    with style.styled():
        figure = style.new_figure(
            "Natural modes of the specimens",
            f"clamped at the back, contact face free; the largest displacement drawn as {100.0 * REACH:.0f} % of the "
            "body's size, lines: at rest", height=8.6)
        for row, (side, view, specimen, own) in enumerate(zip(
                ("Upper", "Lower"), (UPPER_FROM, LOWER_FROM), specimens, modes, strict=True)):
            for k in range(min(SHOWN, len(own.frequency))):
                axes = figure.add_axes((0.005 + 0.18 * k, 0.46 - 0.42 * row, 0.175, 0.38))
                _draw(axes, specimen, specimen.at_points(own)[k], view, arrows=k == 0)
                axes.set_title(f"{side} {k + 1}: {style.figures(own.frequency[k] / 1e3)} kHz", fontsize=14, pad=2)
        colours = ScalarMappable(Normalize(0.0, 1.0), COLOURS)
        bar = figure.colorbar(colours, cax=figure.add_axes((0.925, 0.15, 0.015, 0.6)))
        bar.set_label("displacement over its largest")
        return style.save_figure(figure, path)


def plot_rig_modes(path: Path, modes: RigModes) -> Path:
    """Draw how block and arm move along x in each mode, with the faces apart and stuck to each other."""
    rows = [("faces apart", modes.apart_frequency, modes.apart_shape),
            ("faces stuck", modes.stuck_frequency, modes.stuck_shape)]
    count = len(modes.apart_frequency)
    with style.styled():
        figure = style.new_figure("Modes of the rig", "block and arm along x, undamped; filled: displaced, dashed: at "
                                  "rest; the larger displacement is 1; orange: contact", height=7.4)
        panels = figure.subplots(len(rows), count, squeeze=False, gridspec_kw={
            "left": 0.03, "right": 0.98, "bottom": 0.06, "top": 0.8, "hspace": 0.45, "wspace": 0.08})
        for row, (faces, frequencies, shapes) in zip(panels, rows, strict=True):
            for axes, frequency, shape in zip(row, frequencies, shapes, strict=True):
                _draw_masses(axes, shape, stuck=faces.endswith("stuck"))
                axes.set_title(f"{faces}: {style.figures(frequency)} Hz", fontsize=15)
        return style.save_figure(figure, path)


def _draw_masses(axes: Axes, shape: Array, stuck: bool) -> None:
    """Draw ground, block and arm in a row, joined by the ground's and the hinge's spring, and the contact below."""
    moved = 0.5 * np.asarray(shape)[:2]
    places = [(1.0, 1.2, "block", style.UPPER_COLOUR), (3.6, 0.8, "arm", style.UPPER_COLOUR)]
    axes.plot([0.0, 0.0], [0.0, 1.6], color="black", linewidth=4.0)
    ends = [(0.0, places[0][0] + moved[0]), (places[0][0] + places[0][1] + moved[0], places[1][0] + moved[1])]
    for start, end in ends:
        axes.plot(*_spring(start, end, 0.9), color="black", linewidth=1.5)
    for (left, width, name, colour), shift, share in zip(places, moved, shape, strict=False):
        axes.add_patch(Rectangle((left, 0.4), width, 1.0, fill=False, linestyle="--", edgecolor="grey"))
        axes.add_patch(Rectangle((left + shift, 0.4), width, 1.0, facecolor=colour, edgecolor="black"))
        axes.text(left + shift + 0.5 * width, 0.9, f"{name}\n{share:+.2f}", ha="center", va="center", fontsize=13)
    arm = places[1][0] + moved[1] + 0.5 * places[1][1]
    if stuck:  # through the specimens to the static block
        axes.plot([arm, arm], [0.4, 0.15], color="black", linewidth=1.5)
        axes.plot(*_spring(arm, 5.6, 0.15), color=style.VERMILLION, linewidth=1.5)
        axes.plot([5.6, 5.6], [-0.1, 0.5], color="black", linewidth=4.0)
    axes.set(xlim=(-0.2, 5.8), ylim=(-0.2, 1.8))
    axes.set_axis_off()


def _spring(start: float, end: float, height: float) -> tuple[Array, Array]:
    """Return a zigzag from `start` to `end`."""
    along = np.concatenate([[0.0], np.linspace(0.2, 0.8, 9), [1.0]])
    across = np.concatenate([[0.0], [0.0], 0.1 * (-1.0) ** np.arange(7), [0.0], [0.0]])
    return start + (end - start) * along, height + across


def _draw(axes: Axes, specimen: MeshedSpecimen, shape: Array, seen_from: tuple[float, float, float], arrows: bool
          ) -> None:
    """Draw a shape (points, 3) whose largest displacement is 1, and the body at rest as lines."""
    rest = specimen.geometry.points * MM
    size = float(np.ptp(rest, axis=0).max())
    quads = specimen.outer_faces()
    moved = surface(rest + REACH * size * shape, quads, displacement=np.linalg.norm(shape, axis=1))
    outline = surface(rest, quads).clean().extract_feature_edges(boundary_edges=False, manifold_edges=False)
    largest = REACH * size
    box = np.stack([rest.min(axis=0) - largest, rest.max(axis=0) + largest])
    view = View(box, seen_from, (0.0, 0.0, 1.0), axes_pixels(axes), margin=0.0)
    show_shot(axes, shoot([
        Layer(moved, {"scalars": "displacement", "clim": (0.0, 1.0), "cmap": COLOURS, "show_edges": True,
                      "edge_color": style.EDGE_COLOUR, "edge_opacity": 0.3}),
        Layer(outline, {"color": "black", "line_width": 2.0, "lighting": False})], view), view)
    if arrows:
        axis_arrows(axes, view, "", length=40.0)
