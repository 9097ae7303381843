"""A stretch of rows recorded at one cycle count, as whole periods in order of phase: time, holes and drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import Array
from fretflow.core.units import per_cent
from fretflow.recordings import periods as p
from fretflow.recordings.notes import Note, row_ranges
from fretflow.recordings.periods import SHORTEST

LONGEST_HOLE = 0.05  # of a period that is bridged
UNEVEN = 0.1  # of the sampling interval
GAP = 1.8  # sampling intervals
MOST_MISSING = 0.2  # of the samples of a stretch
DRIFT_SIGNIFICANCE = 4.0  # standard deviations
LEAST_DRIFT = 1e-6  # of the range: less is rounding
OTHER_FREQUENCY = 0.02  # relative: beyond, the one that is given is wrong
FAINT = 0.1  # of slower motion: what moves less at the frequency given has another
MOST_UNSEEN = 64.0  # periods, of which a motion might be seen to come back three times or less
WHOLE = 0.02  # of a period that may be lacking at the end


class Unusable(Exception):
    """A stretch cannot be used; the message says why."""

    def __init__(self, reason: str, channel: str = "") -> None:
        super().__init__(reason)
        self.channel = channel


class Notebook:
    """Collects notes; those of one text and channel become one with all their rows."""

    def __init__(self, block: str) -> None:
        self._block = block
        self._rows: dict[tuple[str, str], list[NDArray[np.int64]]] = {}

    def add(self, text: str, channel: str, rows: NDArray[np.int64]) -> None:
        """Note `text` about `rows` (n,), counted from 0."""
        self._rows.setdefault((text, channel), []).append(rows)

    def notes(self) -> tuple[Note, ...]:
        """Return what was noted."""
        return tuple(Note(self._block, text, channel, row_ranges(np.concatenate(rows)))
                     for (text, channel), rows in self._rows.items())


@dataclass(frozen=True)
class Stretch:
    """Whole periods of all channels, not yet on a common phase grid."""

    rows: NDArray[np.int64]
    turns: Array  # (n,), from the first row
    values: Array  # (C, n), complete
    periods: int
    evenly: bool
    reference: float  # turn in [0, 1) at which the reference is largest
    reference_sd: float  # of it, in samples
    excluded: frozenset[int] = field(default=frozenset())  # periods with too long a hole

    @property
    def samples(self) -> int:
        """Return the samples a period, rounded."""
        return round(len(self.turns) / self.periods)

    @property
    def offset(self) -> float | None:
        """Return where the first sample after the reference's maximum lies, in samples; None if that varies."""
        if not self.evenly or len(self.turns) != self.samples * self.periods:
            return None
        after = float(-self.reference * self.samples % 1.0)
        return after if after < 1.0 - 1e-6 else 0.0  # round-off before the maximum is on it

    def on_grid(self, samples: int, offset: float, exact: bool) -> Array:
        """Return the periods (P, C, N) at the phases ``(n + offset) / N`` after the reference's maximum.

        `exact` says that the samples lie there already.
        """
        first = int(np.ceil((self.turns[0] - self.reference) * samples - offset - 1e-6))
        if exact:
            first = round((self.turns[0] - self.reference) * samples - offset)
            values = self.values
        else:
            at = self.reference + (first + offset + np.arange(samples * self.periods)) / samples
            values = p.resampled(self.turns, self.values, self.periods, at, self.evenly)
        cut = values.reshape(len(values), self.periods, samples).swapaxes(0, 1)
        return np.roll(cut, first % samples, axis=2)


