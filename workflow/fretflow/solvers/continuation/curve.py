"""The forced response as a curve, and what is read off it: peak and half-power damping."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record, to_dataset

if TYPE_CHECKING:
    import xarray as xr

CHANNELS = ("block", "arm", "relative", "upper", "lower")
SUMMIT = 0.99  # of the largest amplitude
FOLD = 1e-3  # of the frequency
SAME_BRANCH = 0.02  # relative distance of first harmonics


class SweepDirection(IntEnum):
    """Which way a curve was followed."""

    DOWN = -1
    UP = 1


@record
class ResponseCurve:
    """Periods under a force of constant amplitude, in the order in which they were found along the curves.

    Channels are x motions: block, arm, area mean of the faces' relative displacement, upper and lower observation
    point. The upward curve comes first. A branch is a stretch between turning points; branches that both curves
    went along have one number. Harmonics and ranges are in m.

    Examples
    --------
    >>> import fretflow as ff
    >>> curve = ff.continue_response(problem, 20, 400)  # doctest: +SKIP
    >>> curve.receptance("block").max()  # m/N  # doctest: +SKIP
    """

    excitation: float = quantity("N")
    frequency: NDArray[np.float64] = quantity("Hz", "(P,)")
    first_harmonic: NDArray[np.complex128] = quantity("m", "(P, channels), x = Re X exp(i omega t)")
    peak_to_peak: NDArray[np.float64] = quantity("m", "(P, channels)")
    direction: NDArray[np.int8] = quantity("1", "(P,), 1 up, -1 down")
    branch: NDArray[np.int64] = quantity("1", "(P,)")
    multiplier: NDArray[np.float64] = quantity("1", "(P,), largest modulus of the Floquet multipliers, nan where "
                                               "stability follows from that of the points around")
    stable: NDArray[np.bool_] = quantity("1", "(P,)")
    bridged: NDArray[np.bool_] = quantity("1", "(P,), the curve could not be followed from the point before")
    iterations: NDArray[np.int64] = quantity("1", "(P,)")
    residual: NDArray[np.float64] = quantity("1", "(P,), of the rig's equations, relative to the excitation")
    samples: NDArray[np.int64] = quantity("1", "(P,), per period")
    sampling_error: float = quantity("1")  # change of the first harmonic near the peak with finer samples; nan: no peak
    channels: tuple[str, ...] = quantity("", "(channels,)", coordinate=True, default=CHANNELS)

    @property
    def arrays(self) -> xr.Dataset:
        """Return the points as labelled arrays, dimensions (point, channel); units as attributes.

        ``amplitude`` in m and ``phase`` in rad behind the force are of the first harmonic, ``frequency`` in Hz is a
        coordinate of the points, in their order along the curve.
        """
        plane, along = ("point", "channel"), ("point",)
        return to_dataset(
            {"amplitude": (plane, np.abs(self.first_harmonic), "m"),
             "phase": (plane, np.mod(-np.angle(self.first_harmonic), 2.0 * np.pi), "rad"),
             "peak_to_peak": (plane, self.peak_to_peak, "m"),
             **{name: (along, getattr(self, name), "1") for name in ("multiplier", "stable", "bridged")}},
            {"frequency": (along, self.frequency, "Hz"), "direction": (along, self.direction, "1"),
             "branch": (along, self.branch, "1"), "channel": (("channel",), list(self.channels), ""),
             "excitation": ((), self.excitation, "N")})

    def receptance(self, channel: str = "block") -> NDArray[np.float64]:
        """Return first-harmonic amplitude per unit force (P,) in m/N.

        Raises
        ------
        InputError
            If there is no such channel.
        """
        return np.asarray(np.abs(self.first_harmonic[:, channel_index(channel, self.channels)]) / self.excitation)

    def along(self, direction: SweepDirection) -> NDArray[np.int64]:
        """Return the indices of the points of one direction, in order."""
        return np.flatnonzero(self.direction == direction)

    def turning_points(self, direction: SweepDirection) -> NDArray[np.int64]:
        """Return the indices at which the curve of `direction` turns back: there a sweep jumps.

        A fold narrower than 0.1 % of the frequency is left out: time samples make some.
        """
        own = self.along(direction)
        return np.asarray(own[turns(self.frequency[own])])


@record
class Peak:
    """A resonance: its largest first harmonic, and damping by the half-power points where both are in the curve."""

    channel: str
    frequency: float = quantity("Hz")
    amplitude: float = quantity("m")
    lower_half_power: float | None = quantity("Hz")
    upper_half_power: float | None = quantity("Hz")
    damping_ratio: float | None = quantity("1")
    reason: str  # why there is no damping ratio; empty where there is one


@dataclass(frozen=True)
class Parabola:
    """The largest value of a parabola, and where."""

    vertex: float
    value: float

    @classmethod
    def through(cls, x: NDArray[np.float64], y: NDArray[np.float64]) -> Parabola:
        """Fit in least squares to `x` and `y`, (3,) or more; where it has no vertex among them, the largest of them."""
        top = int(np.argmax(y))
        origin, scale = float(x[top]), float(x[-1] - x[0])
        a, b, c = np.polyfit((x - origin) / scale, y, 2)
        place = -b / (2.0 * a) if a < 0.0 else np.inf
        if not x[0] <= origin + scale * place <= x[-1]:
            return cls(origin, float(y[top]))
        return cls(origin + scale * float(place), float(c - b * b / (4.0 * a)))


def channel_index(channel: str, channels: tuple[str, ...] = CHANNELS) -> int:
    """Return the column of `channel`.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if channel not in channels:
        raise InputError(f"channel {channel!r}: unknown; choose one of {', '.join(channels)}")
    return channels.index(channel)


