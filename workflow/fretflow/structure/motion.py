"""A measured motion and its rates, by local polynomials.

A polynomial of degree 5 is fitted to the samples within T to either side (Savitzky and Golay, Anal. Chem. 36, 1964),
which gives displacement, velocity and acceleration at once, without phase. At angular frequency w they come out as::

    1 - (w T)^6 / 33264,    1 - (w T)^6 / 61776,    1 - (w T)^4 / 792      of their size

to leading order, and white noise of standard deviation s in n = 2 T / h + 1 samples at the steps h gives::

    225/64 s^2 / n,    3675/64 s^2 / (n T^2),    2205/4 s^2 / (n T^4)      as variances

T is the largest at which what is smoothed away is no more than the noise.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb, sqrt

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record

DEGREE = 5
ORDER = 6  # of the differences that leave noise alone
MEDIAN_OF_NORMAL = 0.6744897502  # of its absolute value, in standard deviations
CENTRE = 225.0 / 64.0
EXCESS = 1.1  # of the noise, beyond which what is smoothed away is motion too
WIDTHS = tuple(dict.fromkeys(round(2.0**(0.5 * k)) for k in range(4, 19)))  # samples to either side
FEWEST = 16


@record
class Motion:
    """A motion that drives a joint: N equidistant samples.

    `lean` is how far the joint is loaded at the first sample: 1 where it slides to positive x, -1 to negative, 0 at
    rest without force.

    Examples
    --------
    >>> import fretflow as ff
    >>> import numpy as np
    >>> t = np.arange(200) / 20e3
    >>> x, v = 5e-6 * np.sin(628.0 * t), 3.14e-3 * np.cos(628.0 * t)
    >>> ff.Motion(step=1 / 20e3, displacement=x, velocity=v, acceleration=-(628.0**2) * x).lean
    0.0
    """

    step: float = quantity("s")
    displacement: Array = quantity("m", "(N,)")
    velocity: Array = quantity("m/s", "(N,)")
    acceleration: Array = quantity("m/s^2", "(N,)")
    lean: float = quantity("1", default=0.0)

    def check(self) -> None:
        """Check shapes and ranges.

        Raises
        ------
        InputError
            Naming the channel.
        """
        if self.displacement.ndim != 1 or not len(self.displacement):
            raise InputError(f"motion: displacement {self.displacement.shape} must have one or more samples in a row")
        for name in ("displacement", "velocity", "acceleration"):
            values = getattr(self, name)
            if values.shape != self.displacement.shape or not np.all(np.isfinite(values)):
                raise InputError(f"motion: {name} must be finite and have {len(self.displacement)} samples; "
                                 "close gaps first")
        if not (self.step > 0.0 and -1.0 <= self.lean <= 1.0):
            raise InputError(f"motion: step {self.step} s must be positive and lean {self.lean} within -1 and 1")

    def thinned(self, every: int) -> Motion:
        """Return every `every`-th sample."""
        return replace(self, step=self.step * every, displacement=self.displacement[::every],
                       velocity=self.velocity[::every], acceleration=self.acceleration[::every])

    @property
    def time(self) -> Array:
        """Return the time (N,) in s since the first sample."""
        return self.step * np.arange(len(self.displacement))


@record
class MeasuredMotion:
    """A motion with what is known of its errors."""

    motion: Motion
    half_width: int = quantity("1")  # samples to either side
    noise: float = quantity("m")  # standard deviation of the displacement as measured


def measure(displacement: Array, step: float, half_width: int | None = None) -> MeasuredMotion:
    """Return the motion of a measured displacement.

    Parameters
    ----------
    displacement : ndarray, shape (N,), m
        Equidistant samples without gaps.
    step : float, s
    half_width : int, optional
        Samples to either side of each that its polynomial is fitted to.

    Raises
    ------
    InputError
        If there are too few samples, some are not finite, or the width does not fit.
    """
    x = np.asarray(displacement, dtype=float)
    if x.ndim != 1 or len(x) < FEWEST or not np.all(np.isfinite(x)):
        raise InputError(f"displacement: {x.shape} must be {FEWEST} or more finite samples in a row; close gaps first")
    noise = noise_floor(x)
    width = best_width(x, noise) if half_width is None else half_width
    if not 3 <= width <= (len(x) - 1) // 2:
        raise InputError(f"displacement: half_width {width} must lie between 3 and {(len(x) - 1) // 2} samples")
    x, v, a = (_smoothed(x, step, width, order) for order in (0, 1, 2))
    return MeasuredMotion(motion=Motion(step=step, displacement=x, velocity=v, acceleration=a), half_width=width,
                          noise=noise)


def noise_floor(values: Array) -> float:
    """Return the standard deviation of the white noise in a smooth channel (N,), from its sixth differences.

    By their median, so that a few jumps do not matter; where more than half of them are zero, by their mean square.
    """
    differences = np.diff(values, ORDER)
    scale = sqrt(comb(2 * ORDER, ORDER))
    median = float(np.median(np.abs(differences))) / MEDIAN_OF_NORMAL
    return (median if median > 0.0 else float(np.sqrt(np.mean(differences**2)))) / scale


def best_width(displacement: Array, noise: float) -> int:
    """Return the largest half width at which displacements (N,) differ from the smoothed ones by the `noise` (m) alone.

    Of the noise a polynomial over n samples follows the share ``225/64 / n``.
    """
    best: int = WIDTHS[0]
    for width in WIDTHS:
        if 2 * width + 1 > len(displacement):
            break
        left = noise * sqrt(1.0 - CENTRE / (2 * width + 1))
        if float(np.std(displacement - _smoothed(displacement, 1.0, width, 0))) > EXCESS * left:
            break
        best = width
    return best


def _smoothed(values: Array, step: float, width: int, derivative: int) -> Array:
    from scipy.signal import savgol_filter  # takes as long to import as all the rest

    return np.asarray(savgol_filter(values, 2 * width + 1, DEGREE, derivative, step))
