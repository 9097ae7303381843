"""Coulomb's cone at one node and instant, compiled: every limit, slope and return mapping in the package is this one.

With friction coefficient mu, a factor g of the instant, the normal force N, the node's reference force N_0 and the
direction t of the friction force,

    |f_t| <= L(N, t) = g mu l(N) (1 - d t_x),    l(N) = N (N / N_0)^-b

see `contact.coulomb`. Below `SMALLEST_LOAD` of N_0 the power stays what it is there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.core.compiled import compiled
from fretflow.core.records import Array

SMALLEST_LOAD = 1e-3  # of the reference force: below it a power law of the load would let friction grow without bound
SMALLEST = float(np.finfo(float).tiny)


@compiled
def gripping(normal: float, reference: float, exponent: float) -> tuple[float, float]:
    """Return l(N), the friction limit over the coefficient in N, and its derivative by the normal force."""
    if exponent == 0.0:
        return normal, 1.0
    share = normal / reference
    factor = max(share, SMALLEST_LOAD)**-exponent
    return normal * factor, factor * (1.0 - exponent if share > SMALLEST_LOAD else 1.0)


@compiled
def project(trial: complex, limit: float) -> complex:
    """Return the friction force: `trial`, what sticking would need, projected radially onto the disc of `limit`."""
    size = abs(trial)
    return trial * (limit / max(size, SMALLEST)) if size > limit else trial


@compiled
def project_slope(trial: complex, limit: float) -> tuple[float, complex, complex]:
    """Return the derivative of `project`: ``df = a dp + b conj(dp) + n dL`` as (a, b, n).

    In slip, with direction ``n = p / |p|`` and ``s = L / |p|``: ``df = s (dp - n Re(conj(n) dp)) + n dL``.
    """
    size = max(abs(trial), SMALLEST)
    if size > limit:
        scale, direction = 0.5 * limit / size, trial / size
        return scale, -scale * direction * direction, direction
    return 1.0, 0.0j, 0.0j


@compiled
def limit(law: tuple[float, float, float, float], factor: float, normal: float, along: float) -> tuple[float, float]:
    """Return L and its derivative by the normal force, for friction in a direction with x component `along`.

    `law` is mu, N_0, b and d of the node; `factor` is g.
    """
    mu, reference, exponent, asymmetry = law
    force, slope = gripping(normal, reference, exponent)
    share = factor * mu * (1.0 - asymmetry * along)
    return share * force, share * slope


@compiled
def grip_all(normal: Array, reference: Array, exponent: float, force: Array, slope: Array) -> None:
    """Put l(N) and its derivative into `force` and `slope`, all (samples, nodes); the reference is (nodes,)."""
    for j in range(len(normal)):
        for i in range(normal.shape[1]):
            force[j, i], slope[j, i] = gripping(normal[j, i], reference[i], exponent)


@compiled
def project_all(trial: NDArray[np.complex128], radius: Array, force: NDArray[np.complex128], direct: Array,
                mirrored: NDArray[np.complex128], radial: NDArray[np.complex128]) -> None:
    """Put `project` and `project_slope` of all of (size,) into the results."""
    for i in range(len(trial)):
        force[i] = project(trial[i], radius[i])
        direct[i], mirrored[i], radial[i] = project_slope(trial[i], radius[i])
