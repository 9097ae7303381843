"""The DLFT solver: the paper's scheme, with an estimate of its own error.

The contact law holds in time, but only the retained harmonics of the displacement match, so that with few
harmonics the sliding distance depends on the penalty. Every solution therefore states its error (see
`DlftSolver`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from fretflow.contact.coulomb import CoulombLaw, audit_contact
from fretflow.core.config import Solver
from fretflow.core.errors import NonConvergenceError
from fretflow.harmonic.dlft_equations import DlftEquations, Evaluation
from fretflow.harmonic.fourier import analysis_matrix, to_complex, to_real
from fretflow.harmonic.newton import NewtonResult, solve_newton
from fretflow.harmonic.periodic import ContactState, PeriodicProblem, PeriodicSolution

FIRST_LOAD_STEP, SMALLEST_LOAD_STEP = 0.25, 1e-3
SMALLER_PENALTY = 0.1
NO_SLIDING = 1e-15  # m, round-off of a stuck contact


class Variant(NamedTuple):
    """Numerical settings of one solution."""

    harmonics: int
    samples: int
    penalty: float | None


class DlftSolver:
    """Finds periods by DLFT (a `harmonic.periodic.PeriodicSolver`).

    The error estimate is the larger relative change of the sliding distance (area mean, peak to peak) when
    the harmonics go from H to 2 H + 1, and when the penalty is a tenth.
    """

    def __init__(self, settings: Solver) -> None:
        self.settings = settings

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        AuditError
            If the contact forces violate the contact law.
        """
        settings = self.settings
        variant = Variant(settings.resolved_harmonics, settings.resolved_samples, settings.penalty)
        first = None if start is None else _coefficients(start.displacement, variant.harmonics)
        equations = build_equations(problem, variant)
        root = solve_equations(equations, first, settings.tolerance, settings.max_iterations)
        _audit(equations, root.state)
        solution = _solution(problem, equations, root)
        if not settings.estimate_error:
            return solution
        return replace(solution, error_estimate=self._error(problem, variant, equations, root.unknowns))

    def _error(self, problem: PeriodicProblem, variant: Variant, equations: DlftEquations,
               unknowns: NDArray[np.float64]) -> float:
        """Return the larger change of the sliding distance, or nan if a finer solution is out of reach."""
        finer = 2 * variant.harmonics + 1
        variants = (variant._replace(harmonics=finer, samples=max(variant.samples, 4 * finer),
                                     penalty=equations.penalty),
                    variant._replace(penalty=SMALLER_PENALTY * equations.penalty))
        areas = problem.interface.areas
        base, changes = _sliding(equations, unknowns, areas), []
        for other in variants:
            beside = build_equations(problem, other)
            padded = np.zeros((2 * other.harmonics + 1, unknowns.shape[1]))
            padded[:len(unknowns)] = unknowns
            try:
                root = solve_equations(beside, padded, self.settings.tolerance, self.settings.max_iterations)
            except NonConvergenceError:
                return float("nan")
            sliding = _sliding(beside, root.unknowns, areas)
            changes.append(abs(sliding - base) / max(sliding, base, NO_SLIDING))
        return max(changes)


def spectral_radius(stiffness: NDArray[np.float64]) -> float:
    """Return the largest eigenvalue of a symmetric stiffness, N/m: the penalty of Charleux et al. (2006)."""
    first = np.random.default_rng(0).normal(size=len(stiffness))  # Lanczos from a fixed vector: repeatable
    return float(eigsh(stiffness, k=1, which="LM", v0=first, return_eigenvectors=False)[0])


def build_equations(problem: PeriodicProblem, variant: Variant) -> DlftEquations:
    """Return the DLFT equations; the penalty is by default the spectral radius of the static stiffness."""
    relative = problem.joint.dynamic_stiffness(problem.frequency, variant.harmonics, problem.excitation,
                                               problem.normal_load)
    penalty = variant.penalty if variant.penalty is not None else spectral_radius(relative.stiffness[0].real)
    law = CoulombLaw(friction_coefficient=np.asarray(problem.friction_coefficient))
    return DlftEquations(stiffness=relative.stiffness, load=relative.load, gap=problem.interface.gap, law=law,
                         penalty=penalty, samples=variant.samples)


def solve_equations(equations: DlftEquations, start: NDArray[np.float64] | None, tolerance: float,
                    max_iterations: int) -> NewtonResult[Evaluation]:
    """Solve from `start` (2 H + 1, 3 n) if given, else from sliding or from rest, else by raising the load.

    Raises
    ------
    NonConvergenceError
        If none of these leads to a root; with the history of the last one.
    """
    rest, sliding = np.zeros((2 * equations.harmonics + 1, equations.load.shape[1])), free_sliding(equations)
    guesses = [sliding, rest] if _slides(equations) else [rest, sliding]
    for guess in ([] if start is None else [start]) + guesses:
        try:
            return solve_newton(equations, guess, equations.scale, tolerance, max_iterations)
        except NonConvergenceError:
            continue
    return _raise_load(equations, tolerance, max_iterations)


