"""A test on the rig from first cycle to last: wear, loops at chosen cycle counts, other conditions at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fretflow_trial.contact import Contact, UnsettledContactError
from fretflow_trial.joint import Joint
from fretflow_trial.period import STEPS, March, Settled, State
from fretflow_trial.physics import Channels, Condition, Physics, Slow, Worn
from fretflow_trial.rig import EXACT, Scheme

Array = NDArray[np.float64]

LARGEST_WEAR = 0.2e-6  # of a node in one jump at first, m
SHARE_OF_WEAR = 0.15  # later, of the depth so far
SHARE_OF_CYCLES = 0.3  # a jump's share of the cycles so far
FIRST_JUMP = 500.0
SAME_PRESSURE, MOST_UPDATES = 0.02, 4  # of the springs, which follow the pressure
LARGEST_UNREST = 1e-3  # of a recorded loop, over its range
PASSING, KEPT = 2e-3, 2e-4  # tolerance of periods that only wear, and of recorded ones
PASSING_STEPS = 200  # or up to twice as many, of a period that only wears


@dataclass(frozen=True)
class Plan:
    """What is recorded when."""

    main: Condition
    cycles: tuple[int, ...]  # counts with loops; the last one is the length of the test
    sweep: tuple[Condition, ...]  # at the end
    samples: int = 200  # a period
    steps: int = STEPS
    scheme: Scheme = EXACT


@dataclass(frozen=True)
class Outcome:
    """What ideal sensors show of a test."""

    loops: tuple[Channels, ...]  # by cycle count
    sweep: tuple[Channels, ...]
    depth: Array  # of both faces at the end, (n,) m
    energy: float  # J
    jumps: int
    unrest: float  # largest change of a recorded loop's motion from period to period, over its range
    slow: Slow  # at the end
    starts: tuple[tuple[State, Slow, Array], ...]  # state, slow state and pressure at each recorded count


class Test:
    """One test of a joint with given physics.

    Parameters
    ----------
    joint : Joint
    physics : Physics
    plan : Plan
    """

    __test__ = False  # not one of pytest's

    def __init__(self, joint: Joint, physics: Physics, plan: Plan) -> None:
        self.joint, self.physics, self.plan = joint, physics, plan
        self.pressure = plan.main.load * np.ones(joint.size) / joint.areas.sum()
        self.contacts: dict[tuple[float, int], Contact] = {}

    def run(self, fits: Callable[[Channels], bool] = lambda loop: True) -> Outcome:
        """Run the test to its end.

        Raises
        ------
        UnsettledContactError
            As soon as a loop does not repeat or does not fit.
        """
        joint, plan = self.joint, self.plan
        none = np.zeros(joint.size)
        slow = Slow(0.0, 0.0, none, none, 0.0, 0.0)
        state: State | None = None
        loops: list[Channels] = []
        starts, jumps, unrest = [], 0, 0.0
        for count in plan.cycles:
            while slow.cycles < count:
                march, settled = self._settle(plan.main, slow, state, PASSING)
                slow, state, jumps = self._jump(march, settled, slow, count), settled.state, jumps + 1
            march, settled = self._settle(plan.main, slow, state, KEPT)
            state, unrest = settled.state, max(unrest, settled.change)
            loops.append(self._sensed(march, settled, fits))
            starts.append((state, slow, self.pressure))
        # from the running test, as a rig is set to another condition, and not from rest
        sweep: list[Channels] = []
        for condition in plan.sweep:
            march, settled = self._settle(condition, slow, state, KEPT)
            unrest = max(unrest, settled.change)
            sweep.append(self._sensed(march, settled, fits))
        return Outcome(tuple(loops), tuple(sweep), slow.depth, slow.energy, jumps, unrest, slow, tuple(starts))

    def _sensed(self, march: March, settled: Settled, fits: Callable[[Channels], bool]) -> Channels:
        channels = self.sense(march, settled)
        if settled.change > LARGEST_UNREST or not fits(channels):
            raise UnsettledContactError("a motion that does not repeat or is not to be recorded")
        return channels

    def sense(self, march: March, settled: Settled) -> Channels:
        """Return what the sensors show of a period."""
        channels = march.channels(settled.track, self.plan.steps // self.plan.samples)
        for sensor in self.physics.sensors:
            channels = sensor(channels, march.slow)
        return channels

    def repeated(self, start: tuple[State, Slow, Array], condition: Condition | None = None) -> Channels:
        """Return a loop at a recorded state of another test, on its own physics."""
        state, slow, self.pressure = start
        march, settled = self._settle(condition or self.plan.main, slow, state, KEPT)
        return self.sense(march, settled)

    def _settle(self, condition: Condition, slow: Slow, state: State | None, tolerance: float
                ) -> tuple[March, Settled]:
        steps = self.plan.steps
        if tolerance == PASSING and self.plan.scheme.method != "explicit":  # which longer steps would upset
            steps //= max(steps // PASSING_STEPS, 1)
        alike = condition.frequency, steps
        # in passing, the pressure of the jump before will do
        for _ in range(MOST_UPDATES if tolerance == KEPT or state is None else 1):
            march = March(self.joint, self.physics, condition, slow, self.pressure,
                          self.contacts.get(alike), steps, self.plan.scheme)
            self.contacts[alike] = march.contact
            settled = march.settle(state, tolerance)
            before, self.pressure = self.pressure, settled.track.pressing.mean(axis=0) / self.joint.areas
            moved = float(np.abs(self.pressure - before) @ self.joint.share / (before @ self.joint.share))
            if self.physics.springs is None or moved < SAME_PRESSURE:
                break
        return march, settled

    def _jump(self, march: March, settled: Settled, slow: Slow, target: int) -> Slow:
        """Return the joint after a jump of cycles.

        Wear by Archard, implicit in how the wear itself reshapes the pressure: with the pressing force that
        falls by ``Q dh``, ``(1 + n K diag(s / a) Q) dh = n K sum p |du|``.
        """
        joint, physics = self.joint, self.physics
        worn = march.worn(settled.track)
        factor = np.ones(joint.size)
        for change in physics.wear_factors:
            factor = factor * change(worn, slow)
        layer = None if physics.layer is None else physics.layer(joint.nodes)
        if layer is not None:
            factor = factor * layer.slows(slow.layer)
        rate = physics.wear * factor * worn.work
        allowed = max(LARGEST_WEAR, SHARE_OF_WEAR * float(slow.depth @ joint.share))
        cycles = min(allowed / max(float(rate.max()), 1e-30), FIRST_JUMP + SHARE_OF_CYCLES * slow.cycles)
        left = target - slow.cycles
        cycles = left if cycles > left else left / np.ceil(left / cycles)
        opening = np.ones(joint.size) if layer is None else 1.0 - layer.retained * layer.residence / cycles * (
            1.0 - np.exp(-cycles / layer.residence))
        closed = settled.track.pressing.mean(axis=0) > 0.0
        stiffness = settled.contact.reshaping(closed)
        yielding = cycles * (physics.wear * factor * worn.path / joint.areas)[:, None] * stiffness * opening
        depth = np.linalg.solve(np.eye(joint.size) + yielding, cycles * rate)
        return self._after(slow, np.maximum(depth, 0.0), cycles, worn, march, settled)

    def _after(self, slow: Slow, worn_off: Array, cycles: float, worn: Worn, march: March, settled: Settled) -> Slow:
        thickness = slow.layer
        if self.physics.layer is not None:
            layer = self.physics.layer(self.joint.nodes)
            gone = np.exp(-cycles / layer.residence)
            supply = layer.retained * worn_off / cycles
            thickness = thickness * gone + supply * layer.residence * (1.0 - gone)
        stroke = 0.5 * float(np.ptp(settled.track.rig[:, 1]))
        energy = float(worn.power @ self.joint.areas) / march.condition.frequency
        count = slow.cycles + cycles
        return replace(slow, cycles=float(round(count)) if abs(count - round(count)) < 1e-6 else count,
                       energy=slow.energy + cycles * energy, depth=slow.depth + worn_off, layer=thickness,
                       scar=max(slow.scar, stroke), elapsed=count / self.plan.cycles[-1])
