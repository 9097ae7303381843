"""Coulomb friction with unilateral contact, and the audit of a period against it.

Prediction and correction as in Nacivet, Pierre, Thouverez, Jezequel, J. Sound Vib. 265 (2003) 201-219, sections
3.3-3.4: the force that sticking would need is kept inside the friction disc and projected onto it from outside.
The formulas themselves stand in `contact.kernels.cone`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.law import FactorAndSlopes, MotionFactor
from fretflow.core.errors import AuditError, InputError
from fretflow.core.records import Array, quantity, record


@record
class Coulomb:
    """Coulomb's law ``|f_t| <= mu f_n`` (a `contact.law.ContactLaw`): ``Coulomb(0.6)``.

    Its coefficient may fall with the normal force, ``mu (f_n / f_0)^-b``, differ with the direction of the friction
    force t by the factor ``1 - d t_x`` (sliding to positive x, against t_x = -1, meets ``mu (1 + d)``), and follow how
    the faces move as a whole by `motion_factors`.

    Examples
    --------
    >>> import fretflow as ff
    >>> import numpy as np
    >>> ff.Coulomb(0.6).slip_limit(np.array([0.0, 10.0]))  # N
    array([0., 6.])
    """

    friction_coefficient: Array | float = quantity("1", "() or (nodes,)", kw_only=False)
    exponent: float = quantity("1", default=0.0)  # b
    reference_pressure: float | None = quantity("Pa", default=None)  # p_0; by default the mean under the normal load
    asymmetry: float = quantity("1", default=0.0)  # d
    motion_factors: tuple[MotionFactor, ...] = ()
    reference_force: Array | float = quantity("N", "() or (nodes,)", default=1.0)  # f_0, see `on`

    def check(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            If a friction coefficient is negative or not finite, the exponent does not lie in [0, 1), the asymmetry not
            within (-1, 1), or a reference pressure that it needs is not positive.
        """
        mu = np.asarray(self.friction_coefficient)
        if not (mu.ndim < 2 and mu.dtype.kind in "fiu" and np.all(np.isfinite(mu)) and np.all(mu >= 0.0)):
            raise InputError("friction_coefficient: must be a finite number, or one for each node, and not negative")
        if not (0.0 <= self.exponent < 1.0 and -1.0 < self.asymmetry < 1.0):
            raise InputError(f"friction: exponent {self.exponent} must lie in [0, 1) and asymmetry {self.asymmetry} "
                             "between -1 and 1")
        if self.exponent and self.reference_pressure is not None and not self.reference_pressure > 0.0:
            raise InputError(f"friction: reference_pressure {self.reference_pressure} Pa must be positive")

    def on(self, areas: Array, normal_load: float) -> Coulomb:
        """Return the law of nodes of `areas` (nodes,) m^2 under a normal load in N: f_0 is p_0 times the area."""
        pressure = normal_load / areas.sum() if self.reference_pressure is None else self.reference_pressure
        return replace(self, reference_force=pressure * areas)

    def slip_limit(self, normal: Array) -> Array:
        """Return the limit in N in the mean of both directions: ``mu f_n`` by default."""
        return np.asarray(self.friction_coefficient * self._grip(normal)[0])

    def slip_limit_slope(self, normal: Array) -> Array:
        """Return the derivative of `slip_limit`, shaped as `normal`: mu by default."""
        return np.broadcast_to(np.asarray(self.friction_coefficient * self._grip(normal)[1]), normal.shape)

    def gripping_force(self, normal: Array) -> Array:
        """Return `slip_limit` over the friction coefficient, N: the normal force itself by default."""
        return self._grip(normal)[0]

    def directed_limit(self, force: Array, factor: Array | float = 1.0) -> Array:
        """Return the limit in N in the direction of the friction of contact forces (..., nodes, 3) in N."""
        size = np.hypot(force[..., 0], force[..., 1])
        along = force[..., 0] / np.where(size > 0.0, size, np.inf)
        return np.asarray(factor * self.slip_limit(np.maximum(force[..., 2], 0.0)) * (1.0 - self.asymmetry * along))

    def factor(self, position: Array, velocity: Array) -> FactorAndSlopes:
        """Return the product of the motion factors at positions (N,) m and velocities (N,) m/s, and its slopes."""
        whole = FactorAndSlopes(np.ones_like(position), np.zeros_like(position), np.zeros_like(position))
        for factor in self.motion_factors:
            one = factor(position, velocity)
            whole = FactorAndSlopes(whole.factor * one.factor,
                                    one.factor * whole.by_position + whole.factor * one.by_position,
                                    one.factor * whole.by_velocity + whole.factor * one.by_velocity)
        return whole

    def _grip(self, normal: Array) -> tuple[Array, Array | float]:
        if self.exponent == 0.0:
            return normal, 1.0
        from fretflow.contact.kernels.cone import grip_all  # the compiler takes as long to import as all the rest

        nodes = normal.shape[-1] if normal.ndim else 1
        given = np.require(normal, dtype=float, requirements=["C", "W"]).reshape(-1, nodes)
        force, slope = np.empty_like(given), np.empty_like(given)
        grip_all(given, np.require(np.broadcast_to(self.reference_force, nodes), dtype=float, requirements=["C", "W"]),
                 self.exponent, force, slope)
        return force.reshape(normal.shape), slope.reshape(normal.shape)