def free_sliding(equations: DlftEquations) -> NDArray[np.float64]:
    """Return the rigid sliding (2 H + 1, 3 n) in m that the load would cause without friction."""
    rigid = np.tile(np.eye(3)[:, :2], (equations.load.shape[1] // 3, 1))
    amplitudes = np.zeros_like(equations.load)
    impedance = rigid.T @ equations.stiffness[1] @ rigid
    amplitudes[1] = rigid @ np.linalg.solve(impedance, rigid.T @ equations.load[1])
    return to_real(amplitudes)


def _slides(equations: DlftEquations) -> bool:
    """Return whether sticking would need more friction in all than the static normal load provides."""
    amplitude = np.abs(equations.load[1:].reshape(equations.harmonics, -1, 3).sum(axis=1)[:, :2]).sum()
    normal = np.maximum(-equations.load[0].real[2::3], 0.0)
    return bool(amplitude > equations.law.slip_limit(normal[None]).sum())


def _raise_load(equations: DlftEquations, tolerance: float, max_iterations: int) -> NewtonResult[Evaluation]:
    """Follow the solution from rest as the vibrating load is raised, in steps as large as Newton allows."""
    share, step = 0.0, FIRST_LOAD_STEP
    unknowns: NDArray[np.float64] = np.zeros((2 * equations.harmonics + 1, equations.load.shape[1]))
    while True:
        target = min(1.0, share + step)
        load = np.concatenate([equations.load[:1], target * equations.load[1:]])
        try:
            root = solve_newton(replace(equations, load=load), unknowns, equations.scale, tolerance,
                                max_iterations)
        except NonConvergenceError as error:
            step *= 0.5
            if step < SMALLEST_LOAD_STEP:
                raise NonConvergenceError(f"DLFT: no solution beyond {share:.1%} of the excitation; try a "
                                          f"smaller penalty or more harmonics ({error})",
                                          error.history) from error
            continue
        if target == 1.0:
            return root
        share, unknowns, step = target, root.unknowns, 1.5 * step


def _audit(equations: DlftEquations, state: Evaluation) -> None:
    x = equations.contact_displacement(state)
    tangential = x[:, :, 0] + 1j * x[:, :, 1]
    slip = tangential - np.roll(tangential, 1, axis=0)
    length = float(np.abs(state.force).max()) / equations.penalty
    audit_contact(equations.gap + x[:, :, 2], state.force, slip, state.limit, length)


def _sliding(equations: DlftEquations, unknowns: NDArray[np.float64], areas: NDArray[np.float64]) -> float:
    """Return the area mean of the relative displacement in x, peak to peak in m."""
    return float(np.ptp(equations.synthesis @ unknowns[:, 0::3] @ areas) / areas.sum())


def _coefficients(displacement: NDArray[np.float64], harmonics: int) -> NDArray[np.float64]:
    """Return coefficients (2 H + 1, 3 n) of a displacement (N, nodes, 3), as far as its samples tell."""
    samples = len(displacement)
    known = min(harmonics, (samples - 1) // 2)
    coefficients = np.zeros((2 * harmonics + 1, displacement[0].size))
    coefficients[:2 * known + 1] = analysis_matrix(known, samples) @ displacement.reshape(samples, -1)
    return coefficients


def _solution(problem: PeriodicProblem, equations: DlftEquations,
              root: NewtonResult[Evaluation]) -> PeriodicSolution:
    """Return the period in time: displacement from the retained harmonics, forces from the contact law."""
    state, synthesis = root.state, equations.synthesis
    motion = problem.joint.motion_amplitudes(problem.frequency, to_complex(root.unknowns), problem.excitation,
                                             problem.normal_load)
    slips = np.abs(state.friction.trial) > state.limit
    label = np.where(state.trial_normal > 0.0, np.where(slips, ContactState.SLIP, ContactState.STICK),
                     ContactState.OPEN)
    return PeriodicSolution(
        method="dlft", frequency=problem.frequency,
        displacement=(synthesis @ root.unknowns).reshape(state.force.shape), force=state.force,
        state=label.astype(np.int8), rig_displacement=synthesis @ to_real(motion.rig),
        upper_observation=synthesis @ to_real(motion.upper_observation),
        lower_observation=synthesis @ to_real(motion.lower_observation),
        friction_force=-state.force[:, :, 0].sum(axis=1), residual_history=root.history,
        error_estimate=float("nan"))
