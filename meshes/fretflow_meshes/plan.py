"""Quadrilateral plans of a body seen along z, made to be stacked into hexahedra.

Every plan holds the contact square ``|x|, |y| <= w/2`` as a uniform grid and the lines ``y = +-w/2`` whole,
so that the ridge along x is a set of its elements.
"""

from __future__ import annotations

import numpy as np
from fretflow.case.config import BodyShape, Mesh, Specimen
from fretflow.core.records import quantity, record
from numpy.typing import NDArray

from fretflow_meshes.grading import graded_sizes, levels, subdivide

# The largest element is this share of the body's width, so that the body's own modes are resolved.
LARGEST_SHARE = 1.0 / 8.0
# Half-width of the square core of a round body as a share of its radius; leaves the ring a good thickness at
# the diagonals.
CORE_SHARE = 0.55


@record
class Plan:
    """Nodes and elements of the plan; each element lists its (degree + 1)^2 nodes, x index slowest."""

    points: NDArray[np.float64] = quantity("m", "(points, 2)")
    quads: NDArray[np.int64] = quantity("1", "(quads, (degree + 1)^2)")
    degree: int

    @property
    def centres(self) -> NDArray[np.float64]:
        """Return the mean of each element's nodes, shape (quads, 2)."""
        return np.asarray(self.points[self.quads].mean(axis=1))


def largest_size(specimen: Specimen) -> float:
    """Return the largest element size (m) allowed in the specimen."""
    return specimen.body_width * LARGEST_SHARE


def make_plan(specimen: Specimen, mesh: Mesh) -> Plan:
    """Return the plan of the specimen's body with the ridge along x."""
    return _round_plan(specimen, mesh) if specimen.body is BodyShape.ROUND else _square_plan(specimen, mesh)


def _half_line(specimen: Specimen, mesh: Mesh, end: float) -> NDArray[np.float64]:
    """Return the element boundaries from the edge of the contact square to `end`, both included."""
    half = 0.5 * specimen.contact_width
    element = specimen.contact_width / mesh.contact_elements
    return levels(half, graded_sizes(end - half, element * mesh.growth, mesh.growth, largest_size(specimen)))


def _symmetric_line(specimen: Specimen, mesh: Mesh, end: float) -> NDArray[np.float64]:
    """Return element boundaries on [-end, end] with the uniform contact grid in the middle."""
    outer = _half_line(specimen, mesh, end)[1:]
    outer[-1] = end
    count = mesh.contact_elements
    inner = 0.5 * specimen.contact_width * np.arange(-count, count + 1, 2) / count
    return np.concatenate((-outer[::-1], inner, outer))


def _lattice_quads(index: NDArray[np.int64], degree: int) -> NDArray[np.int64]:
    """Cut a lattice of node numbers into elements, shape (elements, (degree + 1)^2)."""
    rows, columns = ((n - 1) // degree for n in index.shape)
    corners = np.ix_(np.arange(rows) * degree, np.arange(columns) * degree)
    nodes = [index[corners[0] + a, corners[1] + b] for a in range(degree + 1) for b in range(degree + 1)]
    return np.asarray(np.stack(nodes, axis=-1).reshape(rows * columns, -1))


def _grid(line: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return points and node numbers of the square grid over `line`."""
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.column_stack((x.ravel(), y.ravel()))
    return points, np.arange(len(points)).reshape(x.shape)


def _square_plan(specimen: Specimen, mesh: Mesh) -> Plan:
    line = subdivide(_symmetric_line(specimen, mesh, 0.5 * specimen.body_width), mesh.degree)
    points, index = _grid(line)
    return Plan(points=points, quads=_lattice_quads(index, mesh.degree), degree=mesh.degree)


def _round_plan(specimen: Specimen, mesh: Mesh) -> Plan:
    """Return an O-grid: a square core, and a ring from its boundary to the circle.

    Ring lines that start at the ridge's flanks run on straight to the circle; those between them and those
    up to the diagonals are spread evenly. Second-degree nodes of the rim lie on the circle.
    """
    radius, half = 0.5 * specimen.body_width, 0.5 * specimen.contact_width
    core = max(CORE_SHARE * radius, 0.5 * (half + radius / np.sqrt(2.0)))
    boundaries = _symmetric_line(specimen, mesh, core)
    line = subdivide(boundaries, mesh.degree)
    points, index = _grid(line)
    start = _boundary_loop(index)
    end = _circle_points(line, half, radius)
    step = boundaries[-1] - boundaries[-2]
    sizes = graded_sizes(radius - core, step, mesh.growth, largest_size(specimen))
    fraction = subdivide(levels(0.0, sizes), mesh.degree)[1:] / (radius - core)
    fraction[-1] = 1.0
    ring = points[start] + fraction[:, None, None] * (end - points[start])
    outer = len(points) + np.arange(fraction.size * start.size).reshape(fraction.size, start.size)
    ring_index = np.vstack((start, outer))
    closed = np.column_stack((ring_index, ring_index[:, 0]))
    quads = np.vstack((_lattice_quads(index, mesh.degree), _lattice_quads(closed, mesh.degree)))
    return Plan(points=np.vstack((points, ring.reshape(-1, 2))), quads=quads, degree=mesh.degree)


def _boundary_loop(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the boundary nodes of a square lattice, counter-clockwise from (+x, -y), each once."""
    return np.concatenate((index[-1, :-1], index[:0:-1, -1], index[0, :0:-1], index[:-1, 0]))


def _circle_points(line: NDArray[np.float64], half: float, radius: float) -> NDArray[np.float64]:
    """Return the point of the circle for each node of the core's boundary, in the loop's order."""
    t = line[:-1]
    flank = np.arcsin(half / radius)
    angle = np.sign(t) * np.interp(np.abs(t), [0.0, half, line[-1]], [0.0, flank, np.pi / 4.0])
    turns = np.concatenate([angle + k * np.pi / 2.0 for k in range(4)])
    return radius * np.column_stack((np.cos(turns), np.sin(turns)))
