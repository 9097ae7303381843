"""One specimen's mesh: made from its geometry or taken from the user's file, checked and summarised.

Geometry: a body with a ridge across it, which runs along x on the upper specimen (z > 0) and along y on the
lower one (z < 0); the interface is z = 0. A mesh of degree 2 has 27-node hexahedra, so the file holds exactly
the nodes of the field, on square bodies (where they add nothing to the geometry) as on round ones (where the
rim lies on the circle and the geometry error falls from second to fourth order).

The face's curvature is not in the mesh: a crowned or cylindrical face is meshed flat and its `profile` is
given to the contact as a gap, as Hertz's and all half-space theory do. Nodes of both faces then match
whatever the curvature. The ridge is too high by the profile, so its compliance errs by a share of about
profile / ridge_height; above MAX_PROFILE_SHARE the mesh is refused.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
from fretflow.case import config
from fretflow.case.config import FaceShape, Specimen
from fretflow.core.errors import MeshError, PlatformError
from fretflow.core.isolated import call_isolated
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.core.store import write_record
from fretflow.core.units import per_cent
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fretflow_meshes import checks, quality
from fretflow_meshes.gmsh_files import read_mesh, write_mesh
from fretflow_meshes.hexmesh import HexMesh, specimen_mesh, turned_over

MAX_PROFILE_SHARE: Final = 0.05
# Nodes closer than this share of the contact's spacing are one: rounding of text files stays far below it.
MATCH_SHARE: Final = 1e-3


class Side(StrEnum):
    """Which of the two specimens."""

    UPPER = "upper"
    LOWER = "lower"


def build_specimen(specimen: Specimen, mesh: config.Mesh, side: Side, path: Path) -> MeshSummary:
    """Mesh a specimen from its geometry, write it to `path` and summarise what the file holds.

    Raises
    ------
    MeshError
        If the face is too curved for its ridge, the mesh would be too large, or the file cannot be written.
    """
    hexahedra = specimen_mesh(specimen, mesh)
    write_mesh(hexahedra if side is Side.UPPER else turned_over(hexahedra), path)
    return _summarise(read_mesh(path), specimen, side, path, str(path))


def read_specimen(source: Path, specimen: Specimen, mesh: config.Mesh, side: Side, path: Path) -> MeshSummary:
    """Check the user's mesh `source` and write what is used of it to `path`, with fretflow's own group tags.

    The mesh counts in ``mesh.unit``, upper specimen in z > 0 and lower one in z < 0, contact face flat at z = 0.

    Raises
    ------
    MeshError
        If the file, a group or the right elements are missing, the degree differs from ``mesh.degree``, the
        size is implausible, the contact face is not in z = 0, or an element is inverted.
    """
    try:
        hexahedra = call_isolated(read_mesh, source)  # a damaged file may take gmsh's process with it
    except PlatformError as error:
        raise MeshError(f"{source}: is damaged, so that gmsh breaks off in it; write the mesh anew") from error
    hexahedra = replace(hexahedra, points=mesh.unit * hexahedra.points)
    if hexahedra.degree != mesh.degree:
        raise MeshError(f"{source}: holds hexahedra of degree {hexahedra.degree}; "
                        f"set mesh.degree = {hexahedra.degree} or give a mesh of degree {mesh.degree}")
    checks.check_user_mesh(hexahedra, side is Side.UPPER, str(source))
    summary = _summarise(hexahedra, specimen, side, path, str(source))
    write_mesh(hexahedra, path)
    return summary


def check_matching(upper: MeshSummary, lower: MeshSummary) -> None:
    """Check that the contact nodes of both faces coincide, in the same order.

    Raises
    ------
    MeshError
        With the numbers of nodes or the largest distance.
    """
    way_out = "mesh both contact faces with the same grid (same contact_width and contact_elements)"
    if len(upper.contact_nodes) != len(lower.contact_nodes):
        raise MeshError(f"{upper.file}, {lower.file}: {len(upper.contact_nodes)} and "
                        f"{len(lower.contact_nodes)} contact nodes do not match; {way_out}")
    distance = np.linalg.norm(upper.contact_nodes[:, :2] - lower.contact_nodes[:, :2], axis=1)
    tolerance = MATCH_SHARE * _spacing(upper.contact_nodes)
    if distance.max() > tolerance:
        # a node out of line also shifts the order of others, so that each is measured from the nearest
        nearest = cKDTree(lower.contact_nodes[:, :2]).query(upper.contact_nodes[:, :2])[0]
        distance = nearest if nearest.max() > tolerance else distance
        x, y = 1e3 * upper.contact_nodes[np.argmax(distance), :2]
        raise MeshError(f"{upper.file}, {lower.file}: contact nodes lie up to {1e6 * distance.max():.4g} µm "
                        f"apart, most at ({x:.4g}, {y:.4g}) mm; {way_out}")


def mesh_geometry(path: Path) -> MeshGeometry:
    """Return points and corners of the cells of the mesh file `path`; gmsh orders corners as VTK does.

    Raises
    ------
    MeshError
        If the file cannot be read.
    """
    mesh = read_mesh(path)
    used, corners = np.unique(mesh.cells[:, :8], return_inverse=True)
    return MeshGeometry(points=mesh.points[used], hexahedra=corners.reshape(-1, 8).astype(np.int64))


def _summarise(mesh: HexMesh, specimen: Specimen, side: Side, path: Path, name: str) -> MeshSummary:
    measured = quality.measure(mesh)
    quality.refuse_inverted(mesh, measured, name)
    nodes = sorted_nodes(mesh.points[np.unique(mesh.contact)])
    return MeshSummary(
        file=path.name, degree=mesh.degree, cells=len(mesh.cells), nodes=len(mesh.points),
        contact_nodes=nodes, profile=face_profile(specimen, side, nodes),
        observation_point=_observation_point(mesh, nodes, specimen.observation_distance, side),
        min_scaled_jacobian=float(measured.scaled_jacobian.min()),
        min_jacobian=float(measured.jacobian.min()))


def face_profile(specimen: Specimen, side: Side, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far the specimen's curved face lies behind z = 0 at each contact node.

    Crowned: ``(x^2 + y^2) / (2 R)``. Cylindrical: ``s^2 / (2 R)`` with s across the ridge, so the two
    cylinders of a pair are crossed.

    Parameters
    ----------
    nodes : ndarray, shape (nodes, 3), m

    Returns
    -------
    ndarray, shape (nodes,), m

    Raises
    ------
    MeshError
        If the profile exceeds MAX_PROFILE_SHARE of the ridge's height.
    """
    x, y = nodes[:, 0], nodes[:, 1]
    if specimen.face_radius is None:
        return np.zeros(len(nodes))
    across = y if side is Side.UPPER else x
    squared = x**2 + y**2 if specimen.face is FaceShape.CROWNED else across**2
    profile = np.asarray(squared / (2.0 * specimen.face_radius))
    limit = MAX_PROFILE_SHARE * specimen.ridge_height
    if profile.max() > limit:
        needed = specimen.face_radius * profile.max() / limit
        raise MeshError(f"specimen.{side}.face_radius: the face falls off by {1e6 * profile.max():.4g} µm, "
                        f"above {per_cent(MAX_PROFILE_SHARE)} of ridge_height, too much for an initial gap on a "
                        f"flat mesh; give at least {1e3 * needed:.4g} mm")
    return profile


