"""Which mode of a structure a backbone is of, and how motions of it show there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from math import log

import numpy as np
from scipy.linalg import eigvalsh

from fretflow.core.errors import InputError
from fretflow.core.records import Array
from fretflow.experiments.structure.responses import POWERS
from fretflow.recordings.kinds.structures import MODAL_UNIT, MeasuredBackbone
from fretflow.recordings.plausibility import STATED
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode
from fretflow.solvers.nonlinear_modes.periodic_mode import PeriodicMode
from fretflow.solvers.nonlinear_modes.quasi_static import ModalBackbone
from fretflow.structure.reduction.contact_modes import ReducedStructure, assembled

MATRICES = 1e-3  # relative error of a frequency from matrices matched to the parts: what a modal test resolves
NOMINAL = 0.02  # from a drawing's: 1.8 % of a thickness to 1 % (ISO 286, h11), E of a steel to 3, density to 0.5


@dataclass(frozen=True)
class BackboneObservation:
    """What a backbone shows of the motions of a structure; `frequency` (Hz) is that of its smallest amplitude."""

    structure: ReducedStructure
    backbone: MeasuredBackbone
    frequency: float

    def number(self, modes: Sequence[LinearMode]) -> int:
        """Return which of `modes` is stated, or whose frequency is nearest with a motion of the named output, from 0.

        Raises
        ------
        InputError
            If there is no such mode.
        """
        backbone, own = self.backbone, self.frequency
        motion = np.array([self.motion(one) for one in modes])
        still = motion <= np.sqrt(np.finfo(float).eps) * motion.max()  # round-off, as across a plane of symmetry
        if backbone.mode is not None:
            if backbone.mode > len(modes):
                raise InputError(f"backbone.mode: {backbone.mode} is beyond the {len(modes)} first modes")
            if still[backbone.mode - 1]:
                raise InputError(f"backbone.amplitude_of: mode {backbone.mode} does not move {backbone.amplitude_of!r};"
                                 " name another mode by backbone.mode, or another output")
            low, high = self.span(backbone.mode - 1)
            if not low / STATED < own < high * STATED:
                raise InputError(f"backbone.mode: {own:.4g} Hz is not that of mode {backbone.mode}, which has "
                                 f"{low:.4g} Hz with the joint open and {high:.4g} Hz with it glued; check the number, "
                                 "the unit of the frequency and those of M and K")
            return backbone.mode - 1
        highest, lowest = modes[-1].frequency, self.span(0)[0]  # the open joint's is the lowest (Rayleigh)
        if not lowest / STATED < own < highest * STATED:
            raise InputError(f"backbone.frequency: {own:.4g} Hz is none of the structure's, whose first mode with the "
                             f"joint open has {lowest:.4g} Hz and whose last that is compared {highest:.4g} Hz; "
                             "check its unit and those of M and K, or name its number in backbone.mode")
        distance = np.array([abs(log(one.frequency / own)) for one in modes])
        moving, nearest = int(np.argmin(np.where(still, np.inf, distance))), int(np.argmin(distance))
        low, high = self.span(moving)
        if moving != nearest and not low * (1.0 - MATRICES) <= own <= high * (1.0 + MATRICES):
            raise InputError(f"backbone.amplitude_of: {own:.4g} Hz is the frequency of mode {nearest + 1}, which does "
                             f"not move {backbone.amplitude_of!r}, and that of mode {moving + 1}, which does, lies "
                             f"between {low:.4g} and {high:.4g} Hz; name another output, or a mode by backbone.mode")
        return moving

    def span(self, mode: int) -> tuple[float, float]:
        """Return the frequencies (Hz) of a mode, from 0, with the joint open and glued; contact only stiffens."""
        stiffness, mass = assembled(self.structure)
        place = len(mass) - 1 - mode
        shift = (2.0 * np.pi * self.frequency)**2  # contact may have no mass, bodies may move freely
        inverse = float(eigvalsh(mass, stiffness + shift * mass, subset_by_index=[place, place])[0])
        low, high = (float(np.sqrt(max(one, 0.0))) / (2.0 * np.pi)
                     for one in (1.0 / inverse - shift, self.structure.eigenvalues[mode]))
        return low, high

    def gain(self, mode: LinearMode) -> float:
        """Return the recorded amplitude of a mode over its modal amplitude, at small ones."""
        return self.motion(mode) * float((2.0 * np.pi * mode.frequency)**POWERS.get(self.backbone.amplitude_unit, 0))

    def motion(self, mode: LinearMode) -> float:
        """Return the displacement of the output over the modal amplitude, in 1/kg^0.5; 1 of a modal amplitude."""
        if self.backbone.amplitude_unit == MODAL_UNIT:
            return 1.0
        on_contact, on_modes = self.structure.outputs[self.backbone.amplitude_of]
        return abs(float(on_contact @ mode.contact + on_modes @ mode.modes))

    def seen(self, motion: ModalBackbone | PeriodicMode) -> Array:
        """Return the amplitudes of motions as they were recorded."""
        if self.backbone.amplitude_unit == MODAL_UNIT:
            return np.asarray(motion.amplitude)
        moved = np.abs(motion.outputs[..., list(self.structure.outputs).index(self.backbone.amplitude_of)])
        return np.asarray(moved * (2.0 * np.pi * motion.frequency)**POWERS[self.backbone.amplitude_unit])


def moves_alike(one: BoltedJoint, other: BoltedJoint) -> bool:
    """Tell whether two joints differ in damping alone, which moves nothing under static loads."""
    return _same(*(replace(joint, modal_damping=0.0, damping_slope=0.0) for joint in (one, other)))


def _same(one: object, other: object) -> bool:
    """Tell whether two values are the same, records by their fields."""
    if is_dataclass(one) and one is not other:
        return type(one) is type(other) and all(
            _same(getattr(one, part.name), getattr(other, part.name)) for part in fields(one))
    return one is other or np.array_equal(one, other)  # type: ignore[arg-type]
