"""What hypotheses near a simulated one would show, without simulating them.

The data of each period's problem are differenced between the simulated hypothesis and its neighbour (see
`effects.derivative`), and carried to the channels by the exact sensitivities of the period. Over cycles, the change of
the wear rate is integrated with the feedback of depth on pressure, ``dw' = J dw + dr``, and opens the gap. All
neighbours share one march of each period, so that a hundred of them cost little more than one. Laws over cycles
get the wear, energy and motion of the neighbour itself in a second march, to which the first one's changes are carried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import expm

from fretflow.core.errors import FretflowError
from fretflow.core.records import Array
from fretflow.effects.derivative import directions_to
from fretflow.effects.model import EffectModel
from fretflow.experiments.rig.model import RigModel, channel, harmonics_of
from fretflow.experiments.rig.simulation import Hypothesis, Period, Simulation, asperity_motion
from fretflow.inference.experiment import STEP
from fretflow.recordings.schema import MeasuredAt
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.sensitivity import Direction
from fretflow.solvers.sensitivity import DifferentiatedPeriod, PeriodSensitivity
from fretflow.structure.internal_forces import force_beside_friction
from fretflow.structure.sensors import Signals, band_limited
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.wear.archard import wear_rate
from fretflow.wear.cycle import CycleResponse, mean_response
from fretflow.wear.history import WearStep
from fretflow.wear.scheme import DIFFERENCE
from fretflow.wear.slow import SlowState


@dataclass(frozen=True)
class _Neighbour:
    """A hypothesis beside the simulated one: model, slow states at the simulated steps, and problems of the periods."""

    model: EffectModel
    coefficient: float
    slow: dict[int, SlowState]
    problems: dict[int, PeriodicProblem]  # by the periods' ids

    @classmethod
    def of(cls, simulation: Simulation, model: EffectModel, coefficient: float, steps: Sequence[WearStep]
           ) -> _Neighbour:
        """Return a hypothesis that remembers the wear and the periods of `steps`.

        Raises
        ------
        FretflowError
            If its data cannot be made.
        """
        slow = _remembered(simulation, model, steps)
        return cls(model, coefficient, slow, {key: _problem_of(model, slow, simulation, period)
                                              for key, period in _periods(simulation).items()})


def neighbours(rig: RigModel, simulation: Simulation, hypotheses: Sequence[Hypothesis]) -> Array:
    """Return the first-order changes (M, V) of the vector from `simulation` to each of `hypotheses`.

    A hypothesis whose data cannot be made at the simulated motion has a column of nan.
    """
    try:
        return _changes(rig, simulation, hypotheses)
    except FretflowError:  # of one of them, in one of the periods
        if len(hypotheses) == 1:
            return np.full((len(rig.observation.values), 1), np.nan)
        half = len(hypotheses) // 2
        return np.hstack([neighbours(rig, simulation, part) for part in (hypotheses[:half], hypotheses[half:])])


def _changes(rig: RigModel, simulation: Simulation, hypotheses: Sequence[Hypothesis]) -> Array:
    """Return what `neighbours` does, of hypotheses whose data can be made in all periods."""
    known = {_baseline_of(simulation.hypothesis): simulation.model.baseline}
    beside = [_beside(rig, simulation, one, known) for one in hypotheses]
    columns = np.full((len(rig.observation.values), len(beside)), np.nan)
    usable = [v for v, one in enumerate(beside) if one is not None]
    chosen = [one for one in beside if one is not None]
    if not chosen:
        return columns
    periods = {key: _Differentiated.of(period, [one.problems[key] for one in chosen])
               for key, period in _periods(simulation).items()}
    moved = _Moved.of(simulation, chosen, {key: one.first for key, one in periods.items()})
    if not all(np.isfinite(worn).all() for worn in moved.worn.values()):
        return columns
    shown = _shown(rig, simulation, chosen, moved)
    evolving = [v for v, one in enumerate(chosen) if one.model.over_cycles]
    if evolving:
        again = [_evolved(simulation, chosen[v], moved, v) for v in evolving]
        shown[:, evolving] = _shown(rig, simulation, again, _Moved.of(simulation, again, {
            key: one.to([own.problems[key] for own in again]) for key, one in periods.items()}))
    columns[:, usable] = shown
    return columns


@dataclass(frozen=True)
class _Moved:
    """What V neighbours change to first order: the periods, by their ids, and the wear."""

    changes: dict[int, PeriodSensitivity]
    worn: dict[int, Array]  # (nodes, V), m, by the recorded cycle counts

    @classmethod
    def of(cls, simulation: Simulation, chosen: Sequence[_Neighbour], changes: dict[int, PeriodSensitivity]) -> _Moved:
        """Return what neighbours change, by their periods' `changes` and what they remember."""
        worn = _wear(simulation, chosen, {p.step.cycles: changes[id(p)] for p in simulation.loops})
        return cls({key: _with_gap(changes[key], worn[p.step.cycles]) for key, p in _periods(simulation).items()}, worn)


