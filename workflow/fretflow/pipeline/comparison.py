"""What a run found beside what was measured on the same joint: one row a case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case, SlidingRegime
from fretflow.contact.law import ContactState
from fretflow.core.store import write_csv
from fretflow.experiments.facts.quantities import mean_sliding
from fretflow.pipeline.run_records import RunRecords
from fretflow.solvers.periodic import PeriodicSolution

WITHIN = 0.1  # difference to a measured value that passes without a remark


@dataclass(frozen=True)
class CaseComparison:
    """A case's results and the measured values; None where there is none."""

    name: str
    sliding: float | None = None  # m, peak to peak, mean of the test
    volume: float | None = None  # m^3, at the end of the test
    regime: SlidingRegime | None = None  # unworn
    worn_regime: SlidingRegime | None = None  # at the end of the test
    measured_sliding: float | None = None  # m
    measured_volume: float | None = None  # m^3
    measured_regime: SlidingRegime | None = None
    seconds: float = 0.0  # of the computing, whenever that was
    failure: str = ""

    @property
    def sliding_error(self) -> float | None:
        """Return the relative difference of the sliding distance to the measured one."""
        return _relative(self.sliding, self.measured_sliding)

    @property
    def volume_error(self) -> float | None:
        """Return the relative difference of the worn volume to the measured one."""
        return _relative(self.volume, self.measured_volume)

    @property
    def remarkable(self) -> bool:
        """Return whether a measured value is missed by more than `WITHIN`, or the regime is another."""
        errors = [error for error in (self.sliding_error, self.volume_error) if error is not None]
        other = None not in (self.worn_regime, self.measured_regime) and self.worn_regime != self.measured_regime
        return other or any(abs(error) > WITHIN for error in errors)


def compare(case: Case, folders: Mapping[str, Path], seconds: float) -> CaseComparison:
    """Return the row of `case` from its complete stages in `folders`, as far as they go."""
    measured = case.measured
    computed: dict[str, object] = {}
    run = RunRecords(folders)
    if run.has("solve"):
        computed["regime"] = sliding_regime(run.unworn, run.areas)
        if run.has("wear"):
            history, periods = run.history, run.periods
            computed |= {"sliding": mean_sliding(history, int(history.cycles[-1])), "volume": float(history.volume[-1]),
                         "worn_regime": sliding_regime(periods[max(periods)], run.areas)}
    return CaseComparison(
        case.name, measured_sliding=measured.sliding_distance, measured_volume=measured.worn_volume,
        measured_regime=measured.regime, seconds=seconds, **computed)  # type: ignore[arg-type]


def sliding_regime(solution: PeriodicSolution, areas: NDArray[np.float64]) -> SlidingRegime:
    """Return how the faces slide: gross slip if at some instant nothing that touches sticks.

    Nodes without area do not count.
    """
    state = solution.state[:, areas > 0.0]
    slips = np.any(state == ContactState.SLIP, axis=1)
    sticks = np.any(state == ContactState.STICK, axis=1)
    if np.any(slips & ~sticks):
        return SlidingRegime.GROSS_SLIP
    return SlidingRegime.PARTIAL_SLIP if slips.any() else SlidingRegime.STICK


def write_comparison(path: Path, rows: Sequence[CaseComparison]) -> Path:
    """Write `rows` to the CSV file `path`; empty where there is no value."""
    columns = {
        "case": [row.name for row in rows],
        "sliding_distance_m": [_cell(row.sliding) for row in rows],
        "measured_sliding_distance_m": [_cell(row.measured_sliding) for row in rows],
        "worn_volume_m3": [_cell(row.volume) for row in rows],
        "measured_worn_volume_m3": [_cell(row.measured_volume) for row in rows],
        "regime_unworn": [_cell(row.regime) for row in rows],
        "regime_worn": [_cell(row.worn_regime) for row in rows],
        "measured_regime": [_cell(row.measured_regime) for row in rows],
        "time_s": [f"{row.seconds:.1f}" for row in rows],
        "failure": [row.failure for row in rows]}
    return write_csv(path, columns)


def _relative(computed: float | None, measured: float | None) -> float | None:
    return None if computed is None or measured is None else computed / measured - 1.0


def _cell(value: float | SlidingRegime | None) -> str:
    if value is None:
        return ""
    return value.value if isinstance(value, SlidingRegime) else repr(value)
