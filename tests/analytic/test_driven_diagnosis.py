"""Diagnoses of made-up driven joints: nothing, one effect, and what no effect of the catalogue does.

What carries the weight: the force of a slider marched sample by sample here, not by the package's own march, so that a
wrong model of the baseline would raise alarms; and noise of which the standard deviation is known.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.core.errors import RecordingError, UnreliableRecordingError, UnsupportedRecordingError
from fretflow.experiments.driven.data import driven_data
from fretflow.experiments.driven.noise import correlation_length, effective
from fretflow.experiments.driven.run import diagnose_driven, searched
from fretflow.experiments.driven.views import comparisons
from fretflow.experiments.independent import estimates
from fretflow.inference.verdict import Verdict
from fretflow.pipeline.diagnose import diagnose
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED
from fretflow.recordings.loopset import LoopSet, Series
from fretflow.recordings.recording import Recording
from fretflow.recordings.schema import RecordedTest, RecordedWear

K, S, X, HERTZ = 28e6, 50.0, 7e-6, 100.0
STEP, CYCLES = 1.0 / 20000.0, 6
SIZE = 0.02 * S  # of the noise


def quiet(share, text):
    pass


def motion(seed):
    """Return time, the true displacement and its velocity; amplitudes differ a little from cycle to cycle."""
    t = STEP * np.arange(round((CYCLES + 0.6) / HERTZ / STEP))
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * HERTZ * t
    size = X * (1.0 + 0.002 * rng.standard_normal())
    return t, -size * np.cos(angle), size * 2.0 * np.pi * HERTZ * np.sin(angle)


def slid(x, up=S, down=S, play=0.0, stiffness=K):
    """Return the force of a slider behind play, sample by sample."""
    z, force = -0.5 * play - down / stiffness, []
    for step in np.diff(x, prepend=x[0]):
        z = min(max(z + step, -0.5 * play - down / stiffness), 0.5 * play + up / stiffness)
        force.append(stiffness * (z - min(max(z, -0.5 * play), 0.5 * play)))
    return np.array(force)


def recording(t, x, force, kind=IMPOSED_DISPLACEMENT, timed=True):
    series = Series(time=t if timed else None, channels={"displacement": x, "force": force},
                    usable=np.ones(len(t), bool), units={"displacement": "m", "force": "N"}, sd={}, calibration_sd={},
                    displacement_of=None)
    return Recording(path="made", title="made", test=RecordedTest(kind=kind), rig=None, specimen=None, given={},
                     wear=RecordedWear(), loops=None, series=series, sweep=None, frf=None, wear_depth=None, notes=())


def made(force_of, seed=0, kind=IMPOSED_DISPLACEMENT, timed=True, size=SIZE):
    t, x, v = motion(seed)
    rng = np.random.default_rng(1000 + seed)
    return recording(t, x + 1e-3 * X * rng.standard_normal(len(x)), force_of(t, x, v) + size * rng.standard_normal(
        len(x)), kind, timed)


def test_nothing_is_found_where_nothing_is_missing():
    """In at least 95 % of 40 recordings, whose baseline differs from any default."""
    verdicts = [diagnose_driven(made(lambda t, x, v: slid(x), seed), True, quiet).verdict for seed in range(40)]
    assert sum(one is Verdict.NONE for one in verdicts) >= 38


def test_corners_of_the_motion_raise_no_alarm():
    """A triangular motion, whose corners are rounded where its noise is smoothed."""
    t = np.arange(5000) / 5000.0
    x = X * (2.0 * np.abs(2.0 * ((4.3 * t) % 1.0) - 1.0) - 1.0)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        diagnosis = diagnose_driven(recording(t, x + 1e-3 * X * rng.standard_normal(len(t)),
                                              slid(x) + SIZE * rng.standard_normal(len(t))), True, quiet)
        assert diagnosis.verdict is Verdict.NONE


def test_a_body_without_friction_is_left_alone():
    def body(t, x, v):
        return 120.0 * (2.0 * np.pi * HERTZ)**2 * -x + 8e3 * v

    verdicts = [diagnose_driven(made(body, seed, LUMPED, size=0.3), True, quiet).verdict for seed in range(8)]
    assert sum(one is Verdict.NONE for one in verdicts) >= 7


EFFECTS = {
    "backlash": lambda t, x, v: slid(x, play=2e-6),
    "directional-friction": lambda t, x, v: slid(x, up=1.07 * S, down=0.93 * S),
    "force-offset": lambda t, x, v: slid(x) + 6.0,
    "parallel-stiffness": lambda t, x, v: slid(x) + 1e6 * x,
    "viscous": lambda t, x, v: slid(x) + 0.15 * S / (X * 2.0 * np.pi * HERTZ) * v,
    "sensor-drift": lambda t, x, v: slid(x) + 8.0 * t / t[-1],
    "channel-delay": lambda t, x, v: np.interp(t - 3.0 * STEP, t, slid(x)),
    "distributed-micro-slip": lambda t, x, v: np.mean([slid(x, 2.0 * S * q, 2.0 * S * q) for q in
                                                       (np.arange(20) + 0.5) / 20], axis=0),
}


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_of_clear_size_is_named_or_among_those_that_act_alike(name):
    diagnosis = diagnose_driven(made(EFFECTS[name]), True, quiet)
    assert diagnosis.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert name in diagnosis.effects
    assert diagnosis.held_out.after < 1.3
    assert diagnosis.held_out.before > diagnosis.held_out.after
    if len(diagnosis.effects) == 1:
        assert diagnosis.probability > 0.7


def test_what_the_catalogue_lacks_is_not_named():
    def odd(t, x, v):
        return slid(x) + 0.6 * S * (x / X)**2 * v / (X * 2.0 * np.pi * HERTZ) * np.cos(6.0 * np.pi * x / X)

    diagnosis = diagnose_driven(made(odd), True, quiet)
    assert diagnosis.verdict is Verdict.UNKNOWN
    assert diagnosis.effects == ()
    assert diagnosis.residual_law is not None
    assert diagnosis.separating_measurement


def test_coulomb_friction_and_an_offset_of_a_body_have_intervals_that_hold():
    """A mass of 12 kg on 400 N s/m; friction of 20 N and an offset of -3 N."""
    true = {"baseline.mass": 12.0, "baseline.damping": 400.0, "coulomb-friction.friction_limit": 20.0,
            "force-offset.force_offset": -3.0}
    t = 1e-3 * np.arange(6000)
    rates = (0.7, 1.9)
    x = sum(0.02 / w * np.sin(2.0 * np.pi * w * t) for w in rates)
    v = sum(0.04 * np.pi * np.cos(2.0 * np.pi * w * t) for w in rates)
    a = sum(-0.08 * np.pi**2 * w * np.sin(2.0 * np.pi * w * t) for w in rates)
    noise = 0.5 * np.random.default_rng(5).standard_normal(len(t))
    force = 12.0 * a + 400.0 * v + slid(x, 20.0, 20.0, stiffness=2e7) - 3.0 + noise
    diagnosis = diagnose_driven(recording(t, x, force, LUMPED), False, quiet)
    assert {"coulomb-friction", "force-offset"} <= set(diagnosis.effects)
    assert "velocity-dependent-friction" not in diagnosis.effects
    for one in diagnosis.parameters:
        if one.name in true:
            assert one.low - 0.005 * abs(one.value) < true[one.name] < one.high + 0.005 * abs(one.value)
            assert one.high - one.low < 0.3 * abs(one.value)


def loops(force_of, samples=200, counts=5, repeats=3):
    """Return a recording of loops at several amplitudes, with repeats."""
    rng, phase = np.random.default_rng(7), 2.0 * np.pi * np.arange(samples) / samples
    shape = (counts, repeats, samples)
    x = np.broadcast_to((X * (1.0 + 0.1 * np.arange(counts)))[:, None, None] * np.cos(phase), shape)
    force = np.array([[force_of(np.tile(one, 3))[-samples:] for one in own] for own in x])
    loop_set = LoopSet(
        cycles=1 + 100 * np.arange(counts), frequency=np.full(counts, HERTZ), phase=phase, units={}, sd={},
        calibration_sd={}, displacement_of=None, aligned_to="displacement",
        channels={"displacement": x + 1e-3 * X * rng.standard_normal(shape),
                  "friction_force": force + SIZE * rng.standard_normal(shape)})
    return replace(made(EFFECTS["backlash"]), series=None, loops=loop_set)


def test_loops_with_repeats_are_diagnosed_too():
    """The noise is that between repeats; every third loop is held out."""
    plain = diagnose_driven(loops(slid), True, quiet)
    assert plain.verdict is Verdict.NONE
    assert plain.held_out.after == pytest.approx(1.0, abs=0.1)
    assert set(plain.smallest_visible) > {"backlash", "force-offset"}
    assert 0.0 < plain.smallest_visible["backlash"] < 1.0
    played = diagnose_driven(loops(lambda x: slid(x, play=2e-6)), True, quiet)
    assert played.effects == ("backlash",)
    play = next(one for one in played.parameters if one.name == "backlash.play")
    assert play.value == pytest.approx(2e-6, rel=0.1)
    assert {one.held_out for one in played.comparisons} == {True, False}


def test_all_loops_that_are_held_out_are_drawn():
    """Of 30 cycles the last ten are held out, of ten loops of three repeats every third row."""
    t = STEP * np.arange(round(30.6 / HERTZ / STEP))
    x = -X * np.cos(2.0 * np.pi * HERTZ * t)
    for data in (driven_data(recording(t, x, slid(x))), driven_data(loops(slid, samples=100, counts=10))):
        out = {one.label for one in data.cycles if one.held_out}
        shown = comparisons(data, data.force, data.force)
        assert len(out) == 10
        assert {one.label for one in shown if one.held_out} == out
        assert sum(not one.held_out for one in shown) in range(4, 9)


def test_every_sample_of_a_thinned_loop_stands_beside_those_that_are_compared():
    """Of a damper's 1,024 samples a cycle 202 were drawn as measured, its ringing as a zigzag."""
    t = 0.1 * STEP * np.arange(round(6.6 / HERTZ / (0.1 * STEP)))
    x = -X * np.cos(2.0 * np.pi * HERTZ * t)
    force = slid(x) + 5.0 * np.sin(2.0 * np.pi * 70.0 * HERTZ * t)
    data = driven_data(recording(t, x, force))
    assert data.every > 1
    for one, cycle in zip(comparisons(data, data.force, data.force), data.cycles, strict=True):
        assert len(one.raw_force) == cycle.stop - cycle.start > 1.5 * len(one.force)
        np.testing.assert_allclose(one.raw_force, force[cycle.start:cycle.stop])
        np.testing.assert_allclose(one.raw_displacement, x[cycle.start:cycle.stop])
    few = driven_data(loops(slid, samples=100, counts=10))  # all of which are compared
    assert all(one.raw_force is None for one in comparisons(few, few.force, few.force))


