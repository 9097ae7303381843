"""A joint with springs in series with its contact: asperities, or a layer of debris.

With the body's relative displacement u_b and the contact force f = Z u_b - g, springs of compliance C give the contact
displacement ``u = u_b + C f``, hence ``f = (1 + Z C)^-1 (Z u - g)``; statically the flexibility becomes G + C.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.structure.structure import DynamicStiffness, MasslessBoundary, Structure
from fretflow.structure.two_mass_rig.joint import JointModel, JointMotion, QuasiStaticJoint, invert_stiffness, rig_of
from fretflow.structure.two_mass_rig.lumped import LumpedRig


@record
class CompliantJoint:
    """A joint with springs at its contact nodes (a `rig.joint.JointModel`)."""

    joint: JointModel
    springs: NDArray[np.float64] = quantity("m/N", "(3 n,)")

    @property
    def rig(self) -> LumpedRig:
        """Return the rig."""
        return self.joint.rig

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the loads."""
        return self.joint.inputs

    @property
    def linear(self) -> bool:
        """Return whether the rig is linear and its normal load constant."""
        return self.joint.linear

    def with_rig(self, rig: LumpedRig) -> CompliantJoint:
        """Return the joint on another rig."""
        return replace(self, joint=self.joint.with_rig(rig))

    def massless_boundary(self) -> MasslessBoundary:
        """Return the joint with its specimens massless, as solvers see it."""
        return self.quasi_static().massless_boundary()

    def dynamic_stiffness(self, frequency: float, loads: NDArray[np.complex128]) -> DynamicStiffness:
        """Return the relative dynamic stiffness at the harmonics of `frequency` (Hz) under loads (H + 1, 3) in N."""
        bare = self.joint.dynamic_stiffness(frequency, loads)
        stiffness, load = np.empty_like(bare.stiffness), np.empty_like(bare.load)
        for k, (z, g) in enumerate(zip(bare.stiffness, bare.load, strict=True)):
            series = lu_factor(np.eye(len(z)) + z * self.springs, check_finite=False)
            stiffness[k], load[k] = lu_solve(series, z, check_finite=False), lu_solve(series, g, check_finite=False)
        return DynamicStiffness(omega=bare.omega, load=load, stiffness=stiffness)

    def motion_amplitudes(self, frequency: float, displacement: NDArray[np.complex128],
                          loads: NDArray[np.complex128]) -> JointMotion:
        """Return the rig's and the observation nodes' motion for contact displacements (H + 1, 3 n) in m."""
        own = self.dynamic_stiffness(frequency, loads)
        force = np.einsum("kij,kj->ki", own.stiffness, displacement) - own.load
        return self.joint.motion_amplitudes(frequency, displacement - self.springs * force, loads)

    def quasi_static(self) -> QuasiStaticJoint:
        """Return the joint with its specimens massless."""
        joint = self.joint.quasi_static()
        flexibility = joint.flexibility + np.diag(self.springs)
        return replace(joint, flexibility=flexibility, stiffness=invert_stiffness(flexibility, "joint with springs"))


def with_springs(structure: Structure, springs: NDArray[np.float64]) -> JointModel:
    """Return a joint on the rig with springs of compliance `springs` (3 n,), m/N, in series with each contact DOF.

    Raises
    ------
    InputError
        If a compliance is negative or not finite, or the structure is not on the rig.
    """
    if not (np.all(np.isfinite(springs)) and np.all(springs >= 0.0)):
        raise InputError("contact springs: compliance must be finite and not negative at every node")
    joint = rig_of(structure)
    if not np.any(springs):
        return joint
    compliant = CompliantJoint(joint=joint, springs=springs)
    return compliant.quasi_static() if isinstance(joint, QuasiStaticJoint) else compliant
