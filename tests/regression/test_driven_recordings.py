"""Measured joints that a motion drives: how well each model refits them.

What carries the weight: the values that others published for the positioning drive, from other models and fits, and
what each effect leaves of the force. The figures are those of these fits when they were first made, with little room.
"""

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.effects.coulomb_friction import CoulombFriction
from fretflow.effects.driven import DrivenJoint, LumpedBaseline
from fretflow.effects.force_offset import ForceOffset
from fretflow.effects.velocity_dependent_friction import VelocityDependentFriction
from fretflow.experiments.driven.data import plain_data, prepared
from fretflow.experiments.driven.experiment import DrivenExperiment
from fretflow.experiments.driven.noise import white_noise
from fretflow.experiments.driven.run import fitted
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT, LUMPED
from fretflow.recordings.recording import read_joint_recording
from fretflow.structure.motion import Motion, measure
from scipy.optimize import least_squares

pytestmark = pytest.mark.real_data
PUBLISHED = {"baseline.mass": 95.11, "baseline.damping": 203.5, "coulomb-friction.friction_limit": 20.39,
             "force-offset.force_offset": -3.16}
DAMPERS = ("damper_d1_0p5Hz20lbtension", "damper_d1_0p5Hz35lbtension", "damper_d2_0p5Hz30lbtension1amplitude")


@cache
def recorded(path: Path):
    series = read_joint_recording(path).series
    step = (series.time[-1] - series.time[0]) / (len(series.time) - 1)
    return measure(series.channels["displacement"], step), series.channels["force"]


def refit(kind, names, motion, force, used=None):
    """Return the fit, what it leaves of the force, and the CPU time that it took."""
    data = plain_data(kind, motion, force, used)
    start = time.process_time()
    fit = fitted(data, names)
    taken = time.process_time() - start
    return fit, force - DrivenExperiment(data, white_noise(data), 1.0).force(fit), taken


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@cache
def drive(folder, *names):
    """Return a fit of all the positioning drive, and the error on its second half of a fit of the first."""
    measured, force = recorded(folder / "drive_estimation")
    motion, force = prepared(LUMPED, measured.motion, force, samples=5000)
    first = np.arange(len(force)) < len(force) // 2
    _, left, _ = refit(LUMPED, names, motion, force, used=first)
    whole, rest, taken = refit(LUMPED, names, motion, force)
    return whole, rms(left[~first]) / rms(force[~first]), taken, rest


def test_the_drive_has_the_published_parameters(recordings):
    fit, _, taken, _ = drive(recordings, "coulomb-friction", "force-offset")
    assert {one.name for one in fit.parameters.coordinates} == set(PUBLISHED)
    for one, z in zip(fit.parameters.coordinates, fit.z, strict=True):
        assert one.value(z) == pytest.approx(PUBLISHED[one.name], rel=0.005)
    assert taken < 1.0


def test_each_effect_of_the_drive_tells_on_its_held_out_half(recordings):
    errors = [drive(recordings, *names)[1] for names in (
        (), ("coulomb-friction",), ("coulomb-friction", "force-offset"))]
    assert errors == pytest.approx([0.181, 0.075, 0.044], abs=0.002)


def test_the_drive_has_no_stribeck_friction(recordings):
    """More friction at low speed, over any speed up to a tenth of the largest, gains less than 2 % of what is left."""
    names = ("coulomb-friction", "force-offset")
    plain, _, _, rest = drive(recordings, *names)
    measured, force = recorded(recordings / "drive_estimation")
    motion, force = prepared(LUMPED, measured.motion, force, samples=5000)
    data = plain_data(LUMPED, motion, force)
    known = {one.field: one.value(z) for one, z in zip(plain.parameters.coordinates, plain.z, strict=True)}
    fastest = np.abs(motion.velocity).max()
    for strength in (0.05, 0.2):
        for share in (0.01, 0.03, 0.1):
            slower = VelocityDependentFriction().changed(strength=strength, speed_scale=share * fastest)

            def left(values, slower=slower):
                friction, offset, mass, damping = values
                body = LumpedBaseline().model_copy(update={"mass": mass, "damping": damping, "stiffness": 0.0})
                effects = [CoulombFriction().changed(friction_limit=friction), slower,
                           ForceOffset().changed(force_offset=offset)]
                return DrivenJoint.build(body, effects).predict(data.motion).measured - force

            best = least_squares(left, [known[name] for name in ("friction_limit", "force_offset", "mass", "damping")],
                                 x_scale="jac")
            assert rms(best.fun) > 0.98 * rms(rest)


