"""How far repeats of the same loop differ: the floor under which no model can be told from the recording.

Model of a channel at cycle count k, repeat r, sample n (phase)::

    y_krn = (1 + g_kr) m_kn + o_kr + e_krn

with the loop m without its mean, the gain g and the offset o of a repeat, and noise e whose size may depend on the
phase. All are estimated from the differences between repeats alone, never from the residuals of a fit. Few repeats tell
little of a single phase: by chance alone some would seem far surer than others, and `moderated` holds them together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array, quantity, record
from fretflow.recordings.periods import LEVEL

SMOOTH = 5  # harmonics: above, the masses of a rig let nothing through; of white noise of N samples 10 / N lie in these
COLOURED = 0.05  # p-value of white noise below which noise has a colour


@record
class Repeatability:
    """What the repeats of one channel say; in the channel's unit unless stated."""

    mean: Array = quantity("", "(K, N), over the repeats")
    repeats: NDArray[np.int64] = quantity("1", "(K,)")
    noise_sd: Array = quantity("", "(N,), of one sample without gain and offset")
    gain_sd: float = quantity("1")  # between repeats, relative, beyond what noise explains
    offset_sd: float  # between repeats, beyond what noise explains
    repeat_sd: Array = quantity("", "(N,), between repeats in all: the floor of a single loop")
    smooth_excess: float = quantity("1", default=0.0)  # variance of `SMOOTH` harmonics over that of others, less one

    def covariance(self, k: int) -> Array:
        """Return the covariance (N, N) of the mean loop at cycle count `k` by noise, gain and offset."""
        loop = self.mean[k] - self.mean[k].mean()
        one = np.diag(self.noise_sd**2) + self.gain_sd**2 * np.outer(loop, loop) + self.offset_sd**2
        return np.asarray(one / self.repeats[k])


def repeatability(values: Array) -> Repeatability:
    """Return what the repeats of a channel (K, R, N) say, nan where there is no repeat.

    Raises
    ------
    UnreliableRecordingError
        If no cycle count has two repeats.
    """
    there = np.isfinite(values).all(axis=2)
    repeats = there.sum(axis=1)
    freedom = int(np.sum(np.maximum(repeats - 1, 0)))
    if not freedom:
        raise UnreliableRecordingError("loops: no cycle count has two repeats, so nothing tells how far they scatter; "
                                       "record some loops twice")
    mean = np.full((len(values), values.shape[2]), np.nan)
    total, rest, between = np.zeros(values.shape[2]), np.zeros(values.shape[2]), np.zeros(2)
    noise_of_fit, smooth = np.zeros(2), 0.0
    for k in np.flatnonzero(repeats):
        loops = values[k, there[k]]
        mean[k] = loops.mean(axis=0)
        if repeats[k] < 2:
            continue
        basis = np.stack([mean[k] - mean[k].mean(), np.ones(values.shape[2])])
        squares = np.maximum((basis * basis).sum(axis=1), 1e-300)
        away = loops - mean[k]
        fits = away @ basis.T / squares  # (R, gain and offset); the two are orthogonal
        total += np.sum(away**2, axis=0)
        left = away - fits @ basis
        rest += np.sum(left**2, axis=0)
        smooth += _smooth(left)
        between += np.sum(fits**2, axis=0)
        noise_of_fit += (repeats[k] - 1) / squares
    samples = values.shape[2]
    noise = moderated(rest / freedom * samples / (samples - 2), freedom)
    fitted = np.sqrt(np.maximum(between - noise_of_fit * noise.mean(), 0.0) / freedom)
    return Repeatability(mean=mean, repeats=repeats, noise_sd=np.sqrt(noise), gain_sd=float(fitted[0]),
                         offset_sd=float(fitted[1]), repeat_sd=np.sqrt(total / freedom),
                         smooth_excess=_excess(smooth, float(rest.sum()), freedom, samples))


def smooth_waves(samples: int) -> Array:
    """Return the waves (N, 2 `SMOOTH`) of the first harmonics over the phase, each of norm one."""
    angle = 2.0 * np.pi * np.arange(samples)[:, None] / samples * np.arange(1, SMOOTH + 1)
    return np.asarray(np.sqrt(2.0 / samples) * np.hstack([np.cos(angle), np.sin(angle)]))


