"""How much of a hidden effect a recording shows once the baseline's own parameters are refitted, over the noise.

The change that the effect makes is projected, in least squares weighted by the noise, onto what friction
coefficient, wear coefficient, moving mass and the gains within their calibration can absorb: a
refit by two Gauss-Newton steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, lstsq

from fretflow_trial.campaign import Outcome, Plan, Test
from fretflow_trial.joint import Joint
from fretflow_trial.physics import Channels, Physics

Array = NDArray[np.float64]

NUDGE = 0.02
LINEAR = 0.02  # relative change of a parameter up to which one step will do
LARGEST_STEP = 0.5


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
    colour: float = 0.0  # correlation of a sample's noise with that of the sample before


@dataclass(frozen=True)
class Slopes:
    """Derivatives of all loops by the logarithms of friction and mass, (loops, N) by channel, sweep last."""

    friction: Mapping[str, Array]
    mass: Mapping[str, Array]


@dataclass(frozen=True)
class Signal:
    """How much of an effect is left.

    `rms`: root mean square of the change after the refit over the noise of one sample, sensor and offset, in the
    channel where it is largest; `by_channel` has it for each. `total`: the distance of recordings with and without
    the effect, over all samples and repeats, in standard deviations (Mahalanobis), after the refit; noise, offsets
    and scatter are its covariance. `absorbed`: share of the change, squared, that the refit takes.
    """

    rms: float
    total: float
    absorbed: float
    by_channel: Mapping[str, float]
    refit: tuple[float, float, float]  # relative changes of friction, mass and wear coefficient


def stacked(loops: tuple[Channels, ...], names: tuple[str, ...]) -> dict[str, Array]:
    """Return the first period of each channel of all loops, (loops, N).

    Where the drive is not among them, nothing tells the phase: it is then counted from the displacement's fundamental.
    """
    channels = {name: np.stack([getattr(loop, name)[:len(loop.time) // loop.periods] for loop in loops])
                for name in names}
    if "excitation" in names:
        return channels
    first = np.fft.rfft(channels["displacement"])[:, 1:2]
    samples = channels["displacement"].shape[1]
    turn = np.exp(-1j * np.angle(first) * np.arange(samples // 2 + 1))
    return {name: np.fft.irfft(turn * np.fft.rfft(values), samples) for name, values in channels.items()}


def slopes(joint: Joint, physics: Physics, plan: Plan, outcome: Outcome, names: tuple[str, ...]) -> Slopes:
    """Return derivatives about an outcome of `physics`: of the first and last loop, and of the sweep.

    Loops in between take those of the last one.
    """
    base = (outcome.loops[0], outcome.loops[-1], *outcome.sweep)
    derivatives = []
    for nudged in (replace(physics, friction=physics.friction * (1.0 + NUDGE)),
                   replace(physics, rig=replace(physics.rig, block_mass=physics.rig.block_mass * (1.0 + NUDGE)))):
        test = Test(joint, nudged, plan)
        loops = [test.repeated(outcome.starts[0]), test.repeated(outcome.starts[-1])]
        loops += [test.repeated(outcome.starts[-1], condition) for condition in plan.sweep]
        after, before = stacked(tuple(loops), names), stacked(base, names)
        change = {name: (after[name] - before[name]) / NUDGE for name in names}
        between = [0] + [1] * (len(plan.cycles) - 1) + list(range(2, len(base)))
        derivatives.append({name: values[between] for name, values in change.items()})
    return Slopes(*derivatives)


def signal(joint: Joint, with_effect: Outcome, without: Outcome, rates: Slopes, noise: Noise, repeats: int) -> Signal:
    """Return how much of the difference between two outcomes is left after the refit."""
    names = tuple(rates.friction)
    loops = stacked((*without.loops, *without.sweep), names)
    after = stacked((*with_effect.loops, *with_effect.sweep), names)
    parts = {name: (after[name] - loops[name]).ravel() for name in names}
    parts["wear_depth"] = with_effect.depth - without.depth
    change = np.concatenate(list(parts.values()))
    level = {name: np.hypot(noise.sample[name], noise.offset[name]) for name in names}
    place = np.repeat(np.arange(len(parts)), [len(part) for part in parts.values()])
    overall = np.array([*level.values(), noise.depth])[place]
    refit = _refit(joint, without, loops, rates)
    gains = _gains(joint, loops)
    left, coefficients = _left(change / overall, refit / overall[:, None], noise.calibration * gains / overall[:, None])
    rms = {name: float(np.sqrt(np.mean(left[:len(change)][place == k]**2))) for k, name in enumerate(parts)}
    kept = float(np.sum(left[:len(change)]**2))
    # coloured noise is counted as if it were as strong everywhere as where it is strongest, in the slowest changes
    slow = np.sqrt((1.0 + noise.colour) / (1.0 - noise.colour) / repeats)
    sample = np.array([*(noise.sample[name] * slow for name in names), noise.depth])[place]
    scatter = np.hstack([noise.calibration * gains, _each_loop(joint, loops, rates, noise, repeats)])
    apart, _ = _left(change / sample, refit / sample[:, None], scatter / sample[:, None])
    whole = max(float(np.sum((change / overall)**2)), 1e-300)
    return Signal(max(rms.values()), float(np.linalg.norm(apart)), 1.0 - kept / whole, rms,
                  (float(coefficients[0]), float(coefficients[1]), float(coefficients[2])))


def _left(change: Array, free: Array, scattered: Array) -> tuple[Array, Array]:
    """Return what is left of `change` after a fit of `free` columns and of `scattered` ones of unit prior, and the fit.

    The last rows are the priors' residuals, so that the sum of squares is the distance in standard deviations.
    """
    count = scattered.shape[1]
    size = np.linalg.norm(free, axis=0)
    columns = np.block([[free / np.where(size > 0.0, size, 1.0), scattered],
                        [np.zeros((count, free.shape[1])), np.eye(count)]])
    target = np.concatenate([change, np.zeros(count)])
    coefficients = lstsq(columns, target, lapack_driver="gelsy")[0]
    return target - columns @ coefficients, coefficients[:free.shape[1]] / np.where(size > 0.0, size, 1.0)


def _refit(joint: Joint, without: Outcome, loops: Mapping[str, Array], rates: Slopes) -> Array:
    """Return how all samples follow friction, mass and wear coefficient, (samples, 3)."""
    friction = np.concatenate([*(rates.friction[name].ravel() for name in loops), np.zeros(joint.size)])
    mass = np.concatenate([*(rates.mass[name].ravel() for name in loops), np.zeros(joint.size)])
    worn = [((values - values[:1]).mean(axis=1, keepdims=True) if name == "approach" else 0.0) * np.ones_like(values)
            for name, values in loops.items()]
    wear = np.concatenate([*(part.ravel() for part in worn), without.depth])
    return np.stack([friction, mass, wear], axis=1)


def _gains(joint: Joint, loops: Mapping[str, Array]) -> Array:
    """Return how all samples follow the gain of each channel, (samples, channels)."""
    return np.asarray(block_diag(*(values.reshape(-1, 1) for values in loops.values()), np.zeros((joint.size, 0))))


def _each_loop(joint: Joint, loops: Mapping[str, Array], rates: Slopes, noise: Noise, repeats: int) -> Array:
    """Return the scatter of every loop, one column a source and one standard deviation high: offset, gain, friction."""
    offsets = [np.full((values.shape[1], 1), noise.offset[name]) for name, values in loops.items() for _ in values]
    gains = [noise.repeat_gain / np.sqrt(repeats) * row[:, None] for values in loops.values() for row in values]
    count = len(next(iter(loops.values())))
    friction = [noise.repeat_friction / np.sqrt(repeats) * block_diag(*(row[:, None] for row in rates.friction[name]))
                for name in loops]
    wear = np.zeros((joint.size, 0))
    return np.hstack([block_diag(*offsets, wear), block_diag(*gains, wear),
                      np.vstack([*friction, np.zeros((joint.size, count))])])


def signal_of(joint: Joint, with_effect: Outcome, physics: Physics, plan: Plan, noise: Noise, names: tuple[str, ...],
              repeats: int) -> tuple[Signal, Slopes]:
    """Return how much of an outcome `physics`, without the effect, cannot explain after its refit, and its slopes.

    The slopes are those about `physics` as it is given.
    """
    without = Test(joint, physics, plan).run()
    first = rates = slopes(joint, physics, plan, without, names)
    seen = signal(joint, with_effect, without, rates, noise, repeats)
    if max(map(abs, seen.refit)) < LINEAR:
        return seen, first
    friction, mass, wear = (1.0 + min(max(change, -LARGEST_STEP), LARGEST_STEP) for change in seen.refit)
    refitted = replace(physics, friction=physics.friction * friction, wear=physics.wear * wear,
                       rig=replace(physics.rig, block_mass=physics.rig.block_mass * mass))
    without = Test(joint, refitted, plan).run()
    rates = slopes(joint, refitted, plan, without, names)
    again = signal(joint, with_effect, without, rates, noise, repeats)
    return (again if again.total < seen.total else seen), first
