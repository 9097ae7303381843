"""The solvers by name."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import ValidationError

from fretflow.case.config import PeriodicMethod, Solver, explain
from fretflow.core.errors import FretflowError, InputError
from fretflow.solvers.dlft.solver import DlftSolver
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution, PeriodicSolver, check_problem
from fretflow.solvers.quasi_static.cautions import period_multipliers, warn_of_instability, warn_of_no_contact
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.stability import is_stable


def make_solver(settings: Solver, estimate_error: bool = False, keeps_tangents: bool = False) -> PeriodicSolver:
    """Return the solver that `settings` ask for; only a single period is worth an estimate of its error.

    One of many neighbours in turn `keeps_tangents`, see `QuasiStaticSolver`.
    """
    own = settings.model_copy(update={"estimate_error": estimate_error and settings.estimate_error})
    return DlftSolver(own) if own.method is PeriodicMethod.DLFT else QuasiStaticSolver(own, keeps_tangents)


def solve_periodic(problem: PeriodicProblem, method: str = "quasi-static", *, start: PeriodicSolution | None = None,
                   **settings: Any) -> PeriodicSolution:
    """Find the steady period of a joint under its excitation.

    Parameters
    ----------
    problem : PeriodicProblem
        Structure, interface, law and loads.
    method : str
        "quasi-static": internal coordinates by harmonics, the contact true in time; or "dlft": all by few harmonics, as
        in the paper, with all the mass.
    start : PeriodicSolution, optional
        A neighbouring period to start from.
    settings
        Of the section ``[solver]`` of case files: harmonics, samples, tolerance, max_iterations, penalty,
        estimate_error (here False by default).

    Returns
    -------
    PeriodicSolution
        Displacements in m and forces in N of every contact node and sample, and the named outputs in m.

    Raises
    ------
    InputError
        If there is no such method or setting, the method does not know what the problem holds, an overtone is above the
        harmonics, or `start` is of another joint.
    NonConvergenceError
        With the residual history.
    AuditError
        If the period breaks the contact law.

    Warns
    -----
    FretflowWarning
        If the faces touch at no time, so that there is no friction.
    UnstablePeriodWarning
        If a Floquet multiplier of the quasi-static period lies outside the unit circle.
    HeavyContactWarning
        If the contact's inertia, which the quasi-static solver leaves out, holds over 2 % of the kinetic energy, or the
        damping of its own motion over 2 % of the excitation's work.

    Notes
    -----
    DLFT: Tubita, Fantetti, Blanc, Thouverez (2021), after Nacivet et al., J. Sound Vib. 265 (2003) 201-219. The
    massless boundary of the other method: C. D. Monjaraz Tec, J. Gross, M. Krack, Comput. Struct. 260 (2022) 106698.

    Examples
    --------
    A mass of 1 kg on a spring of 1 N/um, dragging a contact point of 1 g that 100 N press on the ground:

    >>> import fretflow as ff
    >>> import numpy as np
    >>> k = np.diag([2e6, 1e6, 1e6, 1e6])
    >>> k[0, 1] = k[1, 0] = -1e6
    >>> joint = ff.Joint.from_matrices(k, np.diag([1.0, *3 * [1e-3]]), contact_map=np.eye(4)[1:], observe={"tip": 0},
    ...                                modal_damping=0.02)
    >>> face = ff.Interface(np.zeros((1, 2)), np.array([1e-4]), np.zeros(1))
    >>> problem = ff.PeriodicProblem(joint, face, ff.Coulomb(0.3), ff.Harmonic(100.0, {"tip": 90.0}),
    ...                              preload=ff.NormalLoad(100.0))
    >>> period = ff.solve_periodic(problem, harmonics=15, samples=128)
    >>> round(1e3 * period.dissipated_energy, 2)  # mJ
    8.74
    """
    try:
        chosen = Solver(**{"method": method, "estimate_error": False, **settings})
    except ValidationError as error:
        raise InputError(f"solve_periodic: {explain(error, {}, model=Solver)}") from error
    check_problem(problem, chosen.resolved_harmonics)
    if start is not None:
        _check_start(problem, start, chosen.method)
    solution = make_solver(chosen, estimate_error=True).solve(problem, start)
    warn_of_no_contact(solution)
    if chosen.method is PeriodicMethod.QUASI_STATIC and not is_stable(period_multipliers(problem, solution)):
        warn_of_instability(problem, _finer(problem, solution, chosen))
    return solution


def _check_start(problem: PeriodicProblem, start: PeriodicSolution, method: PeriodicMethod) -> None:
    """Refuse a start of another number of nodes, or to the quasi-static solver of internal coordinates."""
    sizes = {"contact nodes": (start.displacement.shape[1], problem.interface.size)}
    if method is PeriodicMethod.QUASI_STATIC:
        sizes["internal coordinates"] = int(np.prod(start.internal.shape[1:])), problem.boundary.size
    for what, (given, due) in sizes.items():
        if given != due:
            raise InputError(f"start: is a period of {given} {what}, and the problem has {due}; leave it out")


def _finer(problem: PeriodicProblem, solution: PeriodicSolution, chosen: Solver) -> PeriodicSolution:
    """Return a period with four times the samples, as few of them make multipliers larger; itself where none is found.

    A step adds energy where it is long against the fastest motion.
    """
    try:
        return make_solver(chosen.model_copy(update={"samples": 4 * chosen.resolved_samples})).solve(problem, solution)
    except FretflowError:
        return solution
