"""The DLFT solver: the paper's scheme, with an estimate of its own error.

The contact law holds in time, but only the retained harmonics of the displacement match, so that with few
harmonics the sliding distance depends on the penalty. Every solution therefore states its error (see
`DlftSolver`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Solver
from fretflow.contact.coulomb import audit_contact
from fretflow.contact.law import ContactState
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.dlft.equations import DenseStiffness, DlftEquations, Evaluation, Stiffness
from fretflow.solvers.fourier import analysis_matrix, to_complex, to_real
from fretflow.solvers.newton import NewtonResult, solve_newton
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution, refuse_unknown, structure_loads
from fretflow.structure.mirror import MirrorPlane
from fretflow.structure.structure import Structure
from fretflow.structure.two_mass_rig.condensed import CondensedJoint, condensed, spectral_radius

FIRST_LOAD_STEP, SMALLEST_LOAD_STEP = 0.25, 1e-3
SMALLER_PENALTY = 0.1
SOFTER = (0.1, 0.3)  # shares of the penalty at which Newton is tried first where it fails otherwise
FEW_HARMONICS, COARSE_TOLERANCE = 3, 1e-4
SLIDING_SHARE = 1.15  # of friction, above which a load slides: between 1 and 4 / pi, that of a square wave; measured
NO_SLIDING = 1e-15  # m, round-off of a stuck contact


class Variant(NamedTuple):
    """Numerical settings of one solution."""

    harmonics: int
    samples: int
    penalty: float | None  # N/m of a node by itself; by default the spectral radius of the static stiffness
    softened: float = 1.0  # share of that penalty


class DlftSolver:
    """Finds periods by DLFT (a `solvers.periodic.PeriodicSolver`).

    The error estimate is the larger relative change of the sliding distance (area mean, peak to peak) when
    the harmonics go from H to 2 H + 1, and when the penalty is a tenth.
    """

    def __init__(self, settings: Solver) -> None:
        self.settings = settings
        self._structure: Structure | None = None
        self._condensed: dict[bool, CondensedJoint | None] = {}  # by whether one side of it is wanted

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        AuditError
            If the contact forces violate the contact law.
        """
        joint = self._joint(problem)
        if joint is None or joint.plane is None:
            return self._solve(problem, start, joint)
        near = None if start is None else start.half(joint.plane)
        return self._solve(problem.half(joint.plane, problem.structure), near, joint).whole(joint.plane)

    def _solve(self, problem: PeriodicProblem, start: PeriodicSolution | None, joint: CondensedJoint | None
               ) -> PeriodicSolution:
        settings = self.settings
        variant = Variant(settings.resolved_harmonics, settings.resolved_samples, settings.penalty)
        first = None if start is None else _coefficients(start.displacement, variant.harmonics)
        equations = build_equations(problem, variant, joint)
        root = solve_equations(equations, first, settings.tolerance, settings.max_iterations)
        _audit(equations, root.state)
        solution = _solution(problem, equations, root, joint)
        if not settings.estimate_error:
            return solution
        return replace(solution, error_estimate=self._error(problem, variant, equations, root.unknowns, joint))

    def _joint(self, problem: PeriodicProblem) -> CondensedJoint | None:
        """Return the structure condensed, for one side of a plane that all is symmetric about where there is one.

        It is kept, because from one period to the next only loads and gaps change.
        """
        if self._structure is not problem.structure:
            self._structure = problem.structure
            self._condensed.clear()
        plane, harmonics = MirrorPlane.through(problem.interface.nodes), self.settings.resolved_harmonics
        if plane is not None and problem.is_symmetric(plane):
            joint = self._kept(plane)
            if joint is not None and joint.reaches(problem.frequency, _finer(harmonics)):
                return joint
        return self._kept(None)

    def _kept(self, plane: MirrorPlane | None) -> CondensedJoint | None:
        if self._structure is not None and (plane is not None) not in self._condensed:
            self._condensed[plane is not None] = condensed(self._structure, plane)
        return self._condensed[plane is not None]

    def _error(self, problem: PeriodicProblem, variant: Variant, equations: DlftEquations,
               unknowns: NDArray[np.float64], joint: CondensedJoint | None) -> float:
        """Return the larger change of the sliding distance, or nan if a finer solution is out of reach."""
        finer = _finer(variant.harmonics)
        variants = (variant._replace(harmonics=finer, samples=max(variant.samples, 4 * finer)),
                    variant._replace(softened=SMALLER_PENALTY))
        areas = problem.interface.areas
        base, changes = _sliding(equations, unknowns, areas), []
        for other in variants:
            beside = build_equations(problem, other, joint)
            try:
                root = solve_equations(beside, padded(unknowns, other.harmonics), self.settings.tolerance,
                                       self.settings.max_iterations)
            except NonConvergenceError:
                return float("nan")
            sliding = _sliding(beside, root.unknowns, areas)
            changes.append(abs(sliding - base) / max(sliding, base, NO_SLIDING))
        return max(changes)


def build_equations(problem: PeriodicProblem, variant: Variant,
                    joint: CondensedJoint | None = None) -> DlftEquations:
    """Return the DLFT equations; the penalty is by default the spectral radius of the static stiffness.

    `joint` is the problem's in its condensed form, if at hand; otherwise it is made where there is one. A node that
    stands for two has the penalty of both: its force is that of both.
    """
    joint = joint or condensed(problem.structure)
    stiffness, load = _stiffness(problem, variant.harmonics, joint)
    penalty = variant.penalty
    if penalty is None:
        penalty = spectral_radius(stiffness.real_part(0)) if joint is None else joint.spectral_radius
    times = 1.0 if joint is None or joint.plane is None else joint.plane.times
    refuse_unknown(problem, 'solver.method = "dlft"')
    return DlftEquations(stiffness=stiffness, load=load, gap=problem.interface.gap, law=problem.nodal_law,
                         penalty=variant.softened * penalty * times, samples=variant.samples)


