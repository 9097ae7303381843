"""Curves that are being followed, kept in a file: interrupted ones go on from there, to the same numbers.

A step depends on nothing but what the file holds (see `ContinuationSystem.begin_step`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import quantity, record
from fretflow.core.store import read_record, write_record
from fretflow.solvers.continuation.curve import SweepDirection
from fretflow.solvers.continuation.model import FORMER, Secants
from fretflow.solvers.continuation.points import ResponsePoint, Trail
from fretflow.solvers.continuation.system import ContinuationSystem, CurvePoint
from fretflow.solvers.quasi_static.sample import Array, SampleState

RARELY = 20.0  # times as long as writing took, until the file is written again: a twentieth of the time


@dataclass
class Trace:
    """A curve as far as it has been followed: its points, the unit chord that leads on and the arc to try."""

    direction: SweepDirection
    points: list[ResponsePoint]
    along: Array
    arc: float
    ended: bool = False


@record
class SavedTraces:
    """The curves followed so far, one after the other; what leads on is that of the last."""

    nodes: NDArray[np.bool_] = quantity("1", "(n,), within reach")
    points: Mapping[str, NDArray[Any]]
    along: Array = quantity("1", "(n_a + 1,)")
    arc: float = quantity("1")
    ended: bool
    left: NDArray[np.int64] = quantity("1", "(T,), points ahead of each trail")
    derivative: Array = quantity("N/m", "(n_a, n_a + 1) or (0, 0)")
    returning: Array = quantity("1", "(3 m, 3 m) or (0, 0)")


class Checkpoint:
    """The file of curves that are being followed; without one nothing is kept.

    Raises
    ------
    StoreError
        If the file cannot be read, or later written.
    """

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self.saved = read_record(file, SavedTraces) if file is not None and file.is_file() else None
        self._due = 0.0

    def save(self, nodes: NDArray[np.bool_], traces: Sequence[Trace], system: ContinuationSystem,
             trails: Sequence[Trail]) -> None:
        """Write `traces`, of which the last is being followed with `system` along `trails`, unless just written."""
        now = monotonic()
        if self.file is None or now < self._due:
            return
        last, (derivative, returning) = traces[-1], system.memory
        write_record(self.file, SavedTraces(
            nodes=nodes, points=_columns(traces), along=last.along, arc=last.arc, ended=last.ended,
            left=np.array([trail.left for trail in trails], dtype=np.int64), derivative=derivative,
            returning=returning))
        written = monotonic()
        self._due = written + RARELY * (written - now)

    def resume(self, direction: SweepDirection, system: ContinuationSystem, trails: Sequence[Trail]) -> Trace | None:
        """Return the saved curve of `direction`, if any, and set `system` and `trails` to go on from there."""
        saved = self.saved
        if saved is None or direction not in saved.points["direction"]:
            return None
        rows = np.flatnonzero(saved.points["direction"] == direction)
        points = [_point_of_row(system, saved.points, int(row)) for row in rows]
        if rows[-1] < len(saved.points["direction"]) - 1:
            return Trace(direction, points, saved.along, saved.arc, ended=True)
        system.begin_step((saved.derivative.copy(), saved.returning.copy()))
        for trail, left in zip(trails, saved.left, strict=True):
            trail.pass_to(int(left))
        return Trace(direction, points, saved.along.copy(), saved.arc, saved.ended)


def _columns(traces: Sequence[Trace]) -> dict[str, NDArray[Any]]:
    """Return all points of `traces` by rows; secants, up to ten a point, are filled up with zeros."""
    kept = [one for trace in traces for one in trace.points]
    points = [one.point for one in kept]
    pairs = np.zeros((len(points), 2, len(points[0].residual), FORMER))
    for row, point in zip(pairs, points, strict=True):
        count = point.secants.defects.shape[1]
        row[0, :, :count], row[1, :, :count] = point.secants.defects, point.secants.residuals
    return {
        "direction": np.concatenate([np.full(len(t.points), t.direction, dtype=np.int8) for t in traces]),
        "first_harmonic_m": np.array([one.first_harmonic for one in kept]),
        "peak_to_peak_m": np.array([one.peak_to_peak for one in kept]),
        "touched": np.array([one.touched for one in kept]), "bridged": np.array([one.bridged for one in kept]),
        "seen_m": np.array([p.seen for p in points]), "other_m": np.array([p.other for p in points]),
        "omega_rad_s": np.array([p.omega for p in points]), "sticks": np.array([p.sticks for p in points]),
        "displacement_m": np.array([p.end.displacement for p in points]),
        "force_N": np.array([p.end.force for p in points]), "state": np.array([p.end.state for p in points]),
        "residual_N": np.array([p.residual for p in points]), "norm": np.array([p.norm for p in points]),
        "iterations": np.array([p.iterations for p in points]),
        "secants": pairs, "secant_count": np.array([p.secants.defects.shape[1] for p in points])}


def _point_of_row(system: ContinuationSystem, columns: Mapping[str, NDArray[Any]], row: int) -> ResponsePoint:
    """Return the point of one row."""
    c = {name: values[row].copy() for name, values in columns.items()}
    defects, residuals = (np.ascontiguousarray(part[:, :int(c["secant_count"])]) for part in c["secants"])
    point = CurvePoint(c["seen_m"], c["other_m"], float(c["omega_rad_s"]),
                       SampleState(c["displacement_m"], c["force_N"], c["state"]), bool(c["sticks"]), None,
                       c["residual_N"], float(c["norm"]), Secants(defects, residuals), int(c["iterations"]))
    return ResponsePoint(system, point, c["first_harmonic_m"], c["peak_to_peak_m"], c["touched"], bool(c["bridged"]))
