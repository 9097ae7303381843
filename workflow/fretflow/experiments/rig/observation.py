"""What a recording of the rig holds, as one vector with its covariance.

Loops are the means over the repeats at every cycle count and condition, thinned to the instants that the model solves
and freed of what lies above its harmonics (arms and sensors ring there); then the worn volume and the map of depth.
Sigma is made of sensor noise and the scatter between repeats (estimated from the repeats alone), calibration gains, and
offsets that no sensor is free of.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array, quantity, record
from fretflow.experiments.loops import HARMONICS
from fretflow.inference.evidence import SIZES
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.periods import noise_sd
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import Repeatability, is_unsteady, repeatability, smooth_waves
from fretflow.recordings.schema import RecordedTest, SweepCondition
from fretflow.structure.sensors import band_limited


@dataclass(frozen=True)
class LoopChannel:
    """What is known of a channel's zero, in sd over the channel's size (see `_size`), and of its mean over a loop."""

    by_loop: float  # lost between recordings
    free: float  # as it was set at rest before the test
    needed: bool = False
    absolute: bool = False  # whether the mean counts: a gain acts on the whole of it
    growing: bool = False  # whether the mean follows the wear over the test: its sensor's gain acts on all of that
    warming: bool = False  # whether it is the distance of parts that grow with heat


# that the model predicts, as far as they were measured
CHANNELS = {"displacement": LoopChannel(by_loop=0.05, free=0.03, needed=True, warming=True),
            "friction_force": LoopChannel(by_loop=0.01, free=0.01, needed=True),
            "excitation": LoopChannel(by_loop=0.002, free=0.02),
            "normal_force": LoopChannel(by_loop=0.003, free=0.01, absolute=True),
            # what it is counted from is unknown: faces meet on asperities
            "approach": LoopChannel(by_loop=0.005, free=3.0, growing=True, warming=True)}
WARMTH = 3e-8  # m, by which a path of a centimetre of steel grows with 0.3 K, as no distance sensor can tell
DEFAULT_WEAR_SD = 0.02  # of the volume or of the largest depth, where nothing tells it
TIMING = 3e-3  # of a period, to which the model and the recording agree on when sliding begins and ends
SYNCHRONISED = 1.5e-3  # of a period, to which a channel is in step with the drive, in all loops alike
CORRELATED = 3.0  # samples over which noise of measured loops is taken to be one where nothing tells


@record
class Piece:
    """One loop's channel, the volume or the map: where it stands in the vector, and what it is of."""

    block: str  # "loops", "sweep", "volume", "map"
    channel: str
    cycles: int
    condition: int | None = None
    start: int = 0
    stop: int = 0
    label: str

    @property
    def place(self) -> slice:
        """Return the rows of the vector."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class Repeats:
    """The repeats (K, R, N) of a channel's loops, and the rows of the vector that hold each loop's mean."""

    values: Array
    places: tuple[slice, ...]


@record
class Observation:
    """The measured vector (M,), the sd of repeats, and how its errors are made."""

    values: Array = quantity("SI", "(M,)")
    variance: Array = quantity("SI^2", "(M,), of independent errors")
    noise: Array = quantity("1", "(M,), share of the variance that repeats show")
    modes: Array = quantity("SI", "(M, B), of errors that samples share")
    floor: Array = quantity("SI", "(M,), sd of a single repeat")
    pieces: tuple[Piece, ...]
    harmonics: int  # of a loop
    aligned_to: str  # channel whose fundamental's maximum is phase zero
    conditions: tuple[SweepCondition, ...]
    points: Array = quantity("m", "(P, 2), of the map")
    repeats: tuple[Repeats, ...] = ()  # of displacement and friction force, by turns
    unsteady: bool = False  # whether the motion does not repeat itself with the drive, as that of all models here does

    @property
    def samples(self) -> int:
        """Return the samples of a loop: those that its harmonics need."""
        return 2 * self.harmonics + 1

    @property
    def counts(self) -> tuple[int, ...]:
        """Return the cycle counts of the loops; where there are none, that of the wear."""
        loops = dict.fromkeys(piece.cycles for piece in self.pieces if piece.block == "loops")
        return tuple(loops) or (max(piece.cycles for piece in self.pieces),)

    @property
    def has_loops(self) -> bool:
        """Tell whether there is more than the wear."""
        return any(piece.block in ("loops", "sweep") for piece in self.pieces)

    def less_sure(self, variance: Array, modes: Array) -> Observation:
        """Return the same with errors that repeats do not show: of a `variance` (M,) each, and `modes` (M, any)."""
        return replace(self, variance=self.variance + variance, modes=np.hstack([self.modes, modes]),
                       noise=self.noise * self.variance / (self.variance + variance))

    def scattering(self, slope: Array) -> Observation:
        """Return the same where a parameter, by which the vector changes with `slope` (M,), differs between repeats.

        What that makes repeats differ by is no sign of a motion that does not repeat itself.
        """
        shapes = [np.stack([np.fft.irfft(np.fft.rfft(slope[place]), one.values.shape[2]) for place in one.places])
                  for one in self.repeats]
        return replace(self, unsteady=any(
            is_unsteady(x.values, force.values, both) for x, force, both in zip(
                self.repeats[::2], self.repeats[1::2], zip(shapes[::2], shapes[1::2], strict=True), strict=True)))

    def until(self, cycles: int) -> tuple[NDArray[np.bool_], Observation]:
        """Return the rows (M,) of the loops up to a cycle count, and an observation of these alone."""
        kept, pieces, size = np.zeros(len(self.values), dtype=bool), [], 0
        for piece in self.pieces:
            if piece.block == "loops" and piece.cycles <= cycles:
                kept[piece.place] = True
                pieces.append(replace(piece, start=size, stop=size + piece.stop - piece.start))
                size = pieces[-1].stop
        return kept, replace(
            self, values=self.values[kept], variance=self.variance[kept], noise=self.noise[kept],
            modes=self.modes[kept], floor=self.floor[kept], pieces=tuple(pieces), conditions=(),
            points=self.points[:0], repeats=())

    def fundamental(self, displacement: Array) -> complex:
        """Return the amplitude in m of a period's displacement (N,), and its phase where the drive's is known."""
        amplitude = 2.0 * complex(np.fft.rfft(displacement)[1]) / len(displacement)
        return amplitude if self.aligned_to == "excitation" else complex(abs(amplitude))

    def rows(self, **wanted: object) -> NDArray[np.bool_]:
        """Return the rows (M,) of the pieces whose fields are as `wanted`."""
        rows = np.zeros(len(self.values), dtype=bool)
        for piece in self.pieces:
            rows[piece.place] = all(getattr(piece, name) == value for name, value in wanted.items())
        return rows


@dataclass
class _Stack:
    """The vector while it is put together."""

    values: list[Array] = field(default_factory=list)
    variance: list[Array] = field(default_factory=list)
    noise: list[Array] = field(default_factory=list)
    floor: list[Array] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    shared: list[tuple[str, slice, Array]] = field(default_factory=list)  # name of an error, where, and its shape there
    repeats: list[Repeats] = field(default_factory=list)

    @property
    def size(self) -> int:
        return sum(map(len, self.values))

    def add(self, piece: Piece, values: Array, variance: Array, floor: Array, more: Array | float = 0.0) -> slice:
        """Add a piece at the end; `more` is the variance of errors that repeats share and so do not show."""
        piece = replace(piece, start=self.size, stop=self.size + len(values))
        self.values.append(values)
        self.variance.append(variance + more)
        self.noise.append(variance / (variance + more))
        self.floor.append(floor)
        self.pieces.append(piece)
        return piece.place


def is_other_motion(one: complex, other: complex) -> bool:
    """Tell whether two fundamentals are of motions that may coexist: they differ by more than the smaller one is."""
    return abs(one - other) > min(abs(one), abs(other))


def observe(recording: Recording) -> Observation:
    """Return the vector of a recording of the rig.

    Raises
    ------
    UnreliableRecordingError
        If it holds neither loops with displacement and friction force nor a map of the worn depth, or too few samples.
    """
    check_blocks(recording)
    stack = _Stack()
    _check_samples(recording)
    sizes = {} if recording.loops is None else _add_loops(stack, recording.loops, None, {})
    if recording.sweep is not None:
        _add_loops(stack, recording.sweep.loops,
                   condition_labels(recording.sweep.conditions, recording.test), sizes)
    last = (recording.test.cycles or 0) if recording.loops is None else int(recording.loops.cycles[-1])
    if recording.wear.worn_volume is not None:
        volume = recording.wear.worn_volume
        sd = recording.wear.worn_volume_sd or DEFAULT_WEAR_SD * volume
        stack.add(Piece(block="volume", channel="worn_volume", cycles=last, label="worn volume"),
                  np.array([volume]), np.array([sd**2]), np.array([sd]))
    points = _add_map(stack, recording, last)
    size, names = stack.size, dict.fromkeys(name for name, _, _ in stack.shared)
    modes = np.zeros((size, len(names)))
    for column, name in enumerate(names):
        for own, place, shape in stack.shared:
            if own == name:
                modes[place, column] = shape
    return Observation(
        values=np.concatenate(stack.values), variance=np.concatenate(stack.variance),
        noise=np.concatenate(stack.noise), modes=modes, floor=np.concatenate(stack.floor),
        pieces=tuple(stack.pieces), harmonics=HARMONICS,
        aligned_to="excitation" if recording.loops is None else recording.loops.aligned_to,
        conditions=() if recording.sweep is None else recording.sweep.conditions, points=points,
        repeats=tuple(stack.repeats), unsteady=any(is_unsteady(x.values, force.values) for x, force in zip(
            stack.repeats[::2], stack.repeats[1::2], strict=True)))


def check_blocks(recording: Recording) -> None:
    """Check that there is what a rig is compared by.

    Raises
    ------
    UnreliableRecordingError
        If there is neither.
    """
    if recording.loops is None and (recording.wear_depth is None or not recording.test.cycles):
        raise UnreliableRecordingError(f"{recording.path}: has no [loops]; a recording of the rig is compared by them, "
                                       "or by [wear_depth] alone at the end of so many test.cycles")


def _check_samples(recording: Recording) -> None:
    """Check that all loops have the samples that their harmonics need.

    Raises
    ------
    UnreliableRecordingError
        If there are too few.
    """
    sweep = None if recording.sweep is None else recording.sweep.loops
    least = 4 * HARMONICS  # what lies above half of their frequency folds into the harmonics
    measured = min((len(loops.phase) for loops in (recording.loops, sweep) if loops is not None), default=least)
    if measured < least:
        raise UnreliableRecordingError(f"{recording.path}: {measured} samples a period are too few to tell the physics "
                                       f"of a rig by; record {least} or more")


def from_zero(loops: Array, phase: Array) -> Array:
    """Return loops (..., N), measured at equidistant `phase` (N,) in rad, by their Fourier series at N from zero."""
    if abs(phase[0]) < 1e-9:
        return loops
    order = np.arange((len(phase) - 1) // 2 + 1)  # the last one of an even number has no phase
    lines = np.fft.rfft(loops)[..., :len(order)] * np.exp(-1j * order * phase[0])
    return np.asarray(np.fft.irfft(lines, len(phase)))


def count_label(cycles: int) -> str:
    """Return what the loop at a cycle count is called."""
    return f"{cycles:,} cycles"


def condition_labels(conditions: Iterable[SweepCondition], test: RecordedTest) -> dict[int, str]:
    """Return what the loop at each condition, by its number, is called: what is not as in the test."""
    labels: dict[int, str] = {}
    for one in conditions:
        other = [f"{word}{value:g} {unit}" for word, value, usual, unit in (
            ("excitation ", one.excitation_amplitude, test.excitation_amplitude, "N"),
            ("load ", one.normal_load, test.normal_load, "N"),
            ("", one.excitation_frequency, test.excitation_frequency, "Hz")) if value not in (None, usual)]
        label = ", ".join(other) or "as in the test"
        labels[one.id] = f"{label} (condition {one.id})" if label in labels.values() else label
    return labels


def measured_loops(recording: Recording) -> dict[str, tuple[Array, Array]]:
    """Return displacement and force (N,) of every loop by its label: means over the repeats at every sample."""
    loops = {} if recording.loops is None else {
        count_label(at): loop for at, loop in _means(recording.loops).items()}
    if recording.sweep is not None:
        labels = condition_labels(recording.sweep.conditions, recording.test)
        loops |= {labels[at]: loop for at, loop in _means(recording.sweep.loops).items()}
    return loops


def _means(loops: LoopSet) -> dict[int, tuple[Array, Array]]:
    force = "friction_force" if "friction_force" in loops.channels else "force"
    x, y = (from_zero(loops.channels[name], loops.phase) for name in ("displacement", force))
    return {int(loops.cycles[k]): (np.nanmean(x[k], axis=0), np.nanmean(y[k], axis=0))
            for k in np.flatnonzero(loops.repeats)}


def _add_loops(stack: _Stack, loops: LoopSet, conditions: Mapping[int, str] | None, sizes: Mapping[str, float]
               ) -> dict[str, float]:
    """Add loops to the vector; return the sizes of all channels so far, `sizes` those of loops before.

    A sensor's zero is one for all loops, those of the test and those at other conditions after it.
    """
    all_sizes = dict(sizes)
    block = "loops" if conditions is None else "sweep"
    names = [name for name in CHANNELS if name in loops.channels]
    if "friction_force" not in names and "force" in loops.channels:
        names.insert(1, "force")
    if "displacement" not in names or len(names) < 2:
        raise UnreliableRecordingError(f"{block}: displacement and friction_force are needed; name their columns")
    for name in names:
        channel = "friction_force" if name == "force" else name
        kind, values = CHANNELS[channel], from_zero(loops.channels[name], loops.phase)
        spread = _spread(values)
        samples, size = spread.mean.shape[1], _size(kind, spread.mean)
        # interpolation between samples, and what no sensor resolves
        least, known, places = SIZES[0] * size, np.flatnonzero(loops.repeats), []
        # noise of a colour is white noise and waves of the first harmonics; both have the variance that repeats show
        excess, waves = spread.smooth_excess, smooth_waves(samples)
        white = spread.noise_sd**2 / (1.0 + excess * waves.shape[1] / samples)
        waves = waves * np.sqrt(excess * white.mean()) if excess else waves[:, :0]
        for k in known:
            mean, repeats = spread.mean[k], int(loops.repeats[k])
            moving = 0.5 * samples * (np.roll(mean, -1) - np.roll(mean, 1))  # in a period
            variance = (white + least**2) / repeats
            condition = None if conditions is None else int(loops.cycles[k])
            cycles = int(loops.cycles[k]) if conditions is None else -1
            label = count_label(cycles) if conditions is None else conditions[int(loops.cycles[k])]
            piece = Piece(block=block, channel=channel, cycles=cycles, condition=condition, label=label)
            floor = np.sqrt(spread.repeat_sd**2 + least**2)
            place = stack.add(piece, mean, variance, floor, (TIMING * moving)**2)
            places.append(place)
            centred, own = mean if kind.absolute else mean - mean.mean(), f"{block} {k} {channel}"
            stack.shared += [(f"{own} wave {j}", place, one / np.sqrt(repeats)) for j, one in enumerate(waves.T)]
            # what a gain of its own does to a repeat's mean is in the offset
            stack.shared += [(f"{own} gain", place, spread.gain_sd / np.sqrt(repeats) * (mean - mean.mean())),
                             (f"{own} offset", place, np.full(samples, np.hypot(
                                 spread.offset_sd / np.sqrt(repeats), _loop_offset(kind, size)))),
                             (f"{channel} synchronisation", place, SYNCHRONISED * moving),
                             (f"{channel} calibration", place, loops.calibration_sd.get(name, 0.0) * (
                                 mean if kind.growing else centred)),
                             (f"{channel} zero", place, np.full(
                                 samples, kind.free * all_sizes.setdefault(channel, size)))]
        if kind.needed:
            stack.repeats.append(Repeats(values[known], tuple(places)))
    return all_sizes


def _loop_offset(channel: LoopChannel, size: float) -> float:
    """Return the sd of what a loop's zero loses against those of other loops."""
    return float(np.hypot(channel.by_loop * size, WARMTH * channel.warming))


