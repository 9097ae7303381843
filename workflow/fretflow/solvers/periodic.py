"""What a periodic solver is given and what it returns.

Sign conventions: relative displacement u = upper minus lower, (x, y, z) per node; contact force f acts on the upper
node, so its z component is positive in compression, and the friction force opposes the sliding of the upper node.
The gap of a node is ``gap + u_z``; it is positive when open.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import CoulombLaw
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState, MotionFactor
from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.structure.two_mass_rig.forces import RigForce
from fretflow.structure.two_mass_rig.joint import JointModel


@record
class PeriodicProblem:
    """A joint under a periodic force: everything that the period depends on.

    The last fields are physics beyond the baseline and neutral by default. With them friction at a node obeys
    ``|f_t| <= mu (p / p_0)^-b (1 - d t_x) f_n``, mu multiplied by every motion factor; the normal load is
    ``N + load_slope x`` at the arm position x; forces on the rig and further harmonics of the drive are added.
    """

    joint: JointModel
    interface: Interface
    friction_coefficient: float | NDArray[np.float64] = quantity("1", "() or (nodes,)")
    frequency: float = quantity("Hz")
    excitation: float = quantity("N")  # amplitude of F cos(omega t) on the moving mass
    normal_load: float = quantity("N")
    frictional_preload: bool = False  # whether the faces rub while the load is applied, before anything moves
    friction_exponent: float = quantity("1", default=0.0)  # b
    reference_pressure: float | None = quantity("Pa", default=None)  # p_0; by default load over area
    friction_asymmetry: float = quantity("1", default=0.0)  # d
    motion_factors: tuple[MotionFactor, ...] = ()
    load_slope: float = quantity("N/m", default=0.0)
    rig_forces: tuple[RigForce, ...] = ()
    overtones: tuple[tuple[int, complex], ...] = ()  # (k, F_k): Re F_k exp(i k omega t) in N on the block besides

    @property
    def omega(self) -> float:
        """Return the angular frequency in rad/s."""
        return 2.0 * float(np.pi) * self.frequency

    @property
    def law(self) -> CoulombLaw:
        """Return the friction law of the nodes, without the motion factors."""
        areas = self.interface.areas
        pressure = self.normal_load / areas.sum() if self.reference_pressure is None else self.reference_pressure
        return CoulombLaw(friction_coefficient=np.asarray(self.friction_coefficient, dtype=float),
                          exponent=self.friction_exponent, reference_force=pressure * areas,
                          asymmetry=self.friction_asymmetry)

    def refuse_beyond(self, method: str, *allowed: str) -> None:
        """Refuse physics that `method` would leave out, except the `allowed` fields.

        Raises
        ------
        InputError
            Naming what it is.
        """
        beyond = {"friction_exponent": "friction that depends on the load",
                  "friction_asymmetry": "friction that depends on the direction",
                  "motion_factors": "friction that depends on the motion",
                  "load_slope": "a normal load that depends on the motion",
                  "rig_forces": "further forces on the rig", "overtones": "further harmonics of the drive"}
        for name, what in beyond.items():
            if name not in allowed and getattr(self, name) not in (0.0, ()):
                raise InputError(f"{method} does not know {what}; use solver.method = \"quasi-static\"")


@record
class PeriodicSolution:
    """One steady period on N equidistant samples, ``t_j = j T / N``.

    `error_estimate` is the relative error of the sliding distance, from a finer solution; nan when none was made.
    """

    method: str
    frequency: float = quantity("Hz")
    displacement: NDArray[np.float64] = quantity("m", "(N, nodes, 3)")
    force: NDArray[np.float64] = quantity("N", "(N, nodes, 3)")
    state: NDArray[np.int8] = quantity("1", "(N, nodes)", codes=ContactState)
    rig_displacement: NDArray[np.float64] = quantity("m", "(N, 2), block and arm, x")
    upper_observation: NDArray[np.float64] = quantity("m", "(N, 3)")
    lower_observation: NDArray[np.float64] = quantity("m", "(N, 3)")
    friction_force: NDArray[np.float64] = quantity("N", "(N,), x force of the upper specimen on the lower")
    residual_history: tuple[float, ...] = quantity("1", "(iterations,), relative to the excitation")
    error_estimate: float = quantity("1")

    @property
    def slip_increments(self) -> NDArray[np.float64]:
        """Return |u_t(t_j) - u_t(t_j-1)| in m, (N, nodes), zero where a node is open at t_j."""
        tangential = self.displacement[:, :, :2]
        step = np.linalg.norm(tangential - np.roll(tangential, 1, axis=0), axis=2)
        return np.where(self.state == ContactState.SEPARATION, 0.0, step)


class PeriodicSolver(Protocol):
    """Finds the steady period of a problem, from zero or from a neighbouring solution."""

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        """
        ...
