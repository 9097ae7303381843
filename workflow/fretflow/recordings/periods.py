"""Periodic signals as they are recorded: their period, phase, drift, noise and resampling; pure functions.

Time is counted in turns (periods) here.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import stats
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d, uniform_filter1d

from fretflow.core.records import Array

SHORTEST = 16  # samples a period
HYSTERESIS = 0.1  # of half the range: what a signal must pass beyond its middle to have crossed it
SMOOTHED_SHARE = 1.0 / 64.0  # of a period: half-width of the smoothing
EDGE_SHARE = 0.05  # of a period: what the ends of a record are extrapolated from
NEAR_ENDS = 4  # times that: how far from the ends the same is tried where nothing jumps
SIGMA_OF_MAD = 1.4826
AROUND = 5  # samples: spikes of one or two stand out of their median
FEW = 5e-4  # of the samples, at least two, that may be spikes
ABOVE_OWN = 4.0  # times the largest peak of the signal's own
RARE = 0.02  # of the samples on either side, which do not count as its range
FEW_GROSS = 4e-3  # of the samples may begin a spike far off it: own peaks come back in every period, of 200 samples say
BESIDE = 0.25  # of the range: what may be beyond it next to a spike, by noise
SPIKE = 0.02  # of the range
ROUGH_FREEDOM = SHORTEST / 2.31  # of `roughness` of white noise: 1 + 2 (225 + 36 + 1) / 400, as differences correlate
TIED = 0.02  # of a channel's samples at one extreme value: with noise, a wave of 25 samples or more has one or two
NOISY = 0.3  # of the third differences that change sign
LEVEL = 1e-3  # of tests of a channel: a thousand recordings without a fault let one be told


def fundamental(turns: Array, values: Array) -> complex:
    """Return C of ``a0 + Re(C exp(-2 pi i turns))`` by least squares; turns and values (n,)."""
    angle = 2.0 * np.pi * turns
    basis = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    _, cosine, sine = np.linalg.solve(basis.T @ basis, basis.T @ values)
    return complex(cosine, sine)


def turn_of_maximum(turns: Array, values: Array) -> float:
    """Return where in [0, 1) the fundamental of a signal is largest."""
    return float(np.angle(fundamental(turns, values)) / (2.0 * np.pi) % 1.0)


@cache
def smoothing_kernel(half_width: int) -> Array:
    """Return the weights (2 m + 1,) of the least-squares parabola's middle over 2 m + 1 samples.

    ``h_j = 3 (3 m^2 + 3 m - 1 - 5 j^2) / ((2 m - 1) (2 m + 1) (2 m + 3))`` (Savitzky and Golay, Anal. Chem. 36,
    1627, 1964). Where a signal is a parabola over the window, as within a stick or a plateau, it is left as it is.
    A kink that changes the slope by s a sample shifts only the samples closer than m, the kink itself by
    ``s m (m + 1) (m + 2) (m - 1) c / 4`` with ``c = 3 / ((2 m - 1) (2 m + 1) (2 m + 3))``, about 3/32 of s m.
    """
    m, j = half_width, np.arange(-half_width, half_width + 1)
    if m < 2:
        return np.ones(1)
    return np.asarray(3.0 * (3 * m * m + 3 * m - 1 - 5 * j * j) / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3)))


def smoothed(values: Array, half_width: int | None = None) -> Array:
    """Return periodic signals (..., N) smoothed by local parabolas, by default over 1/32 of a period."""
    if half_width is None:
        half_width = round(SMOOTHED_SHARE * values.shape[-1])
    kernel = smoothing_kernel(half_width)
    return np.asarray(convolve1d(values, kernel, axis=-1, mode="wrap"))


def smoothed_record(values: Array) -> Array:
    """Return a record (T,) that does not repeat, smoothed by local parabolas over seven samples."""
    return np.asarray(convolve1d(values, smoothing_kernel(3), mode="nearest"))


def noise_sd(values: Array) -> Array:
    """Return the standard deviation of the white noise on periodic signals (..., N), by third differences.

    These vanish on a parabola and have 20 times the variance of the noise. Those above three deviations by their
    median are left out, so that kinks and jumps do not count; of a normal deviate that leaves 0.9733 of the variance.
    """
    rest = convolve1d(values, np.array([1.0, -3.0, 3.0, -1.0]) / np.sqrt(20.0), axis=-1, mode="wrap") ** 2
    limit = (3.0 * SIGMA_OF_MAD) ** 2 * np.median(rest, axis=-1, keepdims=True)
    inside = rest <= limit
    return np.asarray(np.sqrt(np.sum(rest * inside, axis=-1) / np.sum(inside, axis=-1) / 0.9733))


def roughness(values: Array) -> Array:
    """Return the variance of noise on periodic signals (..., N) about each sample, by third differences around it."""
    rest = convolve1d(values, np.array([1.0, -3.0, 3.0, -1.0]) / np.sqrt(20.0), axis=-1, mode="wrap")
    return np.asarray(uniform_filter1d(rest**2, SHORTEST, axis=-1, mode="wrap"))


def spikes(values: Array, begins: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return which samples (n,) of a signal (T,), nan where there is none, are electric spikes: far off those around.

    Off the median of five (a running median keeps edges, F. R. Hampel, J. Am. Stat. Assoc. 69 (1974) 383), by more than
    a share of the range and a multiple of the signal's own peaks, which come back in every period while spikes are few.
    Beside a sample (T,) that `begins` something else, and at the ends, they are off the range. Of those off it by all
    of it again, which no friction is, more may stand, and several together.
    """
    there = np.flatnonzero(np.isfinite(values))
    gross = there[_off_range(values[there])]
    there = np.setdiff1d(there, gross, assume_unique=True)
    half = AROUND // 2
    if len(there) < 4 * AROUND:
        return gross
    known = values[there]
    few = max(2, round(FEW * len(known)))
    low, high = np.partition(known, [few, len(known) - few - 1])[[few, len(known) - few - 1]]
    off = np.maximum(np.maximum(low - known, known - high), 0.0)
    apart = np.convolve(begins[there], np.ones(2 * half), mode="full")[half:half + len(known)] > 0.0
    inner = ~apart[half:-half]
    off[half:-half][inner] = np.abs(known[half:-half] - np.median(sliding_window_view(known, AROUND), axis=1))[inner]
    own = float(np.partition(off, len(off) - few - 1)[len(off) - few - 1])
    return np.union1d(gross, there[off > max(ABOVE_OWN * own, SPIKE * (high - low))])


