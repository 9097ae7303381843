"""Forced response by pseudo-arc-length continuation.

From each end of the frequency range the curve of periods is followed to where it leaves the range, around turning
points, so that several periods at one frequency are all found. Each step is tried at a frequency, with several
coordinates also from where the joint settles in time there, and where there is no period near, across the last chord.
Its length is measured relative to the motion and the frequency themselves and set by how far the point found is from
where the chord led, and by the effort. Where another direction has been, its points are solved again, from the contact
as it is now, while they lie ahead. At the peak and its half-power points more periods are solved, with finer settings.
Where a curve cannot be followed (samples that begin to stick make it jagged), or has turned round and come back to
where it began, it is taken up again at a frequency further on, and the point is marked as bridged.
Equations: `continuation.system`; an interrupted curve: `continuation.checkpoint`.

Stability is found at some points, and between any two that differ, at all: see `continuation.points`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import islice
from math import pi, sqrt
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from fretflow.case.config import Solver, explain
from fretflow.core.errors import InputError, NonConvergenceError, did_you_mean
from fretflow.core.records import Array
from fretflow.solvers.continuation.checkpoint import Checkpoint, Trace
from fretflow.solvers.continuation.curve import (
    ResponseCurve,
    SweepDirection,
    channel_index,
    label_branches,
)
from fretflow.solvers.continuation.model import Plane
from fretflow.solvers.continuation.points import STRAIGHT, Face, ResponsePoint, Trail, channels_of, judge
from fretflow.solvers.continuation.refinement import Refinement
from fretflow.solvers.continuation.system import NO_MEMORY, ContinuationSystem, CurvePoint
from fretflow.solvers.periodic import PeriodicProblem, check_problem
from fretflow.solvers.quasi_static.backbone import Backbone
from fretflow.solvers.quasi_static.candidate_nodes import candidate_nodes
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.starts import instant_of, settled_starts
from fretflow.solvers.quasi_static.symmetry import halved

OFF = 0.03  # distance of a good point from where the last chord led
FAR = 2.0  # arcs; a root beyond is on another part of the curve
BACK = -0.3  # cosine of the bend beyond which a root lies on the part behind
STEEP = 0.03  # share of the frequency in a chord; across a steeper one there may be no period at a frequency
SHORTER = 0.4
BRIDGES = (0.002, 0.005, 0.01, 0.02, 0.05)  # of the frequency
LOAD_STEPS = tuple(0.1 * k for k in range(1, 11))
MAX_POINTS = 1000
# Of a contact that sees several coordinates, unless asked for: N samples leave a motion off by about 1 / N, so that a
# tenth of that is close enough; what the harmonics leave out, too, is in the curve's sampling error.
SEVERAL: dict[str, Any] = {"harmonics": 21, "tolerance": 0.1 / 128, "fine_tolerance": 0.1 / 256, "effort": 20}


@dataclass(frozen=True)
class Sweep:
    """Range and settings of a forced response.

    `harmonics`, `samples` and `tolerance` serve along the curve; `fine_harmonics`, `fine_samples` and `fine_tolerance`
    at the peak and its half-power points. Arcs are relative to motion and frequency.
    """

    start: float  # Hz
    stop: float  # Hz
    harmonics: int = 40
    samples: int = 128
    fine_harmonics: int = 40
    fine_samples: int = 256
    tolerance: float = 1e-4  # of the residual, relative to the excitation
    fine_tolerance: float = 1e-5
    max_iterations: int = 8  # derivatives of a point
    effort: int = 8  # iterations of a good arc
    first_arc: float = 0.05
    longest_arc: float = 0.2
    longest_step: float = 0.04  # of the frequency
    shortest_arc: float = 2e-3
    channel: str = "block"  # whose peak is refined
    directions: tuple[SweepDirection, ...] = field(default=(SweepDirection.UP, SweepDirection.DOWN))

    def check(self) -> None:
        """Check the settings.

        Raises
        ------
        InputError
            If one is of no use: too few samples for the harmonics, or a length or a direction that is none.
        """
        for fine in ("", "fine_"):
            given = {name: getattr(self, fine + name) for name in ("harmonics", "samples", "tolerance")}
            try:
                Solver(**given)
            except ValidationError as error:
                raise InputError(f"continue_response: {fine}{explain(error, given, model=Solver)}") from error
        for name in ("max_iterations", "effort", "first_arc", "longest_arc", "longest_step", "shortest_arc"):
            value = getattr(self, name)
            kind = Integral if name in ("max_iterations", "effort") else Real
            if not (isinstance(value, kind) and 0.0 < float(value) < np.inf):
                raise InputError(f"continue_response: {name} = {value!r} must be a positive number")
        if not self.directions or any(one not in [*SweepDirection] for one in self.directions):
            raise InputError(f"continue_response: directions = {self.directions!r} must be some of 1, up, and -1, down")


@dataclass(frozen=True)
class _Run:
    """A curve in one direction; multiplier nan where stability follows from that of both neighbours."""

    points: list[ResponsePoint]
    multiplier: Array
    stable: NDArray[np.bool_]
    change: float  # of the largest first harmonics with the finer settings, relative


def continue_response(problem: PeriodicProblem, start: float, stop: float, channel: str | None = None, *,
                      progress: Callable[[float], None] | None = None, **settings: Any) -> ResponseCurve:
    """Follow the forced response of a joint over a range of frequencies, up and down, around turning points.

    Parameters
    ----------
    problem : PeriodicProblem
        Its excitation keeps its amplitude; its frequency is not used.
    start, stop : float
        In Hz.
    channel : str, optional
        Output whose peak is refined; by default the first, of the rig the moving mass.
    progress : callable, optional
        Takes the frequency in Hz of each point solved.
    settings
        Of `Sweep`: harmonics, samples, tolerances and lengths of arcs; where the contact sees several coordinates,
        by default fewer harmonics and tolerances of a tenth of a sample.

    Returns
    -------
    ResponseCurve
        First harmonics and ranges in m by channel, with stability and branches, (P,) points in the order found.

    Raises
    ------
    InputError
        If the range is empty or there is no such channel or setting.
    NonConvergenceError
        Naming the frequency.

    Notes
    -----
    Pseudo-arc-length continuation with the contact solved at every instant (``docs/theory/periodic.md``).

    Examples
    --------
    >>> import fretflow as ff
    >>> curve = ff.continue_response(problem, 20, 400)  # doctest: +SKIP
    >>> curve.frequency[abs(curve.first_harmonic[:, 0]).argmax()]  # Hz  # doctest: +SKIP
    """
    if not 0.0 < start < stop:
        raise InputError(f"start {start:g} Hz, stop {stop:g} Hz: start must be positive and below stop")
    channels = channels_of(problem)
    if channels.count("relative") > 1:
        raise InputError("observe: relative is what response curves call the sliding of the faces; give your output "
                         "another name")
    shown = channels[0] if channels[0] != "relative" or len(channels) == 1 else channels[1]
    channel_index(channel or shown, channels)
    known = [one.name for one in fields(Sweep) if one.name not in ("start", "stop", "channel")]
    for name in set(settings).difference(known):
        raise InputError(f"continue_response: there is no setting {name}; there are {', '.join(known)}"
                         f"{did_you_mean(name, known)}")
    own = SEVERAL if len(seen_coordinates(problem.boundary)) > 1 else {}
    sweep = Sweep(float(start), float(stop), channel=channel or shown, **{**own, **settings})
    sweep.check()
    check_problem(problem, min(sweep.harmonics, sweep.fine_harmonics))
    if not problem.excitation.amplitude > 0.0:
        raise InputError("excitation: is zero, to which there is no response")
    return respond(problem, sweep, lambda direction, frequency: progress(frequency) if progress else None)


def respond(problem: PeriodicProblem, sweep: Sweep, note: Callable[[SweepDirection, float], None],
            unfinished: Path | None = None) -> ResponseCurve:
    """Return the forced response of `problem` over the range of `sweep`; `note` is told each point solved, Hz.

    Of faces that are symmetric one side is solved for, see `symmetry`. Nodes out of reach are left out, see
    `candidate_nodes`; where one turns out to touch, all is done again. Points are kept in the file `unfinished` as they
    are found; where it is there, the curve goes on from them, to the same result.

    Raises
    ------
    NonConvergenceError
        Naming the frequency, with the residual history of the last attempt.
    StoreError
        If the file cannot be read or written.
    """
    checkpoint, problem = Checkpoint(unfinished), halved(problem)
    nodes = candidate_nodes(problem, None) if checkpoint.saved is None else checkpoint.saved.nodes
    while True:
        face = Face.of(problem, nodes)
        traces: list[Trace] = []
        runs: dict[SweepDirection, _Run] = {}
        for direction in sweep.directions:
            follower = _Follower(face, sweep, partial(note, direction), checkpoint)
            traces.append(follower.follow(direction, traces))
            runs[direction] = follower.finish(traces[-1])
        missed = np.any([p.touched for run in runs.values() for p in run.points], axis=0) & ~nodes
        if not missed.any():
            return _curve(problem, runs)
        nodes, checkpoint.saved = nodes | missed, None


class _Follower:
    """Follows the curve of the nodes within reach."""

    def __init__(self, face: Face, sweep: Sweep, note: Callable[[float], None], checkpoint: Checkpoint) -> None:
        self.face, self.sweep, self.note, self.checkpoint = face, sweep, note, checkpoint
        self.problem = problem = face.part
        backbone, s = _backbone(problem), sweep
        self.system = ContinuationSystem(problem, s.harmonics, s.samples, s.tolerance, s.max_iterations, backbone)
        self.trails: list[Trail] = []
        fine = ContinuationSystem(problem, s.fine_harmonics, s.fine_samples, s.fine_tolerance, s.max_iterations,
                                  backbone)
        self.refinement = Refinement(face, fine, channel_index(s.channel, channels_of(problem)), note)

    def follow(self, direction: SweepDirection, others: list[Trace]) -> Trace:
        """Return the curve in `direction`, from where it was left; `others` were followed the other way."""
        system, self.trails = self.system, [Trail(other.points) for other in others]
        trace = self.checkpoint.resume(direction, system, self.trails)
        if trace is None:
            first = self._keep(self._start(direction, [other.points[-1].point for other in others]))
            along = np.append(np.zeros(len(first.point.seen)), float(direction))
            trace = Trace(direction, [first], system.tangent(first.point, along), self.sweep.first_arc)
            self._save(others, trace)
        while not trace.ended:
            self._advance(trace)
            self._save(others, trace)
        return trace

    def finish(self, trace: Trace) -> _Run:
        """Return a curve refined, with the stability of its points."""
        self.system.begin_step(NO_MEMORY)
        points = list(trace.points)
        change = self.refinement.refine(points)
        return _Run(points, *judge(points, self.refinement.top(points)), change)

    def _save(self, others: list[Trace], trace: Trace) -> None:
        self.system.begin_step(self.system.memory)
        self.checkpoint.save(self.face.nodes, [*others, trace], self.system, self.trails)

    def _start(self, direction: SweepDirection, reached: list[CurvePoint]) -> CurvePoint:
        """Solve at the end of the range where `direction` begins, from rest or from where another curve ended."""
        s = self.sweep
        omega = 2.0 * pi * (s.start if direction is SweepDirection.UP else s.stop)
        try:
            pressed = self.system.march.preloaded(self.problem.preload.frictional)
            return self.system.at_frequency(omega, self.system.guess(omega), pressed)
        except NonConvergenceError as error:
            there = [p for p in reached if abs(p.omega - omega) < 1e-9 * omega]
            if there:
                return there[-1]
            return self._settled(omega) if len(self.system.seen) > 1 else self._loaded(omega, error)

    def _loaded(self, omega: float, error: NonConvergenceError) -> CurvePoint:
        """Raise the excitation step by step, from rest."""
        seen: Array = np.zeros(len(self.system.seen) * (2 * self.sweep.harmonics + 1))
        start, before = self.system.march.preloaded(self.problem.preload.frictional), 0.0
        for share in LOAD_STEPS:
            part = self.system.under(share)
            try:
                point = part.at_frequency(omega, seen * (share / before if before else 1.0), start)
            except NonConvergenceError:
                raise error from None
            seen, start, before = point.seen, point.end, share
        return point

    def _advance(self, trace: Trace) -> None:
        """Put the next point on the curve, or the last one at the end of the range."""
        s, low, high = self.system, 2.0 * pi * self.sweep.start, 2.0 * pi * self.sweep.stop
        now, along, points = trace.points[-1].point, trace.along, trace.points
        if len(points) >= MAX_POINTS:
            raise NonConvergenceError(f"forced response: not out of the frequency range after {MAX_POINTS} points, "
                                      f"near {now.omega / (2.0 * pi):.6g} Hz; take a smaller range")
        bridged = False
        try:
            new, arc = self._arc(now, along, trace.arc)
        except NonConvergenceError as error:
            bridged, arc = True, self.sweep.first_arc
            new = self._bridge(now, float(np.sign(along[-1])), error)
        if self._returned(trace, now, new):
            del points[1 + max(range(len(points)), key=lambda k: trace.direction * points[k].point.omega):]
            now, along = points[-1].point, np.append(np.zeros(len(now.seen)), float(trace.direction))
            bridged, arc = True, self.sweep.first_arc
            new = self._bridge(now, along[-1], NonConvergenceError(
                f"forced response near {now.omega / (2.0 * pi):.6g} Hz: the curve comes back as it went"))
        if not low < new.omega < high:
            points.append(self._keep(self._end(now, new, low if new.omega <= low else high)))
            trace.ended = True
        elif bridged:
            points.append(self._keep(new, bridged=True))
            way = np.append(np.zeros(len(new.seen)), float(np.sign(along[-1])))
            trace.along, trace.arc = s.tangent(points[-1].point, way), arc
        else:
            points.append(self._keep(new))
            chord = (new.unknowns - now.unknowns) / now.scales
            trace.arc = self._next_arc(new, chord, arc * along)
            trace.along = chord / np.linalg.norm(chord)

    def _returned(self, trace: Trace, now: CurvePoint, new: CurvePoint) -> bool:
        """Tell whether a curve leaves the range where it began and by the way it came: somewhere it turned round."""
        first = trace.points[0].point
        if trace.direction * (new.omega - first.omega) > 0.0:
            return False
        end = self._end(now, new, first.omega)
        return bool(np.linalg.norm((end.unknowns - first.unknowns) / first.scales) < OFF)

    def _next_arc(self, new: CurvePoint, chord: Array, predicted: Array) -> float:
        length, off = float(np.linalg.norm(chord)), float(np.linalg.norm(chord - predicted))
        growth = min(2.0 ** (0.5 * (self.sweep.effort - new.iterations)), sqrt(OFF / max(off, 1e-6)))
        share = max(abs(float(chord[-1])) / length, 1e-9)  # of the frequency in the chord
        arc = length * float(np.clip(growth, 0.5, 2.0))
        return max(min(arc, self.sweep.longest_arc, self.sweep.longest_step / share), self.sweep.shortest_arc)

    def _arc(self, now: CurvePoint, along: Array, arc: float) -> tuple[CurvePoint, float]:
        """Return the next point and the arc that led there; `along` has the length one."""
        met = self._met(now, along, arc)
        if met is not None:
            return met, arc
        history: tuple[float, ...] = ()
        while arc >= self.sweep.shortest_arc:
            for solve in self._ways(now, along, arc):
                try:
                    new = solve()
                except NonConvergenceError as error:
                    history = error.history
                    continue
                chord = (new.unknowns - now.unknowns) / now.scales
                length = float(np.linalg.norm(chord))
                if length < FAR * arc and chord @ along > BACK * length:
                    return new, arc
            arc *= SHORTER
        raise NonConvergenceError(f"forced response near {now.omega / (2.0 * pi):.6g} Hz: the curve has a gap", history)

    def _ways(self, now: CurvePoint, along: Array, arc: float) -> list[Callable[[], CurvePoint]]:
        """Return the ways to a point an arc ahead: at its frequency, from where the joint settles there, or across."""
        system, ahead = self.system, now.unknowns + arc * along * now.scales
        omega, seen = float(ahead[-1]), ahead[:-1]
        ways = [partial(system.correct, Plane.of_frequency(omega, seen), now.end, now)]
        if len(system.seen) > 1:
            ways.append(partial(self._settled, omega, now))
        across = partial(system.correct, Plane(ahead, along, now.scales), now.end, now)
        return [*ways, across] if abs(along[-1]) > STEEP else [across, *ways]

    def _met(self, now: CurvePoint, along: Array, arc: float) -> CurvePoint | None:
        """Return the next point of another curve, solved again from the contact at `now`, or None."""
        distance = FAR * max(arc, self.sweep.first_arc)
        for trail in self.trails:
            known = trail.ahead(now, along, distance)
            if known is None:
                continue
            with suppress(NonConvergenceError):
                new = self.system.at_frequency(known.omega, known.seen, now.end, known)
                chord = (new.unknowns - now.unknowns) / now.scales
                length = float(np.linalg.norm(chord))
                if length < distance and chord @ along > STRAIGHT * length:
                    return new
        return None

    def _bridge(self, now: CurvePoint, way: float, error: NonConvergenceError) -> CurvePoint:
        """Go on at a frequency further on, where the curve cannot be followed."""
        for relative in BRIDGES:
            omega = now.omega * (1.0 + way * relative)
            for guess in (now.seen, self.system.guess(omega)):
                with suppress(NonConvergenceError):
                    return self.system.at_frequency(omega, guess, now.end, now)
        for relative in BRIDGES if len(self.system.seen) > 1 else ():
            with suppress(NonConvergenceError):
                return self._settled(now.omega * (1.0 + way * relative))
        raise error

    def _settled(self, omega: float, near: CurvePoint | None = None) -> CurvePoint:
        """Return the point of one frequency where the joint settles in time, from `near` by. Raises as `correct`."""
        at, march = self.system.at(omega), self.system.march
        begin = None if near is None else instant_of(at, self.system.motion(near), near.end)
        error = NonConvergenceError(f"forced response at {omega / (2.0 * pi):.6g} Hz: the motion does not settle")
        starts = settled_starts(at, self.system.equations(omega), march, begin)
        for settled in starts if near is None else islice(starts, 1):
            try:
                return self.system.at_frequency(omega, settled.start.seen, settled.contact)
            except NonConvergenceError as failure:
                error = failure
        raise error

    def _end(self, inside: CurvePoint, outside: CurvePoint, omega: float) -> CurvePoint:
        """Return the point at the end of the range, `omega`, between two points."""
        way = outside.omega - inside.omega
        share = (omega - inside.omega) / way if way else 1.0  # the first step may turn back at the range's end itself
        return self.system.at_frequency(omega, inside.seen + share * (outside.seen - inside.seen), inside.end, inside)

    def _keep(self, point: CurvePoint, bridged: bool = False) -> ResponsePoint:
        self.note(point.omega / (2.0 * pi))
        return ResponsePoint.of(self.face, self.system, point, bridged)


def _backbone(problem: PeriodicProblem) -> Backbone | None:
    """Return the contact's backbone, or None where it does not slide however far it is pushed."""
    seen = seen_coordinates(problem.boundary)
    if len(seen) > 1:
        return None
    march = ContactMarch.of(problem, seen)
    with suppress(NonConvergenceError):
        return Backbone.of(march, march.preloaded(problem.preload.frictional))
    return None


def _curve(problem: PeriodicProblem, runs: dict[SweepDirection, _Run]) -> ResponseCurve:
    labels = label_branches([(np.array([p.frequency for p in run.points]),
                              np.array([p.first_harmonic for p in run.points])) for run in runs.values()])
    points = [p for run in runs.values() for p in run.points]
    return ResponseCurve(
        excitation=problem.excitation.amplitude, channels=channels_of(problem),
        frequency=np.array([p.frequency for p in points]),
        first_harmonic=np.array([p.first_harmonic for p in points]),
        peak_to_peak=np.array([p.peak_to_peak for p in points]),
        direction=np.concatenate([np.full(len(run.points), d, dtype=np.int8) for d, run in runs.items()]),
        branch=np.concatenate(labels), multiplier=np.concatenate([run.multiplier for run in runs.values()]),
        stable=np.concatenate([run.stable for run in runs.values()]), bridged=np.array([p.bridged for p in points]),
        iterations=np.array([p.point.iterations for p in points]),
        residual=np.array([p.point.norm for p in points]),
        samples=np.array([p.system.samples for p in points]),
        sampling_error=float(max(run.change for run in runs.values())))