@dataclass(frozen=True)
class _Differentiated:
    """A period with its sensitivities to the changes to some problems and, after them, to the gap of every node."""

    period: Period
    known: DifferentiatedPeriod

    @property
    def first(self) -> PeriodSensitivity:
        """Return the sensitivities that it was marched with."""
        return self.known.first

    @classmethod
    def of(cls, period: Period, problems: Sequence[PeriodicProblem]) -> _Differentiated:
        """Return a period, differentiated."""
        worn = [Direction(name=f"gap of node {m}", gap=row)
                for m, row in enumerate(np.eye(period.problem.interface.size))]
        return cls(period, DifferentiatedPeriod(
            period.problem, period.solution, [*directions_to(problems, period.problem, period.solution), *worn],
            harmonics_of(len(period.solution.state))))

    def to(self, problems: Sequence[PeriodicProblem]) -> PeriodSensitivity:
        """Return the same for other problems."""
        own = self.known.by(directions_to(problems, self.period.problem, self.period.solution))
        gaps = slice(len(self.first.names) - self.period.problem.interface.size, None)
        both: dict[str, Any] = {one.name: np.concatenate([getattr(own, one.name), getattr(self.first, one.name)[gaps]])
                                for one in fields(PeriodSensitivity) if one.name not in ("names", "outputs")}
        outputs = {name: np.concatenate([values, self.first.outputs[name][gaps]])
                   for name, values in own.outputs.items()}
        return PeriodSensitivity(names=(*own.names, *self.first.names[gaps]), outputs=outputs, **both)


def _periods(simulation: Simulation) -> dict[int, Period]:
    """Return all periods of a simulation by their ids."""
    return {id(period): period for period in (*simulation.loops, *simulation.sweep)}


def _shown(rig: RigModel, simulation: Simulation, chosen: Sequence[_Neighbour], moved: _Moved) -> Array:
    """Return the changes (M, V) of the vector."""
    changes = np.zeros((len(rig.observation.values), len(chosen)))
    for key, period in _periods(simulation).items():
        pieces = [piece for piece, seen in rig.pieces(simulation) if seen is period]
        before = rig.signals(period)
        shown = rig.sensed(simulation.model, before)
        after = _signals(rig, chosen, period, [one.problems[key] for one in chosen], moved.changes[key], before)
        for v, one in enumerate(chosen):
            seen_after = rig.sensed(one.model, after[v])
            for piece in pieces:
                changes[piece.place, v] = channel(seen_after, piece) - channel(shown, piece)
    rig.put_wear(changes, moved.worn[simulation.loops[-1].step.cycles])
    return changes


def _baseline_of(hypothesis: Hypothesis) -> tuple[float, ...]:
    """Return what a hypothesis changes in the unworn problem without effects."""
    return hypothesis.friction, hypothesis.mass, hypothesis.compliance, hypothesis.damping


def _beside(rig: RigModel, simulation: Simulation, hypothesis: Hypothesis,
            known: dict[tuple[float, ...], PeriodicProblem]) -> _Neighbour | None:
    """Return a neighbour; `known` problems without effects are shared by those that differ in nothing else."""
    try:
        own = _baseline_of(hypothesis)
        known[own] = known.get(own) or rig.case_problem(hypothesis)
        model = EffectModel.build(known[own], hypothesis.effects)
        return _Neighbour.of(simulation, model, hypothesis.wear * rig.wear_coefficient, simulation.steps)
    except FretflowError:
        return None


