"""Where fits of the rig begin: at the resonance that a sensor has, with either sign, and far from the answer.

Recordings are predictions of the small rig itself, so that what was put in is known.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.extra_mode import ExtraMode
from fretflow.effects.normal_load_coupling import NormalLoadCoupling
from fretflow.experiments.rig.coordinates import Space
from fretflow.experiments.rig.detection import REPEATS, detect
from fretflow.experiments.rig.fit import Fitter
from fretflow.experiments.rig.model import Hypothesis, RigModel
from fretflow.experiments.rig.screening import changes, in_sensors_alone, seen_through, signatures, starts_beside
from fretflow.experiments.rig.search import SLACK, RigSearch
from fretflow.experiments.rig.setup import RICHARDSON, first_simulation
from fretflow.inference.covariance import Covariance

SD = {"displacement": 3e-8, "friction_force": 0.15}


@pytest.fixture
def recorded(monkeypatch):
    """Return what makes the baseline's fit to a recording of given effects."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    model = small_rig.rig(small_rig.observed(SD, (0, 4000), (), 2e-15, 3e-9))

    def fit(*effects):
        true = model.predict(model.simulate(Hypothesis(effects=effects)))
        seen = replace(model, observation=replace(model.observation, values=true))
        fitter = Fitter(seen, Covariance(seen.observation.variance, seen.observation.modes), np.zeros(len(true)))
        return fitter, fitter.fit(Space.of(()), np.zeros(Space.of(()).size), None, 0)

    return fit


@pytest.mark.parametrize("frequency", [330.0, 520.0, 760.0])
def test_a_resonance_of_the_force_path_is_found_wherever_it_is(recorded, frequency):
    fitter, fit = recorded(ExtraMode().changed(frequency=frequency, damping_ratio=0.05))
    found = Space.of(("extra-mode",)).hypothesis(
        np.concatenate([np.zeros(Space.of(()).size), seen_through(fitter, fit, "extra-mode").z]))
    assert found.effects[0].frequency == pytest.approx(frequency, rel=0.08)  # half a step of the points is 4 %


def test_only_what_leaves_the_contact_alone_is_seen_through():
    assert in_sensors_alone("extra-mode")
    assert in_sensors_alone("sensor-inertia")
    assert not in_sensors_alone("viscous")
    assert not in_sensors_alone("third-body")


@pytest.mark.parametrize("slope", [4e5, -4e5])
def test_either_sign_is_begun_with_the_right_one_first(recorded, slope):
    fitter, fit = recorded(NormalLoadCoupling().changed(slope=slope))
    starts = starts_beside(fit, ("normal-load-coupling",))
    begun = signatures(fitter, fit, starts, changes(fitter, fit, starts)).begin("normal-load-coupling")
    signs = [one.signs["normal-load-coupling.slope"] for one in begun]
    assert signs == [np.sign(slope), -np.sign(slope)]


def test_a_start_far_off_is_not_given_up_before_its_first_step(recorded):
    """Friction that falls with pressure lowers all friction where it begins, which the first step sets right."""
    fitter, fit = recorded()
    space = Space.of(("load-dependent-friction",))
    z = np.zeros(space.size)
    z[-1] = 1.2  # a reference pressure far above the mean: less friction everywhere
    begun, then = (fitter.fit(space, z, fit.simulation, steps).objective for steps in (0, 1))
    assert then < 0.6 * begun
    assert fitter.fit(space, z, fit.simulation, 1, worth=0.3 * begun).objective == pytest.approx(then)
    assert fitter.fit(space, z, fit.simulation, 1, worth=0.01 * begun).objective == pytest.approx(begun)


def test_a_start_without_a_simulation_is_left_out(recorded, monkeypatch):
    """Of two readings of friction the one that cannot be simulated does not stop the other; two of them do."""
    fitter, _ = recorded()
    simulate = RigModel.simulate

    def failing(model, hypothesis, near=None):
        if np.mean(model.problem.friction_coefficient) > 0.9:
            raise NonConvergenceError("too much friction")
        return simulate(model, hypothesis, near)

    monkeypatch.setattr(RigModel, "simulate", failing)
    stuck = replace(fitter.rig, problem=fitter.rig.problem.vary(friction_coefficient=50.0))
    for models in ((stuck, fitter.rig), (fitter.rig, stuck)):
        assert first_simulation(models)[0] is fitter.rig
    with pytest.raises(NonConvergenceError, match="too much friction"):
        first_simulation([stuck, stuck])


def test_the_reading_whose_displacement_is_nearest_is_the_start(recorded):
    fitter, _ = recorded()
    other = replace(fitter.rig, problem=fitter.rig.problem.vary(friction_coefficient=0.7))
    assert first_simulation([other, fitter.rig])[0] is fitter.rig


def test_correction_at_a_fit_is_kept_where_it_lessens_the_misfit(recorded):
    """A recording of the denser model is met once the plain model is corrected by it; a wrong check changes nothing."""
    fitter, _ = recorded()
    denser = replace(fitter.rig, samples=2 * fitter.rig.samples)
    exact = fitter.rig.predict(fitter.rig.simulate(Hypothesis()))
    twice = exact + RICHARDSON * (denser.predict(denser.simulate(Hypothesis())) - exact)
    seen = replace(fitter.rig, observation=replace(fitter.rig.observation, values=twice))
    sharp = Covariance(0.1 * fitter.covariance.variance, fitter.covariance.modes)
    plain, space, none = replace(fitter, rig=seen, covariance=sharp), Space.of(()), frozenset()

    def looked(check):
        fit = plain.fit(space, np.zeros(space.size), None, 0)
        found = RigSearch(plain, lambda function, arguments: [function(one) for one in arguments], {none: fit},
                          (seen, check))
        found.correct([none], 0)
        return fit, found

    fit, found = looked(replace(seen, samples=denser.samples))
    assert fit.chi_squared > found.expected * SLACK
    assert found.fits[none].chi_squared < 1e-6 * fit.chi_squared
    assert found.fitter_of(none) is not plain
    fit, found = looked(replace(seen, problem=seen.problem.vary(friction_coefficient=0.7)))
    assert found.fits[none] is fit
    assert found.fitter_of(none) is plain


def test_repeats_that_differ_smoothly_are_detected_whatever_the_mean_loops_show(recorded):
    fitter, fit = recorded()
    starts = starts_beside(fit, ("viscous", "channel-delay"))
    seen = signatures(fitter, fit, starts, changes(fitter, fit, starts))
    steady, wandering = (detect(replace(fitter.rig.observation, smooth_share=share), fit, seen) for share in (0.2, 0.8))
    assert steady.p_value > steady.false_alarm_rate
    assert wandering.p_value < 1e-3 * wandering.false_alarm_rate
    assert wandering.statistic == REPEATS
