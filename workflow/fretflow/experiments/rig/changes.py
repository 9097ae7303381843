"""Changes of a recording that one block of the rig's model may make, with the equations of all others as they are.

Each maker returns the columns of one block, see `blocks`: those that all loops share, and those of one loop each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fretflow.core.records import Array
from fretflow.effects.initial_gap import InitialGap
from fretflow.experiments.loops import Strokes
from fretflow.experiments.rig.experiment import simulation_of
from fretflow.experiments.rig.model import RigModel, harmonics_of
from fretflow.experiments.rig.simulation import Period
from fretflow.inference.evidence import LOOP_HARMONICS
from fretflow.inference.least_squares import Fit
from fretflow.recordings.repeatability import SMOOTH
from fretflow.solvers.fourier import derivative_matrix
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.sensitivity import Direction
from fretflow.solvers.sensitivity import PeriodSensitivity, sensitivities
from fretflow.structure.sensors import Signals, band_limited

CONTACT, WEAR, RIG, EXCITATION, GEOMETRY, SENSOR = (
    "contact law", "wear law", "rig", "excitation", "geometry", "sensor")
GAP_SIZE = InitialGap.priors()["crown"].high  # m, of a change of the gap


@dataclass(frozen=True)
class Loop:
    """One solved loop: its signals, and where its channels stand in the vector."""

    rig: RigModel
    base: Fit
    period: Period
    places: dict[str, slice]
    signals: Signals
    shown: Signals

    @classmethod
    def of(cls, rig: RigModel, base: Fit, period: Period) -> Loop:
        """Return the loop of a period of a fitted baseline."""
        pieces = {piece.channel: piece for piece, seen in rig.pieces(simulation_of(base.prediction)) if seen is period}
        signals = rig.signals(period)
        return cls(rig, base, period, {name: piece.place for name, piece in pieces.items()}, signals,
                   rig.sensed(simulation_of(base.prediction).model, signals))

    def harmonics(self, most: int) -> Array:
        """Return a constant, cosines and sines (N, 2 H + 1) over the loop's samples."""
        phase = 2.0 * np.pi * np.arange(self.rig.observation.samples) / self.rig.observation.samples
        parts = [np.ones_like(phase)]
        for k in range(1, most + 1):
            parts += [np.cos(k * phase), np.sin(k * phase)]
        return np.column_stack(parts)

    def column(self, vector: Array, changes: dict[str, Array]) -> None:
        """Add to a vector (M,) what small changes (N,) of true channels show."""
        step = float(np.sqrt(np.finfo(float).eps))  # of differences to one side
        moved: dict[str, Any] = {name: getattr(self.signals, name) + step * change
                                 for name, change in changes.items() if getattr(self.signals, name) is not None}
        after = self.rig.sensed(simulation_of(self.base.prediction).model, replace(self.signals, **moved))
        for name, place in self.places.items():
            vector[place] += (getattr(after, name) - getattr(self.shown, name)) / step

    def answers(self, directions: Sequence[Direction]) -> list[dict[str, Array]]:
        """Return the changes of the channels for each direction, to first order."""
        sensitivity = sensitivities(self.period.problem, self.period.solution, directions,
                                    harmonics_of(len(self.period.solution.state)))
        return [self._changes(sensitivity, v) for v in range(len(directions))]

    def _changes(self, sensitivity: PeriodSensitivity, v: int) -> dict[str, Array]:
        solution = self.period.solution
        moved = sensitivity.moved(solution, v)
        faces = sensitivity.relative_displacement[v]
        seen = self.rig.displacement(replace(self.period, solution=moved)) - self.rig.displacement(self.period)
        changes = {"displacement": seen if np.any(seen) else faces, "friction_force": sensitivity.friction_force[v],
                   "arm": sensitivity.outputs["arm"][v], "approach": -sensitivity.outputs["approach"][v]}
        return {name: band_limited(change, self.rig.observation.harmonics) for name, change in changes.items()}

    @cached_property
    def following(self) -> Array:
        """Return the motion (N, N) of the arm by a force on it at each sample, m/N."""
        n = self.rig.observation.samples
        arm = InternalEquations.of(self.period.problem, (n - 1) // 2, n)
        return np.asarray(arm.synthesis @ np.linalg.solve(arm.impedance, arm.analysis))

    @cached_property
    def compliance(self) -> float:
        """Return by how much the displacement stays behind the arm for a friction force, m/N."""
        behind = self.signals.arm - self.signals.displacement
        force = self.signals.friction_force - self.signals.friction_force.mean()
        return float(behind @ force / (force @ force))

    @property
    def force_size(self) -> float:
        """Return half the range of the friction force, N."""
        return 0.5 * float(np.ptp(self.signals.friction_force))

    @property
    def motion_size(self) -> float:
        """Return half the range of the displacement, m."""
        return 0.5 * float(np.ptp(self.signals.displacement))


Columns = tuple[Array, Array]


def _stacked(size: int, columns: Iterable[Array]) -> Array:
    made = list(columns)
    return np.column_stack(made) if made else np.zeros((size, 0))


def _by_loop(rig: RigModel, loops: list[Loop], changes: Callable[[Loop], list[dict[str, Array]]]) -> Columns:
    """Return changes of all loops alike, and of each by itself."""
    size = len(rig.observation.values)
    shared: list[Array] = []
    single: list[Array] = []
    for loop in loops:
        for i, change in enumerate(changes(loop)):
            one = np.zeros(size)
            loop.column(one, change)
            single.append(one)
            if i == len(shared):
                shared.append(np.zeros(size))
            shared[i] += one
    return _stacked(size, shared), _stacked(size, single)


def _contact(rig: RigModel, loops: list[Loop]) -> Columns:
    """Return friction forces of any shape, and those that all loops share as functions of travel and speed."""
    def anything(loop: Loop) -> list[dict[str, Array]]:
        forces = loop.force_size * loop.harmonics(LOOP_HARMONICS).T
        return [_followed(loop, force) for force in forces] + _pressed(loop)

    def alike(loop: Loop) -> list[dict[str, Array]]:
        return [_followed(loop, force) for force in (
            *_laws(loop), *_likenesses(loop, loops, "friction_force", "arm"))]

    return np.hstack([_by_loop(rig, loops, alike)[0], _worn(rig)]), _by_loop(rig, loops, anything)[1]


def _worn(rig: RigModel) -> Array:
    """Return any field of depth at the end alone: what is worn otherwise as other pressures act."""
    columns = np.zeros((len(rig.observation.values), rig.problem.interface.size))
    for column, field in zip(columns.T, np.eye(rig.problem.interface.size), strict=True):
        rig.put_wear(column, GAP_SIZE * field)
    return columns


def _followed(loop: Loop, force: Array) -> dict[str, Array]:
    """Return a change of the friction force (N,) and of the motion that the rig makes of it."""
    moved = -loop.following @ force
    return {"friction_force": force, "arm": moved, "displacement": moved - loop.compliance * force}


def _pressed(loop: Loop) -> list[dict[str, Array]]:
    """Return what a contact may do in the normal direction: come closer, and give way to the friction force."""
    if loop.signals.approach is None:
        return []
    bent = loop.signals.friction_force / loop.force_size
    return [{"approach": GAP_SIZE * change} for change in (np.ones_like(bent), bent, bent**2)]


def _laws(loop: Loop) -> list[Array]:
    """Return friction forces as functions of the share of the stroke, in each direction, and of the speed."""
    strokes = Strokes.of(loop.signals.displacement, loop.signals.friction_force)
    at = np.linspace(0.0, 1.0, LOOP_HARMONICS + 1)  # apart by half of the shortest wave, linear between
    hats = np.clip(1.0 - np.abs(strokes.share[:, None] - at) * LOOP_HARMONICS, 0.0, None).T
    force = loop.signals.friction_force
    speed = np.abs(loop.signals.velocity) / loop.rig.problem.omega / loop.motion_size
    load = loop.period.problem.normal_load
    forces = [load * (strokes.way == way) * hat for hat in hats for way in (1.0, -1.0)]
    return forces + [force * np.exp(-speed / fading) for fading in (0.1, 0.5)] + [force * speed]


def _rig(rig: RigModel, loops: list[Loop]) -> Columns:
    def changes(loop: Loop) -> list[dict[str, Array]]:
        return loop.answers([_on_arm(loop, loop.force_size * history, 0) for history in
                             loop.harmonics(SMOOTH).T])

    def alike(loop: Loop) -> list[dict[str, Array]]:
        return loop.answers([_on_arm(loop, history, 0) for history in
                             _likenesses(loop, loops, "friction_force", "arm")])

    return np.hstack([_by_loop(rig, loops, alike)[0], _worn(rig)]), _by_loop(rig, loops, changes)[1]


def _parallel(rig: RigModel, loops: list[Loop]) -> Columns:
    shared, _ = _by_loop(rig, loops, _beside)
    return shared, np.zeros((len(shared), 0))


def _beside(loop: Loop) -> list[dict[str, Array]]:
    """Return forces between the specimens beside the contact, functions of the motion that all loops share."""
    first = simulation_of(loop.base.prediction).loops[0].solution.rig_displacement[:, 1]
    x = loop.signals.arm / (0.5 * float(np.ptp(first)))
    most = loop.rig.observation.harmonics
    waves = loop.harmonics(most)
    rates = waves @ derivative_matrix(most, loop.period.problem.frequency / loop.rig.problem.frequency)
    v = rates @ np.linalg.lstsq(waves, x, rcond=None)[0]
    histories = [x, x**2, x**3, np.abs(x) * x**3, v, np.abs(v) * v, np.sign(v) * np.sqrt(np.abs(v)), np.abs(x) * v]
    histories = [loop.rig.problem.normal_load * history for history in histories]
    answers = loop.answers([_on_arm(loop, -history, 0) for history in histories])
    return [change | {"friction_force": change["friction_force"] + history}
            for change, history in zip(answers, histories, strict=True)]


def _on_arm(loop: Loop, history: Array, on_block: int) -> Direction:
    """Return a force of a loop's samples, on all that the period was solved with."""
    samples = len(loop.period.solution.state)
    spectrum = np.fft.rfft(history)
    fine = np.fft.irfft(spectrum, samples) * (samples / len(history))
    force = np.zeros((samples, 2))
    force[:, 0 if on_block else 1] = fine
    return Direction(name="force", force=force)


def _excitation(rig: RigModel, loops: list[Loop]) -> Columns:
    def changes(loop: Loop) -> list[dict[str, Array]]:
        basis = loop.harmonics(SMOOTH)
        drive = loop.period.condition.excitation.amplitude
        histories = [drive * basis[:, 2 * k - 1 + part] for k in range(2, SMOOTH + 1)
                     for part in (0, 1)]
        answers = loop.answers([_on_arm(loop, history, 1) for history in histories])
        return [change | {"excitation": history} for change, history in zip(answers, histories, strict=True)]
    shared, _ = _by_loop(rig, loops, changes)
    return shared, np.zeros((len(shared), 0))


def _sensor(rig: RigModel, loops: list[Loop], name: str, other: str) -> Columns:
    """Return what the sensor of a channel does: a filter of it or of another, a bent or drifting scale, or anything."""
    size, _ = _sizes(loops, name, other)

    def alike(loop: Loop) -> list[dict[str, Array]]:
        return [{name: change} for change in _likenesses(loop, loops, name, other)]

    def anything(loop: Loop) -> list[dict[str, Array]]:
        return [{name: size * history} for history in loop.harmonics(LOOP_HARMONICS).T]

    return _by_loop(rig, loops, alike)[0], _by_loop(rig, loops, anything)[1]


def _sizes(loops: list[Loop], name: str, other: str) -> tuple[float, float]:
    """Return half the largest ranges of two channels."""
    first, second = (0.5 * max(float(np.ptp(getattr(loop.signals, one))) for loop in loops) for one in (name, other))
    return first, second


def _likenesses(loop: Loop, loops: list[Loop], name: str, other: str) -> list[Array]:
    """Return histories (N,) of one law in all loops: filters of a channel, of another or of the drive, powers, gains.

    A gain drifts over the test, evenly or early in it.
    """
    size, across = _sizes(loops, name, other)
    mine, its = getattr(loop.signals, name), size / across * getattr(loop.signals, other)
    drive, share = size * loop.harmonics(1)[:, 1], loop.period.elapsed
    histories = [size * (mine / size)**2, size * (mine / size)**3, share * mine, _early(share) * mine]
    for signal, orders in ((mine, LOOP_HARMONICS), (its, LOOP_HARMONICS), (drive, 1)):
        spectrum = np.fft.rfft(signal)
        for k in range(1, orders + 1):
            for turn in (1.0, 1j):
                one = np.zeros_like(spectrum)
                one[k] = turn * spectrum[k]
                histories.append(np.fft.irfft(one, len(signal)))
    order = np.arange(len(mine) // 2 + 1)
    for signal in (mine, its):
        histories += [np.fft.irfft(factor * np.fft.rfft(signal), len(mine)) for factor in (1.0, 1j * order, -order**2)]
    return histories


def _early(share: float) -> float:
    """Return what fades early in a test, of which a share has passed."""
    return float(np.exp(-8.0 * share))


def _force_sensor(rig: RigModel, loops: list[Loop]) -> Columns:
    return _sensor(rig, loops, "friction_force", "arm")


def _motion_sensor(rig: RigModel, loops: list[Loop]) -> Columns:
    return _sensor(rig, loops, "displacement", "friction_force")


def _gaps(rig: RigModel, loops: list[Loop], course: Callable[[float], list[float]]) -> Columns:
    """Return fields of the gap over the nodes whose course over the test is as told, with the depth they leave."""
    nodes = rig.problem.interface.size
    total = max(loop.period.step.cycles for loop in loops)
    times = len(course(0.0))
    columns = np.zeros((len(rig.observation.values), nodes * times))
    directions = [Direction(name="gap", gap=GAP_SIZE * row) for row in np.eye(nodes)]
    for loop in loops:
        answers = loop.answers(directions)
        weights = course(loop.period.step.cycles / max(total, 1))
        for m, change in enumerate(answers):
            one = np.zeros(len(columns))
            loop.column(one, change)
            for t, weight in enumerate(weights):
                columns[:, m * times + t] += weight * one
    ends = np.array(course(1.0)) - np.array(course(0.0))
    columns += np.kron(_worn(rig), ends)
    return columns, np.zeros((len(columns), 0))


def _geometry(rig: RigModel, loops: list[Loop]) -> Columns:
    return _gaps(rig, loops, lambda share: [1.0, 1.0 - share, _early(share)])


def _wear(rig: RigModel, loops: list[Loop]) -> Columns:
    return _gaps(rig, loops, lambda share: [share, float(np.sqrt(share))])


Maker = Callable[[RigModel, list[Loop]], Columns]
MAKERS: tuple[tuple[str, Maker], ...] = (
    (CONTACT, _contact), (WEAR, _wear), (RIG, _rig), (RIG, _parallel), (EXCITATION, _excitation), (GEOMETRY, _geometry),
    (SENSOR, _force_sensor), (SENSOR, _motion_sensor))
