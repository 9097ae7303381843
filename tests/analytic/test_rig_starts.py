"""Where fits of the rig begin: at the resonance that a sensor has, with either sign, and far from the answer.

Recordings are predictions of the small rig itself, so that what was put in is known.
"""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.backlash import Backlash
from fretflow.effects.cycle import PeriodicCycle
from fretflow.effects.effect import in_sensors_alone
from fretflow.effects.extra_mode import ExtraMode
from fretflow.effects.friction_run_in import FrictionRunIn
from fretflow.effects.normal_load_coupling import NormalLoadCoupling
from fretflow.effects.support_nonlinearity import SupportNonlinearity
from fretflow.experiments.rig.experiment import RigExperiment, hypothesis, resensed
from fretflow.experiments.rig.model import DENSER, SAMPLES, RigModel
from fretflow.experiments.rig.setup import first_simulation
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.beginnings import begin_task, beginnings_task, elsewhere, is_untold
from fretflow.inference.corrections import correct
from fretflow.inference.experiment import Point
from fretflow.inference.least_squares import Fitter
from fretflow.inference.search import FAST, Effort, Search
from fretflow.inference.strategy import begin_elsewhere
from fretflow.recordings.schema import SweepCondition
from fretflow.solvers.quasi_static import solver as quasi_static
from fretflow.solvers.time_integration import integrate

SD = {"displacement": 3e-8, "friction_force": 0.15}


@pytest.fixture
def recorded(monkeypatch):
    """Return what makes the baseline's fit to a recording of given effects."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    def fit(*effects, noise=1.0, samples=SAMPLES, **baseline):
        sd = {name: noise * own for name, own in SD.items()}
        own = replace(small_rig.rig(small_rig.observed(sd, (0, 4000), (), 2e-15, 3e-9)), samples=samples)
        hypothesis = Hypothesis(effects=effects, **baseline)
        true = own.predict(own.resolving(hypothesis).simulate(hypothesis))
        seen = replace(own, observation=replace(own.observation, values=true))
        experiment = RigExperiment(seen, np.zeros(len(true)), np.zeros((len(true), 0)))
        fitter, space = Fitter(experiment, experiment.measurement.covariance()), experiment.parameters(())
        return fitter, fitter.at(Point(space, np.zeros(space.size)), None)

    return fit


def starting_points(fitter, fit, name):
    """Return the points at which the fits of an effect begin."""
    return [one.point for one in beginnings_task((fitter, fit, [name])).values() if one.point.effects == {name}]


@pytest.mark.parametrize("frequency", [330.0, 520.0, 760.0])
def test_a_resonance_of_the_force_path_is_found_wherever_it_is(recorded, frequency):
    fitter, fit = recorded(ExtraMode().changed(frequency=frequency, damping_ratio=0.05))
    (point,) = starting_points(fitter, fit, "extra-mode")
    (mode,) = point.built()
    assert mode.frequency == pytest.approx(frequency, rel=0.08)  # half a step of the points is 4 %


def test_what_sensors_alone_show_needs_no_simulation_and_is_exact(recorded):
    """The change to a resonance in the force path is that of another simulation; the contact's states are shared."""
    assert in_sensors_alone(ExtraMode)
    assert not in_sensors_alone(NormalLoadCoupling)
    fitter, fit = recorded()
    space = fitter.experiment.parameters(["extra-mode"])
    point = Point(space, np.append(fit.z, np.array([0.3, -0.5])))
    change = fitter.experiment.changes(fit.prediction, [point])[:, 0]
    again = fitter.experiment.predict(point).values
    assert resensed(fit.prediction, point).loops is fit.prediction.state.loops
    assert np.abs(change + fit.predicted - again).max() < 1e-6 * np.abs(again).max()


