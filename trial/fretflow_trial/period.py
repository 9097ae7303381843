"""Integration in time over periods of the drive, until the motion repeats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow_trial.contact import Contact, Flags
from fretflow_trial.joint import Joint
from fretflow_trial.physics import Channels, Condition, Instant, Physics, Slow, Worn, opened
from fretflow_trial.rig import ARM, BLOCK, EXACT, Scheme, step_of

Array = NDArray[np.float64]

STEPS = 400  # a period
NORMAL_TO_SHEAR = 2.6  # of the stiffness of a debris layer


class State(NamedTuple):
    """Everything at one instant, and the pressing forces one step before."""

    rig: Array  # (4,): positions and velocities of block and arm
    outer: tuple[float, float]  # forces on the rig, friction included, N
    slip: Array  # (n,), m
    friction: Array  # (n,), N
    sliding: Array  # (n,), -1, 0, 1
    pressing: Array  # (n,), N
    pressing_before: Array  # (n,), N
    closed: Flags
    velocity_before: float  # of the block
    age: float  # of the contacts, as the physics keeps it


@dataclass(frozen=True)
class Track:
    """All instants of a run, S steps: rows are the ends of the steps."""

    rig: Array  # (S, 4)
    friction: Array  # (S, n), N
    slip: Array  # (S, n), m
    pressing: Array  # (S, n), N
    load: Array  # (S,), N
    approach: Array  # (S,), m
    excitation: Array  # (S,), N
    slip_steps: Array  # (S, n), m
    step: float  # s


@dataclass(frozen=True)
class Settled:
    """A motion that repeats."""

    state: State
    track: Track
    contact: Contact
    change: float  # of the arm's motion from period to period, over its range
    runs: int


class March:
    """The rig under one condition with given worn faces.

    Parameters
    ----------
    joint : Joint
    physics : Physics
    condition : Condition
    slow : Slow
        What the cycles so far have done.
    pressure : ndarray, shape (n,)
        Mean pressure of each node in Pa that the asperities' stiffness follows.
    contact : Contact or None
        A contact of another march to reuse where it is the same.
    steps : int
        Steps a period.
    scheme : Scheme
        How the rig is integrated.
    """

    def __init__(self, joint: Joint, physics: Physics, condition: Condition, slow: Slow, pressure: Array,
                 contact: Contact | None = None, steps: int = STEPS, scheme: Scheme = EXACT) -> None:
        self.joint, self.physics, self.condition, self.slow, self.steps = joint, physics, condition, slow, steps
        self.duration = 1.0 / (condition.frequency * steps)
        rig = replace(physics.rig, added_mass=joint.specimen.mass)
        self.step = step_of(rig, self.duration, scheme)
        self.whole_step = np.hstack([self.step.free, self.step.early, self.step.late])
        self.contact = self._contact(pressure, contact)
        self.gap = opened(physics.gap, joint.nodes) + slow.depth - slow.layer
        share = np.prod([factor(slow) for factor in physics.load_over_test])
        self.load = condition.load * float(share)
        mu = physics.friction * np.prod([factor(slow) for factor in physics.friction_over_test])
        self.friction = np.asarray(mu * (np.ones(joint.size) if physics.friction_of_node is None
                                         else physics.friction_of_node))

    def _contact(self, pressure: Array, other: Contact | None) -> Contact:
        joint, soft = self.joint, np.zeros(self.joint.size)
        stiffnesses = None if self.physics.springs is None else self.physics.springs(self.slow, pressure)
        springs = [k * joint.areas for k in stiffnesses or (self.physics.rigid, self.physics.rigid)]
        if self.physics.layer is not None:
            soft = self.slow.layer / (self.physics.layer(joint.nodes).modulus * joint.areas)
        sliding, normal = 1.0 / (1.0 / springs[0] + NORMAL_TO_SHEAR * soft), 1.0 / (1.0 / springs[1] + soft)
        arm = float(self.step.late[ARM, ARM])
        made = Contact(joint, sliding, normal, arm)
        same = other is not None and np.array_equal(other.coupled, made.coupled) and np.array_equal(
            other.normal, made.normal)
        return other if same and other is not None else made

    def at_rest(self) -> State:
        """Return the loaded rig at rest, all nodes held."""
        n = self.joint.size
        pressing, _, closed = self.contact.press(self.load, -self.gap, np.ones(n, dtype=bool))
        return State(rig=np.zeros(4), outer=(0.0, 0.0), slip=np.zeros(n), friction=np.zeros(n),
                     sliding=np.zeros(n), pressing=pressing, pressing_before=pressing, closed=closed,
                     velocity_before=0.0, age=0.0)

    def drive(self, steps: int) -> Array:
        """Return the exciting force at the instants 0...`steps`, (steps + 1,) N; it has its maximum at 0."""
        phase = 2.0 * np.pi * np.arange(steps + 1) / self.steps
        return np.asarray(self.condition.amplitude * (np.cos(phase) + sum(
            (added(phase) for added in self.physics.excitation), np.zeros(len(phase)))))

    def run(self, state: State) -> tuple[State, Track]:
        """Integrate over the periods after which the motion repeats, from phase 0."""
        count, n = self.steps * self.physics.periods, self.joint.size
        drive = self.drive(count)
        rig, friction, slip, pressing, moved = (np.empty((count, k)) for k in (4, n, n, n, n))
        load, approach = np.empty(count), np.empty(count)
        advance = self._advance_with_forces if self.physics.rig_forces else self._advance
        for k in range(count):
            state, friction[k], moved[k], load[k], approach[k] = advance(state, k, drive[k], drive[k + 1])
            rig[k], slip[k], pressing[k] = state.rig, state.slip, state.pressing
        return state, Track(rig, friction, slip, pressing, load, approach, drive[1:], moved, self.duration)

    def _advance_with_forces(self, state: State, k: int, now: float, then: float
                             ) -> tuple[State, Array, Array, float, float]:
        """Take a step with further forces on the rig: those at its end by one correction of a prediction."""
        early = self._rig_forces(state.rig)
        end = state.rig + self.duration * np.append(state.rig[2:], [0.0, 0.0])
        for _ in range(2):
            late = self._rig_forces(end)
            advanced = self._advance(state, k, now, then, early, late)
            end = advanced[0].rig
        return advanced

    def _rig_forces(self, rig: Array) -> Array:
        return np.asarray(np.sum([force(rig, self.slow) for force in self.physics.rig_forces], axis=0))

    def _advance(self, state: State, k: int, now: float, then: float, early: Array | None = None,
                 late: Array | None = None) -> tuple[State, Array, Array, float, float]:
        physics, contact = self.physics, self.contact
        block, arm = now, -state.outer[1]
        new_block, new_arm = then, 0.0
        if early is not None and late is not None:
            block, arm, new_block, new_arm = block + early[0], arm + early[1], then + late[0], late[1]
        free = self.whole_step @ np.array([*state.rig, block, arm, new_block, new_arm])
        expected = np.maximum(2.0 * state.pressing - state.pressing_before, 0.0)
        limit = self.friction * expected
        if physics.friction_at_instant:
            velocity = 2.0 * state.rig[2 + BLOCK] - state.velocity_before
            instant = Instant((k + 1) * self.duration, velocity, state.age, expected / self.joint.areas, state.friction)
            for factor in physics.friction_at_instant:
                limit = limit * factor(instant)
        push = free[ARM] + self.joint.cross @ expected - state.slip
        friction, moved, sliding = contact.friction(limit, push, state.sliding)
        total = float(friction.sum())
        rig = free - self.step.late[:, ARM] * total
        load = self.load
        for added in physics.load_at_instant:
            load += added(self.load, (k + 1) / self.steps, float(rig[ARM]))
        pressing, approach, closed = contact.press(max(load, 0.0), self.joint.cross.T @ friction - self.gap,
                                                   state.closed)
        age = state.age
        if physics.ageing is not None:
            age = physics.ageing(age, float(np.abs(moved) @ self.joint.share), self.duration)
        new = State(rig, (0.0, total), state.slip + moved, friction, sliding, pressing, state.pressing, closed,
                    float(state.rig[2 + BLOCK]), age)
        return new, friction, moved, load, approach

    def settle(self, state: State | None = None, tolerance: float = 2e-4, least: int = 2, most: int = 60) -> Settled:
        """Integrate until the arm's motion repeats to `tolerance` of its range, or `most` runs are over."""
        state = self.at_rest() if state is None else state
        before: Array | None = None
        change = np.inf
        for runs in range(1, most + 1):
            state, track = self.run(state)
            arm = track.rig[:, ARM]
            if before is not None:
                change = float(np.max(np.abs(arm - before)) / max(np.ptp(arm), 1e-12))
            if runs >= least and change < tolerance:
                break
            before = arm
        return Settled(state, track, self.contact, change, runs)

    def worn(self, track: Track) -> Worn:
        """Return what a period of `track` does to the faces."""
        slip, pressing = np.abs(track.slip_steps), track.pressing
        periods, areas = self.physics.periods, self.joint.areas
        dissipated = np.sum(track.friction * track.slip_steps, axis=0) / periods
        return Worn(np.sum(pressing * slip, axis=0) / areas / periods, np.sum(slip, axis=0) / periods,
                    dissipated * self.condition.frequency / areas, self.condition.frequency)

    def channels(self, track: Track, every: int = 2) -> Channels:
        """Return what ideal sensors show, from phase 0, every `every`-th step."""
        joint = self.joint

        def rolled(values: Array) -> Array:
            return np.roll(values, 1, axis=0)[::every]  # the last instant of a period is the first of the next

        arm = track.rig[:, ARM]
        faces = arm[:, None] - track.friction @ joint.sliding + track.pressing @ joint.cross.T
        velocity = track.rig[:, 2 + ARM]
        acceleration = (np.roll(velocity, -1) - np.roll(velocity, 1)) / (2.0 * track.step)
        time = track.step * every * np.arange(len(arm) // every)
        return Channels(self.condition.frequency / self.physics.periods, self.physics.periods, time,
                        *map(rolled, (track.excitation, faces @ joint.share, track.friction.sum(axis=1), track.load,
                                      track.approach, arm, velocity, acceleration)))
