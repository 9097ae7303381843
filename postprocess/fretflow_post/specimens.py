"""Pictures of the meshed specimens: assembled, opened, and close to the contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.structure.reduction.reduced_specimen import ModeShapes
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fretflow_post import style
from fretflow_post.panels import axes_pixels, axis_arrows, show_shot
from fretflow_post.scene import Layer, View, shoot, surface

MM = 1e3
SEEN_FROM = (0.75, -1.3, 0.62)
CLOSE_FROM = (0.75, -1.3, 0.42)
# Corners of the six faces of a hexahedron in VTK order, outward.
_HEX_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


@dataclass(frozen=True)
class MeshedSpecimen:
    """A specimen's mesh and summary."""

    geometry: MeshGeometry
    summary: MeshSummary

    def outer_faces(self) -> NDArray[np.int64]:
        """Return the quads (k, 4) that bound the mesh."""
        quads = self.geometry.hexahedra[:, _HEX_FACES].reshape(-1, 4)
        _, first, count = np.unique(np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True)
        return np.asarray(quads[first[count == 1]])

    def contact_points(self) -> NDArray[np.int64]:
        """Return the number of the mesh point at each contact node, -1 at the mid-nodes of degree 2."""
        span = float(np.ptp(self.geometry.points, axis=0).max())
        distance, number = cKDTree(self.geometry.points).query(self.summary.contact_nodes)
        return np.where(distance < 1e-6 * span, number, -1)

    def at_points(self, modes: ModeShapes) -> NDArray[np.float64]:
        """Return the shapes of `modes` at the mesh's points, (modes, points, 3), the largest displacement of each 1."""
        _, number = cKDTree(modes.points).query(self.geometry.points)
        shapes = modes.shape[:, number]
        return np.asarray(shapes / np.linalg.norm(shapes, axis=2).max(axis=1)[:, None, None])

    def faces(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the quads of the free boundary and those of the contact face."""
        quads = self.outer_faces()
        touching = np.isin(quads, self.contact_points()).all(axis=1)
        return quads[~touching], quads[touching]


def plot_specimens(path: Path, upper: MeshedSpecimen, lower: MeshedSpecimen) -> Path:
    """Draw both meshed specimens, assembled and opened with the contact faces up."""
    cells = [style.counted(s.summary.cells) for s in (upper, lower)]
    with style.styled():
        figure = style.new_figure(
            "Meshed specimens",
            f"hexahedra of degree {upper.summary.degree}: {cells[0]} upper, {cells[1]} lower; "
            f"{style.counted(len(upper.summary.contact_nodes))} contact nodes on each face", height=8.2)
        left = figure.add_axes((0.01, 0.12, 0.4, 0.7))
        layers, bounds = _assembled(upper, lower, lift=0.0)
        _draw(left, layers, View(bounds, SEEN_FROM, (0.0, 0.0, 1.0), axes_pixels(left)))
        left.set_title("Assembled")
        right = figure.add_axes((0.42, 0.12, 0.57, 0.7))
        layers, bounds = _opened(upper, lower)
        _draw(right, layers, View(bounds, (0.45, -1.2, 0.95), (0.0, 0.0, 1.0), axes_pixels(right)),
              "x: sliding direction; y and z as of the lower specimen")
        right.set_title("Opened: lower specimen left, upper one turned over about x")
        _legend(figure, observed=False)
        return style.save_figure(figure, path)


def plot_contact_closeup(path: Path, upper: MeshedSpecimen, lower: MeshedSpecimen) -> Path:
    """Draw the ridges around the contact, closed and pulled apart, with the observed points."""
    side = float(np.ptp(lower.summary.contact_nodes[:, 0])) * MM
    distance = float(np.abs(lower.summary.observation_point[2])) * MM
    with style.styled():
        figure = style.new_figure(
            "Close-up of the contact", f"contact {side:.3g} mm wide; motion is observed {distance:.3g} mm "
            "from the interface on both specimens", height=8.2)
        apart = 0.6 * side
        for k, (lift, title) in enumerate([(0.0, "Closed"), (apart, f"Pulled apart by {apart:.2g} mm")]):
            axes = figure.add_axes((0.01 + 0.495 * k, 0.12, 0.485, 0.7))
            layers, _ = _assembled(upper, lower, lift)
            layers += [_observed(upper, lift, side), _observed(lower, 0.0, side)]
            box = np.array([[-1.3, -1.3, -1.1], [1.3, 1.3, 1.1]]) * side + [[0.0, 0.0, 0.0], [0.0, 0.0, lift]]
            _draw(axes, layers, View(box, CLOSE_FROM, (0.0, 0.0, 1.0), axes_pixels(axes), margin=0.0))
            axes.set_title(title)
        _legend(figure, observed=True)
        return style.save_figure(figure, path)


def _assembled(upper: MeshedSpecimen, lower: MeshedSpecimen, lift: float) -> tuple[
        list[Layer], NDArray[np.float64]]:
    """Return both specimens with the upper one lifted (mm), and their box."""
    high = upper.geometry.points * MM + [0.0, 0.0, lift]
    low = lower.geometry.points * MM
    return (_specimen_layers(upper, high, style.UPPER_COLOUR)
            + _specimen_layers(lower, low, style.LOWER_COLOUR)), _box([high, low])


def _opened(upper: MeshedSpecimen, lower: MeshedSpecimen) -> tuple[list[Layer], NDArray[np.float64]]:
    """Return both specimens side by side with their contact faces up, and their box."""
    low = lower.geometry.points * MM
    turned = upper.geometry.points * MM * [1.0, -1.0, -1.0]
    turned[:, 0] += 1.2 * 0.5 * float(np.ptp(low[:, 0]) + np.ptp(turned[:, 0]))
    return (_specimen_layers(lower, low, style.LOWER_COLOUR)
            + _specimen_layers(upper, turned, style.UPPER_COLOUR)), _box([low, turned])


def _specimen_layers(specimen: MeshedSpecimen, points: NDArray[np.float64], colour: str) -> list[Layer]:
    free, contact = specimen.faces()
    edges = {"show_edges": True, "edge_color": style.EDGE_COLOUR, "line_width": 1.0, "ambient": 0.5,
             "diffuse": 0.5}
    return [Layer(surface(points, free), {"color": colour, **edges}),
            Layer(surface(points, contact), {"color": style.CONTACT_COLOUR, **edges})]


def _observed(specimen: MeshedSpecimen, lift: float, side: float) -> Layer:
    """Return a ball at the observed point, in front of the mesh as it may lie inside."""
    centre = specimen.summary.observation_point * MM + [0.0, 0.0, lift]
    toward = np.asarray(CLOSE_FROM) / np.linalg.norm(CLOSE_FROM)
    return Layer(pv.Sphere(radius=0.06 * side, center=tuple(centre + 20.0 * side * toward)),
                 {"color": style.GREEN, "lighting": False})


def _box(clouds: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    points = np.concatenate(clouds)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _draw(axes: Axes, layers: Sequence[Layer], view: View, caption: str = "x: sliding direction") -> None:
    show_shot(axes, shoot(layers, view), view)
    axis_arrows(axes, view, caption)


def _legend(figure: Figure, observed: bool) -> None:
    """Name the colours in one row below the panels."""
    handles: list[Patch | Line2D] = [
        Patch(facecolor=style.UPPER_COLOUR, edgecolor="black", label="upper specimen, on the moving arm"),
        Patch(facecolor=style.LOWER_COLOUR, edgecolor="black", label="lower specimen, on the static block"),
        Patch(facecolor=style.CONTACT_COLOUR, edgecolor="black", label="contact face")]
    if observed:
        handles.append(Line2D([], [], marker="o", linestyle="", markersize=11, color=style.GREEN,
                              label="observed point (seen through)"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False,
                  bbox_to_anchor=(0.5, 0.015))
