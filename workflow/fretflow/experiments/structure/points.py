"""What is compared of a measured backbone: few averaged points, and the noise that their scatter tells.

Errors have a density of Student's t, whose width and tails scatter tells (K. L. Lange, R. J. A. Little, J. M. G.
Taylor, J. Am. Stat. Assoc. 84 (1989) 881-896). As the expectation maximisation of such a density has it, each point
counts as normal with a variance of its own, large where it is far off a smooth curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.stats import chi2, multivariate_normal
from scipy.stats import t as student

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.experiments.independent import FREEDOM
from fretflow.experiments.structure.responses import backbone_of
from fretflow.inference.verdict import FALSE_ALARMS
from fretflow.recordings.kinds.structures import FEWEST, MeasuredBackbone, StructureRecording
from fretflow.recordings.notes import Note
from fretflow.solvers.nonlinear_modes.ring_down import MASING, InstantaneousMode, instantaneous_mode

Array = NDArray[np.float64]

MOST_POINTS = 24  # of a backbone that is compared; more are averaged, as neighbours tell the same
ORDERS = (1, 3)  # of polynomials through the neighbours about which values scatter; a curved one needs the higher
SLIDES = ("backbone: the joint slides as a whole at all recorded amplitudes; raise bolt_load's range, or check "
          "the unit of the amplitude")
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
    def of(cls, backbone: MeasuredBackbone, predicted: Sequence[Array] = ()) -> BackbonePoints:
        """Return at most `MOST_POINTS` points; noise is read off how neighbours differ.

        They may also differ from what some models have `predicted`, each (channels, P).
        """
        count = len(backbone.amplitude)
        place = np.log(backbone.amplitude)
        first = np.flatnonzero(np.diff(place, prepend=-np.inf) > 0.0)  # amplitudes may repeat
        groups = np.split(np.arange(count), [own[0] for own in np.array_split(first, min(len(first), MOST_POINTS))][1:])
        size = np.sqrt([len(own) for own in groups])

        def averaged(values: Array) -> Array:
            return np.array([values[own].mean() for own in groups])

        def noise(values: Array, stated: float | None, name: str) -> Array:
            if stated is not None:
                one = np.full(len(groups), stated)
            elif count < 8:
                one = np.full(len(groups), ROUGH[name] * float(np.mean(values)))
            else:
                curves = [np.interp(place, averaged(place), one[list(ROUGH).index(name)]) for one in predicted]
                one = averaged(noise_of(place, values, ROUGH[name], curves))
            return np.maximum(one / size, 1e-6 * np.abs(averaged(values)))

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

    @property
    def of_decay(self) -> Array:
        """Return by how much damping ratios (P,) are less if what was recorded is the decrement of a decay."""
        place = np.log(self.amplitude)
        return np.asarray(MASING * np.gradient(np.log(self.frequency), place) * (
            np.zeros_like(place) if self.damping is None else self.damping))

    def read(self, at: Array, seen: Array, frequency: Array, damping: Array) -> Array:
        """Return frequency and damping (channels, points) at amplitudes from those `seen` at others."""
        order = np.argsort(seen)
        place = np.log(seen[order])
        keep = np.r_[True, np.diff(place) > 1e-9]
        place, order = place[keep], order[keep]
        if len(place) < 2:
            raise NonConvergenceError(SLIDES)
        channels = (frequency,) if self.damping is None else (frequency, damping)
        return np.array([_along(place, one[order], np.log(at)) for one in channels])

    def weighed(self, missed: Array) -> BackbonePoints:
        """Return the same with larger errors where a prediction misses values (channels, P) by more than smoothly."""
        place, sd = np.log(self.amplitude), (self.frequency_sd, self.damping_sd)
        return replace(self, **{name: own / np.sqrt(weights_of(place, one, own)) for name, own, one in zip(
            ("frequency_sd", "damping_sd"), sd, missed, strict=False)})


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
    seen = instantaneous_mode(decay.time, signal, (1 + int(np.argmax(lines[1:]))) / (len(signal) * step))
    told = above_noise(seen)
    rising = np.argsort(seen.amplitude[:told])
    rising = rising[(seen.damping[rising] > 0.0) & (seen.amplitude[rising] > 0.0)]
    if len(rising) < FEWEST:
        raise InputError("ring_down: too little of it decays above its noise to tell frequency and damping")
    parts, notes = len(seen.amplitude), recording.notes
    if told < parts:
        notes = (*notes, Note("ring_down", f"{parts - told} of its {parts} parts, from where it is ten times the noise "
                                           "that it ends in, are left out"))
    return replace(recording, notes=notes, backbone=MeasuredBackbone(
        amplitude_of=name, mode=None, amplitude=seen.amplitude[rising], amplitude_unit=decay.units[name],
        frequency=seen.frequency[rising], damping=seen.damping[rising], frequency_sd=None, damping_sd=None,
        calibration_sd=0.0))


def above_noise(seen: InstantaneousMode) -> int:
    """Return how many windows of a decay, from its first on, are ten times above the noise that it ends in.

    Noise is as likely to rise as to fall: where any of the last windows does not fall, they are noise. At a tenth of
    the amplitude it moves a window's logarithm by a tenth. A decay that falls throughout is told to its end.
    """
    last = slice(-max(4, len(seen.amplitude) // 10), None)
    if np.all(seen.damping[last] > 0.0):
        return len(seen.amplitude)
    noise = float(np.sqrt(np.mean(seen.amplitude[last]**2)))
    near = np.flatnonzero(seen.amplitude < 10.0 * noise)
    near = near[near > int(np.argmax(seen.amplitude))]  # before it, what starts the motion may not be there yet
    return int(near[0]) if near.size else len(seen.amplitude)


def noise_of(place: Array, values: Array, rough: float, curves: Sequence[Array] = ()) -> Array:
    """Return the sd (P,) of values: the same for all, or in proportion to them, each as probable as their scatter says.

    They scatter about polynomials, or about these beside one of predicted `curves`, each (P,): points that slide one by
    one make kinks, which are no noise.

    Where the scatter does not tell, as with few points where the values are large, both count, in their variances
    (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Stat. Sci. 14 (1999) 382-417). Few points also tell by
    chance too small a scatter: the variance is the mean of its posterior, which has n values of these and two of a
    relative sd `rough` beforehand (conjugate: A. Gelman et al., Bayesian Data Analysis (2014), section 2.6).
    """
    fits = []
    size, known = np.maximum(np.abs(values), np.finfo(float).tiny), rough * np.abs(values)
    for own, scale, order in product((values, *(values - one for one in curves)), (np.ones_like(values), size), ORDERS):
        left = _about_neighbours(place, own, scale, order)
        if left.size:
            (width, likelihood), n = _student(left), independent(len(values), order)
            fits.append((n * (likelihood - float(np.mean(np.log(scale)))), (width * scale)**2 + 2.0 / n * known**2))
    top = max(one[0] for one in fits)
    weights = np.exp([one[0] - top for one in fits])
    return np.asarray(np.sqrt(np.average([one[1] for one in fits], axis=0, weights=weights)))


def independent(count: int, order: int) -> float:
    """Return how many independent values the differences of `order` of so many are worth for a variance.

    They have neighbours in common: it is their number over the sum of their squared correlations (M. S. Bartlett,
    J. R. Stat. Soc. 98 (1935) 536), at even spacing.
    """
    weight = np.poly(np.ones(order + 1))
    shared = np.correlate(weight, weight, "full") / float(weight @ weight)
    return (count - order - 1) / float(shared @ shared)


def scatter(place: Array, values: Array) -> float:
    """Return the sd of values (P,) about smooth curves through their neighbours, robust against few outliers."""
    left = (_about_neighbours(place, values, np.ones_like(values), order) for order in ORDERS)
    return min((_student(one)[0] for one in left if one.size), default=0.0)


def _student(left: Array) -> tuple[float, float]:
    """Return width and mean log likelihood of the density of Student's t that fits values best."""
    fits = []
    for freedom in 4.0**np.arange(4):  # from Cauchy's density to one that is nearly normal
        own = max(float(np.median(np.abs(left))), 1e-12)
        for _ in range(50):
            weight = (freedom + 1.0) / (freedom + (left / own)**2)
            own = max(float(np.sqrt(np.mean(weight * left**2))), 1e-12)
        fits.append((own, float(np.mean(student.logpdf(left / own, freedom))) - log(own)))
    return max(fits, key=lambda one: one[1])


