"""A wear test whose motion jumps over a fold of the response.

What carries the weight: of motions that coexist at a later cycle count the measured one is predicted, and goes on from
there; the loops before the jump are an experiment of their own, which predicts what the whole one does there.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.effects.support_nonlinearity import SupportNonlinearity
from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.observation import is_other_motion
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.experiment import Point, Prediction
from fretflow.recordings.schema import SweepCondition

COUNTS = (0, 10, 20)  # too few cycles for wear to bring the motion anywhere
SD = {"displacement": 1e-7, "friction_force": 0.5}
FOLDED = Hypothesis(effects=(SupportNonlinearity().changed(stiffness=1.4e15),))


@pytest.fixture
def rig(monkeypatch):
    """Return the small rig at 90 Hz, where motions on a hardening support coexist."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    seen = small_rig.observed(SD, COUNTS, (SweepCondition(id=0, normal_load="58 N"),), 2e-15, 3e-9)
    made = small_rig.rig(seen)
    return replace(made, problem=made.problem.vary(frequency=90.0))


def measured(rig, displacement, after):
    """Return a rig whose recording has displacements by the cycle count, and one at the other condition after that."""
    values = rig.observation.values.copy()
    for count, own in displacement.items():
        values[rig.observation.rows(block="loops", channel="displacement", cycles=count)] = own
    values[rig.observation.rows(block="sweep", channel="displacement")] = after
    return replace(rig, observation=replace(rig.observation, values=values))


@pytest.fixture
def branches(rig):
    """Return the displacement of the small motion and of the large one."""
    spans = {}
    for stiffness in (1e15, 2e15):
        own = rig.simulate(Hypothesis(effects=(SupportNonlinearity().changed(stiffness=stiffness),)))
        spans[stiffness] = rig.predict(own)[rig.observation.rows(block="loops", channel="displacement", cycles=0)]
    return spans[1e15], spans[2e15]


def test_of_coexisting_motions_the_one_measured_at_each_count_is_predicted(rig, branches):
    small, large = branches
    for aimed in ((small, small, small), (small, large, large), (large, large, small)):
        own = measured(rig, dict(zip(COUNTS, aimed, strict=True)), aimed[-1])
        simulation = own.simulate(FOLDED)
        spans = [np.ptp(own.displacement(period)) for period in simulation.loops]
        wanted = [np.ptp(one) for one in aimed]
        assert spans == pytest.approx(wanted, rel=0.25)
        assert [step.cycles for step in simulation.steps if step.cycles in COUNTS] == list(COUNTS)
        for period in simulation.loops:  # what wear goes on from is the motion that is shown
            (step,) = (one for one in simulation.steps if one.cycles == period.step.cycles)
            assert step is period.step


def test_the_loops_before_a_jump_are_an_experiment_of_their_own(rig, branches):
    small, large = branches
    own = measured(rig, {0: small, 10: 1.01 * small, 20: large}, large)
    size = len(own.observation.values)
    correction = np.arange(size) * 1e-9
    experiment = RigExperiment(own, correction, np.ones((size, 2)), embedded=np.ones((size, 3)))
    assert experiment.last_before_jump == 10
    point = Point(experiment.parameters(()), np.zeros(experiment.parameters(()).size))
    still = Prediction(point, np.zeros(size))  # of no motion at all, at any count
    assert experiment.before_jump(Prediction(point, 1.2 * own.observation.values)) is None  # which jumps as well
    part = experiment.before_jump(still)
    kept, _ = own.observation.until(10)
    assert [piece.cycles for piece in part.rig.observation.pieces] == [0, 10, 0, 10]
    assert part.measurement.values == pytest.approx(own.observation.values[kept])
    assert part.before_jump(still) is None
    assert part.rig.observation.conditions == ()
    whole, before = experiment.predict(point), part.predict(point)
    assert before.values == pytest.approx(whole.values[kept], rel=1e-6, abs=1e-9)
    assert part.measurement.covariance().modes.shape[0] == kept.sum()
    even, after = (replace(experiment, rig=measured(rig, dict.fromkeys(COUNTS, small), one)) for one in (small, large))
    assert even.before_jump(still) is None
    assert len(after.before_jump(still).measurement.groups) == len(COUNTS)  # at the other condition alone
    heavier = replace(rig, observation=replace(rig.observation, conditions=(
        SweepCondition(id=0, excitation_amplitude="130 N"),)))
    heavier_too = replace(experiment, rig=measured(heavier, dict.fromkeys(COUNTS, small), 2.5 * small))
    assert heavier_too.before_jump(still) is None


def test_another_motion_differs_by_more_than_the_smaller_one():
    assert is_other_motion(1.0, -0.1)
    assert is_other_motion(1.0, 2.1)
    assert not is_other_motion(1.0, 1.9)
    assert is_other_motion(1.0, 1.2j)
