"""The periodic solution and the effects as wear sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Solver, Wear
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError, did_you_mean
from fretflow.core.records import digest
from fretflow.effects.effect import Effect
from fretflow.effects.model import EffectModel
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution, PeriodicSolver
from fretflow.structure.internal_forces import force_beside_friction
from fretflow.structure.sensors import Signals
from fretflow.structure.structure import NORMAL_LOAD
from fretflow.wear.archard import Archard
from fretflow.wear.asymptotic import AsymptoticShape, solve_asymptotic_shape
from fretflow.wear.cycle import CycleModel, CycleResponse, summarise_cycle
from fretflow.wear.history import WearHistory, WearSettings
from fretflow.wear.march import run_history
from fretflow.wear.slow import SlowState

ROUND_OFF = 1e-9  # of the largest number: reduced matrices are as exact


class PeriodicCycle:
    """A `wear.CycleModel` made of a periodic solver, the unworn problem and effects, in any order.

    Raises
    ------
    ConfigError
        If two effects do not work together.
    """

    state_type = PeriodicSolution

    def __init__(self, solver: PeriodicSolver, problem: PeriodicProblem, effects: Iterable[Effect] = ()) -> None:
        self.solver = solver
        self.model = EffectModel.build(problem, effects)
        self.areas: NDArray[np.float64] = problem.interface.areas
        self.has_laws = any(_acts_over_cycles(effect) for effect in self.model.effects)

    @cached_property
    def load_held(self) -> bool:
        """Return whether the normal load acts where nothing else holds the faces, as on the rig's arm."""
        boundary = self.model.baseline.boundary
        motion, stiffness = boundary.motion[2::3], boundary.internal.stiffness
        unstrained = motion - motion @ _inverse(stiffness) @ stiffness if motion.any() else motion
        return bool(boundary.input_free[:, boundary.inputs.index(NORMAL_LOAD)].any()
                    or np.any(np.abs(unstrained) > ROUND_OFF * np.abs(motion).max(initial=0.0)))

    def initial(self) -> SlowState:
        """Return the start of the test."""
        return self.model.initial()

    def normal_flexibility(self, slow: SlowState) -> NDArray[np.float64]:
        """Return the static normal flexibility of the faces, free coordinates held, (nodes, nodes), m/N."""
        problem, bare = self.model.problem(slow), self.model.baseline
        return self._bare_flexibility if problem.structure is bare.structure else _normal_flexibility(problem)

    @cached_property
    def _bare_flexibility(self) -> NDArray[np.float64]:
        return _normal_flexibility(self.model.baseline)

    def cycle(self, slow: SlowState, start: PeriodicSolution | None) -> tuple[CycleResponse, PeriodicSolution]:
        """Return the steady period of the joint in the state `slow`."""
        problem = self.model.problem(slow)
        solution = self.solver.solve(problem, start)
        return respond(solution, problem.interface), solution

    def evolve(self, before: SlowState, cycles: float, worn: NDArray[np.float64], energy: float,
               response: CycleResponse) -> SlowState:
        """Return the slow state after a jump."""
        return self.model.evolve(before, cycles, worn, energy, response)

    def wear_factor(self, response: CycleResponse, slow: SlowState) -> NDArray[np.float64]:
        """Return the factor of the effects on Archard's wear rate, (nodes,)."""
        return self.model.wear_factor(response, slow)

    def opening_share(self, slow: SlowState, cycles: float) -> NDArray[np.float64]:
        """Return the share of the wear of a jump of `cycles` that opens the gap, (nodes,)."""
        return self.model.opening_share(slow, cycles)

    def gap(self, slow: SlowState) -> NDArray[np.float64]:
        """Return the gap of the undeformed faces, (nodes,), m."""
        return self.model.problem(slow).interface.gap


def march_wear(problem: PeriodicProblem | CycleModel[Any], law: Archard, cycles: int, *, effects: Iterable[Effect] = (),
               solver: PeriodicSolver | None = None, folder: Path | str | None = None,
               progress: Callable[[int, int], None] | None = None, **settings: Any) -> WearHistory:
    """Wear the contact of a joint over millions of cycles: jumps, each followed by a new period.

    Parameters
    ----------
    problem : PeriodicProblem or CycleModel
        The unworn joint; a `BoltedCycle` is a bolted structure's.
    law : Archard
        Wear coefficient in m^2/N, and the upper face's share.
    cycles : int
        Length of the test.
    effects : iterable of Effect, optional
        Physics beyond the baseline.
    solver : PeriodicSolver, optional
        By default the quasi-static one.
    folder : Path or str, optional
        Keeps a checkpoint of each jump; the same call goes on from the last one, another is refused.
    progress : callable, optional
        Takes the cycles done and the cycles asked after each jump.
    settings
        Of `fretflow.wear.history.WearSettings`: ``stops``, ``scheme`` (by default implicit jumps), ``tolerance`` of a
        jump, ``max_depth_per_jump`` in m, ``vanishing_rate``.

    Returns
    -------
    WearHistory
        Depth in m at each node, volume in m^3, energy in J and more after each jump; ``arrays`` is an `xarray.Dataset`.

    Raises
    ------
    InputError
        If there is no such setting, or one is out of range.
    NonConvergenceError
        If a period is not found.

    Notes
    -----
    Jumps are those of `fretflow.wear`; the law is J. F. Archard's, J. Appl. Phys. 24 (1953).

    Examples
    --------
    >>> import fretflow as ff
    >>> worn = ff.march_wear(problem, ff.Archard(1.1e-14), cycles=1_900_000)  # doctest: +SKIP
    >>> worn.arrays.volume.isel(cycles=-1)  # m^3  # doctest: +SKIP
    """
    known = sorted({one.name for one in fields(WearSettings)} - {"coefficient", "upper_share", "cycles"})
    for name in set(settings).difference(known):
        raise InputError(f"march_wear: there is no setting {name}; there are {', '.join(known)}"
                         f"{did_you_mean(name, known)}")
    asked = WearSettings(coefficient=law.coefficient, upper_share=law.upper_share, cycles=cycles,
                         **{"scheme": Wear().scheme, **settings})
    cycle = _cycle_of(problem, effects := tuple(effects), solver)
    used = getattr(cycle, "solver", None)
    joint = "" if folder is None else digest(problem, effects, used, getattr(used, "settings", None))
    return run_history(cycle, asked, None if folder is None else Path(folder), progress, joint)


