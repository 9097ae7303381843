"""The wear history: what is kept of every wear step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import WearScheme
from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record, to_dataset, unit_of
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

if TYPE_CHECKING:
    import xarray as xr


@record
class WearSettings:
    """How far and how the wear is marched."""

    coefficient: float = quantity("m^2/N")
    cycles: int = quantity("1")
    scheme: WearScheme = WearScheme.EXPLICIT
    stops: tuple[int, ...] = ()  # cycle counts to land on, besides the end; states there are kept
    max_depth_per_jump: float | None = quantity("m", default=None)
    tolerance: float = quantity("1", default=1e-2)  # of an implicit jump, by its largest depth
    vanishing_rate: float = quantity("1", default=1e-6)
    upper_share: float = quantity("1", default=0.5)

    def check(self) -> None:
        """Check kinds and ranges.

        Raises
        ------
        InputError
            Naming the field.
        """
        if self.scheme not in [*WearScheme]:
            raise InputError(f"wear.scheme: must be {' or '.join(WearScheme)}, got {self.scheme!r}")
        object.__setattr__(self, "scheme", WearScheme(self.scheme))  # of text too
        self._check_kinds()
        if not self.coefficient >= 0.0:
            raise InputError(f"wear.coefficient: must not be negative, got {self.coefficient}")
        if self.cycles < 0:
            raise InputError(f"cycles: must not be negative, got {self.cycles}")
        if any(not 0 <= stop <= self.cycles for stop in self.stops):
            raise InputError(f"cycles: asked {self.stops} must lie between 0 and the test's {self.cycles}")
        if self.max_depth_per_jump is not None and not self.max_depth_per_jump > 0.0:
            raise InputError(f"wear.max_depth_per_jump: must be positive, got {self.max_depth_per_jump}")
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"wear.tolerance: must lie between 0 and 1, got {self.tolerance}")
        for name in ("vanishing_rate", "upper_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"wear.{name}: must lie between 0 and 1, got {getattr(self, name)}")

    def _check_kinds(self) -> None:
        for name in ("coefficient", "tolerance", "vanishing_rate", "upper_share", "max_depth_per_jump"):
            value = getattr(self, name)
            if not isinstance(value, Real) and (value is not None or name != "max_depth_per_jump"):
                raise InputError(f"wear.{name}: {value!r} is no number")
        if not isinstance(self.stops, Sequence | np.ndarray) or not all(isinstance(stop, Real) for stop in self.stops):
            raise InputError(f"cycles: stops = {self.stops!r} must be a sequence of cycle counts")

    def next_stop(self, cycles: int) -> int:
        """Return the first asked cycle count after `cycles`."""
        return min((stop for stop in (*self.stops, self.cycles) if stop > cycles), default=self.cycles)


@record
class WearStep:
    """The worn contact after a jump; step 0 is unworn."""

    slow: SlowState
    rate: NDArray[np.float64] = quantity("m", "(nodes,), depth per cycle")
    response: CycleResponse
    proposed_jump: float = quantity("1")  # next jump by error control; nan without
    shortened: bool  # the jump to here was cut at the stability bound
    solves: int  # periodic solutions since the start

    @property
    def cycles(self) -> int:
        """Return the cycles since the start."""
        return round(self.slow.cycles)

    @property
    def depth(self) -> NDArray[np.float64]:
        """Return the depth worn off both faces together, (nodes,), m."""
        return self.slow.depth


@record
class WearHistory:
    """State at the start of the test and after each jump; K rows, row 0 is unworn.

    Depth is that of both faces together; `upper_share` of it is taken from the upper face. `memory` is what laws over
    cycles remember at each row, see `SlowState`.
    """

    cycles: NDArray[np.int64] = quantity("1", "(K,)", coordinate=True)
    depth: NDArray[np.float64] = quantity("m", "(K, nodes)")
    rate: NDArray[np.float64] = quantity("m", "(K, nodes), depth per cycle")
    volume: NDArray[np.float64] = quantity("m^3", "(K,)")
    dissipated_energy: NDArray[np.float64] = quantity("J", "(K,), per cycle")
    sliding_distance: NDArray[np.float64] = quantity("m", "(K,), area mean, peak to peak")
    energy: NDArray[np.float64] = quantity("J", "(K,), dissipated since the start")
    approach: NDArray[np.float64] = quantity("m", "(K,), of the specimens since the start, at their observed points")
    memory: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    upper_share: float = quantity("1")
    solves: int  # periodic solutions that the history took
    shortened_jumps: int = 0  # jumps that were cut at the explicit scheme's stability bound
    stopped_by: str  # "cycles" or "vanishing rate"

    @property
    def arrays(self) -> xr.Dataset:
        """Return the history with dimension cycles, ``depth`` and ``rate`` (cycles, node); units as attributes."""
        several = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)}
        labelled = {name: (("cycles", "node")[:values.ndim], values, unit_of(WearHistory, name))
                    for name, values in several.items()}
        return to_dataset(labelled, {"cycles": labelled.pop("cycles")})

    def slow(self, row: int) -> SlowState:
        """Return the slow state at `row`; -1 is the end."""
        return SlowState(cycles=float(self.cycles[row]), depth=self.depth[row], energy=float(self.energy[row]),
                         memory={name: np.asarray(values[row]) for name, values in self.memory.items()})


def collect(steps: Sequence[WearStep], areas: NDArray[np.float64], upper_share: float,
            stopped_by: str) -> WearHistory:
    """Return the history of `steps`; `areas` (nodes,) in m^2."""
    depth = np.array([step.depth for step in steps])
    approach = np.array([step.response.approach for step in steps])
    return WearHistory(
        cycles=np.array([step.cycles for step in steps], dtype=np.int64),
        depth=depth,
        rate=np.array([step.rate for step in steps]),
        volume=depth @ areas,
        dissipated_energy=np.array([step.response.dissipated_energy for step in steps]),
        sliding_distance=np.array([step.response.sliding_distance for step in steps]),
        energy=np.array([step.slow.energy for step in steps]),
        approach=approach - approach[0],
        memory={name: np.array([step.slow.memory[name] for step in steps]) for name in steps[0].slow.memory},
        upper_share=upper_share,
        solves=steps[-1].solves,
        shortened_jumps=sum(step.shortened for step in steps),
        stopped_by=stopped_by)
