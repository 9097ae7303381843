"""The rig as a recording sees it: its loops, its sweep and its wear for any values of the parameters.

A hypothesis is the baseline's own parameters (friction, wear coefficient, moving mass) and a set of effects. It is
simulated on a coarse contact mesh; what that mesh and the thinned samples leave out is added as the difference to a
finer model at the baseline, and enters the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from fretflow.case.config import Solver, WearScheme
from fretflow.core.errors import FretflowError, NonConvergenceError
from fretflow.core.records import Array
from fretflow.effects.cycle import PeriodicCycle, true_signals
from fretflow.effects.model import EffectModel
from fretflow.experiments.rig.observation import CHANNELS, Observation, Piece, is_other_motion
from fretflow.experiments.rig.simulation import (
    Hypothesis,
    Period,
    Resolution,
    Simulation,
    arm_approach,
    asperity_motion,
)
from fretflow.inference.experiment import TOLERANCE
from fretflow.recordings.schema import DisplacementOf, MeasuredAt, SweepCondition
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.solver import SMALLEST_SHARE, QuasiStaticSolver
from fretflow.solvers.quasi_static.starts import fastest_frequency
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.history import WearSettings, WearStep
from fretflow.wear.implicit import Implicit
from fretflow.wear.scheme import WearingJoint

SAMPLES = 64  # of a period that fits are made with, four for each harmonic of the masses' motion
DENSER = 4  # times as many that fits are corrected by: beyond the arm's own mode, which rings whenever the faces stick
# of a simulation's wear: faces micrometres apart need 60 to 100, less plausible laws over cycles may need thousands
MOST_PERIODS = 150
# Of the embedded solution of first order; the depth itself is a tenth as far off. With twice as much the first steps on
# tilted and crowned faces set the nodes wobbling: more steps in all, and three times the map's error. Springs that
# stiffen wobble with this as well, by several sd of a map: a fit that comes to a halt goes on with that of a case.
WEAR_TOLERANCE = 0.1


def harmonics_of(samples: int) -> int:
    """Return the harmonics of the masses' motion that a period of so many samples is solved with."""
    return samples // 4


@contextmanager
def no_solution_beyond_bounds() -> Iterator[None]:
    """Raise `NonConvergenceError` where a hypothesis asks on its way for data that no joint has."""
    try:
        yield
    except NonConvergenceError:
        raise
    except FretflowError as error:
        raise NonConvergenceError(f"the hypothesis leaves what a joint may be: {error}") from error


