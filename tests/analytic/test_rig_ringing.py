"""The arm rings on hinge and contact whenever the faces stick: what fits are corrected by holds it.

The rig's arm sounds at 2,500 Hz free and near 3,000 Hz on faces that stick, at a drive of 100 Hz. Time integration,
which knows no harmonics, is the reference.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.backlash import Backlash
from fretflow.experiments.rig.experiment import RigExperiment, hypothesis
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.setup import is_seen
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.corrections import correct_task
from fretflow.inference.experiment import Point
from fretflow.inference.least_squares import Fitter
from fretflow.solvers.time_integration import integrate, settle
from fretflow.structure.two_mass_rig.joint import rig_of
from fretflow.structure.two_mass_rig.lumped import LumpedRig

STEPS, REPEATS = 1024, 1e-5  # the last step as good as the motion of `TOLERANCE`


@pytest.mark.parametrize("effects", [(), (Backlash(play="2.5 um"),)], ids=["baseline", "play"])
def test_more_samples_bring_the_friction_force_to_that_of_time_integration(effects, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    model = small_rig.rig(small_rig.observed({"displacement": 3e-8, "friction_force": 0.15}, (0,), (), 2e-15, 3e-9))
    coarse, dense = ((one.simulate(Hypothesis(effects=effects)).loops[0]) for one in (model, model.denser()))
    history = settle(dense.problem, dense.solution, (4, 40), STEPS, REPEATS)
    wanted = lines(history.of_period(history.friction_force))
    assert np.linalg.norm(lines(dense.solution.friction_force) - wanted) < 0.003 * np.linalg.norm(wanted)
    assert np.linalg.norm(lines(coarse.solution.friction_force) - wanted) > 0.006 * np.linalg.norm(wanted)


@pytest.mark.parametrize(("play", "rounding"), [("2.5 um", 0.1), ("4 um", 0.5)])
def test_a_play_is_fitted_with_the_harmonics_that_it_rings_and_found_beside_a_joint_without_it(
        play, rounding, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    model = small_rig.rig(small_rig.observed({"displacement": 3e-8}, (0,), (), 2e-15, 3e-9))
    plain, asked = Hypothesis(), Hypothesis(effects=(Backlash(play=play, rounding=rounding),))
    assert model.resolving(plain) is model
    resolved = model.resolving(asked)
    assert resolved.samples / 4 > 27.0 > resolved.samples / 8  # the arm sounds near 3,000 Hz
    (own,), (few,) = (one.simulate(asked, model.simulate(plain)).loops for one in (resolved, model))
    history = settle(own.problem, own.solution, (4, 40), STEPS, REPEATS)
    wanted = lines(history.of_period(history.friction_force))
    far = [np.linalg.norm(lines(one.solution.friction_force) - wanted) / np.linalg.norm(wanted) for one in (own, few)]
    assert far[0] < 0.02
    assert far[1] > 2.0 * far[0]


def test_a_baseline_that_few_harmonics_do_not_lead_to_is_sought_from_nothing(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    simulate = RigModel.simulate

    def from_nothing_alone(self, hypothesis, near=None):
        if near is not None:
            raise NonConvergenceError("not near this")
        return simulate(self, hypothesis, near)

    model = small_rig.rig(small_rig.observed({"displacement": 3e-8}, (0,), (), 2e-15, 3e-9)).denser()
    (led,) = model.simulate(Hypothesis()).loops
    monkeypatch.setattr(RigModel, "simulate", from_nothing_alone)
    (sought,) = model.simulate(Hypothesis()).loops
    assert lines(sought.solution.friction_force) == pytest.approx(lines(led.solution.friction_force), abs=1e-2)
    with pytest.raises(NonConvergenceError):
        model.simulate(Hypothesis(effects=(Backlash(play="2.5 um"),)))


@pytest.mark.parametrize("play", ["1.9 um", "2.3 um", "2.5 um"])
def test_periods_across_a_play_are_found_with_all_samples_at_once(play, monkeypatch):
    """The joint's own motion in time leads there, also where the hinge damps half as much; it stays one in time.

    There may be several, so that none is told by another way to it.
    """
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    dense = small_rig.rig(small_rig.observed({"displacement": 3e-7}, (0,), (), 2e-15, 3e-9)).denser()
    (period,) = dense.simulate(Hypothesis(effects=(Backlash(play=play),), damping=0.5)).loops
    assert period.solution.residual_history[-1] < 1e-4
    history = integrate(period.problem, period.solution, 1, 2 * STEPS)
    own, after = lines(period.solution.friction_force), lines(history.of_period(history.friction_force))
    assert np.linalg.norm(after - own) < 0.01 * np.linalg.norm(own)


@pytest.mark.parametrize(("arm", "doubled"), [(1600.0, True), (2500.0, False)])
def test_an_arm_that_sounds_where_harmonics_end_asks_for_more_samples(arm, doubled, monkeypatch):
    """At 113 Hz its mode on the faces is near the 16th harmonic, the last that 64 samples hold, or far beyond it."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    seen = small_rig.observed({"displacement": 1e-7, "friction_force": 1.2}, (0,), (), 2e-15, 3e-9)
    model = small_rig.rig(seen)
    joint = replace(rig_of(model.problem.structure).quasi_static(),
                    rig=LumpedRig.from_modes(8.4, 0.45, 37.0, arm, 0.0055))
    problem = replace(model.problem, structure=joint).vary(
        friction_coefficient=0.757, normal_load=68.7, frequency=113.0, amplitude=66.6)
    few, more, many = (own.predict(own.simulate(Hypothesis())) for own in (
        replace(model, problem=problem, samples=samples) for samples in (64, 128, 512)))
    assert is_seen(seen, many - few) is doubled
    assert not is_seen(seen, 10.0 * (many - more))


