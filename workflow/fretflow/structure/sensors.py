"""What sensors see of a motion: the channels of one period, or of a long record, on equidistant instants."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record

Array = NDArray[np.float64]

BESIDE = ("friction_force", "arm", "excitation", "normal_force", "approach", "arm_velocity", "arm_acceleration")


def band_limited(periods: Array, harmonics: int) -> Array:
    """Return periods (..., N) by 2 H + 1 equidistant samples (..., 2 H + 1) of their mean and first H harmonics."""
    samples = 2 * harmonics + 1
    kept = np.fft.rfft(periods)[..., :harmonics + 1]
    return np.asarray(samples / periods.shape[-1] * np.fft.irfft(kept, samples))


@record
class Signals:
    """Channels of N equidistant samples.

    Displacement is upper minus lower, force that of the upper specimen on the lower. Where `periodic`, the samples
    are one whole period and its first sample follows the last.

    `elapsed` is how much of the test is over at a period, 0 to 1; a record is the whole test. `arm_velocity` and
    `arm_acceleration` are those of `arm` where they are known better than by differences.
    """

    step: float = quantity("s")
    displacement: Array = quantity("m", "(N,), as the displacement sensor sees it")
    friction_force: Array = quantity("N", "(N,)")
    arm: Array = quantity("m", "(N,), motion of the moving specimen along x")
    excitation: Array | None = quantity("N", "(N,)", default=None)
    normal_force: Array | None = quantity("N", "(N,)", default=None)
    approach: Array | None = quantity("m", "(N,), of the specimens toward each other", default=None)
    arm_velocity: Array | None = quantity("m/s", "(N,)", default=None)
    arm_acceleration: Array | None = quantity("m/s^2", "(N,)", default=None)
    periodic: bool = True
    elapsed: float = quantity("1", default=0.0)

    def check(self) -> None:
        """Check that all channels have one length.

        Raises
        ------
        InputError
            Naming the channel.
        """
        for name in BESIDE:
            values = getattr(self, name)
            if values is not None and values.shape != self.displacement.shape:
                raise InputError(f"signals: {name} has {values.shape} samples, displacement {self.displacement.shape}")

    def band_limited(self, harmonics: int) -> Signals:
        """Return one whole period by 2 H + 1 samples of its first H harmonics."""
        channels: dict[str, Any] = {name: band_limited(values, harmonics) for name in ("displacement", *BESIDE)
                    if (values := getattr(self, name)) is not None}
        step = self.step * len(self.displacement) / (2 * harmonics + 1)
        return replace(self, step=step, **channels)

    def rate(self, values: Array) -> Array:
        """Return the time derivative of a channel (N,): of its Fourier series, or by central differences."""
        if not self.periodic:
            return np.asarray(np.gradient(values, self.step))
        return np.fft.irfft(self._turning() * np.fft.rfft(values), len(values))

    def delayed(self, values: Array, delay: float) -> Array:
        """Return a channel (N,) that comes `delay` s later; a record keeps its first value until then."""
        if not self.periodic:
            time = self.step * np.arange(len(values))
            return np.interp(time - delay, time, values)
        return np.fft.irfft(np.exp(-delay * self._turning()) * np.fft.rfft(values), len(values))

    def filtered(self, values: Array, numerator: Array, denominator: Array) -> Array:
        """Return a channel (N,) after a linear filter of proper transfer function, stable and not zero at rest.

        Parameters
        ----------
        values : ndarray, shape (N,)
        numerator, denominator : ndarray
            Polynomials of ``i omega``, highest power first, in units of s.

        Notes
        -----
        A period is filtered in the frequency domain. A record is taken as linear between its samples, for which the
        recursion is exact, and as at rest before its first one.
        """
        if self.periodic:
            turning = 1j * self.angular_frequencies
            response = np.polyval(numerator, turning) / np.polyval(denominator, turning)
            return np.fft.irfft(response * np.fft.rfft(values), len(values))
        from scipy.signal import cont2discrete, lfilter, lfilter_zi  # takes as long to import as all the rest

        # with the step as the unit of time, so that the coefficients are of one size
        system = [np.trim_zeros(part / self.step**np.arange(len(part))[::-1], "f") for part in (numerator, denominator)]
        above, below, _ = cont2discrete(system, 1.0, method="foh")
        above = np.ravel(above)
        return np.asarray(lfilter(above, below, values, zi=lfilter_zi(above, below) * values[0])[0])

    @property
    def velocity(self) -> Array:
        """Return that of the moving specimen, (N,) m/s."""
        return self.rate(self.arm) if self.arm_velocity is None else self.arm_velocity

    @property
    def acceleration(self) -> Array:
        """Return that of the moving specimen, (N,) m/s^2."""
        return self.rate(self.velocity) if self.arm_acceleration is None else self.arm_acceleration

    @property
    def progress(self) -> Array:
        """Return how much of the test is over at each sample, (N,): from 0 to 1 over a record."""
        n = len(self.displacement)
        return np.full(n, self.elapsed) if self.periodic else np.linspace(0.0, 1.0, n)

    @property
    def angular_frequencies(self) -> Array:
        """Return those of the channels' discrete Fourier series, (N // 2 + 1,) rad/s."""
        return 2.0 * np.pi * np.fft.rfftfreq(len(self.displacement), self.step)

    def _turning(self) -> NDArray[np.complex128]:
        turning = 1j * self.angular_frequencies
        if len(self.displacement) % 2 == 0:
            turning[-1] = 0.0  # the last one has no phase
        return turning