def _off_range(known: Array) -> NDArray[np.bool_]:
    """Return which samples of a signal (T,) are beyond the range of nearly all by that range, and briefly so.

    They leave and come back within a sample, and are fewer than half a period of the fewest samples, as a plateau has.
    """
    if not len(known):
        return np.zeros(0, dtype=bool)
    low, high = np.quantile(known, [RARE, 1.0 - RARE])
    away = np.pad(np.maximum(low - known, known - high), 1, constant_values=-1.0)
    off = away > high - low
    starts, ends = np.flatnonzero(np.diff(off)).reshape(-1, 2).T + 1
    sudden = np.maximum(away[starts - 1], away[ends]) <= BESIDE * (high - low)
    brief = ends - starts < SHORTEST // 2
    rare = len(starts) <= max(2, FEW_GROSS * len(known))
    off[off] = np.repeat(rare & sudden & brief, ends - starts)
    return np.asarray(off[1:-1])


def is_noisy(values: Array) -> bool:
    """Return whether third differences change sign from sample to sample: 77 % do in noise, few on a smooth curve."""
    rest = np.diff(values[np.isfinite(values)], 3)
    return len(rest) > 1 and float(np.mean(rest[1:] * rest[:-1] < 0.0)) > NOISY


def standing_still(values: Array) -> NDArray[np.bool_]:
    """Return which samples of a signal (of any shape), nan where there is none, stand still at an extreme value.

    Of the crest of a smooth signal that is read in steps, 1 / sqrt(2) of the samples of its last two steps are in the
    last one at the most, as it is a parabola; noise leaves fewer. More are a sensor's limit, by a binomial test, where
    they are more than a smooth signal without steps has.
    """
    still = np.zeros(values.shape, dtype=bool)
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < 3:
        return still
    step = np.median(np.diff(levels))
    for end in (0, -1):
        near = counts[np.abs(levels - levels[end]) < 1.5 * step].sum()
        if counts[end] > TIED * counts.sum() and stats.binom.sf(counts[end] - 1, near, np.sqrt(0.5)) < LEVEL:
            still |= values == levels[end]
    return still


def upward_crossings(values: Array) -> Array:
    """Return where (n,), in samples, a signal passes its middle upwards, each time having been well below it."""
    middle, half = 0.5 * (values.max() + values.min()), 0.5 * np.ptp(values)
    side = np.where(values > middle + HYSTERESIS * half, 1, np.where(values < middle - HYSTERESIS * half, -1, 0))
    decided = np.flatnonzero(side)
    turns = np.flatnonzero((side[decided][:-1] < 0) & (side[decided][1:] > 0))
    crossings = []
    for before, after in zip(decided[turns], decided[turns + 1], strict=True):
        k = before + int(np.flatnonzero(values[before:after + 1] <= middle)[-1])
        crossings.append(k + (middle - values[k]) / (values[k + 1] - values[k]))
    return np.array(crossings)


