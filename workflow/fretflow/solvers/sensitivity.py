"""Sensitivities of the converged period by the implicit function theorem.

The motion x of the coordinates seen from the contact solves ``r = Z_a x - g - Phi[x; p] = 0``, with the force Phi of a
contact that repeats itself, so that

    (Z_a - dPhi/dx) dx = dg - dZ_a x + dPhi

One march of the solved period, sample by sample with the Jacobian of each, carries at once the motions
(dPhi/dx), the parameters (dPhi) and unit changes of what the contact remembers at the start; with T the memory's
derivative over a period, (I - T) dm = drift closes the period exactly. All that is kept of the march is linear in
these columns and is combined once dx is known. Nothing is solved again.

Nodes that stick all the period stay where they are unless the direction `locked` moves them: this is the derivative
along a slow change of the parameter, as wear makes it. Extremes move with their sample, so that the derivative of a
sliding distance is one-sided where two samples tie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.fourier import to_complex, to_real
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.internal import InternalBalance, InternalEquations, seen_coordinates
from fretflow.solvers.quasi_static.march import Surroundings
from fretflow.solvers.quasi_static.sample import Array, ContactSystem, PeriodHistory, plain
from fretflow.solvers.quasi_static.sensitivity import (
    ContactColumns,
    ContactDerivative,
    Direction,
    LinearOutputs,
    SolvedContact,
    strains,
)
from fretflow.structure.structure import NORMAL_LOAD
from fretflow.structure.two_mass_rig.joint import rig_of

TRUNCATED = 1e-9  # of the arm's motion, beyond the harmonics that the solution is said to have


@record
class PeriodSensitivity:
    """Derivatives of a period by P parameters, rows in the order of `names`; units are per unit of the parameter."""

    names: tuple[str, ...]
    seen: Array = quantity("m", "(P, (2 H + 1) d_a), coefficients [a0, c1, s1, ...] of the coordinates seen")
    internal: Array = quantity("m", "(P, N, d), internal coordinates")
    outputs: Mapping[str, Array] = quantity("m", "by name, (P, N) or (P, N, k)")
    relative_displacement: Array = quantity("m", "(P, N), area mean of the faces' x")
    friction_force: Array = quantity("N", "(P, N), x force of the upper specimen on the lower")
    sliding_distance: Array = quantity("m", "(P,)")
    dissipated_energy: Array = quantity("J", "(P,), per cycle")
    pressure_sliding: Array = quantity("N/m", "(P, nodes), sum of p |du_t| per cycle")
    slip_path: Array = quantity("m", "(P, nodes), path slid in contact per cycle")
    mean_pressure: Array = quantity("Pa", "(P, nodes), mean over the period")
    mean_opening: Array = quantity("m", "(P, nodes), mean gap over the period")

    def moved(self, solution: PeriodicSolution, v: int) -> PeriodicSolution:
        """Return `solution` with its motion, not its contact, changed to first order by one of parameter v."""
        outputs = {name: values + self.outputs[name][v] for name, values in solution.outputs.items()}
        return replace(solution, internal=solution.internal + self.internal[v], outputs=outputs)


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
    return DifferentiatedPeriod(problem, solution, directions, harmonics).first


class DifferentiatedPeriod:
    """A period that the quasi-static solver found, with its derivatives by some directions; see `sensitivities`.

    Those `by` further ones cost little: the motions are marched once.
    """

    def __init__(self, problem: PeriodicProblem, solution: PeriodicSolution, directions: Sequence[Direction],
                 harmonics: int) -> None:
        self.problem, self.solution = problem, solution
        in_contact = self._in_contact(directions)
        self.equations = equations = InternalEquations.of(problem, harmonics, len(solution.state))
        _check(solution, equations)
        # b as it was found: where it was an unknown beside a, it need not follow from a alone
        self.balance = equations.beside_balance(*(equations.coefficients(solution.internal[:, part])
                                                  for part in (equations.seen, equations.other)))
        self.columns = _columns(problem, solution, equations, in_contact)
        self.first = self._derivatives(directions, self.columns.closed())

    def by(self, directions: Sequence[Direction]) -> PeriodSensitivity:
        """Return the derivatives by P further directions; raises as `sensitivities`."""
        return self._derivatives(directions, self.columns.by(self._in_contact(directions)))

    def _in_contact(self, directions: Sequence[Direction]) -> list[Direction]:
        for direction in directions:
            direction.validate(*self.solution.state.shape)
        return [direction for direction in directions if direction.acts_in_contact]

    def _derivatives(self, directions: Sequence[Direction], columns: ContactDerivative) -> PeriodSensitivity:
        """Return all by directions, of a contact's columns by motions and by those of them that act there."""
        equations, size = self.equations, len(self.equations.load)
        rig = _RigChange.build(self.problem, equations, self.balance, self.solution, directions)
        in_contact = [i for i, direction in enumerate(directions) if direction.acts_in_contact]
        self._strain(columns, [directions[i] for i in in_contact])
        weights = np.zeros((columns.energy.shape[0], len(directions)))
        weights[size + np.arange(len(in_contact)), in_contact] = 1.0
        pushed = equations.coefficients(columns.outputs[:, :len(equations.seen)])  # dPhi by all columns
        jacobian = self.balance.linear.jacobian - pushed[:, :size]
        weights[:size] = np.linalg.solve(jacobian, rig.seen + pushed @ weights)
        return _collect(self.problem, self.solution, directions, equations, rig, weights[:size],
                        columns.combined(weights))

    def _strain(self, columns: ContactDerivative, directions: Sequence[Direction]) -> None:
        """Take in that directions strain what is in series with the free coordinates."""
        b = self.problem.boundary
        lever = np.linalg.solve(b.free.T @ b.bare_stiffness @ b.free, b.free.T @ b.bare_stiffness)
        for row_of_output, row in enumerate(lever, start=len(self.equations.seen) + 1):
            columns.outputs[:, row_of_output, len(self.equations.load):] -= strains(
                self.columns.solved.period, directions, row)


