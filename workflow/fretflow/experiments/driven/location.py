"""Where a driven joint's force and its prediction part: by phase of the stroke, cycle and parity; the law behind it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import stats

from fretflow.core.units import readable_unit
from fretflow.effects.driven import LumpedBaseline, SliderBaseline
from fretflow.effects.effect import Kind
from fretflow.experiments.driven.data import Array, DrivenData, Mask
from fretflow.experiments.driven.fit import DrivenFit
from fretflow.experiments.driven.noise import Noise
from fretflow.inference.verdict import Location, Place, ResidualLaw

HYSTERESIS = 0.02  # of the amplitude: smaller turns are no reversals
TURNED, KNEE, SLIDING = 0.15, 0.8, 1.5  # travel since the reversal over that at which the baseline slides again
END = 0.9  # of a stroke: the plateau's end from there
SLOW, BRISK = 0.05, 0.3  # of the largest speed and acceleration
SIGNIFICANT = 0.05
PARITIES = {(1, 1): "a constant", (-1, 1): "odd in the displacement", (1, -1): "odd in the direction of motion",
            (-1, -1): "odd in the displacement and in the direction of motion"}
LAW_BINS, PARITY_BINS = 16, 12
MOST_CYCLES = 40


def strokes(x: Array, least: float) -> tuple[Array, Array]:
    """Return the travel since the last reversal, and the whole travel of the stroke, both (N,) in m."""
    since, whole = np.zeros_like(x), np.zeros_like(x)
    begin, extreme, way = 0, 0, 0.0
    for k in range(1, len(x)):
        if way * (x[k] - x[extreme]) >= 0.0:
            extreme, way = k, way or float(np.sign(x[k] - x[begin]))
        elif abs(x[k] - x[extreme]) > least:
            _fill(x, since, whole, begin, extreme)
            begin, extreme, way = extreme, k, -way
    _fill(x, since, whole, begin, len(x) - 1)
    return since, whole


def _fill(x: Array, since: Array, whole: Array, begin: int, end: int) -> None:
    since[begin:end + 1] = np.abs(x[begin:end + 1] - x[begin])
    whole[begin:end + 1] = max(abs(x[end] - x[begin]), 1e-300)


def phases(data: DrivenData, baseline: DrivenFit) -> dict[str, Mask]:
    """Return which samples (N,) lie in which phase of the stroke."""
    joint, motion = baseline.joint.baseline, data.motion
    if isinstance(joint, SliderBaseline):
        reach = 2.0 * joint.friction_limit / joint.tangential_stiffness
        since, whole = strokes(motion.displacement, HYSTERESIS * 0.5 * float(np.ptp(motion.displacement)))
        share, end = since / max(reach, 1e-300), since > END * whole
        plateau = (share >= SLIDING) & ~end
        return {"reversal": share < TURNED, "stick slope": (share >= TURNED) & (share < KNEE),
                "knee": (share >= KNEE) & (share < SLIDING), "plateau": plateau,
                "plateau end": (share >= SLIDING) & end}
    speed, rate = np.abs(motion.velocity), np.abs(motion.acceleration)
    reversal = speed < SLOW * speed.max()
    brisk = ~reversal & (rate > BRISK * np.quantile(rate, 0.99))
    return {"reversal": reversal, "acceleration": brisk, "plateau": ~reversal & ~brisk}


def locate(data: DrivenData, noise: Noise, baseline: DrivenFit, block: str) -> Location:
    """Return where the baseline's residual exceeds the noise, each p-value corrected for how many were looked at."""
    left, used = baseline.residual, data.used
    found = [("phase", name, used & mask) for name, mask in phases(data, baseline).items()]
    cycles = data.cycles
    for one in cycles[::max(1, len(cycles) // MOST_CYCLES)]:
        mask = np.zeros_like(used)
        mask[data.samples_of(one)] = True
        found.append(("cycles", one.label, used & mask))
    found = [one for one in found if one[2].any()]
    parity = dict(_parities(data, left))
    looked = len(found) + len(parity)
    total = max(float(np.sum(left[used]**2)) - used.sum() * noise.sd**2, 1e-300)
    places = [Place(cut=cut, where=where, share=_share(left[mask], noise, total),
                    p_value=min(1.0, looked * _p(left[mask], noise))) for cut, where, mask in found]
    strength = sum(parity.values()) or 1.0
    overall = min(1.0, looked * _p(left[used], noise))
    places += [Place(cut="parity", where=name, share=size / strength, p_value=overall) for name, size in parity.items()]
    places.append(Place(cut="channel", where="force", share=1.0, p_value=overall))
    phase, side = _largest(places, "phase"), max(parity, key=lambda name: parity[name], default="")
    parts = [one for one in cycles if any(p.where == one.label and p.p_value < SIGNIFICANT for p in places)]
    span = (parts[0].number, parts[-1].number) if parts else (0, 0)
    text = ""
    if phase is not None and block:
        mean = float(np.sqrt(np.mean(left[dict((w, m) for _, w, m in found)[phase.where]]**2)))
        text = (f"The force differs most in the phase '{phase.where}', by {_force(mean)} there (root mean square; "
                f"repeats differ by {_force(noise.sd)}): {100.0 * phase.share:.0f} % of the difference.")
        if side:
            text += f" Read over displacement and direction it is mostly {side}."
    return Location(block=block, channel="force", phase=phase.where if phase else "", cycles=span, zone="",
                    parity=side, places=tuple(places), text=text)


def _force(value: float) -> str:
    unit, size = readable_unit(value, "N")
    return f"{value / size:.3g} {unit}"


def _largest(places: list[Place], cut: str) -> Place | None:
    return max((one for one in places if one.cut == cut), key=lambda one: one.share, default=None)


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
    edges = np.linspace(-1.0, 1.0, PARITY_BINS + 1)[1:-1] * np.abs(x[used]).max()
    place, rising = np.digitize(x, edges), motion.velocity > 0.0
    table = np.full((2, PARITY_BINS), np.nan)
    for way in (0, 1):
        for k in range(PARITY_BINS):
            inside = used & (place == k) & (rising == bool(way))
            if inside.any():
                table[way, k] = left[inside].mean()
    for (mirror, turn), name in PARITIES.items():
        one = 0.25 * (table + mirror * table[:, ::-1] + turn * table[::-1] + mirror * turn * table[::-1, ::-1])
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
    if data.kind is Kind.IMPOSED_DISPLACEMENT:
        since, _ = strokes(motion.displacement, HYSTERESIS * 0.5 * float(np.ptp(motion.displacement)))
        states["travel since the reversal, signed by its direction"] = (since * np.sign(v), "m")
    curves = {name: _curve(values[used], left[used], noise) for name, (values, _) in states.items()}
    name = max(curves, key=lambda key: curves[key][3])
    at, mean, sd, explained = curves[name]
    return ResidualLaw(channel="force", state=name, state_unit=states[name][1], channel_unit="N", x=at, y=mean, sd=sd,
                       explained=explained)


def _curve(state: Array, left: Array, noise: Noise) -> tuple[Array, Array, Array, float]:
    """Return the mean residual over a state in bins of equal count, its sd, and the share of squares it explains."""
    groups = [own for own in np.array_split(np.argsort(state), LAW_BINS) if len(own)]
    at, mean = (np.array([values[own].mean() for own in groups]) for values in (state, left))
    inside = sum(float(np.sum((left[own] - left[own].mean())**2)) for own in groups)
    sd = np.array([left[own].std() / np.sqrt(max(1.0, len(own) / noise.correlation)) for own in groups])
    noisy = len(left) * noise.sd**2
    most = float(np.sum(left**2)) - noisy
    explained = 0.0 if most <= 0.0 else float(np.clip((float(np.sum(left**2)) - inside) / most, 0.0, 1.0))
    return at, mean, sd, explained


def block_of(kind: Kind) -> str:
    """Return the block of a baseline: what the measured motion drives."""
    return "rig" if kind is LumpedBaseline.kind else "contact law"
