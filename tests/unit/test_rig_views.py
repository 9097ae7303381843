"""What the report draws of the rig: loops shown, differences, held-out errors.

What carries the weight: a prediction that is off by nothing but the scatter of the repeats comes to 1, one with
another zero of a loop is not worse, and a known error shows with its size and at its place.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.experiments.loops import PHASES, Strokes
from fretflow.experiments.rig.held_out import detect
from fretflow.experiments.rig.law import residual_law
from fretflow.experiments.rig.observation import Observation, Piece, condition_labels, count_label
from fretflow.experiments.rig.views import comparisons, evolved, held_out_error, residual_maps, wear_map
from fretflow.inference.experiment import Covariance
from fretflow.recordings.schema import RecordedTest, SweepCondition

SAMPLES, REPEATS, FLOOR = 101, 4, 0.1
WITHIN = 1.0 - 1.0 / REPEATS  # variance of a repeat about the mean of all, over that of a repeat
COUNTS = tuple(range(0, 120_000, 10_000))
PHASE = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
MOTION = 10e-6 * np.cos(PHASE)
FORCE = 50.0 * np.tanh(4.0 * np.cos(PHASE + 0.25 * np.pi))


def observation(values=None):
    places = [("loops", count, None, f"{count:_} cycles") for count in COUNTS]
    places += [("sweep", -1, one, f"condition {one}") for one in (0, 1)]
    pieces, parts, floors = [], [], []
    for channel, loop, floor in (("displacement", MOTION, 1e-8), ("friction_force", FORCE, FLOOR)):
        for block, cycles, condition, label in places:
            at = SAMPLES * len(pieces)
            pieces.append(Piece(block=block, channel=channel, cycles=cycles, condition=condition, start=at,
                                stop=at + SAMPLES, label=label))
            parts.append(loop)
            floors.append(np.full(SAMPLES, floor))
    at = SAMPLES * len(pieces)
    pieces.append(Piece(block="map", channel="wear_depth", cycles=COUNTS[-1], condition=None, start=at, stop=at + 3,
                        label="wear map"))
    floor = np.concatenate([*floors, np.full(3, 1e-8)])
    return Observation(
        values=np.concatenate([*parts, [1e-6, 2e-6, 3e-6]]) if values is None else values,
        variance=floor**2 / REPEATS, noise=np.ones(len(floor)), modes=np.zeros((len(floor), 0)), floor=floor,
        pieces=tuple(pieces), harmonics=SAMPLES // 2, aligned_to="excitation",
        conditions=(SweepCondition(id=0, normal_load="50 N"), SweepCondition(id=1, normal_load="60 N")),
        points=1e-3 * np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 1.0]]))


def test_eight_counts_with_both_ends_and_all_conditions_are_shown():
    seen = observation()
    shown = comparisons(seen, seen.values, seen.values, {"condition 1"})
    counts = [one.label for one in shown if "cycles" in one.label]
    assert len(counts) == 8
    assert counts[0] == "0 cycles"
    assert counts[-1] == "110_000 cycles"
    assert [one.label for one in shown if one.held_out] == ["condition 1"]
    assert shown[-2].label == "condition 0"


def test_every_held_out_loop_is_shown_with_its_samples():
    """What was held out beyond the eighth count had been dropped, and measured loops were drawn by their harmonics."""
    seen = observation()
    out, raw = {f"{count:_} cycles" for count in COUNTS[3:7]}, (np.arange(7.0), np.ones(7))
    shown = comparisons(seen, seen.values, seen.values, out, {"30_000 cycles": raw})
    assert {one.label for one in shown if one.held_out} == out
    own = next(one for one in shown if one.label == "30_000 cycles")
    assert own.raw_displacement == pytest.approx(raw[0])
    assert own.raw_force == pytest.approx(raw[1])


def test_all_counts_are_read_over_the_cycles():
    """Half the force is half the friction, the energy and the stiffness, at the same sliding distance."""
    seen = observation()
    half = seen.values * np.where(seen.rows(channel="friction_force"), 0.5, 1.0)
    evolution = evolved(seen, seen.values, half)
    assert evolution.cycles == pytest.approx(COUNTS)
    area = np.sum(0.5 * (FORCE + np.roll(FORCE, -1)) * (np.roll(MOTION, -1) - MOTION))
    assert evolution.dissipated_energy[0] == pytest.approx(abs(area), rel=0.02)
    for name, share in (("dissipated_energy", 0.5), ("friction_limit", 0.5), ("tangential_stiffness", 0.5),
                        ("sliding_distance", 1.0)):
        measured, before, after = getattr(evolution, name)
        assert before == pytest.approx(measured)
        assert after == pytest.approx(share * measured, rel=1e-6)


def test_another_zero_of_a_loop_is_no_difference():
    seen = observation()
    shifted = seen.values + np.where(seen.rows(channel="friction_force"), 3.0, 0.0)
    shown = comparisons(seen, shifted, seen.values)[0]
    assert shown.before_force == pytest.approx(shown.force)
    maps = residual_maps(seen, Covariance(seen.variance, seen.modes), shifted, seen.values)
    assert maps[1].before == pytest.approx(0.0, abs=1e-9)
    assert held_out_error(seen, shifted) == pytest.approx(held_out_error(seen, seen.values), rel=1e-12)


def test_a_known_error_shows_where_it_is_and_with_its_size():
    seen = observation()
    wrong = np.array(seen.values)
    piece = next(one for one in seen.pieces if one.channel == "friction_force" and one.cycles == COUNTS[3])
    wrong[piece.place] -= 0.5 * np.cos(PHASE)
    force = residual_maps(seen, Covariance(seen.variance, seen.modes), wrong, seen.values)[1]
    assert force.channel == "friction_force"
    assert force.rows[3] == piece.label
    assert force.before[3] == pytest.approx(0.5 * np.cos(PHASE) / (FLOOR / np.sqrt(REPEATS)))
    assert np.abs(np.delete(force.before, 3, axis=0)).max() == 0.0
    assert np.abs(force.after).max() == 0.0
    assert held_out_error(seen, wrong, seen.rows(label=piece.label, channel="friction_force")) == pytest.approx(
        np.sqrt(0.5 * (0.5 / FLOOR)**2 + WITHIN))


def test_a_perfect_prediction_errs_as_single_repeats_do():
    true = observation()
    generator = np.random.default_rng(3)
    seen = observation(true.values + generator.standard_normal(len(true.values)) * np.sqrt(true.variance))
    assert held_out_error(seen, seen.values) == pytest.approx(np.sqrt(WITHIN))
    assert held_out_error(seen, true.values) == pytest.approx(1.0, rel=0.05)


def test_the_map_of_wear_is_put_at_its_points():
    seen = observation()
    shown = wear_map(seen, 2.0 * seen.values, seen.values)
    assert shown.measured == pytest.approx([1e-6, 2e-6, 3e-6], abs=0.0)
    assert shown.before == pytest.approx(2.0 * shown.after, abs=0.0)
    assert shown.x == pytest.approx([0.0, 5e-4, 1e-3], abs=0.0)


@pytest.mark.parametrize(("way", "state"), [
    (lambda seen: 2.0 * (MOTION / 10e-6) ** 3, "displacement"),
    (lambda seen: -2.0 * np.sin(PHASE), "velocity over the angular frequency")])
def test_a_law_of_one_state_is_found(way, state):
    seen = observation()
    predicted = np.array(seen.values)
    for piece in seen.pieces:
        if piece.channel == "friction_force":
            predicted[piece.place] -= way(seen)
    law = residual_law(seen, predicted)
    assert (law.channel, law.state, law.state_unit) == ("friction_force", state, "m")
    assert law.explained > 0.95
    share = law.x / 10e-6
    assert law.y == pytest.approx(2.0 * (share**3 if state == "displacement" else share), abs=0.15)


def test_friction_that_grows_over_the_test_follows_the_cycles():
    seen = observation()
    predicted = np.array(seen.values)
    for piece in seen.pieces:
        if piece.channel == "friction_force":
            late = COUNTS[-1] if piece.condition is not None else piece.cycles
            way = Strokes.of(MOTION, FORCE).way
            predicted[piece.place] -= 3.0 * late / COUNTS[-1] * way
    law = residual_law(seen, predicted)
    assert law.state == "cycles"
    assert law.y == pytest.approx(3.0 * law.x / COUNTS[-1], abs=0.1)


def test_phases_follow_each_other_along_a_stroke():
    """An elastic slider whose spring is stuck over a tenth of the stroke: it slides from there on."""
    x = 10e-6 * np.cos(PHASE)
    force, held = np.empty(SAMPLES), 0.0
    for _ in range(2):
        for k in range(SAMPLES):
            held = np.clip(held + 50.0 / 1e-6 * (x[k] - x[k - 1]), -50.0, 50.0)
            force[k] = held
    strokes = Strokes.of(x, force)
    falling = strokes.phase[1:SAMPLES // 2 - 1]
    assert np.all(np.diff(falling) >= 0)
    assert set(np.unique(falling)) <= set(range(len(PHASES)))
    sliding = strokes.phase >= PHASES.index("plateau")
    away = np.abs(x) < 5e-6
    assert np.all(sliding[away])
    assert not np.any(sliding & (strokes.since < 0.5e-6))
    assert np.all(strokes.way[1:SAMPLES // 2 - 1] == -1.0)


def test_loops_are_called_by_what_they_were_made_at():
    assert count_label(220_000) == "220,000 cycles"
    test = RecordedTest(kind="fretting-rig", excitation_amplitude="60 N", normal_load="60 N",
                        excitation_frequency="100 Hz")
    names = condition_labels([SweepCondition(id=0, excitation_amplitude="53 N", normal_load="60 N"),
                              SweepCondition(id=1),
                              SweepCondition(id=2, normal_load="45.5 N", excitation_frequency="80 Hz"),
                              SweepCondition(id=3, excitation_amplitude="53 N")], test)
    assert names == {0: "excitation 53 N", 1: "as in the test", 2: "load 45.5 N, 80 Hz",
                     3: "excitation 53 N (condition 3)"}


def test_maps_count_errors_that_samples_share_and_no_zero():
    """An offset of a loop is levelled away, so that it widens nothing; half of a wave that is not known does."""
    seen = observation()
    piece = next(one for one in seen.pieces if one.channel == "friction_force")
    modes = np.zeros((len(seen.values), 2))
    modes[piece.place, 0], modes[piece.place, 1] = 50.0, 3.0 * np.cos(PHASE)
    wrong = np.array(seen.values)
    wrong[piece.place] -= 3.0 * np.cos(PHASE)
    sd = FLOOR / np.sqrt(REPEATS)
    shown = residual_maps(seen, Covariance(seen.variance, modes), wrong, seen.values)[1].before[0]
    assert shown == pytest.approx(3.0 * np.cos(PHASE) / np.hypot(sd, 3.0 * np.cos(PHASE)))


def test_errors_of_timing_that_are_not_there_hide_nothing():
    """Three quarters of the variance may be there and are not: noise alone passes, half as much beside it does not."""
    seen = observation()
    seen = seen.less_sure(3.0 * seen.variance, np.zeros((len(seen.values), 0)))
    noise = 0.5 * np.random.default_rng(6).standard_normal(len(seen.values))
    slope = np.sqrt(seen.variance)[:, None]

    def p_value(left):
        fit = SimpleNamespace(residual=left, chi_squared=float(left @ left), z=np.zeros(1), whitened_jacobian=slope)
        return detect(seen, fit).tests["chi-squared of all that is left"]

    assert p_value(noise) > 0.05
    assert p_value(np.sqrt(1.5) * noise) < 1e-6


def test_a_baseline_that_was_fitted_under_other_errors_is_no_sign_of_anything():
    """Its parameter is five sd off the optimum under the noise alone: what is left has a degree of freedom less."""
    seen = observation()
    noise = np.random.default_rng(6).standard_normal(len(seen.values))
    slope = np.column_stack([np.ones(len(noise)), np.zeros(len(noise))])  # the second one does nothing here

    def p_values(left):
        fit = SimpleNamespace(residual=left, chi_squared=float(left @ left), z=np.zeros(2), whitened_jacobian=slope)
        return detect(seen, fit).tests

    assert min(p_values(noise).values()) > 0.01
    off = p_values(noise + 5.0 * slope[:, 0])
    assert [*off.values()] == pytest.approx([*p_values(noise).values()], rel=1e-6)


def test_what_is_left_in_one_loop_alone_is_detected():
    """Its zero is two sd off: no harmonic, and no more in all than noise that is told a little too large."""
    seen = observation()
    noise = 0.9 * np.random.default_rng(4).standard_normal(len(seen.values))
    loop = next(one for one in seen.pieces if one.channel == "friction_force")

    def p_value(left):
        fit = SimpleNamespace(residual=left, chi_squared=float(left @ left), z=np.zeros(1),
                              whitened_jacobian=np.ones((len(left), 1)))
        return detect(seen, fit).tests["chi-squared of a channel of one loop"]

    assert p_value(noise) > 0.05
    noise[loop.place] += 2.0
    assert p_value(noise) < 1e-3


def test_a_mean_that_all_loops_share_is_detected():
    """A zero one sd off in all loops of a channel is no harmonic, and little in all beside noise."""
    seen = observation()
    noise = np.random.default_rng(4).standard_normal(len(seen.values))

    def p_value(left):
        fit = SimpleNamespace(residual=left, chi_squared=float(left @ left), z=np.zeros(0),
                              whitened_jacobian=np.zeros((len(left), 0)))
        return detect(seen, fit).tests["means and harmonics of the loops by their trend over the cycles"]

    assert p_value(noise) > 0.05
    noise[seen.rows(block="loops", channel="friction_force")] += 1.0
    assert p_value(noise) < 1e-3
