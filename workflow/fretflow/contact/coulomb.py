"""Coulomb friction with unilateral contact: return mapping, its tangent, and the audit of a period.

Prediction and correction as in Nacivet, Pierre, Thouverez, Jezequel, J. Sound Vib. 265 (2003) 201-219,
sections 3.3-3.4: the force that sticking would need is kept inside the friction disc and projected onto it
from outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import AuditError, InputError
from fretflow.core.records import quantity, record

TINY = np.finfo(float).tiny
SMALLEST_LOAD = 1e-3  # of the reference force; below it the coefficient stays what it is there


@record
class CoulombLaw:
    """Coulomb's law ``|f_t| <= mu f_n`` (a `contact.law.ContactLaw`).

    Its coefficient may fall with the normal force, ``mu (f_n / f_0)^-b``, and differ with the direction of the
    friction force t by the factor ``1 - d t_x``: sliding to positive x, against t_x = -1, meets ``mu (1 + d)``.
    """

    friction_coefficient: NDArray[np.float64] = quantity("1", "() or (nodes,)")
    exponent: float = quantity("1", default=0.0)  # b
    reference_force: NDArray[np.float64] | float = quantity("N", "() or (nodes,)", default=1.0)
    asymmetry: float = quantity("1", default=0.0)  # d

    def check(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            If a friction coefficient is negative or not finite, the exponent does not lie in [0, 1), or the asymmetry
            not within (-1, 1).
        """
        mu = np.asarray(self.friction_coefficient)
        if not (np.all(np.isfinite(mu)) and np.all(mu >= 0.0)):
            raise InputError("friction_coefficient: must be finite and not negative at every node")
        if not (0.0 <= self.exponent < 1.0 and -1.0 < self.asymmetry < 1.0):
            raise InputError(f"friction: exponent {self.exponent} must lie in [0, 1) and asymmetry {self.asymmetry} "
                             "between -1 and 1")

    def slip_limit(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the limit in N in the mean of both directions: ``mu f_n`` by default."""
        return np.asarray(self.friction_coefficient * self.gripping_force(normal))

    def slip_limit_slope(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative of `slip_limit`, shaped as `normal`: mu by default."""
        if self.exponent == 0.0:
            return np.broadcast_to(self.friction_coefficient, normal.shape)
        share = normal / self.reference_force
        falls = np.where(share > SMALLEST_LOAD, 1.0 - self.exponent, 1.0)
        return np.asarray(self.friction_coefficient * falls * np.maximum(share, SMALLEST_LOAD)**-self.exponent)

    def gripping_force(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `slip_limit` over the friction coefficient, N: the normal force itself by default."""
        if self.exponent == 0.0:
            return normal
        share = np.maximum(normal / self.reference_force, SMALLEST_LOAD)
        return np.asarray(normal * share**-self.exponent)


class ReturnTangent(NamedTuple):
    """Derivative of the return mapping: ``df = direct dp + mirrored conj(dp) + radial dlimit``."""

    direct: NDArray[np.float64]
    mirrored: NDArray[np.complex128]
    radial: NDArray[np.complex128]


def return_mapping(trial: NDArray[np.complex128], limit: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the tangential force: `trial`, projected radially onto the disc of radius `limit`."""
    return np.asarray(trial * np.minimum(1.0, limit / np.maximum(np.abs(trial), TINY)))


def return_tangent(trial: NDArray[np.complex128], limit: NDArray[np.float64]) -> ReturnTangent:
    """Return the exact derivative of `return_mapping`.

    In slip, with direction ``n = p / |p|`` and ``s = limit / |p|``: ``df = s (dp - n Re(conj(n) dp)) + n
    dlimit``.
    """
    size = np.maximum(np.abs(trial), TINY)
    slips = size > limit
    direction = np.where(slips, trial / size, 0.0)
    scale = np.where(slips, 0.5 * limit / size, 1.0)
    return ReturnTangent(direct=scale, mirrored=-scale * direction**2, radial=direction)


class ContactAudit(NamedTuple):
    """Largest violations over all nodes and samples, forces relative to `scale` of `audit_contact`."""

    tension: float
    penetration: float
    complementarity: float
    cone: float
    slip_direction: float


def audit_contact(opening: NDArray[np.float64], force: NDArray[np.float64], slip: NDArray[np.complex128],
                  limit: NDArray[np.float64], length: float = 0.0, tolerance: float = 1e-9) -> ContactAudit:
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

    Raises
    ------
    AuditError
        If a node pulls, penetrates, carries force while open, leaves the cone, or slides inside it or along
        it.
    """
    normal, tangential = force[..., 2], force[..., 0] + 1j * force[..., 1]
    newton = float(np.abs(force).max()) or 1.0
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
