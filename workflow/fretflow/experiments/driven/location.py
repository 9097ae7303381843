"""Where a driven joint's force and its prediction part: by phase of the stroke, cycle and parity; the law behind it."""

from __future__ import annotations

from collections.abc import Iterator
from math import isqrt

import numpy as np
from scipy import stats

from fretflow.core.records import Array
from fretflow.core.units import readable_unit
from fretflow.experiments.driven.data import DrivenData, Mask
from fretflow.experiments.driven.noise import Noise
from fretflow.experiments.laws import binned_law
from fretflow.experiments.loops import PHASES, Strokes, parity_parts
from fretflow.inference.verdict import FALSE_ALARMS, Detection, Location, Place, ResidualLaw
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED


def phases(data: DrivenData) -> dict[str, Mask]:
    """Return which samples (N,) are in each phase, none of a record without cycles.

    A body is in the phase of acceleration where that is a larger share of its largest than the speed is.
    """
    if data.kind is LUMPED:
        speed, rate = np.abs(data.motion.velocity), np.abs(data.motion.acceleration)
        brisk = rate * speed.max() > speed * rate.max()
        return {"acceleration": brisk, "plateau": ~brisk}
    masks = {name: np.zeros(len(data.force), bool) for name in PHASES}
    for one in data.cycles:
        own = data.samples_of(one)
        phase = Strokes.of(data.motion.displacement[own], data.force[own]).phase
        for k, name in enumerate(PHASES):
            masks[name][own[phase == k]] = True
    return masks


def locate(data: DrivenData, noise: Noise, left: Array, block: str) -> Location:
    """Return where what the baseline leaves (N,) exceeds the noise, p-values corrected for how many were looked at."""
    used, cycles = data.used, data.cycles
    cuts = [("channel", "force", used)]
    cuts += [("phase", name, used & mask) for name, mask in phases(data).items()]
    cuts += [("cycles", one.label, used & np.isin(np.arange(len(used)), data.samples_of(one))) for one in cycles]
    cuts = [one for one in cuts if one[2].any()]
    parity = dict(_parities(data, left))
    count = len(cuts) + len(parity)
    total = max(float(np.sum(left[used]**2)) - used.sum() * noise.sd**2, 1e-300)
    places = [Place(cut=cut, where=where, share=_share(left[mask], noise, total),
                    p_value=min(1.0, count * _p(left[mask], noise))) for cut, where, mask in cuts]
    strength = sum(parity.values()) or 1.0
    places += [Place(cut="parity", where=name, share=size / strength, p_value=places[0].p_value)
               for name, size in parity.items()]
    phase = max((one for one in places if one.cut == "phase"), key=lambda one: one.share, default=None)
    side = max(parity, key=lambda name: parity[name], default="")
    shown = {one.where for one in places if one.cut == "cycles" and one.p_value < FALSE_ALARMS}
    parts = [one.number for one in cycles if one.label in shown]
    text = ""
    if phase is not None and block:
        mean = float(np.sqrt(np.mean(left[next(mask for _, where, mask in cuts if where == phase.where)]**2)))
        text = (f"The force differs most in the phase '{phase.where}', by {_force(mean)} there (root mean square; "
                f"repeats differ by {_force(noise.sd)}): {100.0 * phase.share:.0f} % of the difference.")
        if side:
            text += f" Read over displacement and direction it is mostly {side}."
    return Location(block=block, channel="force", phase=phase.where if phase else "", zone="", parity=side,
                    cycles=(parts[0], parts[-1]) if parts else (0, 0), places=tuple(places), text=text)


def detect(data: DrivenData, noise: Noise, left: Array) -> Detection:
    """Return whether the baseline leaves (N,) more than noise, by a classical test beside the posterior's answer."""
    p, name = _p(left[data.used], noise), "mean square of what is left"
    return Detection(p_value=p, statistic=name, tests={name: p}, false_alarm_rate=FALSE_ALARMS)


def _force(value: float) -> str:
    unit, size = readable_unit(value, "N")
    return f"{value / size:.3g} {unit}"


def _share(left: Array, noise: Noise, total: float) -> float:
    return float(np.clip((float(np.sum(left**2)) - len(left) * noise.sd**2) / total, 0.0, 1.0))


def _p(left: Array, noise: Noise) -> float:
    ratio = float(np.mean(left**2)) / noise.sd**2
    return float(stats.f.sf(ratio, max(1.0, len(left) / noise.correlation), noise.freedom))


def _parities(data: DrivenData, left: Array) -> Iterator[tuple[str, float]]:
    """Return the mean square of the residual's parts by their parity in (x, sign v)."""
    used, motion = data.used & (data.motion.velocity != 0.0), data.motion
    if not used.any():
        return
    x = motion.displacement - 0.5 * (motion.displacement[used].min() + motion.displacement[used].max())
    bins = 2 * isqrt(int(used.sum()))  # in mirror pairs
    edges = np.linspace(-1.0, 1.0, bins + 1)[1:-1] * np.abs(x[used]).max()
    place, rising = np.digitize(x, edges), motion.velocity > 0.0
    table = np.full((2, bins), np.nan)
    for way in (0, 1):
        for k in range(bins):
            inside = used & (place == k) & (rising == bool(way))
            if inside.any():
                table[way, k] = left[inside].mean()
    for name, one in parity_parts(table).items():
        if np.isfinite(one).any():
            yield name, float(np.nanmean(one**2))


def residual_law(data: DrivenData, noise: Noise, left: Array) -> ResidualLaw:
    """Return what is left (N,) against the state that explains most of it."""
    motion, used = data.motion, data.used
    x = motion.displacement - 0.5 * (motion.displacement.min() + motion.displacement.max())
    v = motion.velocity
    states = {"displacement": (x, "m")}
    if data.timed:
        states |= {"velocity": (v, "m/s"), "acceleration": (motion.acceleration, "m/s^2"),
                   "displacement times speed": (x * np.abs(v), "m^2/s"),
                   "squared displacement times velocity": (x**2 * v, "m^3/s")}
    if data.kind is IMPOSED_DISPLACEMENT and data.cycles:
        since = np.zeros_like(x)
        for one in data.cycles:
            own = data.samples_of(one)
            strokes = Strokes.of(motion.displacement[own], data.force[own])
            since[own] = strokes.since * strokes.way
        states["travel since the reversal, signed by its direction"] = (since, "m")
    laws = [binned_law({"channel": "force", "state": name, "state_unit": unit, "channel_unit": "N"}, values[used],
                       left[used], np.ones(used.sum()), used.sum() * noise.sd**2, noise.correlation)
            for name, (values, unit) in states.items()]
    return max(laws, key=lambda law: law.explained)
