"""What a period of the quasi-static solver leaves to be said: that it is unstable, or that its contact is heavy."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import FretflowWarning, HeavyContactWarning, UnstablePeriodWarning
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.candidate_nodes import restrict, restrict_solution
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.sample import SEPARATION, ContactSystem, PeriodHistory, plain
from fretflow.solvers.stability import Around, floquet_multipliers, is_stable

# Of the kinetic energy: by Rayleigh's principle 1 % of the frequencies, to which the solvers are checked; and of the
# excitation's work.
HEAVY = 0.02


def warn_of_heavy_contact(problem: PeriodicProblem, solution: PeriodicSolution) -> None:
    """Warn (HeavyContactWarning) where the contact's own inertia or damping, left out, is over 2 % of all."""
    share = neglected_inertia(problem, solution)
    if share > HEAVY:
        warnings.warn(
            f"contact: its own inertia, which the quasi-static solver leaves out, holds {share:.1g} of the kinetic "
            f'energy, so that frequencies are off by about {share / 2.0:.0%}; use method="dlft", which keeps all mass, '
            "or give contact_compliance", HeavyContactWarning, stacklevel=3)
    share = neglected_damping(problem, solution)
    if share > HEAVY:
        warnings.warn(
            "contact: the quasi-static solver leaves out the damping C of the contact's own motion; amplitudes may "
            f'be off by {share:.0%}; use method="dlft", which keeps all of C', HeavyContactWarning, stacklevel=3)


def warn_of_no_contact(solution: PeriodicSolution) -> None:
    """Warn (FretflowWarning) of faces that never touch, as those of a joint that nothing presses do not."""
    if not np.any(solution.state != SEPARATION):
        warnings.warn("contact: the faces touch at no time, so that there is no friction; press them, as with "
                      "preload=ff.NormalLoad(60), or close their gap", FretflowWarning, stacklevel=3)


def warn_of_instability(problem: PeriodicProblem, solution: PeriodicSolution) -> None:
    """Warn (UnstablePeriodWarning) of a period with a Floquet multiplier outside the unit circle."""
    multipliers = period_multipliers(problem, solution)
    if not is_stable(multipliers):
        warnings.warn(
            f"period at {solution.frequency:.6g} Hz: unstable, its largest Floquet multiplier is "
            f"{abs(multipliers[0]):.4g}, so that a test would show another motion; march it in time with "
            "fretflow.solvers.time_integration.settle", UnstablePeriodWarning, stacklevel=3)


def period_multipliers(problem: PeriodicProblem, solution: PeriodicSolution) -> NDArray[np.complex128]:
    """Return the Floquet multipliers of a quasi-static period, the largest first."""
    touching = np.any(solution.state != SEPARATION, axis=0)
    if touching.any():
        problem, solution = restrict(problem, touching), restrict_solution(solution, touching)
    system = ContactSystem.of(problem, seen_coordinates(problem.boundary))
    return floquet_multipliers(problem.boundary.internal, system, _history(problem, solution), solution.frequency,
                               Around.of(problem, solution.internal))


def neglected_inertia(problem: PeriodicProblem, solution: PeriodicSolution) -> float:
    """Return the share of the period's kinetic energy in the contact's own inertia, which a massless contact lacks.

    The internal coordinates q and the relative displacement u carry it separately, ``2 T = q'^2 + u'^T m u'``. By
    Rayleigh's principle leaving out a share e of T moves a frequency by e / 2 in first order, and away from resonance
    the amplitudes by e at most (J. W. S. Rayleigh, The Theory of Sound I (1877), sections 88-91).
    """
    mass = problem.boundary.contact_mass
    if mass is None:
        return 0.0
    inner, across = (time_derivative(one.reshape(len(one), -1), problem.omega)
                     for one in (solution.internal, solution.displacement))
    neglected = float(np.einsum("jm,mn,jn->", across, mass, across))
    kept = float(np.einsum("jd,de,je->", inner, problem.boundary.internal.mass, inner))
    return neglected / (neglected + kept) if neglected > 0.0 else 0.0


def neglected_damping(problem: PeriodicProblem, solution: PeriodicSolution) -> float:
    """Return the work of the damping matrix C that a massless contact misses, over the excitation's apparent work.

    C acts on the whole motion ``x' = Z q' + G_x f' + W_x i'``, of which the solver keeps Z q' alone: the motion of a
    joint free of forces. The apparent work, the period times the rms of force and velocity, is that of a force in phase
    with the velocity: at a resonance the amplitude is off by the share, and elsewhere by less.
    """
    boundary = problem.boundary
    if boundary.whole_damping is None:
        return 0.0
    inner, force = (time_derivative(one.reshape(len(one), -1), problem.omega)
                    for one in (solution.internal, solution.force))
    inputs = boundary.whole_damping.shape[0] - inner.shape[1] - force.shape[1]
    loads = np.zeros((len(inner), inputs))  # a normal load beyond these is constant
    for name, values in problem.excitation.at_phases(2.0 * np.pi * np.arange(len(inner)) / len(inner)).items():
        if name in boundary.inputs[:inputs]:
            loads[:, boundary.inputs.index(name)] = values
    rate = np.hstack([inner, force, time_derivative(loads, problem.omega)])
    period = 2.0 * np.pi / (problem.omega * len(inner))
    kept, whole = (period * float(np.einsum("jd,de,je->", own, matrix, own)) for own, matrix in (
        (inner, boundary.internal.damping), (rate, boundary.whole_damping)))
    moved = inner @ boundary.input_force + force @ boundary.input_motion
    rms = [np.sqrt(np.mean(one**2, axis=0)) for one in (loads, moved[:, :inputs])]
    apparent = 2.0 * np.pi / problem.omega * float(rms[0] @ rms[1])
    return abs(whole - kept) / apparent if apparent > 0.0 else 0.0


def _history(problem: PeriodicProblem, solution: PeriodicSolution) -> PeriodHistory:
    """Return a period as the contact of `problem` saw it."""
    u, f = (one.reshape(len(one), -1) for one in (solution.displacement, solution.force))
    return PeriodHistory(plain(solution.internal[:, seen_coordinates(problem.boundary)]), plain(u), plain(f),
                         np.require(solution.state, dtype=np.int8, requirements=["C", "W"]))