def _remembered(simulation: Simulation, model: EffectModel, steps: Sequence[WearStep]) -> dict[int, SlowState]:
    """Return the slow states that wear and periods of `steps` make a model remember, beside those of a simulation.

    A jump is remembered by periods within it that are not kept: what those at its ends make of it counts as a change.
    """
    remembered, own = ([one.initial()] for one in (model, simulation.model))
    for known, one, through in ((remembered, model, steps), (own, simulation.model, simulation.steps)):
        for before, after in pairwise(through):
            slow = one.evolve(known[-1], after.cycles - before.cycles, after.depth - before.depth,
                              after.slow.energy - before.slow.energy, mean_response(before.response, after.response))
            known.append(replace(slow, depth=after.depth, energy=after.slow.energy))
    return {step.cycles: replace(slow, memory={
        name: value + step.slow.memory[name] - like.memory[name] if name in like.memory else value
        for name, value in slow.memory.items()})
        for step, slow, like in zip(simulation.steps, remembered, own, strict=True)}


def _evolved(simulation: Simulation, one: _Neighbour, moved: _Moved, v: int) -> _Neighbour:
    """Return a neighbour whose laws follow the wear, energy and motion that it changes, number v of those that `moved`.

    Far off, where these lead to data that no joint has, they follow the simulated ones.
    """
    kept = [period.step.cycles for period in simulation.loops]
    responses = [_response_change(period, moved.changes[id(period)], v) for period in simulation.loops]
    depths, steps = [moved.worn[cycles][:, v] for cycles in kept], []
    gain = np.array([float(one["dissipated_energy"]) for one in responses])
    energies = gain[0] * kept[0] + cumulative_trapezoid(gain, kept, initial=0.0)
    for step in simulation.steps:
        last = min(int(np.searchsorted(kept, step.cycles)), len(kept) - 1)
        first = max(last - 1, 0)
        share = float(np.interp(step.cycles, (kept[first], kept[last]), (0.0, 1.0))) if last > first else 0.0
        response = {name: (1.0 - share) * value + share * responses[last][name]
                    for name, value in responses[first].items()}
        depth = np.maximum(step.depth + (1.0 - share) * depths[first] + share * depths[last], 0.0)
        energy = max(step.slow.energy + float(np.interp(step.cycles, (0, *kept), (0.0, *energies))), 0.0)
        steps.append(replace(step, slow=replace(step.slow, depth=depth, energy=energy),
                             response=_added(step.response, response)))
    try:
        return _Neighbour.of(simulation, one.model, one.coefficient, steps)
    except FretflowError:
        return one


def _response_change(period: Period, change: PeriodSensitivity, v: int) -> dict[str, Array]:
    """Return what neighbour v changes of a period's response, by its fields."""
    names = {field.name for field in fields(CycleResponse)} & {field.name for field in fields(PeriodSensitivity)}
    arm, own = period.solution.output("arm"), change.outputs["arm"][v]
    return {name: getattr(change, name)[v] for name in sorted(names)} | {
        "arm_range": own[np.argmax(arm)] - own[np.argmin(arm)]}


def _added(response: CycleResponse, change: Mapping[str, Array]) -> CycleResponse:
    """Return a response with the changes of some of its fields."""
    return replace(response, **{name: getattr(response, name) + value for name, value in change.items()})


def _problem_of(model: EffectModel, known: dict[int, SlowState], simulation: Simulation, period: Period
                ) -> PeriodicProblem:
    """Return a model's problem at the period's condition and wear."""
    own, condition = model.baseline, period.condition
    own = condition if own is simulation.model.baseline else replace(
        own, excitation=condition.excitation, preload=condition.preload)
    slow = known[period.step.cycles]
    problem = replace(model, baseline=own).problem(slow)
    face, opened = problem.interface, slow.depth - period.step.depth  # which `_with_gap` adds
    return replace(problem, interface=replace(face, gap=face.gap - opened)) if opened.any() else problem


