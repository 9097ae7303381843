"""Forced responses about one nonlinear mode, from its backbone.

A force of amplitude F at an input where the mode, M-normalised, moves by phi drives the modal amplitude a at Omega ::

    (omega^2 - Omega^2 + 2 i zeta omega Omega) a = phi F,    omega(a), zeta(a)

(W. Szemplinska-Stupnicka, J. Sound Vib. 63 (1979) 569; M. Krack, L. Panning-von Scheidt, J. Wallaschek, J. Eng. Gas
Turbines Power 135 (2013) 042502), which has at each amplitude at most two frequencies: no continuation is needed.
"""

from __future__ import annotations

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode
from fretflow.solvers.nonlinear_modes.quasi_static import ModalBackbone

FINE = 400  # amplitudes along a response


@record
class ModalResponse:
    """A forced response of P points along the curve, up one side of the resonance and down the other."""

    frequency: Array = quantity("Hz", "(P,)")
    amplitude: Array = quantity("m*kg^0.5", "(P,), modal")
    force: Array = quantity("N", "(P,)")
    outputs: Array = quantity("m", "(P, outputs), amplitudes")


def driven_shape(joint: BoltedJoint, mode: LinearMode, name: str) -> float:
    """Return how an input moves with a mode, 1/kg^0.5.

    Raises
    ------
    InputError
        If the structure has no such input, or it stands still.
    """
    inputs = joint.structure.inputs
    if name not in inputs:
        raise InputError(f"{name!r} is no input of the structure; it has {', '.join(inputs) or 'none'}")
    moved = abs(float(inputs[name][0] @ mode.contact + inputs[name][1] @ mode.modes))
    if not moved > 0.0:
        raise InputError(f"{name!r} stands still in this mode; drive the structure elsewhere")
    return moved


def respond_to_force(curve: ModalBackbone, shape: float, force: float) -> ModalResponse:
    """Return the response to a held force (N) at an input that moves by `shape` (1/kg^0.5), within the backbone.

    Raises
    ------
    InputError
        If the force is not positive, or its resonance lies outside the backbone's amplitudes.
    """
    if not force > 0.0:
        raise InputError(f"force: must be positive, got {force}")
    dense = np.geomspace(curve.amplitude.min(), curve.amplitude.max(), FINE)
    square = _width(curve, dense, shape * force)[1]
    reached = np.flatnonzero(square > 0.0)
    if not len(reached) or reached[-1] == FINE - 1:
        end, way = ("largest", "raise") if len(reached) else ("smallest", "lower")
        raise InputError(f"force: the resonance of {force:g} N lies outside the amplitudes of the backbone, beyond the "
                         f"{end}; {way} it, in files backbone.{end}, or give another force")
    last = int(reached[-1])
    top = float(np.interp(0.0, -square[last:last + 2], dense[last:last + 2]**-2.0))**-0.5
    amplitude = np.append(dense[reached], top)
    middle, square = _width(curve, amplitude, shape * force)
    width = np.sqrt(np.maximum(square, 0.0))
    there = np.flatnonzero(middle > width)
    at = np.concatenate([there, there[::-1]])
    frequency = np.sqrt(np.concatenate([(middle - width)[there], (middle + width)[there[::-1]]])) / (2.0 * np.pi)
    return ModalResponse(frequency=frequency, amplitude=amplitude[at], force=np.full(len(at), force),
                         outputs=_interpolated(curve, amplitude[at])[2])


def force_of_response(curve: ModalBackbone, shape: float, amplitude: float, frequency: Array) -> ModalResponse:
    """Return the force at each frequency (P,), Hz, that holds a modal amplitude (m kg^0.5) within the backbone.

    Raises
    ------
    InputError
        If the amplitude lies outside the backbone's.
    """
    low, high = float(curve.amplitude.min()), float(curve.amplitude.max())
    if not low <= amplitude <= high:
        raise InputError(f"amplitude: {amplitude:g} lies outside the backbone's, {low:g} to {high:g}")
    omega, zeta, outputs = _interpolated(curve, np.array([amplitude]))
    driven = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    return ModalResponse(
        frequency=driven / (2.0 * np.pi), amplitude=np.full(len(driven), amplitude),
        force=amplitude / shape * np.abs(omega**2 - driven**2 + 2j * zeta * omega * driven),
        outputs=np.repeat(outputs, len(driven), axis=0))


def _width(curve: ModalBackbone, amplitude: Array, drive: float) -> tuple[Array, Array]:
    """Return the mean of both squared frequencies at each amplitude, and the square of half their difference."""
    omega, zeta, _ = _interpolated(curve, amplitude)
    return omega**2 * (1.0 - 2.0 * zeta**2), (drive / amplitude)**2 - 4.0 * zeta**2 * omega**4 * (1.0 - zeta**2)


def _interpolated(curve: ModalBackbone, amplitude: Array) -> tuple[Array, Array, Array]:
    """Return omega (P,), zeta (P,) and the outputs (P, outputs) at amplitudes."""
    order = np.argsort(curve.amplitude)
    grid, at = np.log(curve.amplitude[order]), np.log(amplitude)
    omega, zeta, *outputs = (np.interp(at, grid, values[order]) for values in (
        2.0 * np.pi * curve.frequency, curve.damping, *np.abs(curve.outputs.T)))
    return omega, zeta, np.array(outputs).reshape(-1, len(at)).T
