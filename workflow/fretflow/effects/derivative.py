"""Changes of a problem by parameters of effects, and of the baseline, without solving again.

What a parameter changes in the data of a solved problem is differenced, not its solution: friction, load and forces at
the motion that was found, the gap, the flexibility, the rig. `solvers.sensitivity` carries that on to the period by
the implicit function theorem. The state over cycles is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.effect import Array
from fretflow.solvers.audit import friction_factor, further_force
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.sensitivity import Direction
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.structure.two_mass_rig.lumped import MATRICES, LumpedRig


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
    def of(cls, problem: PeriodicProblem, motion: PeriodicSolution, like: tuple[PeriodicProblem, _Data] | None = None
           ) -> _Data:
        """Return those of `problem`; what it shares with a problem that is `like` it is taken from there."""
        rig = rig_of(problem.structure).rig
        load = problem.normal_load + rig.load_at(motion.internal[:, 1])
        if not load.min() > 0.0:
            raise NonConvergenceError("the normal load vanishes during the motion; lower the load's slope or the drive")
        pressed = like is not None and problem.preload is like[0].preload
        if like is not None and pressed and problem.law is like[0].law:
            limit = like[1].friction
        else:
            limit = problem.nodal_law.directed_limit(motion.force, friction_factor(problem, motion)[:, None])
        if like is not None and pressed and problem.excitation is like[0].excitation and (
                problem.boundary.forces is like[0].boundary.forces):
            force = like[1].force
        else:
            force = _force(problem, motion)
        return cls(limit, load, problem.interface.gap, problem.boundary.flexibility,
                   np.array([getattr(rig, name) for name in MATRICES]), force)


def _force(problem: PeriodicProblem, motion: PeriodicSolution) -> Array:
    """Return all forces (N, 2) on block and arm at a motion, but for the contact's."""
    boundary = problem.boundary
    phase = 2.0 * np.pi * np.arange(len(motion.state)) / len(motion.state)
    return np.asarray(problem.loads_at(phase) @ boundary.input_force.T + further_force(problem, motion.internal))


def directions_to(others: Sequence[PeriodicProblem], at: PeriodicProblem, solution: PeriodicSolution
                  ) -> list[Direction]:
    """Return the whole changes from the problem `at` to each of `others`, as directions of unit length.

    `solution` is the period of `at`; the directions are named by their place.
    """
    here, grips = _Data.of(at, solution), _grips(at, solution)
    return [_difference(here, _Data.of(other, solution, (at, here)), grips, str(v))
            for v, other in enumerate(others)]


def _grips(at: PeriodicProblem, solution: PeriodicSolution) -> Array:
    """Return the friction limit (N, nodes) in N by a change of the coefficient, at the instant's factor."""
    unit = replace(at.nodal_law, friction_coefficient=1.0)
    return unit.directed_limit(solution.force, friction_factor(at, solution)[:, None])


def _difference(one: _Data, other: _Data, grips: Array, name: str) -> Direction:
    """Return the direction from the data `one` to the data `other`."""
    slopes = {part.name: getattr(other, part.name) - getattr(one, part.name) for part in fields(_Data)
              if getattr(other, part.name) is not getattr(one, part.name)}
    rig = LumpedRig(**dict(zip(MATRICES, slopes.pop("rig"), strict=True)))
    if "friction" in slopes:  # the coefficient that makes this change of the limit
        slopes["friction"] = np.divide(slopes["friction"], grips, out=np.zeros_like(grips), where=grips > 0.0)
    kept = {part: value for part, value in slopes.items() if np.any(value)}
    return Direction(name=name, rig=rig if any(getattr(rig, name) for name in MATRICES) else None, **kept)