def _check(solution: PeriodicSolution, equations: InternalEquations) -> None:
    if solution.method != "quasi-static":
        raise InputError(f'sensitivities: the period was found by "{solution.method}"; solve it by "quasi-static"')
    moved = solution.internal[:, equations.seen]
    missed = float(np.abs(equations.motion(equations.coefficients(moved)) - moved).max())
    if missed > TRUNCATED * float(np.abs(moved).max()):
        raise InputError(f"sensitivities: {len(equations.analysis) // 2} harmonics do not hold the internal motion; "
                         "give the number that the period was solved with")


@dataclass(frozen=True)
class _RigChange:
    """What the directions change in the structure at held motion: dF - dZ X, carried to a and to b."""

    seen: Array  # (n_a, P) N
    other: Array  # (n_b, P) m, at held a
    other_by_seen: Array  # (n_b, n_a)

    @classmethod
    def build(cls, problem: PeriodicProblem, equations: InternalEquations, balance: InternalBalance,
              solution: PeriodicSolution, directions: Sequence[Direction]) -> _RigChange:
        moved = to_complex(equations.analysis @ solution.internal)
        omega = problem.omega * np.arange(len(moved))
        load = np.zeros((*moved.shape, len(directions)), dtype=complex)
        for i, direction in enumerate(directions):
            if direction.rig is not None:
                rig_of(problem.structure)
                load[:, :, i] -= np.einsum("kab,kb->ka", direction.rig.impedance(omega), moved)
            if direction.force is not None:
                load[:, :, i] += to_complex(equations.analysis @ direction.force)
        on_other, on_seen = (to_real(load[:, part]).reshape(-1, len(directions))
                             for part in (equations.other, equations.seen))
        linear = balance.linear
        return cls(on_seen + linear.carried @ on_other, linear.other_by_load @ on_other, linear.other_by_seen)


def _columns(problem: PeriodicProblem, solution: PeriodicSolution, equations: InternalEquations,
             directions: Sequence[Direction]) -> ContactColumns:
    """March the contact. Outputs: force on a, mean u_x, x force, free coordinates, outputs' forces in turn."""
    b, samples = problem.boundary, len(solution.state)
    u, f = (plain(a.reshape(samples, -1)) for a in (solution.displacement, solution.force))
    period = PeriodHistory(plain(solution.internal[:, equations.seen]), u, f,
                           np.require(solution.state, dtype=np.int8, requirements=["C", "W"]))
    system = ContactSystem.of(problem, equations.seen)
    load = b.inputs.index(NORMAL_LOAD)
    directions_of_seen = equations.directions()
    pulls = [system.coupling, *([] if system.curvature is None else [system.curvature]), b.input_pull[:, load:load + 1]]
    coupling = np.hstack(pulls)
    loaded = replace(system, coupling=coupling, curvature=None, transfer=np.vstack([
        system.transfer, np.zeros((coupling.shape[1] - len(system.transfer), 3 * system.size))]))
    around = Surroundings.of(problem, equations.seen)
    factor = around.friction_factor(period.position)
    still = np.zeros((samples, 1, directions_of_seen.shape[2]))
    moved = system.moved(period.position, directions_of_seen)
    solved = SolvedContact(loaded, period, factor, np.concatenate([moved, still], axis=1),
                           around.factor_slope(factor, directions_of_seen))
    return ContactColumns(solved, _outputs(problem, system, loaded), directions)


