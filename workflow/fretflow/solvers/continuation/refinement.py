"""More points of a curve at its peak and half-power points, with finer settings."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from math import pi, sqrt

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.continuation.curve import Parabola, arc_lengths, half_power_bracket, summit
from fretflow.solvers.continuation.model import Plane
from fretflow.solvers.continuation.points import Face, ResponsePoint
from fretflow.solvers.continuation.system import ContinuationSystem, CurvePoint
from fretflow.solvers.quasi_static.sample import Array

PEAK_CHANGE = 1e-3
MAX_INSERTIONS = 10


class Refinement:
    """Solves points again, and more of them, with the `fine` system."""

    def __init__(self, face: Face, fine: ContinuationSystem, channel: int, note: Callable[[float], None]) -> None:
        """Take the channel whose peak counts; `note` is told the frequency of each point solved, Hz."""
        self.face, self.fine, self.channel, self.note = face, fine, channel, note
        self.size = len(fine.seen) * (2 * fine.harmonics + 1)

    def refine(self, points: list[ResponsePoint]) -> float:
        """Insert points at the peak and at half its power; return how much the finer settings change its top."""
        if self.top(points) in (0, len(points) - 1):
            return float("nan")
        first, last = summit(self._amplitude(points))
        changes = []
        for k in range(first, last + 1):
            with suppress(NonConvergenceError):  # the point then stays as coarse as it is
                coarse, points[k] = points[k], self._keep(self._finer(points[k].point))
                changes.append(abs(coarse.first_harmonic[self.channel] / points[k].first_harmonic[self.channel] - 1.0))
        with suppress(NonConvergenceError):  # the curve then stays as coarse as it is
            self._refine_peak(points)
        for step in (-1, 1):
            with suppress(NonConvergenceError):
                self._refine_half_power(points, step)
        return float(max(changes, default=np.nan))

    def _refine_peak(self, points: list[ResponsePoint]) -> None:
        for _ in range(MAX_INSERTIONS):
            top = self.top(points)
            if top in (0, len(points) - 1):
                return
            around = points[top - 1:top + 2]
            motion = np.array([p.first_harmonic[self.channel] for p in around])
            arc = arc_lengths(np.array([p.frequency for p in around]), motion)
            fitted = Parabola.through(arc, np.abs(motion))
            first = top - 1 if fitted.vertex < arc[1] else top
            left, right = arc[first - top + 1], arc[first - top + 2]
            share = float(np.clip((fitted.vertex - left) / (right - left), 0.02, 0.98))
            points.insert(first + 1, self._between(points[first], points[first + 1], share))
            new = abs(points[first + 1].first_harmonic[self.channel])
            if abs(new - fitted.value) < PEAK_CHANGE * fitted.value:
                return

    def _refine_half_power(self, points: list[ResponsePoint], step: int) -> None:
        for _ in range(MAX_INSERTIONS):
            amplitude = self._amplitude(points)
            top = int(np.argmax(amplitude))
            bracket = half_power_bracket(amplitude, top, step)
            if bracket is None:
                return
            first, last = sorted(bracket)
            target = amplitude[top] / sqrt(2.0)
            share = (target - amplitude[first]) / (amplitude[last] - amplitude[first])
            points.insert(last, self._between(points[first], points[last], float(np.clip(share, 0.02, 0.98))))
            if abs(abs(points[last].first_harmonic[self.channel]) / target - 1.0) < PEAK_CHANGE:
                return

    def _between(self, a: ResponsePoint, b: ResponsePoint, share: float) -> ResponsePoint:
        """Return the finer point on the plane across the chord from `a` to `b`, at `share` of it.

        Raises
        ------
        NonConvergenceError
            If none is found, or another one that the plane meets far off.
        """
        arms = [_resized(p.point.seen, self.size) for p in (a, b)]
        start, end = (np.append(arm, p.point.omega) for arm, p in zip(arms, (a, b), strict=True))
        unknowns = start + share * (end - start)
        scales = np.append(np.full(len(arms[0]), np.linalg.norm(unknowns[:-1])), unknowns[-1])
        chord = (end - start) / scales
        near = a if share < 0.5 else b
        plane = Plane(unknowns, chord / np.linalg.norm(chord), scales)
        known = near.point if near.system.samples == self.fine.samples else None
        point = self.fine.correct(plane, near.point.end, known)
        if np.linalg.norm((point.unknowns - unknowns) / scales) > 0.5 * np.linalg.norm(chord):
            raise NonConvergenceError("forced response: another point lies across the chord")
        return self._keep(point)

    def _finer(self, point: CurvePoint) -> CurvePoint:
        """Solve `point` again with the fine settings, at its frequency."""
        return self.fine.at_frequency(point.omega, _resized(point.seen, self.size), point.end)

    def _amplitude(self, points: list[ResponsePoint]) -> Array:
        return np.array([abs(p.first_harmonic[self.channel]) for p in points])

    def top(self, points: list[ResponsePoint]) -> int:
        """Return the index of the largest amplitude."""
        return int(np.argmax(self._amplitude(points)))

    def _keep(self, point: CurvePoint) -> ResponsePoint:
        self.note(point.omega / (2.0 * pi))
        return ResponsePoint.of(self.face, self.fine, point, False)


def _resized(seen: Array, size: int) -> Array:
    """Return coefficients (`size`,) with zeros for further harmonics, or without the last ones."""
    return np.concatenate([seen[:size], np.zeros(max(0, size - len(seen)))])
