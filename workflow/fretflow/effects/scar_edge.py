"""A worn scar that holds the motion back at both ends of the stroke."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fretflow.contact.interface import Interface
from fretflow.core import units as u
from fretflow.effects.effect import Array, Block, Effect, Sketch, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.internal_forces import ForceAndSlopes
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

HALF_STROKE = "scar-edge.half_stroke_m"
AREA_SHARE = "scar-edge.area_share"


@dataclass(frozen=True)
class EdgeForce:
    """Force on the arm that pushes it back from both ends of the scar (a `structure.internal_forces.InternalForce`).

    Over the last `width` before `half_stroke` (m) the floor of the scar rises, with a slope that starts as e^power with
    the distance e into the rise, goes on to the scar's `end` (m) and keeps its last value beyond. Climbing it under the
    held load N takes the force ``N dz/dx``: here ``-sign(x) peak (e / width)^power``, with the `peak` (N) at the half
    stroke. It has the potential N z: the way back returns it.
    """

    between_specimens: ClassVar[bool] = True  # a force sensor sees it

    peak: float
    half_stroke: float
    width: float
    power: float
    end: float

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        """Return the force on block and arm, (N, 2), and its slopes."""
        force, slope = np.zeros_like(displacement), np.zeros((len(displacement), 2, 2))
        arm = displacement[:, 1]
        start = self.half_stroke - self.width
        into = np.maximum(np.minimum(np.abs(arm), self.end) - start, 0.0) / self.width
        force[:, 1] = -np.sign(arm) * self.peak * into**self.power
        rising = (np.abs(arm) >= start) & (np.abs(arm) < self.end)
        slope[rising, 1, 1] = -self.power * self.peak / self.width * into[rising]**(self.power - 1.0)
        return ForceAndSlopes(force, slope, np.zeros_like(slope))


class ScarEdge(Effect):
    """Both ends of the stroke harden as the scar deepens.

    A scar of mean depth h ends where its floor rises to the unworn level. The other face, worn to match, climbs that
    rise under the held load N, by work of N dz/dx: a force on the arm with a potential, hence without dissipation. Its
    value at the ends of the stroke grows with the slope of the rise, F_p (1 - exp(-h / h_s)).

    The floor is flat in the middle and rises as e^(p + 1); with a width of 1 it is one bowl. X follows where the arm
    has been: it starts at the half stroke of the first wear, and moves out to a larger one as wear digs there,
    dX = (stroke / 2 - X)_+ dh / h_s. It never moves in. The rise ends at r X, as far beyond the stroke as the faces
    that made the scar are long. The specimens exchange the force, so that it is measured with the friction force.
    """

    id = "scar-edge"
    title = "ends of the stroke that harden as the scar deepens"
    block = Block.GEOMETRY
    equation = ("F = -sign(x) F_p (1 - exp(-h / h_s)) e^p; e = (|x| - (1 - w) X) / (w X) "
                "from 0, for |x| to r X; T_meas = T - F")
    formula = (r"F = -\operatorname{sgn}(x)\,F_p \left(1 - e^{-h / h_s}\right) e^p, \;\; "
               r"e = \frac{(\min(|x|, r X) - (1 - w) X)_+}{w X}, \;\; T_\mathrm{meas} = T - F")
    source = ("D. M. Mulvihill, M. E. Kartal, A. V. Olver, D. Nowell, D. A. Hills, Wear 271 (2011) "
              "802-816, wear-scar interaction; the shape of the rise is an assumption")
    over_cycles = True
    observables = ("force at both ends of a loop, rising over cycles", "sliding over cycles")

    peak_force: u.SignedForce = parameter(10.0, "F_p: force at the ends of the stroke in a deep scar", 3.0, 25.0,
                                          ge=0.0, neutral=0.0, logarithmic=True)
    width: float = parameter(0.3, "w: length of the rise over the half stroke", 0.1, 0.6, gt=0.0, le=1.0)
    depth_scale: u.Length = parameter(1e-6, "h_s: mean depth of both faces over which it builds up", 0.2e-6, 5e-6)
    power: float = parameter(2.0, "p: power of the way into the rise with which the force grows", 1.0, 3.0, ge=1.0,
                             source="floors that rise as a parabola to such as rise with the fourth power")
    reach: float = parameter(1.0, "r: end of the rise over the half stroke that digs it", 1.0, 3.0, ge=1.0,
                             source="from faces far shorter than the stroke to such as are as long as it")

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Add the force of the scar as it is."""
        peak, stroke = self.peak(float(slow.memory[AREA_SHARE] @ slow.depth)), float(slow.memory[HALF_STROKE])
        if not (peak > 0.0 and stroke > 0.0):
            return problem
        force = self._force(peak, stroke)
        return replace(problem, structure=change_rig(problem.structure, forces=(force,)))

    def _force(self, peak: float, half_stroke: float) -> EdgeForce:
        return EdgeForce(peak, half_stroke, self.width * half_stroke, self.power, self.reach * half_stroke)

    def peak(self, depth: float) -> float:
        """Return the force in N at the ends of a scar of mean `depth` in m."""
        return -self.peak_force * float(np.expm1(-depth / self.depth_scale))

    def initial_memory(self, interface: Interface) -> dict[str, Array]:
        """Return no scar, and the nodes' shares of the area."""
        return {HALF_STROKE: np.zeros(()), AREA_SHARE: interface.areas / interface.areas.sum()}

    def evolve(self, before: SlowState, cycles: float, worn: Array, energy: float, response: CycleResponse
               ) -> dict[str, Array]:
        """Return the half stroke that has dug the scar."""
        end, now = float(before.memory[HALF_STROKE]), 0.5 * response.arm_range
        if end == 0.0:
            return {HALF_STROKE: np.asarray(now)}
        moved = -float(np.expm1(-float(before.memory[AREA_SHARE] @ worn) / self.depth_scale))
        return {HALF_STROKE: np.asarray(end + moved * max(now - end, 0.0))}

    def sketch(self) -> Sketch:
        """Return the force over the stroke for scars of several depths."""
        place = np.linspace(-1.1, 1.1, 221)
        return Sketch("position over the half stroke", "force against the motion in N", {
            f"h = {depth:g} h_s": (place, -self._force(self.peak(depth * self.depth_scale), 1.0)(
                np.stack([place, place], axis=1), np.zeros((len(place), 2))).force[:, 1])
            for depth in (0.3, 1.0, 3.0)})
