"""Loops of the rig that are held out: what is shown and judged there comes from fits that did not see them.

What carries the weight: whatever was measured in a loop that is held out, its prediction stays the same, while a fit
of all loops follows it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.experiments.rig.experiment import BASELINE, RigExperiment
from fretflow.experiments.rig.held_out import held_out
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.least_squares import Fitter
from fretflow.inference.search import FAST, Search
from fretflow.recordings.schema import SweepCondition

SD = {"displacement": 3e-8, "friction_force": 0.15}
CONDITIONS = (SweepCondition(id=0, excitation_amplitude="75 N"), SweepCondition(id=1, normal_load="50 N"))


@pytest.fixture
def model(monkeypatch):
    """Return a rig with two cycle counts and two conditions, the second of which is held out."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    return small_rig.rig(small_rig.observed(SD, (0, 4000), CONDITIONS, 2e-15, 3e-9))


def test_what_is_held_out_does_not_move_its_own_prediction(model):
    start = model.simulate(Hypothesis())
    true = model.predict(start)
    rows = model.observation.rows(label="condition 1")
    shift = 2.0 * rows * model.observation.rows(channel="friction_force") * np.sign(true)

    def unseen(change, friction):
        seen = replace(model, observation=replace(model.observation, values=true + change))
        experiment = RigExperiment(seen, np.zeros(len(true)), np.zeros((len(true), 0)))
        fitter = Fitter(experiment, experiment.measurement.covariance())
        point = Point(experiment.parameters(()), friction)
        near = Prediction(Point(point.parameters, np.zeros(len(friction))), true, start)
        fit = fitter.at(point, near)
        search = Search(experiment, lambda function, arguments: [function(one) for one in arguments], FAST,
                        {frozenset(): fit})
        return held_out(search, experiment, frozenset()), fitter.fit(point, near, 2), fit

    off = 0.1 * (np.arange(len(BASELINE)) == 0)  # friction 3 % too large
    (plain, _, fit), (shifted, all_seen, _) = unseen(0.0, off), unseen(shift, off)
    assert plain.labels == {"condition 1"}
    assert shifted.before[rows] == pytest.approx(plain.before[rows], rel=1e-6)
    assert np.array_equal(shifted.before, shifted.after)
    size = np.abs(all_seen.predicted - shifted.before)[rows].max()
    assert size > 0.15
    assert np.array_equal(plain.before[~rows], fit.predicted[~rows])
    assert np.abs(plain.before - true)[rows].max() < 0.1 * np.abs(fit.predicted - true)[rows].max()
    assert plain.error.before < 1.1
    assert shifted.error.before > 5.0


def test_beside_a_jump_of_the_motion_nothing_is_judged(model):
    """A refit that shows a loop as a motion a tenth as large predicts nothing of it; one of six tenths is wrong."""
    start = model.simulate(Hypothesis())
    true = model.predict(start)
    experiment = RigExperiment(replace(model, observation=replace(model.observation, values=true)),
                               np.zeros(len(true)), np.zeros((len(true), 0)))
    fitter = Fitter(experiment, experiment.measurement.covariance())
    fit = fitter.at(Point(experiment.parameters(()), np.zeros(len(BASELINE))), None)
    moved = model.observation.rows(label="condition 1") & model.observation.rows(channel="displacement")

    def judged(size):
        refit = replace(fit, prediction=replace(fit.prediction, values=np.where(moved, size * fit.predicted,
                                                                                fit.predicted)))
        search = Search(experiment, lambda function, arguments: [refit for _ in arguments], FAST, {frozenset(): fit})
        return held_out(search, experiment, frozenset())

    assert judged(0.6).error.before > 10.0
    assert judged(0.1).error is None
    assert judged(0.1).labels == {"condition 1"}
