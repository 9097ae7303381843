"""Where a recording of the rig and its prediction part: block, channel, loop phase, parity, cycles, harmonic, zone.

What is left is whitened, so that under the null its squares are those of standard normal deviates, of which repeats
show a known share. Each place has a p-value corrected for all that was looked at (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fretflow.core.records import Array
from fretflow.experiments.loops import PARITIES, PHASES, Strokes, parity_parts
from fretflow.experiments.rig.blocks import Cut, cuts
from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.observation import Observation, count_label
from fretflow.experiments.rig.views import loop_pieces
from fretflow.inference.evidence import LOOP_HARMONICS
from fretflow.inference.least_squares import Fit
from fretflow.inference.verdict import FALSE_ALARMS, Location, Place
from fretflow.recordings.kinds.facts import CORNER

CHANNEL_WORDS = {"friction_force": "friction force", "normal_force": "normal force", "worn_volume": "worn volume",
                 "wear_depth": "wear depth"}
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class _Part:
    """Some of what is left: its excess over noise, and how probable it is by chance."""

    cut: str
    where: str
    excess: float
    p_value: float  # not corrected


def locate(experiment: RigExperiment, base: Fit, block: str = "", cut: bool = True) -> Location:
    """Return where the fitted baseline and the recording part.

    Parameters
    ----------
    experiment, base
        The model with its covariance, and the baseline fitted.
    block
        The block of the named effects, in words; where it is empty it is decided from cuts of the model (see `blocks`).
    cut
        Whether that is to be decided at all.
    """
    observation = experiment.rig.observation
    parts = list(_parts(observation, base.residual))
    block_cuts = cuts(experiment, base) if cut and not block and observation.has_loops else ()
    tests = len(parts) + len(block_cuts)
    total = max(base.chi_squared - float(observation.noise.sum()), 1.0)
    places = [Place(cut=one.cut, where=one.where, share=float(np.clip(one.excess / total, 0.0, 1.0)),
                    p_value=min(1.0, tests * one.p_value)) for one in parts]
    places += [Place(cut="block", where=one.block, share=one.share, p_value=min(1.0, tests * one.p_value))
               for one in block_cuts]
    chosen = block or _block(block_cuts, tests)
    most = {cut: _largest(places, cut) for cut in ("channel", "phase", "parity", "harmonic", "condition", "zone")}
    span, jump = _span(observation, places)
    return Location(block=chosen, channel=most["channel"], phase=most["phase"], cycles=span, zone=most["zone"],
                    parity=most["parity"], harmonic=most["harmonic"], condition=most["condition"],
                    places=tuple(places), text=_text("" if block else chosen, most, span, jump, places))


def _block(block_cuts: tuple[Cut, ...], tests: int) -> str:
    first = block_cuts[0] if block_cuts else None
    return first.block if first is not None and tests * first.p_value < FALSE_ALARMS else ""


def _largest(places: list[Place], cut: str) -> str:
    """Return the place that holds most of the excess, empty where none is more than chance."""
    own = [one for one in places if one.cut == cut and one.p_value < FALSE_ALARMS]
    return max(own, key=lambda one: one.share).where if own else ""


def _parts(observation: Observation, left: Array) -> Iterator[_Part]:
    """Return all that is looked at."""
    for channel in dict.fromkeys(piece.channel for piece in observation.pieces):
        yield _part(observation, left, "channel", channel_words(channel), observation.rows(channel=channel))
    yield from _by_phase(observation, left)
    loops = loop_pieces(observation)
    for label, pieces in loops.items():
        rows = np.zeros(len(left), dtype=bool)
        for piece in pieces.values():
            rows[piece.place] = True
        cut = "cycles" if pieces["displacement"].block == "loops" else "condition"
        yield _part(observation, left, cut, label, rows)
    yield from _change_point(observation, left)
    yield from _by_harmonic(observation, left)
    yield from _by_parity(observation, left)
    yield from _by_zone(observation, left)


def _part(observation: Observation, left: Array, cut: str, where: str, rows: Mask) -> _Part:
    """Return the excess of the squares over what repeats show, tested against unit variance."""
    squares = float(np.sum(left[rows]**2))
    return _Part(cut, where, squares - float(observation.noise[rows].sum()),
                 float(stats.chi2.sf(squares, max(int(rows.sum()), 1))))


def _by_phase(observation: Observation, left: Array) -> Iterator[_Part]:
    masks = {name: np.zeros(len(left), dtype=bool) for name in PHASES}
    for pieces in loop_pieces(observation).values():
        strokes = Strokes.of(*(observation.values[pieces[name].place] for name in ("displacement", "friction_force")))
        for name in ("displacement", "friction_force"):
            for k, phase in enumerate(PHASES):
                masks[phase][pieces[name].place] = strokes.phase == k
    for phase, rows in masks.items():
        if rows.any():
            yield _part(observation, left, "phase", phase, rows)


def _change_point(observation: Observation, left: Array) -> Iterator[_Part]:
    """Return the cycle count from which on the loops differ otherwise than before: the largest fall of the squares.

    Each channel's loops are taken as one loop up to a count and another from it on, against one loop throughout.
    """
    counts = observation.counts
    if len(counts) < 3:
        return
    best, fall, freedom = counts[0], 0.0, 1
    for k in range(1, len(counts)):
        gained, free = 0.0, 0
        for channel in ("displacement", "friction_force"):
            table = np.array([left[piece.place] for piece in observation.pieces
                              if piece.block == "loops" and piece.channel == channel])
            early, late = table[:k].mean(axis=0), table[k:].mean(axis=0)
            gained += float(np.sum((early - late)**2)) * k * (len(counts) - k) / len(counts)
            free += table.shape[1]
        if gained > fall:
            best, fall, freedom = counts[k], gained, free
    p_value = min(1.0, (len(counts) - 1) * float(stats.chi2.sf(fall, freedom)))
    yield _Part("change", count_label(best), fall - freedom, p_value)


def _by_harmonic(observation: Observation, left: Array) -> Iterator[_Part]:
    """Return the harmonics of the loops: two deviates each of a loop's channel."""
    pieces = [piece for one in loop_pieces(observation).values() for piece in one.values()]
    if not pieces:
        return
    lines = np.array([np.fft.rfft(left[piece.place]) for piece in pieces]) * np.sqrt(2.0 / observation.samples)
    shown = np.array([observation.noise[piece.place].mean() for piece in pieces])
    for k in range(1, min(LOOP_HARMONICS + 1, lines.shape[1] - 1)):
        squares = float(np.sum(np.abs(lines[:, k])**2))
        yield _Part("harmonic", str(k), squares - 2.0 * float(shown.sum()),
                    float(stats.chi2.sf(squares, 2 * len(pieces))))


