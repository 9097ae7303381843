"""Fits of driven joints to a measured force, at the scale of the recording.

The ranges of the effects are those of a fretting rig; a joint of another size has them by similarity: forces go with
the force amplitude F, lengths with the amplitude X of the motion, and times with X over the speed V. Delays and
frequencies of sensors stay what they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.core.units import Unit
from fretflow.effects.driven import BASELINE, Baseline, DrivenJoint, LumpedBaseline, SliderBaseline
from fretflow.effects.effect import Array, Effect, Kind, Prior
from fretflow.structure.motion import Motion

# Powers of F, X and X / V in what goes with the size of a joint.
DIMENSIONS = {"N": (1, 0, 0), "m": (0, 1, 0), "m/s": (0, 1, -1), "N/m": (1, -1, 0), "N*s/m": (1, -1, 1),
              "kg": (1, -1, 2), "m/N": (-1, 1, 0), "N/m^3": (1, -3, 0)}
TOLERANCE = 1e-6  # relative change of misfit or parameters at which to stop
FIRST_EVALUATIONS = 5  # of each start
MAX_EVALUATIONS = 60
STICK_SHARES = (0.03, 0.1, 0.3)  # elastic motion over the amplitude, to start from
PLATEAU = (10.0, 90.0)  # percentiles of the force
EFFECT_SHARES = (1.0, 0.25)  # of the way from neutral to the values at the recording's scale, to start from
REFINED = 2  # starts that a fit goes on with
SAMPLES = 2500
TINY = float(np.finfo(float).tiny)


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
        a, b, c = DIMENSIONS.get(unit, (0, 0, 0))
        return float((self.force / RIG.force)**a * (self.length / RIG.length)**b * (self.time / RIG.time)**c)


RIG = Scale(50.0, 7e-6, 1.0 / (2.0 * float(np.pi) * 100.0))


@record
class DrivenFit:
    """A joint fitted to a recording; `sd` holds where residuals are white and normal."""

    joint: DrivenJoint
    names: tuple[str, ...]
    value: Array = quantity("SI", "(P,)")
    sd: Array = quantity("SI", "(P,)")
    residual: Array = quantity("N", "(N,), measured less predicted")
    misfit: float = quantity("1")  # rms of the residual over that of the force
    misfit_of_range: float = quantity("1")  # rms of the residual over the peak-to-peak of the force


def scaled_priors(joint: DrivenJoint, scale: Scale) -> dict[str, Prior]:
    """Return the ranges of a joint's parameters at the size of a recording."""
    return {name: scale.prior(prior, parameter_unit(joint, name)) for name, prior in joint.priors.items()}


def first_baselines(kind: Kind, motion: Motion, force: Array) -> list[Baseline]:
    """Return baselines to start a fit from, read off the recording.

    Raises
    ------
    InputError
        If nothing moves, or the recording is of a fretting rig.
    """
    if kind is Kind.LUMPED:
        rates = np.column_stack([motion.acceleration, motion.velocity])
        mass, damping = np.maximum(np.linalg.lstsq(rates, force, rcond=None)[0], 0.0)
        return [LumpedBaseline.model_construct(mass=float(mass), damping=float(damping), stiffness=0.0)]
    if kind is not Kind.IMPOSED_DISPLACEMENT:
        raise InputError(f"recording of kind {kind.value}: no measured motion drives it; the full model predicts it")
    scale = Scale.of(motion, force)
    low, high = np.percentile(force, PLATEAU)
    limit = 0.5 * float(high - low) or scale.force
    return [SliderBaseline.model_construct(tangential_stiffness=limit / (share * scale.length), friction_limit=limit)
            for share in STICK_SHARES]


def first_joints(kind: Kind, effects: Iterable[Effect], motion: Motion, force: Array) -> list[DrivenJoint]:
    """Return joints to start a fit from: first baselines with `effects` at the recording's scale, and weaker ones.

    Raises
    ------
    ConfigError
        If the effects do not act in such recordings or do not work together.
    InputError
        If nothing moves, or the recording is of a fretting rig.
    """
    scale, chosen = Scale.of(motion, force), tuple(effects)
    joints = [DrivenJoint.build(baseline, chosen) for baseline in first_baselines(kind, motion, force)]
    return [_at_scale(joint, scale, share) for joint in joints for share in (EFFECT_SHARES if chosen else (1.0,))]


