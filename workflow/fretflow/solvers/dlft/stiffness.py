"""The relative dynamic stiffness as the DLFT equations use it: its product and its real part."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Stiffness(Protocol):
    """Dynamic stiffness Z at harmonics 0..H; `rig.condensed.RelativeStiffness` is one."""

    def apply(self, u: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return Z u in N for complex amplitudes (H + 1, 3 n) in m."""
        ...

    def real_part(self, harmonic: int) -> NDArray[np.float64]:
        """Return the real part of Z at one harmonic, (3 n, 3 n) in N/m."""
        ...

    def up_to(self, harmonics: int) -> Stiffness:
        """Return the first harmonics, 0..`harmonics`."""
        ...


class DenseStiffness(NamedTuple):
    """One dense complex matrix a harmonic, (H + 1, 3 n, 3 n) in N/m."""

    matrices: NDArray[np.complex128]

    def apply(self, u: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return Z u in N for complex amplitudes (H + 1, 3 n) in m."""
        return np.asarray((self.matrices @ u[:, :, None])[:, :, 0])

    def real_part(self, harmonic: int) -> NDArray[np.float64]:
        """Return the real part of Z at one harmonic, (3 n, 3 n) in N/m."""
        return np.asarray(self.matrices[harmonic].real)

    def up_to(self, harmonics: int) -> DenseStiffness:
        """Return the first harmonics, 0..`harmonics`."""
        return DenseStiffness(self.matrices[:harmonics + 1])