def read_peak(curve: ResponseCurve, channel: str = "block", direction: SweepDirection = SweepDirection.UP) -> Peak:
    """Read the largest resonance off the curve of one direction.

    The damping ratio is ``(f2 - f1) / (f2 + f1)`` of the half-power points f1 < f2, as for a linear oscillator. Where
    both directions go along one branch all its points count: each way's own tell a flat peak's place to half a per mil.
    """
    own, column = curve.along(direction), channel_index(channel, curve.channels)
    if not np.ptp(curve.branch):
        own = np.unique(curve.frequency, return_index=True)[1][::int(direction)]
    f, x = curve.frequency[own], curve.first_harmonic[own, column]
    a = np.abs(x)
    top = int(np.argmax(a))
    frequency, amplitude = float(f[top]), float(a[top])
    ends: list[float | None] = [None, None]
    reason = "the amplitude is largest at an end of the frequency range"
    if top not in (0, len(a) - 1):
        first, last = summit(a)
        around = slice(first, last + 1)
        arc = arc_lengths(f[around], x[around])
        fitted = Parabola.through(arc, a[around])
        frequency, amplitude = _along(arc, f[around], fitted.vertex), fitted.value
        sides = [half_power_bracket(a, top, step) for step in (-1, 1)]
        ends = [None if side is None else _crossing(f, a, side) for side in sides][::int(direction)]
        reason = _why_no_damping(ends, len(curve.turning_points(direction)))
    low, high = ends
    damping = (high - low) / (high + low) if not reason and low is not None and high is not None else None
    return Peak(channel=channel, frequency=frequency, amplitude=amplitude, lower_half_power=low,
                upper_half_power=high, damping_ratio=damping, reason=reason)


def _why_no_damping(ends: list[float | None], turning_points: int) -> str:
    missing = [side for side, end in zip(("below", "above"), ends, strict=True) if end is None]
    if missing:
        return f"the amplitude does not fall to half the power {' and '.join(missing)} the peak within the range"
    return "the curve turns back, so that its width measures no damping" if turning_points else ""