@cache
def loop(path: Path):
    """Return one loop of a damper at full stroke, after a quarter that it needs to forget its start."""
    measured, force = recorded(path)
    inside = slice(5120, 9421)
    motion = Motion(step=measured.motion.step, displacement=measured.motion.displacement[inside],
                    velocity=measured.motion.velocity[inside], acceleration=measured.motion.acceleration[inside])
    return prepared(IMPOSED_DISPLACEMENT, motion, force[inside], samples=600)


@pytest.mark.parametrize(("name", "expected"), list(zip(DAMPERS, (
    (0.066, 0.057, 0.033), (0.056, 0.055, 0.032), (0.061, 0.061, 0.031)), strict=True)))
def test_a_damper_with_backlash_is_best_explained_by_play(recordings, name, expected):
    """Root mean square over the range of the force: slider, unequal directions, and play with both."""
    motion, force = loop(recordings / name)
    models = ((), ("directional-friction",), ("backlash", "directional-friction"), ("distributed-micro-slip",
                                                                                     "directional-friction"))
    fits = [refit(IMPOSED_DISPLACEMENT, names, motion, force) for names in models]
    errors = [rms(left) / np.ptp(force) for _, left, _ in fits]
    assert errors[:3] == pytest.approx(expected, abs=0.0015)
    assert errors[2] < errors[3]
    played = fits[2][0]
    assert max(one.value(z) for one, z in zip(played.parameters.coordinates, played.z, strict=True)
               if one.field == "play") > 2.5e-3
    assert max(taken for _, _, taken in fits) < 2.0


def test_the_whole_record_of_a_damper_is_refitted_within_a_second(recordings):
    measured, force = recorded(recordings / DAMPERS[1])
    motion, force = prepared(IMPOSED_DISPLACEMENT, measured.motion, force)
    _, plain, _ = refit(IMPOSED_DISPLACEMENT, (), motion, force)
    _, played, taken = refit(IMPOSED_DISPLACEMENT, ("backlash",), motion, force)
    assert taken < 1.0
    assert rms(played) < 0.5 * rms(plain)


def bolted(folder, name):
    """Return a loop without time, gone round twice so that the start is forgotten."""
    x, force = np.genfromtxt(folder / "bolted_joint_loops" / name, delimiter=",", skip_header=2).T
    x, force = (np.concatenate([values, values, values[:1]]) for values in (1e-3 * x, 1e3 * force))
    motion = Motion(step=1.0, displacement=x, velocity=np.gradient(x), acceleration=np.zeros_like(x))
    motion, force = prepared(IMPOSED_DISPLACEMENT, motion, force)
    return replace(motion, lean=0.0), force, np.arange(len(x)) > len(x) // 2


@pytest.mark.parametrize(("name", "gain"), [("rousseau2025_loop_steel_amp0p05.csv", 0.45),
                                            ("rousseau2025_loop_steel_amp0p03.csv", 0.9)])
def test_bolted_joints_have_distributed_slip(recordings, name, gain):
    motion, force, used = bolted(recordings, name)
    one, many = (rms(refit(IMPOSED_DISPLACEMENT, names, motion, force, used=used)[1][used]) for names in (
        ("force-offset",), ("distributed-micro-slip", "force-offset")))
    assert many < gain * one