def make_stretch(rows: NDArray[np.int64], time: Array | None, values: Array, names: Sequence[str],
                 reference: str, frequency: float, notes: Notebook) -> Stretch:
    """Turn rows (n,) with their time (s) and channels (C, n) into whole periods, noting what is done.

    A `frequency` (Hz) of nan is found from the reference; rows in which it does not come back are one period. Without
    a time the rows are taken as even.

    Raises
    ------
    Unusable
        If that cannot be done.
    """
    rows, turns, values, interval = _turns(rows, time, values, names.index(reference), frequency, notes)
    periods = int(np.floor(turns[-1] + interval + WHOLE))
    if periods == 0 and turns[-1] + interval >= 1.0 - LONGEST_HOLE:
        early = per_cent(1.0 - turns[-1] - interval, 1)
        notes.add(f"end {early} of a period too early, which is bridged", "", rows[-1:])
        periods = 1
    if periods == 0:
        raise Unusable(f"{per_cent(turns[-1] + interval)} of a period; at least one whole period is needed")
    used = turns < periods - 0.5 * interval
    if len(turns) - used.sum() > WHOLE / interval:
        notes.add("are no whole period and left out", "", rows[~used])
    rows, turns, values = rows[used], turns[used], values[:, used]
    if len(turns) < SHORTEST * periods:
        raise Unusable(f"{len(turns) / periods:.0f} samples a period; at least {SHORTEST} are needed")
    whole = _filled(rows, turns, values, names, notes)
    excluded = _holes(rows, turns, values, interval, periods, names, notes)
    evenly = bool(np.all(np.abs(np.diff(turns) - interval) < UNEVEN * interval))
    whole = _without_drift(rows, turns, whole, names, periods, interval, notes)
    k = names.index(reference)
    maximum = p.turn_of_maximum(turns, whole[k])
    noise = float(p.noise_sd(whole[k])) / max(abs(p.fundamental(turns, whole[k])), 1e-300)
    spread = float(noise * np.sqrt(2.0 / len(turns)) * len(turns) / periods / (2.0 * np.pi))
    return Stretch(rows, turns, whole, periods, evenly, maximum, spread, excluded)


def _turns(rows: NDArray[np.int64], time: Array | None, values: Array, reference: int, frequency: float,
           notes: Notebook) -> tuple[NDArray[np.int64], Array, Array, float]:
    """Return rows, turns, values without rows that have no time, and the sampling interval in turns."""
    if time is not None and not np.all(np.isfinite(time)):
        known = np.isfinite(time)
        notes.add("have no time and are left out", "time", rows[~known])
        rows, time, values = rows[known], time[known], values[:, known]
    if len(rows) < SHORTEST:
        raise Unusable(f"{len(rows)} samples; at least {SHORTEST} a period are needed")
    if time is None:
        time, frequency = np.arange(len(rows)) * 1.0, float("nan")
    else:
        _must_grow(rows, time)
    step = float(np.median(np.diff(time)))
    frequency = _true_frequency(rows, time, values[reference], frequency, notes)
    if not np.isfinite(frequency):
        frequency = 1.0 / (time[-1] - time[0] + step)
    steps = np.diff(time)
    gaps = steps > GAP * step
    if np.any(gaps):
        notes.add("follow gaps in time, bridged where they are short", "time", rows[1:][gaps])
    elif np.any(np.abs(steps - step) > UNEVEN * step):
        notes.add("are sampled unevenly and resampled", "time", rows)
    return rows, (time - time[0]) * frequency, values, step * frequency


def _must_grow(rows: NDArray[np.int64], time: Array) -> None:
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        raise Unusable(f"time does not grow at row {rows[back[0] + 1] + 1}; sort the rows, and check that each loop "
                       "has its own cycle and repeat", "time")


def _true_frequency(rows: NDArray[np.int64], time: Array, values: Array, given: float, notes: Notebook) -> float:
    """Return the frequency by which the reference comes back, the given one where that cannot be told."""
    there = np.isfinite(values)
    crossings = p.upward_crossings(values[there]) if there.any() else np.zeros(0)
    if len(crossings) < (2 if not np.isfinite(given) else 4):
        _must_come_back(time[there], values[there], given)
        return given
    at = np.interp(crossings, np.arange(there.sum()), time[there])
    if np.isfinite(given) and at[-1] - at[0] < 0.5 * (time[-1] - time[0]):
        return given  # a burst passes the middle many times in one place
    frequency = float(1.0 / np.median(np.diff(at)))
    between = round(float((at[-1] - at[0]) * frequency))
    frequency = between / float(at[-1] - at[0])
    if not np.isfinite(given):
        return frequency
    if abs(frequency / given - 1.0) > OTHER_FREQUENCY:
        raise Unusable(f"periods come at {frequency:.6g} Hz where {given:.6g} Hz are stated; correct "
                       "excitation_frequency or the unit of time", "time")
    if abs(frequency / given - 1.0) * (time[-1] - time[0]) * given < WHOLE:
        return given
    notes.add(f"cut into periods at the {frequency:.6g} Hz by which the signal comes back, not at {given:.6g} Hz",
              "time", rows)
    return frequency


