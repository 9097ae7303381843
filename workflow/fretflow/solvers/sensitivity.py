"""Sensitivities of the converged period by the implicit function theorem.

The arm's motion x solves ``r = Z_a x - g - Phi[x; p] = 0``, with the friction force Phi of a contact that repeats
itself, so that

    (Z_a - dPhi/dx) dx = dg - dZ_a x + dPhi

One march of the solved period, sample by sample with the Jacobian of each, carries at once the motions of the arm
(dPhi/dx), the parameters (dPhi) and unit changes of what the contact remembers at the start; with T the memory's
derivative over a period, (I - T) dm = drift closes the period exactly. All that is kept of the march is linear in
these columns and is combined once dx is known. Nothing is solved again.

Nodes that stick all the period stay where they are unless the direction `locked` moves them: this is the derivative
along a slow change of the parameter, as wear makes it. Extremes move with their sample, so that the derivative of a
sliding distance is one-sided where two samples tie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.direction import Direction
from fretflow.solvers.fourier import to_complex, to_real
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.arm import ArmEquations, RigBalance
from fretflow.solvers.quasi_static.march import Surroundings
from fretflow.solvers.quasi_static.sample import Array, ContactSystem
from fretflow.solvers.quasi_static.sensitivity import ContactDerivative, SolvedContact, differentiate_contact
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint

TRUNCATED = 1e-9  # of the arm's motion, beyond the harmonics that the solution is said to have


@record
class PeriodSensitivity:
    """Derivatives of a period by P parameters, rows in the order of `names`; units are per unit of the parameter."""

    names: tuple[str, ...]
    arm: Array = quantity("m", "(P, 2 H + 1), coefficients [a0, c1, s1, ...]")
    rig_displacement: Array = quantity("m", "(P, N, 2), block and arm, x")
    relative_displacement: Array = quantity("m", "(P, N), area mean of the faces' x")
    friction_force: Array = quantity("N", "(P, N), x force of the upper specimen on the lower")
    upper_observation: Array = quantity("m", "(P, N, 3)")
    lower_observation: Array = quantity("m", "(P, N, 3)")
    approach: Array = quantity("m", "(P, N), of the arm, positive upward")
    sliding_distance: Array = quantity("m", "(P,)")
    dissipated_energy: Array = quantity("J", "(P,), per cycle")
    pressure_sliding: Array = quantity("N/m", "(P, nodes), sum of p |du_t| per cycle")
    slip_path: Array = quantity("m", "(P, nodes), path slid in contact per cycle")
    mean_pressure: Array = quantity("Pa", "(P, nodes), mean over the period")
    mean_opening: Array = quantity("m", "(P, nodes), mean gap over the period")


def sensitivities(problem: PeriodicProblem, solution: PeriodicSolution, directions: Sequence[Direction],
                  harmonics: int) -> PeriodSensitivity:
    """Differentiate a period that the quasi-static solver found.

    Parameters
    ----------
    problem, solution
        The problem and its converged period of N samples and n nodes.
    directions
        P parameter directions.
    harmonics
        The harmonics of the arm's motion with which the solution was found.

    Raises
    ------
    InputError
        If the solution is not of that kind, or a direction's data do not fit it.
    """
    for direction in directions:
        direction.validate(*solution.state.shape)
    joint = problem.joint.quasi_static()
    equations = ArmEquations.of(problem, harmonics, len(solution.state))
    _check(solution, equations)
    balance = _balance(equations, solution)
    rig = _RigChange.build(joint, problem, equations, balance, solution, directions)
    in_contact = [i for i, direction in enumerate(directions) if direction.acts_in_contact]
    columns = _march(problem, joint, solution, equations, [directions[i] for i in in_contact])
    weights = np.zeros((columns.approach.shape[1], len(directions)))
    coefficients = len(equations.load)
    weights[coefficients + np.arange(len(in_contact)), in_contact] = 1.0
    pushed = equations.analysis @ columns.forces[:, 0]  # dPhi by all columns
    jacobian = balance.jacobian - pushed[:, :coefficients]
    weights[:coefficients] = np.linalg.solve(jacobian, rig.arm + pushed @ weights)
    return _collect(problem, solution, directions, equations, rig, weights[:coefficients], columns.combined(weights))


def _balance(equations: ArmEquations, solution: PeriodicSolution) -> RigBalance:
    block, arm = (equations.analysis @ solution.rig_displacement).T
    return equations.balance(arm, block)


def _check(solution: PeriodicSolution, equations: ArmEquations) -> None:
    if solution.method != "quasi-static":
        raise InputError(f'sensitivities: the period was found by "{solution.method}"; solve it by "quasi-static"')
    arm = solution.rig_displacement[:, 1]
    missed = float(np.abs(equations.synthesis @ (equations.analysis @ arm) - arm).max())
    if missed > TRUNCATED * float(np.abs(arm).max()):
        raise InputError(f"sensitivities: {len(equations.block[0]) - 1} harmonics do not hold the arm's motion; "
                         "give the number that the period was solved with")


@dataclass(frozen=True)
class _RigChange:
    """What the directions change in the rig at held motion: dF - dZ X, carried to the arm and to the block."""

    arm: Array  # (2 H + 1, P) N
    block: Array  # (2 H + 1, P) m, at held arm
    block_by_arm: Array  # (2 H + 1, 2 H + 1)

    @classmethod
    def build(cls, joint: QuasiStaticJoint, problem: PeriodicProblem, equations: ArmEquations, balance: RigBalance,
              solution: PeriodicSolution, directions: Sequence[Direction]) -> _RigChange:
        if problem.rig_forces and any(direction.frequency for direction in directions):
            raise InputError("sensitivities: the frequency's is not known where further forces act on the rig")
        moved = to_complex(equations.analysis @ solution.rig_displacement)
        order = np.arange(len(moved))
        omega = problem.omega * order
        k = order[:, None, None]
        by_omega: NDArray[np.complex128] = 1j * k * joint.rig.damping - 2.0 * problem.omega * k**2 * joint.rig.mass
        load = np.zeros((*moved.shape, len(directions)), dtype=complex)
        for i, direction in enumerate(directions):
            load[1, 0, i] += direction.excitation
            change: NDArray[np.complex128] = 2.0 * np.pi * direction.frequency * by_omega
            if direction.rig is not None:
                change += direction.rig.impedance(omega)
            load[:, :, i] -= np.einsum("kab,kb->ka", change, moved)
            if direction.force is not None:
                load[:, :, i] += to_complex(equations.analysis @ direction.force)
        on_block, on_arm = to_real(load[:, 0]), to_real(load[:, 1])
        return cls(on_arm + balance.carried @ on_block, balance.block_by_load @ on_block, balance.block_by_arm)


def _march(problem: PeriodicProblem, joint: QuasiStaticJoint, solution: PeriodicSolution, equations: ArmEquations,
           directions: Sequence[Direction]) -> ContactDerivative:
    """Differentiate the contact; force sums: x force, then what moves the upper and the lower observation node."""
    samples, nodes = solution.state.shape
    u, f = (a.transpose(0, 2, 1).reshape(samples, 3 * nodes) for a in (solution.displacement, solution.force))
    system = ContactSystem.of(problem, joint.stiffness)
    by_node = np.vstack([joint.motion[:, 0], joint.upper_compliance, -joint.lower_compliance])
    sums = by_node.reshape(-1, nodes, 3).transpose(0, 2, 1).reshape(len(by_node), 3 * nodes)
    areas = problem.interface.areas
    under = Surroundings.of(problem).conditions(problem.normal_load, solution.rig_displacement[:, 1],
                                                equations.synthesis)
    return differentiate_contact(system, SolvedContact(u, f, solution.state), equations.synthesis, under, directions,
                                 areas / areas.sum(), sums)


def _collect(problem: PeriodicProblem, solution: PeriodicSolution, directions: Sequence[Direction],
             equations: ArmEquations, rig: _RigChange, arm: Array, contact: ContactDerivative) -> PeriodSensitivity:
    """Put the record together; arm (2 H + 1, P), and the contact by P columns."""
    areas = problem.interface.areas
    block = equations.synthesis @ (rig.block_by_arm @ arm + rig.block)
    moved = equations.synthesis @ arm
    upper, lower = contact.forces[:, 1:4].copy(), contact.forces[:, 4:]
    upper[:, 0] += moved
    upper[:, 2] += contact.approach
    mean = solution.displacement[:, :, 0] @ areas / areas.sum()
    return PeriodSensitivity(
        names=tuple(direction.name for direction in directions),
        arm=arm.T, rig_displacement=np.stack([block.T, moved.T], axis=-1),
        relative_displacement=contact.displacement.T, friction_force=-contact.forces[:, 0].T,
        upper_observation=upper.transpose(2, 0, 1), lower_observation=lower.transpose(2, 0, 1),
        approach=contact.approach.T,
        sliding_distance=contact.displacement[np.argmax(mean)] - contact.displacement[np.argmin(mean)],
        dissipated_energy=contact.energy,
        pressure_sliding=contact.sliding.T / areas, slip_path=contact.path.T,
        mean_pressure=contact.pressing.T / areas, mean_opening=contact.opening.T)

