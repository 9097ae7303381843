"""The true periodic solver: internal coordinates by harmonics, the contact quasi-static at every time sample.

The bodies' own modes beside the internal coordinates lie far above the harmonics that matter, so the contact nodes
carry no inertia and their motion has no reason to be truncated (massless boundary, see `structure.structure`). The
coordinates are harmonic, and the force they feel of the contact is a functional Phi of their motion a:

    Z_a(k omega) a_k = g_k + Phi_k[a],    k = 0..H

with Z_a their impedance after elimination of those that the contact does not see. Newton on the (2 H + 1) d_a
coefficients uses the exact tangent of Phi from the march of the contact. Where that fails from all starts, further
forces, then the excitation, are raised from nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from operator import is_not
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.audit import audit_period
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution
from fretflow.solvers.quasi_static.candidate_nodes import (
    PartOfFaces,
    candidate_nodes,
    extend_solution,
    penetrating,
    restrict,
    restrict_solution,
)
from fretflow.solvers.quasi_static.cautions import warn_of_heavy_contact
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.newton import CLOSE, COARSE, InitialGuess, InternalNewton, Iterate
from fretflow.solvers.quasi_static.sample import PeriodHistory, SampleState, plain
from fretflow.solvers.quasi_static.starts import (
    REPEATING,
    Settled,
    cold_starts,
    corrected_on_patches,
    marched_starts,
    settled_starts,
    stuck_start,
)
from fretflow.solvers.quasi_static.symmetry import OneSide
from fretflow.solvers.time_integration import at_phase_zero
from fretflow.structure.internal_forces import ShareOfForce
from fretflow.structure.two_mass_rig.lumped import LumpedRig

SMALLEST_SHARE = 0.05  # step in which further forces or the excitation are raised, or a condition is followed
# Violation of the contact law over the solver's tolerance, and at least, that counts as one: ten times what was seen of
# the direction of sliding, and a hundred times of all else.
UNLAWFUL, LEAST_UNLAWFUL = 1e3, 1e-6
PATIENCE = 8  # steps of Newton in which the residual has to halve: of any structure, and of a rig that has settled


class _Settings(Protocol):
    """The part of the case's [solver] section that this solver reads."""

    @property
    def resolved_harmonics(self) -> int: ...
    @property
    def resolved_samples(self) -> int: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def max_iterations(self) -> int: ...
    @property
    def estimate_error(self) -> bool: ...


