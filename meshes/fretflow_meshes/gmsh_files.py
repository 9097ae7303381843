"""The .msh files: the only place that calls gmsh."""

from __future__ import annotations

import inspect
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from fretflow.core.specimen_mesh import BODY_GROUP, CLAMPED_GROUP, CONTACT_GROUP, copied_mesh
from numpy.typing import NDArray

from fretflow_meshes.hexmesh import HexMesh

# gmsh's element types: (hexahedron, quadrilateral) of each degree.
HEXAHEDRON: Final = 5  # of 8 nodes
QUADRILATERAL: Final = 3  # of 4 nodes
_TYPES: Final = {1: (HEXAHEDRON, QUADRILATERAL), 2: (12, 10)}
_HEXAHEDRA: Final = {kind for kind, _ in _TYPES.values()}
_GROUPS: Final = {CONTACT_GROUP: 2, CLAMPED_GROUP: 2, BODY_GROUP: 3}


@contextmanager
def _interrupt_key_kept() -> Iterator[None]:
    """Keep gmsh from taking over the interrupt key, as it does on import and at its end."""
    with mock.patch.object(signal, "signal", return_value=signal.getsignal(signal.SIGINT)):
        yield


@contextmanager
def gmsh_session(path: Path) -> Iterator[Any]:
    """Open a quiet gmsh with an empty model; whatever gmsh says about `path` becomes a MeshError.

    A gmsh that somebody else has initialised stays so.
    """
    with _interrupt_key_kept():
        import gmsh

        owned = not _is_initialized(gmsh)
        if owned:
            options = {"readConfigFiles": False, "interruptible": False}
            known = inspect.signature(gmsh.initialize).parameters
            gmsh.initialize(**{key: value for key, value in options.items() if key in known})
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("fretflow")
        yield gmsh
    except MeshError:
        raise
    except Exception as error:
        if type(error) is not Exception:  # gmsh raises bare Exception only
            raise
        raise MeshError(f"{path}: gmsh says {str(error).strip()!r}; "
                        "give a readable .msh file and a writable folder") from error
    finally:
        if owned:
            with _interrupt_key_kept():
                gmsh.finalize()
        else:
            gmsh.model.remove()


def _is_initialized(gmsh: Any) -> bool:
    if hasattr(gmsh, "isInitialized"):
        return bool(gmsh.isInitialized())
    try:  # before 4.9 a gmsh that is not initialised answers 0, or raises once it was finalised
        return bool(gmsh.option.getNumber("Mesh.MshFileVersion") > 0.0)
    except Exception as error:
        if type(error) is not Exception:  # gmsh raises bare Exception only
            raise
        return False


@record
class Group:
    """A physical group of a mesh: name, gmsh's type of its elements, and their nodes, numbered from 0."""

    name: str
    kind: int
    elements: NDArray[np.int64] = quantity("1", "(elements, nodes)")


def write_mesh(mesh: HexMesh, path: Path) -> None:
    """Write `mesh` as .msh 4.1 (binary, hence exact) with the physical groups contact, clamped and body.

    Raises
    ------
    MeshError
        If gmsh cannot write the file.
    """
    hexahedron, quadrilateral = _TYPES[mesh.degree]
    write_groups(mesh.points, (Group(name=CONTACT_GROUP, kind=quadrilateral, elements=mesh.contact),
                               Group(name=CLAMPED_GROUP, kind=quadrilateral, elements=mesh.clamped),
                               Group(name=BODY_GROUP, kind=hexahedron, elements=mesh.cells)), path)


def write_groups(points: NDArray[np.float64], groups: Sequence[Group], path: Path) -> None:
    """Write points (n, 3) in m and physical groups, numbered from 1 on, as .msh 4.1.

    Raises
    ------
    MeshError
        If gmsh cannot write the file.
    """
    with gmsh_session(path) as gmsh:
        first = 1
        volumes = [tag for tag, group in enumerate(groups, 1) if group.kind in _HEXAHEDRA]
        for tag, group in enumerate(groups, 1):
            dim = 3 if tag in volumes else 2
            gmsh.model.addDiscreteEntity(dim, tag)
            gmsh.model.addPhysicalGroup(dim, [tag], tag)
            gmsh.model.setPhysicalName(dim, tag, group.name)
        gmsh.model.mesh.addNodes(3, volumes[0], np.arange(1, len(points) + 1), points.ravel())
        for tag, group in enumerate(groups, 1):
            elements = np.arange(first, first + len(group.elements))
            gmsh.model.mesh.addElementsByType(tag, group.kind, elements, group.elements.ravel() + 1)
            first += len(elements)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.option.setNumber("Mesh.SaveAll", 0)
        gmsh.write(str(path))


