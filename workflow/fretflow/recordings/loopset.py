"""Clean loops on one phase grid, and long records, as the rest of the program takes them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record, to_dataset
from fretflow.recordings.schema import DisplacementOf

if TYPE_CHECKING:
    import xarray as xr

PLATEAU = 0.9  # quantile of a centred force over a loop
FORCES = ("friction_force", "force")  # that a loop is drawn with, the first that there is


def frozen_arrays(arrays: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return `arrays` as a mapping that cannot change, nor can what is in it."""
    fixed = {}
    for name, values in arrays.items():
        fixed[name] = np.array(values, dtype=float) if values.base is not None else values
        fixed[name].setflags(write=False)
    return MappingProxyType(fixed)


def plateau(loops: Array) -> Array:
    """Return the amplitude (K,) of most of each loop (K, N): near the friction limit, without peaks that ring."""
    middle = 0.5 * (loops.max(axis=1) + loops.min(axis=1))
    return np.asarray(np.quantile(np.abs(loops - middle[:, None]), PLATEAU, axis=1))


@record
class LoopSet:
    """Periods of the steady motion at K cycle counts (or conditions), up to R repeats of N samples each.

    A channel is nan throughout a repeat that there is not, or that was left out. Phase counts from the maximum of
    the fundamental of channel `aligned_to`, from `phase[0]` in steps of 2 pi / N.
    """

    cycles: NDArray[np.int64] = quantity("1", "(K,), or the ids of the conditions")
    frequency: Array = quantity("Hz", "(K,), nan where it is not known")
    phase: Array = quantity("rad", "(N,), first one in [0, 2 pi / N)")
    channels: Mapping[str, Array] = quantity("SI", "(K, R, N) each")
    units: Mapping[str, str]
    sd: Mapping[str, float]  # of one sample, where the recording gives it
    calibration_sd: Mapping[str, float]  # of the gain, relative
    displacement_of: DisplacementOf | None
    aligned_to: str

    def check(self) -> None:
        """Check shapes and make the channels read-only.

        Raises
        ------
        InputError
            If a channel has another shape than the rest.
        """
        object.__setattr__(self, "channels", frozen_arrays(self.channels))
        for name in ("units", "sd", "calibration_sd"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        shape = next(iter(self.channels.values())).shape
        for name, values in self.channels.items():
            if values.shape != shape or shape[::2] != (len(self.cycles), len(self.phase)):
                raise InputError(f"loops.{name}: shape {values.shape} where {len(self.cycles)} cycle counts and "
                                 f"{len(self.phase)} samples are due; give every channel the same")

    @property
    def arrays(self) -> xr.Dataset:
        """Return the channels with dimensions (cycles, repeat, phase), a repeat that there is not being nan.

        Coordinates are ``cycles``, ``phase`` in rad and ``frequency`` in Hz; each has its unit in ``attrs["units"]``.
        """
        return to_dataset(
            {name: (("cycles", "repeat", "phase"), values, self.units[name]) for name, values in self.channels.items()},
            {"cycles": (("cycles",), self.cycles, "1"), "phase": (("phase",), self.phase, "rad"),
             "frequency": (("cycles",), self.frequency, "Hz")})

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Return which repeats there are, (K, R)."""
        there = [np.isfinite(values[:, :, 0]) for values in self.channels.values()]
        return np.asarray(np.all(there, axis=0))

    @property
    def repeats(self) -> NDArray[np.int64]:
        """Return the number of usable repeats at each cycle count, (K,)."""
        return np.asarray(self.usable.sum(axis=1), dtype=np.int64)

    @property
    def force_name(self) -> str:
        """Return the name of the force channel.

        Raises
        ------
        InputError
            If there is none.
        """
        for name in FORCES:
            if name in self.channels:
                return name
        raise InputError(f"loops: have no channel {' or '.join(FORCES)}; name the column that holds it")

    @property
    def displacement(self) -> Array:
        """Return the displacement in m, (K, R, N).

        Raises
        ------
        InputError
            If there is none.
        """
        if "displacement" not in self.channels:
            raise InputError("loops: have no channel displacement; name the column that holds it")
        return self.channels["displacement"]

    @property
    def force(self) -> Array:
        """Return the (friction) force in N, (K, R, N)."""
        return self.channels[self.force_name]

    def mean(self, name: str) -> Array:
        """Return the mean of a channel over the usable repeats, (K, N); nan where there are none."""
        values = self.channels[name]
        weight = self.usable[:, :, None] / np.maximum(self.repeats, 1)[:, None, None]
        mean = np.sum(np.where(weight > 0.0, values, 0.0) * weight, axis=1)
        return np.where(self.repeats[:, None] > 0, mean, np.nan)


@record
class Series:
    """One long record of T rows, in order of time."""

    time: Array | None = quantity("s", "(T,); None where only the order of the rows is known")
    channels: Mapping[str, Array] = quantity("SI", "(T,) each, without gaps")
    usable: NDArray[np.bool_] = quantity("", "(T,); false where a row was too far from a measured one")
    units: Mapping[str, str]
    sd: Mapping[str, float]
    calibration_sd: Mapping[str, float]
    displacement_of: DisplacementOf | None

    def check(self) -> None:
        """Make the channels read-only."""
        object.__setattr__(self, "channels", frozen_arrays(self.channels))
        for name in ("units", "sd", "calibration_sd"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(self.usable)

    @property
    def sampling_interval(self) -> float | None:
        """Return the median time from row to row in s, if time is known."""
        return None if self.time is None else float(np.median(np.diff(self.time)))
