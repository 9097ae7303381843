"""A joint that a measured motion drives: a baseline and effects, which predict its force.

The baselines are one Jenkins slider (recordings of an imposed displacement) and a mass on a damper and a spring
(lumped recordings). With motion x, the motion y that reaches the contact, and sliders S::

    T = m a + c v + k x + S[y; limits] + forces of the effects,    recorded as the effects sense it

Effects act in the order of their ids, so that the order in which they are given does not matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fretflow.case.config import Section
from fretflow.core import units as u
from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import check_together
from fretflow.effects.effect import (
    Array,
    Effect,
    Prior,
    RecordingKind,
    declared_priors,
    parameter,
    parameter_limits,
)
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED
from fretflow.structure.driven import DrivenForce, Sliders, driven_force
from fretflow.structure.motion import Motion

BASELINE = "baseline"
DIFFERENCE = 1e-5  # of a parameter's size, for derivatives
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

    kind: ClassVar[RecordingKind] = IMPOSED_DISPLACEMENT

    tangential_stiffness: u.SignedStiffness = parameter(
        28e6, "stiffness of the joint while it sticks", 1e6, 1e9, source=WIDE, gt=0.0)
    friction_limit: u.SignedForce = parameter(50.0, "friction limit", 5.0, 200.0, source=WIDE, ge=0.0)

    def sliders(self) -> Sliders:
        """Return the slider."""
        return Sliders.one(self.tangential_stiffness, self.friction_limit)


class LumpedBaseline(Baseline):
    """A mass on a damper and, where its field is set, a spring."""

    kind: ClassVar[RecordingKind] = LUMPED

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

    @property
    def parts(self) -> dict[str, Section]:
        """Return the baseline and the effects by name."""
        return {BASELINE: self.baseline, **{effect.id: effect for effect in self.effects}}

    @property
    def priors(self) -> dict[str, Prior]:
        """Return the ranges of all parameters that have one, as ``backlash.play``."""
        return {f"{name}.{field}": prior for name, part in self.parts.items()
                for field, prior in declared_priors(type(part)).items() if not prior.rig_only}

    @property
    def values(self) -> dict[str, float]:
        """Return all parameters that have a range, in SI."""
        parts = self.parts
        return {name: float(getattr(parts[name.split(".")[0]], name.split(".")[1])) for name in self.priors}

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Return the limits that the parameters' fields set."""
        parts = self.parts
        return {name: parameter_limits(type(parts[name.split(".")[0]]), name.split(".")[1]) for name in self.priors}

    def with_values(self, values: Mapping[str, float]) -> DrivenJoint:
        """Return the joint with some parameters changed, in SI; the names are those of `values`.

        Raises
        ------
        KeyError
            If a name is not known.
        """
        changes: dict[str, dict[str, Any]] = {name: {} for name in self.parts}
        for name, value in values.items():
            part, _, field = name.partition(".")
            if field not in type(self.parts[part]).model_fields:
                raise KeyError(f"{name}: no such parameter; there are {', '.join(self.values)}")
            changes[part][field] = float(value)
        return DrivenJoint(self.baseline.model_copy(update=changes[BASELINE]),
                           tuple(effect.model_copy(update=changes[effect.id]) for effect in self.effects))

    def derivatives(self, motion: Motion, names: Sequence[str]) -> Array:
        """Return the derivatives (N, P) of the recorded force by the parameters `names`, by central differences.

        Near a bound of a parameter they are one-sided.
        """
        columns = []
        for name in names:
            value, prior, (low, high) = self.values[name], self.priors[name], self.bounds[name]
            step = DIFFERENCE * max(abs(value), abs(prior.low), 1e-3 * abs(prior.high))
            ends = max(value - step, low), min(value + step, high)
            below, above = (self.with_values({name: end}).predict(motion).measured for end in ends)
            columns.append((above - below) / (ends[1] - ends[0]))
        return np.column_stack(columns) if columns else np.zeros((len(motion.displacement), 0))

