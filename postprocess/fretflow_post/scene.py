"""Shots of meshes: pyvista draws them off-screen without any text, and says where points fall in the image.

Titles, scales and labels are set by matplotlib around the shots, so that texts keep clear of each other.
Lengths here are in millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from fretflow_post.offscreen import uninterrupted

OVERSAMPLING = 2  # shots are made this much larger than shown, which smooths their edges


@dataclass(frozen=True)
class View:
    """A parallel projection that holds the box `bounds` whole.

    Attributes
    ----------
    bounds
        Lowest and highest corner in mm, (2, 3).
    direction
        From the box towards the eye, (3,).
    up
        What points up in the image, (3,).
    size
        Width and height of the shot in pixels, before oversampling.
    margin
        Free share around the box.
    """

    bounds: NDArray[np.float64]
    direction: tuple[float, float, float]
    up: tuple[float, float, float]
    size: tuple[int, int]
    margin: float = 0.06

    @property
    def axes(self) -> NDArray[np.float64]:
        """Return the unit vectors to the right, up and towards the eye, (3, 3)."""
        toward = np.asarray(self.direction) / np.linalg.norm(self.direction)
        right = np.cross(self.up, toward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(toward, right), toward])

    @property
    def focus(self) -> NDArray[np.float64]:
        """Return the centre of the box as seen in the image, (3,)."""
        return np.asarray(self.bounds.mean(axis=0))

    @property
    def half_height(self) -> float:
        """Return half the height of the image in mm."""
        corners = np.array([[self.bounds[i, 0], self.bounds[j, 1], self.bounds[k, 2]]
                            for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        half = np.abs((corners - self.focus) @ self.axes[:2].T).max(axis=0)
        return float(max(half[1], half[0] * self.size[1] / self.size[0]) * (1.0 + self.margin))

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where `points` (k, 3) fall, (k, 2) in pixels right and down from the upper left corner."""
        offset = (np.atleast_2d(points) - self.focus) @ self.axes[:2].T / self.half_height
        width, height = self.size
        return 0.5 * np.array([width, height]) + 0.5 * height * offset * [1.0, -1.0]


@dataclass(frozen=True)
class Layer:
    """A mesh to draw and how: keywords of ``pyvista.Plotter.add_mesh``."""

    mesh: Any
    look: dict[str, Any] = field(default_factory=dict)


@uninterrupted()
def shoot(layers: Sequence[Layer], view: View) -> NDArray[np.uint8]:
    """Draw `layers` as seen from `view`; return the image, (oversampled height, width, 3)."""
    width, height = (OVERSAMPLING * s for s in view.size)
    plotter = pv.Plotter(off_screen=True, window_size=(width, height))
    try:
        plotter.set_background("white")
        for layer in layers:
            plotter.add_mesh(layer.mesh, **{"show_scalar_bar": False, "ambient": 0.7, "diffuse": 0.35,
                                            "specular": 0.0, **layer.look})
        distance = 10.0 * float(np.linalg.norm(np.ptp(view.bounds, axis=0)))
        camera = plotter.camera
        camera.focal_point = tuple(view.focus)
        camera.position = tuple(view.focus + distance * view.axes[2])
        camera.up = view.up
        camera.parallel_projection = True
        camera.parallel_scale = view.half_height
        plotter.renderer.reset_camera_clipping_range()
        image = plotter.screenshot(None, return_img=True)
    finally:
        plotter.close()
    return np.asarray(image, dtype=np.uint8)


def surface(points: NDArray[np.float64], cells: NDArray[np.int64], **data: NDArray[Any]) -> Any:
    """Return a pyvista surface of `points` (n, 3) and `cells` (m, corners) with `data` of points or cells."""
    faces = np.hstack([np.full((len(cells), 1), cells.shape[1]), cells])
    mesh = pv.PolyData(np.asarray(points, dtype=float), faces.ravel())
    for name, values in data.items():
        (mesh.point_data if len(values) == len(points) else mesh.cell_data)[name] = values
    return mesh


def rim(points: NDArray[np.float64], cells: NDArray[np.int64]) -> Any:
    """Return the outline of a surface as lines."""
    edges = _rim_edges(cells)
    return pv.PolyData(np.asarray(points, dtype=float), lines=np.insert(edges, 0, 2, axis=1).ravel())


def skirt(points: NDArray[np.float64], cells: NDArray[np.int64], base: float) -> Any:
    """Return the side walls from the rim of a surface down to the height `base`."""
    edges = _rim_edges(cells)
    low = points.copy()
    low[:, 2] = base
    return surface(np.concatenate([points, low]), np.hstack([edges, edges[:, ::-1] + len(points)]))


def _rim_edges(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges (k, 2) that belong to one cell only."""
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])


def hexahedra(points: NDArray[np.float64], cells: NDArray[np.int64]) -> Any:
    """Return a pyvista grid of hexahedra in VTK order."""
    connectivity = np.hstack([np.full((len(cells), 1), 8), cells]).ravel()
    return pv.UnstructuredGrid(connectivity, np.full(len(cells), pv.CellType.HEXAHEDRON, dtype=np.uint8),
                               np.asarray(points, dtype=float))
