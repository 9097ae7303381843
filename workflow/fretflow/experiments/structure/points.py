"""What is compared of a measured backbone: few averaged points, and the noise that their scatter tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.experiments.structure.responses import backbone_of
from fretflow.recordings.kinds.structures import FEWEST, MeasuredBackbone, StructureRecording
from fretflow.solvers.nonlinear_modes.ring_down import instantaneous_mode

Array = NDArray[np.float64]

MOST_POINTS = 24  # of a backbone that is compared; more are averaged, as neighbours tell the same
ORDERS = (1, 3)  # of polynomials through the neighbours about which values scatter; a curved one needs the higher
NORMAL_QUARTILE = 0.6745  # of a normal error of unit sd
ROUGH = {"frequency": 1e-4, "damping": 0.02}  # relative sd where neither the file nor the scatter tells it


@dataclass(frozen=True)
class BackbonePoints:
    """P points of a measured backbone, averaged: amplitude as recorded, frequency (Hz), damping, and their sd (P,)."""

    amplitude: Array
    frequency: Array
    damping: Array | None
    frequency_sd: Array
    damping_sd: Array

    @classmethod
    def of(cls, backbone: MeasuredBackbone) -> BackbonePoints:
        """Return at most `MOST_POINTS` points; noise that is not stated is read off how neighbours differ."""
        count = len(backbone.amplitude)
        place = np.log(backbone.amplitude)
        groups = [own for own in np.array_split(np.arange(count), min(count, MOST_POINTS)) if len(own)]
        size = np.sqrt([len(own) for own in groups])

        def averaged(values: Array) -> Array:
            return np.array([values[own].mean() for own in groups])

        def noise(values: Array, stated: float | None, name: str) -> Array:
            mean = np.abs(averaged(values))
            if stated is not None:
                one = np.full(len(groups), stated)
            elif count < 8:
                one = np.full(len(groups), ROUGH[name] * float(np.mean(values)))
            else:
                one = averaged(noise_of(place, values))
            return np.maximum(one / size, 1e-6 * mean)

        damping = backbone.damping
        return cls(amplitude=np.exp(averaged(place)), frequency=averaged(backbone.frequency),
                   damping=None if damping is None else averaged(damping),
                   frequency_sd=noise(backbone.frequency, backbone.frequency_sd, "frequency"),
                   damping_sd=np.zeros(0) if damping is None else noise(damping, backbone.damping_sd, "damping"))

    def first(self, count: int) -> BackbonePoints:
        """Return the `count` points of the smallest amplitudes."""
        return BackbonePoints(self.amplitude[:count], self.frequency[:count],
                      None if self.damping is None else self.damping[:count], self.frequency_sd[:count],
                      self.damping_sd[:count])


def with_backbone(recording: StructureRecording) -> StructureRecording:
    """Return a recording with the backbone that its decay or its responses tell, where it has no other.

    Raises
    ------
    InputError
        If no channel of the decay is an output of the structure, or it is too short.
    """
    decay = recording.ring_down
    if recording.backbone is None and decay is None and recording.responses:
        return replace(recording, backbone=backbone_of(recording.responses))
    if recording.backbone is not None or decay is None:
        return recording
    name = next((one for one in decay.channels if one in recording.matrices.outputs), None)
    if name is None:
        raise InputError(f"ring_down: none of {', '.join(decay.channels)} is an output of the structure; it has "
                         f"{', '.join(recording.matrices.outputs) or 'none'}")
    signal = decay.channels[name]
    step = float(np.median(np.diff(decay.time)))
    lines = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(signal))))
    seen = instantaneous_mode(decay.time, signal, float(np.argmax(lines)) / (len(signal) * step))
    rising = np.argsort(seen.amplitude)
    rising = rising[(seen.damping[rising] > 0.0) & (seen.amplitude[rising] > 0.0)]
    if len(rising) < FEWEST:
        raise InputError("ring_down: too little of it decays to tell frequency and damping over amplitude")
    return replace(recording, backbone=MeasuredBackbone(
        amplitude_of=name, mode=None, amplitude=seen.amplitude[rising], amplitude_unit=decay.units[name],
        frequency=seen.frequency[rising], damping=seen.damping[rising], frequency_sd=None, damping_sd=None,
        calibration_sd=0.0))


def noise_of(place: Array, values: Array) -> Array:
    """Return the sd (P,) of values: the same for all, or in proportion to them, whichever their scatter fits better."""
    fits = []
    for size, order in product((np.ones_like(values), np.maximum(np.abs(values), np.finfo(float).tiny)), ORDERS):
        left = _about_neighbours(place, values, size, order)
        if left.size:
            sd = _robust_sd(left)
            # robust likelihood of a value: of Laplace's density, as kinks of a curve are among what is left
            misfit = np.sqrt(2.0) * float(np.mean(np.abs(left))) / sd
            fits.append((float(np.mean(np.log(sd * size))) + misfit, sd * size))
    return np.asarray(min(fits, key=lambda one: one[0])[1])


def scatter(place: Array, values: Array) -> float:
    """Return the sd of values (P,) about smooth curves through their neighbours, robust against few outliers."""
    left = (_about_neighbours(place, values, np.ones_like(values), order) for order in ORDERS)
    return min((_robust_sd(one) for one in left if one.size), default=0.0)


def _robust_sd(left: Array) -> float:
    return max(float(np.median(np.abs(left))) / NORMAL_QUARTILE, 1e-12)


def _about_neighbours(place: Array, values: Array, size: Array, order: int) -> Array:
    """Return by how much values (P,) miss polynomials of `order` through their neighbours, (P - order - 1,).

    In units of the sd of that if the sd of each value were `size`: divided differences, as T. Gasser, L. Sroka,
    C. Jennen-Steinmetz, Biometrika 73 (1986) 625 take them of the first order.
    """
    count = len(values) - order - 1
    if count < 1:
        return np.zeros(0)
    rows = np.arange(count)[:, None] + np.arange(order + 2)
    at = (place + 1e-9 * np.arange(len(place)))[rows]  # amplitudes may repeat
    apart = at[:, :, None] - at[:, None, :] + np.eye(order + 2)
    weight: Array = (at[:, -1:] - at[:, :1])**(order + 1) / np.prod(apart, axis=2)
    missed = np.sum(weight * values[rows], axis=1)
    return np.asarray(missed / np.sqrt(np.sum((weight * size[rows])**2, axis=1)))
