"""Mains hum on a channel: a wave of 50 or 60 Hz in periods of another frequency.

As its phase differs from repeat to repeat, their differences hold it, beside gains, delays, zeros and drifts of their
own. Even harmonics alone are looked at: where friction, load or drive differ from repeat to repeat, loops differ by odd
ones, as they are the same to either side. A hum that begins every period anew is not told from the loop by this.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fretflow.experiments.rig.equations import LEVEL
from fretflow.experiments.rig.observation import DIGITIZING, HARMONICS
from fretflow.recordings.loopset import LoopSet

Array = NDArray[np.float64]
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
    squares, freedom, size = np.zeros(3), np.zeros(3), 0.0  # of hum, of other smooth differences, of the rest
    for loops, frequency in blocks:
        samples = len(loops.phase)
        turns = np.arange(samples) / samples
        waves = _even(_wave(np.outer(turns, np.arange(2, HARMONICS + 1, 2))))
        for k in np.flatnonzero((loops.repeats > 1) & np.isfinite(frequency)):
            every = loops.channels[name][k, loops.usable[k]]
            mean = every.mean(axis=0)
            turning, away = _even(_wave(mains / frequency[k] * turns)), _even((every - mean).T)
            own = _even(np.stack([turns, mean, np.gradient(mean)], axis=1))
            basis, _ = np.linalg.qr(np.hstack([own, turning, waves]))
            parts = basis.T @ away
            told, more = parts[3:5], parts[5:]
            squares += np.sum(told**2), np.sum(more**2), np.sum(away**2) - np.sum(parts**2)
            freedom += (len(every) - 1) * np.array([2, basis.shape[1] - 5, len(away) - basis.shape[1]])
            size += (len(every) - 1) * float(np.sum((basis[:, 3:5].T @ turning)**2))
    if not freedom.all() or not squares.all():
        return None
    noise = squares[1:].sum() / freedom[1:].sum()
    if stats.f.sf(squares[1] / freedom[1] / (squares[2] / freedom[2]), freedom[1], freedom[2]) < LEVEL:
        return None
    p_value = float(stats.f.sf(squares[0] / freedom[0] / noise, freedom[0], freedom[1:].sum()))
    amplitude = float(np.sqrt(max(0.0, 2.0 * (squares[0] - freedom[0] * noise) / size)))
    seen = blocks[0][0].channels[name]
    resolved = amplitude > DIGITIZING * (np.nanmax(seen) - np.nanmin(seen))
    return p_value if resolved else 1.0, amplitude


def _wave(turns: Array) -> Array:
    """Return cosine and sine of turns, side by side."""
    return np.column_stack([np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)])


def _even(signals: Array) -> Array:
    """Return the even harmonics of periodic signals (N, any), real and imaginary; white noise keeps its size."""
    lines = np.fft.rfft(signals, axis=0)[2:(len(signals) + 1) // 2:2] * np.sqrt(2.0 / len(signals))
    return np.concatenate([lines.real, lines.imag])