def arc_lengths(frequency: NDArray[np.float64], motion: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the length along a curve (P,), each chord relative to the frequency and amplitude at its ends."""
    df = np.diff(frequency) / (0.5 * (frequency[1:] + frequency[:-1]))
    dx = np.abs(np.diff(motion)) / (0.5 * (np.abs(motion[1:]) + np.abs(motion[:-1])))
    return np.concatenate([[0.0], np.cumsum(np.hypot(df, dx))])


def summit(amplitude: NDArray[np.float64]) -> tuple[int, int]:
    """Return the first and last of the points about the largest, not at an end, that lie within 1 % of it.

    At least its neighbours: a few samples a period make a flat peak uneven by some tenths of a per cent.
    """
    top = int(np.argmax(amplitude))
    high = amplitude >= SUMMIT * amplitude[top]
    first = top - int(np.argmin(np.append(high[top::-1], False))) + 1
    last = top + int(np.argmin(np.append(high[top:], False))) - 1
    return min(first, top - 1), max(last, top + 1)


def half_power_bracket(amplitude: NDArray[np.float64], top: int, step: int) -> tuple[int, int] | None:
    """Return the neighbours between which the amplitude first falls to half the power, going by `step` from `top`."""
    k = top
    while 0 <= k + step < len(amplitude):
        if amplitude[k + step] * sqrt(2.0) <= amplitude[top]:
            return k, k + step
        k += step
    return None


def turns(frequency: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices at which a sequence (P,) turns back by more than 0.1 % before it goes on."""
    indices: list[int] = []
    way, far = float(np.sign(np.diff(frequency)[:1].sum())), 0
    for k, value in enumerate(frequency):
        if way * (value - frequency[far]) >= 0.0:
            far = k
        elif way * (frequency[far] - value) > FOLD * frequency[far]:
            indices.append(far)
            way, far = -way, k
    return np.array(indices, dtype=np.int64)


def label_branches(curves: list[tuple[NDArray[np.float64], NDArray[np.complex128]]]) -> list[NDArray[np.int64]]:
    """Return numbers of the stretches between turning points of curves (frequency (P,), first harmonic (P, c)).

    A stretch that lies on an earlier one takes its number.
    """
    known: list[tuple[NDArray[np.float64], NDArray[np.complex128]]] = []
    labels: list[NDArray[np.int64]] = []
    for frequency, motion in curves:
        label = np.zeros(len(frequency), dtype=np.int64)
        ends = [0, *map(int, turns(frequency)), len(frequency) - 1]
        fresh = len(known)
        for first, last in pairwise(ends):
            stretch = slice(first, last + 1)
            order = first + np.argsort(frequency[stretch])
            f, x = frequency[order], motion[order]
            same = [k for k in range(fresh) if _coincide(f, x, *known[k])]
            label[stretch] = same[0] if same else len(known)
            if not same:
                known.append((f, x))
        labels.append(label)
    return labels


def _coincide(f: NDArray[np.float64], x: NDArray[np.complex128], g: NDArray[np.float64],
              y: NDArray[np.complex128]) -> bool:
    inside = (f >= g[0]) & (f <= g[-1])
    if not inside.any():
        return False
    expected = np.column_stack([np.interp(f[inside], g, column) for column in y.T])
    apart = np.linalg.norm(x[inside] - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return float(np.median(apart)) < SAME_BRANCH


def _crossing(f: NDArray[np.float64], a: NDArray[np.float64], bracket: tuple[int, int]) -> float:
    """Return the frequency of half the power in a bracket, by interpolation of the amplitude's logarithm."""
    i, k = bracket
    share = np.log(a[i] * sqrt(2.0) / a.max()) / np.log(a[i] / a[k])
    return float(f[i] + share * (f[k] - f[i]))


def _along(arc: NDArray[np.float64], f: NDArray[np.float64], place: float) -> float:
    """Return the frequency at a place of the arc."""
    return float(np.interp(place, arc, f))
