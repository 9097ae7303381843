"""What hypotheses near a simulated one would show, without simulating them.

The data of each period's problem are differenced between the simulated hypothesis and its neighbour (see
`effects.derivative`), and carried to the channels by the exact sensitivities of the period. Over cycles, the change of
the wear rate is integrated with the feedback of depth on pressure, ``dw' = J dw + dr``, and opens the gap. All
neighbours share one march of each period, so that a hundred of them cost little more than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from fretflow.core.errors import FretflowError
from fretflow.effects.derivative import directions_to
from fretflow.effects.model import EffectModel
from fretflow.experiments.rig.model import (
    Hypothesis,
    Period,
    RigModel,
    Simulation,
    asperity_motion,
    channel,
    harmonics_of,
)
from fretflow.experiments.rig.observation import Array
from fretflow.recordings.schema import MeasuredAt
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.sensitivity import Direction
from fretflow.solvers.sensitivity import PeriodSensitivity, sensitivities
from fretflow.structure.internal_forces import force_beside_friction
from fretflow.structure.sensors import Signals, band_limited
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.wear.archard import wear_rate
from fretflow.wear.feedback import Feedback
from fretflow.wear.slow import SlowState


@dataclass(frozen=True)
class _Neighbour:
    """A hypothesis beside the simulated one: its model, and its slow states at the simulated steps."""

    model: EffectModel
    coefficient: float
    slow: dict[int, SlowState]


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
    found = np.zeros((len(columns), len(chosen)))
    periods = {id(period): period for period in (*simulation.loops, *simulation.sweep)}
    problems = {key: [_problem_of(one, simulation, period) for one in chosen] for key, period in periods.items()}
    changes = {key: _carried(period, directions_to(problems[key], period.problem, period.solution))
               for key, period in periods.items()}
    worn = _wear(simulation, chosen, {p.step.cycles: changes[id(p)] for p in simulation.loops})
    changes = {key: _with_gap(changes[key], worn[period.step.cycles]) for key, period in periods.items()}
    for key, period in periods.items():
        pieces = [piece for piece, seen in rig.pieces(simulation) if seen is period]
        before = rig.signals(period)
        shown = rig.sensed(simulation.model, before)
        after = _signals(rig, chosen, period, problems[key], changes[key], before)
        for v, one in enumerate(chosen):
            seen_after = rig.sensed(one.model, after[v])
            for piece in pieces:
                found[piece.place, v] = channel(seen_after, piece) - channel(shown, piece)
    rig.put_wear(found, worn[simulation.loops[-1].step.cycles])
    columns[:, usable] = found
    return columns


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
        slow, states = model.initial(), dict[int, SlowState]()
        states[0] = slow
        for before, after in zip(simulation.steps, simulation.steps[1:], strict=False):
            moved = model.evolve(slow, after.cycles - before.cycles, after.depth - before.depth,
                                 after.slow.energy - before.slow.energy, after.response)
            slow = replace(moved, depth=after.depth, energy=after.slow.energy)
            states[after.cycles] = slow
    except FretflowError:
        return None
    return _Neighbour(model, hypothesis.wear * rig.wear_coefficient, states)


def _problem_of(one: _Neighbour, simulation: Simulation, period: Period) -> PeriodicProblem:
    """Return the neighbour's problem at the period's condition and wear."""
    own, condition = one.model.baseline, period.condition
    own = condition if own is simulation.model.baseline else replace(
        own, excitation=condition.excitation, preload=condition.preload)
    return replace(one.model, baseline=own).problem(one.slow[period.step.cycles])


def _carried(period: Period, directions: Sequence[Direction]) -> PeriodSensitivity:
    """Return the sensitivities to some directions and, after them, to the gap of every node that may wear."""
    worn = [Direction(name=f"gap of node {m}", gap=row)
            for m, row in enumerate(np.eye(period.problem.interface.size if period.step.cycles else 0))]
    return sensitivities(period.problem, period.solution, [*directions, *worn],
                         harmonics_of(len(period.solution.state)))


def _wear(simulation: Simulation, beside: Sequence[_Neighbour], changes: dict[int, PeriodSensitivity]
          ) -> dict[int, Array]:
    """Integrate the change of depth (nodes, V) of each neighbour over the recorded cycle counts."""
    depth = np.zeros((len(simulation.depth), len(beside)))
    found, before = {0: depth}, simulation.loops[0]
    rate = _rate_change(before, beside, changes[before.step.cycles])
    for period in simulation.loops:
        cycles = period.step.cycles - (before.step.cycles if period is not before else 0)
        last, rate = rate, _rate_change(period, beside, changes[period.step.cycles])
        if cycles > 0:
            jacobian = 0.5 * (_feedback(simulation, before, cycles) + _feedback(simulation, period, cycles))
            depth = _linear(cycles * jacobian, depth, cycles * last, cycles * rate)
        found[period.step.cycles], before = depth, period
    return found


def _feedback(simulation: Simulation, period: Period, cycles: int) -> Array:
    """Return the change (nodes, nodes) of the wear rate by the depth, of which a share opens the gap in some cycles."""
    step = period.step
    coefficient = np.divide(step.rate, step.response.pressure_sliding, out=np.zeros(len(step.rate)),
                            where=step.response.pressure_sliding > 0.0)
    flexibility = period.problem.boundary.flexibility[2::3, 2::3]
    found = Feedback(flexibility, period.problem.interface.areas).rate_jacobian(coefficient, step.response)
    return np.asarray(found * simulation.model.opening_share(step.slow, cycles))


def _linear(jacobian: Array, start: Array, first: Array, last: Array) -> Array:
    """Return w(1) (n, V) of ``w' = J w + first + t (last - first)``, ``w(0) = start``, for J (n, n) of any size."""
    n = len(jacobian)
    blocks = np.zeros((3 * n, 3 * n))
    blocks[:n, :n] = jacobian
    blocks[:2 * n, n:] += np.eye(2 * n)
    exponential, constant, ramp = np.hsplit(expm(blocks)[:n], 3)
    return np.asarray(exponential @ start + constant @ first + ramp @ (last - first))


