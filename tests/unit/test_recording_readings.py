"""Readings of recorded loops and their uncertainty.

What carries the weight: of 200 recordings made with the same noise, the interval that is stated to hold the truth
in nine of ten does so in 84 to 96 of a hundred, for every reading; and gains enter with their exact powers.
"""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from fretflow.core.errors import UnreliableRecordingError
from fretflow.recordings import readings
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.readings import Source, read_recorded_loops
from fretflow.recordings.repeatability import (
    deviations,
    is_unsteady,
    moderated,
    repeatability,
    smooth_share,
    smooth_waves,
)

LOAD, NORMAL_90 = 60.0, 1.6449
TURNS = (np.arange(160) + 0.37) / 160


def loop_set(spring_slider, cycles=1, repeats=1, noise=(0.0, 0.0), gain=0.0, rng=None, calibration=(0.0, 0.0), **shape):
    x, force = spring_slider(TURNS, **shape)
    size = (cycles, repeats, len(TURNS))
    rng = rng or np.random.default_rng(0)
    gains = 1.0 + gain * rng.standard_normal((2, cycles, repeats, 1))
    return LoopSet(
        cycles=np.arange(cycles) * 100, frequency=np.full(cycles, 100.0), phase=2.0 * np.pi * TURNS,
        channels={"displacement": x * gains[0] + noise[0] * rng.standard_normal(size),
                  "friction_force": force * gains[1] + noise[1] * rng.standard_normal(size)},
        units={"displacement": "m", "friction_force": "N"}, sd={},
        calibration_sd={"displacement": calibration[0], "friction_force": calibration[1]}, displacement_of=None,
        aligned_to="displacement")


def coverage(seen, exact):
    """Return the share of readings whose 90 % interval holds the exact one, by quantity."""
    shares = {}
    for name, value in exact.items():
        inside = [np.abs(getattr(s, name).value - value) <= NORMAL_90 * getattr(s, name).sd for s in seen]
        shares[name] = float(np.mean(np.concatenate(inside)))
    return shares


def read(loops, **options):
    return read_recorded_loops(loops, np.full(len(loops.cycles), LOAD), **options)


def test_without_noise_the_readings_are_exact(spring_slider, exact):
    seen = read(loop_set(spring_slider))
    for name, value in exact().items():
        tolerance = {"friction_coefficient": 1e-6, "tangential_stiffness": 2e-4}.get(name, 1e-3)
        assert getattr(seen, name).value == pytest.approx([value], rel=tolerance, abs=0.0)
        assert getattr(seen, name).sd[0] < 1e-4 * value


def test_intervals_of_single_loops_cover(spring_slider, exact, monkeypatch):
    monkeypatch.setattr(readings, "DRAWS", 40)
    rng = np.random.default_rng(11)
    seen = [read(loop_set(spring_slider, noise=(8e-8, 0.4), rng=rng)) for _ in range(200)]
    for name, share in coverage(seen, exact()).items():
        assert 0.84 <= share <= 0.96, (name, share)
    # The largest of noisy samples is too large by more than a deviation; that is corrected.
    reach = np.array([(s.peak_to_peak.value[0] - exact()["peak_to_peak"]) / s.peak_to_peak.sd[0] for s in seen])
    assert abs(reach.mean()) < 0.3


def test_intervals_of_repeats_that_differ_in_gain_cover(spring_slider, exact, monkeypatch):
    monkeypatch.setattr(readings, "DRAWS", 20)
    rng = np.random.default_rng(12)
    seen = [read(loop_set(spring_slider, 5, 3, (4e-8, 0.2), 0.01, rng)) for _ in range(40)]
    for name, share in coverage(seen, exact()).items():
        assert 0.84 <= share <= 0.96, (name, share)
    assert seen[0].friction_coefficient.dominated_by[0] is Source.REPEATS


def test_gains_enter_by_their_powers(spring_slider, exact):
    calibrated = loop_set(spring_slider, calibration=(0.03, 0.04))
    seen = read(calibrated, normal_load_sd=0.12)
    relative = {"friction_coefficient": np.hypot(0.04, 0.12), "tangential_stiffness": 0.05, "dissipated_energy": 0.05,
                "sliding_distance": 0.03, "peak_to_peak": 0.03, "friction_limit": 0.04}
    for name, share in relative.items():
        estimate = getattr(seen, name)
        assert estimate.sd == pytest.approx(share * estimate.value, rel=1e-6, abs=0.0)
        assert estimate.dominated_by == (Source.CALIBRATION,)


