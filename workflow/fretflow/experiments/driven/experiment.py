"""A driven joint's record under the inference engine: its measured force, and the force that its motion predicts.

The ranges of the effects are those of a fretting rig; a joint of another size has them by similarity: forces go with
the force amplitude F, lengths with the amplitude X of the motion, and times and frequencies with X over the speed V.
Delays of sensors stay what they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.case.casefile import unit_of
from fretflow.case.config import Section
from fretflow.core.errors import InputError
from fretflow.core.units import registry
from fretflow.effects.catalogue import catalogue, described, is_own
from fretflow.effects.driven import Baseline, DrivenJoint, LumpedBaseline, SliderBaseline
from fretflow.effects.effect import Array, Prior, declared_priors, parameter_limits
from fretflow.effects.sketches import AMPLITUDE, LIMIT, TIME
from fretflow.experiments.driven.data import DrivenData
from fretflow.experiments.driven.noise import Noise
from fretflow.experiments.independent import IndependentExperiment
from fretflow.inference.evidence import MODULATING, harmonics
from fretflow.inference.experiment import Measurement, Point, Prediction
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import Coordinate, Parameters
from fretflow.recordings.kinds import RecordingKind
from fretflow.structure.motion import Motion

BASELINES: Mapping[RecordingKind, type[Baseline]] = {one.kind: one for one in (SliderBaseline, LumpedBaseline)}


@dataclass(frozen=True)
class Scale:
    """Sizes of a recording: force (N), motion (m) and time (s)."""

    force: float
    length: float
    time: float

    @classmethod
    def of(cls, motion: Motion, force: Array) -> Scale:
        """Return the sizes of a recording.

        Raises
        ------
        InputError
            If nothing moves, or the force is constant.
        """
        length, size, speed = 0.5 * np.ptp(motion.displacement), 0.5 * np.ptp(force), np.std(motion.velocity)
        if not (length > 0.0 and size > 0.0 and speed > 0.0):
            raise InputError("recording: its displacement or force is constant; there is nothing to fit")
        return cls(float(size), float(length), float(np.std(motion.displacement) / speed))

    def prior(self, prior: Prior, unit: str) -> Prior:
        """Return a range of a fretting rig for a joint of this size."""
        factor = self.factor(unit)
        return replace(prior, low=prior.low * factor, high=prior.high * factor)

    def factor(self, unit: str) -> float:
        """Return how much larger a quantity in `unit` is than in a fretting rig."""
        a, b, c = similarity(unit)
        return float((self.force / RIG.force)**a * (self.length / RIG.length)**b * (self.time / RIG.time)**c)


RIG = Scale(LIMIT, AMPLITUDE, TIME)


@cache
def similarity(unit: str) -> tuple[float, float, float]:
    """Return the powers of F, X and X / V in what goes with the size of a joint; times alone are delays of sensors."""
    powers: Mapping[str, Any] = registry().Unit(unit).dimensionality
    mass, length, time = (float(powers.get(f"[{name}]", 0)) for name in ("mass", "length", "time"))
    return (mass, length - mass, time + 2.0 * mass) if mass or length else (0.0, 0.0, min(time, 0.0))


def baseline_of(kind: RecordingKind) -> type[Baseline]:
    """Return the baseline of recordings of a kind.

    Raises
    ------
    InputError
        If no measured motion drives the joint in it.
    """
    if kind not in BASELINES:
        raise InputError(f"recording of kind {kind.id}: no measured motion drives it; the full model predicts it")
    return BASELINES[kind]


@dataclass(frozen=True)
class DrivenExperiment(IndependentExperiment):
    """A joint's model against the force of its record, at the samples that are used."""

    data: DrivenData
    noise: Noise
    shared: float  # samples that are alike
    every: int = 1  # of so many samples one counts

    @cached_property
    def scale(self) -> Scale:
        """Return the sizes of the record."""
        return Scale.of(self.data.motion, self.data.force)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Return the samples that count."""
        return np.flatnonzero(self.data.used)[::self.every]

    @cached_property
    def measurement(self) -> Measurement:
        """Return the force at the rows, those as one that lie within `shared` samples."""
        data, rows, count = self.data, self.rows, len(self.rows)
        groups, group = np.unique(data.stretch[rows], return_inverse=True)
        alike = max(1.0, self.shared / self.every)
        modes = [one[rows] for one in (self.noise.bias, self.noise.rounded) if np.any(one[rows])]
        return Measurement.of(
            data.force[rows], np.full(count, self.noise.sd**2 * alike), channels=("force",),
            modes=np.stack(modes, axis=1) if modes else np.zeros((count, 0)), repeatable=np.full(count, 1.0 / alike),
            phase=2.0 * data.phase[rows] % 1.0, group=group, groups=tuple(f"stretch {k + 1}" for k in groups))

    @property
    def modulations(self) -> Array:
        """Return waves over the phase, which goes round once in each stroke: other forms too are alike in both."""
        return harmonics(self.measurement.phase, MODULATING)

    def choice(self, effect: str) -> float:
        """Return that each effect has one law here."""
        return 0.0

    def candidates(self) -> tuple[str, ...]:
        """Return the effects that can act on such a record; those that act by rates need a time axis."""
        return tuple(name for name, kind in catalogue().items() if self.data.kind in kind.kinds
                     and (self.data.timed or not kind.needs_time))

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of the baseline and the effects, their ranges at the size of the record."""
        parts: dict[str, type[Section]] = {"": baseline_of(self.data.kind), **{
            name: catalogue()[name] for name in sorted(effects)}}
        own = [self._coordinate(part, name, section, prior, signs or {}) for part, section in parts.items()
               for name, prior in declared_priors(section).items() if not (prior.rig_only or prior.held)]
        return Parameters(tuple(sorted(effects)), tuple(own), dict(signs or {}))

    def _coordinate(self, part: str, field: str, section: type[Section], stated: Prior, signs: Mapping[str, float]
                    ) -> Coordinate:
        unit, (lowest, highest) = unit_of(section, field), parameter_limits(section, field)
        prior = stated if is_own(section) else self.scale.prior(stated, unit)
        by_factor = prior.logarithmic or (prior.low > 0.0 and any(similarity(unit)))  # as is what similarity tells
        sign = signs.get(f"{part}.{field}", 1.0) if lowest < 0.0 <= prior.low else 1.0
        return Coordinate.within(part, field, prior.low, prior.high, by_factor, lowest, highest, sign)

    def joint(self, point: Point) -> DrivenJoint:
        """Return the joint of a hypothesis."""
        values = point.parameters.values(point.z)
        effects = []
        for name in sorted(set(point.parameters.effects) - point.neutral):
            kind = catalogue()[name]
            held = {field: getattr(kind(), field) * (1.0 if is_own(kind) else self.scale.factor(unit_of(kind, field)))
                    for field, prior in declared_priors(kind).items() if prior.held}
            effects.append(kind().changed(**held, **values[name]))
        return DrivenJoint.build(baseline_of(self.data.kind)().model_copy(update=values[""]), effects)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the force that the measured motion makes in the joint."""
        return Prediction(point, (self.joint(point).predict(self.data.motion).measured + self.noise.rounded)[self.rows])

    def force(self, fit: Fit) -> Array:
        """Return the force (N,) that a fit predicts over the whole record."""
        return self.joint(fit.prediction.point).predict(self.data.motion).measured + self.noise.rounded

    def described(self, coordinate: Coordinate) -> tuple[str, str]:
        """Return the unit and the meaning of a parameter."""
        if coordinate.effect:
            return described(coordinate.effect, coordinate.field)
        section = baseline_of(self.data.kind)
        return unit_of(section, coordinate.field), section.model_fields[coordinate.field].description or ""
