"""The rig's model of a test of which facts are known: its wear, its unworn period and its resonance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import minimize_scalar

from fretflow.case.config import WearScheme
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import Array
from fretflow.effects.cycle import PeriodicCycle
from fretflow.experiments.facts.quantities import WornTest
from fretflow.experiments.rig.model import MOST_PERIODS, RigModel
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.experiment import TOLERANCE
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.wear.history import WearSettings
from fretflow.wear.march import run_history

GRID = np.geomspace(0.8, 12.0, 18)  # of the in-phase mode: a stuck contact raises the resonance several times over


@dataclass(frozen=True)
class Condition:
    """Force, load and frequency of a test, in SI, and the cycles that facts ask for, the last of them its length."""

    amplitude: float
    load: float
    frequency: float
    counts: tuple[int, ...]

    @property
    def key(self) -> tuple[float, float, float]:
        """Return force, load and frequency."""
        return self.amplitude, self.load, self.frequency

    def of(self, problem: PeriodicProblem) -> PeriodicProblem:
        """Return a problem at this condition."""
        return problem.vary(amplitude=self.amplitude, normal_load=self.load, frequency=self.frequency)


def worn_test(rig: RigModel, hypothesis: Hypothesis, condition: Condition, resonating: float | None = None) -> WornTest:
    """Return a test under a hypothesis, marched through its wear.

    Its first resonance is sought beside where it is said to be `resonating`, Hz, else over a range.

    Raises
    ------
    NonConvergenceError
        If a period is not found, or the wear needs too many.
    """
    cycle = PeriodicCycle(rig.solver(), condition.of(rig.case_problem(hypothesis)), hypothesis.effects)
    settings = WearSettings(coefficient=hypothesis.wear * rig.wear_coefficient, cycles=condition.counts[-1],
                            scheme=WearScheme.IMPLICIT, stops=condition.counts[:-1], tolerance=rig.wear_tolerance,
                            vanishing_rate=0.0)  # a contact that stops to wear stays as it is until its test ends
    jumps = [0]

    def count(done: int, asked: int) -> None:
        jumps[0] += 1
        if jumps[0] > MOST_PERIODS:
            raise NonConvergenceError(f"the wear needs more than {MOST_PERIODS} jumps for {asked} cycles")

    history = run_history(cycle, settings, None, count)
    problem = cycle.model.problem(history.slow(0))
    first = GRID * in_phase_frequency(problem) if resonating is None else np.array([resonating])

    @cache
    def resonance(cycles: int) -> float:
        row = int(np.searchsorted(history.cycles, cycles))
        return largest_motion(cycle.solver.solve, cycle.model.problem(history.slow(row)),
                              np.array([resonance(0)]) if cycles else first)

    return WornTest(interface=problem.interface, normal_load=condition.load, unworn=cycle.solver.solve(problem),
                    history=history, resonance=resonance)


def in_phase_frequency(problem: PeriodicProblem) -> float:
    """Return the frequency of the rig's in-phase mode without contact, Hz."""
    rig = rig_of(problem.structure).rig
    return float(np.sqrt(rig.ground_stiffness / (rig.moving_mass + rig.arm_mass)) / (2.0 * np.pi))


def largest_motion(solve: Callable[..., PeriodicSolution], problem: PeriodicProblem, starts: Array) -> float:
    """Return the frequency (Hz) at which the first harmonic of the driven block is largest, beside the best start.

    A contact that slides makes a peak so flat that what samples leave out raises hills on it, a few per cent wide:
    points up to half of the way to neighbours in `GRID`, in as many steps, are compared before the best one is refined.
    Where a joint begins to slide there the curve has a corner, so that no parabola is laid through it. A maximum is
    flat: its place is known to the root of what its height is.

    Raises
    ------
    NonConvergenceError
        If there is no maximum as far as resonances may be apart.
    """
    last: list[PeriodicSolution] = []

    def motion(frequency: float) -> float:
        try:
            solution = solve(problem.vary(frequency=frequency), last[-1] if last else None)
        except NonConvergenceError:
            solution = solve(problem.vary(frequency=frequency))
        last.append(solution)
        block = solution.rig_displacement[:, 0]
        return float(abs(np.fft.rfft(block)[1]) / len(block))

    middle = start = max(map(float, starts), key=motion) if len(starts) > 1 else float(starts[0])
    apart = float(np.log(GRID[1] / GRID[0]))
    beside, step = np.linspace(-0.5 * apart, 0.5 * apart, len(GRID) + 1, retstep=True)
    while max(middle / start, start / middle) < GRID[-1] / GRID[0]:
        off = max(map(float, beside), key=lambda one: motion(middle * np.exp(one)))
        middle *= float(np.exp(off))
        if abs(off) < beside[-1]:
            best = minimize_scalar(lambda one, about=middle: -motion(about * np.exp(one)), bounds=(-step, step),
                                   method="bounded", options={"xatol": step * np.sqrt(TOLERANCE)})
            return middle * float(np.exp(best.x))
    raise NonConvergenceError(f"no resonance near {middle:.4g} Hz")
