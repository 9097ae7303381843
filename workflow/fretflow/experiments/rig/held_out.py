"""Checks of a fitted rig: classical tests of what the baseline leaves, and loops that are held out of the fit.

The whitened residual, what the baseline's parameters can do projected out, is standard normal under the null.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.observation import Array, Observation
from fretflow.experiments.rig.views import held_out_error
from fretflow.inference.experiment import Covariance
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.search import Names, Search, Task, fit_task
from fretflow.inference.verdict import FALSE_ALARMS, Detection, HeldOut


@dataclass(frozen=True)
class HeldOutPrediction:
    """The loops that are held out, and predictions (M,) that are of refits without them there.

    Everywhere else they are of the fits to all loops.
    """

    labels: frozenset[str]
    error: HeldOut | None  # None where there are too few loops to hold any out
    before: Array
    after: Array


def held_out_labels(observation: Observation) -> frozenset[str]:
    """Return the labels of the loops that are held out: every third cycle count, and every second condition."""
    loops = list(dict.fromkeys(piece.label for piece in observation.pieces if piece.block == "loops"))
    sweep = list(dict.fromkeys(piece.label for piece in observation.pieces if piece.block == "sweep"))
    kept = loops[1:-1:3] if len(loops) > 4 else []  # so few are all fitted
    return frozenset([*kept, *sweep[1::2]])


def held_out(search: Search, experiment: RigExperiment, names: Names) -> HeldOutPrediction:
    """Return what the fits of the baseline and of a set predict, made again without some of the loops."""
    observation, fits = experiment.rig.observation, (search.baseline, search.fits[names])
    labels = held_out_labels(observation)
    if not labels:
        return HeldOutPrediction(labels, None, fits[0].predicted, fits[1].predicted)
    out = np.zeros(len(observation.values), dtype=bool)
    for piece in observation.pieces:
        out[piece.place] = piece.label in labels
    known = search.fitter.covariance
    hidden = Covariance(known.variance, np.where(out[:, None], 0.0, known.modes)).hiding(out)
    sets = list(dict.fromkeys((frozenset[str](), names)))
    refits = search.pool(fit_task, [
        Task(Fitter(search.fitter_of(one).experiment, hidden), search.fits[one].prediction.point,
             search.fits[one].prediction, 1) for one in sets])  # a step: they stand near where all rows put them
    predicted = [fit.predicted if own is None else own.predicted
                 for fit, own in zip([search.fits[one] for one in sets], refits, strict=True)]
    shared = experiment.measurement.covariance()
    seen = Covariance(hidden.variance, np.where(out[:, None], 0.0, shared.modes))
    sensed = [one + shared.modes @ seen.shared(observation.values - one) for one in (predicted[0], predicted[-1])]
    sizes = [held_out_error(observation, one, out) for one in sensed]
    order = [label for label in dict.fromkeys(piece.label for piece in observation.pieces) if label in labels]
    shown = [np.where(out, own, fit.predicted) for own, fit in zip(sensed, fits, strict=True)]
    return HeldOutPrediction(labels, HeldOut(what=f"{len(labels)} of the loops: {'; '.join(order)}", before=sizes[0],
                                  after=sizes[1], floor=1.0), shown[0], shown[1])


def detect(observation: Observation, base: Fit) -> Detection:
    """Return whether anything is left at a fitted baseline: in all, in one loop, or in harmonics common to the loops.

    What is left in all is compared with what repeats differ by: much of the variance at corners is of errors of timing
    that need not be there, and would hide what is.
    """
    residual, freedom = base.residual, max(float(observation.noise.sum()) - len(base.z), 1.0)
    tests = {"chi-squared of all that is left": float(stats.chi2.sf(base.chi_squared, freedom)),
             "chi-squared of a channel of one loop": _single(observation, residual),
             "means and harmonics of the loops by their trend over the cycles": _harmonics(observation, residual, base)}
    name = min(tests, key=lambda key: tests[key])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def _single(observation: Observation, residual: Array) -> float:
    """Return the p-value of the loop's channel that has most left, the largest of so many; errors of timing count."""
    left = [residual[piece.place] for piece in observation.pieces if piece.block in ("loops", "sweep")]
    shares = [float(stats.chi2.sf(one @ one, len(one))) for one in left]
    return min(1.0, len(shares) * min(shares)) if shares else 1.0


def _harmonics(observation: Observation, residual: Array, base: Fit) -> float:
    """Return the p-value of a channel's largest harmonic or mean, constant or linear in the loops' order."""
    probes = []
    angle = 2.0 * np.pi * np.arange(observation.samples) / observation.samples
    waves = [shape(k * angle) for k in range(observation.harmonics + 1) for shape in (np.cos, np.sin)]
    for channel in dict.fromkeys(piece.channel for piece in observation.pieces if piece.block == "loops"):
        pieces = [piece for piece in observation.pieces if piece.block == "loops" and piece.channel == channel]
        trend = np.linspace(-1.0, 1.0, len(pieces)) if len(pieces) > 1 else np.zeros(1)
        for wave in waves:
            for weight in (np.ones(len(pieces)), trend):
                probe = np.zeros(len(residual))
                for piece, size in zip(pieces, weight, strict=True):
                    probe[piece.place] = size * wave
                if np.any(probe):
                    probes.append(probe)
    if not probes:
        return 1.0
    own, _ = np.linalg.qr(base.whitened_jacobian)
    probed = np.column_stack(probes)
    probed -= own @ (own.T @ probed)
    size = np.linalg.norm(probed, axis=0)
    kept = size > np.finfo(np.float32).eps * size.max()
    squares = (probed[:, kept].T @ residual / size[kept])**2
    return float(min(1.0, kept.sum() * stats.chi2.sf(squares.max(), 1)))