def _size(channel: LoopChannel, means: Array) -> float:
    """Return what a channel's zero is compared with: half its largest loop, or what it comes to over the test."""
    if channel.absolute:
        return float(np.nanmax(np.abs(means)))
    if channel.growing:
        return 0.5 * float(np.nanmax(means) - np.nanmin(means))
    return 0.5 * float(np.nanmax(np.ptp(means, axis=-1)))


def _spread(values: Array) -> Repeatability:
    """Return what repeats say; without repeats, the noise is taken from what the samples do from one to the next."""
    there, limited = np.isfinite(values).all(axis=2), band_limited(values, HARMONICS)
    if np.any(there.sum(axis=1) > 1):  # the floor goes by all that a sample holds
        whole = repeatability(values)
        floor = np.full(limited.shape[2], np.sqrt(np.mean(whole.repeat_sd**2)))
        return replace(repeatability(limited), repeat_sd=floor)
    mean = np.where(there[:, 0, None], limited[:, 0], np.nan)
    noise = CORRELATED * float(np.median(noise_sd(values[there[:, 0], 0])))
    flat, within = np.full(limited.shape[2], noise), np.sqrt(limited.shape[2] / values.shape[2])
    return Repeatability(mean=mean, repeats=there.sum(axis=1), noise_sd=within * flat, gain_sd=0.005,
                         offset_sd=noise, repeat_sd=flat)


def _add_map(stack: _Stack, recording: Recording, cycles: int) -> Array:
    if recording.wear_depth is None or "depth" not in recording.wear_depth.channels:
        return np.zeros((0, 2))
    points = recording.wear_depth
    depth = points.channels["depth"]
    sd = points.sd.get("depth", DEFAULT_WEAR_SD * float(np.abs(depth).max()))
    place = stack.add(Piece(block="map", channel="wear_depth", cycles=cycles, label="wear map"),
                      depth, np.full(len(depth), sd**2), np.full(len(depth), sd))
    stack.shared.append(("depth calibration", place, points.calibration_sd.get("depth", 0.0) * depth))
    return np.column_stack([points.channels["x"], points.channels["y"]])
