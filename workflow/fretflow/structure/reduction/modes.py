"""Constraint and fixed-interface modes of a body, by PETSc and SLEPc on one MUMPS Cholesky factorisation."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse
from scipy.linalg import block_diag, eigh
from slepc4py import SLEPc

from fretflow.core.errors import AuditError, NonConvergenceError
from fretflow.structure.fem.cholesky import MUMPS_COLUMNS
from fretflow.structure.fem.elasticity import ElasticBody
from fretflow.structure.reduction.condensation import condense
from fretflow.structure.reduction.craig_bampton import ComponentModes, rigid_motions
from fretflow.structure.reduction.reduced_specimen import OBSERVATION_DOFS, RIGID_DOFS, ModeShapes

_EIGEN_TOLERANCE = 1e-13
_RESIDUAL_LIMIT = 1e-7


def component_modes(body: ElasticBody, observation: int, count: int) -> ComponentModes | None:
    """Project `body` onto constraint modes, its `count` lowest fixed-interface modes and residual vectors.

    Constraint modes: a unit displacement of each contact DOF, of the clamped face as a rigid body about its
    centroid (6), and of the node `observation` (global number, 3); the rest of the boundary held, the inside
    free of force. Residual vectors (30): the static answer of the inside to the inertia of the constraint
    modes while contact face, clamped face or observation node move rigidly, and its answer to the inertia of
    that answer, freed of the modes. They stand for the inertia of the modes left out, which ten modes alone
    miss by up to 1 % in frequency, and change no static stiffness (block Krylov vectors about zero frequency:
    T.-J. Su, R. R. Craig, Model reduction and control of flexible structures using Krylov vectors, J. Guid.
    Control Dyn. 14 (1991)).

    Returns
    -------
    ComponentModes or None
        On rank 0; None on the other ranks.

    Raises
    ------
    NonConvergenceError
        If SLEPc finds fewer modes than asked.
    AuditError
        If the modes miss their equations by more than 1e-7, or are not orthonormal.
    """
    boundary = _boundary_motion(body, observation)
    inner = np.repeat(np.diff(boundary.indptr)[::3] == 0, 3)
    stiffness_across = _times(body.stiffness, boundary)
    mass_across = _times(body.mass, boundary)
    condensed = _condensed(body, boundary, inner)
    _give_back()
    with (_inside(body.stiffness, inner) as stiffness, _inside(body.mass, inner) as mass,
          _factor(stiffness) as factor):
        motions = _boundary_motions(body)
        moved = _solve(factor, -(stiffness_across[inner] @ motions))
        squares, modes = _lowest_modes(stiffness, mass, factor, count)
        answers = _solve(factor, _product(mass, moved) + mass_across[inner] @ motions)
        first = answers[:, :-1]
        second = _solve(factor, _product(mass, first))
        more, vectors = _residual_vectors(stiffness, mass, modes, np.hstack([first, second]))
        squares, modes = np.concatenate([squares, more]), np.hstack([modes, vectors])
        modes *= _sign(body, inner, modes)
        mass_times_modes = _product(mass, modes)
        _check_orthonormal(body.comm, modes, mass_times_modes)
        against_modes = -(stiffness_across[inner].T @ _solve(factor, mass_times_modes))
    whole = sparse.csr_matrix(boundary.T)
    parts = [_sum_on_root(body.comm, part) for part in (
        whole @ (stiffness_across @ motions) + stiffness_across[inner].T @ moved,
        whole @ (mass_across @ motions) + mass_across[inner].T @ moved - stiffness_across[inner].T @ answers,
        mass_across[inner].T @ modes + against_modes)]
    if condensed is None:
        return None
    for name, matrix, known in zip(("stiffness", "mass"), condensed, parts, strict=False):
        _check_condensed(matrix @ motions, known, name)
    return ComponentModes(constraint_stiffness=condensed[0], constraint_mass=condensed[1], coupling=parts[2],
                          modal_frequencies=np.sqrt(squares) / (2.0 * np.pi))


def natural_modes(body: ElasticBody, count: int) -> ModeShapes | None:
    """Return the `count` lowest modes of the full model with only its clamped face fixed; on rank 0, else None.

    A mode's largest component is positive, so that runs agree.

    Raises
    ------
    NonConvergenceError
        If SLEPc finds fewer modes than asked.
    """
    nodes = body.first_node + np.arange(len(body.points))
    free = np.repeat(~np.isin(nodes, body.clamped.nodes), 3)
    with (_inside(body.stiffness, free) as stiffness, _inside(body.mass, free) as mass,
          _factor(stiffness) as factor):
        squares, modes = _lowest_modes(stiffness, mass, factor, count)
    motion = np.zeros((len(free), count))
    motion[free] = modes
    parts = body.comm.gather((body.points, motion.reshape(-1, 3, count)))
    if parts is None:
        return None
    points, shape = (np.concatenate(owned) for owned in zip(*parts, strict=True))
    every = shape.reshape(-1, count)
    shape = shape * np.sign(every[np.argmax(np.abs(every), axis=0), np.arange(count)])
    return ModeShapes(frequency=np.sqrt(squares) / (2.0 * np.pi), points=points, shape=np.moveaxis(shape, 2, 0).copy())


def _boundary_motion(body: ElasticBody, observation: int) -> sparse.csr_matrix:
    """Return this rank's rows of the boundary's motion per boundary coordinate (owned DOFs, 3 n + 9)."""
    contact_dofs = 3 * len(body.contact.nodes)
    clamped = rigid_motions(body.clamped.points, body.clamped.centroid)
    blocks = sparse.block_diag(
        [sparse.identity(contact_dofs), clamped, sparse.identity(OBSERVATION_DOFS)], format="coo")
    nodes = np.concatenate([body.contact.nodes, body.clamped.nodes, [observation]]) - body.first_node
    rows = (3 * nodes[:, None] + np.arange(3)).ravel()[blocks.row]
    mine = (rows >= 0) & (rows < 3 * len(body.points))
    return sparse.csr_matrix((blocks.data[mine], (rows[mine], blocks.col[mine])),
                             shape=(3 * len(body.points), blocks.shape[1]))


def _times(matrix: PETSc.Mat, boundary: sparse.csr_matrix) -> sparse.csr_matrix:
    """Return this rank's rows of `matrix` times `boundary`, whose rows are distributed likewise."""
    rows = matrix.getLocalSize()[1]
    arrays = (boundary.indptr.astype(PETSc.IntType), boundary.indices.astype(PETSc.IntType), boundary.data)
    size = ((rows, None), (None, boundary.shape[1]))
    with (_owned(PETSc.Mat().createAIJ(size, csr=arrays, comm=matrix.comm)) as right,
          _owned(matrix.matMult(right)) as product):
        indptr, indices, data = product.getValuesCSR()
        return sparse.csr_matrix((data, indices, indptr), shape=boundary.shape)