class QuasiStaticSolver:
    """Solves periodic problems true to time integration (``docs/theory/periodic.md``).

    Where it `keeps_tangents`, a rig's period has its last one: what begins from it is solved in half the time, and
    within its tolerance depends on where it began. A rig's period that Newton loses near another one is sought where
    the motion settles in time, unless that was in vain as often as `settlings` says, as it takes longest: whoever can
    take a shorter step need not, and what is not found there is seldom found a step before. Where kinks fall between
    the samples, these may leave no root: it `takes_stalled` residuals of ten times the tolerance, for which that has to
    be well below what the samples miss.
    """

    def __init__(self, settings: _Settings, keeps_tangents: bool = False, settlings: float = np.inf,
                 takes_stalled: bool = False) -> None:
        self.settings = settings
        self.keeps_tangents = keeps_tangents
        self.settlings = settlings
        self.takes_stalled = takes_stalled
        self._kept_equations: tuple[tuple[object, ...], InternalEquations] | None = None
        self._kept_side: tuple[tuple[object, ...], OneSide | None] | None = None

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period; where the tolerance is not coarse, its contact law is audited.

        Raises
        ------
        NonConvergenceError
            With the residual history, relative to the excitation.
        AuditError
            If the period breaks the contact law at a node and sample.
        """
        solution = self._solve(problem, self.settings.resolved_samples, start)
        if self.settings.tolerance <= COARSE:
            audit_period(problem, solution, max(LEAST_UNLAWFUL, UNLAWFUL * self.settings.tolerance))
            warn_of_heavy_contact(problem, solution)
        if not self.settings.estimate_error:
            return solution
        # first order in the samples: the difference to half of them is about the error that remains
        coarse = self._solve(problem, self.settings.resolved_samples // 2, solution)
        fine, rough = (sliding_distance(s, problem.interface) for s in (solution, coarse))
        return replace(solution, error_estimate=abs(fine - rough) / max(fine, 1e-15))

    def _solve(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        """Solve for the nodes on one side of a plane of symmetry, where there is one."""
        side = self._one_side(problem)
        if side is None or not side.is_of(problem, start):
            return self._solve_near(problem, samples, start)
        near = None if start is None else start.half(side.plane)
        return self._solve_near(side.half(problem), samples, near).whole(side.plane)

    def _one_side(self, problem: PeriodicProblem) -> OneSide | None:
        """Return the plane that structure and nodes are symmetric about: the last one where these are the same."""
        made_of = problem.boundary, problem.interface.nodes
        kept = self._kept_side
        if kept is None or any(map(is_not, made_of, kept[0])):
            self._kept_side = kept = made_of, OneSide.of(problem.boundary, problem.interface)
        return kept[1]

    def _solve_near(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        """Solve for the nodes within reach, and again for more of them if others turn out to touch."""
        nodes = candidate_nodes(problem, start)
        while not nodes.all():
            near = None if start is None else restrict_solution(start, nodes)
            solution = extend_solution(self._solve_all(restrict(problem, nodes), samples, near), problem, nodes)
            missed = penetrating(solution, problem.interface, nodes)
            if not missed.any():
                return solution
            nodes, start = nodes | missed, solution
        return self._solve_all(problem, samples, start)

    def _solve_all(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        if not isinstance(problem.boundary.internal, LumpedRig):
            return self._settled(problem, samples, start)
        forces = problem.boundary.forces
        try:
            return self._find(problem, samples, start)
        except NonConvergenceError:
            if start is not None:
                raise
        if forces:
            return self._raised(lambda share: with_forces(problem, share), samples,
                                self._find(with_forces(problem, 0.0), samples, None), 0.5)
        return self._raised(lambda share: replace(problem, excitation=problem.excitation.scaled(share)), samples,
                            None, 0.25)

    def _raised(self, at: Callable[[float], PeriodicProblem], samples: int, solution: PeriodicSolution | None,
                step: float) -> PeriodicSolution:
        """Return the period of ``at(1)`` by steps from the `solution` at zero, or from rest."""
        share = 0.0
        while share < 1.0:
            target = min(1.0, share + step)
            try:
                solution = self._find(at(target), samples, solution, settling=False)
            except NonConvergenceError:
                step = 0.5 * (target - share)
                if step < SMALLEST_SHARE:
                    raise
                continue
            share, step = target, 2.0 * step
        if solution is None:
            raise NonConvergenceError("quasi-static period: nothing to raise")
        return solution

    def _settled(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None) -> PeriodicSolution:
        """Return the period of any structure: near `start`, of a contact that sticks, or where it settles in time."""
        equations, march, newton = self._equations(problem, samples, PATIENCE)
        contact, first = _beginning(problem, equations, march, start, samples)
        error = NonConvergenceError("the contact does not stick")
        try:
            at = newton.best(chain(first, [stuck_start(equations, march)]), contact)
            if start is not None or at.norm <= CLOSE:
                return _solution(problem, equations, *newton.refine(at, self.settings.max_iterations))
        except NonConvergenceError as failure:
            error = failure
        return _solution(problem, equations, *self._where_it_settles(problem, equations, march, start, error))

    def _where_it_settles(self, problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch,
                          start: PeriodicSolution | None, error: NonConvergenceError, ringing: bool = True
                          ) -> tuple[Iterate, tuple[float, ...]]:
        """Return the root by the motion in time from phase zero of `start`; `error` came of what was tried before.

        Newton begins close to a root there, or creeps where kinks between the samples leave none: it has patience only.

        Raises
        ------
        NonConvergenceError
            With what that motion tells of the reason.
        """
        newton = self._newton(equations, march, PATIENCE)
        near, settled = None if start is None else at_phase_zero(problem, start), None
        for settled in settled_starts(problem, equations, march, near, ringing):
            try:
                return newton.solve(iter([settled.start]), settled.contact, self.settings.max_iterations)
            except NonConvergenceError as failure:
                error = min(error, failure, key=lambda one: min(one.history, default=np.inf))
        raise _not_found(error, settled)

    def _equations(self, problem: PeriodicProblem, samples: int, patience: int | None = None
                   ) -> tuple[InternalEquations, ContactMarch, InternalNewton]:
        equations = self._internal(problem, samples)
        march = ContactMarch.of(problem, equations.seen)
        return equations, march, self._newton(equations, march, patience)

    def _newton(self, equations: InternalEquations, march: ContactMarch, patience: int | None) -> InternalNewton:
        return InternalNewton(equations, march, self.settings.tolerance, patience, self.takes_stalled)

    def _internal(self, problem: PeriodicProblem, samples: int) -> InternalEquations:
        """Return the structure's equations: the last ones where nothing that they are made of is another."""
        made_of = problem.boundary, problem.excitation, problem.preload
        kept = self._kept_equations
        if kept is None or len(kept[1].synthesis) != samples or any(map(is_not, made_of, kept[0])):
            harmonics = min(self.settings.resolved_harmonics, (samples - 1) // 2)
            self._kept_equations = kept = made_of, InternalEquations.of(problem, harmonics, samples)
        return kept[1]

    def _find(self, problem: PeriodicProblem, samples: int, start: PeriodicSolution | None,
              settling: bool = True) -> PeriodicSolution:
        equations, march, newton = self._equations(problem, samples)
        contact, first = _beginning(problem, equations, march, start, samples)
        failure: NonConvergenceError | None = None
        starts = ((newton, guess, contact) for guess in first)
        patient = self._newton(equations, march, PATIENCE)
        marched = marched_starts(problem, equations, march) if settling else iter(())
        for own, guess, before in chain(starts, ((patient, *one) for one in marched)):
            try:
                near = self._nearer(problem, equations, march, own, own.best(iter([guess]), before))
                if near.norm < 1.0:  # closer to balance than rest is
                    first = ()  # not twice
                    return self._kept(problem, equations, *own.refine(near, self.settings.max_iterations))
            except NonConvergenceError as error:
                failure = failure or error
        if failure is not None:
            if not settling or self.settlings <= 0:
                raise failure
            try:  # across a play, or beyond a fold of the response
                return self._kept(problem, equations, *self._where_it_settles(
                    problem, equations, march, start, failure, ringing=False))
            except NonConvergenceError:
                self.settlings -= 1
        return self._kept(problem, equations, *newton.solve(
            chain(first, cold_starts(problem, equations, march)), contact, self.settings.max_iterations))

    def _nearer(self, problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch,
                newton: InternalNewton, near: Iterate) -> Iterate:
        """Return where patches lead from a start, if that is nearer to balance.

        They cost several tangents of theirs; a neighbour that has its own is close.
        """
        if near.norm <= self.settings.tolerance or near.tangent is not None:
            return near
        guess = corrected_on_patches(problem, equations, march, near)
        if guess is None:
            return near
        closer = newton.best(iter([guess]), SampleState.of(near.history))
        return closer if closer.norm < near.norm else near

    def _kept(self, problem: PeriodicProblem, equations: InternalEquations, root: Iterate, history: tuple[float, ...]
              ) -> PeriodicSolution:
        """Return the period of a root, with its tangent where these are kept."""
        period = _solution(problem, equations, root, history)
        return replace(period, tangent=root.tangent) if self.keeps_tangents else period


def _not_found(error: NonConvergenceError, settled: Settled | None) -> NonConvergenceError:
    """Say how close the solver came, and what the motion in time tells of the reason."""
    if settled is None:
        return error
    came = f"quasi-static period: residual {min(error.history, default=np.inf):.1e} of the excitation at best"
    if settled.change > REPEATING:
        return NonConvergenceError(
            f"{came}; after {settled.periods} periods marched in time the motion still changes by {settled.change:.0%} "
            "from one to the next, so that there may be none of the excitation's: raise the damping", error.history)
    return NonConvergenceError(f'{came}, though the motion settles in time; use more samples, or method = "dlft"',
                               error.history)


def _beginning(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch,
               start: PeriodicSolution | None, samples: int) -> tuple[SampleState, tuple[InitialGuess, ...]]:
    """Return the contact before the period, and the start that a neighbouring period makes."""
    if start is None:
        return march.preloaded(problem.preload.frictional), ()
    near = _as_history(start, equations.seen, samples)
    other = equations.coefficients(_resample(start.internal, samples)[:, equations.other])
    tangent = start.tangent
    if tangent is not None and tangent.shape != equations.impedance.shape:
        tangent = None  # of other harmonics
    return SampleState.of(near), (InitialGuess(equations.coefficients(near.position), other, near, tangent),)


def with_forces(problem: PeriodicProblem, share: float) -> PeriodicProblem:
    """Return the problem with a share of the structure's further forces."""
    boundary = problem.boundary
    forces = tuple(ShareOfForce(share, force) for force in boundary.forces) if share else ()
    return replace(problem, structure=PartOfFaces(problem.structure, replace(boundary, forces=forces)))


def sliding_distance(solution: PeriodicSolution, interface: Interface) -> float:
    """Return the peak-to-peak of the area mean of the faces' relative x displacement, m."""
    return float(np.ptp(interface.mean(solution.displacement[:, :, 0])))


def _resample(values: NDArray[Any], samples: int) -> NDArray[Any]:
    """Take the nearest earlier sample of a period (N, ...) at each of `samples` times."""
    taken: NDArray[Any] = values[np.arange(samples) * len(values) // samples]
    return taken


def _as_history(solution: PeriodicSolution, seen: NDArray[np.intp], samples: int) -> PeriodHistory:
    """Read a solution as a guess."""
    u, f = (_resample(a, samples).reshape(samples, -1) for a in (solution.displacement, solution.force))
    return PeriodHistory(plain(_resample(solution.internal, samples)[:, seen]), plain(u), plain(f),
                         np.require(_resample(solution.state, samples), dtype=np.int8, requirements=["C", "W"]))


def _solution(problem: PeriodicProblem, equations: InternalEquations, root: Iterate, history: tuple[float, ...]
              ) -> PeriodicSolution:
    period = root.history
    samples, nodes = period.state.shape
    internal = equations.whole_motion(root.seen, root.balance.other)
    loads = problem.loads_at(2.0 * np.pi * np.arange(samples) / samples)
    force = period.force.reshape(samples, nodes, 3)
    return PeriodicSolution(
        method="quasi-static", frequency=problem.frequency,
        displacement=period.displacement.reshape(samples, nodes, 3).copy(), force=force.copy(), state=period.state,
        internal=internal, outputs=problem.boundary.observe(internal, period.displacement, period.force, loads),
        friction_force=-force[:, :, 0].sum(axis=1), residual_history=history, error_estimate=float("nan"))