def test_a_play_that_rings_is_fitted_with_more_samples(monkeypatch):
    """What few harmonics leave out of impacts changes with damping and play: put right at one fit it is not beside it.

    The reference is the model with four times the samples, where the play is another and the hinge damps otherwise.
    """
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    seen = small_rig.observed({"displacement": 3e-7, "friction_force": 1.2}, (0,), (), 2e-15, 3e-9)
    rig = replace(small_rig.rig(seen), samples=64)
    blank = np.zeros(len(seen.values))
    coarse = RigExperiment(rig, blank, np.zeros((len(blank), 0)), checks=(rig, rig.denser()))
    assert coarse.corrected(coarse.predict(at(coarse))).rig.samples == 64

    fitter = Fitter(coarse, coarse.measurement.covariance())
    fit = fitter.at(at(coarse, "backlash", play=2.5e-6, rounding=0.1), None)
    own, anew = correct_task((fitter, fit))
    assert (coarse.rig.samples, own.experiment.rig.samples, own.experiment.checks[0].samples) == (64, 128, 128)
    assert all(own.experiment.has_made(one.prediction) for one in (fit, anew))
    beside = at(coarse, "backlash", damping=3.0, play=2.3e-6, rounding=0.1)
    (wanted, few), (at_fit, few_at_fit) = ([one.predict(one.simulate(hypothesis(point)))
                                            for one in (rig.denser(), rig)] for point in (beside, fit.prediction.point))
    left = [np.linalg.norm((one - wanted) / seen.floor)
            for one in (few + at_fit - few_at_fit, own.experiment.predict(beside, fit.prediction).values)]
    assert left[1] < 0.5 * left[0]


def test_an_error_is_seen_where_one_channel_is_less_noisy():
    pieces = [SimpleNamespace(block=block, channel=name, place=slice(4 * at, 4 * at + 4))
              for at, (block, name) in enumerate([("loops", "x"), ("sweep", "f"), ("map", "depth")])]
    seen = SimpleNamespace(pieces=pieces, variance=np.repeat([1.0, 4.0, 1e-6], 4))
    assert not is_seen(seen, np.repeat([0.9, 1.8, 1.0], 4))
    assert is_seen(seen, np.repeat([0.0, 2.2, 0.0], 4))


def lines(force):
    """Return the compared harmonics of a period of the force, N."""
    return np.fft.rfft(force)[1:11] / len(force)


def at(experiment, *effects, **values):
    """Return the point in the middle of all ranges, but for some fields' values in SI."""
    space = experiment.parameters(effects)
    return Point(space, np.array([one.place(values[one.field]) if one.field in values else 0.0
                                  for one in space.coordinates]))
