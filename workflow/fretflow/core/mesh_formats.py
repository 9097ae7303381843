"""Meshes of other formats than gmsh's: read by meshio, their named sets made the physical groups of a .msh file."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import MeshError
from fretflow.core.store import open_hdf5

Cells = NDArray[np.int64]

BODIES = "body"  # group of the solids that belong to none
# Faces of a solid by its nodes in meshio's order, which is VTK's, and the kind of each.
_FACES = {
    "tetra": ("triangle", [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    "tetra10": ("triangle6", [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]]),
    "hexahedron": ("quad", [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]),
}
_CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4}
# Of each cell, the number of the set that it is in, as gmsh, Salome, Medit, Nastran and SU2 call it.
_NUMBERS = ("gmsh:physical", "cell_tags", "medit:ref", "nastran:ref", "su2:tag")
# What tells that another file holds a part, by ending; meshio drops all asterisks of Abaqus' keywords, and of TetGen's
# two files neither is whole.
_PARTED = {".inp": re.compile(rb"^[\s*]*\*[\s*]*" + rb"\**".join(bytes([one]) for one in b"include"),
                              re.IGNORECASE | re.MULTILINE),
           **dict.fromkeys((".xdmf", ".xmf"), re.compile(rb"<!ENTITY|xi:include|Format\s*=\s*[\"'](?!XML)",
                                                         re.IGNORECASE)),
           **dict.fromkeys((".node", ".ele"), re.compile(rb""))}


def write_as_msh(path: Path, copy: Path) -> None:
    """Write a mesh of any format that meshio reads, in metres, to `copy` in gmsh's.

    Sets of elements become groups; sets of nodes become groups of the outer faces all of whose corners are in them;
    cells that have but a number are in a group of that number. A solid is in the smallest of its sets, or in ``body``.

    Raises
    ------
    MeshError
        If the file cannot be read, holds no solids, or has a facet in two groups.
    """
    import meshio  # takes a tenth of a second, for those who need it

    mesh = _read(path)
    sets = list(_sets(mesh))
    solids = [block for block in mesh.cells if block.dim == 3]
    if not solids:
        raise MeshError(f"{path}: holds no solid elements; save the bodies' mesh, not their surfaces alone")
    named = {(3, name): own for name, own in _bodies(mesh, sets)}
    for name, block, places in sets:
        if mesh.cells[block].dim == 2:
            named.setdefault((2, name), []).append((mesh.cells[block].type, mesh.cells[block].data[places]))
    for name, nodes in mesh.point_sets.items():
        faces = [] if (2, name) in named else list(_faces_within(solids, np.asarray(nodes, dtype=np.int64)))
        if faces:
            named[2, name] = faces
    _refuse_shared(path, {name: own for (dim, name), own in named.items() if dim == 2})
    blocks = [(kind, cells, tag) for tag, own in enumerate(named.values(), start=1) for kind, cells in own]
    tags = [np.full(len(cells), tag) for _, cells, tag in blocks]
    written = meshio.Mesh(mesh.points, [(kind, cells) for kind, cells, _ in blocks],
                          cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
                          field_data={name: np.array([tag, dim]) for tag, (dim, name) in enumerate(named, start=1)})
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        meshio.write(copy, written, file_format="gmsh22", binary=True)


def _read(path: Path) -> Any:
    """Return what meshio reads of a file."""
    import meshio

    kinds = meshio.extension_to_filetypes.get(path.suffix.lower(), [])
    if not kinds:
        raise MeshError(f"{path}: is of no known format; save the mesh as .msh, or one that meshio reads, as .inp, "
                        ".med, .bdf or .vtu")
    _refuse_parts(path)
    trouble = "empty"
    for kind in kinds:
        try:
            with redirect_stdout(io.StringIO()) as told, redirect_stderr(told):
                return meshio.read(path, file_format=kind)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a damaged file raises any of many kinds
            trouble = str(error) if isinstance(error, meshio.ReadError) and str(error) else told.getvalue()
    raise MeshError(f"{path}: meshio cannot read it ({' '.join(trouble.split())[:200] or 'damaged'}); write the mesh "
                    "again, best as .msh")


def _refuse_parts(path: Path) -> None:
    """Refuse a mesh of which another file holds a part: it would be read unasked, and its changes not be seen."""
    tells = _PARTED.get(path.suffix.lower())
    try:
        if h5py.is_hdf5(path):
            with open_hdf5(path, MeshError):  # refuses links
                return
        if tells is None or not tells.search(path.read_bytes()):
            return
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error}); write the mesh again, best as .msh") from error
    raise MeshError(f"{path}: a part of it lies in another file; save the mesh as one file, best as .msh")


def _sets(mesh: Any) -> Iterator[tuple[str, int, Cells]]:
    """Yield the sets of elements: name, number of a block and places (k,) of elements in it."""
    for name, own in mesh.cell_sets.items():
        if ":" not in name:  # what gmsh:physical and the like are told by below
            for block, places in enumerate(own):
                if places is not None and len(places):
                    yield name, block, np.asarray(places, dtype=np.int64)
    names = {(int(tag), int(dim)): name for name, (tag, dim) in mesh.field_data.items()}
    spoken: Mapping[int, list[str]] = getattr(mesh, "cell_tags", {})
    known = set(mesh.cell_sets)
    for key in _NUMBERS:
        for block, numbers in enumerate(mesh.cell_data.get(key, [])):
            for number in set(np.unique(numbers)) - {0}:  # which is in no set
                own_names = spoken.get(int(number)) or [names.get((int(number), mesh.cells[block].dim), str(number))]
                for name in own_names:
                    if name not in known:
                        yield name, block, np.flatnonzero(np.asarray(numbers) == number)


def _bodies(mesh: Any, sets: list[tuple[str, int, Cells]]) -> Iterator[tuple[str, list[tuple[str, Cells]]]]:
    """Yield the groups of solids: name and elements by kind."""
    owner = {block: np.full(len(own.data), -1) for block, own in enumerate(mesh.cells) if own.dim == 3}
    solid = [one for one in sets if one[1] in owner]
    size = {name: sum(len(places) for own, _, places in solid if own == name) for name in dict.fromkeys(
        name for name, _, _ in solid)}
    order = sorted(size, key=lambda name: -size[name])
    for name, block, places in sorted(solid, key=lambda one: -size[one[0]]):
        owner[block][places] = order.index(name)
    for place, name in [*enumerate(order), (-1, BODIES)]:
        own = [(mesh.cells[block].type, mesh.cells[block].data[numbers == place])
               for block, numbers in owner.items() if np.any(numbers == place)]
        if own:
            yield name, own


def _faces_within(solids: list[Any], nodes: Cells) -> Iterator[tuple[str, Cells]]:
    """Yield the outer faces of blocks of solids, by kind, all of whose corners are among some nodes."""
    for kind, (face, places) in _FACES.items():
        cells = [block.data[:, places].reshape(-1, len(places[0])) for block in solids if block.type == kind]
        if not cells:
            continue
        own = np.vstack(cells)
        corners = np.sort(own[:, :_CORNERS[face]], axis=1)
        _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
        outer = first[count == 1]
        within = outer[np.isin(corners[outer], nodes).all(axis=1)]
        if len(within):
            yield face, own[within]


def _refuse_shared(path: Path, surfaces: Mapping[str, list[tuple[str, Cells]]]) -> None:
    """Refuse facets that are in two groups, as a facet has one number."""
    seen: dict[frozenset[int], str] = {}
    for name, own in surfaces.items():
        for facet in (frozenset(facet) for _, cells in own for facet in cells.tolist()):
            other = seen.setdefault(facet, name)
            if other != name:
                raise MeshError(f"{path}: a facet is in {other!r} and in {name!r}; give each facet one set")
