"""Several meshed bodies with named interfaces and bolts, as the matrices of a structure.

Each facet of an interface's upper face is one contact point: its relative displacement is the mean over the facet, and
the contact force is spread over it evenly (piecewise constant multipliers of a mortar method; B. I. Wohlmuth, SIAM J.
Numer. Anal. 38 (2000) 989), so that elements of any kind and degree will do, and both faces may be meshed apart: the
mean of the lower face is taken over what each of its facets shares with the upper one. There a face moves as the linear
function nearest to its motion over a facet, so that the bodies turned as a whole leave no relative displacement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse
from scipy.linalg import null_space
from scipy.spatial import cKDTree

from fretflow.core.errors import InputError, MeshError
from fretflow.core.records import Array
from fretflow.structure.bodies import Bolt, Material
from fretflow.structure.fem import compat
from fretflow.structure.fem.elasticity import elastic_forms, elastic_moduli
from fretflow.structure.fem.mesh_file import MeshedBodies, read_bodies
from fretflow.structure.matrices import StructureMatrices

APART = 0.1  # of a facet's size, which two that face each other may be apart: a wider gap is none of a joint
FACING = -0.99  # cosine between their normals
COVERED = 0.5  # of an upper facet, at least: holes are polygons that differ from one mesh to another
DIGITS = 1e-6  # of a facet's size: a smaller gap is what coordinates are written by
LARGEST = 30.0  # m, of a face: bearings of bridges; a mesh in mm read as metres is beyond
NEAR = 1.0  # times the largest distance of neighbouring nodes, within which a sensor must have one


def structure_from_mesh(path: str | Path, material: Material, interfaces: Sequence[tuple[str, str]],
                        bolts: Sequence[Bolt] = (), clamped: Sequence[str] = (),
                        sensors: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
                        degree: int = 2, materials: Mapping[str, Material] | None = None,
                        unit: float = 1.0) -> StructureMatrices:
    """Assemble the bodies of a mesh, free of each other but for bolts, and the map to their contact.

    Parameters
    ----------
    path : path
        A mesh, .msh or of another format that meshio reads, whose groups name surfaces; hexahedra or tetrahedra.
    material : Material
        Of all bodies that `materials` do not name.
    interfaces : sequence of pairs
        The groups of the upper and the lower face of each, which may be meshed apart; the lower one is the larger.
    bolts : sequence of Bolt
        Each pulls its two faces together by one unit of the bolt load.
    clamped : sequence of str
        Groups that are held still; without any the structure is free in space.
    sensors : mapping
        Point (3,) in m and direction (3,) of each named input and output; the nearest node is taken.
    degree : int
        Of the displacement, 1 or 2; straight elements of degree 1 are too stiff in bending.
    materials : mapping
        Those of bodies of another material, by the groups of their volumes.
    unit : float
        What the mesh counts in, m: 1e-3 where its coordinates are millimetres.

    Returns
    -------
    StructureMatrices
        Sparse, in SI; one contact point a facet of an upper face, in the order of the interfaces.

    Raises
    ------
    MeshError
        If a group is missing, an upper face does not lie on the lower one, or the faces are too large for any joint.
    InputError
        If the degree, the unit, a bolt or a sensor cannot be.

    Examples
    --------
    >>> import fretflow as ff
    >>> steel = ff.Material(youngs_modulus=205e9, poissons_ratio=0.29, density=7850.0)  # Pa, 1, kg/m^3
    >>> ff.structure_from_mesh("absent.msh", steel, [("upper lap", "lower lap")])
    Traceback (most recent call last):
        ...
    fretflow.core.errors.MeshError: absent.msh: no such mesh file; give the path of a .msh file
    """
    if degree not in (1, 2):
        raise InputError(f"degree: {degree} is not an element degree; give 1 or 2")
    if not unit > 0.0:
        raise InputError(f"unit: {unit} m is no length that a mesh counts in; give 1e-3 for millimetres")
    if not interfaces:
        raise InputError("interfaces: give at least one pair of groups that touch")
    rubbing = {name for pair in interfaces for name in pair}
    if wrong := sorted(rubbing.intersection(name for bolt in bolts for name in (bolt.head, bolt.nut))):
        raise InputError(f"bolts: {wrong[0]!r} is a face of an interface; name the faces under head and nut")
    faces = _Faces.of(Path(path), degree, unit)
    moduli = faces.moduli(material, materials or {})
    stiffness, mass = (_scipy(compat.assemble_matrix(form))
                       for form in elastic_forms(faces.domain, faces.space, moduli, degree))
    preload = np.zeros(len(faces.points) * 3)
    for bolt in bolts:
        own = faces.bolt(bolt)
        preload -= np.asarray(own.strains[0].todense()).ravel()
        springs = (bolt.stiffness, *[bolt.shear_stiffness] * 2, *[bolt.bending_stiffness] * 2)
        stiffness = stiffness + own.strains.T @ sparse.diags(springs) @ own.strains
        mass = mass + 0.5 * bolt.mass * own.ends.T @ own.ends
    contacts = [faces.interface(upper, lower) for upper, lower in interfaces]
    size = float(max(np.ptp(one.points, axis=0).max() for one in contacts))
    if size > LARGEST:
        raise MeshError(f"{path}: its contact faces are {size:.4g} m large; where it counts in millimetres give unit = "
                        '1e-3, in files mesh_unit = "1 mm"')
    held = np.unique(np.concatenate([np.zeros(0, dtype=int), *(faces.dofs(name) for name in clamped)]))
    keep = np.setdiff1d(np.arange(len(preload)), held)
    gaps = np.concatenate([one.gaps for one in contacts])
    rows = {name: faces.sensor(name, np.asarray(at, dtype=float), np.asarray(along, dtype=float))[keep]
            for name, (at, along) in (sensors or {}).items()}
    return StructureMatrices(
        mass=mass.tocsr()[keep][:, keep], stiffness=stiffness.tocsr()[keep][:, keep],
        contact_map=sparse.vstack([one.rows for one in contacts]).tocsr()[:, keep],
        areas=np.concatenate([one.areas for one in contacts]), points=np.vstack([one.points for one in contacts]),
        preload=preload[keep] if bolts else None, gap=gaps if gaps.any() else None, inputs=rows, outputs=rows)


class _Interface(NamedTuple):
    """Rows (3 m, n) of the contact map, areas (m,) in m^2, middles (m, 3) and gaps (m,) in m of the contact points."""

    rows: Any
    areas: Array
    points: Array
    gaps: Array


class _Side(NamedTuple):
    """Facets of a group: integrals of the shape functions (m facets, nodes), areas, middles, outer normals, corners.

    `moments` are the integrals times each of x, y and z less the facet's middle; `corners` (m, k, 3).
    """

    integrals: Any
    moments: tuple[Any, ...]
    areas: Array
    points: Array
    normals: Array
    corners: Array

    def means(self) -> Any:
        """Return the rows (m, nodes) of each facet's mean displacement."""
        return sparse.diags(1.0 / self.areas) @ self.integrals

    def linear(self, facets: NDArray[np.intp], points: Array, nodes: Array) -> Any:
        """Return the rows (k, nodes) of the displacement at points (k, 3) of some facets, by its linear part there."""
        second = np.stack([moment @ nodes for moment in self.moments], axis=1)  # (m, 3, 3) m^4, of rank two
        slopes = np.einsum("ki,kij->kj", points - self.points[facets], np.linalg.pinv(second, rcond=DIGITS)[facets])
        return self.means()[facets] + sum(
            sparse.diags(slope) @ moment[facets] for slope, moment in zip(slopes.T, self.moments, strict=True))


