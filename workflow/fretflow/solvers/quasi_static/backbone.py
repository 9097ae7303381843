"""The contact as one hysteretic spring: its own backbone under Masing's rule.

Under a constant normal load the friction force depends on the arm's motion alone. Let the contact's backbone be
phi(q); by Masing's rule (G. Masing, 1926) a cycle is made of it: after a reversal at (q_r, f_r),
``f = f_r -+ 2 phi(|q - q_r| / 2)``. Parallel Jenkins elements (W. D. Iwan, J. Appl. Mech. 33 (1966)) do
the same sample by sample: element i sticks with stiffness k_i up to its limit s_i, so that
``phi'(q) = sum of k_i over s_i > k_i q``. Where the contact slides as a whole the rule is exact, since phi is read off
such a cycle. In partial slip it leaves out that friction tilts the faces and moves the pressure. So it serves as a fast
approximation for many frequencies and as a start for the full solution, not as a replacement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.core.compiled import compiled
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.solvers.periodic import PeriodicProblem, PeriodicSolution, refuse_unknown
from fretflow.solvers.quasi_static.internal import InternalEquations, seen_coordinates
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.sample import STICK, Array, SampleState, plain
from fretflow.structure.structure import squeezed
from fretflow.structure.two_mass_rig.lumped import LumpedRig

STEPS_TO_LIMIT = 40  # of a push from rest, at the stuck stiffness
FIRST_STEP = 5.0  # of the first push, in those steps: only its end matters
MAX_STEPS = 1000
NEVER = -1
STEADY = 1e-5  # change of the friction force in a step
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.125, 0.0625)
MAX_ITERATIONS = 40
TOLERANCE = 1e-4  # of the load; the kinks of single samples leave about a tenth of it


@compiled
def march_elements(stiffness: Array, limit: Array, arm: Array, forces: Array, since: NDArray[np.int64]) -> None:
    """March Jenkins elements (M,) to their steady period; fill in their force (N,) and when each slid last (N, M)."""
    samples = len(arm)
    force, slid = np.empty(len(limit)), np.empty(len(limit), dtype=np.int64)
    for m in range(len(limit)):
        force[m] = min(max(-stiffness[m] * arm[samples - 1], -limit[m]), limit[m])
        slid[m] = NEVER if abs(force[m]) < limit[m] else samples - 1
    for step in range(2 * samples):  # the second period is steady: Masing's rule forgets the first loading
        j = step % samples
        moved, total = arm[j] - arm[j - 1], 0.0
        for m in range(len(limit)):
            trial = force[m] - stiffness[m] * moved
            force[m] = min(max(trial, -limit[m]), limit[m])
            if not abs(trial) < limit[m]:
                slid[m] = j
            total += force[m]
            since[j, m] = slid[m]
        forces[j] = total


@dataclass(frozen=True)
class Backbone:
    """Parallel Jenkins elements: stiffness (M,) in N/m and limit (M,) in N, softest first."""

    stiffness: Array
    limit: Array

    @classmethod
    def of(cls, march: ContactMarch, start: SampleState) -> Backbone:
        """Push the arm from `start` until all slides, and back until all slides again; read the way back.

        A contact that slides as a whole remembers nothing, so each half of a sliding cycle is that way back, and
        half of it in both directions is the backbone.

        Raises
        ------
        NonConvergenceError
            If the contact does not let go.
        """
        limit = float(march.system.friction.mean()) * march.system.load
        step = limit / float(march.system.felt_stiffness[0, 0]) / STEPS_TO_LIMIT
        turned, arm, _ = _push(march, start, 0.0, FIRST_STEP * step)
        _, _, back = _push(march, turned, arm, -2.0 * step)
        return cls._through(0.5 * np.abs(back - back[0]))

    @classmethod
    def _through(cls, points: Array) -> Backbone:
        """Return the elements whose backbone joins `points` (K, 2) of arm position (m) and force (N)."""
        hull = points[:1]
        while hull[-1, 0] < points[-1, 0]:  # the concave hull: a face that tips back stiffens, which elements cannot
            ahead = points[points[:, 0] > hull[-1, 0]]
            slopes = (ahead[:, 1] - hull[-1, 1]) / (ahead[:, 0] - hull[-1, 0])
            hull = np.vstack([hull, ahead[len(slopes) - 1 - int(np.argmax(slopes[::-1]))]])
        slopes = np.append(np.diff(hull[:, 1]) / np.diff(hull[:, 0]), 0.0)
        stiffness = slopes[:-1] - slopes[1:]
        return cls(stiffness, stiffness * hull[1:, 0])

    def friction(self, arm: Array, directions: Array) -> tuple[Array, Array]:
        """Return the steady force on the arm (N,) in N and its tangent (N, p) for arm positions (N,) in m.

        `directions` (N, p) is the derivative of the positions.
        """
        forces, since = np.empty(len(arm)), np.empty((len(arm), len(self.limit)), dtype=np.int64)
        march_elements(plain(self.stiffness), plain(self.limit), plain(arm), forces, since)
        return forces, self._tangent(since, directions)

    def _tangent(self, since: NDArray[np.int64], directions: Array) -> Array:
        """Return the tangent (N, p) of elements that slid last at the samples `since` (N, M).

        From there an element has followed the arm: ``df = -k (dq - dq_since)``.
        """
        if not directions.shape[1]:
            return np.empty_like(directions)
        n = len(since)
        steady = self.stiffness * (since != NEVER)
        places = np.arange(n)[:, None] * n + np.where(since == NEVER, 0, since)
        weights = np.bincount(places.ravel(), weights=steady.ravel(), minlength=n * n).reshape(n, n)
        return np.asarray((weights - self.stiffness.sum() * np.eye(n)) @ directions)

    def solve(self, equations: InternalEquations, arm: Array, tolerance: float) -> Array:
        """Return the arm's coefficients (2 H + 1,) of the rig on this spring, from the guess `arm`.

        Raises
        ------
        NonConvergenceError
            With the residual history relative to the load.
        """
        scale = float(np.linalg.norm(equations.load))

        def evaluate(x: Array) -> tuple[Array, Array]:
            force, tangent = self.friction(equations.synthesis @ x, equations.synthesis)
            residual = equations.impedance @ x - equations.load - equations.analysis @ force
            return residual / scale, (equations.impedance - equations.analysis @ tangent) / scale

        return newton_across_kinks(evaluate, arm, tolerance)


def newton_across_kinks(evaluate: Callable[[Array], tuple[Array, Array]], x: Array, tolerance: float) -> Array:
    """Return the root of a function with kinks, from the guess `x`; `evaluate` gives residual and Jacobian.

    Samples that begin to stick one by one put kinks into the residual, across which it may have to grow.

    Raises
    ------
    NonConvergenceError
        With the residual history.
    """
    residual, jacobian = evaluate(x)
    history = [float(np.linalg.norm(residual))]
    while not history[-1] <= tolerance:  # nan included
        if len(history) > MAX_ITERATIONS:
            raise NonConvergenceError("the rig on the contact's backbone did not converge", history)
        step, tried = np.linalg.solve(jacobian, -residual), []
        for length in STEP_LENGTHS:
            tried.append((x + length * step, *evaluate(x + length * step)))
            if np.linalg.norm(tried[-1][1]) < (1.0 - 1e-3 * length) * history[-1]:
                break
        else:
            tried = tried[:1]
        x, residual, jacobian = tried[-1]
        history.append(float(np.linalg.norm(residual)))
    return x


def find_arm(problem: PeriodicProblem, equations: InternalEquations, backbone: Backbone, guess: Array | None = None
             ) -> Array:
    """Return the arm's coefficients (2 H + 1,) of the rig of `problem` on `backbone`.

    Raises
    ------
    NonConvergenceError
        If neither the guess, nor one Jenkins element, nor rest leads to them.
    """
    for start in _arms(problem, equations, backbone, guess):
        try:
            return backbone.solve(equations, start, TOLERANCE)
        except NonConvergenceError as error:
            failure = error
    raise failure


def _arms(problem: PeriodicProblem, equations: InternalEquations, backbone: Backbone, guess: Array | None
          ) -> Iterator[Array]:
    """Yield guesses of the arm's coefficients."""
    rig = problem.boundary.internal
    if guess is not None:
        yield guess
    if isinstance(rig, LumpedRig):
        yield equations.analysis @ jenkins_arm_motion(
            rig, float(backbone.stiffness.sum()), float(backbone.limit.sum()), problem.excitation.amplitude,
            problem.frequency, len(equations.synthesis))
    yield np.zeros_like(equations.load)


