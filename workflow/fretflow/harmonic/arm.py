"""The rig seen from the arm: the block eliminated at every harmonic, on real Fourier coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.harmonic.contact_sample import Array
from fretflow.harmonic.fourier import analysis_matrix, synthesis_matrix, to_complex, to_real
from fretflow.rig.lumped import LumpedRig


@dataclass(frozen=True)
class ArmEquations:
    """The rig seen from the arm, on real coefficients of order [a0, c1, s1, ...]."""

    impedance: Array  # (2 H + 1, 2 H + 1) N/m
    load: Array  # (2 H + 1,) N
    synthesis: Array  # (N, 2 H + 1)
    analysis: Array  # (2 H + 1, N)
    block: tuple[NDArray[np.complex128], NDArray[np.complex128]]  # x_block = b[0] x_arm + b[1], (H + 1,)

    @classmethod
    def build(cls, rig: LumpedRig, omega: float, excitation: float, harmonics: int, samples: int) -> ArmEquations:
        """Eliminate the block at every harmonic."""
        z = rig.impedance(omega * np.arange(harmonics + 1))
        force = np.zeros(harmonics + 1, dtype=complex)
        force[1] = excitation
        carried = -z[:, 0, 1] / z[:, 0, 0]
        arm = z[:, 1, 1] + z[:, 1, 0] * carried
        load = to_real(carried * force)
        return cls(real_blocks(arm), load, synthesis_matrix(harmonics, samples),
                   analysis_matrix(harmonics, samples), (carried, force / z[:, 0, 0]))

    def block_motion(self, arm: Array) -> Array:
        """Return the block's motion (N,) in m for the arm's coefficients."""
        amplitudes = self.block[0] * to_complex(arm) + self.block[1]
        return self.synthesis @ to_real(amplitudes)


def real_blocks(impedance: NDArray[np.complex128]) -> Array:
    """Return complex impedances (H + 1,) as a matrix on real coefficients: (a + i b)(c - i s)."""
    matrix = np.zeros((2 * len(impedance) - 1,) * 2)
    cosine = np.arange(1, len(matrix), 2)
    matrix[0, 0] = impedance[0].real
    matrix[cosine, cosine] = matrix[cosine + 1, cosine + 1] = impedance[1:].real
    matrix[cosine, cosine + 1], matrix[cosine + 1, cosine] = impedance[1:].imag, -impedance[1:].imag
    return matrix
