"""What the report draws of a recording of the rig: loops and wear, measured and predicted, and where they differ."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import Array
from fretflow.experiments.loops import MOST_SHOWN, evolution
from fretflow.experiments.rig.model import SAMPLES
from fretflow.experiments.rig.observation import CHANNELS, Observation, Piece
from fretflow.inference.experiment import Covariance
from fretflow.inference.verdict import Comparison, Evolution, ResidualMap, WearMap
from fretflow.structure.sensors import band_limited

LOOPS = ("loops", "sweep")
JUDGED = ("displacement", "friction_force")  # by how well held-out loops are predicted


def loop_pieces(observation: Observation) -> dict[str, dict[str, Piece]]:
    """Return the pieces of every loop by its label and channel: cycle counts, then conditions."""
    by_label: dict[str, dict[str, Piece]] = {}
    for block in LOOPS:
        for piece in observation.pieces:
            if piece.block == block:
                by_label.setdefault(piece.label, {})[piece.channel] = piece
    return by_label


def level(observation: Observation, vector: Array) -> Array:
    """Return a prediction (M,) with each loop's channel shifted to the mean of the measured one.

    A loop's zero is not known, so that a difference of the means is none of the model's. The normal force is absolute.
    """
    moved = np.array(vector, dtype=float)
    for piece in observation.pieces:
        if piece.block in LOOPS and not CHANNELS[piece.channel].absolute:
            moved[piece.place] += float(np.mean(observation.values[piece.place] - vector[piece.place]))
    return moved


def comparisons(observation: Observation, before: Array, after: Array, held_out: Collection[str] = (),
                raw: Mapping[str, tuple[Array, Array]] = MappingProxyType({})) -> tuple[Comparison, ...]:
    """Return eight cycle counts with the first and the last, all that are held out, and all conditions.

    Parameters
    ----------
    observation
        What was measured.
    before, after
        Predictions (M,) without and with the named effects.
    held_out
        Labels of the loops that the fits of these predictions did not see there.
    raw
        Displacement and force (n,) of loops by their labels, every sample.
    """
    loops = loop_pieces(observation)
    counts = [label for label, pieces in loops.items() if pieces["displacement"].block == "loops"]
    last = max(len(counts) - 1, 0)
    kept = {label for k in np.unique(np.linspace(0, last, MOST_SHOWN).round().astype(int)) for label in counts[k:k + 1]}
    kept |= {label for label in loops if label not in counts or label in held_out}
    before, after = level(observation, before), level(observation, after)
    shown = []
    for label, pieces in loops.items():
        if label not in kept:
            continue
        (x, force), (x_before, force_before), (x_after, force_after) = (
            [band_limited(vector[pieces[name].place], SAMPLES // 2) for name in JUDGED]
            for vector in (observation.values, before, after))
        shown.append(Comparison(
            label=label, held_out=label in held_out, displacement=x, force=force, before_displacement=x_before,
            before_force=force_before, after_displacement=x_after, after_force=force_after,
            **dict(zip(("raw_displacement", "raw_force"), raw.get(label, ()), strict=False))))
    return tuple(shown)


def evolved(observation: Observation, before: Array, after: Array) -> Evolution | None:
    """Return what is read off the loops of all cycle counts; predictions are (M,)."""
    loops = [pieces for pieces in loop_pieces(observation).values() if pieces[JUDGED[0]].block == "loops"]
    return evolution([pieces[JUDGED[0]].cycles for pieces in loops], [
        tuple((vector[pieces[JUDGED[0]].place], vector[pieces[JUDGED[1]].place])
              for vector in (observation.values, before, after)) for pieces in loops])


def residual_maps(observation: Observation, covariance: Covariance, before: Array, after: Array
                  ) -> tuple[ResidualMap, ...]:
    """Return the differences over their sd by loop and phase, one map for each channel of the loops."""
    loops = loop_pieces(observation)
    channels = dict.fromkeys(name for pieces in loops.values() for name in pieces)
    sd = _sd(observation, covariance)
    tables = [(observation.values - level(observation, one)) / sd for one in (before, after)]
    phase = np.arange(observation.samples) / observation.samples
    maps = []
    for channel in channels:
        rows = {label: pieces[channel] for label, pieces in loops.items() if channel in pieces}
        first, second = (np.array([table[piece.place] for piece in rows.values()]) for table in tables)
        maps.append(ResidualMap(channel=channel, rows=tuple(rows), phase=phase, before=first, after=second))
    return tuple(maps)


def _sd(observation: Observation, covariance: Covariance) -> Array:
    """Return the sd (M,) of levelled differences, of noise and of what samples share: calibration, mesh, sampling."""
    modes = np.array(covariance.modes)
    for piece in observation.pieces:
        if piece.block in LOOPS and not CHANNELS[piece.channel].absolute:
            modes[piece.place] -= modes[piece.place].mean(axis=0)
    return np.asarray(np.sqrt(covariance.variance + np.sum(modes**2, axis=1)))


def wear_map(observation: Observation, before: Array, after: Array) -> WearMap | None:
    """Return the map of depth at the end; None where none was measured."""
    for piece in observation.pieces:
        if piece.block == "map":
            x, y = observation.points.T
            return WearMap(x=x, y=y, measured=observation.values[piece.place], before=before[piece.place],
                           after=after[piece.place])
    return None


def held_out_error(observation: Observation, predicted: Array, rows: NDArray[np.bool_] | None = None) -> float:
    """Return the rms error of single repeats over their sd, 1 for a prediction without error.

    The mean of the repeats is compared, each loop's zero free; the scatter of the repeats about it is added.

    Parameters
    ----------
    observation
        What was measured.
    predicted
        The prediction (M,).
    rows
        The rows (M,) that count, of whole loops; all loops where it is not given.
    """
    counted = observation.rows(block="loops") | observation.rows(block="sweep") if rows is None else rows
    off = observation.values - level(observation, predicted)
    squares = []
    for piece in observation.pieces:
        if counted[piece.place].all() and piece.channel in JUDGED:
            floor = observation.floor[piece.place]
            within = 1.0 - observation.variance[piece.place] * observation.noise[piece.place] / floor**2
            squares.append((off[piece.place] / floor)**2 + np.clip(within, 0.0, 1.0))
    return float(np.sqrt(np.mean(np.concatenate(squares))))