def has_backbone(problem: PeriodicProblem) -> bool:
    """Tell whether a `BackboneSolver` can solve `problem`."""
    with suppress(InputError):
        refuse_unknown(problem, "")
        return len(seen_coordinates(problem.boundary)) == 1
    return False


class BackboneSolver:
    """Finds periods of a joint whose contact is its own backbone; they have no nodal fields (0 nodes)."""

    def __init__(self, backbone: Backbone, harmonics: int, samples: int) -> None:
        self.backbone = backbone
        self.harmonics, self.samples = harmonics, samples

    @classmethod
    def of(cls, problem: PeriodicProblem, harmonics: int, samples: int) -> BackboneSolver:
        """Read the backbone off the contact of `problem`."""
        refuse_unknown(problem, "the contact's backbone")
        seen = seen_coordinates(problem.boundary)
        if len(seen) != 1:
            raise InputError(f"the contact's backbone: the contact moves with {len(seen)} coordinates, not with one; "
                             'use solver.method = "quasi-static"')
        march = ContactMarch.of(problem, seen)
        start = march.preloaded(problem.preload.frictional)
        return cls(Backbone.of(march, start), harmonics, samples)

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the period at the frequency and the excitation of `problem`.

        Raises
        ------
        InputError
            If the contact or the rig of `problem` follows the motion otherwise than a backbone can.
        NonConvergenceError
            As `find_arm`.
        """
        refuse_unknown(problem, "the contact's backbone")
        equations = InternalEquations.of(problem, self.harmonics, self.samples)
        guess = None if start is None else equations.analysis @ start.internal[:, equations.seen[0]]
        return self._solution(problem, equations, find_arm(problem, equations, self.backbone, guess))

    def _solution(self, problem: PeriodicProblem, equations: InternalEquations, arm: Array) -> PeriodicSolution:
        moved = equations.synthesis @ arm
        force, _ = self.backbone.friction(moved, np.zeros((len(moved), 0)))
        none = np.zeros((len(moved), 0, 3))
        internal, outputs = equations.whole_motion(arm, equations.free_other(arm)), problem.boundary.outputs
        return PeriodicSolution(
            method="backbone", frequency=problem.frequency, displacement=none, force=none,
            state=np.zeros(none.shape[:2], dtype=np.int8), friction_force=-force,
            internal=internal, residual_history=(), error_estimate=float("nan"),
            outputs={name: squeezed(internal @ one.motion.T if one.free is None and one.force is None
                                    else np.full((len(moved), len(one.motion)), np.nan))
                     for name, one in outputs.items()})


def _push(march: ContactMarch, state: SampleState, arm: float, step: float) -> tuple[SampleState, float, Array]:
    """Move the arm by steps until the contact slides; return its state, the arm (m), and arm and force (K, 2)."""
    system = march.system
    felt, along = system.transfer[0], system.coupling[:, 0]
    points = [(arm, -float(felt @ state.force))]
    for _ in range(MAX_STEPS):
        before, arm = arm, arm + step
        state = march.solver.solve(system.pull + arm * along, state.displacement, state, system.pull + before * along)
        points.append((arm, -float(felt @ state.force)))
        # all slides, and the nodes have turned into the direction of sliding
        steady = abs(points[-1][1] - points[-2][1]) < STEADY * abs(points[-1][1])
        if steady and points[-1][1] * step > 0.0 and not np.any(state.state == STICK):
            return state, arm, np.array(points)
    raise NonConvergenceError("the contact sticks however far it is pushed; check friction and normal load")
