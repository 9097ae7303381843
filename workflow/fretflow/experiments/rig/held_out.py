"""Checks of a fitted rig: classical tests of what the baseline leaves, and loops that are held out of the fit.

The whitened residual, what the baseline's parameters can do projected out, is standard normal under the null.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from fretflow.core.records import Array
from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.observation import Observation, is_other_motion
from fretflow.experiments.rig.views import held_out_error
from fretflow.inference.experiment import Covariance
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.search import Names, Search, Task, basis, fit_task
from fretflow.inference.verdict import FALSE_ALARMS, Detection, HeldOut


@dataclass(frozen=True)
class HeldOutPrediction:
    """The loops that are held out, and predictions (M,) that are of refits without them there.

    Everywhere else they are of the fits to all loops. Beside a jump of the motion the error is that of the other loops.
    """

    labels: frozenset[str]
    judged: frozenset[str]  # of them, those that the error is of
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
        return HeldOutPrediction(labels, labels, None, fits[0].predicted, fits[1].predicted)
    out = np.zeros(len(observation.values), dtype=bool)
    for piece in observation.pieces:
        out[piece.place] = piece.label in labels
    known = search.fitter.covariance
    hidden = Covariance(known.variance, np.where(out[:, None], 0.0, known.modes)).hiding(out)
    sets = list(dict.fromkeys((frozenset[str](), names)))
    refits = search.pool(fit_task, [
        Task(Fitter(search.fitter_of(one).experiment, hidden), search.fits[one].prediction.point,
             search.fits[one].prediction, 1) for one in sets])  # a step: they stand near where all rows put them
    fitted = [search.fits[one] for one in sets]
    predicted = [fit.predicted if own is None else own.predicted for fit, own in zip(fitted, refits, strict=True)]
    shared = experiment.measurement.covariance()
    seen = Covariance(hidden.variance, np.where(out[:, None], 0.0, shared.modes))
    sensed = [one + shared.modes @ seen.shared(observation.values - one) for one in (predicted[0], predicted[-1])]
    shown = [np.where(out, own, fit.predicted) for own, fit in zip(sensed, fits, strict=True)]
    jumping = frozenset[str]().union(*(jumps(observation, fit.predicted, own)
                                       for fit, own in zip(fitted, predicted, strict=True)))
    judged, beside = labels - jumping, labels & jumping
    if not judged:
        return HeldOutPrediction(labels, judged, None, *shown)
    rows = np.logical_or.reduce([observation.rows(label=label) for label in judged])
    before, after = (held_out_error(observation, one, rows) for one in sensed)
    order = list(dict.fromkeys(piece.label for piece in observation.pieces))
    what = f"{len(judged)} of the loops: {'; '.join(label for label in order if label in judged)}"
    if beside:
        what += f" (beside a jump of the motion, and not judged: {'; '.join(one for one in order if one in beside)})"
    return HeldOutPrediction(labels, judged, HeldOut(what=what, before=before, after=after, floor=1.0), *shown)


def jumps(observation: Observation, one: Array, other: Array) -> frozenset[str]:
    """Return the labels of the loops that are other motions in two predictions (M,), of fits with and without a loop.

    Where a motion jumps between parameters that differ by no more than a fit without a loop does, which of the motions
    that coexist there that loop shows cannot be predicted.
    """
    return frozenset(piece.label for piece in observation.pieces if piece.channel == "displacement" and is_other_motion(
        *(observation.fundamental(values[piece.place]) for values in (one, other))))


def detect(observation: Observation, base: Fit) -> Detection:
    """Return whether anything is left at a fitted baseline: in all, in one loop, or in harmonics common to the loops.

    What is left in all is compared with what repeats differ by: much of the variance at corners is of errors of timing
    that need not be there, and would hide what is. The baseline was fitted under other errors besides, so that its
    parameters are fitted once more, to first order: a chi-squared has their number of degrees of freedom less there.
    """
    own = basis(base.whitened_jacobian)
    residual = base.residual - own @ (own.T @ base.residual)
    freedom = max(float(observation.noise.sum()) - len(base.z), 1.0)
    tests = {"chi-squared of all that is left": float(stats.chi2.sf(residual @ residual, freedom)),
             "chi-squared of a channel of one loop": _single(observation, residual),
             "means and harmonics of the loops by their trend over the cycles": _harmonics(observation, residual, own)}
    name = min(tests, key=lambda key: tests[key])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def _single(observation: Observation, residual: Array) -> float:
    """Return the p-value of the loop's channel that has most left, the largest of so many; errors of timing count."""
    left = [residual[piece.place] for piece in observation.pieces if piece.block in ("loops", "sweep")]
    shares = [float(stats.chi2.sf(one @ one, len(one))) for one in left]
    return min(1.0, len(shares) * min(shares)) if shares else 1.0


def _harmonics(observation: Observation, residual: Array, own: Array) -> float:
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
    probed = np.column_stack(probes)
    probed -= own @ (own.T @ probed)
    size = np.linalg.norm(probed, axis=0)
    kept = size > np.finfo(np.float32).eps * size.max()
    squares = (probed[:, kept].T @ residual / size[kept])**2
    return float(min(1.0, kept.sum() * stats.chi2.sf(squares.max(), 1)))
