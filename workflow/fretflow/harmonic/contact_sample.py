"""One time sample of quasi-static frictional contact, solved by semi-smooth Newton.

The bodies are massless, so at each sample the relative displacement u, the contact force f and the arm's rigid motion
(q_x given, q_z free under the normal load) obey

    f = K (u - B_x q_x - B_z q_z),    sum f_z = N
    f_z >= 0,  gap + u_z >= 0,  f_z (gap + u_z) = 0
    stick: u_t = u_t(previous sample), |f_t| <= mu f_z
    slip:  f_t = -mu f_z (u_t - u_t(previous)) / |u_t - u_t(previous)|

The conditions are written with the projection of tau = f_t - rho (u_t - u_t(previous)) onto the friction disc
(Alart and Curnier 1991), for any rho > 0. Displacements are the unknowns, so that stuck and closed DOFs drop out:
a sticking contact has no unknown but q_z, and a sliding one 2 n + 1. Friction beyond ``mu f_z`` (see `coulomb`) has the
limit ``L = g l(f_z) (1 - d t_x)`` with t = tau / |tau| and g a factor of the instant.

Arrays are in component order: DOF ``c n + m`` is direction c of node m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from fretflow.contact.coulomb import CoulombLaw
from fretflow.core.errors import NonConvergenceError
from fretflow.harmonic.periodic import ContactState, PeriodicProblem

Array = NDArray[np.float64]
STICK, SLIP, OPEN = int(ContactState.STICK), int(ContactState.SLIP), int(ContactState.OPEN)
MAX_ITERATIONS = 40
MAX_HALVINGS = 8
STALE = 0.05  # a kept factor must contract the residual at least by this


@dataclass(frozen=True)
class ContactSystem:
    """The condensed contact: stiffness, nodes, friction and load. Arrays in component order.

    `stiffness` (3 n, 3 n) N/m; `gap` (n,) m; `load` N.
    """

    stiffness: Array
    gap: Array
    law: CoulombLaw
    load: float
    penalty: float  # rho in N/m

    @classmethod
    def build(cls, stiffness: Array, gap: Array, friction: Array, load: float) -> ContactSystem:
        """Build a contact with the friction coefficients `friction`, () or (n,)."""
        return cls._ordered(stiffness, gap, CoulombLaw(friction_coefficient=np.asarray(friction, dtype=float)), load)

    @classmethod
    def of(cls, problem: PeriodicProblem, stiffness: Array | None = None) -> ContactSystem:
        """Return the contact of `problem`; `stiffness` (3 n, 3 n) in node order is by default the joint's."""
        own = problem.joint.quasi_static().stiffness if stiffness is None else stiffness
        return cls._ordered(own, problem.interface.gap, problem.law, problem.normal_load)

    @classmethod
    def _ordered(cls, stiffness: Array, gap: Array, law: CoulombLaw, load: float) -> ContactSystem:
        """Reorder a stiffness given node by node (x, y, z per node) and choose rho.

        rho only steers the path to the solution; a tenth of the largest diagonal term was the most robust
        of the decades tried.
        """
        n = len(gap)
        order = np.arange(3 * n).reshape(n, 3).T.ravel()
        k = np.ascontiguousarray(stiffness[np.ix_(order, order)])
        return cls(stiffness=k, gap=np.asarray(gap, float), law=law, load=float(load),
                   penalty=0.1 * float(k.diagonal().max()))

    @property
    def friction(self) -> Array:
        """Return the friction coefficients (n,)."""
        return np.broadcast_to(self.law.friction_coefficient, self.size)

    @property
    def size(self) -> int:
        """Return the number of nodes."""
        return len(self.gap)

    def rigid_forces(self) -> tuple[Array, Array]:
        """Return ``K B_x`` and ``K B_z`` (3 n,) in N/m."""
        n = self.size
        return self.stiffness[:, :n].sum(axis=1), self.stiffness[:, 2 * n:].sum(axis=1)


@dataclass
class SampleState:
    """Contact at one sample: u, f (3 n,), arm q_z, state (n,)."""

    displacement: Array
    force: Array
    approach: float
    state: NDArray[np.int8]


class Instant(NamedTuple):
    """What a sample is under besides the arm's position: the normal load in N and the factor g on friction."""

    load: float
    grip: float = 1.0


@dataclass(frozen=True)
class SampleChange:
    """What p parameters change at a sample by themselves, all else held.

    `arm` (p,) m; `load` (p,) N; `friction` (n, p), of ``g mu``; `force` (3 n, p) N, the elastic contact force.
    """

    arm: Array
    load: Array
    friction: Array
    force: Array

    @classmethod
    def of_arm(cls, arm: Array, size: int) -> SampleChange:
        """Return motions of the arm alone; `size` n."""
        return cls(arm, np.zeros(len(arm)), np.zeros((size, len(arm))), np.zeros((3 * size, len(arm))))