class ReturnTangent(NamedTuple):
    """Derivative of the return mapping: ``df = direct dp + mirrored conj(dp) + radial dlimit``."""

    direct: Array
    mirrored: NDArray[np.complex128]
    radial: NDArray[np.complex128]


def return_mapping(trial: NDArray[np.complex128], limit: Array) -> NDArray[np.complex128]:
    """Return the tangential force: `trial`, projected radially onto the disc of radius `limit`."""
    return _projected(trial, limit)[0]


def return_tangent(trial: NDArray[np.complex128], limit: Array) -> ReturnTangent:
    """Return the exact derivative of `return_mapping`."""
    return _projected(trial, limit)[1]


def _projected(trial: NDArray[np.complex128], limit: Array) -> tuple[NDArray[np.complex128], ReturnTangent]:
    from fretflow.contact.kernels.cone import project_all

    given = np.require(trial, dtype=complex, requirements=["C", "W"])
    radius = np.require(np.broadcast_to(limit, given.shape), dtype=float, requirements=["C", "W"])
    force, direct, mirrored, radial = (np.empty(given.shape, dtype=kind) for kind in (complex, float, complex, complex))
    project_all(*(part.reshape(-1) for part in (given, radius, force, direct, mirrored, radial)))
    return force, ReturnTangent(direct, mirrored, radial)


class ContactAudit(NamedTuple):
    """Largest violations over all nodes and samples, forces relative to `scale` of `audit_contact`."""

    tension: float
    penetration: float
    complementarity: float
    cone: float
    slip_direction: float


def audit_contact(opening: Array, force: Array, slip: NDArray[np.complex128], limit: Array, length: float = 0.0,
                  tolerance: float = 1e-9, load: float = 0.0) -> ContactAudit:
    """Check unilateral contact and Coulomb's cone at every node and sample.

    Parameters
    ----------
    opening
        Gap plus normal relative displacement in m, (N, nodes).
    force
        Contact force on the upper nodes in N, (N, nodes, 3).
    slip
        Tangential displacement since the sample before, x + i y in m, (N, nodes).
    limit
        Largest tangential force in N, (N, nodes).
    length
        Motion that counts as large in m, if none of the above is; it separates stuck nodes from round-off.
    tolerance
        Violation allowed, relative to the largest force and the largest motion.
    load
        Force that counts as large in N, if none of the above is: where nothing touches there is round-off alone.

    Raises
    ------
    AuditError
        If a node pulls, penetrates, carries force while open, leaves the cone, or slides inside it or along
        it.
    """
    normal, tangential = force[..., 2], force[..., 0] + 1j * force[..., 1]
    newton = max(float(np.abs(force).max()), load) or 1.0
    metre = float(max(np.abs(slip).max(), np.abs(opening).max(), length)) or 1.0
    moves = np.abs(slip) > tolerance * metre
    # sliding is against the force, which then lies on the cone: f |s| + limit s = 0
    against = np.where(moves & (normal > 0.0), np.abs(tangential * np.abs(slip) + limit * slip), 0.0)
    audit = ContactAudit(
        tension=float(max(0.0, -normal.min()) / newton), penetration=float(max(0.0, -opening.min()) / metre),
        complementarity=float(np.abs(normal * opening).max() / (newton * metre)),
        cone=float(max(0.0, (np.abs(tangential) - limit).max()) / newton),
        slip_direction=float(against.max() / (newton * metre)))
    worst = max(range(len(audit)), key=lambda i: audit[i])
    if not audit[worst] <= tolerance:
        raise AuditError(f"contact law violated: {audit._fields[worst]} {audit[worst]:.2e} above "
                         f"{tolerance:.0e}; tighten the solver's tolerance")
    return audit
