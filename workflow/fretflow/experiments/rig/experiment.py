"""The loops, sweep and wear of a rig under the inference engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import Array
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import in_sensors_alone
from fretflow.experiments.loops import Strokes
from fretflow.experiments.rig.model import RigModel, at_condition
from fretflow.experiments.rig.observation import CHANNELS, Observation, is_other_motion
from fretflow.experiments.rig.setup import errors_of, is_seen
from fretflow.experiments.rig.simulation import Hypothesis, Simulation
from fretflow.experiments.rig.tangent import neighbours
from fretflow.experiments.rig.views import loop_pieces
from fretflow.inference.experiment import Experiment, Measurement, Point, Prediction
from fretflow.inference.parameters import Coordinate, Parameters
from fretflow.recordings.kinds.joints import FRETTING_RIG
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.history import WearSettings

# sd of the logarithm of what the baseline may refit; the compliance covers mesh, modulus and clamping of the specimens.
# Damping ratios of like structures scatter by 40 % (A. G. Davenport, P. Hill-Carroll, Damping in tall buildings: its
# variability and treatment in design, in Building Motion in Wind (ASCE, 1986) 42-57).
BASELINE = tuple(Coordinate("", name, 0.0, sd, True) for name, sd in (
    ("friction", 0.3), ("wear", 0.7), ("mass", 0.1), ("compliance", 0.05), ("damping", 0.4)))


@dataclass(frozen=True)
class RigExperiment(Experiment):
    """A rig's model against its recording; `correction` (M,) is what the coarse model leaves out."""

    rig: RigModel
    correction: Array
    code_error: Array  # (M, any), modes of what is not known of the correction
    checks: tuple[RigModel, RigModel] | None = None  # on a finer mesh, and with more samples
    embedded: Array | None = None  # (M, any), see `Measurement`

    @cached_property
    def measurement(self) -> Measurement:
        """Return what was measured."""
        return measured(self.rig.observation, self.code_error, self.rig.total_cycles, self.embedded)

    def candidates(self) -> tuple[str, ...]:
        """Return the ids of the effects that act in a rig."""
        return rig_effects()

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of the baseline (friction, wear coefficient, ...) and of `effects`."""
        return Parameters.of(BASELINE, effects, signs, chances=True)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return what the rig shows of a hypothesis.

        Raises
        ------
        NonConvergenceError
            If a period is not found, or numbers are beyond all bounds.
        """
        known = None if near is None or not self.has_made(near) else resensed(near, point)
        of = hypothesis(point)
        simulation = known or self.rig.resolving(of).simulate(of, None if near is None else near.state)
        return Prediction(point, self.rig.predict(simulation) + self.correction, simulation)

    def has_made(self, prediction: Prediction) -> bool:
        """Tell whether a prediction has this resolution."""
        simulation = simulation_of(prediction)
        return simulation.resolution == self.rig.resolving(simulation.hypothesis).resolution

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return the first-order changes (M, V), from one march; those of sensors alone are exact."""
        changes, before = np.empty((len(prediction.values), len(points))), simulation_of(prediction)
        alike = {place: one for place, point in enumerate(points) if (one := resensed(prediction, point)) is not None}
        moved = [place for place in range(len(points)) if place not in alike]
        changes[:, moved] = neighbours(self.rig, before, [hypothesis(points[place]) for place in moved])
        shown = self.rig.predict(before) if alike else prediction.values
        for place, one in alike.items():
            changes[:, place] = self.rig.predict(one) - shown
        return changes

    def before_jump(self, leading: Prediction) -> Experiment | None:
        """Return the same with the loops before the measured motion jumps alone.

        None where it does not, or where the `leading` prediction is of the measured motion throughout.
        """
        last = self.last_before_jump
        if last is None or not self._is_other_motion(leading):
            return None
        kept, seen = self.rig.observation.until(last)
        return replace(self._with_models(observation=seen), correction=self.correction[kept],
                       code_error=self.code_error[kept],
                       embedded=None if self.embedded is None else self.embedded[kept])

    def _with_models(self, **changes: Any) -> RigExperiment:
        """Return the same with fields of its model, and of those that check it, changed."""
        rig, *checks = (replace(one, **changes) for one in (self.rig, *(self.checks or ())))
        return replace(self, rig=rig, checks=(checks[0], checks[1]) if checks else None)

    def _is_other_motion(self, prediction: Prediction) -> bool:
        """Tell whether a prediction is of another motion than the measured one anywhere."""
        seen = self.rig.observation
        return any(is_other_motion(*(seen.fundamental(of[piece.place]) for of in (seen.values, prediction.values)))
                   for piece in seen.pieces if piece.channel == "displacement")

    @cached_property
    def last_before_jump(self) -> int | None:
        """Return the last cycle count before the motion over its drive jumps to another one; None where it does not.

        It may do so at the end of the test, under other conditions.
        """
        seen, problem = self.rig.observation, self.rig.problem
        others: dict[int | None, PeriodicProblem] = {one.id: at_condition(problem, one) for one in seen.conditions}
        moved = [(piece, seen.fundamental(seen.values[piece.place]) / others.get(
            piece.condition, problem).excitation.amplitude) for piece in seen.pieces if piece.channel == "displacement"]
        loops = sorted({piece.cycles: one for piece, one in moved if piece.block == "loops"}.items())
        for (count, one), (_, other) in pairwise(loops):
            if is_other_motion(one, other):
                return count
        after = [other for piece, other in moved if piece.block == "sweep"]
        return loops[-1][0] if len(loops) > 1 and any(is_other_motion(loops[-1][1], one) for one in after) else None

    def finer(self) -> Experiment | None:
        """Return the same with finer steps of wear; none where the motion jumps between counts, which takes longest."""
        last = self.last_before_jump
        jumps = last is not None and last < max(self.rig.observation.counts)
        if self.rig.wear_tolerance <= WearSettings.tolerance or jumps:
            return None
        return self._with_models(wear_tolerance=WearSettings.tolerance)

    def corrected(self, prediction: Prediction) -> Experiment | None:
        """Return the same with what the coarse model leaves out at a prediction; None where finer ones fail.

        Where that is seen in the recording the model has twice the samples: what is left out changes with the fit. On a
        finer mesh what is left to chance is another draw, so that it is put out of work for that.
        """
        if self.checks is None:
            return None
        point = prediction.point
        drawn = frozenset(one.effect for one in point.parameters.coordinates if one.chance)
        if drawn:
            try:
                prediction = self.predict(replace(point, neutral=point.neutral | drawn), prediction)
            except NonConvergenceError:
                return None
        simulation, coarse = simulation_of(prediction), prediction.values - self.correction
        rig, fine = (one.resolving(simulation.hypothesis) for one in (self.rig, self.checks[0]))
        dense = self.checks[1]
        observation = rig.observation
        twice = rig.twice_as_dense() if 2 * rig.samples < dense.samples else None
        try:
            if twice is not None:  # at once to all samples, Newton loses what rings otherwise with few
                simulation = twice.refine(simulation)
            denser = dense.predict(dense.refine(simulation))
            if twice is not None and is_seen(observation, denser - coarse):
                rig, fine, coarse = twice, fine.twice_as_dense(), twice.predict(simulation)
            finer = fine.predict(fine.refine(simulation))
        except NonConvergenceError:
            return None
        correction, _ = errors_of(observation, finer, denser, coarse, dense.samples / rig.samples)
        return replace(self, rig=rig, correction=correction, checks=(fine, dense))


def hypothesis(point: Point) -> Hypothesis:
    """Return a point as the rig's model takes it."""
    return Hypothesis(effects=point.built(), **point.parameters.values(point.z)[""])


def resensed(near: Prediction, point: Point) -> Simulation | None:
    """Return the simulation of a point that differs from another one in its sensors alone; None where more differs."""
    other = simulation_of(near)
    one, known = hypothesis(point), other.hypothesis
    acting = [[effect for effect in own.effects if not in_sensors_alone(type(effect))] for own in (one, known)]
    if acting[0] != acting[1] or replace(one, effects=()) != replace(known, effects=()):
        return None
    return replace(other, hypothesis=one, model=replace(other.model, effects=one.effects))


def simulation_of(prediction: Prediction) -> Simulation:
    """Return the simulation behind a prediction of the rig."""
    simulation: Simulation = prediction.state
    return simulation


def rig_effects() -> tuple[str, ...]:
    """Return the ids of the effects that act in the rig."""
    return tuple(name for name, kind in catalogue().items() if FRETTING_RIG in kind.kinds)


def measured(observation: Observation, code_error: Array, total_cycles: int, embedded: Array | None) -> Measurement:
    """Return an observation as the engine takes it."""
    size = len(observation.values)
    labels = tuple(dict.fromkeys(piece.label for piece in observation.pieces))
    channels = tuple(dict.fromkeys(piece.channel for piece in observation.pieces))
    phase, cycles, place = np.full(size, np.nan), np.full(size, np.nan), np.full((size, 2), np.nan)
    rows = {name: np.zeros(size, dtype=np.int64) for name in ("channel", "group", "condition")}
    for piece in observation.pieces:
        rows["channel"][piece.place] = channels.index(piece.channel)
        rows["group"][piece.place] = labels.index(piece.label)
        if piece.block == "loops":
            cycles[piece.place] = piece.cycles / max(total_cycles, 1)
        if piece.block == "map":
            away = observation.points - observation.points.min(axis=0)
            place[piece.place] = away / np.maximum(away.max(axis=0), np.finfo(float).tiny)
        if piece.condition is not None:
            rows["condition"][piece.place] = 1 + piece.condition
            cycles[piece.place] = max(observation.counts) / max(total_cycles, 1)
    for pieces in loop_pieces(observation).values():
        strokes = Strokes.of(*(observation.values[pieces[name].place] for name in ("displacement", "friction_force")))
        for piece in pieces.values():
            phase[piece.place] = strokes.period
    return Measurement(
        values=observation.values, variance=observation.variance, channel=rows["channel"], group=rows["group"],
        condition=rows["condition"],
        modes=observation.modes, code_error=code_error.reshape(size, -1), repeatable=observation.noise,
        channels=channels, groups=labels, phase=phase, cycles=cycles, place=place, embedded=embedded,
        inputs=frozenset({"excitation"} & set(channels)),
        levels=frozenset(name for name in channels if name in CHANNELS and (
            CHANNELS[name].absolute or CHANNELS[name].growing)))
