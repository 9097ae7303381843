"""Linear isotropic elasticity: stiffness and consistent mass of a meshed body, and its two faces.

Elements are hexahedra of degree 1 (8 nodes) or 2 (27 nodes) with full Gauss integration (2 or 3 points a
direction), without incompatible modes or B-bar. Degree 1 is therefore too stiff where a single layer of
bricks bends; the specimens are compact and loaded in compression and shear, and degree 2 is there where
bending matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc

from fretflow.case.config import Specimen
from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from fretflow.structure.bodies import Material
from fretflow.structure.fem import compat
from fretflow.structure.fem.mesh_file import TaggedMesh


@record
class TaggedFace:
    """Nodes of a tagged face, the same on every rank, sorted by x, then y, then z.

    `nodes` are global node numbers: DOF ``3 node + c`` is direction c. `areas` are the integrals of the shape
    functions, so they sum to the area of the face.
    """

    nodes: NDArray[np.int64] = quantity("1", "(n,)")
    points: NDArray[np.float64] = quantity("m", "(n, 3)")
    areas: NDArray[np.float64] = quantity("m^2", "(n,)")

    @property
    def centroid(self) -> NDArray[np.float64]:
        """Return the centroid of the face (3,) in m."""
        return np.asarray(self.areas @ self.points / self.areas.sum())


@dataclass(frozen=True)
class ElasticBody:
    """Stiffness and mass of a body, distributed over the ranks of `comm` by rows; `destroy` frees them.

    Attributes
    ----------
    stiffness, mass : PETSc.Mat
        (3 N, 3 N) in N/m and kg; DOF ``3 node + c``.
    points : ndarray (owned nodes, 3)
        Coordinates (m) of this rank's nodes, the first of which has the global number `first_node`.
    contact, clamped : TaggedFace
        The two faces.
    total_mass : float
        Density times volume (kg).
    full_dofs : int
        Number of DOFs on all ranks, 3 N.
    mesh : TaggedMesh
        Kept because dolfinx 0.9 frees the communicator that the matrices live on together with the mesh.
    """

    comm: Any
    stiffness: PETSc.Mat
    mass: PETSc.Mat
    points: NDArray[np.float64]
    first_node: int
    contact: TaggedFace
    clamped: TaggedFace
    total_mass: float
    full_dofs: int
    mesh: TaggedMesh

    def destroy(self) -> None:
        """Free the matrices, on every rank together."""
        self.stiffness.destroy()
        self.mass.destroy()

    def nearest_inner_node(self, point: NDArray[np.float64]) -> tuple[int, NDArray[np.float64]]:
        """Return number and coordinates (m) of the node nearest to `point` (3,) that lies on neither face."""
        owned = self.first_node + np.arange(len(self.points))
        on_a_face = np.isin(owned, np.concatenate([self.contact.nodes, self.clamped.nodes]))
        distance = np.where(on_a_face, np.inf, np.linalg.norm(self.points - point, axis=1))
        best = int(np.argmin(distance))
        candidates = self.comm.allgather((float(distance[best]), int(owned[best]), self.points[best]))
        nearest = min(candidates, key=lambda candidate: candidate[:2])
        if not np.isfinite(nearest[0]):
            raise MeshError("the mesh has no node off the contact and clamped faces to observe; refine it")
        return nearest[1], nearest[2]


def assemble(mesh: TaggedMesh, material: Specimen, degree: int) -> ElasticBody:
    """Assemble stiffness and consistent mass of `mesh` and find its faces.

    Parameters
    ----------
    mesh : TaggedMesh
        Mesh in metres.
    material : Specimen
        Young's modulus (Pa), Poisson's ratio and density (kg/m^3).
    degree : int
        Degree of the displacement, 1 or 2.

    Raises
    ------
    MeshError
        If the faces share nodes, or a contact node has no area of its own.
    """
    space = compat.vector_space(mesh.domain, degree)
    moduli = [fem.Constant(mesh.domain, PETSc.ScalarType(value)) for value in elastic_moduli(material)]
    stiffness, mass = elastic_forms(mesh.domain, space, moduli, degree)
    index_map = space.dofmap.index_map
    points = space.tabulate_dof_coordinates()[:index_map.size_local].copy()
    contact = _face(mesh, space, points, mesh.contact_tag)
    clamped = _face(mesh, space, points, mesh.clamped_tag)
    if np.intersect1d(contact.nodes, clamped.nodes).size:
        raise MeshError(f"{mesh.source}: the groups 'contact' and 'clamped' share nodes; keep them apart")
    if not np.all(contact.areas > 0.0):
        raise MeshError(f"{mesh.source}: some contact nodes have no positive area; use hexahedra")
    mass_matrix = compat.assemble_matrix(mass)
    return ElasticBody(
        comm=mesh.comm, stiffness=compat.assemble_matrix(stiffness), mass=mass_matrix, points=points,
        first_node=index_map.local_range[0], contact=contact, clamped=clamped, total_mass=_total(mass_matrix),
        full_dofs=3 * index_map.size_global, mesh=mesh)


def elastic_moduli(material: Specimen | Material) -> tuple[float, float, float]:
    """Return Lame's first parameter and the shear modulus in Pa, and the density in kg/m^3."""
    young, poisson = material.youngs_modulus, material.poissons_ratio
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson)), material.density


