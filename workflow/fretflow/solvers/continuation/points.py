"""Points found along a response curve: what is kept of each, and which are stable."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from fretflow.solvers.continuation.curve import CHANNELS, turns
from fretflow.solvers.continuation.system import ContinuationSystem, CurvePoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.candidate_nodes import restrict
from fretflow.solvers.quasi_static.sample import Array
from fretflow.solvers.stability import Around, floquet_multipliers, is_stable

NEARBY, STRAIGHT = 0.1, 0.9  # cosines of a bend: with less a point is passed by, with less it is left aside
JUDGED = 10  # of so many points one has its stability found by itself


@dataclass(frozen=True)
class Face:
    """The nodes within reach, the problem of these alone, and that of all."""

    nodes: NDArray[np.bool_]
    part: PeriodicProblem
    whole: PeriodicProblem

    @classmethod
    def of(cls, problem: PeriodicProblem, nodes: NDArray[np.bool_]) -> Face:
        """Return the face of `problem` with `nodes` (n,) within reach."""
        return cls(nodes, problem if nodes.all() else restrict(problem, nodes), problem)

    def moved(self, internal: Array, free: Array, forces: Array, loads: Array) -> Array:
        """Return the relative displacement (N, 3 n) of all nodes under the forces (N, 3 m) of those within reach."""
        b = self.whole.boundary
        moved = forces @ b.flexibility[np.repeat(self.nodes, 3)]
        return np.asarray(moved + internal @ b.motion.T + free @ b.free.T + loads @ b.input_motion.T)


@dataclass(frozen=True)
class ResponsePoint:
    """A solved point of the curve with what is kept of it: what moves, and where the faces touch."""

    system: ContinuationSystem
    point: CurvePoint
    first_harmonic: NDArray[np.complex128]
    peak_to_peak: Array
    touched: NDArray[np.bool_]
    bridged: bool

    @property
    def frequency(self) -> float:
        """Return the frequency in Hz."""
        return self.point.omega / (2.0 * pi)

    @classmethod
    def of(cls, face: Face, system: ContinuationSystem, point: CurvePoint, bridged: bool) -> ResponsePoint:
        """Return what is kept of `point`, a root of `system` on `face`."""
        period, part = system.period(point), face.part
        internal = system.motion(point)
        loads = system.at(point.omega).loads_at(2.0 * np.pi * np.arange(len(internal)) / len(internal))
        free = part.boundary.free_motion(internal, period.displacement, loads)
        moved, interface = face.moved(internal, free, period.force, loads), face.whole.interface
        outputs = part.boundary.observe(internal, period.displacement, period.force, loads)
        outputs["relative"] = interface.mean(moved[:, 0::3])
        motion = np.column_stack([along_x(outputs[name]) for name in channels_of(part)])
        first_harmonic = 2.0 * np.fft.rfft(motion, axis=0)[1] / len(motion)
        touched = (interface.gap + moved[:, 2::3]).min(axis=0) < 0.0
        return cls(system, point.without_history(), first_harmonic, np.ptp(motion, axis=0), touched, bridged)


def channels_of(problem: PeriodicProblem) -> tuple[str, ...]:
    """Return the names of what a response curve of `problem` keeps: on the rig `CHANNELS`."""
    outputs = problem.boundary.outputs
    return CHANNELS if set(CHANNELS) - {"relative"} <= set(outputs) else ("relative", *outputs)


def along_x(output: Array) -> Array:
    """Return the first component of an output, (N,) or (N, k)."""
    return output if output.ndim == 1 else output[:, 0]


class Trail:
    """The points of a curve followed before, to be met again the other way round.

    Across a gap it does not lead: that is to be found, and said, again.
    """

    def __init__(self, points: list[ResponsePoint]) -> None:
        """Take the points in the order in which they were found."""
        beyond = [*(p.bridged for p in points[1:]), False]
        self._left = [(p.point, gap) for p, gap in zip(points, beyond, strict=True)]

    @property
    def left(self) -> int:
        """Return how many points lie ahead."""
        return len(self._left)

    def pass_to(self, left: int) -> None:
        """Go on to where so many points lie ahead."""
        del self._left[left:]

    def ahead(self, now: CurvePoint, along: Array, distance: float) -> CurvePoint | None:
        """Return the next point if it lies within `distance` of `now`, where `along` leads, else None."""
        while self._left:
            point, gap = self._left[-1]
            chord = (point.unknowns - now.unknowns) / now.scales
            length = float(np.linalg.norm(chord))
            if chord @ along > NEARBY * length:
                return point if not gap and length < distance and chord @ along > STRAIGHT * length else None
            self._left.pop()
        return None


def judge(points: list[ResponsePoint], top: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return the largest Floquet multipliers, nan where not found, and which points are stable, (P,) each.

    Computed are those of every tenth point, of the ends, the peak, turning points, gaps and their neighbours, and
    ever more between points that differ. All others lie between two that agree.
    """
    last = len(points) - 1
    gaps = [k for k, p in enumerate(points) if p.bridged]
    special = [*turns(np.array([p.frequency for p in points])), top, *gaps]
    todo = {*range(0, last, JUDGED), last, *(int(k + s) for k in special for s in (-1, 0, 1) if 0 <= k + s <= last)}
    judged: dict[int, tuple[float, bool]] = {}
    while todo:
        judged |= {k: _judge_one(points[k]) for k in todo}
        known = sorted(judged)
        todo = {(a + b) // 2 for a, b in pairwise(known) if b - a > 1 and judged[a][1] != judged[b][1]}
    nearest = [max(k for k in known if k <= i) for i in range(last + 1)]
    return (np.array([judged[k][0] if k == i else np.nan for i, k in enumerate(nearest)]),
            np.array([judged[k][1] for k in nearest]))


def _judge_one(kept: ResponsePoint) -> tuple[float, bool]:
    """Return the largest modulus of the Floquet multipliers, and whether the period is stable."""
    system, point = kept.system, kept.point
    at = system.at(point.omega)
    multipliers = floquet_multipliers(at.boundary.internal, system.march.system, system.period(point), kept.frequency,
                                      Around.of(at, system.motion(point)))
    return float(abs(multipliers[0])), is_stable(multipliers)
