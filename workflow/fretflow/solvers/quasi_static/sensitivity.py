"""The contact of a solved period, differentiated by motions of the arm and by parameters in one march.

Columns: the motions of the arm, the parameters that act in the contact, and unit changes of what the contact
remembers before the first sample of the march. The last close the period and are then eliminated. The gap's change
is an initial strain: with the opening w = gap + u_z in the place of u_z, f = K (u(w) - B q - strain).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from fretflow.contact.kernels.sample import Marched, empty_factor
from fretflow.contact.kernels.sensitivity import (
    Acting,
    Histories,
    Springs,
    Sums,
    Weights,
    empty_sums,
    march_columns,
)
from fretflow.solvers.direction import Direction
from fretflow.solvers.quasi_static.march import PERSISTS, Conditions
from fretflow.solvers.quasi_static.sample import SLIP, STICK, Array, ContactSystem, plain


@dataclass(frozen=True)
class SolvedContact:
    """A converged period in component order: u and f (N, 3 n), state (N, n)."""

    displacement: Array
    force: Array
    state: NDArray[np.int8]

    @property
    def marched(self) -> Marched:
        """Return the samples as the compiled loops take them; their approach is not needed to differentiate."""
        return Marched(plain(self.displacement), plain(self.force), np.full(len(self.force), np.nan),
                       np.require(self.state, dtype=np.int8, requirements=["C", "W"]))


@dataclass(frozen=True)
class ContactDerivative:
    """What is kept of the march, by c columns; all of it is linear in them."""

    displacement: Array  # (N, c), weighted mean of u_x
    forces: Array  # (N, r, c), the asked sums of contact forces
    approach: Array  # (N, c)
    sliding: Array  # (n, c), of sum f_z |du|
    path: Array  # (n, c), of sum |du|
    pressing: Array  # (n, c), mean normal force
    opening: Array  # (n, c), mean of gap + u_z
    energy: Array  # (c,), friction's work

    def combined(self, weights: Array) -> ContactDerivative:
        """Return the derivative by combinations of the columns, weights (c, p)."""
        return ContactDerivative(**{f.name: getattr(self, f.name) @ weights for f in fields(self)})


def differentiate_contact(system: ContactSystem, solved: SolvedContact, arm: Array, under: Conditions,
                          directions: Sequence[Direction], mean: Array, sums: Array) -> ContactDerivative:
    """March a period once for motions of the arm and parameters.

    Parameters
    ----------
    system, solved
        The contact and its converged period of N samples and n nodes.
    arm : (N, a)
        Motions of the arm, the first a columns of the result.
    under
        Load and friction over the period, and their derivatives by those motions.
    directions
        Parameters that act in the contact, its other columns.
    mean : (n,)
        Weights of the mean of u_x.
    sums : (r, 3 n)
        Weights of the forces, in component order.
    """
    way = _ways(solved)
    first, memory = _memory(solved, way)
    acting, given = _acting(system, solved, arm, under, directions), arm.shape[1] + len(directions)
    kept = empty_sums(len(arm), system.size, len(sums), given + memory.shape[1], len(directions))
    end = march_columns(system.data, empty_factor(system.size), solved.marched, acting,
                        _weights(system, solved, under, way, mean, sums), first,
                        _start(solved, arm.shape[1], directions, memory), kept)
    closing = memory.T @ end
    # a position that the period does not determine keeps its value
    remembered = np.linalg.lstsq(np.eye(memory.shape[1]) - closing[:, given:], closing[:, :given], rcond=PERSISTS)[0]
    return _derivative(system, arm, kept).combined(np.vstack([np.eye(given), remembered]))


def _memory(solved: SolvedContact, way: Array) -> tuple[int, Array]:
    """Return the sample before which least is remembered, and that memory as orthonormal columns (3 n, m).

    A sample knows of the past where the nodes stick, and across their way where they slip. Where a node sticks
    all the period, nothing can change.
    """
    stuck, slipping = solved.state == STICK, solved.state == SLIP
    lasting = stuck & ~stuck.all(axis=0)
    first = int(np.argmin(2 * lasting.sum(axis=1) + slipping.sum(axis=1)))
    n = solved.state.shape[1]
    held, slid = np.flatnonzero(lasting[first]), np.flatnonzero(slipping[first])
    x, y = way[first][:, slid]
    memory = np.zeros((3 * n, 2 * len(held) + len(slid)))
    column = np.arange(len(held))
    memory[held, column] = memory[n + held, len(held) + column] = 1.0
    column = 2 * len(held) + np.arange(len(slid))
    memory[slid, column], memory[n + slid, column] = -y, x
    return first, memory


def _ways(solved: SolvedContact) -> Array:
    """Return the unit vectors (N, 2, n) along which nodes slip, against their friction; zero where they do not."""
    samples, n = solved.state.shape
    friction = solved.force[:, :2 * n].reshape(samples, 2, n)
    size = np.hypot(friction[:, 0], friction[:, 1])
    way: Array = -friction / np.where(size > 0.0, size, np.inf)[:, None]
    return np.where((solved.state == SLIP)[:, None], way, 0.0)


def _working(system: ContactSystem, solved: SolvedContact, under: Conditions, way: Array
             ) -> tuple[Array, Array, Array]:
    """Return what the work ``sum L |du|`` changes by: L over g mu, dL/df_z, each (N, n), and by du, (N, 2, n)."""
    law, n = system.law, system.size
    normal, grip = np.maximum(solved.force[:, 2 * n:], 0.0), under.grip[:, None]
    share = 1.0 + law.asymmetry * way[:, 0]
    gripping = law.gripping_force(normal)
    working = (grip * share * system.friction * gripping)[:, None] * way
    if law.asymmetry:
        turned = law.asymmetry * grip * system.friction * gripping
        slips = solved.state == SLIP
        working[:, 0] += np.where(slips, turned * (1.0 - way[:, 0]**2), 0.0)
        working[:, 1] -= np.where(slips, turned * way[:, 0] * way[:, 1], 0.0)
    return share * gripping, grip * share * law.slip_limit_slope(normal), working


def _start(solved: SolvedContact, motions: int, directions: Sequence[Direction], memory: Array) -> Array:
    """Return the derivative (3 n, p) of the displacement before the first sample."""
    n = solved.state.shape[1]
    slope = np.hstack([np.zeros((3 * n, motions + len(directions))), memory])
    never = np.flatnonzero(np.all(solved.state == STICK, axis=0))
    for column, direction in enumerate(directions, start=motions):
        if direction.locked is not None:
            slope[never, column], slope[n + never, column] = direction.locked[never].T
    return slope


def _acting(system: ContactSystem, solved: SolvedContact, arm: Array, under: Conditions,
            directions: Sequence[Direction]) -> Acting:
    """Return what the columns change."""
    n, force = system.size, np.zeros((0, len(directions)))
    order = np.arange(3 * n).reshape(n, 3).T.ravel()
    springs = csc_array(_constant(directions, "compliance", 3 * n, 1)[order])
    strains = {column: -solved.force @ direction.flexibility[np.ix_(order, order)].T @ system.stiffness
               for column, direction in enumerate(directions) if direction.flexibility is not None}
    if springs.nnz or strains or any(direction.gap is not None for direction in directions):
        force = -system.stiffness[:, 2 * n:] @ _constant(directions, "gap", n, 1)
    return Acting(
        plain(arm), plain(under.load_slope), plain(under.grip_slope), plain(under.grip),
        own_load=_constant(directions, "normal_load", 1, 0)[0],
        own_friction=_constant(directions, "friction", n, 1), own_force=plain(force),
        loads=_histories(_varying(directions, "normal_load", 1), len(arm), 1),
        frictions=_histories(_varying(directions, "friction", 2), len(arm), n),
        forces=_histories(strains, len(arm), 3 * n),
        springs=Springs(springs.indptr.astype(np.int64), springs.indices.astype(np.int64), plain(springs.data)))


def _constant(directions: Sequence[Direction], part: str, rows: int, dimensions: int) -> Array:
    """Return a part of the directions that is the same at all samples, (rows, d)."""
    values = np.zeros((rows, len(directions)))
    for column, direction in enumerate(directions):
        value = getattr(direction, part)
        if value is not None and np.ndim(value) <= dimensions:
            values[:, column] = value
    return values


def _varying(directions: Sequence[Direction], part: str, dimensions: int) -> dict[int, Array]:
    """Return a part of those directions in which it varies over the samples."""
    return {column: getattr(direction, part) for column, direction in enumerate(directions)
            if np.ndim(getattr(direction, part)) == dimensions}


def _histories(values: dict[int, Array], samples: int, size: int) -> Histories:
    """Return the values by parameters, each (samples, size) or flat, as the compiled loops take them."""
    columns = np.fromiter(values, dtype=np.int64, count=len(values))
    together = np.empty((len(values), samples, size))
    for place, value in enumerate(values.values()):
        together[place] = value.reshape(samples, size)
    return Histories(columns, together)


def _weights(system: ContactSystem, solved: SolvedContact, under: Conditions, way: Array, mean: Array, sums: Array
             ) -> Weights:
    """Return what of each sample counts."""
    samples, n = solved.state.shape
    grip, slope, working = _working(system, solved, under, way)
    # du_j counts in the increment that ends at j and in the next one
    path, rubbing, work = (plain(a - np.roll(a, -1, axis=0))
                           for a in (way, way * solved.force[:, None, 2 * n:], working))
    step = (solved.displacement - np.roll(solved.displacement, 1, axis=0))[:, :2 * n].reshape(samples, 2, n)
    return Weights(plain(mean[None]), plain(sums @ system.stiffness), plain(sums),
                   plain(sums @ np.column_stack(system.rigid_forces())), path, rubbing, work,
                   np.hypot(step[:, 0], step[:, 1]), plain(grip), plain(slope))


def _derivative(system: ContactSystem, arm: Array, kept: Sums) -> ContactDerivative:
    """Return what was kept."""
    n, samples = system.size, len(arm)
    given = arm.shape[1] + kept.pressed.shape[1]
    moved = np.zeros((2, len(kept.energy)))
    moved[0, :arm.shape[1]], moved[1] = arm.sum(axis=0), kept.approach.sum(axis=0)
    force = system.stiffness[2 * n:] @ kept.moved - np.column_stack(system.rigid_forces())[2 * n:] @ moved
    force[:, arm.shape[1]:given] += kept.pressed
    return ContactDerivative(
        displacement=kept.displacement, forces=kept.forces, approach=kept.approach, sliding=kept.sliding,
        path=kept.path, pressing=force / samples, opening=kept.moved[2 * n:] / samples, energy=kept.energy)