def test_gain_of_each_channel_changes_the_readings_as_stated(spring_slider):
    base = loop_set(spring_slider)
    before = read(base)
    for channel, place in (("displacement", 0), ("friction_force", 1)):
        channels = {name: values * (1.01 if name == channel else 1.0) for name, values in base.channels.items()}
        after = read(replace(base, channels=channels))
        for name, powers in readings.POWERS.items():
            known = "tangential_stiffness" if name == "tangential_compliance" else name
            sign = -1 if name == "tangential_compliance" else 1
            ratio = getattr(after, known).value[0] / getattr(before, known).value[0]
            assert ratio == pytest.approx(1.01 ** (sign * powers[place]), rel=1e-9)


def test_stiffness_hidden_by_noise_gets_a_lower_bound_that_holds(spring_slider):
    rng = np.random.default_rng(8)
    # The spring of 200 N/um yields over 0.36 um; noise hides that in a single loop.
    seen = [read(loop_set(spring_slider, noise=(3e-7, 0.4), rng=rng, stiffness=200e6)) for _ in range(16)]
    hidden = [s for s in seen if np.isnan(s.tangential_stiffness.value[0])]
    assert len(hidden) > 4
    bounds = np.array([s.stiffness_at_least[0] for s in hidden])
    assert np.mean(bounds[np.isfinite(bounds)] < 200e6) > 0.9


def test_peaks_of_a_triangular_motion_are_not_rounded():
    ramp = np.linspace(-1.0, 1.0, 100, endpoint=False)
    x = 5e-6 * np.r_[ramp, -ramp]
    loops = LoopSet(cycles=np.array([0]), frequency=np.array([1.0]), phase=2.0 * np.pi * np.arange(200) / 200,
                    channels={"displacement": x[None, None, :],
                              "force": np.r_[np.full(100, 9.0), np.full(100, -9.0)][None, None, :]},
                    units={}, sd={}, calibration_sd={}, displacement_of=None, aligned_to="displacement")
    assert read(loops).peak_to_peak.value == pytest.approx([1e-5], rel=1e-9, abs=0.0)


def test_no_normal_load_leaves_the_friction_limit(spring_slider):
    seen = read_recorded_loops(loop_set(spring_slider), np.array([np.nan]))
    assert np.isnan(seen.friction_coefficient.value[0])
    assert seen.friction_limit.value == pytest.approx([36.0], rel=1e-6)


def test_neighbouring_cycles_stand_for_repeats(spring_slider):
    rng = np.random.default_rng(2)
    loops = loop_set(spring_slider, cycles=80)
    channels = dict(loops.channels)
    channels["friction_force"] = channels["friction_force"] * (1.0 + 0.02 * rng.standard_normal((80, 1, 1)))
    varying = replace(loops, channels=channels, cycles=np.arange(80))
    seen = read(varying, consecutive=True)
    assert seen.friction_coefficient.sd == pytest.approx(0.02 * seen.friction_coefficient.value, rel=0.2)


def test_a_loop_that_cannot_be_read_names_its_cycle(spring_slider):
    loops = loop_set(spring_slider)
    channels = {**loops.channels, "friction_force": -loops.force}
    with pytest.raises(UnreliableRecordingError, match="cycle 0: loop: its energy is negative"):
        read(replace(loops, channels=channels))


def test_repeats_tell_noise_gain_and_offset_apart(spring_slider):
    rng = np.random.default_rng(6)
    force = spring_slider(TURNS)[1]
    size = np.where(np.cos(2.0 * np.pi * TURNS) > 0.0, 0.6, 0.2)
    values = (force * (1.0 + 0.02 * rng.standard_normal((60, 4, 1))) + 0.5 * rng.standard_normal((60, 4, 1))
              + size * rng.standard_normal((60, 4, 160)))
    scatter = repeatability(values)
    assert scatter.noise_sd[size > 0.4].mean() == pytest.approx(0.6, rel=0.03)
    assert scatter.noise_sd[size < 0.4].mean() == pytest.approx(0.2, rel=0.03)
    assert scatter.gain_sd == pytest.approx(0.02, rel=0.15)
    assert scatter.offset_sd == pytest.approx(0.5, rel=0.15)
    # The covariance of a mean of four is what repeating the whole test shows.
    loop = force - force.mean()
    truth = (np.diag(size**2) + 0.02**2 * np.outer(loop, loop) + 0.5**2) / 4.0
    assert np.trace(scatter.covariance(0)) == pytest.approx(np.trace(truth), rel=0.15)
    assert scatter.repeat_sd**2 == pytest.approx(4.0 * np.diag(truth), rel=0.6)


@pytest.mark.parametrize("repeats", [(5, 2), (8, 3)])
def test_few_repeats_weigh_no_phase_more_than_another_by_chance(repeats):
    """Means of noise over its variance have a mean square of one; over 5 free differences each, it would be 5/3."""
    rng = np.random.default_rng(8)
    loop = np.sin(2.0 * np.pi * np.arange(25) / 25.0)
    squares = []
    for _ in range(200):
        noise = 0.2 * rng.standard_normal((*repeats, 25))
        scatter = repeatability(loop + noise)
        squares.append(np.mean(noise.mean(axis=1)**2 / (scatter.noise_sd**2 / scatter.repeats[:, None])))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)  # 25 phases tell their own scatter to a sixth