def prepared(kind: Kind, motion: Motion, force: Array, samples: int = SAMPLES) -> tuple[Motion, Array]:
    """Return a recording thinned to some `samples`, leaning as it begins: for fits in a fraction of a second.

    A mass is driven, so its friction leans as it moves; elsewhere the force tells.
    """
    every = max(1, -(-len(force) // samples))
    if kind is Kind.LUMPED:
        lean = float(np.sign(motion.velocity[0]))
    else:
        low, high = np.percentile(force, PLATEAU)
        lean = float(np.clip(2.0 * (force[0] - 0.5 * (low + high)) / max(high - low, TINY), -1.0, 1.0))
    return replace(motion.thinned(every), lean=lean), force[::every]


def fit(starts: Sequence[DrivenJoint], motion: Motion, force: Array, names: Sequence[str] | None = None,
        used: NDArray[np.bool_] | None = None, evaluations: int = MAX_EVALUATIONS,
        largest: Mapping[str, float] | None = None) -> DrivenFit:
    """Fit a joint to a measured force by least squares, from the best of several starts; the best end is returned.

    Parameters
    ----------
    starts : sequence of DrivenJoint
        One joint with different values.
    motion, force
        The recording; `force` is (N,) in N.
    names : sequence of str, optional
        The parameters to fit; by default all that have a range.
    used : ndarray of bool, shape (N,), optional
        The samples that count; by default all.
    evaluations : int, optional
        Of the force, at most, for each start that is gone on with.
    largest : mapping of str to float, optional
        Sizes that some parameters keep within, in SI; all keep within the limits of their fields.
    """
    free = tuple(starts[0].values if names is None else names)
    kept = np.ones(len(force), dtype=bool) if used is None else used
    ends = largest or {}
    tried = [_fit_one(joint, motion, force, free, kept, FIRST_EVALUATIONS, ends) for joint in starts]
    promising = sorted(tried, key=lambda found: found.misfit)[:REFINED]
    return min((_fit_one(found.joint, motion, force, free, kept, evaluations, ends) for found in promising),
               key=lambda found: found.misfit)


def _fit_one(joint: DrivenJoint, motion: Motion, force: Array, names: tuple[str, ...], used: NDArray[np.bool_],
             evaluations: int, largest: Mapping[str, float]) -> DrivenFit:
    values, limits = joint.values, joint.bounds
    priors = scaled_priors(joint, Scale.of(motion, force))
    reach = np.array([largest.get(name, np.inf) for name in names])
    low = np.maximum([limits[name][0] for name in names], -reach)
    high = np.minimum([limits[name][1] for name in names], reach)
    size = np.array([max(abs(values[name]), 0.01 * max(abs(priors[name].low), abs(priors[name].high)))
                     for name in names])
    strength = _rms(force[used])

    def changed(p: Array) -> DrivenJoint:
        return joint.with_values(dict(zip(names, p * size, strict=True)))

    def residual(p: Array) -> Array:
        return np.asarray((changed(p).predict(motion).measured - force)[used] / strength)

    def jacobian(p: Array) -> Array:
        return np.asarray(changed(p).derivatives(motion, names)[used] * size / strength)

    begin = np.clip(np.array([values[name] for name in names]), low, high) / size
    found = least_squares(residual, begin, jac=jacobian, bounds=(low / size, high / size), xtol=TOLERANCE,
                          ftol=TOLERANCE, gtol=TOLERANCE, max_nfev=evaluations)
    misfit = _rms(found.fun)
    spread = np.maximum(np.linalg.pinv(found.jac.T @ found.jac).diagonal(), 0.0) * misfit**2
    best = changed(found.x)
    return DrivenFit(joint=best, names=names, value=found.x * size, sd=size * np.sqrt(spread),
                     residual=force - best.predict(motion).measured, misfit=misfit,
                     misfit_of_range=misfit * strength / float(np.ptp(force[used])))


def parameter_unit(joint: DrivenJoint, name: str) -> str:
    """Return the SI unit of a parameter, nothing where it has none."""
    part, _, field = name.partition(".")
    marks = type(joint.parts[part]).model_fields[field].metadata
    return next((mark.unit for mark in marks if isinstance(mark, Unit)), "")


def _at_scale(joint: DrivenJoint, scale: Scale, share: float) -> DrivenJoint:
    """Return a joint with effects, at a recording's size, at `share` of the way from neutral to default."""
    plain = DrivenJoint(joint.baseline, tuple(effect.neutral() for effect in joint.effects)).values
    return joint.with_values({name: scale.factor(parameter_unit(joint, name))
                              * (plain[name] + share * (value - plain[name]))
                              for name, value in joint.values.items() if not name.startswith(f"{BASELINE}.")})


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
