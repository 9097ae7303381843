"""Where a recording of the rig and its prediction part, on recordings that another hypothesis makes.

What carries the weight: noise alone is placed nowhere; a change that is put into one loop phase, cycle span, harmonic
or channel is found there; and an effect's own change is taken up by the block that it belongs to, by equations that do
not know its law.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.effects.catalogue import catalogue
from fretflow.experiments.loops import PHASES, Strokes
from fretflow.experiments.rig.blocks import cuts
from fretflow.experiments.rig.experiment import RigExperiment
from fretflow.experiments.rig.location import locate
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.least_squares import Fitter
from fretflow.recordings.schema import SweepCondition

HERE = Path(__file__).parent
SAMPLES, COUNTS = 21, (0, 4000, 12000, 24000)
CONDITIONS = (SweepCondition(id=0, excitation_amplitude="75 N"),)
SD = {"displacement": 3e-8, "friction_force": 0.15, "excitation": 0.02}
DEPTH_SD, VOLUME_SD = 3e-9, 2e-15


@pytest.fixture(autouse=True)
def shared(monkeypatch):
    """Let functions here import `small_rig`."""
    monkeypatch.syspath_prepend(HERE)


@cache
def rig():
    import small_rig

    return small_rig.rig(small_rig.observed(SD, COUNTS, CONDITIONS, VOLUME_SD, DEPTH_SD))


@cache
def baseline():
    model = rig()
    return model.simulate(Hypothesis())


def fitted(change):
    """Return the experiment and the baseline, not fitted any further, for a recording that differs by `change` (M,)."""
    model = rig()
    noise = np.random.default_rng(5).standard_normal(len(change)) * np.sqrt(model.observation.variance)
    seen = replace(model.observation, values=model.predict(baseline()) + change + noise)
    experiment = RigExperiment(replace(model, observation=seen), np.zeros(len(change)), np.zeros((len(change), 0)))
    space = experiment.parameters(())
    point = Point(space, np.zeros(space.size))
    fitter = Fitter(experiment, experiment.measurement.covariance())
    return experiment, fitter.linearised(Prediction(point, model.predict(baseline()), baseline()))


def of_effect(name, **parameters):
    model = rig()
    other = model.simulate(Hypothesis(effects=(catalogue()[name]().changed(**parameters),)), baseline())
    return model.predict(other) - model.predict(baseline())


def nothing():
    return np.zeros(len(rig().observation.values))


def test_noise_alone_is_placed_nowhere():
    location = locate(*fitted(nothing()))
    assert min(place.p_value for place in location.places) > 0.05
    assert (location.block, location.channel, location.phase, location.text) == ("", "", "", "")
    assert location.cycles == (0, 0)


@pytest.mark.parametrize(("name", "parameters", "block"), [
    ("directional-friction", {"asymmetry": 0.05}, "contact law"),
    ("velocity-dependent-friction", {"amplitude": 0.1}, "contact law"),
    ("sensor-path-compliance", {"compliance": 2e-8}, "sensor"),
    ("sensor-inertia", {"mass": 0.3}, "sensor"),
    ("channel-delay", {"delay": 5e-5}, "sensor"),
    ("excitation-distortion", {"second": 0.03, "third": 0.03}, "excitation"),
    ("support-nonlinearity", {"stiffness": 3e14}, "rig"),
    ("initial-gap", {"tilt_x": 5e-8}, "geometry"),
    ("wear-power-law", {"pressure_exponent": 0.4}, "wear law")])
def test_an_effect_is_taken_up_by_its_own_block(name, parameters, block):
    block_cuts = cuts(*fitted(of_effect(name, **parameters)))
    assert block_cuts[0].block == block, block_cuts
    assert block_cuts[0].share > 0.8


def test_a_change_in_one_phase_of_the_force_is_found_there():
    change, model = nothing(), rig()
    measured = model.predict(baseline())
    for piece in model.observation.pieces:
        if piece.channel == "friction_force":
            x = measured[next(one.place for one in model.observation.pieces if one.channel == "displacement"
                              and one.label == piece.label)]
            change[piece.place] = (Strokes.of(x, measured[piece.place]).phase == PHASES.index("plateau")) * 0.6
    location = locate(*fitted(change), block="contact law")
    assert (location.block, location.channel, location.phase) == ("contact law", "friction force", "plateau")
    assert "plateau" in location.text


def test_a_change_from_a_cycle_count_on_is_dated():
    change = nothing()
    for piece in rig().observation.pieces:
        if piece.channel == "friction_force" and piece.cycles >= COUNTS[2]:
            change[piece.place] = 0.4 * np.cos(3.0 * 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    location = locate(*fitted(change), block="contact law")
    assert location.cycles == (COUNTS[2], COUNTS[-1])
    assert location.harmonic == "3"
    jump = next(place for place in location.places if place.cut == "change")
    assert jump.where == "12,000 cycles"
    assert jump.p_value < 1e-6


def test_a_force_along_the_motion_is_odd_in_its_direction():
    change, model = nothing(), rig()
    measured = model.predict(baseline())
    for piece in model.observation.pieces:
        if piece.channel == "friction_force":
            x = measured[next(one.place for one in model.observation.pieces if one.channel == "displacement"
                              and one.label == piece.label)]
            change[piece.place] = 0.4 * Strokes.of(x, measured[piece.place]).way
    assert locate(*fitted(change), block="contact law").parity == "odd in the direction of motion"


def test_a_corner_of_the_map_is_a_zone():
    change, model = nothing(), rig()
    piece = next(one for one in model.observation.pieces if one.block == "map")
    corner = np.abs(model.observation.points).min(axis=1) > 0.4e-3
    change[piece.place] = np.where(corner, 8.0 * DEPTH_SD, 0.0)
    location = locate(*fitted(change), block="wear law")
    assert (location.channel, location.zone) == ("wear depth", "corners")