def test_a_play_whose_first_start_tells_nothing_of_others_is_found_among_all(recorded):
    """The start that promises most ends in another minimum, and so do the two best; a rounder one leads there."""
    fitter, fit = recorded(Backlash().changed(play=5e-6, rounding=0.8), noise=0.1)
    search = Search(fitter.experiment, lambda function, arguments: [function(one) for one in arguments], FAST)
    search.keep([fit])
    (beginning,) = beginnings_task((fitter, fit, ["backlash"])).values()
    first = begin_task((fitter, beginning))
    assert is_untold(search, beginning, first)
    begin_elsewhere(search, elsewhere(fitter, beginning, first))
    (play,) = search.fits[frozenset({"backlash"})].prediction.point.built()
    assert (play.play, play.rounding) == pytest.approx((5e-6, 0.8), rel=1e-2)


@pytest.mark.parametrize("slope", [4e5, -4e5])
def test_either_sign_is_begun_and_the_right_one_promises_more(recorded, slope):
    fitter, fit = recorded(NormalLoadCoupling().changed(slope=slope))
    promised = {point.parameters.signs["normal-load-coupling.slope"]: fitter.at(point, fit.prediction).promise
                for point in starting_points(fitter, fit, "normal-load-coupling")}
    assert set(promised) == {1.0, -1.0}
    assert promised[np.sign(slope)] < promised[-np.sign(slope)]


def test_a_start_without_a_simulation_is_left_out(recorded, monkeypatch):
    """Of two readings of friction the one that cannot be simulated does not stop the other; two of them do."""
    fitter, _ = recorded()
    simulate = RigModel.simulate

    def failing(model, hypothesis, near=None):
        if np.mean(model.problem.friction_coefficient) > 0.9:
            raise NonConvergenceError("too much friction")
        return simulate(model, hypothesis, near)

    monkeypatch.setattr(RigModel, "simulate", failing)
    stuck = replace(fitter.experiment.rig, problem=fitter.experiment.rig.problem.vary(friction_coefficient=50.0))
    for models in ((stuck, fitter.experiment.rig), (fitter.experiment.rig, stuck)):
        assert first_simulation(models)[0] is fitter.experiment.rig
    with pytest.raises(NonConvergenceError, match="too much friction"):
        first_simulation([stuck, stuck])


def test_the_reading_whose_displacement_is_nearest_is_the_start(recorded):
    fitter, _ = recorded()
    other = replace(fitter.experiment.rig, problem=fitter.experiment.rig.problem.vary(friction_coefficient=0.7))
    assert first_simulation([other, fitter.experiment.rig])[0] is fitter.experiment.rig


