"""A period of quasi-static frictional contact marched with its tangent, compiled; see `contact_kernel`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fretflow.contact.kernels.sample import (
    STICK,
    Array,
    Contact,
    Factor,
    Marched,
    alike,
    copy_sample,
    find_in_parts,
    total,
)
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.compiled import compiled, multiply

MAX_EXTRAPOLATION = 2.0
SAME_TANGENT = 1e-4  # relative; far from the accuracy that Newton needs of a tangent


class Course(NamedTuple):
    """What a period is under: arm position, load and friction's factor (N,), and their derivatives (N, p)."""

    arm: Array
    load: Array
    grip: Array
    directions: Array
    load_slope: Array
    grip_slope: Array


@compiled
def _guess(guess: Marched, sample: Marched, j: int, arm: Array, before: Marched, b: int, earlier: Marched, e: int
           ) -> None:
    """Put a guess into sample j: the neighbouring period's, moved as the sample before was, or from that one."""
    if len(guess.approach):
        away = (j - 1) % len(guess.approach)
        copy_sample(guess, j, sample, j)
        _shift(sample, j, before, b, guess, away, 1.0)
        return
    copy_sample(before, b, sample, j)
    last = arm[j - 1] - arm[j - 2]
    if last != 0.0 and alike(before.state[b], earlier.state[e]):
        ratio = (arm[j] - arm[j - 1]) / last
        if abs(ratio) < MAX_EXTRAPOLATION:
            _shift(sample, j, before, b, earlier, e, ratio)


@compiled
def _shift(sample: Marched, j: int, toward: Marched, b: int, away: Marched, a: int, ratio: float) -> None:
    """Move sample j by `ratio` times the way from sample a of `away` to sample b of `toward`."""
    for i in range(sample.displacement.shape[1]):
        sample.displacement[j, i] += ratio * (toward.displacement[b, i] - away.displacement[a, i])
    sample.approach[j] += ratio * (toward.approach[b] - away.approach[a])


@compiled
def _as_before(found: Marched, last: Marched, j: int, limit: float) -> bool:
    """Tell whether all slides at sample j and its forces are the last period's."""
    for i in range(found.state.shape[1]):
        if found.state[j, i] == STICK:
            return False
    for i in range(found.force.shape[1]):
        if not abs(found.force[j, i] - last.force[j, i]) < limit:
            return False
    return True


@compiled
def _alike(a: Array, b: Array) -> bool:
    """Tell whether two rows of tangents are the same."""
    size, away = 0.0, 0.0
    for k in range(len(a)):
        size, away = max(size, abs(b[k])), max(away, abs(a[k] - b[k]))
    return away <= SAME_TANGENT * size


@compiled
def march(c: Contact, factors: tuple[Factor, Factor], course: Course, start: Marched, slope: Array, guess: Marched,
          last: Marched, last_tangent: Array, limits: tuple[float, float], found: Marched, tangent: Array
          ) -> tuple[int, Array]:
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
        A neighbouring period, and the one marched before with its tangent (N, p); empty if there is none.
    limits
        Tolerance of a sample's residual, and change of force below which two samples are the same, N.
    found, tangent
        Results: the period, and the tangent (N, p) of the friction force.

    Returns
    -------
    int, (3 n, p)
        The sample j that is as in the `last` period with nothing remembered, the rest is taken from there; N if
        there is none, -1 - j if sample j was not found. The derivative of the last sample marched.
    """
    samples, n = found.state.shape
    p = course.directions.shape[1]
    none, unpressed = np.empty((0, p)), np.empty((0, p))
    moved, approach, widened, force = np.empty((3 * n, p)), np.empty(p), np.empty((n, p)), np.empty((1, p))
    along, lift = total(c.along, 0) - total(c.along, n), total(c.lift, 0) - total(c.lift, n)
    slope = slope.copy()
    before, b, earlier, e = start, 0, start, 0
    for j in range(samples):
        _guess(guess, found, j, course.arm, before, b, earlier, e)
        previous, grip = before.displacement[b], course.grip[j]
        under = (course.arm[j], course.load[j], grip)
        if not find_in_parts(c, factors[0], under, course.arm[j - 1], previous, found, j, limits[0]):
            return -1 - j, slope
        if p:
            for i in range(n):
                for k in range(p):
                    widened[i, k] = c.friction[i] * course.grip_slope[j, k]
            change = (course.directions[j], course.load_slope[j], widened, none)
            differentiate(c, factors[1], grip, previous, found, j, slope, change, moved, approach, unpressed)
            slope, moved = moved, slope
            multiply(c.along.reshape(1, -1), slope, force)
            for k in range(p):
                tangent[j, k] = force[0, k] - along * course.directions[j, k] - lift * approach[k]
        earlier, e, before, b = before, b, found, j
        # where everything slides nothing is remembered, once the directions of sliding have been forgotten
        if len(last.approach) and _as_before(found, last, j, limits[1]) and _alike(tangent[j], last_tangent[j]):
            for rest in range(j + 1, samples):
                copy_sample(last, rest, found, rest)
                for k in range(p):
                    tangent[rest, k] = last_tangent[rest, k]
            return j, slope
    return samples, slope