@dataclass(frozen=True)
class SampleDerivative:
    """Derivative of a sample by p parameters.

    `displacement` (3 n, p), its z rows the opening gap + u_z; `approach` (p,); `pressing` (m, p), the normal
    force at the m slipping nodes.
    """

    displacement: Array
    approach: Array
    pressing: Array


class _Cone(NamedTuple):
    """The friction limit L at the nodes, for the direction t of the trial force.

    `direction` t (2, n); `limit` L (n,) N; `slope` dL/df_z (n,); `across`, x and y (n,): L t changes by
    ``-across w`` where tau turns by w across t.
    """

    direction: Array
    limit: Array
    slope: Array
    across: tuple[Array, Array]


class _Trial(NamedTuple):
    """The trial force tau: its direction t (2, n) and size (n,) N."""

    direction: Array
    size: Array


@dataclass
class _Sets:
    """Unknown DOFs of a contact state.

    `forces` (u + 1, 3 n) N/m: what the u unknowns and q_z do to the forces, one row each.
    """

    slip: NDArray[np.int64]
    opened: NDArray[np.int64]
    unknown: NDArray[np.int64]
    forces: Array
    key: bytes


class SampleSolver:
    """Solves samples one after another and keeps the last factor while it is good enough."""

    def __init__(self, system: ContactSystem) -> None:
        self.system = system
        self.tolerance = 1e-10 * system.load / system.size  # N, largest residual at a node
        self.kbx, self.kbz = system.rigid_forces()
        self._sets: _Sets | None = None
        self._factor: Any = None  # LU of the last Jacobian

    def solve(self, arm: float, previous: Array, guess: SampleState, arm_before: float,
              instant: Instant | None = None) -> SampleState:
        """Return the contact at arm position `arm` (m) after a sample with displacement `previous` (3 n,).

        `instant` is by default that of the system's load and friction coefficients.

        If Newton fails, the arm is moved there from `arm_before` in ever smaller parts, the sample's own
        history unchanged: each part starts from the solution of the one before.

        Raises
        ------
        NonConvergenceError
            If even 2^-8 of the step fails.
        """
        at = Instant(self.system.load) if instant is None else instant
        found = self._newton(arm, previous, guess, at)
        halvings = 1
        while found is None and halvings <= MAX_HALVINGS:
            found = self._approach(np.linspace(arm_before, arm, 2**halvings + 1)[1:], previous, guess, at)
            halvings += 1
        if found is None:
            raise NonConvergenceError(
                f"contact at one time sample did not converge (arm at {arm:.6e} m); use more samples per period")
        return found

    def _approach(self, arms: NDArray[np.floating[Any]], previous: Array, guess: SampleState, at: Instant
                  ) -> SampleState | None:
        resting = np.where(guess.state == SLIP, STICK, guess.state).astype(np.int8)
        state: SampleState | None = SampleState(previous.copy(), guess.force, guess.approach, resting)
        for arm in arms:
            if state is not None:
                state = self._newton(float(arm), previous, state, at)
        return state

    def _newton(self, arm: float, previous: Array, guess: SampleState, at: Instant) -> SampleState | None:
        u, approach, state = guess.displacement.copy(), guess.approach, guess.state
        sets, last = self._select(state), np.inf
        for iteration in range(MAX_ITERATIONS):
            f, trial = self._hold(u, previous, state, arm, approach)
            settled = False
            if iteration:
                new = self._project(u, f, trial, at.grip)
                settled = np.array_equal(new, state)
                if not settled:
                    state, last = new, np.inf
                    sets = self._select(state)
                    f, trial = self._hold(u, previous, state, arm, approach)
            cone = self._cone(f, trial, at.grip)
            residual = self._residual(f, cone, sets, at.load)
            error = float(np.abs(residual).max())
            if not np.isfinite(error):
                return None
            if error < self.tolerance and (
                    settled or np.array_equal(self._project(u, f, trial, at.grip), state)):
                return SampleState(u, f, approach, state)
            if self._factor is None or error > STALE * last:
                self._factor = lu_factor(self._jacobian(cone, sets), check_finite=False, overwrite_a=True)
            last = error
            step = lu_solve(self._factor, -residual, check_finite=False)
            u[sets.unknown] += step[:-1]
            approach += step[-1]
        return None

    def tangent(self, sample: SampleState, previous: Array, history: Array, arm_direction: Array,
                instant: Instant | None = None, load: Array | None = None, grip: Array | None = None
                ) -> tuple[Array, Array]:
        """Differentiate a converged sample by motions of the arm.

        Parameters
        ----------
        sample, previous
            The sample and the displacement before it.
        history : (3 n, p)
            Derivative of `previous`.
        arm_direction, load, grip : (p,)
            Derivatives of the arm position and of what `instant` holds, by default none.

        Returns
        -------
        (3 n, p), (p,)
            Derivatives of the displacement and of the x force on the upper face's nodes together.
        """
        if not len(arm_direction):
            return history, arm_direction
        n, change = self.system.size, SampleChange.of_arm(arm_direction, self.system.size)
        if load is not None and grip is not None:
            change = SampleChange(arm_direction, load, np.outer(self.system.friction, grip), change.force)
        found = self.differentiate(sample, previous, history, change, instant)
        force = self.kbx @ found.displacement - self.kbx[:n].sum() * arm_direction - self.kbz[:n].sum() * found.approach
        return found.displacement, force

    def differentiate(self, sample: SampleState, previous: Array, history: Array, change: SampleChange,
                      instant: Instant | None = None) -> SampleDerivative:
        """Differentiate a converged sample by p parameters; history (3 n, p) is the derivative of `previous`."""
        n, k = self.system.size, self.system.stiffness
        sets = self._select(sample.state)
        grip = 1.0 if instant is None else instant.grip
        cone = self._cone(sample.force, self._trial(sample.displacement, sample.force, previous), grip)
        self._factor = lu_factor(self._jacobian(cone, sets), check_finite=False, overwrite_a=True)
        stuck = np.flatnonzero(sample.state == STICK)
        held = np.concatenate([stuck, n + stuck])
        moved = np.zeros_like(history)
        moved[held] = history[held]
        rows = np.concatenate([sets.slip, n + sets.slip, 2 * n + sets.slip, sets.opened, n + sets.opened,
                               2 * n + sets.opened])
        df = k[np.ix_(rows, held)] @ history[held] - np.outer(self.kbx[rows], change.arm) + change.force[rows]
        m = len(sets.slip)
        rhs = np.empty((len(sets.unknown) + 1, history.shape[1]))
        slip_history = np.stack([history[sets.slip], history[n + sets.slip]])
        rhs[:2 * m] = self._slip_rows(df[:m], df[m:2 * m], df[2 * m:3 * m], cone, sets, -slip_history)
        wider = self.gripping(sample.force, cone.direction)[sets.slip, None] * change.friction[sets.slip]
        rhs[:m] -= cone.direction[0, sets.slip, None] * wider
        rhs[m:2 * m] -= cone.direction[1, sets.slip, None] * wider
        rhs[2 * m:-1] = df[3 * m:]
        rhs[-1] = (self.kbz[held] @ history[held] - self.kbx[2 * n:].sum() * change.arm
                   + change.force[2 * n:].sum(axis=0) - change.load)
        step = lu_solve(self._factor, -rhs, check_finite=False)
        moved[sets.unknown] = step[:-1]
        return SampleDerivative(moved, step[-1], df[2 * m:3 * m] + sets.forces[:, 2 * n + sets.slip].T @ step)

    def gripping(self, force: Array, direction: Array) -> Array:
        """Return the friction limit over ``g mu``, (n,) N, for forces (3 n,) and friction directions (2, n)."""
        law, n = self.system.law, self.system.size
        grips = law.gripping_force(np.maximum(force[2 * n:], 0.0))
        return grips if law.asymmetry == 0.0 else grips * (1.0 - law.asymmetry * direction[0])

    def _select(self, state: NDArray[np.int8]) -> _Sets:
        key = state.tobytes()
        if self._sets is not None and self._sets.key == key:
            return self._sets
        n, k = self.system.size, self.system.stiffness
        slip, opened = np.flatnonzero(state == SLIP), np.flatnonzero(state == OPEN)
        unknown = np.concatenate([slip, n + slip, opened, n + opened, 2 * n + opened])
        forces = np.empty((len(unknown) + 1, 3 * n))
        np.take(k, unknown, axis=0, out=forces[:-1], mode="clip")  # symmetric: rows are columns, and contiguous
        forces[-1] = -self.kbz
        self._sets, self._factor = _Sets(slip, opened, unknown, forces, key), None
        return self._sets

    def _hold(self, u: Array, previous: Array, state: NDArray[np.int8], arm: float, approach: float
              ) -> tuple[Array, _Trial]:
        """Put the known DOFs where their state wants them, closed at the gap and stuck where they were.

        Return the forces (3 n,) then and the trial force.
        """
        n, s = self.system.size, self.system
        np.copyto(u[2 * n:], -s.gap, where=state != OPEN)
        np.copyto(u[:2 * n].reshape(2, n), previous[:2 * n].reshape(2, n), where=state == STICK)
        f: Array = s.stiffness @ u - arm * self.kbx - approach * self.kbz
        return f, self._trial(u, f, previous)

    def _trial(self, u: Array, f: Array, previous: Array) -> _Trial:
        n, rho = self.system.size, self.system.penalty
        tau = (f[:2 * n] - rho * (u[:2 * n] - previous[:2 * n])).reshape(2, n)
        size = np.maximum(np.hypot(tau[0], tau[1]), 1e-300)
        return _Trial(tau / size, size)

    def _project(self, u: Array, f: Array, trial: _Trial, grip: float) -> NDArray[np.int8]:
        n, s = self.system.size, self.system
        pressing = f[2 * n:] - s.penalty * (s.gap + u[2 * n:])
        limit = grip * s.law.slip_limit(np.maximum(pressing, 0.0))
        if s.law.asymmetry:
            limit *= 1.0 - s.law.asymmetry * trial.direction[0]
        state = np.where(trial.size > limit * (1.0 + 1e-12), np.int8(SLIP), np.int8(STICK))
        state[pressing <= 0.0] = OPEN
        return state

    def _cone(self, f: Array, trial: _Trial, grip: float) -> _Cone:
        law, (x, y) = self.system.law, trial.direction
        normal = np.maximum(f[2 * self.system.size:], 0.0)
        limit, slope = grip * law.slip_limit(normal), grip * law.slip_limit_slope(normal)
        turned = limit / trial.size
        if law.asymmetry == 0.0:
            return _Cone(trial.direction, limit, slope, (turned * y, -turned * x))
        turning = law.asymmetry * turned * y
        share = 1.0 - law.asymmetry * x
        return _Cone(trial.direction, share * limit, share * slope,
                     (share * turned * y - x * turning, -share * turned * x - y * turning))

    def _residual(self, f: Array, cone: _Cone, sets: _Sets, load: float) -> Array:
        n, i, o = self.system.size, sets.slip, sets.opened
        limit, d = cone.limit[i], cone.direction[:, i]
        return np.concatenate([f[i] - limit * d[0], f[n + i] - limit * d[1], f[o], f[n + o], f[2 * n + o],
                               [f[2 * n:].sum() - load]])

    def _slip_rows(self, fx: Array, fy: Array, fz: Array, cone: _Cone, sets: _Sets, slid: Array) -> Array:
        """Differentiate ``f_t - L t`` at the slipping nodes for changes of force and slid distance.

        fx, fy, fz (m, p) N; slid (2, m, p) m.
        """
        i, rho = sets.slip, self.system.penalty
        (x, y), (a, b), slope = cone.direction[:, i], (cone.across[0][i], cone.across[1][i]), cone.slope[i]
        turned = x[:, None] * (fy - rho * slid[1]) - y[:, None] * (fx - rho * slid[0])
        return np.concatenate([fx - (slope * x)[:, None] * fz + a[:, None] * turned,
                               fy - (slope * y)[:, None] * fz + b[:, None] * turned])

    def _jacobian(self, cone: _Cone, sets: _Sets) -> Array:
        """Return the derivative of the residual by the unknowns, in Fortran's order as its factorisation wants it."""
        n, i, o = self.system.size, sets.slip, sets.opened
        m, g, rho, k = len(i), sets.forces, self.system.penalty, np.arange(len(i))
        (x, y), (a, b), slope = cone.direction[:, i], (cone.across[0][i], cone.across[1][i]), cone.slope[i]
        fx, fy, fz = (g.take(c * n + i, axis=1) for c in range(3))
        transposed = np.empty((len(g), len(g)))  # a row for each unknown
        along, across = transposed[:, :m], transposed[:, m:2 * m]
        np.multiply(fx, 1.0 - a * y, out=along)
        along += fy * (a * x) - fz * (slope * x)
        np.multiply(fy, 1.0 + b * x, out=across)
        across -= fx * (b * y) + fz * (slope * y)
        along[k, k] += rho * a * y
        along[m + k, k] -= rho * a * x
        across[k, k] += rho * b * y
        across[m + k, k] -= rho * b * x
        transposed[:, 2 * m:-1] = g.take(np.concatenate([o, n + o, 2 * n + o]), axis=1)
        transposed[:-1, -1] = self.kbz[sets.unknown]
        transposed[-1, -1] = -self.kbz[2 * n:].sum()
        return transposed.T
