"""Joints that a given motion drives, against closed forms and a plain march sample by sample.

What carries the weight: areas and curves of loops known in closed form (Jenkins, play in series, Iwan with the rule of
Masing), and a loop over samples in plain Python for limits that change with time.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.errors import ConfigError, InputError
from fretflow.effects.backlash import Backlash
from fretflow.effects.catalogue import catalogue
from fretflow.effects.coulomb_friction import CoulombFriction
from fretflow.effects.directional_friction import DirectionalFriction
from fretflow.effects.distributed_micro_slip import DistributedMicroSlip
from fretflow.effects.driven import DrivenJoint, LumpedBaseline, SliderBaseline
from fretflow.effects.effect import DRIVEN, declared_priors
from fretflow.effects.force_offset import ForceOffset
from fretflow.effects.parallel_stiffness import ParallelStiffness
from fretflow.effects.velocity_dependent_friction import VelocityDependentFriction
from fretflow.effects.viscous import Viscous
from fretflow.experiments.driven.data import plain_data, prepared
from fretflow.experiments.driven.experiment import RIG, DrivenExperiment, Scale, unit_of
from fretflow.experiments.driven.noise import white_noise
from fretflow.experiments.driven.run import fitted
from fretflow.inference.parameters import HALF
from fretflow.recordings.kinds.joints import FRETTING_RIG, IMPOSED_DISPLACEMENT
from fretflow.structure.driven import Sliders, clipped_march
from fretflow.structure.motion import Motion
from hypothesis import given, settings
from hypothesis import strategies as st

K, S, X = 28e6, 50.0, 7e-6
OMEGA = 2.0 * np.pi * 100.0
PERIOD = 2000  # samples
SLIDER = SliderBaseline().model_copy(update={"tangential_stiffness": K, "friction_limit": S})
BODY = LumpedBaseline().model_copy(update={"mass": 12.0, "damping": 40.0, "stiffness": 3e4})


def swinging(amplitude=X, periods=3, lean=0.0):
    phase = 2.0 * np.pi * np.arange(periods * PERIOD + 1) / PERIOD
    return Motion(step=2.0 * np.pi / OMEGA / PERIOD, displacement=amplitude * np.cos(phase), lean=lean,
                  velocity=-amplitude * OMEGA * np.sin(phase), acceleration=-amplitude * OMEGA**2 * np.cos(phase))


def moving(x, step=1e-4):
    v = np.gradient(x, step) if len(x) > 1 else np.zeros_like(x)
    return Motion(step=step, displacement=x, velocity=v, acceleration=np.zeros_like(x))


def last_area(joint, motion):
    """Return the work of the last period, by the trapezoidal rule."""
    force, x = joint.predict(motion).measured[-PERIOD - 1:], motion.displacement[-PERIOD - 1:]
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x)))


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 70), seed=st.integers(0, 10**6))
def test_the_march_is_that_of_one_sample_after_the_other(n, seed):
    random = np.random.default_rng(seed)
    steps, high, low = random.normal(size=(n, 3)), random.random((n, 3)), -random.random((n, 3))
    z, expected = np.array([0.3, -0.2, 0.0]), []
    for k in range(n):
        z = np.clip(z + steps[k], low[k], high[k])
        expected.append(z)
    assert clipped_march(steps, low, high, np.array([0.3, -0.2, 0.0])) == pytest.approx(np.array(expected), abs=1e-14)


def test_loop_of_a_slider():
    joint = DrivenJoint.build(SLIDER)
    assert last_area(joint, swinging()) == pytest.approx(4.0 * S * (X - S / K), rel=1e-4)
    stuck = joint.predict(swinging(0.9 * S / K, lean=1.0))
    assert np.ptp(stuck.measured) == pytest.approx(2.0 * 0.9 * S, rel=1e-9)
    assert stuck.measured[0] == S


def test_loop_of_a_slider_behind_play():
    """It crosses the gap g without force, twice a period, which takes s g off each way of the loop."""
    g = 3e-6
    joint = DrivenJoint.build(SLIDER, [Backlash().changed(play=g)])
    motion = swinging(lean=1.0)
    assert last_area(joint, motion) == pytest.approx(4.0 * S * (X - S / K - g / 2.0), rel=1e-4)
    force, x = (values[:PERIOD // 2] for values in (joint.predict(motion).measured, motion.displacement))
    free = x[force == 0.0]
    assert free.max() == pytest.approx(X - S / K, abs=2e-8)
    assert free.min() == pytest.approx(X - S / K - g, abs=2e-8)
    assert force[0] == S


def test_a_slider_follows_limits_that_change_with_time_and_direction():
    random = np.random.default_rng(8)
    x = np.cumsum(random.normal(size=500)) * 1e-6
    up, down = 1.0 + 0.3 * np.sin(0.05 * np.arange(500)), 0.8 + 0.1 * np.cos(0.03 * np.arange(500))
    force, expected = 0.0, []
    for k in range(500):
        force = min(max(force + K * (x[k] - x[max(k - 1, 0)]), -S * down[k]), S * up[k])
        expected.append(force)
    assert Sliders.one(K, S).force(moving(x), up, down) == pytest.approx(np.array(expected), abs=1e-9)


def test_directions_and_speeds_move_the_plateaus():
    both = [DirectionalFriction(difference=0.1), VelocityDependentFriction(strength=0.3, speed_scale="4 mm/s")]
    motion = swinging()
    force = DrivenJoint.build(SLIDER, both).predict(motion).measured[-PERIOD - 1:]
    fast = 1.0 + 0.3 * np.exp(-X * OMEGA / 4e-3)
    middle = PERIOD // 4  # where the speed is largest: going back, then there
    assert force[middle] == pytest.approx(-0.9 * S * fast, rel=1e-9)
    assert force[3 * middle] == pytest.approx(1.1 * S * fast, rel=1e-9)
    slower = 1.0 + 0.3 * np.exp(np.sin(2.0 * np.pi * 0.85) * X * OMEGA / 4e-3)
    assert force[round(0.85 * PERIOD)] == pytest.approx(1.1 * S * slower, rel=1e-9)
    assert slower > 1.02 * fast


def iwan_backbone(x):
    """Of limits that are uniform from 0 to 2 s: k x - (k x)^2 / 4 s until all slide."""
    stretched = np.minimum(K * x, 2.0 * S)
    return stretched - stretched**2 / (4.0 * S)


def test_uniform_limits_have_a_quadratic_knee_and_obey_masing():
    joint = DrivenJoint.build(SLIDER, [DistributedMicroSlip(spread=1.0, power=1.0)])
    rising = np.linspace(0.0, 2.5 * S / K, 400)
    assert joint.predict(moving(rising)).measured == pytest.approx(iwan_backbone(rising), abs=1e-3 * S)
    turned = 1.4 * S / K
    there, back = np.linspace(0.0, turned, 200), np.linspace(turned, -turned, 400)
    force = joint.predict(moving(np.concatenate([there, back]))).measured[200:]
    masing = iwan_backbone(turned) - 2.0 * iwan_backbone(0.5 * (turned - back))
    assert force == pytest.approx(masing, abs=2e-3 * S)
    # the loop's area below gross slip: (k x)^2 x k / 3 s by Masing's rule on the quadratic
    assert last_area(joint, swinging(turned)) == pytest.approx(K**2 * turned**3 / (3.0 * S), rel=5e-3)


@pytest.mark.parametrize("power", [0.5, 2.0, 4.0])
def test_power_laws_of_limits_follow_their_distribution(power):
    """The force falls behind k x by the integral of the share of limits that are below k x."""
    joint = DrivenJoint.build(SLIDER, [DistributedMicroSlip(spread=1.0, power=power)])
    x = np.linspace(0.0, 1.0, 50) * (1.0 + power) * S / K
    share = (K * x / ((1.0 + power) * S))**(1.0 / power)
    expected = K * x * (1.0 - share / (1.0 + 1.0 / power))
    assert joint.predict(moving(x)).measured == pytest.approx(expected, abs=4e-3 * S * max(power, 1.0))


@pytest.mark.parametrize(("spread", "power"), [(0.3, 0.7), (1.0, 3.0)])
def test_spread_limits_keep_the_whole_limit_and_stiffness(spread, power):
    sliders = DistributedMicroSlip(spread=spread, power=power).sliders(Sliders.one(K, S))
    assert sliders.stiffness.sum() == pytest.approx(K, rel=1e-14)
    assert sliders.stiffness @ sliders.reach == pytest.approx(S, rel=1e-14)
    assert sliders.reach.min() * K > 0.999 * (1.0 - spread) * S


def test_dry_friction_is_the_sign_of_the_velocity_and_holds_at_stops():
    rest, ramp = np.full(300, 1e-3), np.linspace(0.0, 1e-3, 500)
    x = np.concatenate([ramp, rest, ramp[::-1]])
    joint = DrivenJoint.build(BODY.model_copy(update={"stiffness": 0.0, "damping": 0.0}),
                              [CoulombFriction().changed(friction_limit=20.0)])
    force = joint.predict(moving(x)).measured
    assert np.all(force[5:800] == 20.0)
    assert np.all(force[805:] == -20.0)


def test_a_body_has_its_forces_and_effects_add_theirs():
    motion = swinging(1e-3)
    x, v, a = motion.displacement, motion.velocity, motion.acceleration
    effects = [ForceOffset().changed(force_offset=-3.0), ParallelStiffness().changed(stiffness=5e3)]
    force = DrivenJoint.build(BODY, effects).predict(motion).measured
    assert force == pytest.approx(12.0 * a + 40.0 * v + 3.5e4 * x - 3.0, abs=1e-9)
    beside = DrivenJoint.build(SLIDER, [Viscous().changed(damping=70.0)]).predict(motion).measured
    assert beside - DrivenJoint.build(SLIDER).predict(motion).measured == pytest.approx(70.0 * v, abs=1e-9)


def acting():
    return [(kind, name) for kind in sorted(DRIVEN) for name, effect in catalogue().items() if kind in effect.kinds]


def typical(kind):
    return (SLIDER, swinging(lean=1.0)) if kind is IMPOSED_DISPLACEMENT else (BODY, swinging(1e-3))


@pytest.mark.parametrize(("kind", "name"), acting())
def test_a_neutral_effect_leaves_a_driven_joint_as_it_is(kind, name):
    baseline, motion = typical(kind)
    plain = DrivenJoint.build(baseline).predict(motion)
    predicted = DrivenJoint.build(baseline, [catalogue()[name].neutral()]).predict(motion)
    assert predicted.measured == pytest.approx(plain.measured, rel=1e-12, abs=1e-12 * np.abs(plain.measured).max())


@pytest.mark.parametrize("kind", sorted(DRIVEN))
def test_the_order_of_effects_does_not_matter(kind):
    baseline, motion = typical(kind)
    effects = [catalogue()[name]() for own, name in acting() if own is kind]
    forward, backward = (DrivenJoint.build(baseline, given) for given in (effects, effects[::-1]))
    assert forward == backward
    assert np.array_equal(forward.predict(motion).measured, backward.predict(motion).measured)


def test_effects_that_do_not_act_there_or_come_twice_are_refused():
    with pytest.raises(ConfigError, match="backlash: does not act in recordings of kind lumped; only in fretting-rig"):
        DrivenJoint.build(BODY, [Backlash()])
    with pytest.raises(ConfigError, match="backlash: given twice"):
        DrivenJoint.build(SLIDER, [Backlash(), Backlash()])
    with pytest.raises(InputError, match="reach"):
        Sliders(stiffness=np.ones(2), reach=np.ones(3))
    with pytest.raises(InputError, match="play"):
        Sliders(stiffness=np.ones(2), reach=np.ones(2), play=-1.0)


@pytest.mark.parametrize("size", [1.0, 2000.0])
def test_a_fit_finds_what_made_the_force_at_any_scale(size):
    """Made by a plain march: a slider behind play with noise; the bands are four standard deviations."""
    motion = swinging(size * X)
    true = {"baseline.tangential_stiffness": K, "baseline.friction_limit": S * size, "backlash.play": 2.5e-6 * size}
    k, s, g = true.values()
    z, made = 0.0, []
    for step in np.diff(motion.displacement, prepend=motion.displacement[0]):
        z = min(max(z + step, -g / 2 - s / k), g / 2 + s / k)
        made.append(k * (z - min(max(z, -g / 2), g / 2)))
    made = np.array(made) + 0.01 * s * np.random.default_rng(4).normal(size=len(made))
    motion, force = prepared(IMPOSED_DISPLACEMENT, motion, made)
    assert len(force) <= 2500
    used = np.arange(len(force)) > 100
    fit = fitted(plain_data(IMPOSED_DISPLACEMENT, motion, force, used), ["backlash"])
    assert {one.name for one in fit.parameters.coordinates} == set(true)
    spread = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    for one, z, dz in zip(fit.parameters.coordinates, fit.z, spread, strict=True):
        value, sd = one.value(z), abs(one.value(z + dz) - one.value(z - dz)) / 2.0
        assert abs(value - true[one.name]) < 4.0 * sd + 1e-4 * true[one.name]
        assert sd < 0.01 * true[one.name]
    assert np.sqrt(np.mean((fit.predicted - force[used])**2)) == pytest.approx(0.01 * s, rel=0.1)


def test_ranges_go_with_the_size_of_the_joint():
    motion = swinging(2e-3)
    scale = Scale.of(motion, np.array([-9e3, 9e3]))
    assert scale.time == pytest.approx(1.0 / OMEGA, rel=1e-3)
    parts = {"baseline": SliderBaseline, "backlash": Backlash, "velocity-dependent-friction": VelocityDependentFriction}
    own = {f"{part}.{name}": prior for part, kind in parts.items() for name, prior in declared_priors(kind).items()}
    scaled = {name: scale.prior(prior, unit_of(parts[name.split(".")[0]], name.split(".")[1]))
              for name, prior in own.items()}
    assert scaled["backlash.play"].high / own["backlash.play"].high == pytest.approx(2e-3 / RIG.length)
    assert scaled["baseline.tangential_stiffness"].low / own["baseline.tangential_stiffness"].low == pytest.approx(
        9e3 / RIG.force * RIG.length / 2e-3)
    assert scaled["velocity-dependent-friction.strength"] == own["velocity-dependent-friction.strength"]


def test_ranges_of_an_effect_of_one_s_own_are_of_the_user_s_joint(monkeypatch):
    monkeypatch.setenv("FRETFLOW_EFFECTS", str(Path(__file__).parents[2] / "examples" / "own_effects"))
    motion = swinging(2e-3)
    data = plain_data(IMPOSED_DISPLACEMENT, motion, 9e3 * np.sign(motion.velocity), np.ones(len(motion.velocity), bool))
    space = DrivenExperiment(data, white_noise(data), 1.0).parameters(("backlash", "friction-bump"))
    ends = {one.name: [one.value(way * HALF) for way in (-1.0, 1.0)] for one in space.coordinates}
    assert ends["friction-bump.width"] == pytest.approx([0.5e-6, 4e-6])
    assert ends["backlash.play"][1] == pytest.approx(declared_priors(Backlash)["play"].high * 2e-3 / RIG.length)


def test_a_resonance_is_sought_on_the_time_scale_of_the_recording_and_a_delay_on_that_of_instruments():
    slow = replace(RIG, time=100.0 * RIG.time)  # 1 Hz instead of 100
    mode, delay = (declared_priors(catalogue()[name])[field] for name, field in (
        ("extra-mode", "frequency"), ("channel-delay", "delay")))
    assert slow.prior(mode, "Hz").low == pytest.approx(0.01 * mode.low)
    assert slow.prior(mode, "Hz").high == pytest.approx(0.01 * mode.high)
    assert slow.prior(delay, "s") == delay


def test_recordings_that_cannot_be_fitted_are_refused():
    still = plain_data(IMPOSED_DISPLACEMENT, moving(np.zeros(20)), np.zeros(20))
    with pytest.raises(InputError, match="constant"):
        DrivenExperiment(still, white_noise(still), 1.0).parameters(())
    with pytest.raises(InputError, match="fretting-rig: no measured motion"):
        fitted(plain_data(FRETTING_RIG, swinging(), np.zeros(len(swinging().displacement))), [])


def test_play_keeps_its_side_at_the_start():
    g = 2e-6
    joint = DrivenJoint.build(SLIDER, [Backlash().changed(play=g)])
    x = np.linspace(0.0, -5e-6, 200)
    for lean, first in ((1.0, S), (-0.5, -0.5 * S), (0.0, 0.0)):
        assert joint.predict(replace(moving(x), lean=lean)).measured[0] == pytest.approx(first, abs=1e-9)
