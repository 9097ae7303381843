"""The rig seen from the arm: the block eliminated, on real Fourier coefficients.

With block b and arm a, further forces F on both, and the friction force Phi on the arm::

    Z_bb b + Z_ba a = g_b + F_b(b, a),    Z_ab b + Z_aa a = g_a + F_a(b, a) + Phi

the block follows the arm, harmonic by harmonic where F = 0, else by Newton with F sampled in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.fourier import analysis_matrix, derivative_matrix, synthesis_matrix, to_complex, to_real
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.sample import Array
from fretflow.structure.two_mass_rig.forces import ForceAndSlopes, RigForce
from fretflow.structure.two_mass_rig.lumped import LumpedRig

MAX_ITERATIONS = 40
TOLERANCE = 1e-13  # of the block's equation, relative to its forces
SMALLEST_STEP = 1e-3


@dataclass(frozen=True)
class RigBalance:
    """The rig at a motion of the arm, friction left out; all on real coefficients.

    `residual` (2 H + 1,) N, of the arm, and its `jacobian` by the arm's motion; `block` (2 H + 1,) m; with the block
    eliminated it moves by ``block_by_arm da + block_by_load dg_b``, and dg_b acts on the arm as ``carried dg_b``.
    `imbalance` (2 H + 1,) N is what is left of the block's own equation; None where the block follows the arm.
    """

    residual: Array
    jacobian: Array
    block: Array
    block_by_arm: Array
    block_by_load: Array
    carried: Array
    imbalance: Array | None = None

    @property
    def reduced(self) -> Array:
        """Return the arm's residual (2 H + 1,) N once the block has moved to its balance, to first order."""
        return self.residual if self.imbalance is None else self.residual + self.carried @ self.imbalance

    def block_step(self, step: Array) -> Array:
        """Return how the block moves (2 H + 1,) m with a step of the arm, and to its balance, to first order."""
        moved: Array = self.block_by_arm @ step
        return moved if self.imbalance is None else moved - self.block_by_load @ self.imbalance

    @property
    def size(self) -> float:
        """Return the norm of what is left of the block's equation, N."""
        return 0.0 if self.imbalance is None else float(np.linalg.norm(self.imbalance))