def _by_parity(observation: Observation, left: Array) -> Iterator[_Part]:
    """Return the friction force's parts by parity in displacement and direction, over bins of the displacement."""
    squares, freedom = dict.fromkeys(PARITIES, 0.0), 0
    for pieces in loop_pieces(observation).values():
        x = observation.values[pieces["displacement"].place]
        force = pieces["friction_force"].place
        strokes = Strokes.of(x, observation.values[force])
        middle, half = 0.5 * (x.max() + x.min()), 0.5 * float(np.ptp(x))
        pairs = isqrt(len(x))
        place = np.clip(((x - middle) / half + 1.0) * pairs, 0, 2 * pairs - 1).astype(int)
        index = [(strokes.way == way) & (place == k) for way in (1.0, -1.0) for k in range(2 * pairs)]
        count = np.array([rows.sum() for rows in index]).reshape(2, -1)
        mean = np.array([left[force][rows].sum() for rows in index]).reshape(2, -1) / np.maximum(count, 1)
        own = np.s_[0, np.all((count > 0) & (count[:, ::-1] > 0), axis=0)[:pairs].nonzero()[0]]  # seen from all sides
        variance = 0.25 * parity_parts(1.0 / np.maximum(count, 1))[PARITIES[0]][own]
        for name, part in parity_parts(mean).items():
            squares[name] += float(np.sum(part[own]**2 / variance))
        freedom += len(variance)
    for name, square in squares.items():
        yield _Part("parity", name, square - freedom, float(stats.chi2.sf(square, max(freedom, 1))))


def _by_zone(observation: Observation, left: Array) -> Iterator[_Part]:
    place = next((piece.place for piece in observation.pieces if piece.block == "map"), None)
    if place is None:
        return
    middle = 0.5 * (observation.points.max(axis=0) + observation.points.min(axis=0))
    half = np.maximum(0.5 * np.ptp(observation.points, axis=0), 1e-300)
    along, across = (np.abs(observation.points - middle) / half > CORNER).T
    zones = {"middle": ~along & ~across, "edges at the ends of the stroke": along & ~across,
             "edges along the stroke": ~along & across, "corners": along & across}
    for name, mask in zones.items():
        rows = np.zeros(len(left), dtype=bool)
        rows[place] = mask
        if rows.any():
            yield _part(observation, left, "zone", name, rows)


def _span(observation: Observation, places: list[Place]) -> tuple[tuple[int, int], Place | None]:
    """Return the cycle counts between which loops differ, from the change point on where there is one."""
    shown = {one.where for one in places if one.cut == "cycles" and one.p_value < FALSE_ALARMS}
    counts = [count for count in observation.counts if count_label(count) in shown]
    jump = next((one for one in places if one.cut == "change" and one.p_value < FALSE_ALARMS), None)
    return ((counts[0], counts[-1]) if counts else (0, 0)), jump


def channel_words(channel: str) -> str:
    """Return a channel's name in words."""
    return CHANNEL_WORDS.get(channel, channel)


def _text(block: str, most: dict[str, str], span: tuple[int, int], jump: Place | None, places: list[Place]) -> str:
    if not most["channel"]:
        return ""
    share = max((one.share for one in places if one.cut == "channel"), default=0.0)
    first = f"Measured and predicted differ most in the {most['channel']} ({100.0 * share:.0f} % of the difference)"
    if most["phase"]:
        first += f", in the phase '{most['phase']}' of the loop"
    if span != (0, 0):
        first += f", between {span[0]:,} and {span[1]:,} cycles"
    second = []
    if block:
        second.append(f"the cut of the model at the measured signals points to the block '{block}'")
    if jump is not None and jump.share > 0.1:
        second.append(f"loops change most at {jump.where}")
    if most["parity"]:
        second.append(f"over displacement and direction it is mostly {most['parity']}")
    told = "; ".join(second)
    return f"{first}." + (f" {told[0].upper()}{told[1:]}." if told else "")
