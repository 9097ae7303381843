"""What sensors see of a motion: the channels of one period, or of a long record, on equidistant instants."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record

BACKWARDS = -0.05  # of the rectangle about a loop: work that no friction gives back
MIN_SAMPLES = 16  # of a loop: fewer tell neither reversal nor plateau

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
        """Return a channel (N,) that comes `delay` s later; a record keeps its first value until then.

        Between samples it is a cubic, which unlike a line leaves noise nearly as it is.
        """
        if not self.periodic:
            from scipy.interpolate import CubicSpline  # takes as long to import as all the rest

            time = self.step * np.arange(len(values))
            return np.asarray(CubicSpline(time, values)(np.clip(time - delay, time[0], time[-1])))
        return np.fft.irfft(np.exp(-delay * self._turning()) * np.fft.rfft(values), len(values))

    def smoothed(self, values: Array, delay: float, share: float) -> Array:
        """Return a channel (N,) after 1 / `share` equal low-passes in a row, no whole number needed.

        They come to a `delay` in s together; without a share the delay is all. A record is at rest before its start.
        """
        if share == 0.0:
            return self.delayed(values, delay)
        if self.periodic:
            return np.fft.irfft((1.0 + share * delay * self._turning())**(-1.0 / share) * np.fft.rfft(values),
                                len(values))
        from scipy.special import gammainc  # takes as long to import as all the rest

        # the answer to an impulse is a gamma density: of each sample the part that lies about it
        ends = self.step * (np.arange(len(values)) + 0.5)
        weight = np.diff(gammainc(1.0 / share, ends / (share * delay)), prepend=0.0)
        rest = values[0]
        return np.asarray(rest + np.convolve(values - rest, weight)[:len(values)])

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


class Senses(Protocol):
    """What changes the channels on their way from the joint to the recording, at a place of its own."""

    id: ClassVar[str]
    sensed_at: ClassVar[int]

    def sense(self, signals: Signals) -> Signals:
        """Return what the sensors show of `signals`."""


SensesT = TypeVar("SensesT", bound=Senses)


def in_sensing_order(effects: Iterable[SensesT]) -> list[SensesT]:
    """Return `effects` as their `sense` follow each other on the way from the joint to the recording, then by id."""
    return sorted(effects, key=lambda effect: (effect.sensed_at, effect.id))


@record
class HysteresisLoop:
    """One closed steady loop, in order of time.

    Displacement (N,) in m is that of the upper side relative to the lower, force (N,) in N that of the upper specimen
    on the lower, so that the loop encloses a positive dissipated energy.

    Examples
    --------
    >>> import fretflow as ff
    >>> import numpy as np
    >>> phase = 2.0 * np.pi * np.arange(64) / 64
    >>> loop = ff.HysteresisLoop(displacement=5e-6 * np.cos(phase), force=20.0 * np.cos(phase + 0.4))
    >>> round(ff.read_loop(loop).dissipated_energy * 1e6, 1)  # uJ: pi X F sin 0.4 = 122.3
    122.1
    """

    displacement: Array = quantity("m", "(N,)")
    force: Array = quantity("N", "(N,)")

    def check(self) -> None:
        """Check that the loop can be read.

        Raises
        ------
        InputError
            If the arrays do not match, are too short, not finite or constant, or the loop runs the wrong
            way round.
        """
        x, force = self.displacement, self.force
        if x.ndim != 1 or x.shape != force.shape or len(x) < MIN_SAMPLES:
            raise InputError(f"loop: displacement {x.shape} and force {force.shape} must be arrays of one "
                             f"length, {MIN_SAMPLES} samples or more")
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(force))):
            raise InputError("loop: displacement or force is NaN or infinite; clean the recording first")
        if not (np.ptp(x) > 0.0 and np.ptp(force) > 0.0):
            raise InputError("loop: displacement or force is constant; nothing can be read off it")
        if dissipated_energy(self) < BACKWARDS * np.ptp(x) * np.ptp(force):
            raise InputError("loop: its energy is negative; reverse the sign of one channel, or displacement and "
                             "force are swapped")


def dissipated_energy(loop: HysteresisLoop) -> float:
    """Return the loop's area in J, by the trapezoidal rule over the closed polygon."""
    x, force = loop.displacement, loop.force
    return 0.5 * float((force[1:] + force[:-1]) @ (x[1:] - x[:-1]) + (force[0] + force[-1]) * (x[0] - x[-1]))