def test_effects_that_need_time_are_left_out_where_there_is_none():
    diagnosis = diagnose_driven(made(EFFECTS["parallel-stiffness"], timed=False), True, quiet)
    assert "parallel-stiffness" in diagnosis.effects
    assert any("viscous" in note and "no time axis" in note for note in diagnosis.warnings)
    assert all("viscous" not in one.effects for one in diagnosis.ranking)


def test_correlated_noise_counts_as_few_samples_and_widens_intervals():
    rng, n = np.random.default_rng(3), 60000
    white = rng.standard_normal(n)
    smooth = np.convolve(white, np.ones(10), "same")
    assert correlation_length((white,)) == pytest.approx(1.0, abs=0.1)
    assert correlation_length((smooth,)) == pytest.approx(10.0, rel=0.15)
    assert effective(smooth, np.ones(n, bool)) == pytest.approx(n / 10.0, rel=0.15)
    t, x, _ = motion(0)
    slow = np.convolve(rng.standard_normal(len(t) + 39), np.ones(40), "valid") / np.sqrt(40.0)
    widths = []
    for noise in (rng.standard_normal(len(t)), slow):
        data = driven_data(recording(t, x, slid(x) + SIZE * noise))
        search = searched(data, True, quiet)
        limit = next(one for one in estimates(search, frozenset())
                     if one.name == "baseline.friction_limit")
        widths.append(limit.high - limit.low)
    assert widths[1] > 2.5 * widths[0]


def test_a_screening_and_a_whole_search_agree_on_how_many_samples_are_alike():
    data = driven_data(made(EFFECTS["sensor-drift"]))
    fast, full = (searched(data, each, quiet).experiment.shared for each in (True, False))
    assert fast == pytest.approx(full, rel=1e-3)


def test_recordings_without_a_model_are_refused(tmp_path):
    whole = made(lambda t, x, v: slid(x))
    lacking = replace(whole, series=replace(whole.series, channels={"displacement": whole.series.channels[
        "displacement"]}))
    with pytest.raises(UnreliableRecordingError, match="displacement and force are both needed"):
        diagnose_driven(lacking, True, quiet)
    with pytest.raises(RecordingError, match="cannot be read"):
        diagnose(tmp_path)


def test_a_kind_without_a_diagnosis_is_refused_and_not_taken_for_another():
    made_up = made(lambda t, x, v: slid(x), kind=replace(LUMPED, experiment=""))
    with pytest.raises(UnsupportedRecordingError, match=r"kind 'lumped' has no diagnosis; there is one of facts, fre"):
        diagnose(made_up)