def moderated(variance: Array, freedom: int) -> Array:
    """Return sample variances (N,) of so many degrees of freedom, moderated by each other.

    The true ones have a scaled inverse chi-squared distribution, whose scale and degrees of freedom the mean and the
    variance of the logarithms tell; one over what is returned is the expected precision of each. Where they scatter no
    more than by chance, all are the same.

    Source: G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) art. 3, sections 3 and 6.2.
    """
    if not (variance > 0.0).all():
        return variance
    logs, half = np.log(variance), 0.5 * freedom
    beyond = float(logs.var(ddof=1) - polygamma(1, half))
    widest, narrowest = 1e-3, 1e6  # half the degrees of freedom of all: from none to as good as no scatter
    if beyond <= polygamma(1, narrowest):
        return np.full(len(variance), variance.mean())
    own = widest if beyond >= polygamma(1, widest) else float(
        np.exp(brentq(lambda at: float(polygamma(1, np.exp(at))) - beyond, np.log(widest), np.log(narrowest))))
    scale = np.exp(logs.mean() - digamma(half) + np.log(half) + digamma(own) - np.log(own))
    return np.asarray((own * scale + half * variance) / (own + half))


def is_unsteady(displacement: Array, force: Array, shapes: Sequence[Array] | None = None) -> bool:
    """Tell whether repeats (K, R, N) differ by a motion, which then does not repeat itself with the drive.

    Most of what they differ by is smooth, and goes with each other in both channels, as what moves a rig does and no
    sensors' noise, whatever its colour: the squared coherence of n independent harmonics is above g by a chance of
    (1 - g)^(n - 1). A change of known `shapes` (K, N) of both, as a parameter makes that scatters, is no such motion.

    Source: J. S. Bendat, A. G. Piersol, Random Data, 4th ed. (2010), 9.2.3.
    """
    left = [deviations(*one) for one in zip((displacement, force), shapes or (None, None), strict=True)]
    freedom = len(left[0]) - int(np.sum(np.isfinite(displacement).all(axis=2).sum(axis=1) > 1))
    smooth = 0.5 * (1.0 + 2.0 * SMOOTH / displacement.shape[2])  # few samples of white noise are smooth by a share
    if freedom < 2 or len(left[0]) != len(left[1]) or max(map(smooth_share, left)) < smooth:
        return False
    a, b = (np.fft.rfft(one)[:, 1:SMOOTH + 1] for one in left)
    powers = np.sum(np.abs(a)**2, axis=0) * np.sum(np.abs(b)**2, axis=0)
    coherence = np.abs(np.sum(a * b.conj(), axis=0))**2 / np.maximum(powers, 1e-300)
    return bool(SMOOTH * np.min((1.0 - np.minimum(coherence, 1.0))**(freedom - 1)) < LEVEL)


def deviations(values: Array, shapes: Array | None = None) -> Array:
    """Return by what repeats (K, R, N) differ from their mean (any, N), without gain, offset and `shapes` (K, N)."""
    parts = [np.zeros((0, values.shape[2]))]
    for k, every in enumerate(values):
        loops = every[np.isfinite(every).all(axis=1)]
        if len(loops) < 2:
            continue
        mean = loops.mean(axis=0)
        known = [mean - mean.mean(), np.ones_like(mean), *([] if shapes is None else [shapes[k]])]
        basis, _ = np.linalg.qr(np.stack(known, axis=1))
        parts.append(loops - mean - (loops - mean) @ basis @ basis.T)
    return np.concatenate(parts)


def smooth_share(left: Array) -> float:
    """Return the share of `deviations` (any, N) that lies in the first `SMOOTH` harmonics."""
    return _smooth(left) / max(float(np.sum(left**2)), 1e-300)


def _smooth(left: Array) -> float:
    """Return the squares of differences (R, N) that lie in the first `SMOOTH` harmonics."""
    return 2.0 / left.shape[1] * float(np.sum(np.abs(np.fft.rfft(left, axis=1)[:, 1:SMOOTH + 1])**2))


def _excess(smooth: float, rest: float, freedom: int, samples: int) -> float:
    """Return `Repeatability.smooth_excess`: zero where an F test takes the noise for white.

    The gain took one of the first harmonics' dimensions, the offset the mean.
    """
    low, high = freedom * (2 * SMOOTH - 1), freedom * (samples - 1 - 2 * SMOOTH)
    if high <= 0 or rest <= smooth:
        return 0.0
    ratio = (smooth / low) / ((rest - smooth) / high)
    return ratio - 1.0 if stats.f.sf(ratio, low, high) < COLOURED else 0.0