@contextmanager
def _owned(item: Any) -> Iterator[Any]:
    """Destroy a PETSc or SLEPc object on leaving, on every rank together."""
    try:
        yield item
    finally:
        item.destroy()


@contextmanager
def _inside(matrix: PETSc.Mat, chosen: NDArray[np.bool_]) -> Iterator[PETSc.Mat]:
    """Yield the square part of `matrix` whose rows are `chosen` among this rank's; destroyed on leaving."""
    first = matrix.getOwnershipRange()[0]
    indices = (first + np.flatnonzero(chosen)).astype(PETSc.IntType)
    with _owned(PETSc.IS().createGeneral(indices, comm=matrix.comm)) as rows:
        with _owned(matrix.createSubMatrix(rows, rows)) as part:
            part.setOption(PETSc.Mat.Option.SPD, True)
            yield part


@contextmanager
def _factor(matrix: PETSc.Mat) -> Iterator[PETSc.KSP]:
    """Yield a solver that holds the MUMPS Cholesky factor of the positive definite `matrix`."""
    with _owned(PETSc.KSP().create(matrix.comm)) as solver:
        solver.setOperators(matrix)
        solver.setType(PETSc.KSP.Type.PREONLY)
        solver.getPC().setType(PETSc.PC.Type.CHOLESKY)
        solver.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        solver.setUp()
        solver.getPC().getFactorMatrix().setMumpsIcntl(*MUMPS_COLUMNS)
        yield solver