def read_mesh(path: Path) -> HexMesh:
    """Read the groups contact, clamped and body of a .msh file of any version.

    Raises
    ------
    MeshError
        If the file or a group is missing, or a group holds elements other than hexahedra of 8 or 27 nodes and
        their faces.
    """
    with copied_mesh(path) as copy, gmsh_session(path) as gmsh:
        gmsh.merge(str(copy))
        groups = _groups(gmsh, path)
        hexahedra = [kind for kind, _ in _TYPES.values()]
        connectivity = {BODY_GROUP: _elements(gmsh, path, BODY_GROUP, groups, hexahedra)}
        degree = next(d for d in _TYPES if connectivity[BODY_GROUP].shape[1] == (d + 1) ** 3)
        for name in (CONTACT_GROUP, CLAMPED_GROUP):
            connectivity[name] = _elements(gmsh, path, name, groups, [_TYPES[degree][1]])
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
    used = np.unique(np.concatenate([nodes.ravel() for nodes in connectivity.values()]))
    missing = used[~np.isin(used, tags.astype(np.int64))]
    if len(missing):  # a damaged number may point to what gmsh holds in memory for a node
        raise MeshError(f"{path}: is damaged: its elements name {len(missing)} nodes that are not there; "
                        "write the mesh anew")
    order = np.argsort(tags)
    points = coordinates.reshape(-1, 3)[order[np.searchsorted(tags[order], used)]]
    number = {name: np.searchsorted(used, nodes) for name, nodes in connectivity.items()}
    return HexMesh(points=points, cells=number[BODY_GROUP], contact=number[CONTACT_GROUP],
                   clamped=number[CLAMPED_GROUP])


def _groups(gmsh: Any, path: Path) -> dict[str, NDArray[np.int64]]:
    """Return the entities of each needed physical group."""
    tags = {(gmsh.model.getPhysicalName(dim, tag), dim): tag for dim, tag in gmsh.model.getPhysicalGroups()}
    for name, dim in _GROUPS.items():
        if (name, dim) not in tags:
            kind = "volume" if dim == 3 else "surface"
            have = ", ".join(sorted({n for n, _ in tags if n})) or "none"
            raise MeshError(f"{path}: lacks the physical {kind} {name!r} (it has: {have}); "
                            "name the groups contact, clamped (surfaces) and body (volume)")
    return {name: gmsh.model.getEntitiesForPhysicalGroup(dim, tags[name, dim])
            for name, dim in _GROUPS.items()}


def _elements(gmsh: Any, path: Path, name: str, groups: dict[str, NDArray[np.int64]], accepted: list[int]
              ) -> NDArray[np.int64]:
    """Return the nodes (gmsh's tags) of the group's elements, which must all be of one `accepted` type."""
    kinds: dict[int, list[NDArray[np.int64]]] = {}
    for entity in groups[name]:
        for kind, _, nodes in zip(*gmsh.model.mesh.getElements(_GROUPS[name], int(entity)), strict=True):
            kinds.setdefault(int(kind), []).append(nodes)
    if len(kinds) != 1 or next(iter(kinds)) not in accepted:
        have, need = (" or ".join(gmsh.model.mesh.getElementProperties(k)[0] for k in of) or "no elements"
                      for of in (kinds, accepted))
        raise MeshError(f"{path}: group {name} holds {have}; it must hold {need} only; recombine the mesh, "
                        "or have gmsh cut it into hexahedra (Mesh.SubdivisionAlgorithm = 2)")
    ((kind, blocks),) = kinds.items()
    width = gmsh.model.mesh.getElementProperties(kind)[3]
    return np.concatenate(blocks).astype(np.int64).reshape(-1, width)
