"""Responses under control read as a backbone, and the force that a model needs for them.

What carries the weight: a mass on a spring and Jenkins sliders, whose force for a held harmonic motion is written down
by the sliders' own mapping, sample by sample, with nothing of the package: its first harmonic is the recording.
"""

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.experiments.structure import backbone
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.responses import backbone_of, oscillator
from fretflow.inference.experiment import Point
from fretflow.recordings.kinds.structure_sections import Control
from fretflow.recordings.kinds.structures import ControlledResponse, read_structure_recording

MASS, GROUND, DAMPING, COUNT = 2.0, 1e6, 1e-3, 40
HEAD = """format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
matrices = "structure.npz"
bolt_load = "1 N"
friction_coefficient = 1.0
modal_damping = 1e-3
"""
FRF = """[[frf]]
file = "{file}"
control = "response"
of = "head"
at = "head"
frequency = {{ column = "f", unit = "Hz" }}
force = {{ column = "F", unit = "N" }}
amplitude = {{ column = "x", unit = "um" }}
"""


def sliders():
    rng = np.random.default_rng(5)
    return rng.uniform(500.0, 1500.0, COUNT), rng.uniform(0.005, 0.1, COUNT)


def force_of(amplitude, frequency, samples=500):
    """Return the first harmonic of the force that holds a motion, N, at frequencies, from the sliders' own mapping."""
    stiffness, limits = sliders()
    x, anchored = amplitude * np.cos(2.0 * np.pi * np.arange(3 * samples) / samples), np.zeros(COUNT)
    friction = np.zeros(len(x))
    for k, one in enumerate(x):
        stretch = np.clip(one - anchored, -limits / stiffness, limits / stiffness)
        anchored, friction[k] = one - stretch, stiffness @ stretch
    phase = np.exp(-2j * np.pi * np.arange(samples) / samples)
    held = 2.0 / samples * np.sum(friction[-samples:] * phase)
    omega = 2.0 * np.pi * frequency
    natural = np.sqrt((GROUND + stiffness.sum()) / MASS)
    return np.abs((GROUND - MASS * omega**2 + 2j * DAMPING * natural * MASS * omega) * amplitude + held)


@pytest.fixture
def recording(structures, tmp_path):
    stiffness, limits = sliders()
    own = structures.sliders(stiffness, limits, MASS, GROUND)
    np.savez(tmp_path / "structure.npz", M=own.mass, K=own.stiffness, contact_map=own.contact_map, areas=own.areas,
             points=own.points, preload=own.preload, **{"outputs/head": own.outputs["head"],
                                                        "inputs/head": own.inputs["head"]})
    text, middle = HEAD, np.sqrt((GROUND + 0.7 * stiffness.sum()) / MASS) / (2.0 * np.pi)
    for level in (10e-6, 30e-6, 60e-6, 100e-6):
        f = np.linspace(0.98 * middle, 1.02 * middle, 41)
        force = force_of(level, f)
        name = f"held_{1e6 * level:.0f}.csv"
        np.savetxt(tmp_path / name, np.c_[f, force, np.full(41, 1e6 * level)], delimiter=",", header="f,F,x",
                   comments="")
        text += FRF.format(file=name)
    (tmp_path / "recording.toml").write_text(text)
    return read_structure_recording(tmp_path)


def test_held_motions_tell_the_backbone_and_the_model_needs_their_force(recording):
    experiment = StructureExperiment.of(recording)
    space = experiment.parameters(())
    predicted = experiment.predict(Point(space, np.zeros(space.size)))
    own = experiment.measurement
    count = len(experiment.points.amplitude)
    assert count == 4
    assert predicted.values[:count] == pytest.approx(own.values[:count], rel=3e-4)
    assert predicted.values[count:] == pytest.approx(own.values[count:], rel=0.03)
    curves = backbone.curves(experiment, predicted, predicted)[2:]
    assert len(curves) >= 3
    for one in curves:
        assert one.after == pytest.approx(one.measured, rel=0.03, abs=0.03 * one.measured.max())


def held(frequency, force, amplitude=1.0, control=Control.RESPONSE):
    return ControlledResponse(control=control, of="tip", at=None, level=None, frequency=frequency, force=force,
                              amplitude=np.full(len(frequency), amplitude), amplitude_unit="m/s^2", phase=None)


@pytest.mark.parametrize("damping", [1e-3, 0.02])
def test_an_oscillator_is_found_again(damping):
    f = np.linspace(78.0, 82.0, 31)
    force = 1.7 / f**2 * np.abs(80.0**2 - f**2 + 2j * damping * 80.0 * f)
    assert oscillator(held(f, force)) == pytest.approx((1.0, 80.0, damping), rel=1e-5)


def test_what_tells_no_backbone_is_named():
    f = np.linspace(81.0, 82.0, 11)
    with pytest.raises(InputError, match="no least value within its frequencies"):
        oscillator(held(f, f - 80.0))
    with pytest.raises(InputError, match="0 levels tell no trend"):
        backbone_of([held(f, f)])
