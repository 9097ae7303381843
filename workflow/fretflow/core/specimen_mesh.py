"""What a mesh has to say to the rest: its file, its group names, its contact nodes."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import MeshError
from fretflow.core.mesh_formats import write_as_msh
from fretflow.core.records import quantity, record

# Names of the physical groups that a mesh must have; a user's own mesh carries the same.
CONTACT_GROUP = "contact"
CLAMPED_GROUP = "clamped"
BODY_GROUP = "body"
_BEGINNINGS = (b"$MeshFormat", b"$NOD")  # of versions 2 to 4 and of version 1

# half round about x = y: how the upper specimen lies as the lower one, (x, y, z) -> (y, x, -z)
TURN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@record
class MeshSummary:
    """A specimen's mesh, as the mesh stage reports it; the .msh file lies beside it.

    Contact nodes are sorted by x, then y. For a curved face `profile` is the distance of each contact node
    from the plane z = 0 (not negative), hence that body's part of the initial gap.
    """

    file: str  # name of the .msh file, in the same folder
    degree: int
    cells: int
    nodes: int
    contact_nodes: NDArray[np.float64] = quantity("m", "(contact nodes, 3)")
    profile: NDArray[np.float64] = quantity("m", "(contact nodes,)")
    observation_point: NDArray[np.float64] = quantity("m", "(3,)")
    min_scaled_jacobian: float = quantity("1")
    min_jacobian: float = quantity("m^3")


@record
class MeshGeometry:
    """Points and cells of a specimen's mesh for pictures; second-degree cells give their eight corners."""

    points: NDArray[np.float64] = quantity("m", "(points, 3)")
    hexahedra: NDArray[np.int64] = quantity("1", "(cells, 8), VTK order")


@contextmanager
def copied_mesh(path: Path) -> Iterator[Path]:
    """Yield a copy of a mesh in gmsh's format that lies alone in a folder of its own, for gmsh to merge.

    A file of another ending is written anew (see `core.mesh_formats`). Beside ``NAME.msh`` gmsh looks for
    ``NAME.msh.opt`` and runs the commands in it, and it runs any text that is no mesh as a script.

    Raises
    ------
    MeshError
        If the file cannot be read or copied, or is no mesh.
    """
    try:
        if path.exists() and not path.is_file():
            raise MeshError(f"{path}: is no file; give the path of a .msh file")
        with path.open("rb") as file:
            if path.suffix == ".msh" and not file.read(16).startswith(_BEGINNINGS):
                raise MeshError(f"{path}: is no .msh file; save the mesh in gmsh's format with that ending")
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror}); give the path of a .msh file") from error
    with tempfile.TemporaryDirectory(prefix="fretflow-mesh-") as folder:
        copy = Path(folder) / f"{path.stem}.msh"
        try:
            if path.suffix == ".msh":
                shutil.copyfile(path, copy)
            else:
                write_as_msh(path, copy)
        except OSError as error:
            raise MeshError(f"{path}: cannot be copied to {folder} ({error.strerror}); free some space there, or name "
                            "another folder by TMPDIR") from error
        yield copy
