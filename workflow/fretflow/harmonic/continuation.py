"""Forced response by pseudo-arc-length continuation.

From each end of the frequency range the curve of periods is followed to where it leaves the range, around turning
points, so that several periods at one frequency are all found. A step's length is measured relative to the motion and
the frequency themselves and set by the effort of Newton and by how far the curve bent. At the peak and its half-power
points more periods are solved, with finer settings. Where a curve cannot be followed (samples that begin to stick
make it jagged) it is taken up again at a frequency further on, and the point is marked as bridged.
Equations: `continuation_system`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import NonConvergenceError
from fretflow.harmonic.continuation_curve import (
    Direction,
    Parabola,
    ResponseCurve,
    arc_lengths,
    channel_index,
    half_power_bracket,
    label_branches,
)
from fretflow.harmonic.continuation_system import ArmSystem, Point
from fretflow.harmonic.periodic import PeriodicProblem
from fretflow.harmonic.stability import floquet_multipliers, is_stable

Array = NDArray[np.float64]
EFFORT = 4  # Newton steps of a good arc
BEND = 0.4  # rad between good arcs
FAR = 2.0  # arcs; a root beyond is on another part of the curve
PEAK_CHANGE = 1e-3
MAX_INSERTIONS = 10
BRIDGES = (0.002, 0.005, 0.01, 0.02, 0.05)  # of the frequency
LOAD_STEPS = tuple(0.1 * k for k in range(1, 11))
MAX_POINTS = 600


@dataclass(frozen=True)
class Sweep:
    """Range and settings of a forced response.

    `harmonics` and `samples` serve along the curve; `fine_harmonics` and `fine_samples` at the peak and its
    half-power points. Arcs are relative to motion and frequency.
    """

    start: float  # Hz
    stop: float  # Hz
    harmonics: int = 15
    samples: int = 64
    fine_harmonics: int = 25
    fine_samples: int = 256
    tolerance: float = 1e-6
    max_iterations: int = 8
    first_arc: float = 0.05
    longest_arc: float = 0.2
    shortest_arc: float = 2e-3
    channel: str = "block"  # whose peak is refined
    directions: tuple[Direction, ...] = field(default=(Direction.UP, Direction.DOWN))


@dataclass(frozen=True)
class _Found:
    """A point of the curve with what is kept of it."""

    point: Point
    first_harmonic: NDArray[np.complex128]
    peak_to_peak: Array
    multiplier: float
    stable: bool
    bridged: bool

    @property
    def frequency(self) -> float:
        return self.point.omega / (2.0 * pi)


def respond(problem: PeriodicProblem, sweep: Sweep, note: Callable[[float], None]) -> ResponseCurve:
    """Return the forced response of `problem` over the range of `sweep`; `note` is told each frequency solved.

    Raises
    ------
    NonConvergenceError
        Naming the frequency, with the residual history of the last attempt.
    """
    runs: dict[Direction, list[_Found]] = {}
    for direction in sweep.directions:
        runs[direction] = _Follower(problem, sweep, note).follow(direction, [r[-1].point for r in runs.values()])
    return _curve(problem, sweep, runs)


class _Follower:
    """Follows the curve of one problem."""

    def __init__(self, problem: PeriodicProblem, sweep: Sweep, note: Callable[[float], None]) -> None:
        self.problem, self.sweep, self.note = problem, sweep, note
        self.system = ArmSystem(problem, sweep.harmonics, sweep.samples, sweep.tolerance, sweep.max_iterations)
        self.fine = ArmSystem(problem, sweep.fine_harmonics, sweep.fine_samples, sweep.tolerance,
                              sweep.max_iterations)

    def follow(self, direction: Direction, reached: list[Point]) -> list[_Found]:
        """Return the points in order; `reached` are ends of other curves, from which to start if nothing serves."""
        found = [self._keep(self.system, self._start(direction, reached))]
        self._trace(found, direction)
        self._refine(found)
        return found

    def _start(self, direction: Direction, reached: list[Point]) -> Point:
        """Solve at the end of the range where `direction` begins, from rest if possible."""
        s = self.sweep
        omega = 2.0 * pi * (s.start if direction is Direction.UP else s.stop)
        try:
            pressed = self.system.march.preloaded(self.problem.frictional_preload)
            return self.system.at_frequency(omega, self.system.guess(omega), pressed)
        except NonConvergenceError as error:
            there = [p for p in reached if abs(p.omega - omega) < 1e-9 * omega]
            if there:
                return there[-1]
            return self._loaded(omega, error)

    def _loaded(self, omega: float, error: NonConvergenceError) -> Point:
        """Raise the excitation step by step, from the rig at rest."""
        arm: Array = np.zeros(2 * self.sweep.harmonics + 1)
        start, before = self.system.march.preloaded(self.problem.frictional_preload), 0.0
        for share in LOAD_STEPS:
            part = _with_excitation(self.system, self.problem.excitation * share)
            try:
                point = part.at_frequency(omega, arm * (share / before if before else 1.0), start)
            except NonConvergenceError:
                raise error from None
            arm, start, before = point.arm, point.end, share
        return point

    def _trace(self, found: list[_Found], direction: Direction) -> None:
        s, low, high = self.system, 2.0 * pi * self.sweep.start, 2.0 * pi * self.sweep.stop
        now = found[0].point
        along = s.tangent(now, np.append(np.zeros(len(now.arm)), float(direction)))
        arc = self.sweep.first_arc
        while len(found) < MAX_POINTS:
            try:
                new, arc = self._arc(now, along, arc)
            except NonConvergenceError as error:
                new, arc = self._bridge(now, np.sign(along[-1]), error), self.sweep.first_arc
                if low < new.omega < high:
                    found.append(self._keep(s, new, bridged=True))
                    along, now = s.tangent(new, np.append(np.zeros(len(new.arm)), np.sign(along[-1]))), new
                    continue
            if not low < new.omega < high:
                found.append(self._keep(s, self._end(now, new, low if new.omega <= low else high)))
                return
            found.append(self._keep(s, new))
            chord = (new.unknowns - now.unknowns) / new.scales
            chord /= np.linalg.norm(chord)
            bend = float(np.arccos(np.clip(chord @ along / np.linalg.norm(along), -1.0, 1.0)))
            arc *= float(np.clip(min(2.0 ** (0.5 * (EFFORT - new.iterations)), BEND / max(bend, 1e-3)), 0.5, 1.6))
            arc, along, now = min(arc, self.sweep.longest_arc), chord, new
        raise NonConvergenceError(f"forced response: not out of the frequency range after {MAX_POINTS} points, near "
                                  f"{now.omega / (2.0 * pi):.6g} Hz; take a smaller range")

    def _arc(self, now: Point, along: Array, arc: float) -> tuple[Point, float]:
        """Return the next point and the arc that led there."""
        while True:
            try:
                new = self.system.correct(now.unknowns + arc * along * now.scales, along, now.scales, now.end)
                if np.linalg.norm((new.unknowns - now.unknowns) / now.scales) < FAR * arc:
                    return new, arc
                raise NonConvergenceError(f"forced response near {now.omega / (2.0 * pi):.6g} Hz: the curve has a gap")
            except NonConvergenceError:
                if arc < self.sweep.shortest_arc:
                    raise
            # the last chord leads on smoothly over kinks, the tangent where the curve bends much
            arc, along = 0.4 * arc, self.system.tangent(now, along)

    def _bridge(self, now: Point, way: float, error: NonConvergenceError) -> Point:
        """Go on at a frequency further on, where the curve cannot be followed."""
        for relative in BRIDGES:
            omega = now.omega * (1.0 + way * relative)
            for guess in (now.arm, self.system.guess(omega)):
                with suppress(NonConvergenceError):
                    return self.system.at_frequency(omega, guess, now.end)
        raise error

    def _end(self, inside: Point, outside: Point, omega: float) -> Point:
        """Return the point at the end of the range, `omega`, between two points."""
        share = (omega - inside.omega) / (outside.omega - inside.omega)
        return self.system.at_frequency(omega, inside.arm + share * (outside.arm - inside.arm), inside.end)

    def _refine(self, found: list[_Found]) -> None:
        """Insert points at the peak and at half its power."""
        channel = channel_index(self.sweep.channel)
        top = _top(found, channel)
        if top in (0, len(found) - 1):
            return
        for k in (top - 1, top, top + 1):
            found[k] = self._keep(self.fine, self._finer(found[k].point))
        self._refine_peak(found, channel)
        for step in (-1, 1):
            self._refine_half_power(found, channel, step)

    def _refine_peak(self, found: list[_Found], channel: int) -> None:
        for _ in range(MAX_INSERTIONS):
            top = _top(found, channel)
            if top in (0, len(found) - 1):
                return
            around = found[top - 1:top + 2]
            arc = arc_lengths(np.array([p.frequency for p in around]),
                              np.array([p.first_harmonic[channel] for p in around]))
            fitted = Parabola.through(arc, np.array([abs(p.first_harmonic[channel]) for p in around]))
            first = top - 1 if fitted.vertex < arc[1] else top
            left, right = arc[first - top + 1], arc[first - top + 2]
            share = float(np.clip((fitted.vertex - left) / (right - left), 0.02, 0.98))
            found.insert(first + 1, self._between(found[first], found[first + 1], share))
            new = abs(found[first + 1].first_harmonic[channel])
            if abs(new - fitted.value) < PEAK_CHANGE * fitted.value:
                return

    def _refine_half_power(self, found: list[_Found], channel: int, step: int) -> None:
        for _ in range(MAX_INSERTIONS):
            amplitude = np.array([abs(p.first_harmonic[channel]) for p in found])
            top = int(np.argmax(amplitude))
            bracket = half_power_bracket(amplitude, top, step)
            if bracket is None:
                return
            first, last = sorted(bracket)
            target = amplitude[top] / sqrt(2.0)
            share = (target - amplitude[first]) / (amplitude[last] - amplitude[first])
            found.insert(last, self._between(found[first], found[last], float(np.clip(share, 0.02, 0.98))))
            if abs(abs(found[last].first_harmonic[channel]) / target - 1.0) < PEAK_CHANGE:
                return

    def _between(self, a: _Found, b: _Found, share: float) -> _Found:
        """Return the finer point on the plane across the chord from `a` to `b`, at `share` of it."""
        arms = [_resized(p.point.arm, self.sweep.fine_harmonics) for p in (a, b)]
        start, end = (np.append(arm, p.point.omega) for arm, p in zip(arms, (a, b), strict=True))
        unknowns = start + share * (end - start)
        scales = np.append(np.full(len(arms[0]), np.linalg.norm(unknowns[:-1])), unknowns[-1])
        chord = (end - start) / scales
        near = a if share < 0.5 else b
        return self._keep(self.fine, self.fine.correct(unknowns, chord / np.linalg.norm(chord), scales,
                                                       near.point.end))

    def _finer(self, point: Point) -> Point:
        """Solve `point` again with the fine settings, at its frequency."""
        return self.fine.at_frequency(point.omega, _resized(point.arm, self.sweep.fine_harmonics),
                                      point.end)

    def _keep(self, system: ArmSystem, point: Point, bridged: bool = False) -> _Found:
        equations, trajectory = system.equations(point.omega), point.period.trajectory
        n, weights = trajectory.state.shape[1], self.problem.interface.areas
        forces = trajectory.force.reshape(-1, 3, n).transpose(0, 2, 1).reshape(-1, 3 * n)
        upper, lower = system.joint.observe(np.column_stack([trajectory.arm, trajectory.approach]), forces)
        motion = np.column_stack([equations.block_motion(point.arm), trajectory.arm,
                                  trajectory.displacement[:, :n] @ weights / weights.sum(), upper[:, 0], lower[:, 0]])
        multipliers = floquet_multipliers(system.joint.rig, system.march.system, trajectory,
                                          point.omega / (2.0 * pi))
        self.note(point.omega / (2.0 * pi))
        return _Found(point, 2.0 * np.fft.rfft(motion, axis=0)[1] / len(motion), np.ptp(motion, axis=0),
                      float(abs(multipliers[0])), is_stable(multipliers), bridged)


def _with_excitation(system: ArmSystem, excitation: float) -> ArmSystem:
    problem = PeriodicProblem(**{**vars(system.problem), "excitation": excitation})
    return ArmSystem(problem, system.harmonics, system.samples, system.tolerance, system.max_iterations)


def _resized(arm: Array, harmonics: int) -> Array:
    """Return coefficients with zeros for further harmonics, or without the last ones."""
    size = 2 * harmonics + 1
    return np.concatenate([arm[:size], np.zeros(max(0, size - len(arm)))])


def _top(found: list[_Found], channel: int) -> int:
    return int(np.argmax([abs(p.first_harmonic[channel]) for p in found]))


def _curve(problem: PeriodicProblem, sweep: Sweep, runs: dict[Direction, list[_Found]]) -> ResponseCurve:
    labels = label_branches([(np.array([p.frequency for p in run]), np.array([p.first_harmonic for p in run]))
                             for run in runs.values()])
    found = [p for run in runs.values() for p in run]
    return ResponseCurve(
        excitation=problem.excitation, frequency=np.array([p.frequency for p in found]),
        first_harmonic=np.array([p.first_harmonic for p in found]),
        peak_to_peak=np.array([p.peak_to_peak for p in found]),
        direction=np.concatenate([np.full(len(run), d, dtype=np.int8) for d, run in runs.items()]),
        branch=np.concatenate(labels), multiplier=np.array([p.multiplier for p in found]),
        stable=np.array([p.stable for p in found]),
        bridged=np.array([p.bridged for p in found]),
        iterations=np.array([p.point.iterations for p in found]),
        samples=np.array([len(p.point.period.trajectory.arm) for p in found]))