def _wear(simulation: Simulation, beside: Sequence[_Neighbour], changes: dict[int, PeriodSensitivity]
          ) -> dict[int, Array]:
    """Integrate the change of depth (nodes, V) of each neighbour over the recorded cycle counts.

    It is nan from where the faces are unstable, as where what is pressed more wears less: no change stays small there.
    """
    depth = np.zeros((len(simulation.depth), len(beside)))
    depths, before = {0: depth}, simulation.loops[0]
    rate = _rate_change(before, beside, changes[before.step.cycles])
    for period in simulation.loops:
        cycles = period.step.cycles - (before.step.cycles if period is not before else 0)
        last, rate = rate, _rate_change(period, beside, changes[period.step.cycles])
        if cycles > 0:
            jacobian = 0.5 * (_feedback(simulation, before, changes, cycles)
                              + _feedback(simulation, period, changes, cycles))
            depth = _linear(cycles * jacobian, depth, cycles * last, cycles * rate)
        depths[period.step.cycles], before = depth, period
    return depths


def _feedback(simulation: Simulation, period: Period, changes: dict[int, PeriodSensitivity], cycles: int) -> Array:
    """Return the change (nodes, nodes) of the wear rate by the depth, of which a share opens the gap in some cycles."""
    change, slow = changes[period.step.cycles], period.step.slow
    gaps = range(len(change.names) - len(slow.depth), len(change.names))
    own = _Neighbour(simulation.model, simulation.coefficient, {period.step.cycles: slow}, {})
    pressed = float(np.abs(change.mean_pressure[list(gaps)]).max(initial=0.0))  # Pa/m
    small = DIFFERENCE * float(period.step.response.mean_pressure.max()) / pressed if pressed > 0.0 else 1.0
    by_gap = np.stack([_rate_of(own, period, change, m, small) - period.step.rate for m in gaps], axis=1) / small
    return np.asarray(by_gap * simulation.model.opening_share(slow, cycles))


def _linear(jacobian: Array, start: Array, first: Array, last: Array) -> Array:
    """Return w(1) (n, V) of ``w' = J w + first + t (last - first)``, ``w(0) = start``, for J (n, n) of any size.

    It is nan where the step of derivatives would grow to all that was uncertain, which is no change of first order.
    """
    n = len(jacobian)
    blocks = np.zeros((3 * n, 3 * n))
    blocks[:n, :n] = jacobian
    blocks[:2 * n, n:] += np.eye(2 * n)
    with np.errstate(over="ignore", invalid="ignore"):
        exponential, constant, ramp = np.hsplit(expm(blocks)[:n], 3)
    if not STEP * np.abs(exponential).max() < 1.0:
        return np.full_like(start, np.nan)
    return np.asarray(exponential @ start + constant @ first + ramp @ (last - first))


def _rate_change(period: Period, beside: Sequence[_Neighbour], change: PeriodSensitivity) -> Array:
    """Return the change (nodes, V) of the wear rate at the simulated wear."""
    return np.stack([_rate_of(one, period, change, v) - period.step.rate for v, one in enumerate(beside)], axis=1)


def _rate_of(one: _Neighbour, period: Period, change: PeriodSensitivity, row: int, share: float = 1.0) -> Array:
    """Return the wear rate (nodes,) of a model with a share of what a row of sensitivities changes of a period."""
    moved = _added(period.step.response, {
        name: share * value for name, value in _response_change(period, change, row).items()})
    return wear_rate(one.coefficient, moved) * one.model.wear_factor(moved, one.slow[period.step.cycles])


def _with_gap(change: PeriodSensitivity, opened: Array) -> PeriodSensitivity:
    """Return the change by V neighbours with that of the gap `opened` (nodes, V), by the gaps of nodes after them."""
    count = opened.shape[1]
    level = opened.min(axis=0)  # only lowers the arm
    weights = np.vstack([np.eye(count), opened - level])
    added: dict[str, Any] = {name: np.tensordot(weights, getattr(change, name), axes=(0, 0)) for name in (
        field.name for field in fields(PeriodSensitivity) if field.name not in ("names", "outputs"))}
    outputs = {name: np.tensordot(weights, values, axes=(0, 0)) for name, values in change.outputs.items()}
    outputs["approach"] = outputs["approach"] - level[:, None]
    return replace(change, names=change.names[:count], **added, outputs=outputs)