def sorted_nodes(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sort contact nodes by x, then y; coordinates that differ by noise only count as equal.

    Parameters
    ----------
    nodes : ndarray, shape (nodes, 3), m
    """
    tolerance = MATCH_SHARE * _spacing(nodes)
    return np.asarray(nodes[np.lexsort((_ranks(nodes[:, 1], tolerance), _ranks(nodes[:, 0], tolerance)))])


def _ranks(values: NDArray[np.float64], tolerance: float) -> NDArray[np.int64]:
    """Return each value's number among the distinct ones; neighbours closer than `tolerance` share it."""
    order = np.argsort(values)
    ranks = np.empty(len(values), dtype=np.int64)
    ranks[order] = np.concatenate(([0], np.cumsum(np.diff(values[order]) > tolerance)))
    return ranks


def _spacing(nodes: NDArray[np.float64]) -> float:
    """Return the spacing (m) of as many nodes on a square grid as wide as the contact."""
    return float(np.ptp(nodes[:, :2], axis=0).max() / (np.sqrt(len(nodes)) - 1.0))


def _observation_point(mesh: HexMesh, contact: NDArray[np.float64], distance: float, side: Side
                       ) -> NDArray[np.float64]:
    """Return the node nearest to the ridge's flank at mid-length, `distance` from the interface.

    A distance beyond the ridge's height is measured on, into the body, in the plane of the flank. Of nodes
    equally near, the one with the largest x + y - |z| is taken.
    """
    half = contact[:, :2].max(axis=0)
    target = np.array([0.0, half[1], distance] if side is Side.UPPER else [half[0], 0.0, -distance])
    away = np.linalg.norm(mesh.points - target, axis=1)
    nearest = mesh.points[away <= away.min() + MATCH_SHARE * _spacing(contact)]
    return np.asarray(nearest[np.argmax(nearest[:, 0] + nearest[:, 1] - np.abs(nearest[:, 2]))])


def run_mesh(case: config.Case, out: Path) -> tuple[MeshSummary, MeshSummary]:
    """Make or read both meshes and write them to the folder `out`.

    Written for each side: ``<side>.msh``, ``<side>.h5`` (MeshSummary), ``<side>_geometry.h5`` (MeshGeometry).

    Returns
    -------
    tuple of MeshSummary
        The upper and the lower specimen's.

    Raises
    ------
    MeshError
        If a mesh cannot be made, read or used, or the contact nodes do not match.
    StoreError
        If a record cannot be written.
    """
    upper = _one(case.specimen.upper, case.mesh, case.mesh.upper, Side.UPPER, out)
    lower = _one(case.specimen.lower, case.mesh, case.mesh.lower, Side.LOWER, out)
    check_matching(upper, lower)
    return upper, lower


def _one(specimen: config.Specimen, mesh: config.Mesh, source: Path | None, side: Side, out: Path
         ) -> MeshSummary:
    path = out / f"{side}.msh"
    summary = (build_specimen(specimen, mesh, side, path) if source is None
               else read_specimen(source, specimen, mesh, side, path))
    write_record(out / f"{side}.h5", summary)
    write_record(out / f"{side}_geometry.h5", mesh_geometry(path))
    return summary
