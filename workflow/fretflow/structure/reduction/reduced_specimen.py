"""The reduced specimen: what Craig-Bampton leaves of a body."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import quantity, record

RIGID_DOFS = 6
OBSERVATION_DOFS = 3

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


@record
class ModeShapes:
    """Natural modes of a body whose clamped face is fixed, by the full model."""

    frequency: NDArray[np.float64] = quantity("Hz", "(modes,)", coordinate=True)
    points: NDArray[np.float64] = quantity("m", "(points, 3), of all nodes")
    shape: NDArray[np.float64] = quantity("kg^-0.5", "(modes, points, 3), mass-normalised")


def reduction_warnings(specimens: Mapping[str, ReducedSpecimen]) -> list[str]:
    """Return a line for each of `specimens` by side whose frequencies are further off than they are held to."""
    return [f"{side} specimen: the reduction is {100.0 * one.frequency_error.max():.2f} % off the full model at mode "
            f"{int(one.frequency_error.argmax()) + 1}, beyond the {100.0 * FREQUENCY_LIMIT:.1f} % that it is held to; "
            f"raise reduction.fixed_interface_modes, or see whether the mesh is one of this specimen"
            for side, one in specimens.items() if one.frequency_error.max() > FREQUENCY_LIMIT]
