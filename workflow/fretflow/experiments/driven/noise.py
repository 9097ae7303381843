"""How far repeats of a driven joint's cycles differ, and over how many samples such differences are one.

Noise comes from the differences between neighbouring cycles of equal amplitude, at equal phase, of what the fitted
baseline leaves: what the model lacks is alike in both and cancels, as does what the motions differ by. Without such
cycles it is the white noise of the force channel, and what the noise of the motion makes of it in the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.records import Array
from fretflow.effects.driven import DrivenJoint
from fretflow.experiments.driven.data import Cycle, DrivenData, Mask
from fretflow.experiments.independent import FREEDOM
from fretflow.recordings.readings import SEED
from fretflow.structure.motion import measure, noise_floor


@dataclass(frozen=True)
class Noise:
    """Noise of one sample of the force."""

    sd: float  # N
    correlation: float  # samples that count as one in a mean
    source: str
    freedom: float  # independent squares that the sd rests on
    bias: Array  # (N,) N: what the noise of the motion may add to all cycles alike
    rounded: Array  # (N,) N: what all cycles have of the motion's corners, before they were smoothed


def correlation_length(sequences: tuple[Array, ...]) -> float:
    """Return ``1 + 2 sum rho``, up to where a pair of correlations turns negative (Geyer, Stat. Sci. 7, 1992).

    Lags of which a sequence has fewer than `FREEDOM` are not looked at: what so few pairs show is mostly chance.
    """
    power = sum(float(one @ one) for one in sequences)
    if not power > 0.0:
        return 1.0
    total, longest = 1.0, min(len(one) for one in sequences) // FREEDOM
    for lag in range(1, max(longest, 1), 2):
        pair = sum(float(one[k:] @ one[:-k]) * len(one) / (len(one) - k) for one in sequences for k in (lag, lag + 1)
                   ) / power
        if pair <= 0.0:
            break
        total += 2.0 * pair
    return max(total, 1.0)


def measured_noise(data: DrivenData, joint: DrivenJoint) -> Noise:
    """Return the noise of a recording whose baseline is fitted."""
    bias, rounded, spread = _of_motion(data, joint)
    if data.repeats:
        left = data.whole_force - joint.predict(data.whole).measured
        pairs = tuple(_difference(left, a, b) for a, b in data.repeats)
        variance = float(np.mean(np.concatenate(pairs)**2))
        length = max(1.0, correlation_length(pairs) / data.every)
        source = "neighbouring cycles of equal amplitude" if data.every > 1 or len(data.cycles) > 1 else "repeats"
        freedom = sum(len(one) for one in pairs) / (data.every * length)
    else:
        variance, length = noise_floor(data.whole_force)**2 + spread**2, 1.0
        freedom, source = float(len(data.force)), "the noise within the record, as no cycles repeat"
    sd = float(np.sqrt(variance + _step(data.whole_force)**2 / 12.0))
    return Noise(sd, length, source, max(freedom, 2.0), bias, rounded)


def _common(data: DrivenData, values: Array) -> Array:
    """Return values (N,) as all cycles have them in common at each phase, what is noise in them averaged away."""
    common, every = np.zeros_like(values), [data.samples_of(one) for one in data.cycles]
    phases = [data.phases_of(one) for one in data.cycles]
    for own, at in zip(every, phases, strict=True):
        common[own] = np.mean([np.interp(at, phase, values[one], period=1.0)
                               for one, phase in zip(every, phases, strict=True)], axis=0)
    return common if data.cycles else values


def white_noise(data: DrivenData) -> Noise:
    """Return the white noise of the force channel, to begin with."""
    sd = float(np.hypot(noise_floor(data.whole_force), _step(data.whole_force) / np.sqrt(12.0)))
    return Noise(sd, 1.0, "the force channel", float(len(data.force)), *np.zeros((2, len(data.force))))


def _step(values: Array) -> float:
    """Return the step of a digitised channel: the least difference of its values, or of numbers that the file rounds.

    Rounding has the standard deviation of an even distribution over a step.
    """
    steps = np.diff(np.unique(values))
    return float(max(steps.min(initial=np.inf), np.finfo(np.float32).eps * np.ptp(values))) if len(steps) else 0.0


def _difference(values: Array, a: Cycle, b: Cycle) -> Array:
    n = min(a.stop - a.start, b.stop - b.start)
    at = np.arange(n) / n
    first, second = (values[np.minimum(one.start + np.rint(at * (one.stop - one.start)).astype(int), one.stop - 1)]
                     for one in (a, b))
    return np.asarray((first - second) / np.sqrt(2.0))


def _of_motion(data: DrivenData, joint: DrivenJoint) -> tuple[Array, Array, float]:
    """Return what noise in the motion, and smoothing it, change of the predicted force, (N,), and its deviation, N."""
    if not data.displacement_noise > 0.0:
        return *np.zeros((2, len(data.force))), 0.0
    rng, n = np.random.default_rng(SEED), len(data.whole.displacement)
    plain = joint.predict(data.whole).measured[::data.every]
    changes = []
    for _ in range(FREEDOM + 1):
        noise = measure(data.displacement_noise * rng.standard_normal(n), data.whole.step, data.half_width).motion
        moved = replace(data.whole, **{name: getattr(data.whole, name) + getattr(noise, name) for name in (
            "displacement", "velocity", "acceleration")})
        changes.append(joint.predict(moved).measured[::data.every] - plain)
    drawn = np.array(changes)
    rounded = joint.predict(replace(data.whole, displacement=data.unsmoothed)).measured[::data.every] - plain
    deviation = float(np.sqrt(np.mean(drawn[:, data.used].var(axis=0, ddof=1))))
    return drawn.mean(axis=0), _common(data, rounded), deviation


def effective(left: Array, used: Mask) -> float:
    """Return how many independent samples there are in residuals (N,) where `used`."""
    centred = tuple(run - left[used].mean() for run in _runs(left, used)) or (left[used],)
    return float(used.sum()) / correlation_length(centred)


def _runs(left: Array, used: Mask) -> list[Array]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], used, [False]])))
    return [left[a:b] for a, b in edges.reshape(-1, 2) if b - a > 2 * FREEDOM]
