"""How far repeats of a driven joint's cycles differ, and over how many samples such differences are one.

Noise comes from the differences between neighbouring cycles of equal amplitude, at equal phase, of what the fitted
baseline leaves: what the model lacks is alike in both and cancels, as does what the motions differ by. Without such
cycles it is the white noise of the force channel, and what the noise of the motion makes of it in the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from fretflow.effects.driven import DrivenJoint
from fretflow.experiments.driven.data import Array, Cycle, DrivenData, Mask
from fretflow.structure.motion import measure, noise_floor

DIGITIZING = 1e-3  # of half the range: what no sensor and no step of the model resolves
LONGEST = 8  # part of a sequence beyond which correlations are not looked at
SEED = 20240
BLOCKS = 24  # least number that correlations are told from
DRAWS = 400
BIAS_FACTOR = 2.0  # on biases that are known roughly
MOTIONS = 6  # drawn, with noise
RATES = ("displacement", "velocity", "acceleration")


@dataclass(frozen=True)
class Noise:
    """Noise of one sample of the force; `sequences` of it, normalised, thinned as fits are."""

    sd: float  # N
    sequences: tuple[Array, ...]
    correlation: float  # samples that count as one in a mean
    source: str
    biases: tuple[Array, ...]  # (N,) N: what the noise of the motion, and its smoothing, may add to all cycles alike
    freedom: float  # independent squares that the sd rests on


def correlation_length(sequences: tuple[Array, ...]) -> float:
    """Return ``1 + 2 sum rho``, up to where a pair of correlations turns negative (Geyer, Stat. Sci. 7, 1992)."""
    power = sum(float(one @ one) for one in sequences)
    if not power > 0.0:
        return 1.0
    total, longest = 1.0, min(len(one) for one in sequences) // LONGEST
    for lag in range(1, max(longest, 1), 2):
        pair = sum(float(one[k:] @ one[:-k]) * len(one) / (len(one) - k) for one in sequences for k in (lag, lag + 1)
                   ) / power
        if pair <= 0.0:
            break
        total += 2.0 * pair
    return max(total, 1.0)


def measured_noise(data: DrivenData, joint: DrivenJoint) -> Noise:
    """Return the noise of a recording whose baseline is fitted."""
    biases, spread = _of_motion(data, joint)
    least = DIGITIZING * 0.5 * float(np.ptp(data.force[data.used]))
    if data.repeats:
        left = data.whole_force - joint.predict(data.whole).measured
        pairs = [_difference(left, a, b) for a, b in data.repeats]
        variance = float(np.mean(np.concatenate(pairs)**2))
        length = correlation_length(tuple(pairs)) / data.every
        sequences = tuple(one[::data.every] / np.sqrt(max(variance, 1e-300)) for one in pairs)
        source = "neighbouring cycles of equal amplitude" if data.every > 1 or len(data.cycles) > 1 else "repeats"
        freedom = _freedom(sequences, max(length, 1.0))
    else:
        variance = noise_floor(data.whole_force)**2 + spread**2
        rng = np.random.default_rng(SEED)
        length, freedom = 1.0, 0.1 * len(data.whole_force)
        sequences = (rng.standard_normal(max(int(freedom), 2 * BLOCKS)),)
        source = "the noise within the record, as no cycles repeat"
    smoothing = sum(float(np.mean(one[data.used]**2)) for one in biases[1:])  # repeats have it alike
    return Noise(float(np.sqrt(variance + least**2 + smoothing)), sequences, max(length, 1.0), source, biases, freedom)


def _difference(values: Array, a: Cycle, b: Cycle) -> Array:
    n = min(a.stop - a.start, b.stop - b.start)
    at = np.arange(n) / n
    first, second = (values[np.minimum(one.start + np.rint(at * (one.stop - one.start)).astype(int), one.stop - 1)]
                     for one in (a, b))
    return np.asarray((first - second) / np.sqrt(2.0))


def _freedom(sequences: tuple[Array, ...], length: float) -> float:
    """Return twice the squared mean over the variance of the mean of the squares, from means over blocks."""
    squares = np.concatenate(sequences)**2
    size = max(1, min(int(3.0 * length), len(squares) // BLOCKS))
    blocks = squares[:len(squares) // size * size].reshape(-1, size).mean(axis=1)
    spread = float(np.var(blocks, ddof=1)) / len(blocks)
    return float(np.clip(2.0 * np.mean(blocks)**2 / max(spread, 1e-300), 2.0, len(squares)))


def _of_motion(data: DrivenData, joint: DrivenJoint) -> tuple[tuple[Array, ...], float]:
    """Return what noise in the motion, and smoothing it, change of the predicted force, (N,), and its deviation, N."""
    if not data.displacement_noise > 0.0:
        return (), 0.0
    rng, n = np.random.default_rng(SEED), len(data.whole.displacement)
    plain = joint.predict(data.whole).measured[::data.every]
    changes = []
    for _ in range(MOTIONS):
        noise = measure(data.displacement_noise * rng.standard_normal(n), data.whole.step, data.half_width).motion
        moved = replace(data.whole, **{name: getattr(data.whole, name) + getattr(noise, name) for name in RATES})
        changes.append(joint.predict(moved).measured[::data.every] - plain)
    found = np.array(changes)
    rounded = joint.predict(replace(data.whole, displacement=data.unsmoothed)).measured[::data.every] - plain
    return (found.mean(axis=0), rounded), float(np.sqrt(np.mean(found[:, data.used].var(axis=0, ddof=1))))


def effective(left: Array, used: Mask) -> float:
    """Return how many independent samples there are in residuals (N,) where `used`."""
    centred = tuple(run - left[used].mean() for run in _runs(left, used)) or (left[used],)
    return float(used.sum()) / correlation_length(centred)


def _runs(left: Array, used: Mask) -> list[Array]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], used, [False]])))
    return [left[a:b] for a, b in edges.reshape(-1, 2) if b - a > 2 * LONGEST]


def mean_square_p(noise: Noise, left: Array) -> float:
    """Return how probable it is that noise alone has the mean square of residuals (n,).

    Its distribution is that of blocks drawn from the noise, over that of as many as the sd rests on; beyond the draws
    it is Fisher's with as many degrees of freedom.
    """
    ratio = float(np.mean(left**2)) / noise.sd**2
    rng = np.random.default_rng(SEED)
    pool = np.concatenate(noise.sequences)
    size = max(1, min(int(3.0 * noise.correlation), len(pool) // BLOCKS))
    blocks = pool[:len(pool) // size * size].reshape(-1, size)
    squares = np.mean(blocks**2, axis=1)
    own, rest = max(1, len(left) // size), len(squares)
    top, bottom = (squares[rng.integers(0, rest, (DRAWS, n))].mean(axis=1) for n in (own, rest))
    above = int(np.sum(top / bottom >= ratio))
    share = own * size / len(pool)
    tail = float(stats.f.sf(ratio, max(share * noise.freedom, 1.0), noise.freedom))
    return max(tail, (above + 1.0) / (DRAWS + 1.0)) if above else min(tail, 1.0 / (DRAWS + 1.0))


def harmonic_p(noise: Noise, data: DrivenData, left: Array, harmonics: int) -> float:
    """Return how probable it is that noise alone has the largest harmonic of the cycles' mean residual (N,)."""
    sums, count = np.zeros(harmonics + 1, complex), 0
    biases = [np.zeros(harmonics + 1, complex) for _ in noise.biases]
    for cycle in data.cycles:
        own = data.samples_of(cycle)
        kept = data.fitted[own]
        own, phase = own[kept], data.phases_of(cycle)[kept]
        waves = np.exp(-2j * np.pi * np.outer(np.arange(harmonics + 1), phase))
        sums, count = sums + waves @ left[own], count + len(own)
        biases = [total + waves @ one[own] for total, one in zip(biases, noise.biases, strict=True)]
    if not count:
        return 1.0
    least = BIAS_FACTOR * sum((np.abs(one) for one in biases), np.zeros(harmonics + 1))
    size = np.maximum(np.abs(sums) - least, 0.0)**2 / (count * noise.sd**2 * noise.correlation)
    size[1:] *= 2.0
    freedom = np.where(np.arange(harmonics + 1) == 0, 1.0, 2.0)
    p = stats.f.sf(size / freedom, freedom, noise.freedom)
    return min(1.0, float(p.min()) * (harmonics + 1))