def _outputs(problem: PeriodicProblem, system: ContactSystem, loaded: ContactSystem) -> LinearOutputs:
    """Return the weights of `_march`."""
    b, areas = problem.boundary, problem.interface.areas
    mean, along = np.zeros((2, 1, 3 * len(areas)))
    mean[0, 0::3], along[0, 0::3] = areas / areas.sum(), 1.0
    sums = np.vstack([system.transfer, along, *(one.force for one in b.outputs.values() if one.force is not None)])
    by_displacement, by_coordinate = sums @ loaded.stiffness, -sums @ loaded.coupling
    d, load = len(system.transfer), b.inputs.index(NORMAL_LOAD)
    lever = b.bare_stiffness @ b.free
    series = b.free.T @ lever
    free = np.linalg.solve(series, lever.T)
    seen = seen_coordinates(b)
    bent = [] if b.free_curvature is None else [-np.linalg.solve(series, b.free_curvature[:, seen])]
    free_by = np.hstack([-free @ b.motion[:, seen] - np.linalg.solve(series, b.free_coupling[:, seen]), *bent,
                         -free @ b.input_motion[:, load:load + 1]
                         - np.linalg.solve(series, b.input_free[:, load:load + 1])])
    none = np.zeros((1 + len(free), 3 * len(areas)))
    return LinearOutputs(
        np.vstack([by_displacement[:d], mean, free, by_displacement[d:]]), np.vstack([sums[:d], none, sums[d:]]),
        np.vstack([by_coordinate[:d], np.zeros((1, free_by.shape[1])), free_by, by_coordinate[d:]]))


def _collect(problem: PeriodicProblem, solution: PeriodicSolution, directions: Sequence[Direction],
             equations: InternalEquations, rig: _RigChange, seen: Array, contact: ContactDerivative
             ) -> PeriodSensitivity:
    """Put the record together; seen (n_a, P), and the contact by P columns."""
    areas, b = problem.interface.areas, problem.boundary
    mean = problem.interface.mean(solution.displacement[:, :, 0])
    internal = np.empty((len(directions), len(solution.state), b.size))
    for part, by in ((equations.seen, seen), (equations.other, rig.other_by_seen @ seen + rig.other)):
        by_harmonic = by.reshape(equations.synthesis.shape[1], -1)  # coordinates and parameters together
        internal[:, :, part] = (equations.synthesis @ by_harmonic).reshape(
            len(equations.synthesis), len(part), -1).transpose(2, 0, 1)
    at = len(equations.seen) + 1 + b.free.shape[1]
    displacement, free = contact.outputs[:, len(equations.seen)], contact.outputs[:, len(equations.seen) + 1:at]
    outputs, at = dict[str, Array](), at + 1
    for name, one in b.outputs.items():
        derivative = internal @ one.motion.T
        if one.free is not None:
            derivative = derivative + np.einsum("jsp,ks->pjk", free, one.free)
        if one.force is not None:
            derivative = derivative + contact.outputs[:, at:at + len(one.force)].transpose(2, 0, 1)
            at += len(one.force)
        outputs[name] = derivative[:, :, 0] if derivative.shape[2] == 1 else derivative
    return PeriodSensitivity(
        names=tuple(direction.name for direction in directions),
        seen=seen.T, internal=internal, outputs=outputs, relative_displacement=displacement.T,
        friction_force=-contact.outputs[:, len(equations.seen) + 1 + b.free.shape[1]].T,
        sliding_distance=displacement[np.argmax(mean)] - displacement[np.argmin(mean)],
        dissipated_energy=contact.energy,
        pressure_sliding=contact.sliding.T / areas, slip_path=contact.path.T,
        mean_pressure=contact.pressing.T / areas, mean_opening=contact.opening.T)
