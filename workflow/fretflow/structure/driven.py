"""Sliders that a given motion drives: springs with a friction limit each, and a play before them.

A spring of stiffness k in series with a Coulomb slider of limit s (Jenkins, J. Appl. Mech. 29, 1962) carries k z, and
its stretch follows the motion x within plus and minus the reach s / k::

    z_i = min(max(z_i-1 + x_i - x_i-1, -s / k), s / k)

Play of half width r widens both bounds by r and leaves ``k sign(z) max(|z| - r, 0)``: a joint with play in series
carries nothing while it crosses it. Sliders side by side are the model of Iwan (J. Appl. Mech. 33, 1966).

Maps ``z -> clip(z + a, low, high)`` are closed under composition, so that all samples follow from pairs of them: a
march of N samples is log2 N vectorised steps, exact for any motion and for limits that change with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.structure.motion import Motion
from fretflow.structure.sensors import Senses, Signals, in_sensing_order


@record
class Sliders:
    """Jenkins elements side by side, M >= 0 of them, behind play of `play` from end to end."""

    stiffness: Array = quantity("N/m", "(M,)")
    reach: Array = quantity("m", "(M,), stretch at which an element slides")
    play: float = quantity("m", default=0.0)

    def check(self) -> None:
        """Check shapes and signs.

        Raises
        ------
        InputError
            Naming the field.
        """
        if self.stiffness.ndim != 1 or self.stiffness.shape != self.reach.shape:
            raise InputError(f"sliders: stiffness {self.stiffness.shape} and reach {self.reach.shape} do not match")
        for name in ("stiffness", "reach", "play"):
            values = np.asarray(getattr(self, name))
            if not (np.all(np.isfinite(values)) and np.all(values >= 0.0)):
                raise InputError(f"sliders: {name} must be finite and not negative")

    @classmethod
    def none(cls) -> Sliders:
        """Return no slider at all."""
        return cls(stiffness=np.zeros(0), reach=np.zeros(0))

    @classmethod
    def one(cls, stiffness: float, limit: float) -> Sliders:
        """Return one slider of `stiffness` (N/m) and `limit` (N)."""
        return cls(stiffness=np.array([stiffness]), reach=np.array([limit / stiffness]))

    def force(self, motion: Motion, up: Array | float = 1.0, down: Array | float = 1.0) -> Array:
        """Return their force (N,) in N, positive against positive motion.

        Parameters
        ----------
        motion : Motion
        up, down : ndarray or float
            Factors on the limits for sliding to positive and to negative x, () or (N,).
        """
        half, x = 0.5 * self.play, motion.displacement
        shape = (len(x), len(self.reach))
        high = half + np.broadcast_to(up, len(x))[:, None] * self.reach
        low = -half - np.broadcast_to(down, len(x))[:, None] * self.reach
        steps = np.broadcast_to(np.diff(x, prepend=x[0])[:, None], shape)
        begin = motion.lean * self.reach + np.sign(motion.lean) * half
        stretch = clipped_march(steps, low, high, begin)
        return np.asarray((stretch - np.clip(stretch, -half, half)) @ self.stiffness)


def _two(effect: str, factors: tuple[Array | float, Array | float], motion: Motion) -> tuple[Array | float, ...]:
    """Return the factors on the friction limit, refused where there are not two of the motion's length or none."""
    shapes = {(), motion.displacement.shape}
    if not isinstance(factors, tuple | list) or len(factors) != 2 or not {*map(np.shape, factors)} <= shapes:
        raise InputError(f"effect {effect}: limit must return two factors, a number or {len(motion.displacement)} of "
                         "them each: for sliding to positive x and to negative x")
    if not all(np.isfinite(one).all() for one in factors):
        raise InputError(f"effect {effect}: limit returns factors that are not finite")
    return tuple(factors)


def clipped_march(steps: Array, low: Array, high: Array, begin: Array | float) -> Array:
    """Return z with ``z_i = clip(z_i-1 + steps_i, low_i, high_i)``, from ``z_-1 = begin``; all (N, ...)."""
    n = len(steps)
    if n <= 1:
        return np.minimum(np.maximum(begin + steps, low), high)
    pairs = n // 2
    first, second = slice(0, 2 * pairs, 2), slice(1, None, 2)
    a, lo, hi = steps[second], low[second], high[second]
    # clip(clip(z + a1, lo1, hi1) + a2, lo2, hi2) is clip(z + a1 + a2, lo, hi) with both bounds of 1 carried through 2
    odd = clipped_march(steps[first] + a, np.minimum(np.maximum(low[first] + a, lo), hi),
                        np.minimum(np.maximum(high[first] + a, lo), hi), begin)
    z = np.empty_like(odd, shape=steps.shape)
    z[second] = odd
    before = np.concatenate([np.broadcast_to(begin, steps.shape[1:])[None], odd[:(n - 1) // 2]])
    even = slice(0, None, 2)
    z[even] = np.minimum(np.maximum(before + steps[even], low[even]), high[even])
    return z


class ActsOnMotion(Senses, Protocol):
    """What acts where a measured motion drives a joint."""

    def moved(self, motion: Motion) -> Motion:
        """Return the motion that reaches the contact."""

    def sliders(self, sliders: Sliders) -> Sliders:
        """Return the friction elements in place of `sliders`."""

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factors on the friction limit for sliding to positive and to negative x, () or (N,)."""

    def force(self, motion: Motion) -> Array | float:
        """Return the force that is added to the friction, () or (N,) in N, positive against positive motion."""


@record
class DrivenForce:
    """The force of a driven joint."""

    measured: Array = quantity("N", "(N,), as recorded")
    displacement: Array = quantity("m", "(N,), as recorded")


def driven_force(motion: Motion, sliders: Sliders, force: Array | float, effects: Sequence[ActsOnMotion]
                 ) -> DrivenForce:
    """Return the force that `motion` makes with `sliders`, `force` (N, () or (N,)) beside them, and `effects`."""
    moved = motion
    for effect in effects:
        moved, sliders = effect.moved(moved), effect.sliders(sliders)
    up: Array | float = 1.0
    down: Array | float = 1.0
    for effect in effects:
        more, less = _two(effect.id, effect.limit(moved), moved)
        up, down, force = up * more, down * less, force + effect.force(moved)
    signals = Signals(step=motion.step, displacement=motion.displacement,
                      friction_force=sliders.force(moved, up, down) + force, arm=motion.displacement,
                      arm_velocity=motion.velocity, arm_acceleration=motion.acceleration, periodic=False)
    for effect in in_sensing_order(effects):
        signals = effect.sense(signals)
    return DrivenForce(measured=signals.friction_force, displacement=signals.displacement)
