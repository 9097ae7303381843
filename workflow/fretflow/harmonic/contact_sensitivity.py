"""The contact of a solved period, differentiated by motions of the arm and by parameters in one march.

Columns: the motions of the arm, the parameters that act in the contact, and unit changes of what the contact
remembers before the first sample of the march. The last close the period and are then eliminated. The gap's change
is an initial strain: with the opening w = gap + u_z in the place of u_z, f = K (u(w) - B q - strain).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fretflow.harmonic.contact_march import PERSISTS, Conditions
from fretflow.harmonic.contact_sample import (
    SLIP,
    STICK,
    Array,
    ContactSystem,
    SampleChange,
    SampleDerivative,
    SampleSolver,
    SampleState,
)
from fretflow.harmonic.direction import Direction


@dataclass(frozen=True)
class SolvedContact:
    """A converged period in component order: u and f (N, 3 n), state (N, n)."""

    displacement: Array
    force: Array
    state: NDArray[np.int8]

    def sample(self, j: int) -> SampleState:
        """Return sample j; its approach is not needed to differentiate."""
        return SampleState(self.displacement[j], self.force[j], float("nan"), self.state[j])


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
    first, memory = _memory(solved)
    acting = _Acting(system, solved, arm, under, directions, memory.shape[1])
    kept = _Kept(system, solved, under, mean, sums, acting.columns)
    slope, samples = acting.start(memory), len(arm)
    solver = SampleSolver(system)
    for j in ((first + k) % samples for k in range(samples)):
        change = acting.at(j)
        found = solver.differentiate(solved.sample(j), solved.displacement[j - 1], slope, change, under.at(j))
        kept.add(j, found, change)
        slope = found.displacement
    given = acting.columns - memory.shape[1]
    closing = memory.T @ slope
    # a position that the period does not determine keeps its value
    remembered = np.linalg.lstsq(np.eye(memory.shape[1]) - closing[:, given:], closing[:, :given], rcond=PERSISTS)[0]
    return kept.derivative().combined(np.vstack([np.eye(given), remembered]))


def _memory(solved: SolvedContact) -> tuple[int, Array]:
    """Return the sample before which least is remembered, and that memory as orthonormal columns (3 n, m).

    A sample knows of the past where the nodes stick, and across their way where they slip. Where a node sticks
    all the period, nothing can change.
    """
    stuck, slipping = solved.state == STICK, solved.state == SLIP
    lasting = stuck & ~stuck.all(axis=0)
    first = int(np.argmin(2 * lasting.sum(axis=1) + slipping.sum(axis=1)))
    n = solved.state.shape[1]
    held, slid = np.flatnonzero(lasting[first]), np.flatnonzero(slipping[first])
    x, y = _ways(solved)[first][:, slid]
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


class _Acting:
    """What the columns change at each sample."""

    def __init__(self, system: ContactSystem, solved: SolvedContact, arm: Array, under: Conditions,
                 directions: Sequence[Direction], remembered: int) -> None:
        n, given = system.size, arm.shape[1]
        self.under, self.given = under, given
        self.columns = given + len(directions) + remembered
        self.directions = {given + i: d for i, d in enumerate(directions)}
        self.arm = np.pad(arm, ((0, 0), (0, self.columns - given)))
        self.system, self.solved = system, solved
        self.order = np.arange(3 * n).reshape(n, 3).T.ravel()
        self.friction = self._constant("friction", n, 1)
        self.load = self._constant("normal_load", 1, 0)[0]
        self.force = -system.stiffness[:, 2 * n:] @ self._constant("gap", n, 1)
        self.springs = csr_array(self._constant("compliance", 3 * n, 1)[self.order])
        self.strains = {c: self._strained(d.flexibility) for c, d in self.directions.items()
                        if d.flexibility is not None}

    def _constant(self, part: str, rows: int, dimensions: int) -> Array:
        """Return a part of the directions that is the same at all samples, (rows, columns)."""
        values = np.zeros((rows, self.columns))
        for column, direction in self.directions.items():
            value = getattr(direction, part)
            if value is not None and np.ndim(value) <= dimensions:
                values[:, column] = value
        return values

    def _varying(self, part: str, dimensions: int) -> dict[int, Any]:
        return {column: getattr(direction, part) for column, direction in self.directions.items()
                if np.ndim(getattr(direction, part)) == dimensions}

    def _strained(self, flexibility: Array) -> Array:
        """Return the forces (N, 3 n) by a change of the flexibility: -K dG f."""
        force: Array = -self.solved.force @ flexibility[np.ix_(self.order, self.order)].T @ self.system.stiffness
        return force

    def start(self, memory: Array) -> Array:
        """Return the derivative (3 n, columns) of the displacement before the first sample."""
        n, slope = self.system.size, np.zeros((3 * self.system.size, self.columns))
        slope[:, self.columns - memory.shape[1]:] = memory
        never = np.flatnonzero(np.all(self.solved.state == STICK, axis=0))
        for column, direction in self.directions.items():
            if direction.locked is not None:
                slope[never, column], slope[n + never, column] = direction.locked[never].T
        return slope

    def at(self, j: int) -> SampleChange:
        """Return the change at sample j."""
        friction, load, force = self.friction.copy(), self.load.copy(), self.force.copy()
        for column, history in self._varying("friction", 2).items():
            friction[:, column] = history[j]
        friction *= self.under.grip[j]
        friction[:, :self.given] += np.outer(self.system.friction, self.under.grip_slope[j])
        for column, history in self._varying("normal_load", 1).items():
            load[column] = history[j]
        load[:self.given] += self.under.load_slope[j]
        for column, strain in self.strains.items():
            force[:, column] += strain[j]
        if self.springs.nnz:
            force -= (self.springs.T @ (self.solved.force[j][:, None] * self.system.stiffness)).T
        return SampleChange(self.arm[j], load, friction, force)


class _Kept:
    """Sums up the march while it passes, so that its size does not grow with nodes times samples times columns."""

    def __init__(self, system: ContactSystem, solved: SolvedContact, under: Conditions, mean: Array, sums: Array,
                 columns: int) -> None:
        samples, n = solved.state.shape
        self.system, self.mean, self.sums = system, mean, sums
        kbx, kbz = system.rigid_forces()
        self.rigid = np.column_stack([kbx, kbz])
        self.by_displacement = sums @ system.stiffness
        self.by_rigid = sums @ self.rigid
        self.displacement = np.zeros((samples, columns))
        self.approach = np.zeros((samples, columns))
        self.forces = np.zeros((samples, len(sums), columns))
        self.sliding, self.path = np.zeros((n, columns)), np.zeros((n, columns))
        self.moved, self.changed = np.zeros((3 * n, columns)), np.zeros((3 * n, columns))
        self.arm, self.energy = np.zeros(columns), np.zeros(columns)
        way = _ways(solved)
        rubbing = way * solved.force[:, None, 2 * n:]
        self.grip, self.slope, working = _working(system, solved, under, way)
        # du_j counts in the increment that ends at j and in the next one
        self.way, self.rubbing, self.working = (a - np.roll(a, -1, axis=0) for a in (way, rubbing, working))
        step = (solved.displacement - np.roll(solved.displacement, 1, axis=0))[:, :2 * n].reshape(samples, 2, n)
        self.length = np.hypot(step[:, 0], step[:, 1])
        self.slipping = [np.flatnonzero(state == SLIP) for state in solved.state]

    def add(self, j: int, found: SampleDerivative, change: SampleChange) -> None:
        """Take in sample j."""
        n, u = self.system.size, found.displacement
        rigid = np.stack([change.arm, found.approach])
        self.displacement[j], self.approach[j] = self.mean @ u[:n], found.approach
        self.forces[j] = self.by_displacement @ u - self.by_rigid @ rigid + self.sums @ change.force
        self.path += self.way[j, 0, :, None] * u[:n] + self.way[j, 1, :, None] * u[n:2 * n]
        self.sliding += self.rubbing[j, 0, :, None] * u[:n] + self.rubbing[j, 1, :, None] * u[n:2 * n]
        slip = self.slipping[j]
        self.sliding[slip] += self.length[j, slip, None] * found.pressing
        self.energy += self.working[j].reshape(-1) @ u[:2 * n] + self.length[j, slip] @ (
            self.slope[j, slip, None] * found.pressing + self.grip[j, slip, None] * change.friction[slip])
        self.moved += u
        self.changed += change.force
        self.arm += change.arm

    def derivative(self) -> ContactDerivative:
        """Return what was kept."""
        n, samples = self.system.size, len(self.displacement)
        rigid = np.stack([self.arm, self.approach.sum(axis=0)])
        force = self.system.stiffness[2 * n:] @ self.moved - self.rigid[2 * n:] @ rigid + self.changed[2 * n:]
        return ContactDerivative(
            displacement=self.displacement, forces=self.forces, approach=self.approach, sliding=self.sliding,
            path=self.path, pressing=force / samples, opening=self.moved[2 * n:] / samples,
            energy=self.energy)