def _rate_change(period: Period, beside: Sequence[_Neighbour], change: PeriodSensitivity) -> Array:
    """Return the change (nodes, V) of the wear rate at the simulated wear."""
    response, rates = period.step.response, []
    for v, one in enumerate(beside):
        moved = replace(response, pressure_sliding=response.pressure_sliding + change.pressure_sliding[v],
                        slip_path=response.slip_path + change.slip_path[v],
                        mean_pressure=response.mean_pressure + change.mean_pressure[v],
                        dissipated_energy=response.dissipated_energy + float(change.dissipated_energy[v]),
                        sliding_distance=response.sliding_distance + float(change.sliding_distance[v]))
        factor = one.model.wear_factor(moved, one.slow[period.step.cycles])
        rates.append(wear_rate(one.coefficient, moved) * factor - period.step.rate)
    return np.stack(rates, axis=1)


def _with_gap(change: PeriodSensitivity, opened: Array) -> PeriodSensitivity:
    """Return the change by V neighbours with that of the gap `opened` (nodes, V), by the gaps of nodes after them."""
    count = opened.shape[1]
    if len(change.names) == count:
        return change
    level = opened.min(axis=0)  # only lowers the arm
    weights = np.vstack([np.eye(count), opened - level])
    added = {name: np.tensordot(weights, getattr(change, name), axes=(0, 0))
             for name in ("internal", "relative_displacement", "friction_force")}
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
    return problem.normal_load + rig_of(problem.structure).rig.load_slope * (period.solution.output("arm") + moved)


def _more_asperity_motion(period: Period, other: PeriodicProblem, bare: PeriodicProblem, force: Array) -> Array:
    """Return the change (N,) of `asperity_motion` to `other`, as the friction force changes by `force` (N,) in all.

    `bare` is the other one without asperities.
    """
    now, then = asperity_motion(period, period.problem, period.condition), asperity_motion(period, other, bare)
    if not np.any(then):
        return -now
    friction = period.solution.friction_force
    return np.asarray(then - now + float(then @ friction) / float(friction @ friction) * force)