def without_trend(values: Array, period: int) -> Array:
    """Return a signal (T,) without its moving mean over `period` samples; the ends take the nearest mean."""
    if period < 2 or len(values) < 2 * period:
        return np.asarray(values - values.mean())
    total = np.r_[0.0, np.cumsum(values - values.mean())]
    mean = (total[period:] - total[:-period]) / period
    before = (len(values) - len(mean)) // 2
    padded = np.r_[np.full(before, mean[0]), mean, np.full(len(values) - len(mean) - before, mean[-1])]
    return np.asarray(values - values.mean() - padded)


def period_means(turns: Array, values: Array, periods: int) -> Array:
    """Return the mean of each period (P,) of a record (n,), by the trapezoidal rule from one whole turn to the next."""
    start = float(turns[0])
    end = np.interp(start + periods - 1, turns, values)
    turns, values = np.r_[turns, start + periods], np.r_[values, end]
    integral = np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(turns))]
    return np.diff(np.interp(start + np.arange(periods + 1), turns, integral))


def closure_jump(turns: Array, values: Array, interval: float) -> tuple[Array, Array, Array]:
    """Return jumps (C,) from the end of one period (C, n) to its start, their errors, and the largest within it.

    The errors are standard deviations; within the period there is no jump. Of the sum of both halves of the period, if
    their samples are even in number: in it odd harmonics cancel, the flanks of a loop and what rings after them, and a
    drift does not. Its ends are extrapolated by parabolas to their middle, `interval` turns apart. The deviation holds
    what the samples scatter, half of what cubics would make of the jump instead, and the mean square of the jumps that
    the same parabolas see beside the ends.
    """
    half, rest = divmod(len(turns), 2)
    if not rest:
        turns, values = turns[:half], values[:, :half] + values[:, half:]
    m = max(8, round(EDGE_SHARE * len(turns)))
    jumps, variances = [], []
    for degree in (2, 3):
        start, first = _extrapolated(turns[:m] - turns[0] + 0.5 * interval, values[:, :m], degree)
        end, last = _extrapolated(turns[-m:] - turns[-1] - 0.5 * interval, values[:, -m:], degree)
        jumps.append(end - start)
        variances.append(first + last)
    cuts = np.arange(m, len(turns) - m + 1, m // 4)
    if not len(cuts):
        return jumps[0], np.full(len(values), np.inf), np.zeros(len(values))
    within = np.array([_jump_at(turns, values, cut, m) for cut in cuts])
    beside = np.minimum(cuts, len(turns) - cuts) < NEAR_ENDS * m
    deviation = np.sqrt(variances[0] + 0.25 * (jumps[0] - jumps[1]) ** 2 + np.mean(within[beside] ** 2, axis=0))
    return jumps[0], deviation, np.abs(within).max(axis=0)


def _jump_at(turns: Array, values: Array, cut: int, m: int) -> Array:
    """Return the jumps (C,) from what m samples before the sample `cut` make of the middle there to what m after do."""
    middle = 0.5 * (turns[cut - 1] + turns[cut])
    before, after = slice(cut - m, cut), slice(cut, cut + m)
    end, start = (_extrapolated(turns[own] - middle, values[:, own], 2)[0] for own in (before, after))
    return np.asarray(end - start)


def _extrapolated(turns: Array, values: Array, degree: int) -> tuple[Array, Array]:
    """Fit polynomials to values (C, m) at turns (m,); return what they are at zero (C,), and the variances of that."""
    basis = np.vander(turns / np.abs(turns).max(), degree + 1, increasing=True)
    inverse = np.linalg.inv(basis.T @ basis)
    coefficients = values @ basis @ inverse
    variance = np.sum((values - coefficients @ basis.T) ** 2, axis=1) / max(1, len(turns) - degree - 1)
    return coefficients[:, 0], variance * inverse[0, 0]


def resampled(turns: Array, values: Array, periods: int, at: Array, evenly: bool) -> Array:
    """Return signals (C, n) at `turns` (n,), which repeat after `periods` turns, at the turns `at` (m,).

    Even samples by a periodic cubic spline, which keeps the noise nearly white; uneven ones by straight lines,
    which cannot overshoot between two that are close.
    """
    wrapped = turns[0] + (at - turns[0]) % periods
    closed, whole = np.append(turns, turns[0] + periods), np.append(values, values[:, :1], axis=1)
    if evenly:
        return np.asarray(CubicSpline(closed, whole, axis=1, bc_type="periodic")(wrapped))
    return np.array([np.interp(wrapped, closed, channel) for channel in whole])


def cycle_cuts(values: Array) -> Array:
    """Return where (n,), in samples, the cycles of a record (T,) begin and the last ends: as it rises, or else falls.

    Of a record that rises through its middle less than twice the falls may still bound a cycle.
    """
    rough = np.zeros(0)
    for own in (values, -values):
        rough = upward_crossings(smoothed_record(own))
        if len(rough) > 1:
            return upward_crossings(without_trend(own, round(float(np.median(np.diff(rough))))))
    return rough