def _stiffness(problem: PeriodicProblem, harmonics: int,
               joint: CondensedJoint | None) -> tuple[Stiffness, NDArray[np.complex128]]:
    loads, push = structure_loads(problem, harmonics)
    if joint is not None and joint.reaches(problem.frequency, harmonics):
        relative = joint.relative(problem.frequency, loads)
        return relative, relative.load + push
    dense = problem.structure.dynamic_stiffness(problem.frequency, loads)
    return DenseStiffness(dense.stiffness), dense.load + push


def solve_equations(equations: DlftEquations, start: NDArray[np.float64] | None, tolerance: float,
                    max_iterations: int) -> NewtonResult[Evaluation]:
    """Solve from `start` (2 H + 1, 3 n) if given, else from half the harmonics, sliding or rest, else in steps of load.

    Between partial and gross slip Newton may go round in circles: with a smaller penalty nodes change their state less
    abruptly, and the solution for that penalty lies near by.

    Raises
    ------
    NonConvergenceError
        If none of these leads to a root; with the history of the last one.
    """
    for guess in _guesses(equations, start, max_iterations):
        try:
            return solve_newton(equations, guess, equations.scale, tolerance, max_iterations)
        except NonConvergenceError:
            continue
    return _raise_load(equations, tolerance, max_iterations)


def _guesses(equations: DlftEquations, start: NDArray[np.float64] | None,
             max_iterations: int) -> Iterator[NDArray[np.float64]]:
    """Yield first iterates, the most promising first."""
    if start is not None:
        yield start
    elif equations.harmonics > FEW_HARMONICS:  # costs little there, and takes most of the steps
        try:
            root = solve_equations(equations.up_to((equations.harmonics - 1) // 2), None, COARSE_TOLERANCE,
                                   max_iterations)
            yield padded(root.unknowns, equations.harmonics)
        except NonConvergenceError:
            pass
    rest, sliding = np.zeros((2 * equations.harmonics + 1, equations.load.shape[1])), free_sliding(equations)
    first, second = (sliding, rest) if _slides(equations) else (rest, sliding)
    yield first
    yield from _softer_roots(equations, first if start is None else start, max_iterations)
    yield second


def _softer_roots(equations: DlftEquations, start: NDArray[np.float64], max_iterations: int
                  ) -> Iterator[NDArray[np.float64]]:
    """Yield roots of the same equations with smaller penalties."""
    for share in SOFTER:
        with suppress(NonConvergenceError):
            yield solve_newton(replace(equations, penalty=share * equations.penalty), start, equations.scale,
                               COARSE_TOLERANCE, max_iterations).unknowns


def _finer(harmonics: int) -> int:
    """Return how many harmonics tell what `harmonics` leave out."""
    return 2 * harmonics + 1


def padded(unknowns: NDArray[np.float64], harmonics: int) -> NDArray[np.float64]:
    """Return coefficients (2 `harmonics` + 1, 3 n) that begin with `unknowns`, the rest being zero."""
    more = np.zeros((2 * harmonics + 1, unknowns.shape[1]))
    more[:len(unknowns)] = unknowns
    return more


def free_sliding(equations: DlftEquations) -> NDArray[np.float64]:
    """Return the rigid sliding (2 H + 1, 3 n) in m that the load would cause without friction."""
    rigid = np.tile(np.eye(3)[:, :2], (equations.load.shape[1] // 3, 1))
    amplitudes = np.zeros_like(equations.load)
    motions = np.zeros((2, *amplitudes.shape), dtype=complex)
    motions[:, 1] = rigid.T
    impedance = np.array([rigid.T @ equations.stiffness.apply(motion)[1] for motion in motions]).T
    amplitudes[1] = rigid @ np.linalg.solve(impedance, rigid.T @ equations.load[1])
    return to_real(amplitudes)


def _slides(equations: DlftEquations) -> bool:
    """Return whether sticking would need clearly more friction in all than the static normal load provides."""
    amplitude = np.abs(equations.load[1:].reshape(equations.harmonics, -1, 3).sum(axis=1)[:, :2]).sum()
    normal = np.maximum(-equations.load[0].real[2::3], 0.0)
    return bool(amplitude > SLIDING_SHARE * equations.law.slip_limit(normal[None]).sum())


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
            step = 0.5 * (target - share)
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
    length = float(np.abs(state.force).max() / np.min(equations.penalty))
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
              root: NewtonResult[Evaluation], joint: CondensedJoint | None) -> PeriodicSolution:
    """Return the period in time: displacement from the retained harmonics, forces from the contact law."""
    state, synthesis = root.state, equations.synthesis
    reached = joint is not None and joint.reaches(problem.frequency, equations.harmonics)
    model = joint if joint is not None and reached else problem.structure
    loads, _ = structure_loads(problem, equations.harmonics)
    motion = model.motion_amplitudes(problem.frequency, to_complex(root.unknowns), loads)
    slips = np.abs(state.friction.trial) > state.limit
    label = np.where(state.trial_normal > 0.0, np.where(slips, ContactState.SLIP, ContactState.STICK),
                     ContactState.SEPARATION)
    return PeriodicSolution(
        method="dlft", frequency=problem.frequency,
        displacement=(synthesis @ root.unknowns).reshape(state.force.shape), force=state.force,
        state=label.astype(np.int8), internal=synthesis @ to_real(motion.internal),
        outputs={name: synthesis @ to_real(values) for name, values in motion.outputs.items()},
        friction_force=-state.force[:, :, 0].sum(axis=1), residual_history=root.history,
        error_estimate=float("nan"))
