"""The inner loops of the marched period of DLFT, compiled; nodes one after the other, each over all samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.cone import project, project_slope
from fretflow.core.compiled import compiled

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
REMEMBERED = 1e-10  # of a state's change, below which a period does not reduce it


@compiled
def _march(state: complex, increments: Complex, limit: Real, trial: Complex, force: Complex) -> complex:
    """March a node over one period (N,); return its last state."""
    for j in range(len(limit)):
        state += increments[j]
        trial[j] = state
        state = project(state, limit[j])
        force[j] = state
    return state


@compiled
def _newton_start(start: complex, end: complex, trial: Complex, limit: Real) -> complex:
    """Return the state that Newton's method expects to repeat; directions that the period keeps are left alone."""
    first, second = 1.0 + 0.0j, 1.0j
    for j in range(len(limit)):
        scale, mirrored, _ = project_slope(trial[j], limit[j])
        if scale != 1.0:
            first = scale * first + mirrored * first.conjugate()
            second = scale * second + mirrored * second.conjugate()
    a, b, c, d = 1.0 - first.real, -second.real, -first.imag, 1.0 - second.imag
    square, determinant = a * a + b * b + c * c + d * d, a * d - b * c
    if square == 0.0:
        return start
    x, y = (end - start).real, (end - start).imag
    largest = 0.5 * (square + np.sqrt(max(square * square - 4.0 * determinant * determinant, 0.0)))
    if abs(determinant) <= REMEMBERED * largest:  # of rank one: its pseudo-inverse is its scaled transpose
        return start + complex((a * x + c * y) / square, (b * x + d * y) / square)
    return start + complex((d * x - b * y) / determinant, (a * y - c * x) / determinant)


@compiled
def settle(drive: Complex, limit: Real, tolerance: float, first_trial: Complex, trial: Complex, force: Complex,
           defects: Real) -> int:
    """Fill the first and the periodic trials and forces (nodes, N); return the number of `defects`, the largest in N.

    There are as many as fit if a state does not repeat within them.
    """
    most, samples = 0, drive.shape[1]
    increments = np.empty(samples, dtype=np.complex128)
    for m in range(len(drive)):
        for j in range(samples):
            increments[j] = drive[m, j] - drive[m, j - 1]
        start = _march(drive[m, samples - 1], increments, limit[m], first_trial[m], force[m])
        for k in range(len(defects)):
            end = _march(start, increments, limit[m], trial[m], force[m])
            defect = abs(end - start)
            defects[k], most = max(defects[k], defect), max(most, k + 1)
            if not defect > tolerance:
                break
            # a plain period between Newton steps keeps the map's non-expansion
            start = end if k % 2 else _newton_start(start, end, trial[m], limit[m])
    return most


@compiled
def march_derivatives(direct: Real, mirrored: Complex, radial: Complex, basis: Real, history: Real) -> None:
    """March the derivatives of the state of every node; its return tangent is given, (nodes, N).

    `history` (nodes, N, 2, 3 q + 2) takes real and imaginary part of the derivatives by the coefficients of the drive
    in x, in y and of the normal drive, then by the two parts of the first state. Its last sample holds those at the
    start.
    """
    samples, q = basis.shape
    for m in range(len(direct)):
        for j in range(samples):
            before, now = history[m, j - 1], history[m, j]
            for c in range(3 * q + 2):
                now[0, c], now[1, c] = before[0, c], before[1, c]
            for i in range(q):
                change = basis[j, i] - basis[j - 1, i]
                now[0, i] += change
                now[1, q + i] += change
            scale, a, b = direct[m, j], mirrored[m, j].real, mirrored[m, j].imag
            if scale == 1.0:
                continue
            for c in range(3 * q + 2):
                x, y = now[0, c], now[1, c]
                now[0, c], now[1, c] = (scale + a) * x + b * y, b * x + (scale - a) * y
            x, y = radial[m, j].real, radial[m, j].imag
            for i in range(q):
                now[0, 2 * q + i] += x * basis[j, i]
                now[1, 2 * q + i] += y * basis[j, i]


@compiled
def period_maps(direct: Real, mirrored: Complex, less: Real) -> None:
    """Put ``I - G`` into `less` (nodes, 2, 2), G being the derivative of the state after a period by the first."""
    for m in range(len(direct)):
        first, second = 1.0 + 0.0j, 1.0j
        for j in range(direct.shape[1]):
            scale, turned = direct[m, j], mirrored[m, j]
            first = scale * first + turned * first.conjugate()
            second = scale * second + turned * second.conjugate()
        less[m, 0, 0], less[m, 0, 1] = 1.0 - first.real, -second.real
        less[m, 1, 0], less[m, 1, 1] = -first.imag, 1.0 - second.imag
