"""The reduced specimen: what Craig-Bampton leaves of a body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from fretflow.core.errors import MeshError
from fretflow.core.records import quantity, record
from fretflow.core.specimen_mesh import TURN

RIGID_DOFS = 6
OBSERVATION_DOFS = 3

MATCH = 1e-6  # of the contact's width, within which two nodes are one
FREQUENCY_LIMIT = 1e-3  # relative error of the frequencies that a reduced specimen is held to


@record
class ReducedSpecimen:
    """Reduced matrices of one body.

    DOF order: contact nodes (3 n: x, y, z per node, nodes sorted by x then y), the clamped face as a rigid
    body (6: translations x, y, z of its centroid, then rotations about x, y, z), the observation node (3),
    and the modal amplitudes (m, mass-normalised): fixed-interface modes by rising frequency, then the
    residual vectors that stand for the modes left out.
    """

    stiffness: NDArray[np.float64] = quantity("N/m", "(dofs, dofs), 3 n + 9 + m of them")
    mass: NDArray[np.float64] = quantity("kg", "(dofs, dofs), 3 n + 9 + m of them")
    contact_nodes: NDArray[np.float64] = quantity("m", "(nodes, 3)")
    contact_areas: NDArray[np.float64] = quantity("m^2", "(nodes,)")
    profile: NDArray[np.float64] = quantity("m", "(nodes,)")
    observation_point: NDArray[np.float64] = quantity("m", "(3,)")
    fixed_interface_frequencies: NDArray[np.float64] = quantity("Hz", "(modes,)")
    full_frequencies: NDArray[np.float64] = quantity("Hz", "(checked,)")
    reduced_frequencies: NDArray[np.float64] = quantity("Hz", "(checked,)")
    rayleigh_mass: float = quantity("1/s")
    rayleigh_stiffness: float = quantity("s")
    full_dofs: int

    @property
    def contact_size(self) -> int:
        """Return the number of contact DOFs, 3 n."""
        return 3 * len(self.contact_nodes)

    @property
    def rigid(self) -> slice:
        """Return the rows of the rigid clamped face."""
        return slice(self.contact_size, self.contact_size + RIGID_DOFS)

    @property
    def observation(self) -> slice:
        """Return the rows of the observation node."""
        return slice(self.contact_size + RIGID_DOFS, self.contact_size + RIGID_DOFS + OBSERVATION_DOFS)

    @property
    def modal(self) -> slice:
        """Return the rows of the modal amplitudes."""
        return slice(self.contact_size + RIGID_DOFS + OBSERVATION_DOFS, len(self.stiffness))

    @property
    def damping(self) -> NDArray[np.float64]:
        """Return the Rayleigh damping matrix (N s/m), shape as `stiffness`."""
        return self.rayleigh_mass * self.mass + self.rayleigh_stiffness * self.stiffness

    @property
    def frequency_error(self) -> NDArray[np.float64]:
        """Return the relative error of each reduced frequency against the full model."""
        return np.asarray(np.abs(self.reduced_frequencies / self.full_frequencies - 1.0))

    def turned_over(self, contact_nodes: NDArray[np.float64]) -> ReducedSpecimen:
        """Return the same body half round about x = y, ``(x, y, z) -> (y, x, -z)``, as the other specimen lies.

        Parameters
        ----------
        contact_nodes : ndarray (n, 3)
            Those of the turned body in m, in their order.

        Raises
        ------
        MeshError
            If they are not this body's, turned.
        """
        turned = self.contact_nodes @ TURN.T
        distance, order = cKDTree(turned).query(contact_nodes)
        if not (len(np.unique(order)) == len(turned) == len(order)
                and np.max(distance) <= MATCH * np.ptp(turned, axis=0).max()):
            raise MeshError("contact nodes of one specimen are not those of the other turned over; "
                            "give both a mesh of their own")
        moved = (3 * order[:, None] + np.argmax(np.abs(TURN), axis=1)).ravel()
        signs = np.tile(TURN.sum(axis=1), len(order))
        rigid = block_diag(TURN, TURN, TURN)  # a proper rotation: rotations turn as translations do

        def along(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
            """Return the rows of a matrix in the turned coordinates."""
            rows = matrix.copy()
            rows[:self.contact_size] = signs[:, None] * matrix[moved]
            boundary = slice(self.contact_size, self.modal.start)
            rows[boundary] = rigid @ matrix[boundary]
            return rows

        return replace(self, stiffness=along(along(self.stiffness).T), mass=along(along(self.mass).T),
                       contact_nodes=contact_nodes, contact_areas=self.contact_areas[order],
                       profile=self.profile[order], observation_point=self.observation_point @ TURN.T)


@record
class ModeShapes:
    """Natural modes of a body whose clamped face is fixed, by the full model."""

    frequency: NDArray[np.float64] = quantity("Hz", "(modes,)", coordinate=True)
    points: NDArray[np.float64] = quantity("m", "(points, 3), of all nodes")
    shape: NDArray[np.float64] = quantity("kg^-0.5", "(modes, points, 3), mass-normalised")

    def turned_over(self) -> ModeShapes:
        """Return the modes of the same body half round about x = y, see `ReducedSpecimen.turned_over`."""
        return replace(self, points=self.points @ TURN.T, shape=self.shape @ TURN.T)


def reduction_warnings(specimens: Mapping[str, ReducedSpecimen]) -> list[str]:
    """Return a line for each of `specimens` by side whose frequencies are further off than they are held to."""
    return [f"{side} specimen: the reduction is {100.0 * one.frequency_error.max():.2f} % off the full model at mode "
            f"{int(one.frequency_error.argmax()) + 1}, beyond the {100.0 * FREQUENCY_LIMIT:.1f} % that it is held to; "
            f"raise reduction.fixed_interface_modes, or see whether the mesh is one of this specimen"
            for side, one in specimens.items() if one.frequency_error.max() > FREQUENCY_LIMIT]
