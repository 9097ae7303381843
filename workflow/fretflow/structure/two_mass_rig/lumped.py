"""The lumped two-mass rig: a driven block on a ground spring and an arm hinged to it.

Horizontal motion only, x = (block, arm)::

    M = diag(m_b, m_a),  K = [[k_g + k_h, -k_h], [-k_h, k_h]],  C likewise with c_g, c_h

The arm's vertical motion is free and massless: it passes the normal load to the specimens whole.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from fretflow.case.config import Rig
from fretflow.core.records import quantity, record
from fretflow.structure.internal_forces import InternalForce
from fretflow.structure.structure import MasslessBoundary

MATRICES = ("moving_mass", "arm_mass", "ground_stiffness", "hinge_stiffness", "ground_damping", "hinge_damping")


@record
class LumpedRig:
    """Masses, springs and dashpots of the rig (a `structure.structure.Internal`), and what else acts on it.

    Further forces act on block and arm along x; where the arm runs up a wedge, which may be curved, the normal load is
    ``N + load_slope x + load_curvature x^2``.
    """

    moving_mass: float = quantity("kg")
    arm_mass: float = quantity("kg")
    ground_stiffness: float = quantity("N/m")
    hinge_stiffness: float = quantity("N/m")
    ground_damping: float = quantity("N s/m")
    hinge_damping: float = quantity("N s/m")
    load_slope: float = quantity("N/m", default=0.0)
    load_curvature: float = quantity("N/m2", default=0.0)
    forces: tuple[InternalForce, ...] = ()

    @classmethod
    def from_modes(cls, moving_mass: float, arm_mass: float, in_phase: float, out_of_phase: float,
                   damping_ratio: float, hinge_damping_ratio: float | None = None) -> LumpedRig:
        """Identify the springs from the two sliding modes (Hz).

        The modes are three decades of stiffness apart, so each is taken by itself: the total mass on the
        ground spring, the reduced mass on the hinge. The error of either frequency is of the order of
        ``(in_phase / out_of_phase)^2``, below 0.03 % for 40 and 2500 Hz. Damping: ``2 zeta sqrt(k m)``
        with the total mass for the ground spring and the arm's mass for the hinge, of its own ratio where it has one.
        """
        total = moving_mass + arm_mass
        ground = total * (2.0 * np.pi * in_phase) ** 2
        hinge = moving_mass * arm_mass / total * (2.0 * np.pi * out_of_phase) ** 2
        hinge_ratio = damping_ratio if hinge_damping_ratio is None else hinge_damping_ratio
        return cls(
            moving_mass=moving_mass, arm_mass=arm_mass, ground_stiffness=ground, hinge_stiffness=hinge,
            ground_damping=2.0 * damping_ratio * float(np.sqrt(ground * total)),
            hinge_damping=2.0 * hinge_ratio * float(np.sqrt(hinge * arm_mass)))

    @classmethod
    def of(cls, rig: Rig) -> LumpedRig:
        """Return the rig of a case, whose springs follow from its modes."""
        return cls.from_modes(rig.moving_mass, rig.arm_mass, rig.in_phase_frequency, rig.out_of_phase_frequency,
                              rig.damping_ratio, rig.hinge_damping_ratio)

    def load_at(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what a wedge adds to the normal load at positions of the arm in m, N."""
        return (self.load_slope + self.load_curvature * position) * position

    @property
    def mass(self) -> NDArray[np.float64]:
        """Return the mass matrix (2, 2) in kg, order block, arm."""
        return np.diag([self.moving_mass, self.arm_mass])

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """Return the stiffness matrix (2, 2) in N/m, order block, arm."""
        return _chain(self.ground_stiffness, self.hinge_stiffness)

    @property
    def damping(self) -> NDArray[np.float64]:
        """Return the damping matrix (2, 2) in N s/m, order block, arm."""
        return _chain(self.ground_damping, self.hinge_damping)

    def impedance(self, omega: NDArray[np.floating[Any]]) -> NDArray[np.complex128]:
        """Return the dynamic stiffness (len(omega), 2, 2) in N/m at angular frequencies `omega` (rad/s)."""
        w = np.asarray(omega, dtype=float)[:, None, None]
        return np.asarray(self.stiffness - w**2 * self.mass + 1j * w * self.damping)


@record
class RigModes:
    """Undamped modes of block and arm along x: faces apart, and stuck to each other; of each mode the largest is 1."""

    apart_frequency: NDArray[np.float64] = quantity("Hz", "(modes,)")
    apart_shape: NDArray[np.float64] = quantity("1", "(modes, d), of the internal coordinates, block and arm first")
    stuck_frequency: NDArray[np.float64] = quantity("Hz", "(modes,)")
    stuck_shape: NDArray[np.float64] = quantity("1", "(modes, d)")

    @classmethod
    def of(cls, boundary: MasslessBoundary) -> RigModes:
        """Return the modes of a rig with its contact, whose stuck faces feel ``T R`` to the internal coordinates."""
        internal, felt = boundary.internal, boundary.transfer @ boundary.coupling
        fields = {}
        for faces, stiffness in (("apart", internal.stiffness), ("stuck", internal.stiffness + felt)):
            squares, modes = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), internal.mass)
            largest = modes[np.argmax(np.abs(modes), axis=0), np.arange(modes.shape[1])]
            fields[f"{faces}_frequency"] = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
            fields[f"{faces}_shape"] = (modes / largest).T.copy()
        return cls(**fields)


def _chain(ground: float, hinge: float) -> NDArray[np.float64]:
    return np.array([[ground + hinge, -hinge], [-hinge, hinge]])
