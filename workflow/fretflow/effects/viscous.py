"""A dashpot beside the contact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fretflow.core import units as u
from fretflow.effects.effect import INTERFACES, OTHER_RATES, Array, Block, Effect, parameter
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.internal_forces import ForceAndSlopes
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.force_laws import ARM
from fretflow.structure.two_mass_rig.joint import change_rig
from fretflow.wear.slow import SlowState

SPEED = 6.3e-3  # m/s, of 10 µm at 100 Hz
PLATEAU = 0.1  # of it, below which a fluid neither thins nor thickens


@dataclass(frozen=True)
class _Dashpot:
    """Force ``-c v |v / v_0|^(b - 1)`` on the arm, linear below a tenth of v_0."""

    damping: float
    power: float

    def of(self, velocity: Array) -> tuple[Array, Array]:
        """Return the force that the dashpot takes and its slope by the velocity, (N,) each."""
        squared = np.square(velocity / SPEED) + PLATEAU**2
        factor = self.damping * (squared / (1.0 + PLATEAU**2))**(0.5 * (self.power - 1.0))
        return factor * velocity, factor * (1.0 + (self.power - 1.0) * np.square(velocity / SPEED) / squared)

    def __call__(self, displacement: Array, velocity: Array) -> ForceAndSlopes:
        force, slope = np.zeros_like(displacement), np.zeros((len(displacement), 2, 2))
        taken, by_velocity = self.of(velocity[:, ARM])
        force[:, ARM], slope[:, ARM, ARM] = -taken, -by_velocity
        return ForceAndSlopes(force, np.zeros_like(slope), slope)


class Viscous(Effect):
    """A dashpot from the moving specimen to the ground, in the force that is measured: ``T_meas = T + c v``.

    A fluid that thins or thickens with the speed, or an orifice, takes a power of it: ``c v |v / v_0|^(b - 1)``. A
    lumped joint has a damper of its own.
    """

    id = "viscous"
    title = "dashpot beside the contact"
    block = Block.RIG
    equation = "F = -c v |v / v_0|^(b - 1) on the arm; T_meas = T - F; v_0 = 6.3 mm/s"
    formula = (r"T_\mathrm{meas} - T = -F_\mathrm{arm} = c\,v \left|v / v_0\right|^{b - 1}, \qquad "
               r"v_0 = 6.3\ \mathrm{mm/s}")
    source = ("combined Coulomb and viscous friction: J. P. Den Hartog, Trans. ASME 53 (1931), APM-53-9; powers "
              "of the speed: M. C. Constantinou, M. D. Symans, NCEER-92-0032 (1992); P. J. Carreau, Trans. Soc. Rheol. "
              "16 (1972)")
    needs_time = True
    told_by = OTHER_RATES
    observables = ("bulge of both plateaus of a loop", "loops at other frequencies")
    kinds = INTERFACES

    damping: u.SignedDamping = parameter(300.0, "c: force over velocity, at 6.3 mm/s", 50.0, 3e3, ge=0.0, neutral=0.0)
    power: float = parameter(1.0, "b: power of the speed that the force goes with", 0.5, 2.0, rig_only=True, gt=0.0,
                             logarithmic=True, source="from fluids that thin, and dampers, to orifices")

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Hold the arm by the dashpot."""
        if self.damping == 0.0:
            return problem
        return replace(problem, structure=change_rig(problem.structure, forces=(self._dashpot,)))

    def sense(self, signals: Signals) -> Signals:
        """Add the dashpot's force to the friction force."""
        return replace(signals, friction_force=signals.friction_force + self._dashpot.of(signals.velocity)[0])

    @property
    def _dashpot(self) -> _Dashpot:
        return _Dashpot(self.damping, self.power)
