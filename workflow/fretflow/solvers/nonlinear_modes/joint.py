"""A structure with its bolted friction joint: preload, linear modes about it, and static loads in their shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.contact.kernels.static import SEPARATION, SLIP, STICK, States, StaticContact, follow_loads
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array, quantity, record
from fretflow.structure.reduction.contact_modes import ReducedStructure, assembled

Indices = NDArray[np.int64]

TOLERANCE = 1e-10  # of the bolts' forces, residual of a node
RIGID_SPRING = 1e-9  # compliance over the structure's own, below which a node counts as rigid
PRESSED = 1e-8  # of the largest contact force: below it a point touches without holding anything
FEW = 16  # points, up to which nothing is condensed: that costs 1.9 times as much at 7, 1.4 at 12, as much at 25
GAP_STEPS = 8  # in which the bolts are tightened where faces have to close first


@record
class LinearMode:
    """A mode of the structure with all closed contact points stuck, M-normalised."""

    frequency: float = quantity("Hz")
    contact: Array = quantity("1/kg^0.5", "(3 m,), relative displacement of the contact")
    modes: Array = quantity("1", "(N,), share of each mode of the closed joint, eta")

    def damping_ratio(self, damping: Array) -> float:
        """Return the ratio that a matrix (3 m + N, 3 m + N) on u and eta gives it, N s/m; others it may couple."""
        shape = np.r_[self.contact, self.modes]
        return float(shape @ damping @ shape) / (4.0 * np.pi * self.frequency)


@record
class StaticHistory:
    """Contact under S static loads, node order ``3 j + c``."""

    displacement: Array = quantity("m", "(S, 3 m), springs included")
    force: Array = quantity("N", "(S, 3 m)")
    state: NDArray[np.int8] = quantity("1", "(S, m)")
    slid: Array = quantity("m", "(S, 3 m), of the sliders alone")
    load: Array = quantity("N", "(S, 3 m)")

    def last(self, count: int) -> StaticHistory:
        """Return the last `count` loads alone."""
        return self._cut(slice(-count, None))

    def first(self, count: int) -> StaticHistory:
        """Return the first `count` loads alone."""
        return self._cut(slice(count))

    def _cut(self, loads: slice) -> StaticHistory:
        return StaticHistory(**{name: values[loads] for name, values in vars(self).items()})

    @classmethod
    def joined(cls, parts: Sequence[StaticHistory]) -> StaticHistory:
        """Return the contact under the loads of all parts in turn."""
        return parts[0] if len(parts) == 1 else cls(**{
            name: np.concatenate([getattr(one, name) for one in parts]) for name in vars(parts[0])})


class _BusyContact(NamedTuple):
    """The contact of b points, while others stay open or stuck; condensed, as those follow or do not move."""

    contact: StaticContact
    dofs: Indices  # (3 b,), component order: x of all, y, z
    open: Indices  # (o,), the DOF of points that stay open
    stuck: Indices  # (s,), of those that stay stuck
    flexibility: Array  # (o, o), m/N, of the open ones
    carried: Array  # (o, 3 m), force on the others over the open ones' under load, and their motion over the others'
    holding: Array  # (s, 3 m), stiffness that the stuck points feel

    @classmethod
    def of(cls, stiffness: Array, keeps: States, gap: Array, law: Coulomb) -> _BusyContact:
        """Return the contact of the points whose state `keeps` (m,) is slip; stiffness (3 m, 3 m) in node order."""
        m, idle = len(keeps), keeps != SLIP
        dofs = (3 * np.flatnonzero(~idle)[None] + np.arange(3)[:, None]).ravel()
        away, stuck = (np.flatnonzero(np.repeat(keeps == one, 3)) for one in (SEPARATION, STICK))
        flexibility = np.linalg.inv(stiffness[np.ix_(away, away)])
        carried = flexibility @ stiffness[away]
        rows = np.r_[dofs, stuck]
        own = stiffness[rows] - stiffness[np.ix_(rows, away)] @ carried
        busy = own[:len(dofs), dofs]
        busy = np.ascontiguousarray(0.5 * (busy + busy.T))
        friction, reference = (np.array(np.broadcast_to(values, m)[~idle], dtype=float)
                               for values in (law.friction_coefficient, law.reference_force))
        contact = StaticContact(busy, np.array(gap[~idle], dtype=float), friction, reference, law.exponent,
                                law.asymmetry, float(np.mean(stiffness.diagonal())))
        return cls(contact, dofs, away, stuck, flexibility, carried, own[len(dofs):])


@record
class BoltedJoint:
    """A reduced structure, the friction of its faces, asperity springs in series, and the bolts' load.

    The bolts are tightened with the friction that holds later.

    Examples
    --------
    The slider of `StructureMatrices`, pressed by 5 N:

    >>> import fretflow as ff
    >>> import numpy as np
    >>> mass, stiffness = np.diag([2.0, 0.0, 0.0, 0.0]), np.diag([4e4, 1e4, 1e4, 1e4])  # kg, N/m
    >>> stiffness[0, 1] = stiffness[1, 0] = -1e4
    >>> rows = np.eye(4)
    >>> slider = ff.StructureMatrices(mass=mass, stiffness=stiffness, contact_map=rows[1:], areas=np.array([1e-6]),
    ...                               points=np.zeros((1, 3)), preload=-rows[3], outputs={"mass": rows[0]})
    >>> joint = ff.BoltedJoint(structure=ff.reduce_structure(slider), law=ff.Coulomb(0.6), bolt_load=5.0)
    >>> [round(mode.frequency, 2) for mode in joint.linear_modes(1)]  # Hz: 4e4 N/m on 2 kg
    [22.51]
    >>> round(joint.bolted_pressure / 1e6)  # MPa
    5
    """

    structure: ReducedStructure
    law: Coulomb
    bolt_load: float = quantity("N")
    gap: Array | None = quantity("m", "(m,), instead of the structure's", default=None)
    springs: Array | None = quantity("m/N", "(3 m,), compliance; rigid by default", default=None)
    bolt_shares: Array | None = quantity("1", "(m,), factor on the bolts' force at each contact point", default=None)
    modal_damping: float = quantity("1", "ratio; by default the structure's", default=None)
    damping_slope: float = quantity("1/(m*kg^0.5)", "damping ratio over modal amplitude", default=0.0)

    @property
    def interface(self) -> Interface:
        """Return the contact points in the plane of the faces, x along their longer side."""
        points = self.structure.points - self.structure.points.mean(axis=0)
        axes = np.linalg.svd(points.T @ points)[2][:2]  # two of a single point too
        axes *= np.where(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)] < 0.0, -1.0, 1.0)[:, None]
        return Interface(nodes=points @ axes.T, areas=self.structure.areas, gap=self.clearance)

    @property
    def across(self) -> Array:
        """Return the places (m, 2) of the contact points from the middle of the faces, over half their size."""
        nodes = self.interface.nodes
        half = 0.5 * (nodes.max(axis=0) - nodes.min(axis=0))
        middle = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
        flat = half <= 1e-9 * float(half.max())  # points in a row
        return np.where(flat, 0.0, (nodes - middle) / np.where(flat, 1.0, half))

    @property
    def bolted_pressure(self) -> float:
        """Return the mean pressure of the faces under the bolts in Pa."""
        return float(np.abs(self.bolts[2::3]).sum() / self.structure.areas.sum())

    def pressed(self, share: Array) -> BoltedJoint:
        """Return the joint with each point's part of the bolts' force times `share` (m,), their sum kept."""
        normal = np.abs(self.bolts[2::3])
        return replace(self, bolt_shares=share * float(normal.sum() / (normal @ share)))

    def check(self) -> None:
        """Check that something presses the faces together, and that what each point has is of as many points.

        Raises
        ------
        InputError
            If the structure says nothing of its preload, the bolt load is not positive, the damping no ratio, or the
            points are of another number.
        """
        m = self.structure.contacts
        for name, size in (("gap", m), ("springs", 3 * m), ("bolt_shares", m)):
            values = getattr(self, name)
            if values is not None and np.shape(values) != (size,):
                raise InputError(f"{name}: has the shape {np.shape(values)}, but the joint's {m} contact points need "
                                 f"({size},)")
        if np.size(mu := self.law.friction_coefficient) not in (1, m):
            raise InputError(f"friction coefficient: {np.size(mu)} values for {m} contact points; give one, or one for "
                             "each")
        if self.modal_damping is not None and not 0.0 <= self.modal_damping < 1.0:
            raise InputError(f"modal_damping: {self.modal_damping} is no damping ratio between 0 and 1")
        if self.modal_damping is None:
            object.__setattr__(self, "modal_damping", self.structure.modal_damping or 0.0)
        if self.structure.preload is None:
            raise InputError("preload: is required, the force (n,) on every DOF per unit of bolt load; without it "
                             "nothing presses the joint together")
        if not self.bolt_load > 0.0:
            raise InputError(f"bolt_load: must be positive, got {self.bolt_load}")

    @cached_property
    def clearance(self) -> Array:
        """Return the gap (m,) without load."""
        return self.structure.gap if self.gap is None else self.gap

    @cached_property
    def compliance(self) -> Array:
        """Return the compliance (3 m,) of the springs, m/N."""
        return np.zeros(3 * self.structure.contacts) if self.springs is None else self.springs

    @cached_property
    def _series(self) -> Array:
        """Return ``(1 + K D)^-1``, which turns forces on closed faces into those of sliders behind springs."""
        k = self.structure.stiffness
        return np.linalg.inv(np.eye(len(k)) + k * self.compliance)

    @cached_property
    def bolts(self) -> Array:
        """Return the bolts' static load on the contact (3 m,) in N."""
        if self.structure.preload is None:
            raise InputError("preload: is required")
        load = self.bolt_load * self.structure.preload[0]
        return load if self.bolt_shares is None else load * np.repeat(self.bolt_shares, 3)

    @cached_property
    def _stiffness(self) -> Array:
        stiffness = self.structure.stiffness if self.springs is None else self._series @ self.structure.stiffness
        return np.asarray(0.5 * (stiffness + stiffness.T))

    @cached_property
    def _contacts(self) -> dict[bytes, _BusyContact]:
        """Return the contact of those points that are not idle, as it was last needed."""
        return {}

    @cached_property
    def _moved(self) -> NDArray[np.bool_]:
        """Return which points (m,) have not kept the state in which some loads found them."""
        return np.zeros(self.structure.contacts, dtype=bool)

    def _busy_contact(self, keeps: States) -> _BusyContact:
        key = keeps.tobytes()
        if key not in self._contacts:
            self._contacts.clear()
            self._contacts[key] = _BusyContact.of(self._stiffness, keeps, self.clearance, self.law)
        return self._contacts[key]

    def follow(self, loads: Array, start: StaticHistory | None = None, guess: States | None = None) -> StaticHistory:
        """Return the contact under each of the loads (S, 3 m) on u in turn, from the end of `start` or no load on.

        Points that are open or stuck are condensed where they have stayed so before, or under half of the loads so far;
        where one moves after all, it is taken back. A `guess` of the states (S, m) is that of a joint alike.

        Raises
        ------
        NonConvergenceError
            If no state is found under one of them.
        """
        free, guess = np.int8(SLIP), None if guess is None or len(guess) != len(loads) else guess
        moved = self._moved if guess is None else ~_same(guess)
        if len(moved) <= FEW:
            moved = np.ones_like(moved)
        keeps = np.where(moved | (start is None), free, free if start is None else start.state[-1])
        histories: list[StaticHistory] = []
        made, count = 0, len(loads) if moved.any() or start is None else 1
        while made < len(loads):
            now = slice(made, made + count)
            history = self._follow_busy(loads[now], histories[-1].last(1) if histories else start, keeps,
                                        None if guess is None else guess[now])
            if history is None and np.all(keeps == free):
                raise NonConvergenceError(f"static contact: no equilibrium under one of the loads {made + 1} to "
                                          f"{min(made + count, len(loads))} of {len(loads)}; the joint slides or opens "
                                          "as a whole, ask for smaller amplitudes")
            leaving = np.ones((1, len(keeps)), dtype=bool) if history is None else self._leaving(history, keeps)
            good = int(np.argmax(np.r_[leaving.any(axis=1), True]))
            if history is not None and good:
                histories.append(history if good == len(leaving) else history.first(good))
                made += good
            if good < len(leaving):
                gone, guess = leaving.any(axis=0), None
                keeps, count = np.where(gone, free, keeps), max(count // 2, 1)
                self._moved[gone] = True
            else:
                states = np.concatenate([one.state for one in histories])[made // 2:]
                still = _same(states) if guess is None else _same(states) & _same(guess[made:])
                keeps, count = np.where(still, states[-1], free), 2 * count
        return StaticHistory.joined(histories)

    def _leaving(self, history: StaticHistory, keeps: States) -> NDArray[np.bool_]:
        """Return which points close (S, m) that were to stay open, or open or slide that were to stay stuck."""
        force = history.force.reshape(len(history.force), -1, 3)
        beyond = np.hypot(force[..., 0], force[..., 1]) - self.law.directed_limit(force)
        closing = (keeps == SEPARATION) & (history.slid[:, 2::3] < -self.clearance)
        return np.asarray(closing | ((keeps == STICK) & (np.maximum(beyond, -force[..., 2]) > self._tolerance)))

    @property
    def _tolerance(self) -> float:
        return TOLERANCE * float(np.abs(self.bolts).max())

    def _follow_busy(self, loads: Array, start: StaticHistory | None, keeps: States, guess: States | None
                     ) -> StaticHistory | None:
        """Return the contact under loads while some points keep their state; None where there is none."""
        busy, steps = self._busy_contact(keeps), len(loads)
        own, stuck, away = busy.dofs, busy.stuck, busy.open
        count = len(own) // 3
        begin, before, first = np.zeros(len(keeps) * 3), np.zeros((1, len(keeps) * 3)), np.zeros(count, dtype=np.int8)
        if start is not None:
            begin, before, first = np.array(start.slid[-1]), start.load[-1:], np.array(start.state[-1][keeps == SLIP])
            begin[2::3] = np.where(keeps == STICK, -self.clearance, begin[2::3])
        under = np.vstack([before, loads])
        under = under if self.springs is None else under @ self._series.T
        pull = under - under[:, away] @ busy.carried
        slid, force = np.zeros_like(loads), np.zeros_like(loads)
        slid[:, stuck] = begin[stuck]
        u, f, state = np.zeros((steps, len(own))), np.zeros((steps, len(own))), np.zeros((steps, count), dtype=np.int8)
        on_busy = np.ascontiguousarray(pull[:, own] - begin[stuck] @ busy.holding[:, own])
        likely = np.ascontiguousarray(state[:0] if guess is None else guess[:, keeps == SLIP])
        if count and follow_loads(busy.contact, on_busy[1:], begin[own], on_busy[0], first, likely, self._tolerance,
                                  u, f, state) < steps:
            return None
        slid[:, own], force[:, own] = u, f
        force[:, stuck] = u @ busy.holding[:, own].T + busy.holding[:, stuck] @ begin[stuck] - pull[1:, stuck]
        slid[:, away] = under[1:, away] @ busy.flexibility - slid @ busy.carried.T
        states = np.repeat(keeps[None], steps, axis=0)
        states[:, keeps == SLIP] = state
        return StaticHistory(displacement=slid - self.compliance * force, force=force, state=states, slid=slid,
                             load=loads)

    @cached_property
    def preloaded(self) -> StaticHistory:
        """Return the contact under the bolts alone, one load.

        Raises
        ------
        InputError
            If the bolts do not press any two points together.
        """
        steps = GAP_STEPS if np.any(self.clearance) else 1
        try:
            history = self.follow(np.outer(np.arange(1.0, steps + 1.0) / steps, self.bolts))
        except NonConvergenceError as error:
            raise InputError("preload: the bolts' forces find no path through the joint, no equilibrium presses its "
                             "faces together; check their signs and that each bolt pulls both its ends") from error
        if not float(history.force[-1, 2::3].max()) > PRESSED * float(np.abs(self.bolts).max()):
            raise InputError("preload: the bolts' forces find no path through the joint, all faces are open; check "
                             "their signs and those of the normal rows of contact_map")
        return history.last(1)

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """Return which points (m,) the bolts press together."""
        pressing = self.preloaded.force[0, 2::3]
        return np.asarray(pressing > PRESSED * float(pressing.max()))

    def linear_modes(self, count: int) -> tuple[LinearMode, ...]:
        """Return the first modes with all closed points stuck.

        Raises
        ------
        InputError
            If none are asked for, or the bolts leave parts free to move.
        """
        if count < 1:
            raise InputError(f"modes: asked for {count}; give at least 1")
        k, m = assembled(self.structure)
        contact = len(self.structure.stiffness)
        soft = float(np.mean(1.0 / self.structure.stiffness.diagonal())) * RIGID_SPRING
        stuck = np.repeat(self.closed, 3)
        sprung = stuck & (self.compliance > soft)
        own = np.arange(contact)[sprung]
        k[own, own] += 1.0 / self.compliance[sprung]
        free = np.r_[np.flatnonzero(~stuck | sprung), np.arange(contact, len(k))]
        last = min(count, len(free)) - 1
        here, mass = k[np.ix_(free, free)], m[np.ix_(free, free)]
        try:  # of the inverse, as contact points may have no mass
            inverse, vectors = eigh(mass, here, subset_by_index=[len(free) - 1 - last, len(free) - 1])
        except np.linalg.LinAlgError as error:
            raise InputError("preload: what the bolts press together leaves parts of the structure free to move; check "
                             "that they press faces on all parts") from error
        values, vectors = 1.0 / np.maximum(inverse[::-1], np.finfo(float).tiny), vectors[:, ::-1]
        shapes = np.zeros((len(k), last + 1))
        shapes[free] = vectors / np.sqrt(np.sum(vectors * (mass @ vectors), axis=0))
        return tuple(LinearMode(frequency=float(np.sqrt(max(value, 0.0))) / (2.0 * np.pi), contact=shape[:contact],
                                modes=shape[contact:]) for value, shape in zip(values, shapes.T, strict=True))


def _same(states: States) -> NDArray[np.bool_]:
    """Return which points (m,) have the same of `states` (S, m) throughout."""
    return np.asarray(np.all(states == states[-1:], axis=0))
