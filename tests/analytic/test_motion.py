"""Rates of a measured motion: their bias and noise are what the closed forms say, and the noise floor is found.

What carries the weight: the bias is measured on sinusoids, the noise on white noise; neither knows the formulas.
"""

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.structure.motion import Motion, best_width, measure, noise_floor

STEP = 1e-3
TIME = STEP * np.arange(6001)


@pytest.mark.parametrize("frequency", [6.0, 9.0])
def test_bias_is_that_of_the_closed_forms(frequency):
    turning, inside = 2.0 * np.pi * frequency, slice(100, -100)
    x = np.sin(turning * TIME)
    measured, phase = measure(x, STEP, half_width=25), turning * 25 * STEP
    biases = -phase**6 / 33264.0, -phase**6 / 61776.0, -phase**4 / 792.0
    exact = (x, turning * np.cos(turning * TIME), -turning**2 * x)
    motion = measured.motion
    rates = motion.displacement, motion.velocity, motion.acceleration
    for got, true, expected in zip(rates, exact, biases, strict=True):
        bias = (got[inside] @ true[inside]) / (true[inside] @ true[inside]) - 1.0
        # the sums differ from integrals by 1 / (2 half_width), the next order of the series is some (w T)^2 / 10
        assert bias == pytest.approx(expected, rel=0.25)
        assert expected < 0.0


def rates_noise(measured):
    """Return the standard deviations of velocity and acceleration by noise, of sums taken as integrals."""
    span, n = measured.half_width * STEP, 2 * measured.half_width + 1
    return measured.noise * np.sqrt(3675.0 / 64.0 / n) / span, measured.noise * np.sqrt(551.25 / n) / span**2


def test_noise_of_the_rates_is_that_of_the_closed_forms():
    noise = 3e-6 * np.random.default_rng(5).normal(size=200_000)
    measured = measure(noise, STEP, half_width=60)
    assert measured.noise == pytest.approx(3e-6, rel=0.02, abs=0.0)
    assert measured.motion.velocity.std() == pytest.approx(rates_noise(measured)[0], rel=0.05)
    assert measured.motion.acceleration.std() == pytest.approx(rates_noise(measured)[1], rel=0.05)


@pytest.mark.parametrize("noise", [1e-7, 1e-6])
def test_the_noise_floor_is_found_under_a_motion(noise):
    x = 1e-2 * np.sin(40.0 * TIME) + noise * np.random.default_rng(1).normal(size=len(TIME))
    assert noise_floor(x) == pytest.approx(noise, rel=0.08, abs=0.0)


def test_quantised_samples_have_the_noise_of_their_steps():
    """Uniform over a step: the step over the root of 12."""
    x = 1e-5 * np.round(1e-2 * np.sin(40.0 * TIME) / 1e-5)
    assert noise_floor(x) == pytest.approx(1e-5 / np.sqrt(12.0), rel=0.15, abs=0.0)
    still = 1e-5 * (np.arange(4000) % 400 == 0)  # almost always zero
    assert 0.0 < noise_floor(still) < 1e-5


def test_the_width_grows_with_noise_and_the_acceleration_stays_near_the_true_one():
    turning, widths = 30.0, []
    for noise in (1e-8, 1e-6, 1e-4):
        x = 1e-2 * np.sin(turning * TIME) + noise * np.random.default_rng(2).normal(size=len(TIME))
        measured = measure(x, STEP)
        error = measured.motion.acceleration + 1e-2 * turning**2 * np.sin(turning * TIME)
        widths.append(measured.half_width)
        assert measured.half_width == best_width(x, measured.noise)
        assert error[300:-300].std() < 4.0 * rates_noise(measured)[1] + 1e-3 * turning**2 * 1e-2
    assert widths[0] < widths[1] < widths[2]


def test_a_thinned_motion_keeps_its_rates():
    motion = measure(np.sin(9.0 * TIME), STEP).motion
    thin = motion.thinned(7)
    assert thin.step == pytest.approx(7 * STEP)
    assert thin.time == pytest.approx(TIME[::7])
    assert np.array_equal(thin.velocity, motion.velocity[::7])


@pytest.mark.parametrize("x", [np.zeros(8), np.full(40, np.nan), np.zeros((20, 2))])
def test_displacements_that_cannot_be_differentiated_are_refused(x):
    with pytest.raises(InputError, match="displacement"):
        measure(x, STEP)


def test_widths_and_motions_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="half_width 12"):
        measure(np.arange(20.0), STEP, half_width=12)
    with pytest.raises(InputError, match="velocity"):
        Motion(step=STEP, displacement=np.zeros(3), velocity=np.zeros(4), acceleration=np.zeros(3))
    with pytest.raises(InputError, match="lean"):
        Motion(step=STEP, displacement=np.zeros(3), velocity=np.zeros(3), acceleration=np.zeros(3), lean=2.0)
    with pytest.raises(InputError, match="one or more samples"):
        Motion(step=STEP, displacement=np.zeros(0), velocity=np.zeros(0), acceleration=np.zeros(0))