def _dense(comm: Any, local: NDArray[np.float64], rows: int) -> PETSc.Mat:
    """Return a dense PETSc matrix with this rank's rows `local` (owned, columns) of `rows` in all."""
    matrix = PETSc.Mat().createDense(((len(local), rows), (None, local.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = local
    matrix.assemble()
    return matrix


def _solve(factor: PETSc.KSP, loads: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for all columns of `loads`, of which this rank has the rows here, at once."""
    rows = factor.getOperators()[0].getSize()[0]
    with (_owned(_dense(factor.comm, loads, rows)) as right,
          _owned(_dense(factor.comm, np.zeros_like(loads), rows)) as solution):
        factor.getPC().getFactorMatrix().matSolve(right, solution)
        return np.array(solution.getDenseArray(), order="F")


def _condensed(body: ElasticBody, boundary: sparse.csr_matrix,
               inner: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return stiffness and mass of the constraint modes (3 n + 9, 3 n + 9) on rank 0, None on the others."""
    rows = [sparse.csr_matrix(one.getValuesCSR()[::-1], shape=(one.getLocalSize()[0], one.getSize()[1]))
            for one in (body.stiffness, body.mass)]
    parts = body.comm.gather((rows, boundary, inner, body.points))
    if parts is None:
        return None
    matrices, motions, insides, points = zip(*parts, strict=True)
    inside = np.concatenate(insides)
    motion = sparse.hstack([sparse.identity(len(inside), format="csr")[:, inside], sparse.vstack(motions)]).tocsr()
    stiffness, mass = (motion.T @ sparse.vstack(part) @ motion for part in zip(*matrices, strict=True))
    return condense(stiffness.tocsr(), mass.tocsr(), np.concatenate(points)[inside[::3]])


def _give_back() -> None:
    """Return memory to the system that glibc keeps of freed arrays: those under 32 MB lie on a heap full of holes."""
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)


def _check_condensed(computed: NDArray[np.float64], known: NDArray[np.float64], name: str) -> None:
    """Check the condensed matrix times some motions of the boundary against the factor's own solutions."""
    error = float(np.max(np.linalg.norm(computed - known, axis=0) / np.linalg.norm(known, axis=0)))
    if not error <= _RESIDUAL_LIMIT:
        raise AuditError(f"constraint modes: {name} is off by {error:.1e}; check the mesh")


def _boundary_motions(body: ElasticBody) -> NDArray[np.float64]:
    """Return rigid motions of contact face, clamped face and observation node, and a mixture of all (3 n + 9, 16)."""
    contact = rigid_motions(body.contact.points, body.clamped.centroid)
    rigid = block_diag(contact, np.eye(RIGID_DOFS), np.eye(OBSERVATION_DOFS))
    return np.hstack([rigid, np.random.default_rng(0).standard_normal((len(rigid), 1))])


def _residual_vectors(stiffness: PETSc.Mat, mass: PETSc.Mat, modes: NDArray[np.float64],
                      answers: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Free `answers` of `modes`; return the squared Ritz frequencies and the orthonormal vectors."""
    comm = mass.comm.tompi4py()
    vectors = answers
    for _ in range(2):  # once more against round-off, which normalising vectors that are nearly dependent magnifies
        vectors = vectors - modes @ comm.allreduce(modes.T @ _product(mass, vectors))
        gram = comm.allreduce(vectors.T @ _product(mass, vectors))
        size = np.sqrt(np.diag(gram))
        shares, basis = eigh(gram / np.outer(size, size))
        kept = shares > 1e-6  # a coarse mesh may have fewer independent ones
        vectors = vectors @ (basis[:, kept] / size[:, None] / np.sqrt(shares[kept]))
    squares, rotation = eigh(comm.allreduce(vectors.T @ _product(stiffness, vectors)))
    return squares, vectors @ rotation


def _product(matrix: PETSc.Mat, local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return this rank's rows of `matrix` times the dense matrix whose rows here are `local`."""
    with (_owned(_dense(matrix.comm, local, matrix.getSize()[0])) as right,
          _owned(matrix.matMult(right)) as product):
        return np.array(product.getDenseArray())


class _Factored:
    """Preconditioner that applies the factor in hand: about zero, the shifted matrix is the stiffness."""

    def __init__(self, factor: PETSc.KSP) -> None:
        self._factor = factor

    def apply(self, _: PETSc.PC, given: PETSc.Vec, answer: PETSc.Vec) -> None:
        """Solve for one vector (called by PETSc)."""
        self._factor.solve(given, answer)


def _lowest_modes(stiffness: PETSc.Mat, mass: PETSc.Mat, factor: PETSc.KSP,
                  count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the `count` lowest squared angular frequencies and this rank's rows of the modes.

    Mass-normalised; by shift-invert Krylov-Schur about zero.
    """
    with _owned(SLEPc.EPS().create(stiffness.comm)) as solver:
        solver.setOperators(stiffness, mass)
        solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        solver.setTarget(0.0)
        solver.setDimensions(count)
        solver.setTolerances(tol=_EIGEN_TOLERANCE)
        solver.setPurify(False)  # frees vectors of a null space of the mass, which has none, by a solve for each
        solver.getST().setType(SLEPc.ST.Type.SINVERT)
        inverse = solver.getST().getKSP()
        inverse.setType(PETSc.KSP.Type.PREONLY)
        inverse.getPC().setType(PETSc.PC.Type.PYTHON)
        inverse.getPC().setPythonContext(_Factored(factor))
        solver.solve()
        converged = solver.getConverged()
        errors = [solver.getErrorEstimate(i) for i in range(converged)]
        if converged < count:
            raise NonConvergenceError(f"natural modes: found {converged} of {count}; ask for fewer modes", errors)
        squares = np.array([solver.getEigenvalue(i).real for i in range(count)])
        with _owned(stiffness.createVecRight()) as vector:
            modes = np.empty((vector.getLocalSize(), count), order="F")
            for i in range(count):
                solver.getEigenvector(i, vector)
                modes[:, i] = vector.getArray()
        return squares, modes


def _sign(body: ElasticBody, inner: NDArray[np.bool_], modes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sign that each mode gets by its sum with a field without symmetry, so that runs agree."""
    reach = np.ptp(body.clamped.points, axis=0).max()
    slopes = np.array([[1.1, 2.3, 0.7], [0.6, 1.3, 2.9], [1.7, 0.5, 1.9]])
    shares = np.sin(body.points / reach @ slopes + [0.3, 1.0, 1.9]).ravel()[inner] @ modes
    return np.where(body.comm.allreduce(shares) < 0.0, -1.0, 1.0)


def _check_orthonormal(comm: Any, modes: NDArray[np.float64], mass_times_modes: NDArray[np.float64]) -> None:
    gram = comm.allreduce(modes.T @ mass_times_modes)
    error = float(np.max(np.abs(gram - np.eye(len(gram)))))
    if not error <= 1e-9:
        raise AuditError(f"fixed-interface modes: off orthonormal in mass by {error:.1e}; check the mesh")


def _sum_on_root(comm: Any, part: NDArray[np.float64]) -> NDArray[np.float64]:
    total = np.empty_like(part, order="C")
    comm.Reduce(np.ascontiguousarray(part), total, op=MPI.SUM, root=0)
    return total
