"""Every difference between the dolfinx releases that fretflow runs on (0.5 of Debian 12, 0.9 of Debian 13).

Used in one way on both: `fem.form`, `fem.locate_dofs_topological`, `fem.Constant`, `ufl.Measure` and
`fem.petsc.assemble_matrix`, whose results are PETSc objects.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import dolfinx.fem.petsc
import dolfinx.jit
import dolfinx.mesh
import ffcx
import gmsh
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.io import gmshio
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from fretflow.core.errors import MeshError, PlatformError
from fretflow.core.specimen_mesh import copied_mesh

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh

T = TypeVar("T")
ONE_RANK = MPI.COMM_SELF
_NEW = hasattr(fem, "functionspace")  # dolfinx 0.9; what were parameters are options there
_WORD = "options" if _NEW else "params"
_JIT = {name: entry[0] for name, entry in getattr(
    dolfinx.jit, f"DOLFINX_DEFAULT_JIT_{'OPTIONS' if _NEW else 'PARAMETERS'}").items()}
_FORMS = {name: entry[-3 if len(entry) > 2 else 0] for name, entry in (
    ffcx.options.FFCX_DEFAULT_OPTIONS if _NEW else ffcx.parameters.FFCX_DEFAULT_PARAMETERS).items()}
_ABANDONED = 86400.0  # s; no compilation takes a day
_MOST_WORDS = 300  # characters of the last failure that are passed on


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
    return _vectors(mesh, "Lagrange", degree)


def cell_vectors(mesh: Mesh) -> Any:
    """Return the space of three-vectors that are constant in each cell."""
    return _vectors(mesh, "DG", 0)


def corners(mesh: Mesh, cells: Any, facets: NDArray[np.int32]) -> dict[int, NDArray[np.float64]]:
    """Return the corners (k, 3) in m of facets, each by the number that its cell has in the space `cells`."""
    for pair in ((2, 0), (2, 3), (0, 3)):  # the last is what 0.9 finds coordinates by
        mesh.topology.create_connectivity(*pair)
    vertices, own = (mesh.topology.connectivity(2, dim) for dim in (0, 3))
    return {int(cells.dofmap.cell_dofs(own.links(one)[0])[0]): dolfinx.mesh.compute_midpoints(
        mesh, 0, vertices.links(one)) for one in facets}


def _vectors(mesh: Mesh, family: str, degree: int) -> Any:
    if _NEW:  # 0.9 takes options of the compiler and compiles no code for elements
        return fem.functionspace(mesh, (family, degree, (3,)))
    element = ufl.VectorElement(family, mesh.ufl_cell(), degree, dim=3)
    what = f"vectors {element} {mesh.ufl_cell()}"
    return _compiled(mesh.comm, what, lambda options: fem.FunctionSpace(mesh, element, **options))


def mesh_from_gmsh(comm: MPI.Comm) -> tuple[Mesh, Any, Any]:
    """Return the mesh of the gmsh model open on rank 0, distributed over `comm`, and its cells' and facets' tags."""
    # 0.5.2 as Debian ships it has no usable read_from_msh; model_to_mesh is the same in both releases.
    return tuple(gmshio.model_to_mesh(gmsh.model, comm, 0, gdim=3))[:3]


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


def _form(form: Any) -> Any:
    return _compiled(form.ufl_domain().ufl_cargo().comm, form.signature(), lambda options: fem.form(form, **options))


def _compiled(comm: MPI.Comm, what: str, make: Callable[[dict[str, Any]], T]) -> T:
    """Return what `make` makes with options for dolfinx, which keep the machine code of `what` in the user's cache.

    ffcx waits for a file that an interrupted compiler never writes. So each piece is compiled in a new folder, which
    gets its final name when it is complete. The options leave none to files in the working folder, which could have
    gcc load a plug-in.

    Raises
    ------
    PlatformError
        On every rank, if it can be compiled neither in the cache nor in the folder for temporary files.
    """
    key = (what, dolfinx.__version__, ffcx.__version__, sys.implementation.cache_tag)
    kept = _cache() / hashlib.sha256(repr(key).encode()).hexdigest()[:24]
    failure = f"no folder can be made in {kept.parent}"
    for parent in (kept, kept.parent, Path(tempfile.gettempdir())):
        place = comm.bcast(_place(parent, kept) if comm.rank == 0 else None, root=0)
        if place is None:
            continue
        waiting = {"timeout": 1} if place == kept else {}  # s; nobody is compiling in a folder that has its name
        options = {f"jit_{_WORD}": _JIT | {"cache_dir": place} | waiting, f"form_compiler_{_WORD}": dict(_FORMS)}
        made, trouble = None, ""
        try:
            with _quiet_compilation():
                made = make(options)
        except Exception as error:  # noqa: BLE001 - compiler, linker, loader and disk raise many kinds
            trouble = f"{type(error).__name__}: {' '.join(str(error).split())}"
        finally:  # also where the user interrupts
            if made is None and comm.rank == 0:
                shutil.rmtree(place, ignore_errors=True)
        troubles = [words for words in comm.allgather(trouble) if words]
        if comm.rank == 0 and not troubles and place != kept:
            _keep(place, kept)
        if made is not None and not troubles:
            return made
        failure = troubles[0][-_MOST_WORDS:]
    raise PlatformError(f"the equations cannot be compiled ({failure}); see that gcc works and that {kept.parent} has "
                        "room, or name another cache by XDG_CACHE_HOME")


def _cache() -> Path:
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # the user has no home
        home = Path(tempfile.gettempdir()) / f"cache-{os.getuid()}"
    return home / "fretflow" / "forms"


def _place(parent: Path, kept: Path) -> Path | None:
    """Return the complete folder `kept` if it is asked for, or a new one in `parent`; None where there is none."""
    try:
        if parent == kept:  # code that another user may have put there is not run
            state = kept.stat()
            return kept if state.st_uid == os.getuid() and not state.st_mode & 0o022 else None
        parent.mkdir(parents=True, exist_ok=True)
        if parent == kept.parent:
            for left in parent.glob("*.*"):
                if time.time() - left.stat().st_mtime > _ABANDONED:
                    shutil.rmtree(left, ignore_errors=True)
        return Path(tempfile.mkdtemp(prefix=f"{kept.name}.", dir=parent))
    except OSError:
        return None


def _keep(place: Path, kept: Path) -> None:
    """Give what was compiled in `place` its final name, unless another process was first or the cache took nothing."""
    if place.parent == kept.parent:
        with suppress(OSError):
            place.rename(kept)
            return
    shutil.rmtree(place, ignore_errors=True)


def assemble_matrix(form: Any) -> PETSc.Mat:
    """Assemble the bilinear UFL `form` into a PETSc matrix."""
    matrix = dolfinx.fem.petsc.assemble_matrix(_form(form))
    matrix.assemble()
    return matrix


def assemble_vector(form: Any) -> PETSc.Vec:
    """Assemble the linear UFL `form` into a PETSc vector, contributions of all ranks added."""
    vector = dolfinx.fem.petsc.assemble_vector(_form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector
