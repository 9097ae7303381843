"""How much of a hidden effect a recording shows once the baseline's own parameters are refitted, over the noise.

The change that the effect makes is projected, in least squares weighted by the noise, onto what friction
coefficient, wear coefficient, moving mass, an offset of every loop and the gains within their calibration can absorb.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq

from fretflow_trial.campaign import Outcome, Plan, Test
from fretflow_trial.joint import Joint
from fretflow_trial.physics import Channels, Physics

Array = NDArray[np.float64]

NUDGE = 0.02


@dataclass(frozen=True)
class Noise:
    """Standard deviations of one sample (SI) by channel, of the gains, and of scatter between repeats."""

    sample: Mapping[str, float]
    calibration: float
    offset: Mapping[str, float]  # of a loop, by channel
    repeat_gain: float
    repeat_friction: float
    depth: float  # m
    volume: float  # relative


@dataclass(frozen=True)
class Slopes:
    """Derivatives of all loops by the logarithms of friction and mass, (loops, N) by channel, sweep last."""

    friction: Mapping[str, Array]
    mass: Mapping[str, Array]


@dataclass(frozen=True)
class Signal:
    """`rms`: of the change after the refit over the noise of a sample, in the channel where it is largest.

    `by_channel` has it for each; `total` is the square root of the sum over all samples and repeats. `explained` is
    the share of the change that the refit absorbs.
    """

    rms: float
    total: float
    absorbed: float
    by_channel: Mapping[str, float]


def stacked(loops: tuple[Channels, ...], name: str) -> Array:
    """Return the first period of channel `name` of all loops, (loops, N)."""
    return np.stack([getattr(loop, name)[:len(loop.time) // loop.periods] for loop in loops])


def slopes(joint: Joint, physics: Physics, plan: Plan, outcome: Outcome, names: tuple[str, ...]) -> Slopes:
    """Return derivatives about an outcome of `physics`: of the first and last loop, and of the sweep.

    Loops in between take those of the last one.
    """
    base = (outcome.loops[0], outcome.loops[-1], *outcome.sweep)
    found = []
    for nudged in (replace(physics, friction=physics.friction * (1.0 + NUDGE)),
                   replace(physics, rig=replace(physics.rig, block_mass=physics.rig.block_mass * (1.0 + NUDGE)))):
        test = Test(joint, nudged, plan)
        loops = [test.repeated(outcome.starts[0]), test.repeated(outcome.starts[-1])]
        loops += [test.repeated(outcome.starts[-1], condition) for condition in plan.sweep]
        change = {name: (stacked(tuple(loops), name) - stacked(base, name)) / NUDGE for name in names}
        between = [0] + [1] * (len(plan.cycles) - 1) + list(range(2, len(base)))
        found.append({name: values[between] for name, values in change.items()})
    return Slopes(*found)


def signal(joint: Joint, with_effect: Outcome, without: Outcome, rates: Slopes, noise: Noise, repeats: int) -> Signal:
    """Return how much of the difference between two outcomes is left after the refit."""
    names = tuple(rates.friction)
    loops = {name: stacked((*without.loops, *without.sweep), name) for name in names}
    change = {name: stacked((*with_effect.loops, *with_effect.sweep), name) - loops[name] for name in names}
    parts = [change[name].ravel() / noise.sample[name] for name in names]
    parts.append((with_effect.depth - without.depth) / noise.depth)
    columns = _columns(joint, without, loops, rates, noise)
    target = np.concatenate([*parts, np.zeros(columns.shape[0] - sum(map(len, parts)))])
    found = lstsq(columns, target, lapack_driver="gelsy")[0]
    left = target - columns @ found
    rms, start = {}, 0
    for name, part in zip((*names, "wear_depth"), parts, strict=True):
        rms[name] = float(np.sqrt(np.mean(left[start:start + len(part)]**2)))
        start += len(part)
    whole, kept = float(np.sum(target[:start]**2)), float(np.sum(left[:start]**2))
    return Signal(max(rms.values()), float(np.sqrt(kept * repeats)), 1.0 - kept / max(whole, 1e-300), rms)


def _columns(joint: Joint, without: Outcome, loops: Mapping[str, Array], rates: Slopes, noise: Noise) -> Array:
    """Return what the refit can change over the noise, one column a parameter; the last rows are its priors."""
    names = tuple(loops)
    sizes = [loops[name].size for name in names]
    begin = np.cumsum([0, *sizes])
    rows, count = begin[-1] + joint.size, len(next(iter(loops.values())))
    free = np.zeros((rows, 3))
    for name, start, stop in zip(names, begin[:-1], begin[1:], strict=True):
        free[start:stop, 0] = rates.friction[name].ravel() / noise.sample[name]
        free[start:stop, 1] = rates.mass[name].ravel() / noise.sample[name]
    free[begin[-1]:, 2] = without.depth / noise.depth
    if "approach" in names:
        worn = loops["approach"] - loops["approach"][:1]
        start = begin[names.index("approach")]
        free[start:start + worn.size, 2] = worn.ravel() / noise.sample["approach"]
    gains = np.zeros((rows, len(names)))
    offsets = np.zeros((rows, len(names) * count))
    for k, name in enumerate(names):
        gains[begin[k]:begin[k + 1], k] = loops[name].ravel() / noise.sample[name] * noise.calibration
        width = loops[name].shape[1]
        for loop in range(count):
            start = begin[k] + loop * width
            offsets[start:start + width, k * count + loop] = noise.offset[name] / noise.sample[name]
    priors = np.hstack([np.zeros((len(names) * (count + 1), 3)), np.eye(len(names) * (count + 1))])
    return np.vstack([np.hstack([free, gains, offsets]), priors])
