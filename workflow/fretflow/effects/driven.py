"""A joint that a measured motion drives: a baseline and effects, which predict its force.

The baselines are one Jenkins slider (recordings of an imposed displacement) and a mass on a damper and a spring
(lumped recordings). With motion x, the motion y that reaches the contact, and sliders S::

    T = m a + c v + k x + S[y; limits] + forces of the effects,    recorded as the effects sense it

Effects act in the order of their ids, so that the order in which they are given does not matter.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fretflow.case.config import Section
from fretflow.core import units as u
from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import check_together
from fretflow.effects.effect import Array, Effect, RecordingKind, parameter
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED
from fretflow.structure.driven import DrivenForce, Sliders, driven_force
from fretflow.structure.motion import Motion

WIDE = "wide, from the recording's own amplitudes"


class Baseline(Section):
    """A joint without effects, given by its parameters."""

    kind: ClassVar[RecordingKind]

    def sliders(self) -> Sliders:
        """Return its friction elements."""
        return Sliders.none()

    def force(self, motion: Motion) -> Array | float:
        """Return the other forces on it, () or (N,) in N, positive against positive motion."""
        return 0.0


class SliderBaseline(Baseline):
    """A Coulomb slider with a spring in series, driven by a measured displacement."""

    kind = IMPOSED_DISPLACEMENT

    tangential_stiffness: u.SignedStiffness = parameter(
        28e6, "stiffness of the joint while it sticks", 1e6, 1e9, source=WIDE, gt=0.0)
    friction_limit: u.SignedForce = parameter(50.0, "friction limit", 5.0, 200.0, source=WIDE, ge=0.0)

    def sliders(self) -> Sliders:
        """Return the slider."""
        return Sliders.one(self.tangential_stiffness, self.friction_limit)


class LumpedBaseline(Baseline):
    """A mass on a damper and, where its field is set, a spring."""

    kind = LUMPED

    mass: u.SignedMass = parameter(10.0, "moving mass", 0.1, 1e3, source=WIDE, ge=0.0)
    damping: u.SignedDamping = parameter(100.0, "viscous damping", 1.0, 1e4, source=WIDE, ge=0.0)
    stiffness: u.SignedStiffness = 0.0

    def force(self, motion: Motion) -> Array | float:
        """Return ``m a + c v + k x``."""
        return np.asarray(self.mass * motion.acceleration + self.damping * motion.velocity
                          + self.stiffness * motion.displacement)


@dataclass(frozen=True)
class DrivenJoint:
    """A baseline and effects, sorted by id."""

    baseline: Baseline
    effects: tuple[Effect, ...] = ()

    @classmethod
    def build(cls, baseline: Baseline, effects: Iterable[Effect] = ()) -> DrivenJoint:
        """Return the joint of `baseline` and `effects`, in any order.

        Raises
        ------
        ConfigError
            If an effect does not act on such joints, comes twice, or two do not work together.
        """
        chosen = tuple(sorted(effects, key=lambda effect: effect.id))
        for k, effect in enumerate(chosen):
            if baseline.kind not in effect.kinds:
                raise ConfigError(f"effects.{effect.id}: does not act in recordings of kind {baseline.kind.id}; "
                                  f"only in {', '.join(sorted(kind.id for kind in effect.kinds))}")
            if k and chosen[k - 1].id == effect.id:
                raise ConfigError(f"effects.{effect.id}: given twice; an effect is in a model once")
        check_together(chosen)
        return cls(baseline, chosen)

    def predict(self, motion: Motion) -> DrivenForce:
        """Return the force that `motion` makes."""
        return driven_force(motion, self.baseline.sliders(), self.baseline.force(motion), self.effects)
