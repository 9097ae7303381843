"""One time sample of quasi-static frictional contact, solved by semi-smooth Newton.

The bodies are massless, so at each sample the relative displacement u, the contact force f and the arm's rigid motion
(q_x given, q_z free under the normal load) obey

    f = K (u - B_x q_x - B_z q_z),    sum f_z = N
    f_z >= 0,  gap + u_z >= 0,  f_z (gap + u_z) = 0
    stick: u_t = u_t(previous sample), |f_t| <= mu f_z
    slip:  f_t = -mu f_z (u_t - u_t(previous)) / |u_t - u_t(previous)|

The conditions are written with the projection of tau = f_t - rho (u_t - u_t(previous)) onto the friction disc
(Alart and Curnier 1991), for any rho > 0. Displacements are the unknowns, so that stuck and closed DOFs drop out:
a sticking contact has no unknown but q_z, and a sliding one 2 n + 1. Friction beyond ``mu f_z`` (see `coulomb`) has the
limit ``L = g l(f_z) (1 - d t_x)`` with t = tau / |tau| and g a factor of the instant.

Arrays are in component order: DOF ``c n + m`` is direction c of node m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import CoulombLaw
from fretflow.contact.kernels.sample import (
    SEPARATION,
    SLIP,
    STICK,
    Array,
    Contact,
    Marched,
    empty_factor,
    find_in_parts,
)
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.periodic import PeriodicProblem

__all__ = ["SEPARATION", "SLIP", "STICK", "Array", "ContactSystem", "Instant", "SampleChange", "SampleDerivative",
           "SampleSolver", "SampleState", "plain"]


@dataclass(frozen=True)
class ContactSystem:
    """The condensed contact: stiffness, nodes, friction and load. Arrays in component order.

    `stiffness` (3 n, 3 n) N/m; `gap` (n,) m; `load` N.
    """

    stiffness: Array
    gap: Array
    law: CoulombLaw
    load: float
    penalty: float  # rho in N/m

    @classmethod
    def build(cls, stiffness: Array, gap: Array, friction: Array, load: float) -> ContactSystem:
        """Build a contact with the friction coefficients `friction`, () or (n,)."""
        return cls._ordered(stiffness, gap, CoulombLaw(friction_coefficient=np.asarray(friction, dtype=float)), load)

    @classmethod
    def of(cls, problem: PeriodicProblem, stiffness: Array | None = None) -> ContactSystem:
        """Return the contact of `problem`; `stiffness` (3 n, 3 n) in node order is by default the joint's."""
        own = problem.joint.quasi_static().stiffness if stiffness is None else stiffness
        return cls._ordered(own, problem.interface.gap, problem.law, problem.normal_load)

    @classmethod
    def _ordered(cls, stiffness: Array, gap: Array, law: CoulombLaw, load: float) -> ContactSystem:
        """Reorder a stiffness given node by node (x, y, z per node) and choose rho.

        rho only steers the path to the solution; a tenth of the largest diagonal term was the most robust
        of the decades tried.
        """
        n = len(gap)
        order = np.arange(3 * n).reshape(n, 3).T.ravel()
        k = np.ascontiguousarray(stiffness[np.ix_(order, order)])
        return cls(stiffness=k, gap=np.asarray(gap, float), law=law, load=float(load),
                   penalty=0.1 * float(k.diagonal().max()))

    @property
    def friction(self) -> Array:
        """Return the friction coefficients (n,)."""
        return np.broadcast_to(self.law.friction_coefficient, self.size)

    @property
    def size(self) -> int:
        """Return the number of nodes."""
        return len(self.gap)

    @cached_property
    def data(self) -> Contact:
        """Return the data of the compiled loops."""
        law, (along, lift) = self.law, self.rigid_forces()
        return Contact(plain(self.stiffness), plain(along), plain(lift), plain(self.gap), plain(self.friction),
                       plain(np.broadcast_to(law.reference_force, self.size)), float(law.exponent),
                       float(law.asymmetry), float(self.penalty))

    def rigid_forces(self) -> tuple[Array, Array]:
        """Return ``K B_x`` and ``K B_z`` (3 n,) in N/m."""
        n = self.size
        return self.stiffness[:, :n].sum(axis=1), self.stiffness[:, 2 * n:].sum(axis=1)


@dataclass
class SampleState:
    """Contact at one sample: u, f (3 n,), arm q_z, state (n,)."""

    displacement: Array
    force: Array
    approach: float
    state: NDArray[np.int8]

    def alone(self, copied: bool = False) -> Marched:
        """Return it as a march of one sample."""
        found = Marched(plain(self.displacement[None]), plain(self.force[None]), np.array([self.approach], dtype=float),
                        np.require(self.state[None], dtype=np.int8, requirements=["C", "W"]))
        if not copied:
            return found
        return Marched(found.displacement.copy(), found.force.copy(), found.approach, found.state.copy())


