"""From the rows of a block to loops on one phase grid: nothing is changed or left out without a note.

Rows are gathered by cycle count and repeat, cut into whole periods, and aligned by the fundamental of the
excitation, or of the displacement where the excitation was not recorded. Samples that lie on a common phase grid
already are kept as they are; only others are resampled. Each period is a repeat.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.ndimage import maximum_filter1d

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.recordings.blocks import Columns
from fretflow.recordings.loopset import FORCES, LoopSet
from fretflow.recordings.notes import Note, row_ranges, rows_in_words
from fretflow.recordings.periods import LEVEL, ROUGH_FREEDOM, SHORTEST, SPIKE, roughness
from fretflow.recordings.stretches import Notebook, Stretch, Unusable, make_stretch

SAME_PLACE = 0.05  # of a sample: grids closer than that are one
MOST_PLACES = 20  # for repeats, times those that there are: memory grows as the file does
FEW_BURSTS = 0.25  # of the loops, that may be left out for a burst
LEAST_ENERGY = -0.05  # of the loop's bounding rectangle


def clean_loops(columns: Columns, frequency: Callable[[int], float], index: str = "cycle") -> tuple[
        LoopSet, tuple[Note, ...]]:
    """Clean the loops of a block.

    Parameters
    ----------
    columns : Columns
        The block's rows.
    frequency : callable
        From the value of `index` to the frequency in Hz, nan where it is not known.
    index : str
        Channel of whole numbers by which loops are told apart: cycle or condition.

    Raises
    ------
    UnreliableRecordingError
        If no loop is usable, or the loops run the wrong way round.
    """
    reference = _reference(columns)
    notes = Notebook(columns.block)
    counts, members = _gather(columns, index, notes)
    stretches: list[tuple[int, Stretch]] = []
    reasons: list[str] = []
    time = columns.values.get("time")
    values = np.array([columns.values[name] for name in columns.physical])
    for k, rows in members:
        try:
            part = values[:, rows]
            _must_move(part, columns.physical)
            stretches.append((k, make_stretch(
                rows, None if time is None else time[rows], part, columns.physical, reference,
                frequency(int(counts[k])), notes)))
        except Unusable as reason:
            words = f"loop left out: {f'{reason.channel}: ' if reason.channel else ''}{reason}"
            notes.add(words, reason.channel, rows)
            reasons.append(f"{rows_in_words(row_ranges(rows))}: {words}")
    if not stretches:
        raise UnreliableRecordingError(f"{columns.path}: no loop is usable; {reasons[0]}")
    phase, channels = _on_one_grid(stretches, len(counts), notes, columns.physical, reference)
    loops = LoopSet(
        cycles=counts, frequency=np.array([frequency(int(count)) for count in counts]), phase=phase, channels=channels,
        units={name: columns.units[name] for name in channels}, sd=columns.sd, calibration_sd=columns.calibration_sd,
        displacement_of=columns.displacement_of, aligned_to=reference)
    return loops, (*columns.notes, *notes.notes())


def _reference(columns: Columns) -> str:
    for name in ("excitation", "displacement", *columns.physical):
        if name in columns.physical:
            return name
    raise UnreliableRecordingError(f"{columns.block}: names no channel but {', '.join(columns.values)}; name the "
                                   "columns of displacement and force")


def _gather(columns: Columns, index: str, notes: Notebook) -> tuple[
        NDArray[np.int64], list[tuple[int, NDArray[np.int64]]]]:
    """Return the K values of `index`, and for each loop its place among them and its rows."""
    first, second = columns.index(index), columns.index("repeat")
    order = np.lexsort((second, first))
    for name, values in ((index, first), ("repeat", second)):
        if np.any(values < 0):
            notes.add("no whole number from 0; row left out", name, np.flatnonzero(values < 0))
    order = order[(first[order] >= 0) & (second[order] >= 0)]
    starts = np.flatnonzero(np.r_[True, (np.diff(first[order]) != 0) | (np.diff(second[order]) != 0)])
    counts = np.unique(first[order])
    places = np.searchsorted(counts, first[order[starts]])
    return counts, [(int(k), rows) for k, rows in zip(places, np.split(order, starts[1:]), strict=True)]


def _must_move(values: Array, names: tuple[str, ...]) -> None:
    for name, channel in zip(names, values, strict=True):
        there = channel[np.isfinite(channel)]
        if name in ("displacement", *FORCES, "excitation") and not (there.size and np.ptp(there) > 0.0):
            raise Unusable("it never changes; check that the sensor was on and the right column is named"
                           if there.size else "it holds no number", name)


def _on_one_grid(stretches: list[tuple[int, Stretch]], count: int, notes: Notebook, names: tuple[str, ...],
                 reference: str) -> tuple[Array, dict[str, Array]]:
    """Return the phase grid (N,) in rad and the channels (K, R, N) on it."""
    samples = int(np.median([stretch.samples for _, stretch in stretches]))
    offsets = [stretch.offset if stretch.samples == samples else None for _, stretch in stretches]
    common = _common_offset(offsets, [stretch.reference_sd for _, stretch in stretches])
    cut = []
    for (k, stretch), offset in zip(stretches, offsets, strict=True):
        exact = offset is not None and common is not None
        if not exact:
            notes.add(f"put on a common phase grid of {samples} samples by the fundamental of {reference}", "",
                      stretch.rows)
        whole = stretch.on_grid(samples, common or 0.0, exact)
        cut += [(k, whole[j], stretch) for j in range(stretch.periods) if j not in stretch.excluded]
    cut = _without_bursts(_right_way_round(cut, names, notes), names, notes)
    deepest = min(max(np.bincount([k for k, _, _ in cut])), max(1, MOST_PLACES * len(cut) // count))
    channels = np.full((len(names), count, deepest, samples), np.nan)
    filled = np.zeros(count, dtype=int)
    for k, values, stretch in cut:
        if filled[k] == deepest:
            notes.add(f"periods left out: at so many counts as there are, {deepest} repeats of one are kept", "",
                      stretch.rows)
            continue
        channels[:, k, filled[k]] = values
        filled[k] += 1
    phase = 2.0 * np.pi * (np.arange(samples) + (common or 0.0)) / samples
    return phase, dict(zip(names, channels, strict=True))


def _common_offset(offsets: list[float | None], spreads: list[float]) -> float | None:
    """Return the place of the samples between grid points, if it is one for all within its uncertainty."""
    known = np.array([offset for offset in offsets if offset is not None])
    if not known.size:
        return None
    circle = np.exp(2j * np.pi * known)
    middle = float(np.angle(circle.mean()) / (2.0 * np.pi))
    away = np.abs((known - middle + 0.5) % 1.0 - 0.5)
    allowed = max(SAME_PLACE, 4.0 * float(np.max(spreads)))
    return middle % 1.0 if away.max() <= min(allowed, 0.25) else None


def _right_way_round(cut: list[tuple[int, Array, Stretch]], names: tuple[str, ...], notes: Notebook) -> list[
        tuple[int, Array, Stretch]]:
    """Return the loops that dissipate energy; all must unless a channel is wrong."""
    force = next((name for name in FORCES if name in names), None)
    if force is None or "displacement" not in names:
        return cut
    j, k = names.index("displacement"), names.index(force)
    good = [_relative_energy(values[j], values[k]) > LEAST_ENERGY for _, values, _ in cut]
    if np.mean(good) < 0.5:
        rows = np.concatenate([part.rows for (_, _, part), fine in zip(cut, good, strict=True) if not fine])
        raise UnreliableRecordingError(
            f"displacement and {force}, {rows_in_words(row_ranges(rows))}: loops run the wrong way round and give "
            "energy; reverse the sign of one channel (scale = -1), or name the columns the other way round")
    for (_, _, part), fine in zip(cut, good, strict=True):
        if not fine:
            notes.add("loop left out: it runs the wrong way round and gives energy", force, part.rows)
    return [entry for entry, fine in zip(cut, good, strict=True) if fine]


def _relative_energy(x: Array, force: Array) -> float:
    area = 0.5 * float(np.sum((force + np.roll(force, -1)) * (np.roll(x, -1) - x)))
    return area / max(float(np.ptp(x) * np.ptp(force)), 1e-300)


def _without_bursts(cut: list[tuple[int, Array, Stretch]], names: tuple[str, ...], notes: Notebook) -> list[
        tuple[int, Array, Stretch]]:
    """Return the loops but those of which one channel is far rougher in one place than those about it and elsewhere.

    Of a count with three repeats two tell which is out of order; what a quarter of all have is the signal's own.
    """
    groups = [members for k in dict.fromkeys(k for k, _, _ in cut)
              if len(members := [i for i, (own, _, _) in enumerate(cut) if own == k]) > 2]
    if not groups:
        return cut
    rough_channels: dict[int, set[str]] = {}
    for j, name in enumerate(names):
        values = [np.stack([cut[i][1][j] for i in members]) for members in groups]
        rough = [roughness(own - own.mean(axis=0)) / (1.0 - 1.0 / len(own)) for own in values]
        every = np.concatenate(rough)
        usual = maximum_filter1d(np.quantile(every, 0.75, axis=0), 2 * SHORTEST, mode="wrap")
        limit = np.maximum(usual * stats.chi2.isf(LEVEL * SHORTEST / every.size, ROUGH_FREEDOM) / ROUGH_FREEDOM,
                           np.square(SPIKE * np.ptp(np.concatenate(values))))
        for members, own in zip(groups, rough, strict=True):
            if np.any(own > limit):  # half of a burst is in the mean that the others are compared with
                rough_channels.setdefault(members[int(np.argmax((own / limit).max(axis=1)))], set()).add(name)
    bursts = {i: min(own) for i, own in rough_channels.items() if len(own) == 1}
    if not 0 < len(bursts) <= FEW_BURSTS * len(cut):
        return cut
    for i, name in bursts.items():
        notes.add("loop left out: a burst that its repeats do not have", name, cut[i][2].rows)
    return _without_bursts([entry for i, entry in enumerate(cut) if i not in bursts], names, notes)