def averaging(place: Array, values: Array) -> Array:
    """Return the sd (P,) by which values are off that are means up to halfway to their neighbours, as decays tell them.

    A kink anywhere there takes a thirteenth of the second difference off the mean, a parabola half as much.
    """
    bend = np.zeros(len(place) + 2)
    bend[2:-2] = np.diff(np.diff(values) / np.maximum(np.diff(place), 1e-9)) * 0.5 * (place[2:] - place[:-2])
    return np.asarray(np.sqrt(np.convolve(bend**2, np.full(3, 1.0 / 3.0), "valid")) / 13.0)


def weights_of(place: Array, missed: Array, sd: Array) -> Array:
    """Return the weights (P,), at most 1, of values that are `missed` by a smooth curve and by errors of width `sd`.

    The curve is a Gaussian process, once differentiable as friction makes curves. Its length and size and the errors'
    tails are those by which the others predict each value best (C. E. Rasmussen, C. K. I. Williams, Gaussian Processes
    for Machine Learning (2006), section 5.4.2). So is how much wider errors are: neighbours that happen to differ by
    little tell too small a width. Where several predict as well, variances are their mean, as in `noise_of`.
    """
    scaled = missed / sd
    apart = np.abs(place[:, None] - place) / max(float(np.ptp(place)), 1e-12)
    widest = float(np.sqrt(FREEDOM / chi2.ppf(FALSE_ALARMS, FREEDOM)))  # than the scatter of so few squares tells
    fits = []
    for length, size in product(lengths(place), np.geomspace(0.1, max(1.0, float(np.abs(scaled).max())), 6)):
        smooth = size**2 * alike(apart, length)
        for wider, freedom in product((1.0, widest**0.5, widest), 4.0**np.arange(4)):  # Cauchy's to nearly normal
            told, weight = _smoothed(smooth / wider**2, scaled / wider, freedom)
            fits.append((told - len(scaled) * log(wider), np.maximum(wider**2 / weight, 1.0)))
    top = max(one[0] for one in fits)
    probable = np.exp([one[0] - top for one in fits])
    return np.asarray(1.0 / np.average([one[1] for one in fits], axis=0, weights=probable))


