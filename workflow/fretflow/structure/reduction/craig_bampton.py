"""Craig-Bampton reduction: reduced matrices from constraint and fixed-interface modes, and what follows.

Equations: R. R. Craig, M. C. C. Bampton, Coupling of substructures for dynamic analyses, AIAA J. 6 (1968).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from numpy.typing import NDArray

from fretflow.core.errors import AuditError
from fretflow.core.records import quantity, record
from fretflow.structure.reduction.reduced_specimen import OBSERVATION_DOFS, RIGID_DOFS, ReducedSpecimen

_RIGID_TOLERANCE = 1e-8


@record
class ComponentModes:
    """A body projected onto its constraint modes (b) and modes held at the boundary (m, mass-normalised).

    The latter are the fixed-interface modes, then the residual vectors with their Ritz frequencies. Stiffness
    is not coupled between the two families; mass is, through `coupling`.
    """

    constraint_stiffness: NDArray[np.float64] = quantity("N/m", "(b, b)")
    constraint_mass: NDArray[np.float64] = quantity("kg", "(b, b)")
    coupling: NDArray[np.float64] = quantity("kg^0.5", "(b, m)")
    modal_frequencies: NDArray[np.float64] = quantity("Hz", "(m,)")

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """Return the reduced stiffness (b + m, b + m), constraint modes first."""
        modal = np.diag((2.0 * np.pi * self.modal_frequencies) ** 2)
        return np.asarray(scipy.linalg.block_diag(self.constraint_stiffness, modal))

    @property
    def mass(self) -> NDArray[np.float64]:
        """Return the reduced mass (b + m, b + m), constraint modes first."""
        modal = np.eye(self.coupling.shape[1])
        return np.block([[self.constraint_mass, self.coupling], [self.coupling.T, modal]])


def rigid_motions(points: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion (3 n, 6) of `points` (n, 3) under unit translations and rotations about `centre`.

    Columns: translation x, y, z, then rotation about x, y, z; rows x, y, z per point.
    """
    arm = points - centre
    motions = np.zeros((len(points), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for axis in range(3):
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], arm)
    return motions.reshape(-1, 6)


def natural_frequencies(stiffness: NDArray[np.float64], mass: NDArray[np.float64],
                        count: int) -> NDArray[np.float64]:
    """Return the `count` lowest natural frequencies (Hz) of positive definite `stiffness` and `mass` (N, N).

    Shift-invert Lanczos about zero on a dense Cholesky factor, or all of them where that is not cheaper.
    """
    size = len(stiffness)
    if size < max(200, 4 * count):
        squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[:count]
    else:
        factor = scipy.linalg.cho_factor(stiffness, lower=True)
        inverse = scipy.sparse.linalg.LinearOperator(
            (size, size), matvec=lambda v: scipy.linalg.cho_solve(factor, v), dtype=float)
        start = np.random.default_rng(0).standard_normal(size)
        squares = np.sort(scipy.sparse.linalg.eigsh(
            stiffness, count, mass, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))


def clamped_frequencies(modes: ComponentModes, contact_size: int, count: int) -> NDArray[np.float64]:
    """Return the `count` lowest frequencies (Hz) of the reduced body with only the clamped face fixed."""
    size = len(modes.constraint_stiffness) + modes.coupling.shape[1]
    free = np.setdiff1d(np.arange(size), np.arange(contact_size, contact_size + RIGID_DOFS))
    return natural_frequencies(modes.stiffness[np.ix_(free, free)], modes.mass[np.ix_(free, free)], count)


def audit(specimen: ReducedSpecimen, clamped_centroid: NDArray[np.float64], total_mass: float) -> None:
    """Check what every reduced body must satisfy.

    Symmetric matrices; no force and the body's own mass `total_mass` (kg) in its rigid motions, rotations
    about `clamped_centroid` (3,) in m; orthonormal modes; frequencies not below the full model's.

    Raises
    ------
    AuditError
        Naming the law that is violated and by how much.
    """
    stiffness, mass = specimen.stiffness, specimen.mass
    for name, matrix in (("stiffness", stiffness), ("mass", mass)):
        size = np.sqrt(np.diag(matrix))
        asymmetry = np.max(np.abs(matrix - matrix.T) / np.outer(size, size))
        _limit(f"asymmetry of the reduced {name}", asymmetry, 1e-12)
    points = np.vstack([specimen.contact_nodes, specimen.observation_point])
    motions = rigid_motions(points, clamped_centroid)
    rigid = np.zeros((len(stiffness), 6))
    rigid[:specimen.contact_size] = motions[:-OBSERVATION_DOFS]
    rigid[specimen.rigid] = np.eye(6)
    rigid[specimen.observation] = motions[-OBSERVATION_DOFS:]
    forces = np.linalg.norm(stiffness @ rigid, axis=0)
    scale = np.linalg.norm(np.abs(stiffness) @ np.abs(rigid), axis=0)
    _limit("force in a rigid motion of the reduced body", np.max(forces / scale), _RIGID_TOLERANCE)
    inertia = rigid[:, :3].T @ mass @ rigid[:, :3]
    _limit("mass of the reduced body", np.max(np.abs(inertia / total_mass - np.eye(3))), _RIGID_TOLERANCE)
    modal = mass[specimen.modal, specimen.modal]
    _limit("orthonormality of the fixed-interface modes", np.max(np.abs(modal - np.eye(len(modal)))), 1e-8)
    below = 1.0 - specimen.reduced_frequencies / specimen.full_frequencies
    _limit("reduced frequencies below the full model's", np.max(below, initial=0.0), 1e-7)


def _limit(name: str, value: float, limit: float) -> None:
    if not value <= limit:
        raise AuditError(f"reduction: {name}: {value:.2e} exceeds {limit:.0e}")