def elastic_forms(domain: Any, space: Any, moduli: Sequence[Any], degree: int) -> tuple[Any, Any]:
    """Return the bilinear forms of stiffness and mass of what `elastic_moduli` tells, in UFL.

    As constants or functions these may be others without a new compilation.
    """
    lame, shear, density = moduli
    dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": 2 * degree})
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * shear * strain + lame * ufl.tr(strain) * ufl.Identity(3)
    return ufl.inner(stress, ufl.sym(ufl.grad(v))) * dx, density * ufl.inner(u, v) * dx


def _face(mesh: TaggedMesh, space: Any, points: NDArray[np.float64], tag: int) -> TaggedFace:
    """Collect a tagged face from all ranks."""
    owned = len(points)
    facets = mesh.facet_tags.find(tag)
    nodes = np.unique(fem.locate_dofs_topological(space, 2, facets))
    nodes = nodes[nodes < owned].astype(np.int64)
    ds = ufl.Measure("ds", domain=mesh.domain, subdomain_data=mesh.facet_tags)
    ones = fem.Constant(mesh.domain, PETSc.ScalarType((1.0, 1.0, 1.0)))
    vector = compat.assemble_vector(ufl.inner(ones, ufl.TestFunction(space)) * ds(tag))
    areas = vector.getArray().reshape(-1, 3)[nodes, 0].copy()
    vector.destroy()
    first = space.dofmap.index_map.local_range[0]
    parts = mesh.comm.allgather((nodes + first, points[nodes], areas))
    all_nodes, all_points, all_areas = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = sorted_by_position(all_points)
    return TaggedFace(nodes=all_nodes[order], points=all_points[order], areas=all_areas[order])


def sorted_by_position(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the order of `points` (n, 3) by x, then y, then z.

    Coordinates closer than 1e-6 of the extent are taken as one, so round-off does not matter.
    """
    tolerance = 1e-6 * float(np.max(np.ptp(points, axis=0), initial=0.0))
    ranks = np.empty(points.shape, dtype=np.int64)
    for axis, values in enumerate(points.T):
        order = np.argsort(values, kind="stable")
        ranks[order, axis] = np.cumsum(np.diff(values[order], prepend=values[order[:1]]) > tolerance)
    return np.asarray(np.lexsort(ranks.T[::-1]))


def _total(mass: PETSc.Mat) -> float:
    """Return the mass moved by a unit translation along x."""
    direction = mass.createVecRight()
    direction.getArray().reshape(-1, 3)[:] = (1.0, 0.0, 0.0)
    product = mass.createVecLeft()
    mass.mult(direction, product)
    total = float(direction.dot(product))
    direction.destroy()
    product.destroy()
    return total