def lengths(place: Array) -> Array:
    """Return over what parts of their range values at places (P,) may be alike: from twice it to two neighbours'."""
    return np.asarray(2.0**np.arange(1 - int(np.log2(len(place))), 2))


def alike(apart: Array, length: float) -> Array:
    """Return the correlation of a process, once differentiable as friction makes curves, at places so far apart."""
    far = np.sqrt(3.0) * apart / length
    return np.asarray((1.0 + far) * np.exp(-far))


def errors_like(place: Array, seen: Array, shorter: float = 1.0) -> Array:
    """Return modes (P, P) of errors over places, as large about each as those `seen` (P,) and so much shorter.

    They are a process as in `weights_of`, of the length that makes those most probable.
    """
    apart = np.abs(place[:, None] - place) / max(float(np.ptp(place)), 1e-12)
    fits = []
    for length in lengths(place):
        correlation = alike(apart, length)
        size = np.maximum(np.sqrt(correlation @ seen**2 / correlation.sum(axis=1)), np.finfo(float).tiny)
        told = multivariate_normal.logpdf(seen / size, cov=correlation) - float(np.sum(np.log(size)))
        fits.append((float(told), length, size))
    _, length, size = max(fits, key=lambda one: one[0])
    return np.asarray(size[:, None] * np.linalg.cholesky(alike(apart, length * shorter)))


def shrunk(draws: Array) -> Array:
    """Return modes (M, N + M), of unit variance, of an error of which there are N `draws` (M, N) of mean zero.

    Few draws span few directions, and the next one has others too: their covariance is drawn towards that of errors as
    large in each row which have nothing in common, by as much as makes it nearest to the true one (O. Ledoit, M. Wolf,
    J. Multivariate Anal. 88 (2004) 365).
    """
    rows, count = draws.shape
    size = np.sqrt(np.mean(draws**2, axis=1)) if count else np.zeros(rows)
    scaled = draws / np.maximum(size, np.finfo(float).tiny)[:, None]
    seen = scaled @ scaled.T / max(count, 1)
    apart = float(np.sum((seen - np.diag(np.diag(seen)))**2))
    chance = sum(float(np.sum((np.outer(one, one) - seen)**2)) for one in scaled.T) / max(count, 1)**2
    share = min(chance / apart, 1.0) if apart > 0.0 else 1.0
    return np.hstack([np.sqrt((1.0 - share) / max(count, 1)) * draws, np.diag(np.sqrt(share) * size)])


def _smoothed(smooth: Array, values: Array, freedom: float) -> tuple[float, Array]:
    """Return how well values over their errors' width predict each other, the smooth part being (P, P), and weights."""
    weight = np.ones(len(values))
    for _ in range(15):
        inverse = np.linalg.inv(smooth + np.diag(1.0 / weight))
        pulled, own = inverse @ values, np.diag(inverse)
        unknown = (1.0 - own / weight) / weight  # variance of the smooth part
        weight = (freedom + 1.0) / (freedom + (pulled / weight)**2 + unknown)
    width = np.sqrt(1.0 + np.maximum(1.0 / own - 1.0 / weight, 0.0))
    return float(np.sum(student.logpdf(pulled / own / width, freedom) - np.log(width))), weight


def _along(place: Array, values: Array, at: Array) -> Array:
    """Return values (L,) over rising places interpolated at others; outside they go on in a straight line."""
    inside = PchipInterpolator(place, values)
    ends = np.clip(at, place[0], place[-1])
    slope = inside.derivative()(ends)
    return np.asarray(inside(ends) + slope * (at - ends))


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
