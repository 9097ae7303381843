"""Hysteresis loops, and what the rig's users read off them.

As in Fantetti et al., Tribol. Int. 138 (2019), and Tubita et al., section 2.1: the friction coefficient is
the friction limit (the horizontal portion of the loop) over the normal load, the tangential contact
stiffness the slope of the stick portion after a reversal. Both are means over the two half-cycles, so that
a constant offset of either channel does not matter. A loop without a horizontal portion has no friction
limit to read.

A measured loop comes with a guide: a smooth copy that tells where its portions begin and end, while what is fitted
there are the samples themselves, so that smoothing biases neither the stick slope nor the plateau.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import SlidingRegime
from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.structure.sensors import MIN_SAMPLES as MIN_SAMPLES
from fretflow.structure.sensors import HysteresisLoop as HysteresisLoop
from fretflow.structure.sensors import dissipated_energy as dissipated_energy

STICK_WINDOW = (0.05, 0.4)  # of the force swing after a reversal
PLATEAU_WINDOW = (0.2, 0.8)  # of the slip in a half-cycle: the ends are the knee and the edges of a scar
PLATEAU_SLOPE = 0.1  # steepest plateau, as share of the stick slope
FORCE_WEIGHT = 0.25  # beside displacement, each over its range, in the place of a reversal
SHORTEST_SLIDE = 0.02  # of the peak-to-peak displacement
BELOW = 0.02  # of the strongest harmonic: a single period has more below it, whatever resonates
MIDDLE = 0.01  # of the force swing, about its middle, where a round loop is as wide as there to 1e-4


@record
class LoopReadings:
    """What is read off a loop, in SI; None where the loop does not show it. `read_loop` makes it.

    Examples
    --------
    >>> import fretflow as ff
    >>> import numpy as np
    >>> x = 1e-6 * np.cos(2.0 * np.pi * np.arange(64) / 64)
    >>> readings = ff.read_loop(ff.HysteresisLoop(displacement=x, force=20e6 * x), normal_load=60.0)
    >>> str(readings.regime), readings.friction_limit, round(readings.tangential_stiffness * 1e-6)  # -, N, N/um
    ('stick', None, 20)
    """

    regime: SlidingRegime
    friction_coefficient: float | None = quantity("1")  # None without a plateau or a normal load
    friction_limit: float | None = quantity("N")  # None without a plateau
    tangential_stiffness: float | None = quantity("N/m")  # None with too few samples
    tangential_compliance: float | None = quantity("m/N")  # its inverse, which noise may make negative
    dissipated_energy: float = quantity("J")
    sliding_distance: float = quantity("m")  # width at mid force: peak to peak without the elastic part
    peak_to_peak: float = quantity("m")


def read_loop(loop: HysteresisLoop, normal_load: float | None = None, guide: HysteresisLoop | None = None
              ) -> LoopReadings:
    """Read friction, stiffness, energy and sliding off a loop.

    Parameters
    ----------
    loop : HysteresisLoop
        Displacement in m and force in N, (N,) each, in order of time.
    normal_load : float, optional
        In N; without it there is no friction coefficient.
    guide : HysteresisLoop, optional
        A smooth copy of a noisy loop, by which its parts are told.

    Returns
    -------
    LoopReadings
        In SI; None where the loop does not show it.

    Raises
    ------
    InputError
        If the load is not positive, the force is round-off beside it, the loop holds several periods, or the guide has
        another length.

    Notes
    -----
    The stiffness is the slope of the stick portions after both reversals, the friction limit the mean absolute force
    of both plateaus, the energy the area, as A. Fantetti et al., Tribol. Int. 138 (2019) 111-124 read them.

    Examples
    --------
    A slider of 36 N behind a spring of 20 N/um, over strokes of 10 um to either side:

    >>> import fretflow as ff
    >>> import numpy as np
    >>> there = np.linspace(-10e-6, 10e-6, 200, endpoint=False)
    >>> force = np.minimum(-36.0 + 20e6 * (there + 10e-6), 36.0)
    >>> loop = ff.HysteresisLoop(displacement=np.append(there, -there), force=np.append(force, -force))
    >>> readings = ff.read_loop(loop, normal_load=60.0)
    >>> round(readings.friction_coefficient, 3), str(readings.regime)
    (0.6, 'gross slip')
    """
    if normal_load is not None and not (isinstance(normal_load, Real) and normal_load > 0.0):
        raise InputError(f"normal_load: must be positive, got {normal_load}")
    if normal_load is not None and np.ptp(loop.force) < np.finfo(float).eps * len(loop.force) * normal_load:
        raise InputError(f"loop: its force is round-off beside the normal load of {normal_load:g} N, so that nothing "
                         "rubs; see whether the excitation acts along the faces")
    if (rounds := _rounds(loop.displacement)) > 1:
        raise InputError(f"loop: holds {rounds} periods; give one, or their mean")
    guide = loop if guide is None else guide
    if len(guide.force) != len(loop.force):
        raise InputError(f"guide: has {len(guide.force)} samples for the loop's {len(loop.force)}; smooth the loop "
                         "itself")
    there, back = half_cycles(loop, guide)
    compliance = tangential_compliance(there, back)
    stiffness = 1.0 / compliance if compliance is not None and compliance > 0.0 else None
    sliding = sliding_distance(guide)
    peak_to_peak = float(np.ptp(loop.displacement))
    limit = friction_limit(there, back, stiffness)
    if limit is not None:
        regime = SlidingRegime.GROSS_SLIP
    else:
        slides = sliding > SHORTEST_SLIDE * peak_to_peak
        regime = SlidingRegime.PARTIAL_SLIP if slides else SlidingRegime.STICK
    return LoopReadings(
        regime=regime, friction_coefficient=None if limit is None or normal_load is None else limit / normal_load,
        friction_limit=limit, tangential_stiffness=stiffness, tangential_compliance=compliance,
        dissipated_energy=dissipated_energy(loop), sliding_distance=sliding, peak_to_peak=peak_to_peak)


def _rounds(displacement: Array) -> int:
    """Return how often a motion (N,) repeats itself: its strongest harmonic, where there is next to none below."""
    size = np.abs(np.fft.rfft(displacement)[1:])
    strongest = int(np.argmax(size))
    return strongest + 1 if np.all(size[:strongest] < BELOW * size[strongest]) else 1


@dataclass(frozen=True)
class Branch:
    """Half a loop between reversals, turned so that displacement (m) and force (N) grow."""

    displacement: Array
    force: Array
    sign: float  # that turns it back

    @property
    def swing(self) -> float:
        """Return the force from the reversal to the end of the half-cycle, N."""
        return float(self.force[-1] - self.force[0])


@dataclass(frozen=True)
class HalfCycle(Branch):
    """Half a loop as it is, with its smooth `guide`, of the same samples."""

    guide: Branch


def half_cycles(loop: HysteresisLoop, guide: HysteresisLoop) -> tuple[HalfCycle, HalfCycle]:
    """Split a loop at the guide's corners into the way there (growing) and the way back.

    A corner is where displacement and, with less weight, force are extreme: where the motion rests at its end while
    the force turns, that is before the force turns.
    """
    x = guide.displacement
    corner = x / np.ptp(x) + FORCE_WEIGHT * guide.force / np.ptp(guide.force)
    low, high, n = int(np.argmin(corner)), int(np.argmax(corner)), len(x)
    there = np.arange(low, high + 1 if high > low else high + n + 1) % n
    back = np.arange(high, low + 1 if low > high else low + n + 1) % n

    def half(samples: NDArray[np.int64], sign: float) -> HalfCycle:
        smooth = Branch(sign * x[samples], sign * guide.force[samples], sign)
        return HalfCycle(sign * loop.displacement[samples], sign * loop.force[samples], sign, smooth)

    return half(there, 1.0), half(back, -1.0)


def tangential_compliance(*halves: Branch) -> float | None:
    """Return the mean slope of the stick portions in m/N, or None if no half has three samples there.

    Displacement is fitted on force: the window is one of force, and force varies much more than its noise
    there.
    """
    compliances = []
    for half in halves:
        share = (half.force - half.force[0]) / half.swing if half.swing > 0.0 else np.zeros_like(half.force)
        beyond = np.flatnonzero(share > STICK_WINDOW[1])
        stick = share[:beyond[0] if beyond.size else len(share)] >= STICK_WINDOW[0]
        samples = np.flatnonzero(stick)
        if samples.size >= 3:
            compliances.append(_slope(half.force[samples], half.displacement[samples]))
    return float(np.mean(compliances)) if compliances else None


def sliding_distance(loop: HysteresisLoop) -> float:
    """Return the loop's width in m at the middle of its forces, over a narrow band about it.

    In a loop of sticks and plateaus this is the peak-to-peak displacement without the elastic part, and without play,
    which holds the force in the middle. The whole loop is gone through, straight from sample to sample: with noise the
    reversal of a motion that rests there is anywhere in the rest, and passages up and down again cancel.
    """
    x, force = loop.displacement, loop.force - 0.5 * (loop.force.max() + loop.force.min())
    band = 0.5 * MIDDLE * float(np.ptp(force))
    if not band > 0.0:
        return 0.0
    within = np.clip(force, -band, band)
    dx, rise, inner = (np.roll(values, -1) - values for values in (x, force, within))
    share = np.divide(within + 0.5 * inner - force, rise, out=np.zeros_like(x), where=inner != 0.0)
    return max(0.0, float(-(x + share * dx) @ inner) / (2.0 * band))


def friction_limit(there: HalfCycle, back: HalfCycle, stiffness: float | None) -> float | None:
    """Return the mean absolute force of both plateaus in N, or None if one half-cycle has no plateau.

    A `stiffness` (N/m) of None stands for a stick portion too steep to be read, without elastic displacement.
    """
    compliance = 0.0 if stiffness is None else 1.0 / stiffness
    swing = float(there.guide.force.max() + back.guide.force.max())
    levels = []
    for half in (there, back):
        smooth = half.guide
        x = smooth.displacement - smooth.displacement[0]
        slip = x - (smooth.force - smooth.force[0]) * compliance
        low, high = (share * slip[-1] for share in PLATEAU_WINDOW)
        samples = np.flatnonzero((slip >= low) & (slip <= high))
        if slip[-1] < SHORTEST_SLIDE * x[-1] or samples.size < 3:
            return None
        level = float(half.force[samples].mean())
        if _slope(x[samples], half.force[samples]) > PLATEAU_SLOPE * (stiffness or swing / x[-1]):
            return None
        levels.append(level)
    return 0.5 * float(levels[0] + levels[1])


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the line through y over x by least squares."""
    away = x - x.mean()
    return float(away @ y / max(float(away @ away), np.finfo(float).tiny))
