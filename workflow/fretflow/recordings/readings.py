"""What is read off recorded loops, with its uncertainty and where that comes from.

Three sources, each one standard deviation, added in squares: the noise of the samples (the loop is read again and
again with new noise of the size that its own samples show, which also tells its bias), the scatter between repeats
where it is larger (of a long record: between neighbouring cycles of one amplitude), and the calibration of the
channels, whose gain enters each reading by a known power. A stiffness is judged by its inverse, which noise leaves
nearly normal; where that is not clearly above zero, only a lower bound is given.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from functools import cached_property
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError, UnreliableRecordingError
from fretflow.core.records import Array, quantity, record
from fretflow.recordings.hysteresis import HysteresisLoop, LoopReadings, read_loop
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.periods import noise_sd, smoothed

MOTION_SHARE = 1.0 / 24.0  # of a period: half-width of the smoothing of the displacement
DRAWS = 200  # even: each noise is also taken with the other sign, so that its mean is zero
MOST_DRAWN = 12  # cycle counts that are read with new noise; the others take the nearest one's share
MOST_REPEATS = 60  # of a cycle count that are read one by one
SAME_REACH = 0.02  # change of the peak-to-peak displacement between cycles that count as repeats
ROUNDING = 1e-9  # relative: less is no noise
CLEAR = 3.0  # standard deviations that a compliance must be above zero
SHOWN = 0.5  # of the draws in which a reading must be there
SEED = 20210

# Powers with which the gains of displacement, force and normal load enter.
POWERS = {
    "friction_coefficient": (0, 1, -1),
    "friction_limit": (0, 1, 0),
    "tangential_compliance": (1, -1, 0),
    "dissipated_energy": (1, 1, 0),
    "sliding_distance": (1, 0, 0),
    "peak_to_peak": (1, 0, 0),
}


class Source(StrEnum):
    """Where most of an uncertainty comes from."""

    NOISE = "noise"
    REPEATS = "repeats"
    CALIBRATION = "calibration"


@record
class LoopReading:
    """One quantity at K cycle counts, nan where the loop does not show it, with standard deviations."""

    value: Array = quantity("", "(K,)")
    noise: Array = quantity("", "(K,), by noise")
    repeats: Array = quantity("", "(K,), by the scatter of repeats, zero without any")
    calibration: Array = quantity("", "(K,), by the gains")

    @cached_property
    def sd(self) -> Array:
        """Return the standard deviation in all, (K,): repeats scatter by noise already."""
        return np.sqrt(np.maximum(self.noise, self.repeats) ** 2 + self.calibration**2)

    @cached_property
    def dominated_by(self) -> tuple[Source | None, ...]:
        """Return the largest source at each cycle count; None where nothing is read."""
        parts = np.stack([self.noise, self.repeats, self.calibration])
        clear = parts.max(axis=0) > ROUNDING * np.abs(self.value)
        sources = tuple(Source)
        return tuple(sources[k] if there else None for k, there in zip(parts.argmax(axis=0), clear, strict=True))


@record
class RecordedReadings:
    """The readings of a set of loops."""

    cycles: NDArray[np.int64] = quantity("1", "(K,)")
    regime: tuple[str, ...]
    friction_coefficient: LoopReading = quantity("1")
    friction_limit: LoopReading = quantity("N")
    tangential_stiffness: LoopReading = quantity("N/m")
    stiffness_at_least: Array = quantity("N/m", "(K,), two standard deviations below; nan where nothing is known")
    dissipated_energy: LoopReading = quantity("J")
    sliding_distance: LoopReading = quantity("m")
    peak_to_peak: LoopReading = quantity("m")


def read_recorded_loops(loops: LoopSet, normal_load: Array, normal_load_sd: float = 0.0,
                        consecutive: bool = False) -> RecordedReadings:
    """Read the loops at each cycle count, as the mean of their repeats.

    Parameters
    ----------
    loops : LoopSet
        Clean loops of displacement and force.
    normal_load : (K,) array
        In N, nan where it is not known; a recorded normal force goes before it.
    normal_load_sd : float
        Its relative standard deviation.
    consecutive : bool
        The loops are cycles of one record: neighbours of the same amplitude tell how far repeats scatter.

    Raises
    ------
    UnreliableRecordingError
        If a loop cannot be read, naming its cycle count.
    """
    load = normal_load if "normal_force" not in loops.channels else np.nanmean(loops.mean("normal_force"), axis=1)
    if "normal_force" in loops.channels:
        normal_load_sd = loops.calibration_sd.get("normal_force", 0.0)
    kept = np.flatnonzero(loops.repeats)
    means = {name: loops.mean(name) for name in ("displacement", loops.force_name)}
    seen = [_read(loops, int(k), means["displacement"][k], means[loops.force_name][k], load[k]) for k in kept]
    values = {name: _column(seen, name) for name in POWERS}
    bias, noise = _noise(loops, means, kept, load, values)
    values = {name: values[name] - bias[name] for name in POWERS}
    scatter = _scatter_of_neighbours(loops.cycles[kept], values) if consecutive else _scatter(loops, kept, load, values)
    gains = np.array([loops.calibration_sd.get("displacement", 0.0), loops.calibration_sd.get(loops.force_name, 0.0),
                      normal_load_sd])
    estimates = {
        name: LoopReading(value=values[name], noise=noise[name], repeats=scatter[name],
                       calibration=np.abs(values[name]) * float(np.linalg.norm(gains * powers)))
        for name, powers in POWERS.items()}
    compliance = estimates.pop("tangential_compliance")
    stiffness, least = _stiffness(compliance)
    return RecordedReadings(cycles=loops.cycles[kept], regime=tuple(str(r.regime) for r in seen),
                            tangential_stiffness=stiffness, stiffness_at_least=least, **estimates)


def without_friction(readings: RecordedReadings) -> RecordedReadings:
    """Return only what holds for any force: peak to peak and the energy that it brings in each cycle.

    The force on a lumped system holds its inertia, so that neither plateaus nor slopes of its loops are friction.
    """
    none = np.full(len(readings.cycles), np.nan)
    unknown = LoopReading(value=none, noise=none, repeats=none, calibration=none)
    return replace(readings, regime=("unknown",) * len(none), friction_coefficient=unknown, friction_limit=unknown,
                   tangential_stiffness=unknown, stiffness_at_least=none, sliding_distance=unknown)


def _read(loops: LoopSet, k: int, x: Array, force: Array, load: float) -> LoopReadings:
    try:
        return read_noisy_loop(x, force, load)
    except InputError as error:
        raise UnreliableRecordingError(f"cycle {loops.cycles[k]}: {error}") from error


def read_noisy_loop(x: Array, force: Array, load: float = np.nan) -> LoopReadings:
    """Return what a loop (N,) in m and N shows, its parts told by smooth copies; `load` in N, nan if not known.

    Raises
    ------
    InputError
        If it is no loop.
    """
    guide = HysteresisLoop(displacement=_smooth_motion(x), force=smoothed(force))
    return read_loop(HysteresisLoop(displacement=x, force=force), load if np.isfinite(load) else None, guide)


def _smooth_motion(x: Array) -> Array:
    """Smooth a displacement more than a force: it has no kinks where the friction limit is reached."""
    return smoothed(x, round(MOTION_SHARE * x.shape[-1]))


def _column(seen: list[LoopReadings], name: str) -> Array:
    return np.array([np.nan if (value := getattr(reading, name)) is None else value for reading in seen])


def _noise(loops: LoopSet, means: dict[str, Array], kept: NDArray[np.int64], load: Array,
           values: dict[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return bias and standard deviation of each reading by noise, from reading smooth loops with new noise."""
    # Its own draws for each recording, and the same whenever that is read again.
    rng = np.random.default_rng([SEED, crc32(means["displacement"].tobytes())])
    drawn = np.unique(np.linspace(0, len(kept) - 1, min(MOST_DRAWN, len(kept))).round().astype(int))
    bias, spread = ({name: np.full(len(kept), np.nan) for name in POWERS} for _ in range(2))
    for place in drawn:
        k = int(kept[place])
        smooth = [_smooth_motion(means["displacement"][k]), smoothed(means[loops.force_name][k])]
        size = [_noise_of_mean(loops, name, k) for name in means]
        noisy = any(s > ROUNDING * np.ptp(mean) for s, mean in zip(size, smooth, strict=True))
        draws = []
        for _ in range(DRAWS // 2 if noisy else 0):
            noise = [s * rng.standard_normal(len(mean)) for mean, s in zip(smooth, size, strict=True)]
            draws += [read_noisy_loop(smooth[0] + turn * noise[0], smooth[1] + turn * noise[1], load[k])
                      for turn in (1, -1)]
        base = read_noisy_loop(smooth[0], smooth[1], load[k])
        for name in POWERS:
            column = _column(draws, name)
            there = column[np.isfinite(column)]
            enough = len(there) > SHOWN * DRAWS
            spread[name][place] = there.std(ddof=1) if enough else (np.nan if noisy else 0.0)
            bias[name][place] = there.mean() - _column([base], name)[0] if enough else 0.0
    return ({name: _spread_to_all(np.nan_to_num(bias[name]), drawn, values[name]) for name in POWERS},
            {name: _spread_to_all(spread[name], drawn, values[name]) for name in POWERS})


def _noise_of_mean(loops: LoopSet, name: str, k: int) -> float:
    """Return the noise of a channel's mean over the repeats: as the recording gives it, or as its samples show."""
    each = loops.channels[name][k, loops.usable[k]]
    one = loops.sd.get(name) or float(np.sqrt(np.mean(noise_sd(each) ** 2)))
    return one / float(np.sqrt(len(each)))


def _spread_to_all(spread: Array, drawn: NDArray[np.int64], values: Array) -> Array:
    """Give every cycle count the spread of the nearest one drawn, in proportion to its value."""
    place = np.arange(len(values))
    nearest = drawn[np.argmin(np.abs(place[:, None] - drawn[None, :]), axis=1)]
    scale = np.where(nearest == place, 1.0, np.abs(values) / np.maximum(np.abs(values[nearest]), 1e-300))
    return np.asarray(spread[nearest] * scale)


def _scatter(loops: LoopSet, kept: NDArray[np.int64], load: Array, values: dict[str, Array]) -> dict[str, Array]:
    """Return the standard deviation of each mean reading by the scatter of repeats, pooled over cycle counts.

    The scatter is pooled relative to the reading, as gains scatter.
    """
    repeats = loops.repeats[kept]
    shares: dict[str, list[float]] = {name: [] for name in POWERS}
    freedom = dict.fromkeys(POWERS, 0)
    for place, k in enumerate(kept):
        if repeats[place] < 2:
            continue
        usable = np.flatnonzero(loops.usable[k])
        some = usable[np.linspace(0, len(usable) - 1, min(MOST_REPEATS, len(usable))).round().astype(int)]
        each = [_read(loops, int(k), loops.displacement[k, r], loops.force[k, r], load[k]) for r in some]
        for name in POWERS:
            column = _column(each, name)
            if np.all(np.isfinite(column)) and values[name][place] != 0.0:
                shares[name].append(float(np.sum((column - column.mean()) ** 2)) / values[name][place] ** 2)
                freedom[name] += len(column) - 1
    return {name: np.abs(values[name]) * np.sqrt(sum(shares[name]) / max(freedom[name], 1) / repeats)
            for name in POWERS}


def _scatter_of_neighbours(cycles: NDArray[np.int64], values: dict[str, Array]) -> dict[str, Array]:
    """Return the standard deviation of each reading by its differences between neighbouring cycles of one amplitude."""
    peak_to_peak = values["peak_to_peak"]
    alike = np.flatnonzero((np.diff(cycles) == 1) & (np.abs(np.diff(peak_to_peak)) < SAME_REACH * peak_to_peak[:-1]))
    scatter = {}
    for name, column in values.items():
        with np.errstate(invalid="ignore"):  # where it sticks nothing slides in either
            change = 2.0 * (column[alike + 1] - column[alike]) / np.abs(column[alike + 1] + column[alike])
        change = change[np.isfinite(change)]
        scatter[name] = np.abs(column) * float(np.sqrt(np.mean(change**2) / 2.0) if change.size else 0.0)
    return scatter


def _stiffness(compliance: LoopReading) -> tuple[LoopReading, Array]:
    """Return the stiffness where its inverse is clearly positive, and what it is at least."""
    c, sd = compliance.value, compliance.sd
    known = np.isfinite(c) & np.isfinite(sd)
    clear = known & (np.nan_to_num(c) > CLEAR * np.nan_to_num(sd))
    slope = np.where(clear, 1.0 / np.where(clear, c, 1.0) ** 2, np.nan)
    upper = np.where(known, np.maximum(c, 0.0) + 2.0 * sd, np.nan)
    there = np.nan_to_num(upper) > 0.0
    least = np.where(there, 1.0 / np.where(there, upper, 1.0), np.nan)
    return LoopReading(value=np.where(clear, 1.0 / np.where(clear, c, 1.0), np.nan), noise=compliance.noise * slope,
                    repeats=compliance.repeats * slope, calibration=compliance.calibration * slope), least
