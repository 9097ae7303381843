"""Periods in the harmonics that are compared."""

import numpy as np
import pytest
from fretflow.structure.sensors import Signals, band_limited


def test_what_lies_above_the_harmonics_is_left_out():
    """Harmonics 0 to 4 of a sum of cosines stay as they are at nine instants; one that rings at the 25th goes."""
    def low(turn):
        return 3.0 + 2.0 * np.cos(turn) - 0.5 * np.sin(4.0 * turn)

    fine, nine = 2.0 * np.pi * np.arange(200) / 200, 2.0 * np.pi * np.arange(9) / 9
    limited = band_limited(np.stack([low(fine), low(fine) + 5.0 * np.cos(25.0 * fine)]), 4)
    np.testing.assert_allclose(limited, [low(nine), low(nine)], atol=1e-12)


def test_noise_keeps_its_density():
    """White noise of 100 samples has in 21 of them the variance of as many of its lines."""
    noise = np.random.default_rng(7).standard_normal((4000, 100))
    assert band_limited(noise, 10).var() == pytest.approx(0.21, rel=0.02)


def test_a_period_keeps_its_length_and_its_rates():
    """All channels are taken along; the derivative of what stays is the derivative's own share."""
    turn = 2.0 * np.pi * np.arange(60) / 60
    whole = Signals(step=0.01 / 60, displacement=np.sin(2.0 * turn), friction_force=np.cos(turn), arm=np.sin(turn),
                    approach=np.cos(9.0 * turn))
    few = whole.band_limited(5)
    few.check()
    assert few.step * 11 == pytest.approx(0.01)
    assert few.excitation is None
    np.testing.assert_allclose(few.approach, 0.0, atol=1e-12)
    coarse = 2.0 * np.pi * np.arange(11) / 11
    np.testing.assert_allclose(few.rate(few.displacement), 2.0 * 200.0 * np.pi * np.cos(2.0 * coarse), rtol=1e-9,
                               atol=1e-6)