def _must_come_back(time: Array, values: Array, given: float) -> None:
    """Refuse a stretch that is of a few periods by the frequency given, but moves slower than that."""
    stated = (time[-1] - time[0]) * given if len(time) >= SHORTEST and np.isfinite(given) else 0.0
    if not 1.5 < stated < MOST_UNSEEN:
        return
    angle = 2.0 * np.pi * np.outer((time - time[0]) * given, np.arange(1, round(stated) + 1) / round(stated))
    basis = np.column_stack([np.ones_like(time), angle[:, 0], np.cos(angle), np.sin(angle)])  # a drift, too
    _, _, *wave = np.linalg.lstsq(basis, values, rcond=None)[0]
    size = np.hypot(*np.reshape(wave, (2, -1)))
    if size[-1] < FAINT * size.max():
        raise Unusable(f"the motion does not come back at the {given:.6g} Hz stated, of which there are {stated:.3g} "
                       "periods; correct excitation_frequency or the unit of time", "time")


def _filled(rows: NDArray[np.int64], turns: Array, values: Array, names: Sequence[str], notes: Notebook) -> Array:
    """Return the values with missing samples interpolated."""
    if np.all(np.isfinite(values)):
        return values
    whole = values.copy()
    for name, channel in zip(names, whole, strict=True):
        missing = ~np.isfinite(channel)
        if missing.mean() > MOST_MISSING:
            raise Unusable(f"{per_cent(missing.mean())} of the samples are missing; "
                           f"at most {per_cent(MOST_MISSING)} can be bridged", name)
        if missing.any():
            notes.add("no number there; filled by interpolation", name, rows[missing])
            channel[missing] = np.interp(turns[missing], turns[~missing], channel[~missing], period=float(
                max(1.0, np.ceil(turns[-1]))))
    return whole


def _holes(rows: NDArray[np.int64], turns: Array, values: Array, interval: float, periods: int,
           names: Sequence[str], notes: Notebook) -> frozenset[int]:
    """Return the periods in which a channel lacks more than can be bridged."""
    bad: dict[int, str] = {}
    for name, channel in zip(names, values, strict=True):
        there = turns[np.isfinite(channel)]
        edges = np.r_[there, there[0] + periods]
        for k in np.flatnonzero(np.diff(edges) - interval > LONGEST_HOLE):
            touched = range(int(edges[k]), int(np.ceil(edges[k + 1] - 1e-9)))
            bad = {**dict.fromkeys((period % periods for period in touched), name), **bad}
    if len(bad) == periods:
        raise Unusable(f"more than {per_cent(LONGEST_HOLE)} of a period is missing in one place", bad[0])
    for period, name in bad.items():
        inside = rows[(turns >= period) & (turns < period + 1)]
        notes.add(f"period left out: it lacks more than {per_cent(LONGEST_HOLE)} of its samples in one place", name,
                  inside)
    return frozenset(bad)


def _without_drift(rows: NDArray[np.int64], turns: Array, values: Array, names: Sequence[str], periods: int,
                   interval: float, notes: Notebook) -> Array:
    """Return the channels without their drift where it is significant, so that each period closes."""
    drift = _closing_line(turns, values, interval) if periods == 1 else np.array([
        _drift_of_means(turns, channel, periods) for channel in values])
    for k in np.flatnonzero(drift.any(axis=1)):
        share = np.ptp(drift[k]) / np.ptp(values[k])
        notes.add(f"drift removed, {_rounded(share)} of the range", names[k], rows)
    return values - drift


def _rounded(share: float) -> str:
    limits = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
    return next((f"below {per_cent(limit)}" for limit in limits if share < limit), "above 50 %")


def _closing_line(turns: Array, values: Array, interval: float) -> Array:
    """Return the straight lines (C, n) about zero that close a single period, zero where it may be closed already."""
    jump, sd, within = p.closure_jump(turns, values, interval)
    opens = np.abs(jump) > np.maximum(DRIFT_SIGNIFICANCE * sd + within, LEAST_DRIFT * np.ptp(values, axis=1))
    return np.outer(np.where(opens, jump, 0.0), turns - turns.mean())


def _drift_of_means(turns: Array, values: Array, periods: int) -> Array:
    """Return the line (n,) through the means of several periods, about its mean; zero if that is not significant."""
    means = p.period_means(turns, values, periods)
    noise = float(p.noise_sd(values)) / np.sqrt(len(turns) / periods)
    bound = 2.0 * (DRIFT_SIGNIFICANCE + np.log10(periods) / 4.0) * noise
    if np.ptp(means) <= max(bound, LEAST_DRIFT * float(np.ptp(values))):
        return np.zeros_like(values)
    centres = np.arange(periods) + 0.5
    line = np.interp(turns, centres, means)
    for outside, a, b in ((turns < centres[0], 0, 1), (turns > centres[-1], -1, -2)):
        slope = (means[a] - means[b]) / (centres[a] - centres[b])
        line[outside] = means[a] + slope * (turns[outside] - centres[a])
    return np.asarray(line - line.mean())