class Instant(NamedTuple):
    """What a sample is under besides the arm's position: the normal load in N and the factor g on friction."""

    load: float
    grip: float = 1.0


@dataclass(frozen=True)
class SampleChange:
    """What p parameters change at a sample by themselves, all else held.

    `arm` (p,) m; `load` (p,) N; `friction` (n, p), of ``g mu``; `force` (3 n, p) N, the elastic contact force.
    """

    arm: Array
    load: Array
    friction: Array
    force: Array

    @classmethod
    def of_arm(cls, arm: Array, size: int) -> SampleChange:
        """Return motions of the arm alone; `size` n."""
        return cls(arm, np.zeros(len(arm)), np.zeros((size, len(arm))), np.zeros((3 * size, len(arm))))


@dataclass(frozen=True)
class SampleDerivative:
    """Derivative of a sample by p parameters.

    `displacement` (3 n, p), its z rows the opening gap + u_z; `approach` (p,); `pressing` (m, p), the normal
    force at the m slipping nodes.
    """

    displacement: Array
    approach: Array
    pressing: Array


def plain(values: NDArray[Any]) -> Array:
    """Return `values` as a contiguous array of floats that may be written to, a copy where need be."""
    return np.require(values, dtype=np.float64, requirements=["C", "W"])


class SampleSolver:
    """Solves samples one after another and keeps the last factor while it is good enough."""

    def __init__(self, system: ContactSystem) -> None:
        self.system = system
        self.tolerance = 1e-10 * system.load / system.size  # N, largest residual at a node
        self.kbx, self.kbz = system.data.along, system.data.lift
        self.factors = empty_factor(system.size, single=True), empty_factor(system.size)

    def solve(self, arm: float, previous: Array, guess: SampleState, arm_before: float,
              instant: Instant | None = None) -> SampleState:
        """Return the contact at arm position `arm` (m) after a sample with displacement `previous` (3 n,).

        `instant` is by default that of the system's load and friction coefficients.

        If Newton fails, the arm is moved there from `arm_before` in ever smaller parts, the sample's own
        history unchanged: each part starts from the solution of the one before.

        Raises
        ------
        NonConvergenceError
            If even 2^-8 of the step fails.
        """
        at = Instant(self.system.load) if instant is None else instant
        sample = guess.alone(copied=True)
        if not find_in_parts(self.system.data, self.factors[0], (float(arm), float(at.load), float(at.grip)),
                             float(arm_before), plain(previous), sample, 0, float(self.tolerance)):
            raise not_found(arm)
        return SampleState(sample.displacement[0], sample.force[0], float(sample.approach[0]), sample.state[0])

    def tangent(self, sample: SampleState, previous: Array, history: Array, arm_direction: Array,
                instant: Instant | None = None, load: Array | None = None, grip: Array | None = None
                ) -> tuple[Array, Array]:
        """Differentiate a converged sample by motions of the arm.

        Parameters
        ----------
        sample, previous
            The sample and the displacement before it.
        history : (3 n, p)
            Derivative of `previous`.
        arm_direction, load, grip : (p,)
            Derivatives of the arm position and of what `instant` holds, by default none.

        Returns
        -------
        (3 n, p), (p,)
            Derivatives of the displacement and of the x force on the upper face's nodes together.
        """
        if not len(arm_direction):
            return history, arm_direction
        n, change = self.system.size, SampleChange.of_arm(arm_direction, self.system.size)
        if load is not None and grip is not None:
            change = SampleChange(arm_direction, load, np.outer(self.system.friction, grip), change.force)
        found = self.differentiate(sample, previous, history, change, instant)
        force = self.kbx @ found.displacement - self.kbx[:n].sum() * arm_direction - self.kbz[:n].sum() * found.approach
        return found.displacement, force

    def differentiate(self, sample: SampleState, previous: Array, history: Array, change: SampleChange,
                      instant: Instant | None = None) -> SampleDerivative:
        """Differentiate a converged sample by p parameters; history (3 n, p) is the derivative of `previous`."""
        p, slipping = history.shape[1], int(np.count_nonzero(sample.state == SLIP))
        moved, approach, pressing = np.empty((3 * self.system.size, p)), np.empty(p), np.empty((slipping, p))
        by = (plain(change.arm), plain(change.load), plain(change.friction), plain(change.force))
        grip = 1.0 if instant is None else float(instant.grip)
        differentiate(self.system.data, self.factors[1], grip, plain(previous), sample.alone(), 0, plain(history), by,
                      moved, approach, pressing)
        return SampleDerivative(moved, approach, pressing)


def not_found(arm: float) -> NonConvergenceError:
    """Return the error of a sample that was not found."""
    return NonConvergenceError(
        f"contact at one time sample did not converge (arm at {arm:.6e} m); use more samples per period")
