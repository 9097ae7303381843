"""Long records: cleaned row by row, and cut into the cycles by which the displacement comes back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.recordings import periods as p
from fretflow.recordings.blocks import Columns
from fretflow.recordings.loopset import FORCES, LoopSet, Series
from fretflow.recordings.notes import Note, row_ranges
from fretflow.recordings.periods import SHORTEST
from fretflow.recordings.stretches import GAP, WHOLE

BRIDGED = 5  # sampling intervals
SMALLEST_CYCLE = 0.1  # of the largest one
OPEN = 0.15  # of the range between the ends of a single loop
MOST_UNREAD = 0.25  # of a record, before the first passage of its middle and after the last
STEADY = 0.05  # change of the peak-to-peak displacement from cycle to cycle


def clean_series(columns: Columns) -> tuple[Series, tuple[Note, ...]]:
    """Fill the short holes of a long record and mark the rows in the long ones.

    Raises
    ------
    UnreliableRecordingError
        If time does not grow, a channel holds no number or the displacement never changes, naming rows.
    """
    time, rows, notes = _time(columns)
    usable = np.ones(len(rows), dtype=bool)
    channels = {}
    for name in columns.physical:
        values = columns.values[name][rows]
        there = np.isfinite(values)
        if not there.any() or (name in ("displacement", *FORCES) and np.ptp(values[there]) == 0.0):
            raise UnreliableRecordingError(f"{columns.path}: {name}, rows 1-{columns.rows}: "
                                           f"{'never changes' if there.any() else 'no number'}; check that the sensor "
                                           "was on and the right column is named")
        channels[name], far, more = _filled(columns.block, name, values, there, rows)
        usable &= ~far
        notes += more
    if time is not None and len(time) > 2:
        far, more = _gaps(columns.block, time, rows)
        usable &= ~far
        notes += more
    series = Series(time=time, channels=channels, usable=usable, units={n: columns.units[n] for n in channels},
                    sd=columns.sd, calibration_sd=columns.calibration_sd, displacement_of=columns.displacement_of)
    return series, (*columns.notes, *notes)


def _time(columns: Columns) -> tuple[Array | None, NDArray[np.int64], tuple[Note, ...]]:
    rows = np.arange(columns.rows)
    time = columns.values.get("time")
    if time is None:
        return None, rows, ()
    known = np.isfinite(time)
    without = row_ranges(rows[~known])
    notes = (Note(columns.block, "have no time and are left out", "time", without),) if without else ()
    rows, time = rows[known], time[known]
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size or len(time) < SHORTEST:
        what = f"row {rows[back[0] + 1] + 1}: time does not grow; sort the rows" if back.size else (
            f"only {len(time)} rows; at least {SHORTEST} are needed")
        raise UnreliableRecordingError(f"{columns.path}: time, {what}")
    return time, rows, notes


def _filled(block: str, name: str, values: Array, there: NDArray[np.bool_], rows: NDArray[np.int64]) -> tuple[
        Array, NDArray[np.bool_], tuple[Note, ...]]:
    """Return a channel with its missing values interpolated, which rows are too far for that, and notes."""
    far = np.zeros(len(values), dtype=bool)
    if there.all():
        return values, far, ()
    known = np.flatnonzero(there)
    missing = np.flatnonzero(~there)
    after = np.searchsorted(known, missing)
    before = known[np.maximum(after - 1, 0)]
    beyond = known[np.minimum(after, len(known) - 1)]
    long = (beyond - before > BRIDGED + 1) | (beyond < missing) | (before > missing)
    far[missing[long]] = True
    notes: tuple[Note, ...] = ()
    if not long.all():
        notes += (Note(block, "no number there; filled by interpolation", name, row_ranges(rows[missing[~long]])),)
    if long.any():
        notes += (Note(block, "no number in a long stretch; the cycles that it touches are left out", name,
                       row_ranges(rows[missing[long]])),)
    return np.interp(np.arange(len(values)), known, values[there]), far, notes


def _gaps(block: str, time: Array, rows: NDArray[np.int64]) -> tuple[NDArray[np.bool_], tuple[Note, ...]]:
    steps = np.diff(time)
    step = float(np.median(steps))
    far = np.zeros(len(time), dtype=bool)
    gaps = np.flatnonzero(steps > GAP * step)
    long = gaps[steps[gaps] > (BRIDGED + 1.5) * step]
    far[long], far[long + 1] = True, True
    notes: tuple[Note, ...] = ()
    if gaps.size:
        notes += (Note(block, f"follow gaps in time, the longest {steps.max():.4g} s; cycles with more than {BRIDGED} "
                       "samples missing are left out", "time", row_ranges(rows[gaps + 1])),)
    return far, notes


def loops_of_series(series: Series) -> tuple[LoopSet, tuple[Note, ...]]:
    """Cut a long record into cycles, numbered from 1; each is a loop of its own without repeats.

    A cycle lasts from one passage of the displacement upwards through its middle to the next. A record
    that ends near where it began and has no such cycle within is one loop; one that is a few whole cycles, all
    alike, is cut from its beginning instead, where those within it leave out more than a quarter.

    Raises
    ------
    UnreliableRecordingError
        If it holds no whole cycle.
    """
    if "displacement" not in series.channels:
        raise UnreliableRecordingError("series: no channel displacement, by which cycles are told apart")
    cuts = _cuts(series)
    if len(cuts) < 2:
        raise UnreliableRecordingError("series: holds no whole cycle of the displacement; record at least one, from "
                                       "one passage of its middle to the next")
    spans = np.diff(cuts)
    whole = np.array([bool(series.usable[int(a):int(np.ceil(b)) + 1].all()) and b - a >= SHORTEST
                      for a, b in pairwise(cuts)])
    samples = max(SHORTEST, int(np.median(spans)))
    channels = {name: _sampled(values, cuts, samples) for name, values in series.channels.items()}
    peak_to_peak = np.ptp(channels["displacement"], axis=1)
    kept = whole & (peak_to_peak > SMALLEST_CYCLE * peak_to_peak[whole].max(initial=0.0))
    if not kept.any():
        raise UnreliableRecordingError(f"series: no cycle has {SHORTEST} samples without long holes; record more")
    notes = _cycle_notes(cuts, kept, peak_to_peak, series.rows)
    interval = series.sampling_interval
    frequency = 1.0 / (spans[kept] * interval) if interval else np.full(int(kept.sum()), np.nan)
    loops = LoopSet(
        cycles=np.flatnonzero(kept) + 1, frequency=frequency, phase=2.0 * np.pi * np.arange(samples) / samples,
        channels={name: values[kept][:, None, :] for name, values in channels.items()}, units=series.units,
        sd=series.sd, calibration_sd=series.calibration_sd, displacement_of=series.displacement_of,
        aligned_to="displacement")
    return _from_maximum(loops), notes


def _cuts(series: Series) -> Array:
    """Return where (n,), in samples, the cycles begin and the last one ends."""
    pushed = [values for name, values in series.channels.items() if name in FORCES]
    cuts = cycle_bounds(series.channels["displacement"], *pushed)
    if len(cuts) < 2 and series.rows >= SHORTEST and closes(series.channels["displacement"], *pushed):
        return np.array([0.0, series.rows])
    return cuts


def cycle_bounds(displacement: Array, *forces: Array) -> Array:
    """Return where (n,), in samples, the cycles of a record (T,) begin and the last ends: at passages of its middle.

    Of a record that is a few whole cycles, all alike, these may leave out half; it is cut from its beginning then.
    """
    cuts, rows = p.cycle_cuts(displacement), len(displacement)
    if len(cuts) < 2 or cuts[-1] - cuts[0] >= (1.0 - MOST_UNREAD) * rows or not closes(displacement, *forces):
        return cuts
    count = rows / float(np.median(np.diff(cuts)))
    if abs(count - round(count)) > WHOLE * count:
        return cuts
    whole = np.linspace(0.0, rows, round(count) + 1)
    reach = np.ptp(_sampled(displacement, whole, round(rows / count)), axis=1)
    return whole if np.ptp(reach) < STEADY * reach.max() else cuts


def closes(*channels: Array) -> bool:
    """Return whether channels (T,) are a single loop: every one ends near where it began."""
    return all(abs(values[-1] - values[0]) < OPEN * np.ptp(values) for values in channels)


def _sampled(values: Array, cuts: Array, samples: int) -> Array:
    """Return each cycle at `samples` even instants between its cuts, (cycles, samples)."""
    at = cuts[:-1, None] + np.diff(cuts)[:, None] * np.arange(samples) / samples
    return np.interp(at, np.arange(len(values) + 1), np.append(values, values[0]))


def _cycle_notes(cuts: Array, kept: NDArray[np.bool_], peak_to_peak: Array, rows: int) -> tuple[Note, ...]:
    notes = [Note("series", "cycles have no repeats: uncertainties rest on the noise within each, and on neighbours "
                            "of the same amplitude where there are any")]
    outside = tuple((a, b) for a, b in ((1, int(cuts[0])), (int(cuts[-1]) + 1, rows)) if b > a)
    if outside:
        notes.append(Note("series", "belong to no whole cycle and are not read", "", outside))
    ends = np.array([[int(a) + 1, int(b)] for a, b in pairwise(cuts)])
    refused = tuple((a, b) for a, b in ends[~kept].tolist())
    if refused:
        notes.append(Note("series", "cycles left out: too small, too short or with holes", "", refused))
    change = np.abs(np.diff(peak_to_peak)) / np.maximum(peak_to_peak[1:], peak_to_peak[:-1])
    moving = kept & (np.maximum(np.r_[0.0, change], np.r_[change, 0.0]) > STEADY)
    if moving.any():
        numbers = ", ".join(str(k + 1) for k in np.flatnonzero(moving)[:8]) + (" ..." if moving.sum() > 8 else "")
        notes.append(Note("series", f"motion is not steady in cycles {numbers}: their loops do not close",
                          "displacement", tuple((a, b) for a, b in ends[moving].tolist())))
    return tuple(notes)


def _from_maximum(loops: LoopSet) -> LoopSet:
    """Roll every loop so that it begins at the maximum of its displacement's fundamental."""
    samples = len(loops.phase)
    turns = np.arange(samples) / samples
    shift = [-round(p.turn_of_maximum(turns, x) * samples) for x in loops.channels["displacement"][:, 0]]
    rolled: Mapping[str, Array] = {name: np.array([np.roll(v, s, axis=-1) for v, s in zip(values, shift, strict=True)])
                                   for name, values in loops.channels.items()}
    return replace(loops, channels=rolled)
