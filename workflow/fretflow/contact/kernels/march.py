"""A period of quasi-static frictional contact marched with its tangent, compiled; see `contact.kernels.sample`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fretflow.contact.kernels.sample import STICK, Contact, Factor, PeriodHistory, alike, copy_sample, find_in_parts
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.compiled import compiled, multiply
from fretflow.core.records import Array

MAX_EXTRAPOLATION = 2.0
SAME_TANGENT = 1e-4  # relative; far from the accuracy that Newton needs of a tangent


class Forcing(NamedTuple):
    """What a period is under: the pull ``R q + P i`` (N, 3 n) and the factor on friction (N,).

    Derivatives by p parameters: `directions` (N, d, p) of the coordinates, `factor_slope` (N, p).
    """

    pull: Array
    friction_factor: Array
    directions: Array
    factor_slope: Array


@compiled
def guess_sample(guess: PeriodHistory, sample: PeriodHistory, j: int, pull: Array, before: PeriodHistory, b: int,
           earlier: PeriodHistory, e: int) -> None:
    """Put a guess into sample j: the neighbouring period's, moved as the sample before was, or from that one."""
    if len(guess.state):
        away = (j - 1) % len(guess.state)
        copy_sample(guess, j, sample, j)
        _shift(sample, j, before, b, guess, away, 1.0)
        return
    copy_sample(before, b, sample, j)
    along, size = 0.0, 0.0
    for i in range(pull.shape[1]):
        last = pull[j - 1, i] - pull[j - 2, i]
        along += last * (pull[j, i] - pull[j - 1, i])
        size += last * last
    if size != 0.0 and alike(before.state[b], earlier.state[e]):
        ratio = along / size
        if abs(ratio) < MAX_EXTRAPOLATION:
            _shift(sample, j, before, b, earlier, e, ratio)


@compiled
def _shift(sample: PeriodHistory, j: int, toward: PeriodHistory, b: int, away: PeriodHistory, a: int, ratio: float
           ) -> None:
    """Move sample j by `ratio` times the way from sample a of `away` to sample b of `toward`."""
    for i in range(sample.displacement.shape[1]):
        sample.displacement[j, i] += ratio * (toward.displacement[b, i] - away.displacement[a, i])


@compiled
def as_before(period: PeriodHistory, last: PeriodHistory, j: int, limit: float) -> bool:
    """Tell whether all slides at sample j and its forces are the last period's."""
    for i in range(period.state.shape[1]):
        if period.state[j, i] == STICK:
            return False
    for i in range(period.force.shape[1]):
        if not abs(period.force[j, i] - last.force[j, i]) < limit:
            return False
    return True


@compiled
def _same(a: Array, b: Array) -> bool:
    """Tell whether two tangents (d, p) are the same."""
    size, away = 0.0, 0.0
    for i in range(len(a)):
        for k in range(a.shape[1]):
            size, away = max(size, abs(b[i, k])), max(away, abs(a[i, k] - b[i, k]))
    return away <= SAME_TANGENT * size


@compiled
def _copy(source: Array, target: Array) -> None:
    """Copy a tangent; an assignment of arrays takes seconds to compile."""
    for i in range(len(source)):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@compiled
def march(c: Contact, factors: tuple[Factor, Factor], forcing: Forcing, start: PeriodHistory, slope: Array,
          guess: PeriodHistory, last: PeriodHistory, last_tangent: Array, limits: tuple[float, float],
          period: PeriodHistory, tangent: Array) -> tuple[int, Array]:
    """March one period of N samples with its tangent.

    Parameters
    ----------
    factors
        For the samples, and for their derivatives.
    start
        The sample before the first one, alone.
    slope : (3 n, p)
        Its derivative.
    guess, last
        A neighbouring period, and the one marched before with its tangent (N, d, p); empty if there is none.
    limits
        Tolerance of a sample's residual, and change of force below which two samples are the same, N.
    period, tangent
        Results: the period, and the tangent (N, d, p) of the force T f on the coordinates.

    Returns
    -------
    int, (3 n, p)
        The sample j that is as in the `last` period with nothing remembered, the rest is taken from there; N if
        there is none, -1 - j if sample j was not found. The derivative of the last sample marched.
    """
    samples, n = period.state.shape
    d, p = forcing.directions.shape[1:]
    none, unpressed = np.empty((0, p)), np.empty((0, p))
    moved, widened, direct = np.empty((3 * n, p)), np.empty((n, p)), np.empty((d, p))
    slope = slope.copy()
    before, b, earlier, e = start, 0, start, 0
    for j in range(samples):
        guess_sample(guess, period, j, forcing.pull, before, b, earlier, e)
        previous, factor = before.displacement[b], forcing.friction_factor[j]
        pulls = (forcing.pull[j - 1], forcing.pull[j])
        if not find_in_parts(c, factors[0], pulls, factor, previous, period, j, limits[0]):
            return -1 - j, slope
        if p:
            for i in range(n):
                for k in range(p):
                    widened[i, k] = c.friction[i] * forcing.factor_slope[j, k]
            change = (forcing.directions[j], widened, none)
            differentiate(c, factors[1], factor, previous, period, j, slope, change, moved, unpressed)
            slope, moved = moved, slope
            multiply(c.felt, slope, tangent[j])
            multiply(c.felt_coupling, forcing.directions[j], direct)
            for i in range(d):
                for k in range(p):
                    tangent[j, i, k] -= direct[i, k]
        earlier, e, before, b = before, b, period, j
        # where everything slides nothing is remembered, once the directions of sliding have been forgotten
        if len(last.state) and as_before(period, last, j, limits[1]) and _same(tangent[j], last_tangent[j]):
            for rest in range(j + 1, samples):
                copy_sample(last, rest, period, rest)
                _copy(last_tangent[rest], tangent[rest])
            return j, slope
    return samples, slope
