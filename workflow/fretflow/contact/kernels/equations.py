"""The equations of quasi-static frictional contact at one sample, compiled: the data, the residual and its change.

The equations and the choice of unknowns are those of `solvers.quasi_static.sample`; here are plain arrays and no
objects. DOF ``3 i + c`` is direction c of node i, as everywhere. With m slipping and o open nodes there are
q = 2 m + 3 o unknowns: x of the slipping nodes, their y, then x, y, z of the open ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.cone import limit
from fretflow.contact.law import ContactState
from fretflow.core.compiled import compiled

Array = NDArray[np.float64]
States = NDArray[np.int8]
Indices = NDArray[np.int64]
STICK, SLIP, SEPARATION = int(ContactState.STICK), int(ContactState.SLIP), int(ContactState.SEPARATION)


class Contact(NamedTuple):
    """The contact's data: elastic force ``f = K u - R q - r``, gap and the law of friction.

    `stiffness` K (3 n, 3 n), `coupling` R (3 n, d) and penalty rho in N/m, `gap` (n,) m; `felt` T K and `felt_coupling`
    T R give the force T f that the coordinates feel. `friction`, `reference` (n,): see `contact.coulomb`.
    """

    stiffness: Array
    coupling: Array
    felt: Array
    felt_coupling: Array
    gap: Array
    friction: Array
    reference: Array
    exponent: float
    asymmetry: float
    penalty: float


@compiled
def law_at(c: Contact, i: int) -> tuple[float, float, float, float]:
    """Return the law of node i as `cone.limit` takes it."""
    return c.friction[i], c.reference[i], c.exponent, c.asymmetry


@compiled
def try_forces(c: Contact, u: Array, f: Array, previous: Array, trial: Array) -> None:
    """Put direction and size of the trial force tau into `trial` (3, n)."""
    for i in range(len(c.gap)):
        x = f[3 * i] - c.penalty * (u[3 * i] - previous[3 * i])
        y = f[3 * i + 1] - c.penalty * (u[3 * i + 1] - previous[3 * i + 1])
        size = max(np.hypot(x, y), 1e-300)
        trial[0, i], trial[1, i], trial[2, i] = x / size, y / size, size


@compiled
def turn_cone(c: Contact, f: Array, trial: Array, factor: float, cone: Array) -> None:
    """Put the friction limit L, its slope dL/df_z and how L t turns, two rows, into `cone` (4, n).

    L t changes by ``-across w`` where tau turns by w across t.
    """
    for i in range(len(c.gap)):
        x, y, d = trial[0, i], trial[1, i], c.asymmetry
        normal = max(f[3 * i + 2], 0.0)
        cone[0, i], cone[1, i] = limit(law_at(c, i), factor, normal, x)
        # dL/dt_x = -d L / (1 - d t_x), of the mean of both directions
        turned = cone[0, i] / trial[2, i]
        leaning = d * turned / (1.0 - d * x) * y
        cone[2, i] = turned * y - leaning * x
        cone[3, i] = -turned * x - leaning * y


@compiled
def unknowns(state: States) -> tuple[int, Indices]:
    """Return the number of slipping nodes and the unknown DOFs (q,)."""
    m, o = 0, 0
    for i in range(len(state)):
        m += state[i] == SLIP
        o += state[i] == SEPARATION
    unknown = np.empty(2 * m + 3 * o, dtype=np.int64)
    a, b = 0, 2 * m
    for i in range(len(state)):
        if state[i] == SLIP:
            unknown[a], unknown[m + a] = 3 * i, 3 * i + 1
            a += 1
        elif state[i] == SEPARATION:
            for k in range(3):
                unknown[b + k] = 3 * i + k
            b += 3
    return m, unknown


@compiled
def residual_of(f: Array, trial: Array, cone: Array, m: int, unknown: Indices) -> Array:
    """Return the residual (q,) in N: forces of the open nodes, friction beyond the cone's of the slipping ones."""
    residual = np.empty(len(unknown))
    for k in range(m):
        i = unknown[k] // 3
        residual[k] = f[3 * i] - cone[0, i] * trial[0, i]
        residual[m + k] = f[3 * i + 1] - cone[0, i] * trial[1, i]
    for k in range(2 * m, len(unknown)):
        residual[k] = f[unknown[k]]
    return residual


@compiled
def change_of(c: Contact, trial: Array, cone: Array, m: int, unknown: Indices, step: Array, f: Array, change: Array
            ) -> None:
    """Put the change of the residual with a small `step` (q,) and the change f (3 n,) of the force into `change`."""
    for k in range(2 * m, len(unknown)):
        change[k] = f[unknown[k]]
    for k in range(m):
        i = unknown[k] // 3
        x, y, fz = trial[0, i], trial[1, i], cone[1, i] * f[3 * i + 2]
        turned = x * (f[3 * i + 1] - c.penalty * step[m + k]) - y * (f[3 * i] - c.penalty * step[k])
        change[k] = f[3 * i] - fz * x + cone[2, i] * turned
        change[m + k] = f[3 * i + 1] - fz * y + cone[3, i] * turned


@compiled
def dot(a: Array, b: Array) -> float:
    """Return the scalar product."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled
def add(a: Array, share: float, b: Array) -> None:
    """Add a share of `b` to `a`."""
    for k in range(len(a)):
        a[k] += share * b[k]
