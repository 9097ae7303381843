"""Every difference between the dolfinx releases that fretflow runs on (0.5 of Debian 12, 0.9 of Debian 13).

Used in one way on both: `fem.form`, `fem.locate_dofs_topological`, `fem.Constant`, `ufl.Measure` and
`fem.petsc.assemble_matrix`, whose results are PETSc objects.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dolfinx.fem.petsc
import gmsh
from dolfinx import fem
from dolfinx.io import gmshio
from petsc4py import PETSc

from fretflow.core.errors import MeshError
from fretflow.core.specimen_mesh import copied_mesh

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh
    from mpi4py import MPI


@contextmanager
def _quiet_compilation() -> Iterator[None]:
    """Silence gcc's commands, and ffcx 0.5's warning of an unclosed file, at the first use of a form."""
    disabled = logging.root.manager.disable
    logging.disable(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            yield
    finally:
        logging.disable(disabled)


def vector_space(mesh: Mesh, degree: int) -> Any:
    """Return the continuous Lagrange space of three-vectors of `degree` on `mesh`."""
    with _quiet_compilation():
        if hasattr(fem, "functionspace"):
            return fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        return fem.VectorFunctionSpace(mesh, ("Lagrange", degree), dim=3)


def mesh_from_gmsh(comm: MPI.Comm) -> tuple[Mesh, Any]:
    """Return the mesh of the gmsh model open on rank 0, distributed over `comm`, and its facet tags."""
    # 0.5.2 as Debian ships it has no usable read_from_msh; model_to_mesh is the same in both releases.
    mesh, _, facet_tags = gmshio.model_to_mesh(gmsh.model, comm, 0, gdim=3)
    return mesh, facet_tags


@contextmanager
def gmsh_model(path: Path) -> Iterator[Any]:
    """Open the .msh file `path` in gmsh, silently, and yield gmsh; closed on leaving.

    Raises
    ------
    MeshError
        If gmsh cannot read the file.
    """
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(path.stem)
        try:
            with copied_mesh(path) as copy:
                gmsh.merge(str(copy))
        except MeshError:
            raise
        except Exception as error:  # gmsh raises nothing more specific
            raise MeshError(f"{path}: gmsh cannot read it ({error}); write the mesh again as .msh") from error
        yield gmsh
    finally:
        gmsh.finalize()


def _compiled(form: Any) -> Any:
    with _quiet_compilation():
        return fem.form(form)


def assemble_matrix(form: Any) -> PETSc.Mat:
    """Assemble the bilinear UFL `form` into a PETSc matrix."""
    matrix = dolfinx.fem.petsc.assemble_matrix(_compiled(form))
    matrix.assemble()
    return matrix


def assemble_vector(form: Any) -> PETSc.Vec:
    """Assemble the linear UFL `form` into a PETSc vector, contributions of all ranks added."""
    vector = dolfinx.fem.petsc.assemble_vector(_compiled(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector
