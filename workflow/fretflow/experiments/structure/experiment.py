"""The backbone of a structure under the inference engine: frequency and damping of one mode over its amplitude.

What the baseline refits is the bolt load, the friction coefficient and the modal damping of the structure without its
joint; a value that is stated counts as known to `STATED`. Predictions are quasi-static (`solvers.nonlinear_modes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import Coulomb
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Prior, RecordedSize, in_acting_order
from fretflow.experiments.structure.coarser import coarser, mesh_errors
from fretflow.experiments.structure.observation import MATRICES, NOMINAL, BackboneObservation, moves_alike
from fretflow.experiments.structure.points import SLIDES, BackbonePoints, averaging, shrunk, with_backbone
from fretflow.experiments.structure.responses import POWERS
from fretflow.inference.experiment import TOLERANCE, Experiment, Measurement, Point, Prediction, differences
from fretflow.inference.parameters import HALF, Coordinate, Parameters
from fretflow.recordings.kinds.structure_sections import TYPICAL
from fretflow.recordings.kinds.structures import MeasuredBackbone, StructureRecording
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode
from fretflow.solvers.nonlinear_modes.periodic_mode import (
    DYNAMIC,
    HARMONICS,
    SAMPLES,
    PeriodicMode,
    condensed,
    periodic_mode,
)
from fretflow.solvers.nonlinear_modes.quasi_static import STEPS, ModalBackbone, quasi_static_backbone
from fretflow.structure.reduction.contact_modes import COMPARED, RIGID_MOTIONS, ReducedStructure, reduce_structure

STATED = 0.05  # sd of the logarithm of a bolt load, friction or damping that the recording states as known
FEW = 10  # contact points, up to which each prediction is of periodic motions: 0.05 s, and a diagnosis has a minute
MANY = 40  # contact points, from which on predictions take their time
DRAWS = 16  # of what chance decides: their sd is known to a sixth
THIRDS = ("small amplitudes", "middle amplitudes", "large amplitudes")  # of the points; the last are held out


@dataclass(frozen=True)
class StructureExperiment(Experiment):
    """A structure's model against a backbone."""

    recording: StructureRecording
    structure: ReducedStructure
    points: BackbonePoints
    mode: int  # among the linear modes of the preloaded structure, from 0
    steps: int = STEPS
    about: Point | None = None  # the baseline whose numerical errors are told; the first prediction's by default
    draw: int = 0  # of what effects leave to chance
    static: bool = False  # static loads alone, as quasi-static simulators take them, however few contact points
    correction: Array | None = None  # (channels, points): what periodic motions add to static loads
    truncation: Array | None = None  # what twice the harmonics and samples add to that
    coarse: ReducedStructure | None = None  # the structure with points twice as far apart
    spacing: float = 1.0  # of contact points in what was recorded, over that of the matrices
    matched: bool = True  # whether the matrices are to the parts that were recorded, or of a drawing
    or_finer: bool = False  # whether nothing would be missing if those of a finer mesh had been recorded

    @classmethod
    def of(cls, recording: StructureRecording) -> StructureExperiment:
        """Return the experiment of a recording with a backbone.

        Raises
        ------
        InputError
            If the structure has no such mode, or nothing presses its joint together.
        """
        recording = with_backbone(recording)
        if recording.backbone is None:
            raise InputError(f"{recording.path}: has none of [backbone], [ring_down] and [[frf]]")
        try:
            bare = cls(recording, reduce_structure(recording.matrices), BackbonePoints.of(recording.backbone), 0)
            space = bare.parameters(())
            modes = bare.joint(Point(space, np.zeros(space.size))).linear_modes(RIGID_MOTIONS + COMPARED)
            experiment = replace(bare, mode=(number := bare.observation.number(modes)))
            if "modal_damping" not in {*recording.known, *recording.unknown} and bare.structure.damping is not None:
                ratio = modes[number].damping_ratio(bare.structure.damping)
                known = {**recording.known, "modal_damping": ratio}
                experiment = replace(experiment, recording=replace(recording, known=known))
        except InputError as error:
            raise InputError(f"{recording.path}: {error}") from error
        highest = DYNAMIC * 2.0 * np.pi * float(experiment.points.frequency.max())
        kept = max(RIGID_MOTIONS + COMPARED, int(np.sum(experiment.structure.eigenvalues < highest**2)))
        structure = condensed(experiment.structure, kept)
        return replace(experiment, structure=structure, coarse=coarser(structure))

    @property
    def few(self) -> bool:
        """Return whether there are so few contact points that each prediction may be of periodic motions."""
        return self.structure.contacts <= FEW

    @property
    def many(self) -> bool:
        """Return whether there are so many contact points that predictions take their time."""
        return self.structure.contacts > MANY

    @property
    def recorded(self) -> MeasuredBackbone:
        """Return the backbone as it was recorded."""
        if self.recording.backbone is None:
            raise InputError(f"{self.recording.path}: has no [backbone]")
        return self.recording.backbone

    @cached_property
    def observation(self) -> BackboneObservation:
        """Return how motions of the structure show in the backbone."""
        return BackboneObservation(self.structure, self.recorded, float(self.points.frequency[0]))

    @cached_property
    def measurement(self) -> Measurement:
        """Return frequencies, then damping ratios; the place along the backbone stands for half of a loop's phase."""
        own, count = self.points, len(self.points.amplitude)
        blocks = [(own.frequency, own.frequency_sd)]
        if own.damping is not None:
            blocks.append((own.damping, own.damping_sd))
        parts, rows = len(blocks), len(blocks) * count
        values = np.concatenate([values for values, _ in blocks])
        place = np.log(own.amplitude)
        share = np.tile(0.5 * (place - place[0]) / max(float(np.ptp(place)), 1e-12), parts)
        matrices = np.r_[(MATRICES if self.matched else NOMINAL) * own.frequency, np.zeros(rows - count)]
        gain = np.concatenate([np.gradient(values, place) for values, _ in blocks]) * self.recorded.calibration_sd
        noise = np.concatenate([sd**2 for _, sd in blocks])
        rough = np.concatenate([averaging(place, values) for values, _ in blocks])
        decrement = np.r_[np.zeros(count), own.of_decay][:rows]  # or a ratio of energies: nothing says which was taken
        # steps of load may change nothing, as where all sticks; other matrices of the same parts still would
        about = np.concatenate([values - values.mean() for values, _ in blocks])
        return Measurement.of(
            values, noise + rough**2, modes=np.column_stack([matrices, gain, decrement]),
            code_error=np.column_stack([self._code_error, MATRICES * about]), repeatable=noise / (noise + rough**2),
            channel=np.repeat(np.arange(parts), count), channels=("frequency", "damping")[:parts], phase=share,
            groups=("backbone",))

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """Return the rows (M,) that judge a prediction: the largest amplitudes of each channel."""
        return np.tile(self.third == len(THIRDS) - 1, len(self.measurement.channels))

    @property
    def third(self) -> NDArray[np.int64]:
        """Return in which third of the points each is, (P,), from the smallest amplitudes on."""
        parts = np.array_split(np.arange(len(self.points.amplitude)), len(THIRDS))
        return np.repeat(np.arange(len(THIRDS)), [len(own) for own in parts])

    def first_prediction(self) -> Prediction:
        """Return what the baseline predicts in the middle of its ranges; where all slides there, with tighter bolts.

        Raises
        ------
        NonConvergenceError
            If all slides there too.
        """
        if self.about is not None:
            return self.predict(self.about)
        space = self.parameters(())
        tight = np.array([one.field == "bolt_load" for one in space.coordinates], dtype=float)
        try:
            return self.predict(Point(space, np.zeros(space.size)))
        except NonConvergenceError:
            return self.predict(Point(space, HALF * tight))

    @cached_property
    def _fine(self) -> Array:
        """Return what static loads predict, with twice the steps, of the baseline whose numerical errors are told."""
        return replace(self, correction=None, steps=2 * self.steps).first_prediction().values

    @property
    def _code_error(self) -> Array:
        """Return what more steps of load, more harmonics of periodic motions and another mesh change, (M, any)."""
        first = replace(self, correction=None).first_prediction()
        more = [] if self.truncation is None else [self.truncation.ravel()]
        return np.column_stack([self._fine - first.values, *more, self._other_mesh(first)])

    def _other_mesh(self, prediction: Prediction) -> Array:
        """Return modes (M, any) of what a prediction of static loads differs by on the mesh that was recorded."""
        try:
            other = prediction if self.coarse is None or self.spacing == 1.0 else replace(
                self, structure=self.coarse, correction=None, static=True).predict(prediction.point)
        except NonConvergenceError:
            other = prediction
        return mesh_errors(np.log(self.points.amplitude), other.values - prediction.values, self.spacing)

    def as_recorded(self, prediction: Prediction) -> Array:
        """Return predicted values (M,) with the error of the matrices' frequencies that the recording tells."""
        known = self.measurement.covariance()
        share = float(known.shared(self.measurement.values - prediction.values)[0])
        return np.asarray(prediction.values + share * known.modes[:, 0])

    def candidates(self) -> tuple[str, ...]:
        """Return the ids of the effects that act in a bolted structure; on damping alone, where it was recorded."""
        return tuple(name for name, kind in catalogue().items() if "bolted" in vars(kind))

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of bolt load, friction and modal damping, and of `effects`."""
        baseline = []
        for name in ("bolt_load", "friction_coefficient", "modal_damping"):
            if name in self.recording.unknown:
                baseline.append(Coordinate.within("", name, *self.recording.unknown[name], True))
            elif self.recording.known.get(name, 0.0) > 0.0:
                baseline.append(Coordinate("", name, log(self.recording.known[name]), STATED, True))
        return Parameters.of(baseline, effects, signs, self._scaled)

    def beginnings(self) -> list[Point]:
        """Return baselines all over the range of the load or the friction at which points slide, whichever is wider.

        Where all stick at all amplitudes, or slide at all, nothing tells by how much they should less.
        """
        space = self.parameters(())
        size = [one.size * (one.field != "modal_damping") for one in space.coordinates]
        laid = np.linspace(-HALF, HALF, 1 + int(2.0 * HALF / 0.5))  # half of a sd apart
        return [Point(space, at * np.eye(space.size)[int(np.argmax(size))]) for at in laid]

    def released(self) -> StructureExperiment:
        """Return the same as if nothing were said of the stated values."""
        own = self.recording
        ranges = {name: (min(TYPICAL[name][0], 0.5 * value), max(TYPICAL[name][1], 2.0 * value))
                  for name, value in own.known.items() if value > 0.0}
        kept = {name: value for name, value in own.known.items() if name not in ranges}
        return replace(self, recording=replace(own, known=kept, unknown={**own.unknown, **ranges}))

    def at(self, point: Point) -> Point:
        """Return the point of this experiment's parameters that has the values of another experiment's."""
        space, values = self.parameters(point.parameters.effects, point.parameters.signs), point.parameters.values(
            point.z)
        return Point(space, np.array([one.place(values[one.effect][one.field]) for one in space.coordinates]))

    def _scaled(self, effect: str, field: str, prior: Prior) -> Prior | None:
        """Return a range of the catalogue, which is a rig's, at the size of the structure."""
        own, (joint, mode) = self.points.damping, self._bare
        least, most = TYPICAL["modal_damping"]
        if own is not None:
            least, most = max(least, float(own.min())), float(own[-1])
        return catalogue()[effect].bolted_range(field, prior, joint, RecordedSize(
            float(self.points.amplitude[-1]) / self.observation.gain(mode), most, least))

    def joint(self, point: Point) -> BoltedJoint:
        """Return the joint of a hypothesis."""
        own = point.parameters.values(point.z)[""]
        joint = BoltedJoint(structure=self.structure, bolt_load=own["bolt_load"],
                            law=Coulomb(friction_coefficient=np.array(own["friction_coefficient"])),
                            modal_damping=own.get("modal_damping", 0.0))  # stated as none
        for effect in in_acting_order(point.built()):
            joint = effect.bolted_anew(joint, self.draw) if self.draw else effect.bolted(joint)
        return joint

    def by_chance(self, prediction: Prediction) -> Array:
        """Return what other draws change of a prediction whose effects leave something to chance, (M, any).

        Of many contact points the mean leaves little of it.
        """
        if self.many or not any("bolted_anew" in vars(type(one)) for one in prediction.point.built()):
            return np.zeros((len(prediction.values), 0))
        rough = replace(self, static=True)
        first, changes = rough.predict(prediction.point, prediction).values, []
        for draw in range(1, DRAWS + 1):
            try:
                changes.append(replace(rough, draw=draw).predict(prediction.point, prediction).values - first)
            except NonConvergenceError:
                continue
        return shrunk(np.array(changes).reshape(-1, len(first)).T)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the backbone of a hypothesis at the recorded amplitudes.

        Raises
        ------
        NonConvergenceError
            If no amplitude has an equilibrium, or with the effects of the hypothesis the bolts close no contact.
        """
        try:
            joint = self.joint(point)
            alike = near is not None and not self.draw and moves_alike(joint, self.joint(near.point))
            curve = near.state.of(joint) if near is not None and alike else self.backbone(joint, near)
        except InputError as error:
            if point.effects:
                raise NonConvergenceError(str(error)) from error
            raise
        amplitude = self.points.amplitude
        values = self.points.read(amplitude, self.observation.seen(curve), curve.frequency, curve.damping)
        more = self.correction if self.static or not self.few else self._beyond_static_loads(joint, curve)
        return Prediction(point, (values if more is None else values + more).ravel(), curve)

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return the changes (M, V) from a prediction to hypotheses; to its neighbours, linear ones.

        Where points begin to slide one by one, curves have kinks, of which a derivative sees one side; and what samples
        of a period leave out jumps from one instant to the next. Over as much as the recording leaves open both are
        small: changes are linear between both ends of that, along the axes of the posterior (statistical linearisation:
        A. Gelb, Applied Optimal Estimation (1974), section 6.2), which static loads tell.
        """
        space, whiten = prediction.point.parameters, self.measurement.covariance().whiten
        if self.many or any(one.parameters != space for one in points):
            return differences(self, prediction, points)
        rough = replace(self, static=True)
        still = rough.predict(prediction.point, prediction)
        beside, steps = prediction.point.beside()
        slopes = whiten(np.nan_to_num(differences(rough, still, beside)) / steps)
        told, joint = np.eye(space.size) + slopes.T @ slopes, self.joint(still.point)
        moving = [not moves_alike(self.joint(one), joint) for one in beside]
        sharp, axes = np.linalg.eigh(np.where(np.equal.outer(moving, moving), told, 0.0))  # damping costs nothing
        ends = axes / np.sqrt(sharp)
        both = [[replace(prediction.point, z=prediction.point.z + way * one) for one in ends.T] for way in (1.0, -1.0)]
        forth, back = (differences(self, prediction, one) for one in both)
        change = 0.5 * (np.where(np.isfinite(forth), forth, -back) - np.where(np.isfinite(back), back, -forth))
        moves = np.array([one.z - prediction.point.z for one in points])
        return np.asarray(np.nan_to_num(change) @ (np.sqrt(sharp)[:, None] * axes.T @ moves.T))

    def first(self, count: int) -> StructureExperiment:
        """Return the experiment of the `count` points of the smallest amplitudes."""
        correction, truncation = (None if one is None else one[:, :count] for one in (self.correction, self.truncation))
        return replace(self, points=self.points.first(count), correction=correction, truncation=truncation)

    def backbone(self, joint: BoltedJoint, near: Prediction | None = None) -> ModalBackbone:
        """Return the backbone about the recorded amplitudes, or as far as the joint does not slide as a whole.

        Where a model is near the recording, its amplitudes are the recorded ones: curves have kinks, where points begin
        to slide, between which nothing may be interpolated over wide steps.
        """
        mode = joint.linear_modes(self.mode + 1)[self.mode]
        power = 2 - POWERS.get(self.recorded.amplitude_unit, 0)
        asked = self.points.amplitude / self.observation.gain(mode) * (self.points.frequency / mode.frequency)**power
        first, second = np.unique(asked)[:2]
        asked = np.r_[first**2 / second, asked]  # as softer models move further than they are asked to
        while len(asked) > 1:
            try:
                return quasi_static_backbone(joint, mode, asked, self.steps, None if near is None else near.state)
            except NonConvergenceError:
                asked = asked[:-max(1, len(asked) // 4)]
        raise NonConvergenceError(SLIDES)

    @cached_property
    def _bare(self) -> tuple[BoltedJoint, LinearMode]:
        middles = {name: float(np.sqrt(low * high)) for name, (low, high) in self.recording.unknown.items()}
        middles |= {name: value for name, value in self.recording.known.items() if value > 0.0}
        space = Parameters.of([Coordinate("", name, log(value), STATED, True) for name, value in middles.items()], ())
        joint = self.joint(Point(space, np.zeros(space.size)))
        return joint, joint.linear_modes(self.mode + 1)[self.mode]

    def corrected(self, prediction: Prediction) -> StructureExperiment | None:
        """Return the same with what static loads leave out at a prediction put right; None where nothing is left out.

        Of few contact points every prediction is that of periodic motions.
        """
        more = None if self.few or self.static else self.beyond_static_loads(prediction)
        return None if more is None else replace(self, correction=more)

    def with_errors_at(self, prediction: Prediction) -> StructureExperiment:
        """Return the same with its numerical errors told, and as far as they are known put right, at a prediction."""
        about = replace(self, about=prediction.point)
        more, most = (None if self.static else about.beyond_static_loads(prediction, finer) for finer in (1, 2))
        return replace(about, correction=None if self.few else more,
                       truncation=None if more is None or most is None else most - more)

    def told_at(self, prediction: Prediction) -> StructureExperiment:
        """Return the same with its numerical errors at a prediction; what that misses tells errors of measurement."""
        told, rows = self.with_errors_at(prediction), len(self.points.amplitude)
        still = replace(self, static=True, correction=None).predict(prediction.point, prediction)
        static = still.values.reshape(-1, rows)
        values = prediction.values.reshape(-1, rows) if told.correction is None else static + told.correction
        points = BackbonePoints.of(self.recorded, (values, static))
        return replace(told, points=points.weighed(self.measurement.values.reshape(values.shape) - values))

    def readings(self) -> tuple[StructureExperiment, ...]:
        """Return the same for recordings of the same mesh and of one much finer, as real faces are.

        And for those of the same mesh that a simulator made by static loads.
        """
        spacings = (1.0,) if self.coarse is None else (1.0, 0.0)
        return (*(replace(self, spacing=one) for one in spacings),
                replace(self, static=True, correction=None, truncation=None))

    def beyond_static_loads(self, prediction: Prediction, finer: int = 1) -> Array | None:
        """Return what periodic motions of a prediction's joint add to static loads (channels, points), if there are."""
        return self._beyond_static_loads(self.joint(prediction.point), prediction.state, finer)

    def _beyond_static_loads(self, joint: BoltedJoint, curve: ModalBackbone, finer: int = 1) -> Array | None:
        """Return what periodic motions, with `finer` times the harmonics and samples, add (channels, points).

        Static loads keep the shape of the linear mode; where much slides or opens, a motion's own shape is another.
        Below the amplitude from which something does, and above that up to which there are periodic motions, the
        difference stays what it is there.
        """
        order, mode = np.argsort(curve.amplitude), joint.linear_modes(self.mode + 1)[self.mode]
        seen = self.observation.seen(curve)[order]
        busy = (curve.sliding[order] > 0) | (curve.open[order] > int(np.sum(~joint.closed)))
        onset = seen[int(np.argmax(busy))] if busy.any() else seen[-1]
        asked = self.points.amplitude[max(int(np.sum(self.points.amplitude < onset)) - (2 if self.few else 1), 0):]
        modes: list[PeriodicMode] = []
        moved: list[float] = []
        for amplitude in asked[::1 + self.structure.contacts // MANY]:
            modal = amplitude / (moved[-1] / modes[-1].amplitude if modes else self.observation.gain(mode))
            try:
                modes.append(periodic_mode(joint, mode, modal, HARMONICS * finer, SAMPLES * finer, TOLERANCE,
                                           modes[-1] if modes else None))
            except NonConvergenceError:
                break
            moved.append(float(self.observation.seen(modes[-1])))
        if len(modes) < 2:
            return None
        periodic = [np.array([getattr(one, name) for one in modes]) for name in ("frequency", "damping")]
        at = np.clip(self.points.amplitude, min(moved), max(moved))
        return self.points.read(at, np.array(moved), *periodic) - self.points.read(
            at, seen, curve.frequency[order], curve.damping[order])