def _signals(rig: RigModel, beside: Sequence[_Neighbour], period: Period, problems: Sequence[PeriodicProblem],
             change: PeriodSensitivity, before: Signals) -> list[Signals]:
    """Return the true channels of neighbours, of `problems`, at a period whose own were `before`."""
    moved: dict[str, Array] = {
        "displacement": _displacement(rig, beside, period, problems, change), "arm": change.outputs["arm"],
        "friction_force": change.friction_force + np.stack([
            _more_beside(period, other, change.internal[v]) for v, other in enumerate(problems)]),
        "excitation": np.stack([_more_excitation(period, other) for other in problems]),
        "normal_force": np.stack([_load(other, period, change.outputs["arm"][v]) for v, other in enumerate(problems)])
        - _load(period.problem, period, 0.0), "approach": -change.outputs["approach"]}
    shown = {name: getattr(before, name) + band_limited(values, rig.observation.harmonics)
             for name, values in moved.items()}
    return [replace(before, **{name: values[v] for name, values in shown.items()}) for v in range(len(problems))]


def _displacement(rig: RigModel, beside: Sequence[_Neighbour], period: Period, problems: Sequence[PeriodicProblem],
                  change: PeriodSensitivity) -> Array:
    """Return the change (V, N) of the displacement where the recording measured it, m."""
    if rig.displacement_of.place is MeasuredAt.CONTACT_FACES:
        return change.relative_displacement - np.stack([
            _more_asperity_motion(period, other, one.model.baseline, change.friction_force[v])
            for v, (one, other) in enumerate(zip(beside, problems, strict=True))])
    if rig.displacement_of.place is MeasuredAt.BACK_FACES:
        return change.outputs["arm"]
    return np.asarray((change.outputs["upper"] - change.outputs["lower"])[:, :, 0])


def _more_beside(period: Period, other: PeriodicProblem, moved: Array) -> Array:
    """Return the change (N,) of what a sensor sees beside friction, as the coordinates move by `moved` (N, d) more."""
    own, motion = period.problem.boundary.forces, period.solution.internal
    if not own and not other.boundary.forces:
        return np.zeros(len(motion))
    sliding, omega = period.problem.boundary.sliding, period.problem.omega
    then, now = (force_beside_friction(forces, x, time_derivative(x, omega), sliding)
                 for forces, x in ((other.boundary.forces, motion + moved), (own, motion)))
    return then - now


def _more_excitation(period: Period, other: PeriodicProblem) -> Array:
    """Return the change (N,) of the drive by its overtones."""
    now, samples = period.problem.excitation, len(period.solution.state)
    if other.excitation.overtones == now.overtones:
        return np.zeros(samples)
    phase = 2.0 * np.pi * np.arange(samples) / samples
    then = replace(now, overtones=other.excitation.overtones)
    return np.asarray(then.at_phases(phase)["block"] - now.at_phases(phase)["block"])


def _load(problem: PeriodicProblem, period: Period, moved: Array | float) -> Array:
    """Return the normal load (N,) of a problem as the arm moves by `moved` more than in the period."""
    return problem.normal_load + rig_of(problem.structure).rig.load_at(period.solution.output("arm") + moved)


def _more_asperity_motion(period: Period, other: PeriodicProblem, bare: PeriodicProblem, force: Array) -> Array:
    """Return the change (N,) of `asperity_motion` to `other`, as the friction force changes by `force` (N,) in all.

    `bare` is the other one without asperities.
    """
    now, then = asperity_motion(period, period.problem, period.condition), asperity_motion(period, other, bare)
    if not np.any(then):
        return -now
    friction = period.solution.friction_force
    return np.asarray(then - now + float(then @ friction) / float(friction @ friction) * force)
