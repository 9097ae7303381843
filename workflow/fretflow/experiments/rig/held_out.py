"""Loops of the rig that are held out: what refits without them predict there, and how far these are off.

What the other loops say about errors that all loops share (gains of the sensors, their synchronisation) belongs to the
prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.observation import Array, Observation
from fretflow.experiments.rig.views import held_out_error
from fretflow.inference.covariance import Covariance
from fretflow.inference.least_squares import Fitter
from fretflow.inference.search import Names, Search, Task, fit_task
from fretflow.inference.verdict import HeldOut

HIDDEN = 1e12  # factor on the variance of what is held out: beyond all that single precision would tell


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


def held_out(looked: Search, experiment: RigExperiment, names: Names) -> HeldOutPrediction:
    """Return what the fits of the baseline and of a set predict, made again without some of the loops."""
    observation, fits = experiment.rig.observation, (looked.baseline, looked.fits[names])
    labels = held_out_labels(observation)
    if not labels:
        return HeldOutPrediction(labels, None, fits[0].predicted, fits[1].predicted)
    out = np.zeros(len(observation.values), dtype=bool)
    for piece in observation.pieces:
        out[piece.place] = piece.label in labels
    known = looked.fitter.covariance
    hidden = Covariance(np.where(out, HIDDEN, 1.0) * known.variance,
                        np.where(out[:, None], 0.0, known.modes))
    sets = list(dict.fromkeys((frozenset[str](), names)))
    refits = looked.pool(fit_task, [Task(Fitter(looked.fitter_of(one).experiment, hidden),
                                         looked.fits[one].prediction.point, looked.fits[one].prediction,
                                         looked.effort.first_steps) for one in sets])
    predicted = [fit.predicted if own is None else own.predicted
                 for fit, own in zip([looked.fits[one] for one in sets], refits, strict=True)]
    shared = experiment.measurement.covariance()
    seen = Covariance(hidden.variance, np.where(out[:, None], 0.0, shared.modes))
    sensed = [one + shared.modes @ seen.shared(observation.values - one) for one in (predicted[0], predicted[-1])]
    sizes = [held_out_error(observation, one, out) for one in sensed]
    order = [label for label in dict.fromkeys(piece.label for piece in observation.pieces) if label in labels]
    shown = [np.where(out, own, fit.predicted) for own, fit in zip(sensed, fits, strict=True)]
    return HeldOutPrediction(labels, HeldOut(what=f"{len(labels)} of the loops: {'; '.join(order)}", before=sizes[0],
                                  after=sizes[1], floor=1.0), shown[0], shown[1])
