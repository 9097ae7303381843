"""Reading a specimen's mesh: the .msh file and its named groups, checked before any rank waits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fretflow.core.errors import FretflowError, MeshError
from fretflow.core.specimen_mesh import BODY_GROUP, CLAMPED_GROUP, CONTACT_GROUP
from fretflow.structure.fem import compat

_GROUPS = {CONTACT_GROUP: 2, CLAMPED_GROUP: 2, BODY_GROUP: 3}
# gmsh's element types of 4 or 9 nodes and of 8 or 27 nodes.
_QUADRILATERALS_AND_HEXAHEDRA = {2: {3, 10}, 3: {5, 12}}
NO_FILE = "{path}: no such mesh file; give the path of a .msh file"
T = TypeVar("T")


@dataclass(frozen=True)
class TaggedMesh:
    """A dolfinx mesh over the ranks of `comm` and the tags of its contact and clamped facets.

    `source` names it in errors. `comm` outlives the mesh, unlike ``domain.comm``.
    """

    comm: Any
    domain: Any
    facet_tags: Any
    contact_tag: int
    clamped_tag: int
    source: str


def read_mesh(path: Path, comm: Any) -> TaggedMesh:
    """Read the hexahedral mesh `path` (.msh, metres) onto the ranks of `comm`.

    The physical groups are found by name: surfaces ``contact`` and ``clamped``, volume ``body``.

    Raises
    ------
    MeshError
        If the file is missing or damaged, lacks a group, or has other cells than hexahedra.
    """
    with ExitStack() as stack:
        groups = comm.bcast(on_root(comm, lambda: stack.enter_context(_checked_model(path))), root=0)
        domain, _, facet_tags = compat.mesh_from_gmsh(comm)
    return TaggedMesh(comm, domain, facet_tags, groups[CONTACT_GROUP], groups[CLAMPED_GROUP], str(path))


@dataclass(frozen=True)
class MeshedBodies:
    """A dolfinx mesh of any bodies on one rank; tags of its cells and facets, and the tag of each group's name."""

    domain: Any
    cell_tags: Any
    facet_tags: Any
    volumes: dict[str, int]
    surfaces: dict[str, int]


def read_bodies(path: Path, unit: float = 1.0) -> MeshedBodies:
    """Read a mesh of any bodies on this rank, whose coordinates are in units of so many metres.

    Raises
    ------
    MeshError
        If the file is missing or damaged, or has no group of volumes.
    """
    if not path.is_file():
        raise MeshError(NO_FILE.format(path=path))
    with compat.gmsh_model(path) as gmsh:
        groups = [(dim, tag, gmsh.model.getPhysicalName(dim, tag)) for dim, tag in gmsh.model.getPhysicalGroups()]
        if not any(dim == 3 for dim, _, _ in groups):
            raise MeshError(f"{path}: has no physical volume; give each body a group in the mesher")
        _check_faces(path, gmsh.model)
        gmsh.model.mesh.renumberNodes()
        try:
            domain, cell_tags, facet_tags = compat.mesh_from_gmsh(compat.ONE_RANK)
        except (RuntimeError, LookupError, ValueError) as error:
            raise MeshError(f"{path}: cannot be made a mesh ({error}); all volumes need elements of one kind, and "
                            "surface groups their faces") from error
    domain.geometry.x[:] *= unit
    volumes, surfaces = ({name: tag for dim, tag, name in groups if dim == own} for own in (3, 2))
    return MeshedBodies(domain, cell_tags, facet_tags, volumes, surfaces)


@contextmanager
def _checked_model(path: Path) -> Iterator[dict[str, int]]:
    """Open `path` in gmsh, check it and yield the tag of each group."""
    if not path.is_file():
        raise MeshError(NO_FILE.format(path=path))
    with compat.gmsh_model(path) as gmsh:
        model = gmsh.model
        named = {(model.getPhysicalName(dim, tag), dim): tag for dim, tag in model.getPhysicalGroups()}
        for name, dim in _GROUPS.items():
            if (name, dim) not in named:
                kind = "surface" if dim == 2 else "volume"
                raise MeshError(f"{path}: has no physical {kind} named {name!r}; add it in the mesher")
            _check_elements(path, model, name, dim, named[name, dim])
        _check_faces(path, model)
        # dolfinx wants node numbers without holes; a user's file may have them.
        model.mesh.renumberNodes()
        yield {name: named[name, dim] for name, dim in _GROUPS.items()}


def _check_elements(path: Path, model: Any, name: str, dim: int, tag: int) -> None:
    entities = model.getEntitiesForPhysicalGroup(dim, tag)
    types = [tuple(model.mesh.getElementTypes(dim, entity)) for entity in entities]
    kinds = {t for several in types for t in several}
    if not kinds:
        raise MeshError(f"{path}: the group {name!r} is empty; mesh the geometry before saving it")
    if not kinds <= _QUADRILATERALS_AND_HEXAHEDRA[dim] or len(kinds) > 1:
        raise MeshError(f"{path}: the group {name!r} has other elements than hexahedra of 8 or 27 nodes "
                        f"and their faces (gmsh types {sorted(kinds)}); recombine the mesh")


def _check_faces(path: Path, model: Any) -> None:
    """Refuse surface groups with facets that are faces of no element, which dolfinx does not survive."""
    def faces(dim: int, tag: int, corners: int) -> Any:
        own = [np.asarray(model.mesh.getElementFaceNodes(kind, corners, entity, True))
               for entity in model.getEntitiesForPhysicalGroup(dim, tag)
               for kind in model.mesh.getElementTypes(dim, entity)]
        return np.sort(np.concatenate([np.zeros(0, dtype=np.uint64), *own]).reshape(-1, corners), axis=1)

    groups = model.getPhysicalGroups()
    for corners in (3, 4):
        each = np.dtype([("", np.uint64)] * corners)
        solid = np.concatenate([faces(dim, tag, corners) for dim, tag in groups if dim == 3])
        for tag in (tag for dim, tag in groups if dim == 2):
            own = faces(2, tag, corners)
            loose = int(np.sum(~np.isin(own.view(each), solid.view(each))))
            if loose:
                name = model.getPhysicalName(2, tag)
                raise MeshError(f"{path}: {loose} of {len(own)} facets of {name!r} are faces of no element; mesh the "
                                "surfaces together with their bodies")


def on_root(comm: Any, work: Callable[[], T]) -> T | None:
    """Run `work` on rank 0 of `comm` and return its value there, None elsewhere.

    Raises
    ------
    FretflowError
        On every rank, if `work` raised it on rank 0.
    """
    value: T | None = None
    failure: FretflowError | None = None
    if comm.rank == 0:
        try:
            value = work()
        except FretflowError as error:
            failure = error
    failure = comm.bcast(failure, root=0)
    if failure is not None:
        raise failure
    return value
