"""Readings of hysteresis loops.

The weight lies on closed forms: the elastic-perfectly-plastic loop, whose every reading is known, and the
Mindlin loop of a sphere in partial slip (Johnson, Contact Mechanics, section 7.4), which has no plateau and
must not be given one.
"""

import numpy as np
import pytest
from fretflow.case.config import SlidingRegime
from fretflow.core.errors import InputError
from fretflow.recordings.hysteresis import HysteresisLoop, read_loop
from fretflow.recordings.readings import read_noisy_loop

AMPLITUDE, STIFFNESS, MU, LOAD = 8e-6, 28e6, 0.88, 60.0


def jenkins_loop(stiffness=STIFFNESS, limit=MU * LOAD, samples=256, start=0.7, offset=(0.0, 0.0)):
    """Return the second period of a spring in series with a slider, moved sinusoidally."""
    phase = start + 2.0 * np.pi * np.arange(2 * samples) / samples
    x = AMPLITUDE * np.cos(phase)
    force, slider = np.empty_like(x), 0.0
    for j, position in enumerate(x):
        force[j] = np.clip(stiffness * (position - slider), -limit, limit)
        slider = position - force[j] / stiffness
    return x[samples:] + offset[0], force[samples:] + offset[1]


def mindlin_loop(share, limit=MU * LOAD, reach=3e-6, samples=200):
    """Return the steady loop of a sphere under constant load, tangential force peak `share` of the limit."""
    peak, rest = share * limit, 1.0 - share
    back = peak * np.cos(np.linspace(0.0, np.pi, samples, endpoint=False))
    x = reach * (2.0 * (1.0 - (peak - back) / (2.0 * limit)) ** (2 / 3) - rest ** (2 / 3) - 1.0)
    return -np.r_[x, -x], -np.r_[back, -back]


@pytest.mark.parametrize("start", [0.0, 0.7, 2.9, 5.1])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (3e-6, -4.0)])
def test_elastic_plastic_loop_against_closed_form(start, offset):
    x, force = jenkins_loop(start=start, offset=offset, samples=512)
    seen = read_loop(HysteresisLoop(displacement=x, force=force), LOAD)
    slide = 2.0 * (AMPLITUDE - MU * LOAD / STIFFNESS)
    assert seen.regime is SlidingRegime.GROSS_SLIP
    assert seen.friction_coefficient == pytest.approx(MU, rel=1e-6, abs=0.0)
    assert seen.tangential_stiffness == pytest.approx(STIFFNESS, rel=1e-3, abs=0.0)
    assert seen.sliding_distance == pytest.approx(slide, rel=2e-4, abs=0.0)
    assert seen.dissipated_energy == pytest.approx(2.0 * MU * LOAD * slide, rel=1e-3, abs=0.0)
    assert seen.peak_to_peak == pytest.approx(2.0 * AMPLITUDE, rel=1e-4, abs=0.0)


@pytest.mark.parametrize("rounds", [2, 3])
def test_several_periods_are_not_read_as_one(rounds):
    """They were a loop in partial slip, of several times the energy."""
    noise = np.random.default_rng(3).standard_normal((2, rounds * 256))
    x, force = (np.tile(one, rounds) + 0.02 * np.ptp(one) * own for one, own in zip(jenkins_loop(), noise, strict=True))
    with pytest.raises(InputError, match=f"loop: holds {rounds} periods; give one"):
        read_loop(HysteresisLoop(displacement=x, force=force), LOAD)


def test_noise_leaves_the_readings_unbiased():
    rng = np.random.default_rng(7)
    x, force = jenkins_loop(samples=512)
    readings = []
    for _ in range(40):
        noise = rng.standard_normal((2, 512))
        loop = HysteresisLoop(displacement=x + 3e-8 * noise[0], force=force + 0.3 * noise[1])
        seen = read_loop(loop, LOAD)
        readings.append([seen.friction_coefficient, seen.tangential_stiffness, seen.sliding_distance,
                         seen.dissipated_energy])
    slide = 2.0 * (AMPLITUDE - MU * LOAD / STIFFNESS)
    exact = np.array([MU, STIFFNESS, slide, 2.0 * MU * LOAD * slide])
    relative = np.array(readings) / exact - 1.0
    assert np.all(np.abs(relative.mean(axis=0)) < [1e-3, 1e-2, 2e-3, 2e-3])
    assert np.all(relative.std(axis=0) < [2e-3, 2e-2, 5e-3, 5e-3])


def test_rigid_sliding_has_a_friction_coefficient_but_no_stiffness():
    x, force = jenkins_loop(stiffness=1e14)
    seen = read_loop(HysteresisLoop(displacement=x, force=force), LOAD)
    assert seen.friction_coefficient == pytest.approx(MU, rel=1e-9, abs=0.0)
    assert seen.tangential_stiffness is None or seen.tangential_stiffness > 1e9
    assert seen.dissipated_energy == pytest.approx(4.0 * MU * LOAD * AMPLITUDE, rel=1e-2, abs=0.0)


