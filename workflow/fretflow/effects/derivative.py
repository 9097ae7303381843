"""Derivatives by parameters of effects, and of the baseline, without solving again.

What a parameter changes in the data of a solved problem is differenced, not its solution: friction, load and forces at
the motion that was found, the gap, the flexibility, the rig. `harmonic.sensitivity` carries that on to the period by
the implicit function theorem. The state over cycles is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fretflow.effects.effect import Array
from fretflow.effects.model import EffectModel
from fretflow.solvers.direction import Direction
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.march import Surroundings
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.slow import SlowState

STEP = 1e-4  # of a parameter's range


@dataclass(frozen=True)
class _Data:
    """The data of a problem at a motion of N samples."""

    friction: Array  # (N, nodes), limit in N
    normal_load: Array  # (N,)
    gap: Array
    flexibility: Array
    rig: Array
    force: Array  # (N, 2), on block and arm, drive included

    @classmethod
    def of(cls, problem: PeriodicProblem, motion: PeriodicSolution) -> _Data:
        joint, law = problem.joint.quasi_static(), problem.law
        samples = len(motion.state)
        arm = motion.rig_displacement[:, 1]
        under = Surroundings.of(problem).conditions(problem.normal_load, arm, np.zeros((samples, 0)))
        size = np.hypot(motion.force[:, :, 0], motion.force[:, :, 1])
        along = motion.force[:, :, 0] / np.where(size > 0.0, size, np.inf)
        limit = law.slip_limit(np.maximum(motion.force[:, :, 2], 0.0)) * (1.0 - law.asymmetry * along)
        return cls(under.grip[:, None] * limit, under.load, problem.interface.gap, joint.flexibility,
                   np.array([getattr(joint.rig, part.name) for part in fields(LumpedRig)]), _rig_force(problem, motion))


def _rig_force(problem: PeriodicProblem, motion: PeriodicSolution) -> Array:
    samples = len(motion.state)
    phase = 2.0 * np.pi * np.arange(samples) / samples
    force = np.zeros((samples, 2))
    force[:, 0] = problem.excitation * np.cos(phase)
    for order, amplitude in problem.overtones:
        force[:, 0] += (amplitude * np.exp(1j * order * phase)).real
    if problem.rig_forces:
        velocity = time_derivative(motion.rig_displacement, problem.omega)
        for one in problem.rig_forces:
            force += one(motion.rig_displacement, velocity).force
    return force


def effect_direction(model: EffectModel, slow: SlowState, solution: PeriodicSolution, effect_id: str, name: str
                     ) -> Direction:
    """Return the direction of parameter `name` of an effect of `model`, at a period solved with it.

    Raises
    ------
    KeyError
        If the model has no such effect or parameter.
    """
    effect = {one.id: one for one in model.effects}[effect_id]
    prior, value = effect.priors()[name], getattr(effect, name)
    step = STEP * max(abs(value), 0.01 * max(abs(prior.high), abs(prior.low)))

    def varied(by: float) -> PeriodicProblem:
        others = tuple(effect.changed(**{name: value + by}) if one.id == effect_id else one for one in model.effects)
        return replace(model, effects=others).problem(slow)

    grips = _grips(model.problem(slow), solution)
    return _difference(_Data.of(varied(-step), solution), _Data.of(varied(step), solution), 2.0 * step, grips,
                       f"{effect_id}.{name}")


def directions_to(others: Sequence[PeriodicProblem], at: PeriodicProblem, solution: PeriodicSolution
                  ) -> list[Direction]:
    """Return the whole changes from the problem `at` to each of `others`, as directions of unit length.

    `solution` is the period of `at`; the directions are named by their place.
    """
    here, grips = _Data.of(at, solution), _grips(at, solution)
    return [_difference(here, _Data.of(other, solution), 1.0, grips, str(v)) for v, other in enumerate(others)]


def _grips(at: PeriodicProblem, solution: PeriodicSolution) -> Array:
    """Return the friction limit (N, nodes) in N by a change of the coefficient, at the instant's factor."""
    gripping = _Data.of(replace(at, friction_coefficient=1.0, motion_factors=()), solution).friction
    grip = Surroundings.of(at).conditions(at.normal_load, solution.rig_displacement[:, 1],
                                          np.zeros((len(solution.state), 0))).grip
    return grip[:, None] * gripping


def _difference(one: _Data, other: _Data, step: float, grips: Array, name: str) -> Direction:
    """Return the direction from the data `one` to the data `other`, `step` apart in a parameter."""
    slopes = {part.name: (getattr(other, part.name) - getattr(one, part.name)) / step for part in fields(_Data)}
    by_limit = slopes.pop("friction")
    rig = LumpedRig(**dict(zip((part.name for part in fields(LumpedRig)), slopes.pop("rig"), strict=True)))
    # the coefficient that makes this change of the limit
    friction = np.divide(by_limit, grips, out=np.zeros_like(by_limit), where=grips > 0.0)
    kept = {part: value for part, value in {"friction": friction, **slopes}.items() if np.any(value)}
    return Direction(name=name, rig=rig if any(getattr(rig, part.name) for part in fields(LumpedRig)) else None, **kept)