@dataclass(frozen=True)
class RigModel:
    """The baseline's problem on some mesh, and how the recording looks at it."""

    problem: PeriodicProblem
    wear_coefficient: float
    observation: Observation
    displacement_of: DisplacementOf
    samples: int
    total_cycles: int
    wear_tolerance: float = WEAR_TOLERANCE
    harmonics: int | None = None  # of the masses' motion; by default all that the samples hold
    tolerance: float = TOLERANCE  # relative, of a period
    most_periods: int = MOST_PERIODS

    @property
    def resolution(self) -> Resolution:
        """Return how finely it simulates."""
        return Resolution(self.problem.interface.size, self.samples, self.wear_tolerance)

    def case_problem(self, hypothesis: Hypothesis) -> PeriodicProblem:
        """Return the unworn problem with the baseline's parameters as `hypothesis` has them, without its effects."""
        joint = rig_of(self.problem.structure).quasi_static()
        rig = heavier(joint.rig, hypothesis.mass)
        rig = replace(rig, hinge_damping=rig.hinge_damping * hypothesis.damping)
        soft = hypothesis.compliance
        scaled = replace(joint, rig=rig, stiffness=joint.stiffness / soft, flexibility=joint.flexibility * soft,
                         upper_compliance=joint.upper_compliance * soft, lower_compliance=joint.lower_compliance * soft)
        return replace(self.problem, structure=scaled).vary(
            friction_coefficient=hypothesis.friction * self.problem.friction_coefficient)

    def finer(self, problem: PeriodicProblem) -> RigModel:
        """Return the same on the finer mesh of a problem, whose nodes take their periods too as they touch or part."""
        more = problem.interface.size / self.problem.interface.size
        return replace(self._closer(), problem=problem.vary(friction_coefficient=self.problem.friction_coefficient),
                       most_periods=round(more * self.most_periods))

    def denser(self) -> RigModel:
        """Return the same with `DENSER * SAMPLES` samples of a period, however many its own are, and harmonics."""
        return replace(self._closer(), samples=DENSER * SAMPLES)

    def _closer(self) -> RigModel:
        """Return the same with periods solved closer, by as much as the error of `DENSER` times the samples is smaller.

        Fits are corrected by them, and all loops share their errors, which moved friction by 4 % of its sd.
        """
        return replace(self, tolerance=TOLERANCE / DENSER**2)

    def twice_as_dense(self) -> RigModel:
        """Return the same with twice as many samples and harmonics."""
        return replace(self, samples=2 * self.samples)

    def resolving(self, hypothesis: Hypothesis) -> RigModel:
        """Return the same with harmonics up to the arm's own mode, where a hypothesis has a law with corners.

        These strike the arm in every period, and without that mode a period is another one.
        """
        model = self
        if any(effect.smooth for effect in hypothesis.effects):
            while harmonics_of(model.samples) < self._arm_harmonic and model.samples < DENSER * SAMPLES:
                model = model.twice_as_dense()
        return model

    @cached_property
    def _arm_harmonic(self) -> float:
        """Return the frequency of the arm on its hinge and on faces that stick, over the excitation's."""
        march = ContactMarch.of(self.problem, seen_coordinates(self.problem.boundary))
        return fastest_frequency(rig_of(self.problem.structure).rig, march) / self.problem.omega

    def solver(self, settlings: float = np.inf) -> QuasiStaticSolver:
        """Return the periodic solver. What it leaves stalled is less than a tenth of the noise."""
        return QuasiStaticSolver(Solver(samples=self.samples, harmonics=self.harmonics or harmonics_of(self.samples),
                                        tolerance=self.tolerance, estimate_error=False),
                                 keeps_tangents=True, settlings=settlings, takes_stalled=True)

    @no_solution_beyond_bounds()
    @np.errstate(over="ignore", invalid="ignore")  # a hypothesis far off may leave all bounds on its way
    def simulate(self, hypothesis: Hypothesis, near: Simulation | None = None) -> Simulation:
        """March the wear through the recorded cycle counts and solve the other conditions at the end.

        What is not found near a simulation of the same effects is not sought from nothing, which costs as much as ten
        simulations, nor where its wear takes twice the periods: a step half as long finds it.

        Raises
        ------
        NonConvergenceError
            If a period is not found.
        """
        if near is None and self.harmonics is None and self.samples > SAMPLES:  # all at once are not found with a play
            try:
                return self._from_fewer(hypothesis)
            except NonConvergenceError:
                if hypothesis.effects:  # seeking them from nothing takes long, and in vain
                    raise
        known = near is not None and near.has_effects_of(hypothesis)
        cycle = PeriodicCycle(self.solver(settlings=1 if known else np.inf), self.case_problem(hypothesis),
                              hypothesis.effects)
        coefficient = hypothesis.wear * self.wear_coefficient
        counts, last = self.observation.counts, max(self.observation.counts)
        settings = WearSettings(coefficient=coefficient, cycles=max(last, 1), scheme=WearScheme.IMPLICIT,
                                stops=tuple(sorted({count for count in counts if 0 < count < last})),
                                tolerance=self.wear_tolerance)
        joint = WearingJoint(cycle, settings)
        scheme: Implicit[PeriodicSolution] = Implicit(joint, anew=not known)

        def period(step: WearStep, state: PeriodicSolution) -> Period:
            return Period(cycle.model.problem(step.slow), state, step, step.cycles / max(self.total_cycles, 1),
                          cycle.model.baseline)

        def beginning(start: PeriodicSolution | None) -> Period:
            return period(*joint.settled(cycle.initial(), start, solves=1, anew=not known))

        first = self._measured_motion(beginning(None if near is None else near.loops[0].solution), beginning,
                                      block="loops", cycles=min(counts))
        step, state = first.step, first.solution
        steps, kept = [step], {count: first for count in counts if count == step.cycles}
        most = self._most(near if known else None)
        while step.cycles < last:
            step, state = scheme.advance(step, state)
            if step.solves > most:
                raise NonConvergenceError(f"the wear needs more than {most} periods for {last} cycles")
            if step.cycles in counts:
                def jumped(start: PeriodicSolution | None, now: WearStep = step) -> Period:
                    return period(*joint.settled(now.slow, start, now.solves, now.proposed_jump, anew=False))

                kept[step.cycles] = measured = self._measured_motion(period(step, state), jumped, block="loops",
                                                                     cycles=step.cycles)
                step, state = measured.step, measured.solution
            steps.append(step)
        end = kept[last]
        # of other effects the first period is a good guess, and no others
        others = near.sweep if near is not None and known else (end,) * len(self.observation.conditions)
        sweep = tuple(self._at(cycle, end, condition, start, not known) for condition, start in
                      zip(self.observation.conditions, others, strict=True))
        return Simulation(hypothesis, cycle.model, coefficient, tuple(kept[count] for count in counts), sweep,
                          tuple(steps), self.resolution)

    def _most(self, near: Simulation | None) -> int:
        """Return how many periods the wear may take: beside one of the same effects and resolution, twice its own.

        Few are no reason to stop: half of the most may be taken anyway.
        """
        if near is None or near.resolution != self.resolution:
            return self.most_periods
        return min(self.most_periods, 2 * max(near.steps[-1].solves, self.most_periods // 4))

    def refine(self, coarse: Simulation) -> Simulation:
        """Return a coarser model's simulation by this one: from its motion, or from nothing where that leads astray.

        Raises
        ------
        NonConvergenceError
            If a period is not found.
        """
        try:
            return self.simulate(coarse.hypothesis, coarse.on_mesh(self.problem.interface))
        except NonConvergenceError:
            return self.simulate(coarse.hypothesis)

    def _from_fewer(self, hypothesis: Hypothesis) -> Simulation:
        """Return a simulation that begins with half the samples, and where these do not lead there few harmonics."""
        half = replace(self, samples=max(SAMPLES, self.samples // 2))
        try:
            return self.simulate(hypothesis, half.simulate(hypothesis))
        except NonConvergenceError:
            return self.simulate(hypothesis, replace(self, harmonics=harmonics_of(SAMPLES)).simulate(hypothesis))

    def _at(self, cycle: PeriodicCycle, end: Period, condition: SweepCondition, start: Period, anew: bool) -> Period:
        """Return the period at another condition, at the end of the test."""
        model = replace(cycle.model, baseline=at_condition(cycle.model.baseline, condition))
        problem, of = model.problem(end.step.slow), {"block": "sweep", "condition": condition.id}

        def period(solver: QuasiStaticSolver, solution: PeriodicSolution | None) -> Period:
            return Period(problem, solver.solve(problem, solution), end.step, end.elapsed, model.baseline)

        def starts() -> Iterator[tuple[QuasiStaticSolver, PeriodicSolution | None]]:
            solver = self.solver(settlings=0 if anew else 1)
            yield solver, start.solution
            if not anew:
                return
            like = self._like_measured(start, **of)
            if like is not None:
                yield solver, like
            yield solver, None  # beyond a fold of the response nothing leads there
            with suppress(NonConvergenceError):
                yield solver, self._followed(cycle, end, condition)
            yield self.solver(), start.solution  # at last where it settles in time, as that takes longest

        failure = NonConvergenceError(f"condition {condition.id}: no period was found")
        for solver, one in starts():
            try:
                return self._measured_motion(period(solver, one), partial(period, solver), **of)
            except NonConvergenceError as error:
                failure = error
        raise failure

    def _followed(self, cycle: PeriodicCycle, end: Period, condition: SweepCondition) -> PeriodicSolution:
        """Return the period at another condition, followed there from the end of the test by steps that halve.

        Raises
        ------
        NonConvergenceError
            If `SMALLEST_SHARE` of the way is still too far.
        """
        solver, bare, solution, share, step = self.solver(settlings=0), cycle.model.baseline, end.solution, 0.0, 0.5
        there = at_condition(bare, condition)
        while share < 1.0:
            target = min(1.0, share + step)
            amplitude, load, frequency = (own + target * (other - own) for own, other in (
                (bare.excitation.amplitude, there.excitation.amplitude), (bare.normal_load, there.normal_load),
                (bare.frequency, there.frequency)))
            between = bare.vary(amplitude=amplitude, normal_load=load, frequency=frequency)
            try:
                solution = solver.solve(replace(cycle.model, baseline=between).problem(end.step.slow), solution)
            except NonConvergenceError:
                step = 0.5 * (target - share)
                if step < SMALLEST_SHARE:
                    raise
                continue
            share, step = target, 2.0 * step
        return solution

    def _measured_motion(self, period: Period, beginning: Callable[[PeriodicSolution], Period],
                         **of: object) -> Period:
        """Return a period, or the one `beginning` as large as what was measured, if that is nearer to it.

        Of motions that coexist about a fold of the response the recording shows one. A period is taken for another
        where the displacement's fundamental differs from the measured one by more than the smaller of both is.
        """
        start = self._like_measured(period, **of)
        if start is None:
            return period
        try:
            other = beginning(start)
        except NonConvergenceError:
            return period
        return other if self._like_measured(other, **of) is None else period

    def _like_measured(self, period: Period, **of: object) -> PeriodicSolution | None:
        """Return a period's motion, as large and as late as it was measured; None where it is no other motion."""
        measured = self.observation.values[self.observation.rows(channel="displacement", **of)]
        if not len(measured):
            return None
        aimed, own = (self.observation.fundamental(one) for one in (measured, self.displacement(period)))
        if own == 0.0 or not is_other_motion(aimed, own):
            return None
        solution, late = period.solution, -float(np.angle(aimed / own)) / (2.0 * np.pi)
        turned = {name: np.roll(getattr(solution, name), round(late * len(solution.state)), axis=0)
                  for name in ("displacement", "force", "state", "internal", "friction_force")}
        for name in ("displacement", "internal"):
            mean = turned[name].mean(axis=0)
            turned[name] = mean + abs(aimed / own) * (turned[name] - mean)
        return PeriodicSolution(**{one.name: getattr(solution, one.name) for one in fields(PeriodicSolution)} | turned)

    @np.errstate(over="ignore", invalid="ignore")
    def predict(self, simulation: Simulation) -> Array:
        """Return the vector (M,) that the recording would be.

        Raises
        ------
        NonConvergenceError
            If it is beyond all bounds.
        """
        vector = np.empty(len(self.observation.values))
        seen: dict[tuple[str, int], Signals] = {}
        for piece, period in self.pieces(simulation):
            if period is None:
                continue
            key = (piece.block, piece.cycles if piece.condition is None else piece.condition)
            if key not in seen:
                seen[key] = self.sensed(simulation.model, self.signals(period))
            vector[piece.place] = channel(seen[key], piece)
        self.put_wear(vector, simulation.depth)
        if not np.all(np.isfinite(vector)):
            raise NonConvergenceError("the hypothesis predicts numbers beyond all bounds")
        return vector

    def pieces(self, simulation: Simulation) -> list[tuple[Piece, Period | None]]:
        """Return the pieces of the vector, each with its period; None for volume and map."""
        by_count = dict(zip(self.observation.counts, simulation.loops, strict=True))
        by_condition = dict(zip((c.id for c in self.observation.conditions), simulation.sweep, strict=True))
        return [(piece, by_count[piece.cycles] if piece.block == "loops"
                 else by_condition[piece.condition] if piece.block == "sweep" and piece.condition is not None else None)
                for piece in self.observation.pieces]

    def put_wear(self, vector: Array, depth: Array) -> None:
        """Write worn volume and map of `depth` (nodes, ...), m, into a vector (M, ...)."""
        for piece in self.observation.pieces:
            if piece.block == "volume":
                vector[piece.place] = self.problem.interface.areas @ depth
            elif piece.block == "map":
                vector[piece.place] = self._on_map @ depth

    @cached_property
    def _on_map(self) -> Array:
        """Return the matrix (P, nodes) from nodal values to those at the points of the map."""
        nodes = self.problem.interface.nodes
        return on_points(nodes, np.eye(len(nodes)), self.observation.points)

    def signals(self, period: Period) -> Signals:
        """Return the true channels of a period, in the harmonics that are compared."""
        solution = period.solution
        load = period.problem.normal_load + rig_of(period.problem.structure).rig.load_at(solution.output("arm"))
        true = true_signals(period.problem, solution, self.displacement(period), period.elapsed)
        return replace(true, approach=arm_approach(period), normal_force=load).band_limited(self.observation.harmonics)

    def sensed(self, model: EffectModel, signals: Signals) -> Signals:
        """Return what the sensors show, its phase counted as the recording's is."""
        shown = model.sense(signals)
        lead = getattr(shown, self.observation.aligned_to, None)
        if lead is None or self.observation.aligned_to == "excitation":
            return shown
        late = -float(np.angle(np.fft.rfft(lead)[1])) / shown.angular_frequencies[1]  # its maximum, after zero
        shifted: dict[str, Any] = {name: shown.delayed(values, -late) for name in CHANNELS
                                   if (values := getattr(shown, name)) is not None}
        return replace(shown, **shifted)

    def displacement(self, period: Period) -> Array:
        """Return the displacement (N,) where the recording measured it, m."""
        solution = period.solution
        if self.displacement_of.place is MeasuredAt.CONTACT_FACES:
            slid = self.problem.interface.mean(solution.displacement[:, :, 0])
            return np.asarray(slid - asperity_motion(period, period.problem, period.condition))
        if self.displacement_of.place is MeasuredAt.BACK_FACES:
            return solution.rig_displacement[:, 1]
        return (solution.upper_observation - solution.lower_observation)[:, 0]


def heavier(rig: LumpedRig, factor: float) -> LumpedRig:
    """Return the rig with another moving mass and the same in-phase mode, which is measured apart from it."""
    total = (rig.moving_mass * factor + rig.arm_mass) / (rig.moving_mass + rig.arm_mass)
    return replace(rig, moving_mass=rig.moving_mass * factor, ground_stiffness=rig.ground_stiffness * total,
                   ground_damping=rig.ground_damping * total)


def channel(signals: Signals, piece: Piece) -> Array:
    """Return the channel of `signals` that a piece of the vector holds."""
    values: Array = getattr(signals, piece.channel)
    return values


def at_condition(problem: PeriodicProblem, condition: SweepCondition) -> PeriodicProblem:
    """Return `problem` under another drive, load or frequency, as far as `condition` says."""
    drive, load, frequency = condition.excitation_amplitude, condition.normal_load, condition.excitation_frequency
    return problem.vary(amplitude=drive, normal_load=load, frequency=frequency)


def on_points(nodes: Array, values: Array, points: Array) -> Array:
    """Return nodal `values` (nodes, ...) at `points` (P, 2), linearly; the nearest node's outside."""
    if not len(points):
        return np.zeros((0, *values.shape[1:]))
    inside = LinearNDInterpolator(nodes, values)(points)
    outside = NearestNDInterpolator(nodes, values)(points)
    return np.asarray(np.where(np.isnan(inside), outside, inside))