class _Shank(NamedTuple):
    """Rows of a bolt's strains (5, n): stretch in m, shear in m and bending in rad twice; its ends' motion (6, n)."""

    strains: Any
    ends: Any


class _Faces(NamedTuple):
    """Meshed bodies with the space of their displacements and its nodes (n, 3) in m, and constants of the cells."""

    bodies: MeshedBodies
    space: Any
    cells: Any
    points: Array
    source: str

    @classmethod
    def of(cls, path: Path, degree: int, unit: float) -> _Faces:
        bodies = read_bodies(path, unit)
        space = compat.vector_space(bodies.domain, degree)
        return cls(bodies, space, compat.cell_vectors(bodies.domain), space.tabulate_dof_coordinates(), str(path))

    @property
    def domain(self) -> Any:
        """The mesh."""
        return self.bodies.domain

    def moduli(self, material: Material, materials: Mapping[str, Material]) -> list[Any]:
        """Return the cells' `elastic_moduli`, in UFL."""
        moduli = fem.Function(self.cells)
        values = np.tile(elastic_moduli(material), len(moduli.x.array) // 3).reshape(-1, 3)
        for name, own in materials.items():
            tag = _tag(self.bodies.volumes, name, "volume", self.source)
            cells = self.bodies.cell_tags.find(tag)
            values[[self.cells.dofmap.cell_dofs(one)[0] for one in cells]] = elastic_moduli(own)
        moduli.x.array[:] = values.ravel()
        return [moduli[k] for k in range(3)]

    def dofs(self, group: str) -> NDArray[np.int64]:
        """Return the DOF of a group's nodes."""
        nodes = np.unique(fem.locate_dofs_topological(self.space, 2, self._facets(group)))
        return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel(), dtype=np.int64)

    def _tag(self, group: str) -> int:
        return _tag(self.bodies.surfaces, group, "surface", self.source)

    def _facets(self, group: str) -> NDArray[np.int32]:
        return np.asarray(self.bodies.facet_tags.find(self._tag(group)))

    def _ds(self, group: str) -> Any:
        return ufl.Measure("ds", domain=self.domain, subdomain_data=self.bodies.facet_tags)(self._tag(group))

    def side(self, group: str) -> _Side:
        """Return the facets of a group, each told by the cell that it belongs to."""
        test, cell, ds = ufl.TestFunction(self.space), ufl.TrialFunction(self.cells), self._ds(group)
        axis = fem.Constant(self.domain, PETSc.ScalarType((0.0, 0.0, 0.0)))
        along = ufl.dot(axis, ufl.SpatialCoordinate(self.domain))

        def integrate(form: Any) -> Any:
            return _scipy(compat.assemble_matrix(form)).T.tocsr()[0::3, 0::3]

        whole = integrate(ufl.inner(cell, test) * ds)
        area = np.asarray(whole.sum(axis=1)).ravel()
        there = np.flatnonzero(area > 0.0)
        facets = self._facets(group)
        if len(there) != len(facets):
            raise MeshError(f"{self.source}: {len(facets)} facets of {group!r} belong to {len(there)} elements; keep "
                            "interfaces off edges, where an element has two facets of one group")
        normal = compat.assemble_vector(ufl.inner(ufl.FacetNormal(self.domain), ufl.TestFunction(self.cells)) * ds)
        normals = normal.getArray().reshape(-1, 3)[there] / area[there, None]
        own = whole[there]
        middles, moments = own @ self.points / area[there, None], []
        for direction in range(3):
            axis.value[:] = np.eye(3)[direction]
            moments.append(integrate(along * ufl.inner(cell, test) * ds)[there]
                           - sparse.diags(middles[:, direction]) @ own)
        corners = compat.corners(self.domain, self.cells, facets)
        return _Side(own, tuple(moments), area[there], middles, normals, np.stack([corners[one] for one in there]))

    def interface(self, upper: str, lower: str) -> _Interface:
        """Return the relative displacement of each upper facet from what it faces: two tangential rows, the normal one.

        The overlaps of upper and lower facets are taken in the upper ones' planes.
        """
        above, below = self.side(upper), self.side(lower)
        frames = _frames(-above.normals, above.points)
        own, other = _candidates(above, below)
        flat = [shapely.convex_hull(shapely.multipoints(np.einsum(
            "kab,kcb->kca", frames[own, :2], corners - above.points[own, None]))) for corners in (
                above.corners[own], below.corners[other])]
        shared = shapely.intersection(*flat)
        overlap = shapely.area(shared)
        touching = overlap > DIGITS * above.areas[own]
        own, other, overlap = own[touching], other[touching], overlap[touching]
        at = shapely.get_coordinates(shapely.centroid(shared[touching]))
        here = above.points[own] + np.einsum("ka,kab->kb", at, frames[own, :2])
        down, facing = above.normals[own], below.normals[other]
        apart = np.sum((below.points[other] - here) * facing, axis=1) / np.sum(down * facing, axis=1)
        near = np.abs(apart) < APART * np.sqrt(above.areas[own])
        covered = np.bincount(own, overlap * near, len(above.areas)).astype(float)
        self._check_covered(covered / above.areas, above.points, (upper, lower))
        mean = sparse.csr_matrix(((overlap / covered[own])[near], (own[near], np.flatnonzero(near))),
                                 shape=(len(above.areas), len(own)))
        opposite = here + apart[:, None] * down
        relative = mean @ (above.linear(own, here, self.points) - below.linear(other, opposite, self.points))
        rows = sparse.block_diag(list(frames)) @ sparse.kron(relative, sparse.identity(3))
        gaps = mean @ np.where(np.abs(apart) < DIGITS * np.sqrt(above.areas[own]), 0.0, apart)
        return _Interface(rows.tocsr(), covered, mean @ here, gaps)

    def _check_covered(self, share: Array, points: Array, names: tuple[str, str]) -> None:
        """Refuse an upper face of which less than half of some facet lies on the lower one."""
        wrong = share < COVERED
        if wrong.any():
            worst = points[np.argmax(wrong)]
            raise MeshError(f"{self.source}: {names[0]!r} does not lie on {names[1]!r}: {int(wrong.sum())} of its "
                            f"{len(share)} facets have nothing opposite or less than half, one at "
                            f"({', '.join(f'{1e3 * x:.4g}' for x in worst)}) mm; name the smaller face first, and only "
                            "where the bodies touch")

    def bolt(self, bolt: Bolt) -> _Shank:
        """Return how a bolt is strained between the faces under its head and its nut."""
        head, nut = (self.side(name) for name in (bolt.head, bolt.nut))
        middle = [one.areas @ one.points / one.areas.sum() for one in (head, nut)]
        along = middle[0] - middle[1]
        grip = float(np.linalg.norm(along))
        if not grip > 0.0:
            raise InputError(f"bolt {bolt.head!r}: its head and nut are in one place; name the faces under both")
        axes = np.vstack([along / grip, null_space(along[None]).T])  # the bolt's own, and two across it
        moved, tilted = [], []
        for one, centre in zip((head, nut), middle, strict=True):
            mean = sparse.csr_matrix(one.areas / one.areas.sum()) @ one.means()
            moved.append(sparse.kron(mean, sparse.identity(3)).tocsr())
            arms = (one.points - centre) @ axes[1:].T
            inertia = arms.T @ (one.areas[:, None] * arms)
            slopes = sparse.csr_matrix(np.linalg.solve(inertia, arms.T)) @ one.integrals  # facets' means times areas
            tilted.append(sparse.kron(slopes, axes[:1]).tocsr())
        stretch = sparse.csr_matrix(axes) @ (moved[0] - moved[1])
        shear = stretch[1:] + 0.5 * grip * (tilted[0] + tilted[1])  # turned as a whole, nothing is strained
        return _Shank(sparse.vstack([stretch[:1], shear, tilted[0] - tilted[1]]).tocsr(), sparse.vstack(moved).tocsr())

    def sensor(self, name: str, at: Array, along: Array) -> Array:
        """Return the row (n,) of the displacement of the node nearest to a point, along a direction."""
        if at.shape != (3,) or along.shape != (3,) or not np.linalg.norm(along) > 0.0:
            raise InputError(f"sensors: {name}: give a point (x, y, z) in m and a direction")
        tree = cKDTree(self.points)
        distance, node = tree.query(at)
        spacing = float(tree.query(self.points, k=2)[0][:, 1].max())
        if distance > NEAR * spacing:
            raise InputError(f"sensors: {name}: lies {1e3 * distance:.3g} mm off the nearest node; give a point of the "
                             "bodies in metres, and the unit of the mesh")
        row = np.zeros(3 * len(self.points))
        row[3 * node:3 * node + 3] = along / np.linalg.norm(along)
        return row