def test_a_leading_set_is_held_to_what_finer_models_say_at_its_own_fit(recorded):
    """A recording of the denser model is met once the plain one is corrected by it; a worse answer is taken as well."""
    fitter, _ = recorded()
    rig = replace(fitter.experiment.rig, samples=fitter.experiment.rig.samples // 2)
    denser = replace(rig, samples=2 * rig.samples, tolerance=rig.tolerance / DENSER**2)  # as a diagnosis has it
    exact, true = (one.predict(one.simulate(Hypothesis())) for one in (rig, denser))

    def chi_squared_corrected(check, values):
        seen = replace(rig, observation=replace(rig.observation, values=values,
                                                variance=1e-3 * rig.observation.variance))
        experiment = RigExperiment(seen, np.zeros(len(exact)), np.zeros((len(exact), 0)), checks=(seen, check))
        own = Fitter(experiment, experiment.measurement.covariance())
        space = experiment.parameters(())
        first = own.at(Point(space, np.zeros(space.size)), None)
        search = Search(experiment, lambda function, arguments: [function(one) for one in arguments],
                        Effort(0, 1, 0, 1, 0, 0), {frozenset(): first})
        search.fitter = own
        correct(search, [0])
        return first.chi_squared, search.baseline.chi_squared

    before, after = chi_squared_corrected(denser, true)
    assert after < 1e-6 * before
    before, after = chi_squared_corrected(denser, exact)
    assert before < 1e-6 * after


def test_of_motions_that_coexist_the_measured_one_is_predicted(monkeypatch):
    """About the fold of a hardening support; integration in time keeps to either, and no third is made up."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    condition = SweepCondition(id=0, excitation_frequency="90 Hz")
    rig = small_rig.rig(small_rig.observed(SD, (0,), (condition,), 2e-15, 3e-9))
    rows = rig.observation.rows(block="sweep", channel="displacement")

    def sweeping(stiffness, measured):
        values = np.where(rows, measured, rig.observation.values)
        own = replace(rig, observation=replace(rig.observation, values=values))
        simulation = own.simulate(Hypothesis(effects=(SupportNonlinearity().changed(stiffness=stiffness),)))
        return own.predict(simulation), simulation.sweep[0]

    large = sweeping(2e15, rig.observation.values)[0]
    small = sweeping(1e15, large)[0]  # none coexists there
    assert np.ptp(small[rows]) < 0.6 * np.ptp(large[rows])
    spans = []
    for measured in (small, large):
        _, period = sweeping(1.4e15, measured)
        moved = period.solution.displacement[:, :, 0].mean(axis=1)
        marched = integrate(period.problem, period.solution, 40, 200)
        assert marched.change[-1] < 1e-3
        assert np.ptp(marched.of_period(marched.relative_displacement)) == pytest.approx(np.ptp(moved), rel=0.02)
        spans.append(np.ptp(moved))
    assert spans[1] > 1.8 * spans[0]


@pytest.mark.parametrize("factor", [0.5, 2.5])
def test_a_damping_ratio_that_is_not_the_stated_one_is_fitted(recorded, factor):
    """Damping of the arm by another code's steps, or a guess in the file, was friction that falls with speed."""
    fitter, fit = recorded(noise=0.1, samples=256, damping=factor)  # the arm sounds at the 25th harmonic
    assert fit.chi_squared > 20.0
    after = fitter.fit(fit.prediction.point, fit.prediction)
    assert after.chi_squared < 0.2 * fit.chi_squared
    assert hypothesis(after.prediction.point).damping == pytest.approx(factor, rel=0.1)


def test_a_period_that_newton_loses_is_found_where_the_motion_settles(monkeypatch):
    """Across a play more than twice as wide at once; in time, which chatters there, what was found all but stays.

    Where neither a Jenkins element nor the joint after it leads, the joint is marched until it settles.
    """
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    rig = replace(small_rig.rig(small_rig.observed(SD, (0, 4000), (), 2e-15, 3e-9)), samples=128)
    narrow, wide = (Hypothesis(effects=(Backlash().changed(play=play),)) for play in (0.2e-6, 0.5e-6))
    before = rig.simulate(narrow)
    period = rig.simulate(wide, before).loops[0]
    with pytest.raises(NonConvergenceError):  # a step of load or force is shortened instead
        rig.solver()._find(period.problem, 128, before.loops[0].solution, settling=False)
    moved = period.solution.displacement[:, :, 0].mean(axis=1)
    marched = integrate(period.problem, period.solution, 20, 512)
    assert marched.change[-1] < 0.01
    assert np.ptp(marched.of_period(marched.relative_displacement)) == pytest.approx(np.ptp(moved), rel=0.01)
    once, tried = rig.solver(settlings=1), []
    monkeypatch.setattr(quasi_static, "marched_starts", lambda *_: iter(()))
    monkeypatch.setattr(quasi_static, "settled_starts", lambda *_: tried.append(once) or iter(()))
    for _ in range(2):  # what was in vain once is not tried again
        with suppress(NonConvergenceError):
            once.solve(period.problem, before.loops[0].solution)
    assert len(tried) == 1


def test_a_condition_too_far_for_newton_is_followed(monkeypatch):
    """Of a solver that finds nothing further than 3 Hz away; the period is that of one which leaps."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    condition = SweepCondition(id=0, excitation_frequency="90 Hz", excitation_amplitude="50 N")
    rig = small_rig.rig(small_rig.observed(SD, (0,), (condition,), 2e-15, 3e-9))
    simulation = rig.simulate(Hypothesis())
    end, solver, tried = simulation.loops[-1], rig.solver(), [simulation.loops[-1].problem.frequency]

    class Short:
        def solve(self, problem, start):
            if abs(problem.frequency - tried[-1]) > 3.0:
                raise NonConvergenceError("too far")
            tried.append(problem.frequency)
            return solver.solve(problem, start)

    cycle = PeriodicCycle(solver, rig.case_problem(Hypothesis()))
    monkeypatch.setattr(RigModel, "solver", lambda self, settlings=np.inf: Short())
    solution = rig._followed(cycle, end, condition)
    assert tried[-1] == 90.0
    assert len(tried) > 4
    leapt = simulation.sweep[0].solution
    assert solution.displacement == pytest.approx(leapt.displacement, abs=1e-3 * np.ptp(leapt.displacement))


class Sinking(FrictionRunIn):
    """Friction that falls below zero with the first cycles."""

    def coefficient(self, final, energy):
        """Return the final coefficient, less as many as J were dissipated."""
        return np.asarray(final - energy)


def test_friction_below_zero_on_the_way_is_no_solution(monkeypatch):
    """It ended the diagnosis with an error that named a field of no file."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    rig = small_rig.rig(small_rig.observed(SD, (0, 4000), (), 2e-15, 3e-9))
    with pytest.raises(NonConvergenceError, match=r"leaves what a joint may be: .*friction_coefficient"):
        rig.simulate(Hypothesis(effects=(Sinking(),)))


def test_a_finer_mesh_may_take_the_periods_of_its_nodes(monkeypatch):
    """Deep wear took a few periods more on the finer mesh than any march may, and the diagnosis ended in an error."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    seen, deep = small_rig.observed(SD, (0, 400_000), (), 1e-12, 1e-7), Hypothesis(wear=4.0)
    coarse, fine = small_rig.rig(seen), small_rig.rig(seen, np.arange(49))
    most = coarse.simulate(deep).steps[-1].solves
    coarse, fine = (replace(one, most_periods=most) for one in (coarse, fine))
    with pytest.raises(NonConvergenceError, match=f"more than {most} periods"):
        fine.simulate(deep)
    assert coarse.finer(fine.problem).simulate(deep).steps[-1].solves > most


@pytest.mark.parametrize(("most", "wear", "found"), [(16, 0.05, False), (16, 0.2, True), (60, 0.05, True)])
def test_a_neighbour_may_take_twice_the_periods(monkeypatch, most, wear, found):
    """Trial steps that went far too far took six times as many, several in each fit; few are no reason to stop."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    rig = replace(small_rig.rig(small_rig.observed(SD, (0, 400_000), (), 1e-12, 1e-7)), most_periods=most)
    near, deep = rig.simulate(Hypothesis(wear=wear)), Hypothesis(wear=4.0)
    if found:
        assert rig.simulate(deep, near).steps[-1].solves == rig.simulate(deep).steps[-1].solves
    else:
        twice = 2 * near.steps[-1].solves
        assert rig.simulate(deep).steps[-1].solves > twice
        with pytest.raises(NonConvergenceError, match=f"more than {twice} periods"):
            rig.simulate(deep, near)


def test_a_load_that_is_raised_is_never_tried_twice_from_the_same_start():
    """From a half on, a step of one and a step of a half both end at the whole load."""
    tried = []

    class Failing(quasi_static.QuasiStaticSolver):
        """A solver that finds nothing beyond six tenths."""

        def _find(self, problem, samples, start, settling=True):
            tried.append((start, problem))
            if problem > 0.6:
                raise NonConvergenceError("beyond")
            return problem

    with pytest.raises(NonConvergenceError):
        Failing(None)._raised(lambda share: share, 64, None, 0.5)
    assert tried[:2] == [(None, 0.5), (0.5, 1.0)]
    assert len(set(tried)) == len(tried)
