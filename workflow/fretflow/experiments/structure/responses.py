"""What responses under control tell of a mode: a backbone, and the force that a model needs for them.

Where a motion of amplitude x is held, the structure is a linear oscillator of that amplitude's frequency and damping:
the square of force over motion is a parabola in X = Omega^2 ::

    (F / x)^2 = c (X^2 - 2 omega^2 (1 - 2 zeta^2) X + omega^4)

whose three coefficients, by least squares weighted with 1 / F^2 as errors go with the force, give omega, zeta and c
(response-controlled testing: T. Karaagacli, H. N. Ozguven, MSSP 159 (2021) 107740). Where the force is held, the
largest amplitude is near the phase resonance, whose frequency is that of the backbone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import Array
from fretflow.inference.verdict import MeasuredCurve
from fretflow.recordings.kinds.structure_sections import Control
from fretflow.recordings.kinds.structures import FEWEST, MOTIONS, ControlledResponse, MeasuredBackbone
from fretflow.solvers.nonlinear_modes.joint import LinearMode
from fretflow.solvers.nonlinear_modes.quasi_static import ModalBackbone
from fretflow.solvers.nonlinear_modes.response import force_of_response
from fretflow.structure.reduction.contact_modes import ReducedStructure

POWERS = {unit: power for power, unit in enumerate(MOTIONS)}  # of the angular frequency, in an amplitude of motion


def backbone_of(responses: Sequence[ControlledResponse]) -> MeasuredBackbone:
    """Return the backbone that responses at several levels tell: of held motions if there are enough of them.

    Raises
    ------
    InputError
        If there are too few levels, or they are of different outputs.
    """
    held = [one for one in responses if one.control is Control.RESPONSE and one.force is not None]
    chosen = held if len(held) >= FEWEST else [one for one in responses if one.control is Control.FORCE]
    if len(chosen) < FEWEST:
        raise InputError(f"frf: {len(chosen)} levels tell no trend over the amplitude; give {FEWEST} or more with the "
                         "response held and its force, or with the force held")
    if len({(one.of, one.amplitude_unit) for one in chosen}) > 1:
        raise InputError("frf: responses are of different outputs; give those of one")
    points = np.array(sorted(oscillator(one) if chosen is held else resonance(one) for one in map(in_order, chosen)))
    return MeasuredBackbone(
        amplitude_of=chosen[0].of, mode=None, amplitude=points[:, 0], amplitude_unit=chosen[0].amplitude_unit,
        frequency=points[:, 1], damping=points[:, 2] if chosen is held else None, frequency_sd=None, damping_sd=None,
        calibration_sd=0.0)


def oscillator(one: ControlledResponse) -> tuple[float, float, float]:
    """Return amplitude, natural frequency (Hz) and damping ratio of a response whose motion is held.

    Raises
    ------
    InputError
        If the force has no least value within its frequencies.
    """
    if one.force is None:
        raise InputError("frf: the force of a response whose motion is held is required")
    if len(one.frequency) <= FEWEST:
        raise InputError(f"frf: {len(one.frequency)} frequencies do not tell a resonance; give {FEWEST + 1} or more")
    omega = 2.0 * np.pi * one.frequency
    motion = one.amplitude / omega**POWERS[one.amplitude_unit]
    square = (one.force / motion)**2
    scale = float(np.mean(omega**2))
    x = omega**2 / scale - 1.0  # about its middle, or round-off wins
    curved, slope, level = np.polyfit(x, square, 2, w=1.0 / square)
    least = -0.5 * slope / max(curved, 1e-300)
    low = level + 0.5 * slope * least
    if not (curved > 0.0 and x.min() < least < x.max() and low > 0.0):
        raise InputError("frf: a response's force has no least value within its frequencies; widen them")
    # of c ((X - X0)^2 + d): X0 = omega^2 (1 - 2 zeta^2), d = 4 zeta^2 omega^4 (1 - zeta^2)
    middle, rest = 1.0 + least, low / curved
    natural = (middle**2 + rest)**0.25
    damping = np.sqrt(max(0.5 * (1.0 - middle / natural**2), 0.0))
    return float(np.mean(one.amplitude)), float(natural * np.sqrt(scale) / (2.0 * np.pi)), float(damping)


def in_order(one: ControlledResponse) -> ControlledResponse:
    """Return a response with its frequencies rising, each of them once: of rows that repeat one their mean."""
    frequency, place, count = np.unique(one.frequency, return_inverse=True, return_counts=True)
    return replace(one, frequency=frequency, amplitude=np.bincount(place, one.amplitude) / count, phase=None,
                   force=None if one.force is None else np.bincount(place, one.force) / count)


def resonance(one: ControlledResponse) -> tuple[float, float, float]:
    """Return the largest amplitude and where it is, by a parabola through it and its neighbours.

    Raises
    ------
    InputError
        If the amplitude has no largest value within its frequencies.
    """
    seen = one.amplitude if one.force is None else one.amplitude * (float(np.mean(one.force)) / one.force)
    at = int(np.argmax(seen))
    if not 0 < at < len(seen) - 1:
        raise InputError("frf: a response with the force held has no largest amplitude within its frequencies; widen "
                         "them")
    curved, slope, level = np.polyfit(one.frequency[at - 1:at + 2] - one.frequency[at], seen[at - 1:at + 2], 2)
    off = -0.5 * slope / curved if curved < 0.0 else 0.0
    return float(level + 0.5 * slope * off), float(one.frequency[at] + off), 0.0


def required_force(curve: ModalBackbone, structure: ReducedStructure, mode: LinearMode, one: ControlledResponse
                   ) -> Array:
    """Return the force (P,), N, that a model needs for a recorded response; nan beyond its backbone's amplitudes."""
    rows = {**structure.outputs, **structure.inputs}
    on_contact, on_modes = structure.outputs[one.of] if one.at is None else rows[one.at]
    shape = abs(float(on_contact @ mode.contact + on_modes @ mode.modes))
    moved = np.abs(curve.outputs[:, curve.output_names.index(one.of)])
    order = np.argsort(moved)
    motion = one.amplitude / (2.0 * np.pi * one.frequency)**POWERS[one.amplitude_unit]
    modal = np.exp(np.interp(np.log(motion), np.log(moved[order]), np.log(curve.amplitude[order]), np.nan, np.nan))
    force = np.full(len(modal), np.nan)
    for k in np.flatnonzero(np.isfinite(modal)) if shape > 0.0 else ():
        within = float(np.clip(modal[k], curve.amplitude.min(), curve.amplitude.max()))
        force[k] = force_of_response(curve, shape, within, one.frequency[k:k + 1]).force[0]
    return force


def response_curves(responses: Sequence[ControlledResponse], structure: ReducedStructure,
                    models: Sequence[tuple[ModalBackbone, LinearMode]]) -> tuple[MeasuredCurve, ...]:
    """Return the force of each response as measured and as two models, before and after, need it."""
    made = []
    for k, one in enumerate(map(in_order, responses)):
        if one.force is None:
            continue
        before, after = (required_force(curve, structure, mode, one) for curve, mode in models)
        known = np.isfinite(before) & np.isfinite(after)
        if known.sum() > 1:
            made.append(MeasuredCurve(
                label=f"response {k + 1}, {one.control} held", x_label="frequency", x_unit="Hz",
                y_label="force for the measured motion", y_unit="N", x=one.frequency[known], measured=one.force[known],
                before=before[known], after=after[known]))
    return tuple(made)
