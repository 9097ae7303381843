"""Globalised Newton with preconditioned GMRES: the only Jacobian it needs is its product with a vector."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fretflow.core.errors import NonConvergenceError

Vector = NDArray[np.float64]
Operator = Callable[[Vector], Vector]

KRYLOV_DIMENSION = 200
STEPS = (1.0, 0.5, 0.25)
SUFFICIENT_DECREASE = 1e-4
WORTH_KEEPING = 0.5  # of the digits gained by an iteration with new factors; a new set costs as much as 10 to 40
ROUGHEST = 0.1  # linear tolerance
SQUARED = 0.9  # times the squared ratio of residuals: gamma of Eisenstat and Walker's second choice
LARGE = 300  # unknowns of a harmonic, 100 nodes: from there on keeping factors saves a third of the time and more
PATIENCE = 15  # steps without a new smallest residual, after which the iteration goes round in circles


class HasResidual(Protocol):
    """What an evaluation must tell."""

    @property
    def residual(self) -> Vector:
        """Return the residual, shaped as the unknowns."""
        ...


State = TypeVar("State", bound=HasResidual)


class NonlinearEquations(Protocol[State]):
    """A nonlinear system; unknowns and residual are arrays of one shape."""

    def evaluate(self, u: Vector) -> State:
        """Return the residual at `u` and what the Jacobian needs."""
        ...

    def linearise(self, at: State, before: Operator | None = None) -> tuple[Operator, Operator]:
        """Return the product with the Jacobian and with an approximate inverse of it, on flat vectors.

        The inverse may rest on what was made for the one `before`, another iterate's.
        """
        ...


class NewtonResult(NamedTuple, Generic[State]):
    """The root, its evaluation and the relative residual of each iterate."""

    unknowns: Vector
    state: State
    history: tuple[float, ...]


def gmres(apply: Operator, right: Vector, precondition: Operator, tolerance: float) -> tuple[Vector, int]:
    """Solve ``A x = right`` by right-preconditioned GMRES without restart; return x and the iterations.

    Saad and Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856-869, with Gram-Schmidt done twice. It stops at a
    residual of `tolerance` relative to `right`, or with the best of `KRYLOV_DIMENSION` vectors.
    """
    norm = float(np.linalg.norm(right))
    if norm == 0.0:
        return np.zeros_like(right), 0
    basis, searched = np.empty((KRYLOV_DIMENSION + 1, right.size)), np.empty((KRYLOV_DIMENSION, right.size))
    triangle, rotated = np.zeros((KRYLOV_DIMENSION, KRYLOV_DIMENSION)), np.zeros(KRYLOV_DIMENSION + 1)
    cosine, sine = np.empty(KRYLOV_DIMENSION), np.empty(KRYLOV_DIMENSION)
    basis[0], rotated[0] = right / norm, norm
    for j in range(KRYLOV_DIMENSION):
        searched[j] = precondition(basis[j])
        new = apply(searched[j])
        known = basis[:j + 1]
        column = known @ new
        new = new - column @ known
        again = known @ new
        new -= again @ known
        column += again
        length = float(np.linalg.norm(new))
        for i in range(j):
            column[i:i + 2] = (cosine[i] * column[i] + sine[i] * column[i + 1],
                               cosine[i] * column[i + 1] - sine[i] * column[i])
        radius = float(np.hypot(column[j], length))
        cosine[j], sine[j] = column[j] / radius, length / radius
        column[j] = radius
        triangle[:j + 1, j] = column
        rotated[j + 1], rotated[j] = -sine[j] * rotated[j], cosine[j] * rotated[j]
        if abs(rotated[j + 1]) <= tolerance * norm:
            break
        basis[j + 1] = new / length
    weights = solve_triangular(triangle[:j + 1, :j + 1], rotated[:j + 1], check_finite=False)
    return weights @ searched[:j + 1], j + 1


def solve_newton(equations: NonlinearEquations[State], start: Vector, scale: float, tolerance: float,
                 max_iterations: int) -> NewtonResult[State]:
    """Find the root near `start`.

    Inexact Newton. The linear tolerance is the residual; in large systems the square of how much that last fell, if
    larger (S. C. Eisenstat and H. F. Walker, SIAM J. Sci. Comput. 17 (1996) 16-32): where nodes change state, no
    accuracy of a step lets it fall further. A line search halves the step until the residual falls. Where it does not
    soon, because nodes are about to change state, smaller steps would only creep up to that change: the best of a few
    large steps is taken instead, across it. The preconditioner's factors are kept from step to step in large systems,
    while each iteration gains at least half of the digits that it gained with new ones.

    Parameters
    ----------
    equations
        The system.
    start
        First iterate.
    scale
        Size of the load; residuals are given relative to it.
    tolerance
        Relative residual at which the iteration stops.
    max_iterations
        Newton steps allowed.

    Raises
    ------
    NonConvergenceError
        With the residual history.
    """
    u, state = start, equations.evaluate(start)
    history = [float(np.linalg.norm(state.residual)) / scale]
    kept, digits = None, 0.0  # preconditioner, and what an iteration gained when it was new
    while not history[-1] <= tolerance:
        if len(history) > max_iterations:
            raise NonConvergenceError(f"Newton: residual {history[-1]:.1e} after {max_iterations} iterations "
                                      f"against {tolerance:.0e}; raise max_iterations or samples", history)
        if len(history) > PATIENCE and min(history[-PATIENCE:]) >= min(history[:-PATIENCE]):
            raise NonConvergenceError(f"Newton: residual {min(history):.1e} has not fallen for {PATIENCE} iterations; "
                                      "start from a neighbouring solution", history)
        fell = history[-1] / history[-2:][0] if u.shape[-1] >= LARGE else 0.0
        forcing = max(min(ROUGHEST, max(history[-1], SQUARED * fell**2)), 0.3 * tolerance / history[-1])
        for before in (kept, None) if kept is not None else (None,):
            apply, precondition = equations.linearise(state, before)
            flat, iterations = gmres(apply, -state.residual.ravel(), precondition, forcing)
            if iterations < KRYLOV_DIMENSION:
                break
        gained = -np.log10(forcing) / max(iterations, 1)
        digits = gained if before is None else digits
        kept = precondition if gained >= WORTH_KEEPING * digits and u.shape[-1] >= LARGE else None
        u, state = _line_search(equations, u, flat.reshape(u.shape), history[-1] * scale)
        history.append(float(np.linalg.norm(state.residual)) / scale)
    return NewtonResult(u, state, tuple(history))


def _line_search(equations: NonlinearEquations[State], u: Vector, step: Vector,
                 reference: float) -> tuple[Vector, State]:
    """Return the first of `STEPS` with sufficient decrease, or the best."""
    tried = []
    for share in STEPS:
        trial = u + share * step
        state = equations.evaluate(trial)
        size = float(np.linalg.norm(state.residual))
        if size <= (1.0 - SUFFICIENT_DECREASE * share) * reference:
            return trial, state
        tried.append((size, trial, state))
    _, trial, state = min(tried, key=lambda one: one[0])
    return trial, state
