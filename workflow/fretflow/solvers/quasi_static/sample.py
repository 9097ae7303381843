"""One time sample of quasi-static frictional contact, solved by semi-smooth Newton.

The contact is massless (see `structure.structure`), so at each sample the relative displacement u and the contact force
f obey, the internal coordinates q and loads i being given,

    f = K u - p,    p = R q + R_2 q^2 + P i
    f_z >= 0,  gap + u_z >= 0,  f_z (gap + u_z) = 0
    stick: u_t = u_t(previous sample), |f_t| <= mu f_z
    slip:  f_t = -mu f_z (u_t - u_t(previous)) / |u_t - u_t(previous)|

The conditions are written with the projection of tau = f_t - rho (u_t - u_t(previous)) onto the friction disc
(Alart and Curnier 1991), for any rho > 0. Displacements are the unknowns, so that stuck and closed DOFs drop out: a
sticking contact has no unknown, and a sliding one 2 n. Friction beyond ``mu f_z`` has the limit of
`contact.kernels.cone` with t = tau / |tau|. K is semi-definite where a free coordinate carries the normal load; one
closed node makes the equations regular.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import Coulomb
from fretflow.contact.kernels.sample import SEPARATION, SLIP, STICK, Contact, PeriodHistory, empty_factor, find_in_parts
from fretflow.contact.kernels.slope import differentiate
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import Array
from fretflow.solvers.periodic import PeriodicProblem

__all__ = ["SEPARATION", "SLIP", "STICK", "Array", "ContactSystem", "PeriodHistory", "SampleChange",
           "SampleDerivative", "SampleSolver", "SampleState", "plain"]


@dataclass(frozen=True)
class ContactSystem:
    """The contact of a structure: stiffness, nodes and friction.

    `stiffness` K (3 n, 3 n) and `coupling` R (3 n, d) in N/m, `transfer` T (d, 3 n), `gap` (n,) m, `pull` P i at rest
    (3 n,) N; `load` is the size of the normal forces together, N, to which accuracies are relative. The squares of the
    coordinates may pull as well, by `curvature` R_2 (3 n, d) in N/m^2: to compiled loops they are d coordinates more.
    """

    stiffness: Array
    coupling: Array
    transfer: Array
    gap: Array
    law: Coulomb
    pull: Array
    load: float
    penalty: float  # rho in N/m
    curvature: Array | None = None

    @classmethod
    def of(cls, problem: PeriodicProblem, seen: NDArray[np.intp] | None = None) -> ContactSystem:
        """Return the contact of `problem`, with the coordinates `seen`, by default all."""
        b = problem.boundary
        which = np.arange(b.size) if seen is None else seen
        pull = b.input_pull @ problem.loads(0)[0].real
        load = problem.normal_load or float(np.abs(pull).sum()) or problem.excitation.amplitude or 1.0
        system = cls.of_parts(b.stiffness, b.coupling[:, which], b.transfer[which], problem.interface.gap,
                              problem.nodal_law, pull, load)
        return system if b.curvature is None else replace(system, curvature=b.curvature[:, which])

    @classmethod
    def of_parts(cls, stiffness: Array, coupling: Array, transfer: Array, gap: Array, law: Coulomb, pull: Array,
                 load: float) -> ContactSystem:
        """Choose rho: it only steers the path to the solution.

        A tenth of the largest diagonal term was the most robust of the decades tried.
        """
        return cls(stiffness=stiffness, coupling=coupling, transfer=transfer, gap=np.asarray(gap, float), law=law,
                   pull=pull, load=float(load), penalty=0.1 * float(stiffness.diagonal().max(initial=0.0)))

    @property
    def friction(self) -> Array:
        """Return the friction coefficients (n,)."""
        return np.broadcast_to(self.law.friction_coefficient, self.size)

    @property
    def size(self) -> int:
        """Return the number of nodes."""
        return len(self.gap)

    def pulled(self, position: Array) -> Array:
        """Return the pull (N, 3 n), N, at coordinates (N, d)."""
        pull = position @ self.coupling.T + self.pull
        return pull if self.curvature is None else pull + position**2 @ self.curvature.T

    def moved(self, position: Array, directions: Array) -> Array:
        """Return derivatives (..., d, p) of coordinates (..., d) as the compiled loops take them."""
        if self.curvature is None:
            return directions
        return np.concatenate([directions, 2.0 * position[..., None] * directions], axis=-2)

    @cached_property
    def felt_stiffness(self) -> Array:
        """Return ``T R`` (d, d) in N/m: that of the stuck contact to the coordinates."""
        return np.asarray(self.transfer @ self.coupling)

    @cached_property
    def data(self) -> Contact:
        """Return the data of the compiled loops."""
        law, coupling, transfer = self.law, self.coupling, self.transfer
        if self.curvature is not None:
            coupling, transfer = np.hstack([coupling, self.curvature]), np.vstack([transfer, np.zeros_like(transfer)])
        return Contact(plain(self.stiffness), plain(coupling), plain(transfer @ self.stiffness),
                       plain(transfer @ coupling), plain(self.gap), plain(self.friction),
                       plain(np.broadcast_to(law.reference_force, self.size)), float(law.exponent),
                       float(law.asymmetry), float(self.penalty))


@dataclass
class SampleState:
    """Contact at one sample: u, f (3 n,), state (n,)."""

    displacement: Array
    force: Array
    state: NDArray[np.int8]

    def alone(self, copied: bool = False) -> PeriodHistory:
        """Return it as a period of one sample."""
        def one(values: NDArray[Any], kind: type) -> NDArray[Any]:
            return np.array(values[None], kind) if copied else np.require(values[None], kind, ["C", "W"])

        return PeriodHistory(np.zeros((1, 0)), one(self.displacement, np.float64), one(self.force, np.float64),
                             one(self.state, np.int8))

    @classmethod
    def of(cls, period: PeriodHistory, j: int = -1) -> SampleState:
        """Return sample j of a period, by default the last, which is the one before its beginning."""
        return cls(period.displacement[j], period.force[j], period.state[j])


@dataclass(frozen=True)
class SampleChange:
    """What p parameters change at a sample by themselves, all else held.

    `motion` (d, p) m; `friction` (n, p), of ``g mu``; `force` (3 n, p) N, the elastic contact force, or (0, p).
    """

    motion: Array
    friction: Array
    force: Array


@dataclass(frozen=True)
class SampleDerivative:
    """Derivative of a sample by p parameters.

    `displacement` (3 n, p), its z rows the opening gap + u_z; `pressing` (m, p), the normal force at the m slipping
    nodes.
    """

    displacement: Array
    pressing: Array


def plain(values: NDArray[Any]) -> Array:
    """Return `values` as a contiguous array of floats that may be written to, a copy where need be."""
    return np.require(values, dtype=np.float64, requirements=["C", "W"])


class SampleSolver:
    """Solves samples one after another and keeps the last factor while it is good enough."""

    def __init__(self, system: ContactSystem) -> None:
        self.system = system
        self.tolerance = 1e-10 * system.load / system.size  # N, largest residual at a node
        self.factors = empty_factor(system.size, single=True), empty_factor(system.size)

    def solve(self, pull: Array, previous: Array, guess: SampleState, pull_before: Array,
              friction_factor: float = 1.0) -> SampleState:
        """Return the contact under the pull ``p`` (3 n,), N, after a sample with displacement `previous`.

        If Newton fails, the pull is brought there from `pull_before` in ever smaller parts, the sample's own history
        unchanged: each part starts from the solution of the one before.

        Raises
        ------
        NonConvergenceError
            If even 2^-8 of the step fails.
        """
        sample = guess.alone(copied=True)
        if not find_in_parts(self.system.data, self.factors[0], (plain(pull_before), plain(pull)),
                             float(friction_factor), plain(previous), sample, 0, float(self.tolerance)):
            raise NonConvergenceError("contact at one time sample did not converge; use more samples per period")
        return SampleState.of(sample)

    def tangent(self, sample: SampleState, previous: Array, history: Array, motion: Array, factor: float = 1.0,
                factor_slope: Array | None = None) -> tuple[Array, Array]:
        """Differentiate a converged sample by motions of the coordinates.

        Parameters
        ----------
        sample, previous
            The sample and the displacement before it.
        history : (3 n, p)
            Derivative of `previous`.
        motion : (d, p)
            Derivative of the coordinates, and of their squares where these pull (`ContactSystem.moved`).
        factor, factor_slope : float, (p,)
            That on friction, and its derivative, by default none.

        Returns
        -------
        (3 n, p), (d, p)
            Derivatives of the displacement and of the force T f on the coordinates.
        """
        slope = np.zeros(motion.shape[1]) if factor_slope is None else factor_slope
        change = SampleChange(motion, np.outer(self.system.friction, slope), np.zeros((0, motion.shape[1])))
        moved = self.differentiate(sample, previous, history, change, factor).displacement
        d, data = len(self.system.transfer), self.system.data
        return moved, data.felt[:d] @ moved - data.felt_coupling[:d] @ motion

    def differentiate(self, sample: SampleState, previous: Array, history: Array, change: SampleChange,
                      factor: float = 1.0) -> SampleDerivative:
        """Differentiate a converged sample by p parameters; history (3 n, p) is the derivative of `previous`."""
        p, slipping = history.shape[1], int(np.count_nonzero(sample.state == SLIP))
        moved, pressing = np.empty((3 * self.system.size, p)), np.empty((slipping, p))
        by = (plain(change.motion), plain(change.friction), plain(change.force))
        differentiate(self.system.data, self.factors[1], float(factor), plain(previous), sample.alone(), 0,
                      plain(history), by, moved, pressing)
        return SampleDerivative(moved, pressing)
