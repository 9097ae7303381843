"""Mains hum on a channel: a wave of 50 or 60 Hz in periods of another frequency.

As its phase differs from repeat to repeat, their differences hold it, beside gains, delays, zeros and drifts of their
own. Even harmonics alone are looked at: where friction, load or drive differ from repeat to repeat, loops differ by odd
ones, as they are the same to either side. A hum that begins every period anew, as where a trigger does, is told by the
rig's equations of motion, which lack it as they do no force that the motion makes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fretflow.core.records import Array
from fretflow.experiments.loops import HARMONICS
from fretflow.experiments.rig.equations import Equations, Unknown, blocks_of, further_forces
from fretflow.inference.evidence import SIZES
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.periods import LEVEL
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import SMOOTH

MAINS = (50.0, 60.0)  # Hz (IEC 60038)


def hum_between_repeats(blocks: list[tuple[LoopSet, Array]], name: str, mains: float) -> tuple[float, float] | None:
    """Return p-value and amplitude of a hum by which repeats of a channel differ; None if they differ otherwise too.

    What no sensor resolves is none.

    Parameters
    ----------
    blocks
        Loops, and the frequency (K,) of each in Hz.
    name
        The channel.
    mains
        Frequency of the hum in Hz.
    """
    seen = np.concatenate([one.channels[name].ravel() for one, _ in blocks])
    least = SIZES[0] * (np.nanmax(seen) - np.nanmin(seen))
    squares, freedom, size = np.zeros(3), np.zeros(3), 0.0  # of hum, of other smooth differences, of the rest
    for loops, frequency in blocks:
        samples = len(loops.phase)
        turns = np.arange(samples) / samples
        for k in np.flatnonzero((loops.repeats > 1) & np.isfinite(frequency)):
            every = loops.channels[name][k, loops.usable[k]]
            mean = every.mean(axis=0)
            turning, own = _wave(mains / frequency[k] * turns), np.stack([turns, mean, np.gradient(mean)], axis=1)
            for first in (2, 3):  # even harmonics, and those odd ones of which a sensor's ringing makes noise as well
                waves = _wave(np.outer(turns, np.arange(first, HARMONICS + 1, 2)))
                basis, _ = np.linalg.qr(_lines(np.hstack([own, turning, waves]), first))
                away = _lines((every - mean).T, first)
                parts = basis.T @ away
                even = first == 2
                own_freedom = (len(every) - 1) * np.array([2 * even, basis.shape[1] - 5, len(away) - basis.shape[1]])
                squares += even * np.sum(parts[3:5]**2), np.sum(parts[5:]**2), np.sum(away**2) - np.sum(parts**2)
                squares += [0.0, *own_freedom[1:] * np.square(least)]
                freedom += own_freedom
                size += even * (len(every) - 1) * float(np.sum((basis[:, 3:5].T @ _lines(turning, first))**2))
    if not freedom.all() or not squares.all():
        return None
    noise = squares[1] / freedom[1]  # of about its frequency: filters and resampling take off higher ones
    if stats.f.sf(squares[1] / freedom[1] / (squares[2] / freedom[2]), freedom[1], freedom[2]) < LEVEL:
        return None
    p_value = float(stats.f.sf(squares[0] / freedom[0] / noise, freedom[0], freedom[1]))
    amplitude = float(np.sqrt(max(0.0, 2.0 * (squares[0] - freedom[0] * noise) / size)))
    return p_value if amplitude > least else 1.0, amplitude


def hum_begun_anew(recording: Recording, equations: Equations, mains: float) -> tuple[float, str, float] | None:
    """Return a hum that begins every period of a channel anew: lack of fit with it (p-value), channel and amplitude.

    The equations hold with it and not without it, even if `further_forces` act on the arm; None if none has to be.
    Periods of the motion may have been closed by straight lines, which is tried as well.
    """
    shapes = []
    for loops, frequency in [one for one in blocks_of(recording) if "excitation" in one[0].channels]:
        turns = (np.arange(len(loops.phase)) + 0.5) / len(loops.phase)
        shapes += [_seen(mains / frequency[k], turns) for k in np.nonzero(loops.usable)[0]]
    if (plain := equations.solve()).holds:
        return None
    felt, driven = equations.friction / equations.force, equations.damped / equations.displacement
    forces = further_forces(recording, equations)
    bending, waves, hums = equations.solve(forces), np.concatenate(shapes).T, []
    # a filter of a channel, whatever it does to each harmonic, grows with the channel from loop to loop as no hum does
    filtered = min(equations.solve([one * np.where(equations.harmonic == n, unit, 0.0) for n in range(1, SMOOTH)
                                    for unit in (1.0, 1j)]).squares
                   for one in (equations.displacement, equations.friction, equations.drive))
    factors = {"displacement": 1.0, "friction_force": felt + plain.values[Unknown.COMPLIANCE], "excitation": driven}
    level = LEVEL / (len(MAINS) * len(factors))
    for name, factor in factors.items():
        # what forces on the rig do may be bent by them as well, unless the hum alone leaves far less than they
        more = forces if name == "displacement" else []
        for count in (2, 3) if more else (2,):
            one = equations.solve([*more, *factor * waves[:count]])
            if one.holds and one.squares < filtered and (
                    one.better_than(bending, level) if more else one.odds_over(bending) > 1.0 / level):
                hums.append((one.lack_of_fit, name, float(np.hypot(*one.values[-count:][:2]))))
                break
    return max(hums, default=None)


def _seen(turns_a_period: float, turns: Array) -> NDArray[np.complex128]:
    """Return the harmonics that cosine and sine of a hum, and a straight line, have in a period (harmonics, 3)."""
    signals = np.column_stack([_wave(turns_a_period * turns), turns])
    return np.asarray(np.fft.rfft(signals, axis=0)[1:SMOOTH + 1] * 2.0 / len(turns))


def _wave(turns: Array) -> Array:
    """Return cosine and sine of turns, side by side."""
    return np.column_stack([np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)])


def _lines(signals: Array, first: int) -> Array:
    """Return every second harmonic of periodic signals (N, any), real and imaginary; white noise keeps its size."""
    lines = np.fft.rfft(signals, axis=0)[first:(len(signals) + 1) // 2:2] * np.sqrt(2.0 / len(signals))
    return np.concatenate([lines.real, lines.imag])
