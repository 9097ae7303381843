"""Faces that are not flat and parallel when they first meet: tilt, crown, cylinder, rounded edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.bending_gap import FORM
from fretflow.effects.effect import Array, Block, Effect, Prior, RecordedSize, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.wear.slow import SlowState


class InitialGap(Effect):
    """Gap of the unworn faces, besides that of the specimens' own shape.

    With x and y from the middle of the contact over half its width, the gap is
    ``tilt_x (1 + x) / 2 + tilt_y (1 + y) / 2 + crown (s(x)^2 + s(y)^2) / 2 + cylinder s(x)^2`` less its smallest value,
    ``s(x) = max(|x| - flat, 0) / (1 - flat)``: what is flat in the middle has rounded edges.
    """

    id = "initial-gap"
    title = "tilt, crown or rounded edges of the unworn faces"
    block = Block.GEOMETRY
    equation = ("g_0 = (t_x (1 + x) + t_y (1 + y) + c (s_x^2 + s_y^2)) / 2 + z s_x^2; "
                "s_x = max(|x| - f, 0) / (1 - f), s_y alike; x, y in [-1, 1]")
    formula = (r"g_0 = \tfrac12 t_x (1 + x) + \tfrac12 t_y (1 + y) + \tfrac12 c\,(s_x^2 + s_y^2) "
               r"+ z\,s_x^2, \quad s_x = \frac{(|x| - f)_+}{1 - f}")
    source = ("K. L. Johnson, Contact Mechanics (1985), section 4.1; flat with rounded edges: "
              "M. Ciavarella, D. A. Hills, G. Monno, Proc. Inst. Mech. Eng. C 212 (1998) 319-327")
    told_by = "maps of both faces before the test"
    observables = ("wear map", "loops of the first cycles", "approach")

    tilt_x: u.SignedLength = parameter(1e-6, "t_x: height over the width, along the sliding", -4e-6, 4e-6, neutral=0.0)
    tilt_y: u.SignedLength = parameter(0.0, "t_y: height over the width, across", -4e-6, 4e-6, neutral=0.0)
    crown: u.SignedLength = parameter(0.0, "c: depth of the corners below the middle", 0.0, 4e-6, neutral=0.0)
    cylinder: u.SignedLength = parameter(0.0, "z: depth of the ends of the stroke below the middle", 0.0, 4e-6,
                                         neutral=0.0)
    flat: float = parameter(0.0, "f: share of the half width that is flat, between rounded edges", 0.0, 0.8,
                            ge=0.0, lt=1.0)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Open the gap."""
        face = problem.interface
        middle = 0.5 * (face.nodes.min(axis=0) + face.nodes.max(axis=0))
        half = np.maximum(0.5 * np.ptp(face.nodes, axis=0), np.finfo(float).tiny)
        x, y = ((face.nodes - middle) / half).T
        return replace(problem, interface=replace(face, gap=face.gap + self._height(x, y)))

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Open the gap between the faces before the bolts are tightened."""
        return replace(joint, gap=joint.clearance + self._height(*joint.across.T))

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior | None:
        """Return heights up to the form of bolted faces, or up to what the bolts close: beyond, few points touch.

        They close a form no further once closing it takes all that they press where it gapes. Of points in a row what
        is across them does nothing.
        """
        if field in ("tilt_y", "crown") and not joint.across[:, 1].any():  # there the crown is half a cylinder
            return None
        if field == "flat":
            return prior
        form = cls.neutral().changed(**{field: 1.0})._height(*joint.across.T)
        taken = float(form @ joint.structure.stiffness[2::3, 2::3] @ form)
        high = min(FORM[1], float(form @ joint.preloaded.force[0, 2::3]) / taken) if taken > 0.0 else FORM[1]
        return replace(prior, low=prior.low / prior.high * high, high=high)

    def _height(self, x: Array, y: Array) -> Array:
        """Return the gap at places over half the width, zero where it is smallest."""
        along, across = (np.maximum(np.abs(place) - self.flat, 0.0) / (1.0 - self.flat) for place in (x, y))
        gap = (0.5 * self.tilt_x * (1.0 + x) + 0.5 * self.tilt_y * (1.0 + y)
               + 0.5 * self.crown * (along**2 + across**2) + self.cylinder * along**2)
        return np.asarray(gap - gap.min())

    def sketch(self) -> Sketch:
        """Return the gap along the sliding direction, beside crowned and hollow faces of the same size."""
        x = np.linspace(-1.0, 1.0, 101)
        size = max(abs(self.tilt_x), abs(self.crown), abs(self.cylinder))
        sizes = {"tilt: t_x": self.tilt_x, "crown: c": self.crown, "cylinder: z": self.cylinder}
        own = ", ".join(f"{name} {1e6 * value:.3g} µm" for name, value in sizes.items() if value)
        forms = {own or "flat": self,
                 f"crowned: c {1e6 * size:.3g} µm": self.neutral().changed(crown=size),
                 f"rounded edges: c {1e6 * size:.3g} µm, f 0.6": self.neutral().changed(crown=size, flat=0.6),
                 f"hollow: c −{1e6 * size:.3g} µm": self.neutral().changed(crown=-size)}
        return Sketch("position over half the width", "gap in µm",
                      {name: (x, 1e6 * form._height(x, np.full_like(x, -1.0))) for name, form in forms.items()})
