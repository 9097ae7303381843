"""The internal coordinates seen from the contact, on real Fourier coefficients.

Coordinates a that feel the contact or move it are the unknowns; all others, b, carry neither contact nor coupling. With
further forces F on both, and the contact's force Phi on a,

    Z_bb b + Z_ba a = g_b + F_b(b, a),    Z_ab b + Z_aa a = g_a + F_a(b, a) + Phi

b follows a, harmonic by harmonic where F = 0, else by Newton with F sampled in time, finer than the contact.
Coefficients of several coordinates stand harmonic after harmonic, ``(2 H + 1) d`` in all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.fourier import analysis_matrix, derivative_matrix, synthesis_matrix, to_complex, to_real
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.sample import Array
from fretflow.structure.internal_forces import FINER, ForceAndSlopes, InternalForce, total_force
from fretflow.structure.structure import Internal, MasslessBoundary

MAX_ITERATIONS = 40
TOLERANCE = 1e-13  # of the equation of b, relative to its forces
SMALLEST_STEP = 1e-3
Indices = NDArray[np.intp]


class Linearisation(NamedTuple):
    """The derivative of a's residual by a with b eliminated, (n_a, n_a) N/m; all on real coefficients.

    b moves by ``other_by_seen da + other_by_load dg_b``, and dg_b acts on a as ``carried dg_b``.
    """

    jacobian: Array
    other_by_seen: Array
    other_by_load: Array
    carried: Array


@dataclass(frozen=True)
class InternalBalance:
    """The structure at a motion of a, the contact's force left out; all on real coefficients.

    `residual` (n_a,) N is that of a, `other` (n_b,) m is b, and `imbalance` (n_b,) N what is left of the equation of b;
    None where b follows a. Of several motions that are tried one is linearised, which takes longer than the rest.
    """

    residual: Array
    other: Array
    linearise: Callable[[], Linearisation]
    imbalance: Array | None = None

    @cached_property
    def linear(self) -> Linearisation:
        """Return the derivatives there."""
        return self.linearise()

    @property
    def reduced(self) -> Array:
        """Return the residual (n_a,) N once b has moved to its balance, to first order."""
        return self.residual if self.imbalance is None else self.residual + self.linear.carried @ self.imbalance

    def other_step(self, step: Array) -> Array:
        """Return how b moves (n_b,) m with a step of a, and to its balance, to first order."""
        moved: Array = self.linear.other_by_seen @ step
        return moved if self.imbalance is None else moved - self.linear.other_by_load @ self.imbalance

    @property
    def size(self) -> float:
        """Return the norm of what is left of the equation of b, N."""
        return 0.0 if self.imbalance is None else float(np.linalg.norm(self.imbalance))


class _ForceGrid(NamedTuple):
    """Matrices between coefficients and the samples M of further forces: (M, q), (q, M), and rates (M, q) in 1/s."""

    synthesis: Array
    analysis: Array
    rates: Array


@dataclass(frozen=True)
class InternalEquations:
    """The structure seen from a, on coefficients [a0, c1, s1, ...]; `impedance`, `load` without further forces."""

    impedance: Array  # (n_a, n_a) N/m
    load: Array  # (n_a,) N
    synthesis: Array  # (N, 2 H + 1)
    analysis: Array  # (2 H + 1, N)
    seen: Indices  # of the coordinates a
    other: Indices  # of b
    following: tuple[NDArray[np.complex128], NDArray[np.complex128]]  # b = f[0] a + f[1], harmonic by harmonic
    whole_impedance: NDArray[np.complex128]  # (H + 1, d, d) N/m
    internal: Internal
    omega: float
    scale: float  # norm of the vibrating load on all coordinates, N
    forces: tuple[InternalForce, ...] = ()

    @classmethod
    def build(cls, internal: Internal, seen: Indices, omega: float, loads: NDArray[np.complex128], samples: int,
              forces: tuple[InternalForce, ...] = ()) -> InternalEquations:
        """Eliminate b at every harmonic; `loads` (H + 1, d) in N on all coordinates."""
        harmonics = len(loads) - 1
        z = internal.impedance(omega * np.arange(harmonics + 1))
        other = np.setdiff1d(np.arange(z.shape[1]), seen)
        zbb, zba, zab = z[:, other[:, None], other], z[:, other[:, None], seen], z[:, seen[:, None], other]
        carried, free = -np.linalg.solve(zbb, zba), np.linalg.solve(zbb, loads[:, other, None])
        load = loads[:, seen] - (zab @ free)[:, :, 0]
        scale = next((size for part in (loads[1], loads[1:], loads) if (size := float(np.linalg.norm(part)))), 1.0)
        return cls(real_blocks(z[:, seen[:, None], seen] + zab @ carried), to_real(load).ravel(),
                   synthesis_matrix(harmonics, samples), analysis_matrix(harmonics, samples), seen, other,
                   (carried, free[:, :, 0]), z, internal, omega, scale, forces)

    @classmethod
    def of(cls, problem: PeriodicProblem, harmonics: int, samples: int) -> InternalEquations:
        """Return those of the structure of `problem`."""
        b = problem.boundary
        return cls.build(b.internal, seen_coordinates(b), problem.omega, problem.loads(harmonics) @ b.input_force.T,
                         samples, b.forces)

    def motion(self, seen: Array) -> Array:
        """Return a (N, d_a) in m of coefficients (n_a,)."""
        return np.asarray(self.synthesis @ seen.reshape(len(self.synthesis.T), -1))

    def directions(self) -> Array:
        """Return the derivative (N, d_a, n_a) of a by its coefficients."""
        d = len(self.seen)
        samples, q = self.synthesis.shape
        return np.asarray(np.einsum("jh,ab->jahb", self.synthesis, np.eye(d)).reshape(samples, d, q * d))

    def coefficients(self, values: Array) -> Array:
        """Return coefficients of samples (N, d), ((2 H + 1) d,), or of their derivatives (N, d, p), (.., p)."""
        coefficients = np.tensordot(self.analysis, values, axes=1)
        return np.asarray(coefficients.reshape(-1, *values.shape[2:]))

    def rates(self) -> tuple[Array, Array]:
        """Return the derivatives by omega of `impedance`, N s/m, and of `load`, N s, further forces left out.

        With b eliminated, ``Z_a = V^T z V`` for ``V = (-z_bb^-1 z_ba, 1)``, at which it is stationary where z is
        symmetric, so that ``dZ_a = V^T dz V``; the load on b counts by ``-V^T dz (z_bb^-1 g_b, 0)``.
        """
        k = np.arange(len(self.analysis) // 2 + 1)[:, None, None]
        slope = k * (-2.0 * self.omega * k * self.internal.mass + 1j * self.internal.damping)
        to = np.zeros((len(k), slope.shape[1], len(self.seen)), dtype=complex)
        free = np.zeros((len(k), slope.shape[1], 1), dtype=complex)
        to[:, self.other], to[:, self.seen] = self.following[0], np.eye(len(self.seen))
        free[:, self.other, 0] = self.following[1]
        by_omega = to.transpose(0, 2, 1) @ slope
        return real_blocks(by_omega @ to), to_real(-(by_omega @ free)[:, :, 0]).ravel()

    def whole_motion(self, seen: Array, other: Array) -> Array:
        """Return all coordinates (N, d) in m of the coefficients of a and b."""
        whole = np.empty((len(self.synthesis), len(self.seen) + len(self.other)))
        whole[:, self.seen], whole[:, self.other] = self.motion(seen), self._other_motion(other)
        return whole

    def free_other(self, seen: Array) -> Array:
        """Return the coefficients of b that follow those of a, without further forces."""
        amplitudes = to_complex(seen.reshape(len(self.synthesis.T), -1))
        return to_real((self.following[0] @ amplitudes[:, :, None])[:, :, 0] + self.following[1]).ravel()

    def balance(self, seen: Array, other: Array | None = None) -> InternalBalance:
        """Return the structure at coefficients of a (n_a,); `other` is a guess of b's.

        Raises
        ------
        NonConvergenceError
            If the motion of b under the further forces is not found.
        """
        if not self.forces:
            return InternalBalance(self.impedance @ seen - self.load, self.free_other(seen), lambda: self._linear)
        motion, at = self._follow(seen, self.free_other(seen) if other is None else other)
        return self._balanced(seen, motion, at)

    def beside_balance(self, seen: Array, other: Array) -> InternalBalance:
        """Return the structure at coefficients of a and b, whether or not b is in balance."""
        if not self.forces:
            return self.balance(seen)
        at, z = self._forces(other, seen), self._blocks
        left = z["bb"] @ other + z["ba"] @ seen - self._other_load - self._felt(at, self.other)
        return replace(self._balanced(seen, other, at), imbalance=left)

    def _balanced(self, seen: Array, other: Array, at: ForceAndSlopes) -> InternalBalance:
        residual = (self._blocks["ab"] @ other + self._blocks["aa"] @ seen - self._seen_load
                    - self._felt(at, self.seen))
        return InternalBalance(residual, other, lambda: self._linearised(at))

    def _linearised(self, at: ForceAndSlopes) -> Linearisation:
        jacobian = {name: block - self._slopes(at, name) for name, block in self._blocks.items()}
        by_load = np.linalg.inv(jacobian["bb"])
        by_seen, carried = -by_load @ jacobian["ba"], -jacobian["ab"] @ by_load
        return Linearisation(jacobian["aa"] + jacobian["ab"] @ by_seen, by_seen, by_load, carried)

    def _follow(self, seen: Array, other: Array) -> tuple[Array, ForceAndSlopes]:
        """Find the coefficients of b by Newton with halved steps."""
        z = self._blocks
        given = self._other_load - z["ba"] @ seen
        scale = float(np.linalg.norm(given)) + float(np.linalg.norm(z["bb"] @ other)) or 1.0

        def evaluate(b: Array) -> tuple[Array, ForceAndSlopes, float]:
            at = self._forces(b, seen)
            r = z["bb"] @ b - given - self._felt(at, self.other)
            return r, at, float(np.linalg.norm(r)) / scale

        residual, at, norm = evaluate(other)
        history = [norm]
        while not norm <= TOLERANCE:
            step = np.linalg.solve(z["bb"] - self._slopes(at, "bb"), -residual)
            length, last = 1.0, norm
            while length > SMALLEST_STEP:
                residual, at, norm = evaluate(other + length * step)
                if norm < (1.0 - 1e-3 * length) * last:
                    break
                length *= 0.5
            if length <= SMALLEST_STEP or len(history) >= MAX_ITERATIONS:
                if last < 1e3 * TOLERANCE:  # round-off
                    return other, self._forces(other, seen)
                raise NonConvergenceError("the internal motion under the structure's further forces did not converge",
                                          history)
            other = other + length * step
            history.append(norm)
        return other, at

    def _forces(self, other: Array, seen: Array) -> ForceAndSlopes:
        grid, q = self._force_grid, len(self._derivative)
        whole = np.empty((q, len(self.seen) + len(self.other)))
        whole[:, self.seen], whole[:, self.other] = seen.reshape(q, -1), other.reshape(q, -1)
        return total_force(self.forces, grid.synthesis @ whole, grid.rates @ whole)

    def _felt(self, at: ForceAndSlopes, part: Indices) -> Array:
        """Return the coefficients of the further forces on a or on b."""
        return np.asarray((self._force_grid.analysis @ at.force[:, part]).ravel())

    def _slopes(self, at: ForceAndSlopes, name: str) -> Array:
        """Return the derivative of a block's force coefficients by its motion's: "ab" is that of a's by b's."""
        rows, columns = ({"a": self.seen, "b": self.other}[letter] for letter in name)
        grid = self._force_grid
        by_motion = sum(slope[:, rows[:, None], columns][..., None] * basis[:, None, None]
                        for slope, basis in ((at.by_displacement, grid.synthesis), (at.by_velocity, grid.rates)))
        q, samples = grid.analysis.shape
        coefficients = (grid.analysis @ np.reshape(by_motion, (samples, -1))).reshape(q, len(rows), len(columns), q)
        return np.asarray(coefficients.swapaxes(2, 3).reshape(q * len(rows), q * len(columns)))

    def _other_motion(self, other: Array) -> Array:
        return np.asarray(self.synthesis @ other.reshape(len(self.synthesis.T), -1))

    @cached_property
    def _other_load(self) -> Array:
        load: Array = self._blocks["bb"] @ to_real(self.following[1]).ravel()
        return load

    @cached_property
    def _seen_load(self) -> Array:
        """Return the load on a itself: what is left of that with b eliminated."""
        load: Array = self.load + self._blocks["ab"] @ to_real(self.following[1]).ravel()
        return load

    @cached_property
    def _force_grid(self) -> _ForceGrid:
        harmonics, samples = len(self.analysis) // 2, FINER * len(self.synthesis)
        synthesis = synthesis_matrix(harmonics, samples)
        return _ForceGrid(synthesis, analysis_matrix(harmonics, samples), synthesis @ self._derivative)

    @cached_property
    def _derivative(self) -> Array:
        return derivative_matrix(len(self.analysis) // 2, self.omega)

    @cached_property
    def _blocks(self) -> dict[str, Array]:
        """Return the impedance of a and b on each other."""
        place = {"a": self.seen, "b": self.other}
        return {r + c: real_blocks(self.whole_impedance[:, place[r][:, None], place[c]]) for r in "ab" for c in "ab"}

    @cached_property
    def _linear(self) -> Linearisation:
        """Return the derivatives without further forces."""
        zbb = self.whole_impedance[:, self.other[:, None], self.other]
        by_load = np.linalg.inv(zbb)
        carried = -self.whole_impedance[:, self.seen[:, None], self.other] @ by_load
        return Linearisation(self.impedance, real_blocks(self.following[0]), real_blocks(by_load), real_blocks(carried))


def seen_coordinates(boundary: MasslessBoundary) -> Indices:
    """Return the coordinates that move the contact, feel it, or couple to friction and normal load."""
    couples = np.any(boundary.coupling != 0.0, axis=0) | np.any(boundary.transfer != 0.0, axis=1)
    return np.flatnonzero(couples | (boundary.sliding != 0.0))


def real_blocks(impedance: NDArray[np.complex128]) -> Array:
    """Return complex impedances (H + 1, r, c), or (H + 1,), as a matrix on real coefficients: (a + i b)(c - i s)."""
    z = impedance.reshape(len(impedance), *(impedance.shape[1:] or (1, 1)))
    q = 2 * len(z) - 1
    matrix = np.zeros((q, z.shape[1], q, z.shape[2]))
    cosine = np.arange(1, q, 2)
    matrix[0, :, 0] = z[0].real
    matrix[cosine, :, cosine] = matrix[cosine + 1, :, cosine + 1] = z[1:].real
    matrix[cosine, :, cosine + 1], matrix[cosine + 1, :, cosine] = z[1:].imag, -z[1:].imag
    return matrix.reshape(q * z.shape[1], q * z.shape[2])
