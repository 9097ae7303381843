"""Faces that are bent: they touch at the ends and gape in the middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import STRUCTURES, Array, Block, Effect, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint

FORM = (1e-6, 60e-6)  # m, of milled and ground faces of lap joints of 120 mm


class BendingGap(Effect):
    """An arch ``h (1 - x^2)`` between the faces before the bolts are tightened, x from -1 to 1 along them.

    A hump, open at the ends, is the cylinder of ``initial-gap``. Bolts close the arch as far as they bend the bodies;
    bending in a vibration opens and closes what is left, so that the frequency may rise with the amplitude.
    """

    id = "bending-gap"
    title = "faces that are bent along the joint"
    block = Block.GEOMETRY
    equation = "g_0 = h (1 - x^2), less its smallest value; h >= 0"
    formula = r"g_0 = h\,(1 - x^2) - \min, \qquad x \in [-1, 1]"
    source = ("M. R. W. Brake (ed.), The Mechanics of Jointed Structures (Springer 2018): form and "
              "pressure of the faces of the Brake-Reuss beam")
    told_by = "the form of both faces before they were joined, by a profilometer"
    observables = ("frequency over amplitude that rises again", "contact pressure")
    kinds = STRUCTURES

    height: u.SignedLength = parameter(10e-6, "h: of the arch in the middle", *FORM, ge=0.0,
                                       source="milled and ground faces of lap joints of 120 mm: 1 to 60 µm of form",
                                       neutral=0.0)

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Open the gap."""
        return replace(joint, gap=joint.clearance + self._height(joint.across[:, 0]))

    def _height(self, x: Array) -> Array:
        gap = self.height * (1.0 - x**2)
        return np.asarray(gap - gap.min())  # points need not reach the ends

    def sketch(self) -> Sketch:
        """Return the gap along the faces."""
        x = np.linspace(-1.0, 1.0, 101)
        return Sketch("place along the faces over half their length", "gap in µm", {"": (x, 1e6 * self._height(x))})
