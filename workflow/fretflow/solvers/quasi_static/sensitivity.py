"""The contact of a solved period, differentiated by motions of the coordinates and by parameters in one march.

Columns: the motions, the parameters that act in the contact, and unit changes of what the contact remembers before the
first sample of the march. The last close the period and are then eliminated. The gap's change is an initial strain:
with the opening w = gap + u_z in the place of u_z, f = K (u(w) - strain) - R q - P i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fretflow.contact.kernels.sample import PeriodHistory, empty_factor
from fretflow.contact.kernels.sensitivity import Acting, Histories, Sums, Weights, empty_sums, march_columns
from fretflow.contact.law import FactorAndSlopes
from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.quasi_static.march import PERSISTS
from fretflow.solvers.quasi_static.sample import SLIP, STICK, Array, ContactSystem, plain
from fretflow.structure.two_mass_rig.lumped import LumpedRig


@record
class Direction:
    """Derivative of the model's data by one parameter, all else held; units are per unit of the parameter.

    Linear combinations of parameters (a wear depth, a tilt) are directions too. Friction and normal load are histories:
    they may depend on the solution, as a friction that changes with speed does. Arrays over the nodes are in node order
    (x, y, z per node where they have 3 n entries). None: does not act there.
    """

    name: str
    friction: Array | None = quantity("1", "(N, nodes), of the coefficient", default=None)
    normal_load: Array | None = quantity("N", "(N,)", default=None)
    gap: Array | None = quantity("m", "(nodes,)", default=None)
    flexibility: Array | None = quantity("m/N", "(3 n, 3 n), of the faces against each other, springs in series",
                                         default=None)
    locked: Array | None = quantity("m", "(nodes, 2), where nodes that stick all the period sit", default=None)
    rig: LumpedRig | None = None
    force: Array | None = quantity("N", "(N, 2), on block and arm, x, drive included", default=None)

    @property
    def acts_in_contact(self) -> bool:
        """Return whether the contact changes at a given motion of the arm."""
        return any(part is not None for part in (self.friction, self.normal_load, self.gap, self.flexibility,
                                                 self.locked))

    def validate(self, samples: int, nodes: int) -> None:
        """Check the shapes for a period of `samples` and a contact of `nodes`.

        Raises
        ------
        InputError
            Naming the direction and its part.
        """
        shapes = {"friction": (samples, nodes), "normal_load": (samples,), "gap": (nodes,),
                  "flexibility": (3 * nodes, 3 * nodes), "locked": (nodes, 2), "force": (samples, 2)}
        for part, wanted in shapes.items():
            value = getattr(self, part)
            if value is not None and np.shape(value) != wanted:
                raise InputError(f"direction {self.name}: {part} has shape {np.shape(value)}; give {wanted} "
                                 f"for {nodes} nodes and {samples} samples")


@dataclass(frozen=True)
class SolvedContact:
    """The contact at a converged period, with the normal load as one coordinate more, the last of `system`.

    `factor` on friction; by a motions of the coordinates `motion` (N, e, a) and `factor_slope` (N, a).
    """

    system: ContactSystem
    period: PeriodHistory
    factor: FactorAndSlopes
    motion: Array
    factor_slope: Array


@dataclass(frozen=True)
class LinearOutputs:
    """r outputs by displacement and by force (r, 3 n), and by coordinates and load (r, e)."""

    by_displacement: Array
    by_force: Array
    by_coordinate: Array


@dataclass(frozen=True)
class ContactDerivative:
    """What is kept of the march, by c columns; all of it is linear in them."""

    outputs: Array  # (N, r, c), as asked
    sliding: Array  # (n, c), of sum f_z |du|
    path: Array  # (n, c), of sum |du|
    pressing: Array  # (n, c), mean normal force
    opening: Array  # (n, c), mean of gap + u_z
    energy: Array  # (c,), friction's work

    def combined(self, weights: Array) -> ContactDerivative:
        """Return the derivative by combinations of the columns, weights (c, p)."""
        return ContactDerivative(**{f.name: getattr(self, f.name) @ weights for f in fields(self)})


class ContactColumns:
    """A solved contact marched by a motions of the coordinates, some parameters and what it remembers.

    Further parameters need a march of their own columns only.
    """

    def __init__(self, solved: SolvedContact, outputs: LinearOutputs, directions: Sequence[Direction]) -> None:
        self.solved, self.outputs, self.way = solved, outputs, _ways(solved.period)
        self.motions, self.given = solved.motion.shape[2], solved.motion.shape[2] + len(directions)
        self.first, self.memory = _memory(solved.period, self.way)
        self.columns, self.closing = self._march(solved, directions, self.memory)

    def closed(self) -> ContactDerivative:
        """Return the derivative by the motions, the first columns, and by the parameters marched with them."""
        return self._closed(self.columns, self.closing, list(range(self.given)))

    def by(self, directions: Sequence[Direction]) -> ContactDerivative:
        """Return the derivative by the motions, the first columns, and by further parameters, the others."""
        if not directions:
            return self._closed(self.columns, self.closing, list(range(self.motions)))
        alone = replace(self.solved, motion=self.solved.motion[:, :, :0], factor_slope=self.solved.factor_slope[:, :0])
        columns, closing = self._march(alone, directions, self.memory[:, :0])
        both = ContactDerivative(**{f.name: np.concatenate([getattr(one, f.name) for one in (self.columns, columns)],
                                                           axis=-1) for f in fields(ContactDerivative)})
        whole = self.closing.shape[1]
        return self._closed(both, np.hstack([self.closing, closing]),
                            [*range(self.motions), *range(whole, whole + len(directions))])

    def _closed(self, columns: ContactDerivative, closing: Array, chosen: list[int]) -> ContactDerivative:
        """Return chosen columns with what makes the period close."""
        count = self.memory.shape[1]
        kept = self.given + np.arange(count)
        weights = np.zeros((closing.shape[1], len(chosen)))
        weights[chosen, np.arange(len(chosen))] = 1.0
        # a position that the period does not determine keeps its value
        weights[kept] = np.linalg.lstsq(np.eye(count) - closing[:, kept], closing[:, chosen], rcond=PERSISTS)[0]
        return columns.combined(weights)

    def _march(self, solved: SolvedContact, directions: Sequence[Direction], memory: Array
               ) -> tuple[ContactDerivative, Array]:
        """Return the columns of motions, parameters and memory, and what the memory is after the period (m, p)."""
        system, period, motions = solved.system, solved.period, solved.motion.shape[2]
        acting, count = _acting(solved, directions), motions + len(directions) + memory.shape[1]
        shape = (len(period.state), system.size, solved.motion.shape[1])
        kept = empty_sums(shape, len(self.outputs.by_force), count, len(directions))
        end = march_columns(system.data, empty_factor(system.size), period, acting,
                            _weights(solved, self.way, self.outputs), self.first,
                            _start(period, motions, directions, memory), kept)
        return _derivative(system, motions, kept), self.memory.T @ end


def strains(period: PeriodHistory, directions: Sequence[Direction], weights: Array) -> Array:
    """Return ``weights . strain`` (N, P) of the initial strains that the directions put in series; weights (3 n,)."""
    strain = np.zeros((len(period.force), len(directions)))
    for column, direction in enumerate(directions):
        if direction.gap is not None:
            strain[:, column] += weights[2::3] @ direction.gap
        if direction.flexibility is not None:
            strain[:, column] += period.force @ (direction.flexibility.T @ weights)
    return strain


def _memory(period: PeriodHistory, way: Array) -> tuple[int, Array]:
    """Return the sample before which least is remembered, and that memory as orthonormal columns (3 n, m).

    A sample knows of the past where the nodes stick, and across their way where they slip. Where a node sticks
    all the period, nothing can change.
    """
    stuck, slipping = period.state == STICK, period.state == SLIP
    lasting = stuck & ~stuck.all(axis=0)
    first = int(np.argmin(2 * lasting.sum(axis=1) + slipping.sum(axis=1)))
    held, slid = np.flatnonzero(lasting[first]), np.flatnonzero(slipping[first])
    x, y = way[first][:, slid]
    memory = np.zeros((3 * period.state.shape[1], 2 * len(held) + len(slid)))
    column = np.arange(len(held))
    memory[3 * held, column] = memory[3 * held + 1, len(held) + column] = 1.0
    column = 2 * len(held) + np.arange(len(slid))
    memory[3 * slid, column], memory[3 * slid + 1, column] = -y, x
    return first, memory


def _ways(period: PeriodHistory) -> Array:
    """Return the unit vectors (N, 2, n) along which nodes slip, against their friction; zero where they do not."""
    x, y = period.force[:, 0::3], period.force[:, 1::3]
    size = np.hypot(x, y)
    way: Array = -np.stack([x, y], axis=1) / np.where(size > 0.0, size, np.inf)[:, None]
    return np.where((period.state == SLIP)[:, None], way, 0.0)


def _working(solved: SolvedContact, way: Array) -> tuple[Array, Array, Array]:
    """Return what the work ``sum L |du|`` changes by: L over g mu, dL/df_z, each (N, n), and by du, (N, 2, n)."""
    system, period = solved.system, solved.period
    law = system.law
    normal, factor = np.maximum(period.force[:, 2::3], 0.0), solved.factor.factor[:, None]
    share = 1.0 + law.asymmetry * way[:, 0]
    gripping = law.gripping_force(normal)
    working = (factor * share * system.friction * gripping)[:, None] * way
    if law.asymmetry:
        turned = law.asymmetry * factor * system.friction * gripping
        slips = period.state == SLIP
        working[:, 0] += np.where(slips, turned * (1.0 - way[:, 0]**2), 0.0)
        working[:, 1] -= np.where(slips, turned * way[:, 0] * way[:, 1], 0.0)
    return share * gripping, factor * share * law.slip_limit_slope(normal), working


def _start(period: PeriodHistory, motions: int, directions: Sequence[Direction], memory: Array) -> Array:
    """Return the derivative (3 n, p) of the displacement before the first sample."""
    slope = np.hstack([np.zeros((len(memory), motions + len(directions))), memory])
    never = np.flatnonzero(np.all(period.state == STICK, axis=0))
    for column, direction in enumerate(directions, start=motions):
        if direction.locked is not None:
            slope[3 * never, column], slope[3 * never + 1, column] = direction.locked[never].T
    return slope


def _acting(solved: SolvedContact, directions: Sequence[Direction]) -> Acting:
    """Return what the columns change."""
    system, period = solved.system, solved.period
    n, samples, force = system.size, len(period.state), np.zeros((0, len(directions)))
    strained = {column: -period.force @ direction.flexibility.T @ system.stiffness
                for column, direction in enumerate(directions) if direction.flexibility is not None}
    gaps = _given(directions, "gap")
    if strained or gaps:
        opened = np.zeros((n, len(directions)))
        opened[:, list(gaps)] = np.transpose(list(gaps.values()))
        force = -system.stiffness[:, 2::3] @ opened
    return Acting(
        plain(solved.motion), plain(solved.factor_slope), plain(solved.factor.factor),
        own_force=plain(force), loads=_histories(_given(directions, "normal_load"), samples, 1),
        frictions=_histories(_given(directions, "friction"), samples, n),
        forces=_histories(strained, samples, 3 * n))


def _given(directions: Sequence[Direction], part: str) -> dict[int, Array]:
    """Return a part of those directions that have it, by their place."""
    return {column: getattr(direction, part) for column, direction in enumerate(directions)
            if getattr(direction, part) is not None}


def _histories(values: dict[int, Array], samples: int, size: int) -> Histories:
    """Return the values by parameters, each (samples, size) or flat, as the compiled loops take them."""
    columns = np.fromiter(values, dtype=np.int64, count=len(values))
    together = np.empty((len(values), samples, size))
    for place, value in enumerate(values.values()):
        together[place] = value.reshape(samples, size)
    return Histories(columns, together)


def _weights(solved: SolvedContact, way: Array, outputs: LinearOutputs) -> Weights:
    """Return what of each sample counts."""
    period = solved.period
    gripping, slope, working = _working(solved, way)
    # du_j counts in the increment that ends at j and in the next one
    path, rubbing, work = (plain(a - np.roll(a, -1, axis=0))
                           for a in (way, way * period.force[:, None, 2::3], working))
    step = period.displacement - np.roll(period.displacement, 1, axis=0)
    return Weights(plain(outputs.by_displacement), plain(outputs.by_force), plain(outputs.by_coordinate), path, rubbing,
                   work, np.hypot(step[:, 0::3], step[:, 1::3]), plain(gripping), plain(slope))


def _derivative(system: ContactSystem, motions: int, kept: Sums) -> ContactDerivative:
    """Return what was kept."""
    samples, given = len(kept.outputs), motions + kept.pressed.shape[1]
    force = system.stiffness[2::3] @ kept.moved - system.coupling[2::3] @ kept.driven
    force[:, motions:given] += kept.pressed
    return ContactDerivative(outputs=kept.outputs, sliding=kept.sliding, path=kept.path, pressing=force / samples,
                             opening=kept.moved[2::3] / samples, energy=kept.energy)
