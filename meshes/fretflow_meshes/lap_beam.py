"""Two bars that overlap and are bolted together: hexahedra with round holes, and named faces.

The lap lies in the plane z = 0, the lower bar begins at x = 0, and both are as thick as the whole beam outside the lap.
Each bolt's hole is the middle of an O-grid whose first rings are under the washers. The upper bar is the lower one
turned about y, so that the faces of the lap have the same nodes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from fretflow.core.errors import MeshError
from fretflow.core.records import Array, quantity, record
from fretflow.core.units import parse_quantity
from numpy.typing import NDArray

from fretflow_meshes.gmsh_files import HEXAHEDRON, QUADRILATERAL, Group, write_groups

Indices = NDArray[np.int64]

ROUNDED = 9  # decimals of a metre at which points of neighbouring blocks are one


@record
class LapBeam:
    """A bolted lap beam; the default is a half Brake-Reuss beam, whose lap is in its middle.

    Its mesh has the volumes ``lower`` and ``upper``, the faces ``lower lap`` and ``upper lap``, ``head 1`` and
    ``nut 1`` of each bolt from the left, and the ends ``left`` and ``right`` of the beam.

    Examples
    --------
    >>> from fretflow_meshes import LapBeam
    >>> beam = LapBeam(length=0.4, lap=0.1, bolts=2)
    >>> [round(1e3 * float(x)) for x in beam.bolt_places]  # mm
    [183, 217]
    """

    length: float = quantity("m", default=0.72)
    width: float = quantity("m", default=0.0254)
    thickness: float = quantity("m", default=0.0127)
    lap: float = quantity("m", default=0.12)
    bolts: int = 3
    hole: float = quantity("m", "diameter", default=0.0084)
    washer: float = quantity("m", "outer diameter", default=0.016)
    across: int = 4  # elements over the width
    layers: int = 1  # of elements in each half of the lap
    rings: tuple[int, int] = (1, 1)  # under the washer, and from there to the edge
    stretch: float = 3.0  # of the elements of the bars over those of the lap, along x

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> LapBeam:
        """Return the beam of a case file's table: lengths are text with a unit, the rest numbers.

        Raises
        ------
        MeshError
            Naming a key that is unknown, or its value.
        """
        known = {f.name: f.metadata.get("unit") for f in fields(cls)}
        if unknown := set(table) - set(known):
            raise MeshError(f"lap_beam: has no {min(unknown)!r}; it has {', '.join(known)}")
        try:
            given: dict[str, Any] = {name: parse_quantity(value, "m") if known[name] else
                                     tuple(value) if isinstance(value, list) else value
                                     for name, value in table.items()}
            return cls(**given)
        except (TypeError, ValueError) as error:
            raise MeshError(f"lap_beam: {error}") from error

    def check(self) -> None:
        """Check that bolts and washers have room.

        Raises
        ------
        MeshError
            Naming what is too large or too few.
        """
        sizes = ("length", "width", "thickness", "lap", "hole", "washer", "across", "layers", "bolts")
        for name in sizes:
            if not getattr(self, name) > 0:
                raise MeshError(f"{name}: must be positive, got {getattr(self, name)}")
        if min(self.rings) < 1:
            raise MeshError(f"rings: at least one under the washer and one around it, got {self.rings}")
        if not self.lap <= self.length:
            raise MeshError(f"lap: {self.lap} m are longer than the whole beam, {self.length} m")
        room = min(self.width, self.pitch)
        if not self.hole < self.washer < room:
            raise MeshError(f"washer: {self.washer} m must be wider than the hole ({self.hole} m) and narrower than "
                            f"the width and the distance of the bolts ({room:.3g} m)")
        points = self.across * round(self.lap / self.width * self.across)
        needed, there = 8.0 * (3.0 * points)**2, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if needed > there:
            raise MeshError(f"across: {self.across:,} elements over the width make some {points:,} contact points, "
                            f"whose stiffness alone takes {needed / 1e9:,.0f} GB, and there are {there / 1e9:,.0f} GB")

    @property
    def pitch(self) -> float:
        """Return the distance in m of neighbouring bolts, and of the outer ones from the ends of the lap."""
        return self.lap / (self.bolts + 1)

    @property
    def bolt_places(self) -> Array:
        """Return the bolts' x (bolts,) in m."""
        return 0.5 * self.length + self.pitch * (np.arange(self.bolts) - 0.5 * (self.bolts - 1))

    def write(self, path: str | Path) -> Path:
        """Write the mesh as .msh with its groups, and return its path.

        Raises
        ------
        MeshError
            If it cannot be written.
        """
        lower, groups = self._half()
        points = np.vstack([lower, np.array([self.length, 0.0, 0.0]) + lower * [-1.0, 1.0, -1.0]])
        halves = []
        for name, (kind, cells) in groups.items():
            for body, other in enumerate(("lower", "upper")):
                own = _named(name, other, self.bolts)
                halves.append(Group(name=own, kind=kind, elements=cells + body * len(lower)))
        write_groups(points, halves, Path(path))
        return Path(path)

    def _half(self) -> tuple[Array, dict[str, tuple[int, Indices]]]:
        """Return points (n, 3) of the lower bar and its groups: gmsh's type and nodes of each element."""
        plan, quads, ring, in_lap = self._plan()
        size, half = len(plan), 0.5 * self.thickness
        z = np.linspace(-half, half, 2 * self.layers + 1)
        cells = np.vstack([np.hstack([quads[chosen] + size * k, quads[chosen] + size * (k + 1)])
                           for k in range(2 * self.layers)
                           for chosen in [in_lap | True if k < self.layers else ~in_lap]])
        edges = np.vstack([quads[:, [a, (a + 1) % 4]] for a in range(4)])
        end = edges[np.all(plan[edges][:, :, 0] < 1e-9, axis=1)]
        high = self.layers if self.lap >= self.length else 2 * self.layers
        groups = {"body": (HEXAHEDRON, cells), "lap": (QUADRILATERAL, quads[in_lap] + size * self.layers),
                  "end": (QUADRILATERAL, np.vstack([np.hstack([end + size * k, end[:, ::-1] + size * (k + 1)])
                                                    for k in range(high)]))}
        groups |= {f"ring {b + 1}": (QUADRILATERAL, quads[ring == b]) for b in range(self.bolts)}
        used = np.unique(cells)
        number = np.zeros(size * len(z), dtype=np.int64)
        number[used] = np.arange(len(used))
        return (np.column_stack([plan[used % size], z[used // size]]),
                {name: (kind, number[nodes]) for name, (kind, nodes) in groups.items()})

    def _plan(self) -> tuple[Array, Indices, Indices, NDArray[np.bool_]]:
        """Return points (n, 2), counter-clockwise quads, the bolt under whose washer each lies or -1, and which lap."""
        start, stop = 0.5 * (self.length - self.lap), 0.5 * (self.length + self.lap)
        element, first = self.width / self.across, float(self.bolt_places[0]) - 0.5 * self.pitch
        blocks: list[tuple[Array, Indices, int]] = []
        for left, right, size in ((0.0, start, self.stretch * element), (start, first, element),
                                  (self.length - first, stop, element)):
            if right > left:  # a lap of the whole length leaves no bars
                line = np.linspace(left, right, max(1, round((right - left) / size)) + 1)
                blocks.append((*_rectangle(line, self._lines), -1))
        for bolt, x in enumerate(self.bolt_places):
            blocks += [(*block, bolt if under else -1) for block, under in self._around(x)]
        points, quads, ring, count = [], [], [], 0
        for own, cells, bolt in blocks:
            points.append(own)
            quads.append(cells + count)
            ring.append(np.full(len(cells), bolt))
            count += len(own)
        merged, number = np.unique(np.round(np.vstack(points), ROUNDED), axis=0, return_inverse=True)
        cells = np.ravel(number)[np.vstack(quads)]
        middle = merged[cells].mean(axis=1)
        in_lap: NDArray[np.bool_] = (middle[:, 0] > start) & (middle[:, 0] < stop)
        return np.asarray(merged, dtype=float), cells, np.concatenate(ring), in_lap

    @property
    def _lines(self) -> Array:
        return np.linspace(-0.5, 0.5, self.across + 1) * self.width

    def _around(self, x: float) -> list[tuple[tuple[Array, Indices], bool]]:
        """Return the rings about the bolt at x: points and quads, and whether they are under the washer."""
        y, half = self._lines, 0.5 * self.pitch
        along = np.linspace(-half, half, max(2, round(self.pitch / self.width * self.across)) + 1)
        sides = [np.column_stack([np.full(len(y) - 1, half), y[:-1]]),
                 np.column_stack([along[:0:-1], np.full(len(along) - 1, y[-1])]),
                 np.column_stack([np.full(len(y) - 1, -half), y[:0:-1]]),
                 np.column_stack([along[:-1], np.full(len(along) - 1, y[0])])]
        angle = np.concatenate([np.pi / 4.0 * (2 * k - 1 + 2.0 * np.arange(len(side)) / len(side))
                                for k, side in enumerate(sides)])
        circle, middle = np.column_stack([np.cos(angle), np.sin(angle)]), np.array([x, 0.0])
        hole, washer, edge = (middle + 0.5 * self.hole * circle, middle + 0.5 * self.washer * circle,
                              middle + np.vstack(sides))
        return [(_annulus(hole, washer, self.rings[0]), True), (_annulus(washer, edge, self.rings[1]), False)]


def write_lap_beam(table: Mapping[str, Any], path: Path) -> tuple[tuple[str, str], ...]:
    """Write the mesh of a case file's lap beam and return the faces under head and nut of each bolt."""
    beam = LapBeam.of(table)
    beam.write(path)
    return tuple((f"head {k}", f"nut {k}") for k in range(1, beam.bolts + 1))


def _annulus(inner: Array, outer: Array, rings: int) -> tuple[Array, Indices]:
    """Return points and counter-clockwise quads between two closed lines (n, 2)."""
    count = len(inner)
    points = np.vstack([inner + share * (outer - inner) for share in np.linspace(0.0, 1.0, rings + 1)])
    k = np.arange(count)
    after = (k + 1) % count
    quads = np.vstack([np.column_stack([k + r * count, k + (r + 1) * count, after + (r + 1) * count, after + r * count])
                       for r in range(rings)])
    return points, quads


def _rectangle(x: Array, y: Array) -> tuple[Array, Indices]:
    """Return points and counter-clockwise quads over lines."""
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(points)).reshape(len(x), len(y))
    return points, np.column_stack([part.ravel() for part in (
        number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])])


def _named(group: str, body: str, bolts: int) -> str:
    """Return the name of a group of one half in the beam; the upper one is turned, so that its bolts count back."""
    if group == "body":
        return body
    if group == "lap":
        return f"{body} lap"
    if group == "end":
        return "left" if body == "lower" else "right"
    bolt = int(group.split()[1])
    return f"nut {bolt}" if body == "lower" else f"head {bolts + 1 - bolt}"