def find_asymptotic_shape(problem: PeriodicProblem | CycleModel[Any], law: Archard, volume: float, *,
                          effects: Iterable[Effect] = (), solver: PeriodicSolver | None = None,
                          tolerance: float = 1e-6) -> AsymptoticShape:
    """Find the face that the contact of a joint wears to, without marching there.

    Parameters
    ----------
    problem : PeriodicProblem or CycleModel
        The unworn joint; a `BoltedCycle` is a bolted structure's.
    law : Archard
        Wear coefficient in m^2/N.
    volume : float
        Worn volume in m^3 at which to give the face; where wear ends before, the face is that at its end.
    effects : iterable of Effect, optional
        Physics beyond the baseline, none of which may follow laws over cycles.
    solver : PeriodicSolver, optional
        By default the quasi-static one.
    tolerance : float
        Largest accepted deviation of the rate from uniform, relative.

    Returns
    -------
    AsymptoticShape
        Depth in m at each node, rate in m a cycle, volume in m^3; ``distance`` tells how far a march is from it.

    Raises
    ------
    InputError
        If the volume is not positive, nothing slides, or laws over cycles act.
    NonConvergenceError
        If the rate does not become uniform, as where gross slip turns into partial slip on the way.

    Notes
    -----
    All nodes that wear sink at one rate in the end, or carry nothing; see `fretflow.wear.asymptotic`.

    Examples
    --------
    >>> import fretflow as ff
    >>> worn = ff.march_wear(problem, ff.Archard(1.1e-14), cycles=1_900_000)  # doctest: +SKIP
    >>> shape = ff.find_asymptotic_shape(problem, ff.Archard(1.1e-14), worn.volume[-1])  # doctest: +SKIP
    >>> shape.distance(worn.depth[-1])  # doctest: +SKIP
    """
    return solve_asymptotic_shape(_cycle_of(problem, effects, solver), law.coefficient, volume, tolerance)


def _cycle_of(problem: PeriodicProblem | CycleModel[Any], effects: Iterable[Effect], solver: PeriodicSolver | None
              ) -> CycleModel[Any]:
    from fretflow.solvers.quasi_static.solver import QuasiStaticSolver

    if not isinstance(problem, PeriodicProblem):
        return problem
    solver = solver or QuasiStaticSolver(Solver(estimate_error=False), keeps_tangents=True)
    return PeriodicCycle(solver, problem, effects)


def _normal_flexibility(problem: PeriodicProblem) -> NDArray[np.float64]:
    boundary = problem.boundary
    held, motion = boundary.flexibility[2::3, 2::3], boundary.motion[2::3]
    if not motion.any():  # internal coordinates give way along the faces alone, as the rig's
        return held
    return np.asarray(held + motion @ _inverse(boundary.internal.stiffness) @ boundary.transfer[:, 2::3])


def _inverse(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse (d, d) of a stiffness on the motions that strain it; the others no load is known to move."""
    return np.asarray(np.linalg.pinv(stiffness, rcond=ROUND_OFF, hermitian=True))


def respond(solution: PeriodicSolution, interface: Interface) -> CycleResponse:
    """Return what `solution` does to the contact `interface`, whose gap includes the wear."""
    response = summarise_cycle(solution.displacement, solution.force, solution.slip_increments,
                               solution.state != ContactState.SEPARATION, interface.gap, interface.areas)
    if not {"arm", "upper", "lower"} <= solution.outputs.keys():  # those of the rig
        return response
    apart = solution.upper_observation[:, 2] - solution.lower_observation[:, 2]
    return replace(response, arm_range=float(np.ptp(solution.output("arm"))), approach=-float(apart.mean()))


def true_signals(problem: PeriodicProblem, solution: PeriodicSolution, displacement: NDArray[np.float64],
                 elapsed: float = 0.0) -> Signals:
    """Return the channels of a period before any sensor.

    Parameters
    ----------
    problem, solution
        The problem and its period of N samples.
    displacement : (N,)
        The relative displacement where it is measured, m.
    elapsed
        Share of the test that is over.
    """
    samples = len(solution.state)
    phase = 2.0 * np.pi * np.arange(samples) / samples
    motion, boundary = solution.internal, problem.boundary
    beside = force_beside_friction(boundary.forces, motion, time_derivative(motion, problem.omega), boundary.sliding)
    return Signals(step=1.0 / (samples * problem.frequency), displacement=displacement,
                   friction_force=solution.friction_force + beside, arm=solution.output("arm"),
                   excitation=problem.excitation.at_phases(phase)["block"],
                   normal_force=solution.force[:, :, 2].sum(axis=1), elapsed=elapsed)


def _acts_over_cycles(effect: Effect) -> bool:
    """Return whether `effect` changes the period over cycles, or the wear rate."""
    kind = type(effect)
    return kind.over_cycles or kind.evolve is not Effect.evolve or kind.wear_factor is not Effect.wear_factor