def test_moderated_variances_are_those_that_the_prior_makes_probable():
    """Drawn from the distribution that is assumed, they are nearer to the truth than each by itself, and unbiased."""
    rng = np.random.default_rng(9)
    true = 3.0 * 6.0 / rng.chisquare(6.0, 4000)
    sample = true * rng.chisquare(5.0, 4000) / 5.0
    variances = moderated(sample, 5)
    assert np.mean(variances / true) == pytest.approx(1.0, abs=0.03)
    assert np.std(np.log(variances / true)) < 0.75 * np.std(np.log(sample / true))
    assert moderated(np.array([0.0, 1.0]), 5) == pytest.approx([0.0, 1.0])  # what never differs tells no scale


def test_the_colour_of_noise_is_told_by_its_first_harmonics():
    """White noise with waves of thrice its variance in each of the first harmonics; white noise alone has none."""
    rng = np.random.default_rng(12)
    loop = np.sin(2.0 * np.pi * np.arange(25) / 25.0)

    def excess(sd: float) -> float:
        made = [loop + rng.standard_normal((6, 3, 25)) + sd * rng.standard_normal((6, 3, 10)) @ smooth_waves(25).T
                for _ in range(100)]
        return float(np.mean([repeatability(one).smooth_excess for one in made]))

    assert excess(np.sqrt(3.0)) == pytest.approx(3.0, rel=0.15)
    assert excess(0.0) < 0.1  # where one in twenty is taken for coloured


def test_noise_alone_is_no_gain(spring_slider):
    rng = np.random.default_rng(7)
    force = spring_slider(TURNS)[1]
    scatters = [repeatability(force + 0.5 * rng.standard_normal((8, 3, 160))) for _ in range(40)]
    # Noise feigns a gain of 0.5 / sqrt(160) / rms of the loop, 0.13 %; half of that is left at most.
    assert np.sqrt(np.mean([f.gain_sd**2 for f in scatters])) < 0.7e-3


def test_absent_repeats_do_not_count(spring_slider):
    rng = np.random.default_rng(10)
    values = spring_slider(TURNS)[1] + 0.4 * rng.standard_normal((30, 3, 160))
    values[::2, 2] = np.nan
    scatter = repeatability(values)
    assert scatter.repeats.tolist() == [2, 3] * 15
    assert scatter.noise_sd.mean() == pytest.approx(0.4, rel=0.05)
    with pytest.raises(UnreliableRecordingError, match="no cycle count has two repeats"):
        repeatability(values[:, :1])


def test_repeats_that_differ_as_a_motion_does_are_told_from_noise():
    """Not gains, offsets, white noise, noise of a colour or what a parameter that scatters does."""
    rng, phase = np.random.default_rng(11), 2.0 * np.pi * np.arange(160) / 160
    loops, square = np.broadcast_to(np.cos(phase), (40, 3, 160)), np.sign(np.sin(phase - 0.7))
    shapes = 2 * [np.broadcast_to(square, (40, 160))]

    def one(*also):
        """Return repeats with noise of their own, and the same in both channels of what they share."""
        gains, offsets = 1.0 + 0.2 * rng.standard_normal((40, 3, 1)), rng.standard_normal((40, 3, 1))
        return gains * loops + offsets + 0.1 * rng.standard_normal(loops.shape) + sum(also)

    wander, beat, scatter = (size * rng.standard_normal((40, 3, 1)) for size in (1.0, 1.0, 0.5))
    coloured = (rng.standard_normal((40, 3, 1)) * np.sin(2.0 * phase) for _ in range(2))
    assert not is_unsteady(one(), one())
    assert not is_unsteady(*(one(colour) for colour in coloured))
    assert is_unsteady(one(wander * np.sin(phase)), one(2.0 * wander * np.sin(phase - 0.3)))
    both = [one(scatter * square), one(-scatter * square)]
    assert is_unsteady(*both)
    assert not is_unsteady(*both, shapes)
    assert is_unsteady(*(each + beat * np.sin(2.0 * phase) for each in both), shapes)
    assert not is_unsteady(*(each[:, :1] for each in both))
    assert smooth_share(deviations(one())) == pytest.approx(10.0 / 160.0, rel=0.2)


def test_cycles_in_which_nothing_slides_scatter_by_nothing():
    """Dividing by no sliding was a warning of numpy on the terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scatter = readings._scatter_of_neighbours(
            np.arange(3), {"peak_to_peak": np.ones(3), "sliding_distance": np.zeros(3)})
    assert not scatter["sliding_distance"].any()
