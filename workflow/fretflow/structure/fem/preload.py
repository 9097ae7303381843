"""The static preload: two elastic faces without friction pressed together, as a variational inequality."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from petsc4py import PETSc

from fretflow.core.errors import AuditError, InputError, NonConvergenceError
from fretflow.core.records import quantity, record

_TOLERANCE = 1e-12  # residual force relative to the load
_AUDIT = 1e-10
_MAX_ITERATIONS = 200


@record
class Preload:
    """Contact under the static load, the rig at rest.

    `approach` is how far the arm has moved towards the lower specimen from where the undeformed faces would
    coincide at zero gap.
    """

    force: NDArray[np.float64] = quantity("N", "(nodes,), positive in compression")
    pressure: NDArray[np.float64] = quantity("Pa", "(nodes,), positive in compression")
    gap: NDArray[np.float64] = quantity("m", "(nodes,), positive when open")
    approach: float = quantity("m")


def frictionless_preload(flexibility: NDArray[np.float64], initial_gap: NDArray[np.float64],
                         areas: NDArray[np.float64], load: float) -> Preload:
    """Find forces f and gaps g of a frictionless contact pressed together by `load`, free to approach.

    With the approach d of the arm, ``g = g0 - d + C f``, ``g >= 0``, ``f >= 0``, ``g f = 0``, ``sum f = N``:
    the minimum of the elastic energy less the work of the load. PETSc's reduced-space Newton method for
    variational inequalities (SNES ``vinewtonrsls``; S. Benson, T. Munson, Optim. Methods Softw. 21 (2006))
    solves it for (g, d); the touching nodes it finds are then solved for to round-off.

    Parameters
    ----------
    flexibility : ndarray (n, n)
        Normal flexibility C (m/N) of the pair: opening per compressive nodal force, tangential forces absent.
    initial_gap : ndarray (n,)
        Gap g0 (m) of the undeformed faces.
    areas : ndarray (n,)
        Areas of the nodes (m^2), for the pressure.
    load : float
        Normal load (N).

    Raises
    ------
    InputError
        If the shapes do not match, the load is not positive or the flexibility not positive definite.
    NonConvergenceError
        If SNES does not converge.
    AuditError
        If the solution is not complementary or does not carry the load to 1e-10.
    """
    n = len(areas)
    if flexibility.shape != (n, n) or initial_gap.shape != (n,):
        raise InputError(f"preload: flexibility {flexibility.shape}, initial gap {initial_gap.shape} and "
                         f"areas ({n},) do not match; give one row a node")
    if not load > 0.0:
        raise InputError(f"preload: normal_load must be positive, got {load} N")
    try:
        factor = scipy.linalg.cho_factor(0.5 * (flexibility + flexibility.T))
    except np.linalg.LinAlgError as error:
        raise InputError("preload: the flexibility is not positive definite; hold both bodies") from error
    stiffness = scipy.linalg.cho_solve(factor, np.eye(n))
    touching = _solve_inequality(0.5 * (stiffness + stiffness.T), initial_gap, load)
    return _finish(flexibility, initial_gap, areas, load, touching)


def _solve_inequality(stiffness: NDArray[np.float64], initial_gap: NDArray[np.float64],
                      load: float) -> NDArray[np.bool_]:
    """Return which nodes touch: those whose gap is at its bound and whose force is not negative."""
    n = len(initial_gap)
    column_sums = stiffness.sum(axis=0)
    scale = load / column_sums.sum()  # unit of length; that of force is the load
    hessian = np.block([[stiffness, column_sums[:, None]], [column_sums, column_sums.sum()]]) * (scale / load)
    offset = np.append(np.zeros(n), 1.0)

    def residual(_: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        f.setArray(hessian @ x.getArray(readonly=True) - offset)

    # Unknown are g - g0 and d, both from the closest point: elastic quantities, free of cancellation.
    lower = np.append((initial_gap.min() - initial_gap) / scale, -np.inf)
    unknown = np.append(np.zeros(n), 1.0)
    history = _run_snes(residual, hessian, unknown, lower)
    forces = hessian[:n] @ unknown
    touching = unknown[:n] - lower[:n] < n * forces  # one of the two is zero but for round-off
    if not touching.any():
        raise NonConvergenceError("preload: no node touches after the last iteration", history)
    return np.asarray(touching)


def _run_snes(residual: Any, hessian: NDArray[np.float64], unknown: NDArray[np.float64],
              lower: NDArray[np.float64]) -> list[float]:
    """Solve the variational inequality in place in `unknown` and return the residual history."""
    size = len(unknown)
    with ExitStack() as stack:
        def owned(item: Any) -> Any:
            stack.callback(item.destroy)
            return item

        comm = PETSc.COMM_SELF
        x = owned(PETSc.Vec().createWithArray(unknown, comm=comm))
        bounds = [owned(PETSc.Vec().createWithArray(b, comm=comm)) for b in (lower, np.full(size, np.inf))]
        f = owned(PETSc.Vec().createSeq(size, comm=comm))
        matrix = owned(PETSc.Mat().createDense((size, size), array=hessian.copy(), comm=comm))
        matrix.assemble()
        snes = owned(PETSc.SNES().create(comm=comm))
        snes.setType("vinewtonrsls")
        snes.setFunction(residual, f)
        snes.setJacobian(lambda *_: None, matrix)
        snes.setVariableBounds(*bounds)
        snes.setTolerances(rtol=0.0, atol=_TOLERANCE, stol=0.0, max_it=_MAX_ITERATIONS)
        snes.setConvergenceHistory()
        snes.getKSP().setType(PETSc.KSP.Type.PREONLY)
        snes.getKSP().getPC().setType(PETSc.PC.Type.LU)
        snes.solve(None, x)
        history = [float(r) for r in snes.getConvergenceHistory()[0]]
        if snes.getConvergedReason() <= 0:
            raise NonConvergenceError(
                f"preload: not converged after {snes.getIterationNumber()} iterations "
                f"(PETSc reason {snes.getConvergedReason()}); check the initial gap", history)
        return history


def _finish(flexibility: NDArray[np.float64], initial_gap: NDArray[np.float64], areas: NDArray[np.float64],
            load: float, touching: NDArray[np.bool_]) -> Preload:
    """Solve with the touching nodes known, to round-off, and check the result."""
    ones = np.ones((int(touching.sum()), 1))
    system = np.block([[flexibility[np.ix_(touching, touching)], -ones], [ones.T, np.zeros((1, 1))]])
    # The two blocks differ by orders of magnitude; forces in units of the load, lengths of a typical closure.
    length = load * float(np.diag(flexibility).max())
    system[:-1, :-1] *= load / length
    closest = float(initial_gap.min())
    above = initial_gap - closest
    solution = np.linalg.solve(system, np.append(-above[touching] / length, 1.0))
    force = np.zeros(len(areas))
    force[touching] = load * solution[:-1]
    approach = length * float(solution[-1])
    gap = above - approach + flexibility @ force
    gap[touching] = 0.0
    worst = max(-force.min() / load, -gap.min() / length, abs(force.sum() / load - 1.0))
    if not worst <= _AUDIT:
        raise AuditError(f"preload: the solution violates the contact conditions by {worst:.1e} of the load")
    return Preload(force=np.maximum(force, 0.0), pressure=np.maximum(force, 0.0) / areas,
                   gap=np.maximum(gap, 0.0), approach=closest + approach)
