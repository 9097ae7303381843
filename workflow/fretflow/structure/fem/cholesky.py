"""Solutions with a sparse symmetric matrix on one rank: MUMPS' factors, through PETSc."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from fretflow.core.errors import InputError
from fretflow.core.records import Array

MUMPS_COLUMNS = (27, 256)  # ICNTL(27), right-hand sides at a time: half as fast again as MUMPS' own choice


def factorise(matrix: Any) -> Callable[[Array], Array]:
    """Return what solves with a symmetric matrix (n, n) for right-hand sides (n,) or (n, k).

    Raises
    ------
    InputError
        If the matrix is singular.
    """
    rows = sparse.csr_matrix(matrix)
    indices = (one.astype(PETSc.IntType) for one in (rows.indptr, rows.indices))
    operator = PETSc.Mat().createAIJ(rows.shape, csr=(*indices, rows.data), comm=PETSc.COMM_SELF)
    operator.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    factor = PETSc.PC().create(PETSc.COMM_SELF)
    factor.setOperators(operator)
    factor.setType(PETSc.PC.Type.CHOLESKY)
    factor.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    factor.setUp()
    factors = factor.getFactorMatrix()
    if factors.getMumpsInfog(1) < 0:
        raise InputError(f"is singular, MUMPS' INFOG(1) is {factors.getMumpsInfog(1)}")
    factors.setMumpsIcntl(*MUMPS_COLUMNS)

    def solve(right: Array) -> Array:
        solution = np.zeros((len(rows.indptr) - 1, right[0].size), order="F")  # PETSc writes into it
        given = np.asfortranarray(right.reshape(solution.shape), dtype=float)
        own, answer = (PETSc.Mat().createDense(one.shape, array=one, comm=PETSc.COMM_SELF) for one in (given, solution))
        factor.getFactorMatrix().matSolve(own, answer)
        for one in (own, answer):
            one.destroy()
        return solution.reshape(right.shape)

    return solve
