"""Damping of the rest of a structure that grows with the amplitude: other joints, supports, the air."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.effects.effect import STRUCTURES, Block, Effect, Prior, RecordedSize, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint


class JointDamping(Effect):
    """A damping ratio ``zeta = s a`` besides that of the joint, a the mass-normalised modal amplitude.

    The part that does not depend on the amplitude is the structure's own modal damping, which every recording refits.
    What grows in proportion is drag of the air, which goes with the square of the velocity, and micro-slip of joints
    that are not in the model, whose work goes with the cube of the amplitude.
    """

    id = "joint-damping"
    title = "damping of the rest that grows with the amplitude"
    block = Block.RIG
    equation = "zeta + s a, a the modal amplitude"
    formula = r"\zeta(a) = \zeta_0 + s\,a"
    source = ("L. E. Goodman, J. H. Klumpp, J. Appl. Mech. 23 (1956) 421, cubic work; W. E. Baker, "
              "W. E. Woolam, D. Young, Int. J. Mech. Sci. 9 (1967) 743, air")
    told_by = "the same backbone in vacuum, or of a structure of one piece on the same supports"
    observables = ("damping over amplitude without a change of frequency",)
    kinds = STRUCTURES

    slope: float = parameter(1.0, "s: damping ratio over modal amplitude in m kg^0.5", 0.1, 10.0, ge=0.0,
                             source="at the largest amplitude a tenth of the least damping to thrice that there",
                             neutral=0.0)

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior:
        """Return the slope that makes, at the largest amplitude, a tenth of the least damping to thrice that there.

        What the friction of the joint takes at large amplitudes says nothing of how little the rest may.
        """
        return replace(prior, low=0.1 * recorded.least_damping / recorded.amplitude,
                       high=3.0 * recorded.damping / recorded.amplitude)

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Add the damping."""
        return replace(joint, damping_slope=joint.damping_slope + self.slope)

    def sketch(self) -> Sketch:
        """Return the ratio over the amplitude."""
        amplitude = np.linspace(0.0, 1e-3, 50)
        return Sketch("modal amplitude in m kg^0.5", "damping ratio", {"": (amplitude, self.slope * amplitude)})