def test_tilted_plateau_is_read_at_its_middle():
    x, force = jenkins_loop()
    seen = read_loop(HysteresisLoop(displacement=x, force=force * (1.0 + 0.01 * x / 1e-6)), LOAD)
    assert seen.friction_coefficient == pytest.approx(MU, rel=0.02, abs=0.0)


@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
def test_partial_slip_has_no_friction_coefficient(share):
    x, force = mindlin_loop(share)
    seen = read_loop(HysteresisLoop(displacement=x, force=force), LOAD)
    limit, reach = MU * LOAD, 3e-6
    rest = 1.0 - share
    energy = 4.8 * limit * reach * (1.0 - rest ** (5 / 3) - 5.0 * share / 6.0 * (1.0 + rest ** (2 / 3)))
    assert seen.regime is SlidingRegime.PARTIAL_SLIP
    assert seen.friction_coefficient is None
    assert seen.dissipated_energy == pytest.approx(energy, rel=1e-3, abs=0.0)
    assert seen.tangential_stiffness == pytest.approx(1.5 * limit / reach, rel=0.16, abs=0.0)


def test_elastic_line_sticks():
    x = 1e-6 * np.cos(2.0 * np.pi * np.arange(64) / 64)
    seen = read_loop(HysteresisLoop(displacement=x, force=STIFFNESS * x), LOAD)
    assert seen.regime is SlidingRegime.STICK
    assert seen.friction_coefficient is None
    assert seen.tangential_stiffness == pytest.approx(STIFFNESS, rel=1e-9, abs=0.0)
    assert seen.dissipated_energy == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("change", "message"), [
    (lambda x, f: (x[:-1], f), "one length"),
    (lambda x, f: (x[:8], f[:8]), "16 samples"),
    (lambda x, f: (np.where(x == x[3], np.nan, x), f), "NaN"),
    (lambda x, f: (0.0 * x, f), "constant"),
    (lambda x, f: (x, 0.0 * f + 5.0), "constant"),
    (lambda x, f: (x, -f), "reverse the sign"),
])
def test_loops_that_cannot_be_read(change, message):
    x, force = change(*jenkins_loop())
    with pytest.raises(InputError, match=message):
        HysteresisLoop(displacement=x, force=force)


def test_a_force_of_round_off_is_no_friction():
    x, force = jenkins_loop()
    with pytest.raises(InputError, match="loop: its force is round-off beside the normal load of 60 N"):
        read_loop(HysteresisLoop(displacement=x, force=1e-17 * force), LOAD)


def test_load_must_be_positive():
    x, force = jenkins_loop()
    with pytest.raises(InputError, match="normal_load"):
        read_loop(HysteresisLoop(displacement=x, force=force), 0.0)


def test_reversal_of_a_motion_that_rests_while_the_force_turns():
    rng = np.random.default_rng(5)
    # The faces stay for a fifth of a period at each end, but for the spring of 300 N/um under 20 N.
    ramp, limit, stiffness = np.linspace(-1.0, 1.0, 40, endpoint=False), 10.0, 300e6
    slide = 5e-6 * np.cos(np.linspace(0.0, np.pi, 60, endpoint=False))
    x = np.r_[slide, -5e-6 + limit / stiffness * (1.0 + ramp)]
    x, force = np.r_[x, -x - (x[-1] + x[0])], np.r_[np.full(60, -limit), limit * ramp]
    force = np.r_[force, -force]
    x -= 0.5 * (x.max() + x.min())
    guide = HysteresisLoop(displacement=x, force=force)
    compliances = []
    for draw in range(60):
        noise = rng.standard_normal((2, 200))
        loop = HysteresisLoop(displacement=x + 3e-8 * noise[0], force=force + 0.1 * noise[1])
        seen = read_loop(loop, LOAD, guide if draw % 2 else None)
        assert seen.friction_limit == pytest.approx(limit, rel=0.01)
        assert seen.tangential_compliance is not None
        compliances.append(seen.tangential_compliance)
    assert np.mean(compliances) == pytest.approx(1.0 / stiffness, rel=0.15, abs=0.0)


@pytest.mark.parametrize("read", [read_loop, lambda loop: read_noisy_loop(loop.displacement, loop.force)])
@pytest.mark.parametrize("samples", [400, 1000])
def test_play_at_zero_force_does_not_hide_the_sliding(samples, read):
    """A slider F behind a spring k with play g slides 2 X - 2 F / k - g of a stroke 2 X: its work over 2 F."""
    limit, stiffness, play, stroke = 4.173e3, 4.94e6, 3.2e-3, 25e-3
    x = stroke * np.sin(2.0 * np.pi * np.arange(3 * samples) / samples)
    reach, slider, force = 0.5 * play + limit / stiffness, 0.0, []
    for at in x:
        slider = float(np.clip(slider, at - reach, at + reach))
        free = at - slider
        force.append(stiffness * np.sign(free) * max(0.0, abs(free) - 0.5 * play))
    readings = read(HysteresisLoop(displacement=x[-samples:], force=np.array(force[-samples:])))
    assert readings.sliding_distance == pytest.approx(2.0 * stroke - 2.0 * limit / stiffness - play, rel=5e-3)