def _tag(groups: Mapping[str, int], name: str, kind: str, source: str) -> int:
    """Return the tag of a group."""
    if name not in groups:
        raise MeshError(f"{source}: has no physical {kind} named {name!r}; it has "
                        f"{', '.join(filter(None, sorted(groups))) or 'none'}")
    return groups[name]


def _candidates(above: _Side, below: _Side) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the upper and lower facets (k,) that face each other and may overlap."""
    radii = [np.linalg.norm(one.corners - one.points[:, None], axis=2).max(axis=1) for one in (above, below)]
    near = cKDTree(below.points).query_ball_point(above.points, (1.0 + APART) * (radii[0] + radii[1].max()))
    own = np.repeat(np.arange(len(near)), [len(some) for some in near])
    other = np.concatenate([np.asarray(some, dtype=np.intp) for some in near])
    facing = np.sum(above.normals[own] * below.normals[other], axis=1) < FACING
    return own[facing], other[facing]


def _frames(normals: Array, points: Array) -> Array:
    """Return (m, 3, 3): tangents, of which the first lies along the longest side of the interface, and the normal."""
    longest = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    longest = longest * np.sign(longest[np.abs(longest).argmax()])
    first = longest - (normals @ longest)[:, None] * normals
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first), normals], axis=1)


def _scipy(matrix: PETSc.Mat) -> Any:
    """Return a PETSc matrix of one rank as a sparse one, and free it."""
    rows, columns, values = matrix.getValuesCSR()
    copy = sparse.csr_matrix((values, columns, rows), shape=matrix.getSize())
    matrix.destroy()
    return copy
