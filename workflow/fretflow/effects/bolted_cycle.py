"""A bolted joint that vibrates in the shape of one mode, as wear sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fretflow.contact.kernels.static import SEPARATION
from fretflow.core.errors import InputError
from fretflow.core.records import Array
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode, StaticHistory
from fretflow.solvers.nonlinear_modes.quasi_static import shaped_load
from fretflow.wear.cycle import CycleResponse, WearAlone, summarise_cycle
from fretflow.wear.slow import SlowState

STEPS = 24  # of load in half a cycle
GROUND = 1e-7  # of the contact's own stiffness: holds parts that only bolts hold, and changes these forces by as much


def numbered_mode(joint: BoltedJoint, number: int) -> LinearMode:
    """Return a joint's mode about its preload by its number from 1.

    Raises
    ------
    InputError
        If there is none of that number.
    """
    modes = joint.linear_modes(max(1, number))
    if not 1 <= number <= len(modes):
        raise InputError(f"mode: {number} is none of the joint's {len(modes)} modes; they count from 1")
    return modes[number - 1]


@dataclass(frozen=True)
class BoltedCycle(WearAlone):
    """A `wear.CycleModel` of a bolted joint under a load that swings in the shape of a mode (quasi-static).

    The load's size is that which moves the closed joint by the modal `amplitude` in m kg^0.5. The bolts relax as the
    faces wear; what the faces hold by friction goes on from one state to the next.

    Examples
    --------
    >>> import fretflow as ff
    >>> cycle = ff.BoltedCycle(joint, amplitude=1e-4)  # of a BoltedJoint  # doctest: +SKIP
    >>> worn = ff.march_wear(cycle, ff.Archard(1e-14), cycles=10_000_000)  # doctest: +SKIP
    >>> worn.depth[-1]  # m, (contact points,)  # doctest: +SKIP
    """

    joint: BoltedJoint
    amplitude: float
    mode: int = 1  # from 1, of the joint before it wears

    state_type = StaticHistory
    load_held = False

    @property
    def areas(self) -> Array:  # type: ignore[override]  # known by the joint
        """Return the contact areas (m,), m^2."""
        return self.joint.structure.areas

    @cached_property
    def _swing(self) -> Array:
        mode = numbered_mode(self.joint, self.mode)
        return np.asarray((2.0 * np.pi * mode.frequency)**2 * self.amplitude * shaped_load(self.joint, mode))

    @cached_property
    def _flexibility(self) -> Array:
        stiffness = self.joint.structure.stiffness
        ground = GROUND * float(np.mean(stiffness.diagonal())) * np.eye(len(stiffness))
        whole = np.linalg.inv(stiffness + ground) + np.diag(self.joint.compliance)
        return np.asarray(0.5 * (whole + whole.T)[2::3, 2::3])

    def normal_flexibility(self, slow: SlowState) -> Array:
        """Return the static normal flexibility of the faces, (m, m), m/N."""
        return self._flexibility

    def gap(self, slow: SlowState) -> Array:
        """Return the gap of the undeformed faces, (m,), m."""
        return np.asarray(self.joint.clearance + slow.depth)

    def cycle(self, slow: SlowState, start: StaticHistory | None) -> tuple[CycleResponse, StaticHistory]:
        """Return what the second of two cycles of load does to the worn faces, and where it ends."""
        worn = replace(self.joint, gap=self.gap(slow))
        history = self.swing(worn, None if start is None else worn.follow(worn.bolts[None], start))
        slid, force = (values.reshape(len(values), -1, 3) for values in (history.slid, history.force))
        steps, closed = np.diff(slid[:, :, :2], axis=0), history.state[1:] != SEPARATION
        response = summarise_cycle(slid[1:], force[1:], np.where(closed, np.hypot(*np.moveaxis(steps, 2, 0)), 0.0),
                                   closed, worn.clearance, self.areas)
        return response, history.last(1)

    def swing(self, joint: BoltedJoint, start: StaticHistory | None = None) -> StaticHistory:
        """Return the second of two cycles of load on `joint`, its start included, from `start` or the preload on."""
        phase = np.pi * np.arange(1, 4 * STEPS + 1) / STEPS
        loads = joint.bolts + np.sin(phase)[:, None] * self._swing
        return joint.follow(loads, joint.preloaded if start is None else start).last(2 * STEPS + 1)