@dataclass(frozen=True)
class ArmEquations:
    """The rig seen from the arm, on real coefficients of order [a0, c1, s1, ...].

    `impedance` and `load` are those without further forces.
    """

    impedance: Array  # (2 H + 1, 2 H + 1) N/m
    load: Array  # (2 H + 1,) N
    synthesis: Array  # (N, 2 H + 1)
    analysis: Array  # (2 H + 1, N)
    block: tuple[NDArray[np.complex128], NDArray[np.complex128]]  # x_block = b[0] x_arm + b[1], (H + 1,)
    rig_impedance: NDArray[np.complex128]  # (H + 1, 2, 2) N/m, of block and arm
    omega: float
    forces: tuple[RigForce, ...] = ()

    @classmethod
    def build(cls, rig: LumpedRig, omega: float, excitation: float, harmonics: int, samples: int,
              overtones: Sequence[tuple[int, complex]] = (), forces: tuple[RigForce, ...] = ()) -> ArmEquations:
        """Eliminate the block at every harmonic; `overtones` are further harmonics (k, F_k) of the drive, in N."""
        z = rig.impedance(omega * np.arange(harmonics + 1))
        force = np.zeros(harmonics + 1, dtype=complex)
        force[1] = excitation
        for order, amplitude in overtones:
            if order <= harmonics:
                force[order] += amplitude
        carried = -z[:, 0, 1] / z[:, 0, 0]
        arm = z[:, 1, 1] + z[:, 1, 0] * carried
        load = to_real(carried * force)
        return cls(real_blocks(arm), load, synthesis_matrix(harmonics, samples), analysis_matrix(harmonics, samples),
                   (carried, force / z[:, 0, 0]), z, omega, forces)

    @classmethod
    def of(cls, problem: PeriodicProblem, harmonics: int, samples: int) -> ArmEquations:
        """Return the rig of `problem`."""
        return cls.build(problem.joint.quasi_static().rig, problem.omega, problem.excitation, harmonics, samples,
                         problem.overtones, problem.rig_forces)

    def block_motion(self, arm: Array) -> Array:
        """Return the block's motion (N,) in m for the arm's coefficients, without further forces."""
        moved: Array = self.synthesis @ self._free_block(arm)
        return moved

    def balance(self, arm: Array, block: Array | None = None) -> RigBalance:
        """Return the rig at the arm's coefficients (2 H + 1,); `block` is a guess of the block's.

        Raises
        ------
        NonConvergenceError
            If the block's motion under the further forces is not found.
        """
        if not self.forces:
            return RigBalance(self.impedance @ arm - self.load, self.impedance, self._free_block(arm),
                              *self._linear_transfer)
        found, at = self._follow(arm, self._free_block(arm) if block is None else block, self._block_load)
        return self._linearised(arm, found, at)

    def beside_balance(self, arm: Array, block: Array) -> RigBalance:
        """Return the rig at the coefficients (2 H + 1,) of arm and block, whether or not the block is in balance."""
        if not self.forces:
            return self.balance(arm)
        at, z = self._forces(block, arm), self._blocks
        left = z[0, 0] @ block + z[0, 1] @ arm - self._block_load - self.analysis @ at.force[:, 0]
        return replace(self._linearised(arm, block, at), imbalance=left)

    def _linearised(self, arm: Array, block: Array, at: ForceAndSlopes) -> RigBalance:
        z = self._blocks
        jacobian = z - self._slopes(at)
        by_load = np.linalg.inv(jacobian[0, 0])
        by_arm, carried = -by_load @ jacobian[0, 1], -jacobian[1, 0] @ by_load
        residual = z[1, 0] @ block + z[1, 1] @ arm - self.analysis @ at.force[:, 1]
        return RigBalance(residual, jacobian[1, 1] + jacobian[1, 0] @ by_arm, block, by_arm, by_load, carried)

    def _follow(self, arm: Array, block: Array, load: Array) -> tuple[Array, ForceAndSlopes]:
        """Find the block's coefficients by Newton with halved steps."""
        z = self._blocks
        given = load - z[0, 1] @ arm
        scale = float(np.linalg.norm(given)) + float(np.linalg.norm(z[0, 0] @ block)) or 1.0

        def evaluate(b: Array) -> tuple[Array, ForceAndSlopes, float]:
            at = self._forces(b, arm)
            r = z[0, 0] @ b - given - self.analysis @ at.force[:, 0]
            return r, at, float(np.linalg.norm(r)) / scale

        residual, at, norm = evaluate(block)
        history = [norm]
        while not norm <= TOLERANCE:
            step = np.linalg.solve(z[0, 0] - self._slopes(at)[0, 0], -residual)
            length, last = 1.0, norm
            while length > SMALLEST_STEP:
                residual, at, norm = evaluate(block + length * step)
                if norm < (1.0 - 1e-3 * length) * last:
                    break
                length *= 0.5
            else:
                if last < 1e3 * TOLERANCE:  # round-off
                    return block, self._forces(block, arm)
                raise NonConvergenceError("the block's motion under the further forces of the rig did not converge",
                                          history)
            block = block + length * step
            history.append(norm)
            if len(history) > MAX_ITERATIONS:
                raise NonConvergenceError("the block's motion under the further forces of the rig did not converge",
                                          history)
        return block, at

    def _forces(self, block: Array, arm: Array) -> ForceAndSlopes:
        both = np.column_stack([block, arm])
        x, v = self.synthesis @ both, self._rates @ both
        parts = [force(x, v) for force in self.forces]
        return ForceAndSlopes(*(np.sum(group, axis=0) for group in zip(*parts, strict=True)))

    def _slopes(self, at: ForceAndSlopes) -> Array:
        """Return the derivatives (2, 2, 2 H + 1, 2 H + 1) of the forces' coefficients: force, then motion."""
        q = len(self.load)
        slopes = np.empty((2, 2, q, q))
        for i in range(2):
            for j in range(2):
                slopes[i, j] = self.analysis @ (at.by_displacement[:, i, j, None] * self.synthesis
                                                + at.by_velocity[:, i, j, None] * self._rates)
        return slopes

    def _free_block(self, arm: Array) -> Array:
        return to_real(self.block[0] * to_complex(arm) + self.block[1])

    @cached_property
    def _block_load(self) -> Array:
        load: Array = self._blocks[0, 0] @ to_real(self.block[1])
        return load

    @cached_property
    def _rates(self) -> Array:
        rates: Array = self.synthesis @ derivative_matrix(len(self.load) // 2, self.omega)
        return rates

    @cached_property
    def _blocks(self) -> Array:
        """Return the rig's impedance as (2, 2, 2 H + 1, 2 H + 1)."""
        return np.array([[real_blocks(self.rig_impedance[:, i, j]) for j in range(2)] for i in range(2)])

    @cached_property
    def _linear_transfer(self) -> tuple[Array, Array, Array]:
        carried = real_blocks(self.block[0])
        return carried, real_blocks(1.0 / self.rig_impedance[:, 0, 0]), carried


def real_blocks(impedance: NDArray[np.complex128]) -> Array:
    """Return complex impedances (H + 1,) as a matrix on real coefficients: (a + i b)(c - i s)."""
    matrix = np.zeros((2 * len(impedance) - 1,) * 2)
    cosine = np.arange(1, len(matrix), 2)
    matrix[0, 0] = impedance[0].real
    matrix[cosine, cosine] = matrix[cosine + 1, cosine + 1] = impedance[1:].real
    matrix[cosine, cosine + 1], matrix[cosine + 1, cosine] = impedance[1:].imag, -impedance[1:].imag
    return matrix
