"""What sensors see of a motion: the channels of one period, or of a long record, on equidistant instants."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record

Array = NDArray[np.float64]


@record
class Signals:
    """Channels of N equidistant samples.

    Displacement is upper minus lower, force that of the upper specimen on the lower. Where `periodic`, the samples
    are one whole period and its first sample follows the last.
    """

    step: float = quantity("s")
    displacement: Array = quantity("m", "(N,), as the displacement sensor sees it")
    friction_force: Array = quantity("N", "(N,)")
    arm: Array = quantity("m", "(N,), motion of the moving specimen along x")
    excitation: Array | None = quantity("N", "(N,)", default=None)
    normal_force: Array | None = quantity("N", "(N,)", default=None)
    approach: Array | None = quantity("m", "(N,), of the specimens toward each other", default=None)
    periodic: bool = True

    def check(self) -> None:
        """Check that all channels have one length.

        Raises
        ------
        InputError
            Naming the channel.
        """
        for name in ("friction_force", "arm", "excitation", "normal_force", "approach"):
            values = getattr(self, name)
            if values is not None and values.shape != self.displacement.shape:
                raise InputError(f"signals: {name} has {values.shape} samples, displacement {self.displacement.shape}")

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

    def filtered(self, values: Array, response: NDArray[np.complex128]) -> Array:
        """Return a channel (N,) after a linear filter; `response` (N // 2 + 1,) at `angular_frequencies`."""
        return np.fft.irfft(response * np.fft.rfft(values), len(values))

    @property
    def angular_frequencies(self) -> Array:
        """Return those of the channels' discrete Fourier series, (N // 2 + 1,) rad/s."""
        return 2.0 * np.pi * np.fft.rfftfreq(len(self.displacement), self.step)

    def _turning(self) -> NDArray[np.complex128]:
        turning = 1j * self.angular_frequencies
        if len(self.displacement) % 2 == 0:
            turning[-1] = 0.0  # the last one has no phase
        return turning
