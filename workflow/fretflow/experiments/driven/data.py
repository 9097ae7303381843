"""What a recording of a driven joint holds, as one motion and one force with their cycles.

A long record is one motion; its cycles go from one passage of the displacement upwards through its middle to the next.
Loops without what came before them go round twice, and the second round counts. The last third of the cycles is held
out; of a single cycle, every third stretch; of a record without cycles, its second half.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.recordings import periods as p
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED
from fretflow.recordings.loopset import FORCES, LoopSet, Series
from fretflow.recordings.readings import SAME_REACH
from fretflow.recordings.recording import Recording
from fretflow.recordings.series import closes, cycle_bounds
from fretflow.structure.motion import FEWEST, Motion, measure
from fretflow.structure.sensors import BACKWARDS

Mask = NDArray[np.bool_]

MOST_ROWS = 200_000  # of a record; longer ones are thinned, and cut
SAMPLES = 2500  # that a motion is marched at: fewer would miss where it turns
LEAST_OF_CYCLE = 100  # rows, of what is thinned: corners are then seen to a hundredth of the cycle
STRETCHES = 12  # of a single cycle


@dataclass(frozen=True)
class Cycle:
    """A cycle: what it is called, which samples (of the whole record) it has, and whether it is fitted."""

    number: int
    label: str
    start: int
    stop: int
    held_out: bool


@dataclass(frozen=True)
class DrivenData:
    """A record at full length (`whole`, `whole_force`) and thinned for fits; masks (N,) are of the thinned one."""

    kind: RecordingKind
    whole: Motion
    whole_force: Array
    unsmoothed: Array  # m, displacement as measured
    every: int
    motion: Motion
    force: Array
    cycles: tuple[Cycle, ...]
    repeats: tuple[tuple[Cycle, Cycle], ...]  # pairs that should be alike
    fitted: Mask
    held_out: Mask
    held_out_words: str
    timed: bool
    displacement_noise: float  # m, of a measured sample, before it was smoothed
    half_width: int  # of the smoothing, samples
    notes: tuple[str, ...] = ()

    @property
    def used(self) -> Mask:
        """Return what is fitted or held out."""
        return self.fitted | self.held_out

    @cached_property
    def phase(self) -> Array:
        """Return the phase (N,) in [0, 1): of the cycle, or without cycles of the motion in the plane of x and v."""
        x, v = self.motion.displacement - self.motion.displacement.mean(), self.motion.velocity
        phase = np.asarray(np.arctan2(v / max(float(v.std()), 1e-300), x / max(float(x.std()), 1e-300)) / (2.0 * np.pi)
                           % 1.0)
        for one in self.cycles:
            phase[self.samples_of(one)] = self.phases_of(one)
        return phase

    @cached_property
    def stretch(self) -> NDArray[np.int64]:
        """Return the stretch (N,) that each sample is in: its cycle, or without cycles one of equal length."""
        n = len(self.force)
        starts = [self.samples_of(one)[0] for one in self.cycles] or list(range(0, n, -(-n // STRETCHES)))
        return np.maximum(np.searchsorted(np.array(starts), np.arange(n), side="right") - 1, 0)

    def samples_of(self, cycle: Cycle) -> NDArray[np.int64]:
        """Return the thinned samples of a cycle."""
        return np.arange(-(-cycle.start // self.every), -(-cycle.stop // self.every))

    def phases_of(self, cycle: Cycle) -> Array:
        """Return the phase in [0, 1) of the thinned samples of a cycle."""
        return np.asarray((self.samples_of(cycle) * self.every - cycle.start) / (cycle.stop - cycle.start))


def plain_data(kind: RecordingKind, motion: Motion, force: Array, used: Mask | None = None) -> DrivenData:
    """Return a motion and its force (N,) as they are, without cycles; the samples that are not `used` are held out."""
    kept = np.ones(len(force), bool) if used is None else used
    return DrivenData(
        kind=kind, whole=motion, whole_force=force, unsmoothed=motion.displacement, every=1, motion=motion,
        force=force, cycles=(), repeats=(), fitted=kept, held_out=np.zeros(len(force), bool), held_out_words="",
        timed=True, displacement_noise=0.0, half_width=0)


def driven_data(recording: Recording) -> DrivenData:
    """Return a recording of an imposed displacement or of a lumped system, ready to be fitted.

    Raises
    ------
    UnreliableRecordingError
        If it has neither loops nor a series with displacement and force, or too little that moves.
    """
    kind = recording.kind
    try:
        if recording.series is not None:
            return _of_series(kind, recording.series)
        if recording.loops is not None:
            return _of_loops(kind, recording.loops)
    except UnreliableRecordingError as error:
        raise UnreliableRecordingError(f"{recording.path}: {error}") from error
    raise UnreliableRecordingError(f"{recording.path}: has neither [series] nor [loops]; a diagnosis needs the "
                                   "displacement and the force of one of them")


def _channels(block: str, channels: Mapping[str, Array]) -> tuple[Array, Array]:
    force = next((channels[name] for name in FORCES if name in channels), None)
    if force is None or "displacement" not in channels:
        raise UnreliableRecordingError(f"{block}: displacement and force are both needed; name their columns")
    return channels["displacement"], force


def _of_series(kind: RecordingKind, series: Series) -> DrivenData:
    x, force = _channels("series", series.channels)
    usable, notes = series.usable, []
    step = series.sampling_interval or 1.0
    if series.time is not None:
        rows = round(float(series.time[-1] - series.time[0]) / step) + 1
        if rows != len(x):
            even = np.linspace(series.time[0], series.time[-1], min(rows, 4 * len(x)))
            nearest = np.clip(np.searchsorted(series.time, even), 0, len(x) - 1)
            x, force, usable = np.interp(even, series.time, x), np.interp(even, series.time, force), usable[nearest]
            notes.append("series: rows are not evenly spaced in time and were interpolated to an even grid")
        step = float(series.time[-1] - series.time[0]) / (len(x) - 1)
    group, rows = _group(x)
    if rows < len(x):
        notes.append(f"series, rows {rows + 1:,}-{len(x):,}: not used, as fewer rows of a cycle would not show its "
                     "corners; cut the record to diagnose them")
        x, force, usable = x[:rows], force[:rows], usable[:rows]
    if group > 1:  # means of groups would round off the corners of a loop, as no slider does
        x, force, usable, step = x[::group], force[::group], usable[::group], step * group
        notes.append(f"series: every row of {group} is used, as the record is longer than {MOST_ROWS:,} rows")
    cuts = cycle_bounds(x, force)
    if len(cuts) < 2 and kind is IMPOSED_DISPLACEMENT and closes(x, force):
        closed = _closed(kind, [(1, x, force)], [step], series.time is not None)
        return replace(closed, notes=(*notes, *closed.notes))
    measured = measure(x, step)
    timed, cycles = series.time is not None, _cycles(cuts, usable)
    # points without time, such as those read off a figure, are not evenly spaced: no polynomial follows them
    moved = measured.motion if timed else replace(measured.motion, displacement=x)
    every = max(1, -(-len(x) // max(SAMPLES, min(4000, 150 * len(cycles)))))
    motion, thin = prepared(kind, moved, force, -(-len(x) // every))
    data = DrivenData(
        kind=kind, whole=replace(moved, lean=motion.lean), whole_force=force, unsmoothed=x, every=every,
        motion=motion, force=thin, cycles=cycles, repeats=_alike(x, cycles), fitted=np.zeros(0, bool),
        held_out=np.zeros(0, bool), held_out_words="", timed=timed, notes=tuple(notes), half_width=measured.half_width,
        displacement_noise=measured.noise if timed else 0.0)
    window = np.ones(2 * measured.half_width + 1)  # rates are not to be had at the ends, nor beside gaps
    inside = np.convolve(usable, window, "same") >= len(window) - 0.5
    return _split(data, inside[::every])


def prepared(kind: RecordingKind, motion: Motion, force: Array, samples: int = SAMPLES) -> tuple[Motion, Array]:
    """Return a recording thinned to some `samples`, leaning as it begins: for fits in a fraction of a second.

    A mass is driven, so its friction leans as it moves; elsewhere the force tells, by where it is between the plateaus.
    """
    every = max(1, -(-len(force) // samples))
    if kind is LUMPED:
        lean = float(np.sign(motion.velocity[0]))
    else:
        low, high = np.percentile(force, (10.0, 90.0))
        lean = float(np.clip(2.0 * (force[0] - 0.5 * (low + high)) / max(high - low, 1e-300), -1.0, 1.0))
    return replace(motion.thinned(every), lean=lean), force[::every]


def _group(x: Array) -> tuple[int, int]:
    """Return of how many rows of a long record one is used, and how many rows from its start."""
    group = -(-len(x) // MOST_ROWS)
    cuts = p.cycle_cuts(x[:MOST_ROWS]) if group > 1 else np.zeros(0)
    if len(cuts) < 2:
        return group, len(x)
    group = min(group, max(1, int(np.median(np.diff(cuts))) // LEAST_OF_CYCLE))
    return group, min(len(x), group * MOST_ROWS)


def _of_loops(kind: RecordingKind, loops: LoopSet) -> DrivenData:
    x, force = _channels("loops", loops.channels)
    samples = x.shape[-1]
    thin = next((k for k in range(samples // LEAST_OF_CYCLE, 0, -1) if samples % k == 0
                 and x.shape[0] * samples // k >= SAMPLES), 1)
    cycles, steps = [], []
    for k, r in np.argwhere(loops.usable):
        frequency = loops.frequency[k]
        cycles.append((int(loops.cycles[k]), x[k, r, ::thin], force[k, r, ::thin]))
        steps.append(thin / (samples * frequency) if np.isfinite(frequency) else 1.0)
    return _closed(kind, cycles, steps, bool(np.isfinite(loops.frequency).all()))


def _closed(kind: RecordingKind, loops: Sequence[tuple[int, Array, Array]], steps: Sequence[float], timed: bool
            ) -> DrivenData:
    """Return loops (number, displacement, force) one after the other, each gone round twice."""
    parts, cycles, at, noise, width = [], [], 0, [], 3
    for (number, x, force), step in zip(loops, steps, strict=True):
        n = len(x)
        measured = measure(np.tile(x, 3), step) if 3 * n >= FEWEST else None
        if measured is None:
            raise UnreliableRecordingError(f"a loop of {n} samples is too short to be diagnosed; record more samples "
                                           "a cycle")
        smooth = measured.motion
        columns = (smooth.displacement[n:2 * n] if timed else x, smooth.velocity[n:2 * n],
                   smooth.acceleration[n:2 * n], force, x)
        parts.append(tuple(np.tile(values, 2) for values in columns))
        cycles.append(Cycle(number, f"cycle {number:,}", at + n, at + 2 * n, False))
        noise.append(measured.noise if timed else 0.0)
        width, at = measured.half_width, at + 2 * n
    x, v, a, force, raw = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    count = len(cycles)
    cycles = [replace(one, held_out=count > 1 and (k % 3 == 1 if count > 2 else k == 1))
              for k, one in enumerate(_counted(cycles))]
    pairs = tuple((a, b) for a, b in combinations(cycles, 2) if a.number == b.number and a.stop - a.start
                  == b.stop - b.start)
    motion = Motion(step=float(np.mean(steps)), displacement=x, velocity=v, acceleration=a)
    data = DrivenData(
        kind=kind, whole=motion, whole_force=force, unsmoothed=raw, every=1, motion=motion, force=force,
        cycles=tuple(cycles), repeats=pairs, fitted=np.zeros(0, bool), held_out=np.zeros(0, bool), held_out_words="",
        timed=timed, displacement_noise=float(np.mean(noise)), half_width=width)
    return _split(data, np.ones(len(x), bool))


def _counted(cycles: Sequence[Cycle]) -> list[Cycle]:
    """Return cycles with the repeat in their label where a number comes more than once."""
    numbers = [one.number for one in cycles]
    return [replace(one, label=f"{one.label}, repeat {numbers[:k].count(one.number) + 1}")
            if numbers.count(one.number) > 1 else one for k, one in enumerate(cycles)]


def _cycles(cuts: Array, usable: Mask) -> tuple[Cycle, ...]:
    whole = [(k + 1, round(float(a)), round(float(b))) for k, (a, b) in enumerate(pairwise(cuts))]
    kept = [one for one in whole if usable[one[1]:one[2]].all() and one[2] - one[1] >= FEWEST]
    first = len(kept) - max(1, len(kept) // 3)
    return tuple(Cycle(number, f"cycle {number}", a, b, len(kept) > 1 and k >= first)
                 for k, (number, a, b) in enumerate(kept))


def _alike(x: Array, cycles: tuple[Cycle, ...]) -> tuple[tuple[Cycle, Cycle], ...]:
    def same(a: Cycle, b: Cycle) -> bool:
        strokes = np.array([np.ptp(x[one.start:one.stop]) for one in (a, b)])
        length = np.array([one.stop - one.start for one in (a, b)])
        return all(bool(np.ptp(one) < SAME_REACH * one.mean()) for one in (strokes, length))

    return tuple((a, b) for a, b in pairwise(cycles) if b.number == a.number + 1 and same(a, b))


def _split(data: DrivenData, usable: Mask) -> DrivenData:
    """Return the data with what is fitted and what is held out."""
    n = len(data.force)
    fitted, held_out = np.zeros(n, bool), np.zeros(n, bool)
    cycles, at = data.cycles, np.arange(n)
    for one in cycles:
        (held_out if one.held_out else fitted)[data.samples_of(one)] = True
    words = ", ".join(one.label for one in cycles if one.held_out)
    if len(cycles) == 1:
        own = data.samples_of(cycles[0])
        out = (data.phases_of(cycles[0]) * STRETCHES).astype(int) % 3 == 1
        fitted[own[out]], held_out[own[out]], words = False, True, "every third stretch of the cycle"
    if (len(cycles) < 2 and data.kind is LUMPED) or not cycles:
        fitted, held_out, words = at < n // 2, at >= n // 2, "second half of the record"
    elif data.kind is LUMPED:  # a mass forgets nothing that it was not told: the ends count too
        last = data.samples_of(next(one for one in cycles if one.held_out))[0]
        fitted, held_out = at < last, at >= last
        words += " and what follows"
    fitted, held_out = fitted & usable[:n], held_out & usable[:n]
    if min(fitted.sum(), held_out.sum()) < STRETCHES:
        raise UnreliableRecordingError("too little is usable to fit one part and test on another; record more cycles "
                                       "without gaps")
    return replace(data, fitted=fitted, held_out=held_out, held_out_words=words, notes=(*data.notes, *_noticed(data)))


def _noticed(data: DrivenData) -> list[str]:
    """Return warnings about what was recorded; refuse a force that no passive joint has."""
    notes, x, force = [], data.whole.displacement, data.whole_force
    if len(data.cycles) < 2:
        notes.append("fewer than two whole cycles: no repeats tell the noise, and what is held out is not independent")
    work = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x))) / max(1, len(data.cycles))
    if work < BACKWARDS * float(np.ptp(x)) * float(np.ptp(force)):
        raise UnreliableRecordingError("force and displacement: the force gives energy instead of taking it; check the "
                                       "sign of both, and whether their columns are swapped")
    return notes
