"""Forced responses from a backbone: a linear one is the oscillator's, and a softening one leans as its backbone does.

What carries the weight: the force that holds an amplitude and the amplitude that a force gives are inverse to each
other, and the time integration of a Jenkins element under a force.
"""

from __future__ import annotations

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.solvers.nonlinear_modes.quasi_static import ModalBackbone
from fretflow.solvers.nonlinear_modes.response import force_of_response, respond_to_force


def backbone(frequency, damping):
    amplitude, size = np.geomspace(1e-6, 1e-1, 200), 200
    return ModalBackbone(amplitude=amplitude, frequency=frequency(amplitude), damping=damping(amplitude),
                         friction_damping=damping(amplitude), outputs=amplitude[:, None], output_names=("tip",),
                         dissipated=np.zeros(size), sliding=np.zeros(size, dtype=int),
                         open=np.zeros(size, dtype=int))


def test_a_linear_mode_is_an_oscillator():
    response = respond_to_force(backbone(lambda a: 50.0 + 0.0 * a, lambda a: 0.02 + 0.0 * a), 0.5, 3.0)
    omega, natural = 2.0 * np.pi * response.frequency, 100.0 * np.pi
    exact = 1.5 / np.abs(natural**2 - omega**2 + 0.04j * natural * omega)
    assert response.amplitude == pytest.approx(exact, rel=1e-9)
    assert response.amplitude.max() == pytest.approx(1.5 / (0.04 * natural**2), rel=1e-3)
    assert np.any(np.diff(response.frequency) > 0.0)


def test_held_force_and_held_response_are_inverse():
    curve = backbone(lambda a: 50.0 * (1.0 - 2.0 * a), lambda a: 0.005 + 0.3 * a)
    response = respond_to_force(curve, 0.7, 20.0)
    for k in range(0, len(response.frequency), 50):
        back = force_of_response(curve, 0.7, response.amplitude[k], response.frequency[k:k + 1])
        assert back.force == pytest.approx(20.0, rel=2e-3)
    top = int(np.argmax(response.amplitude))
    assert response.frequency[top] == pytest.approx(50.0 * (1.0 - 2.0 * response.amplitude[top]), rel=1e-3)


def test_what_lies_outside_the_backbone_is_refused():
    curve = backbone(lambda a: 50.0 + 0.0 * a, lambda a: 0.01 + 0.0 * a)
    with pytest.raises(InputError, match=r"resonance of 1e\+06 N lies outside .*, beyond the largest; raise it"):
        respond_to_force(curve, 1.0, 1e6)
    with pytest.raises(InputError, match="amplitude: 1 lies outside"):
        force_of_response(curve, 1.0, 1.0, np.array([50.0]))
    with pytest.raises(InputError, match="force: must be positive"):
        respond_to_force(curve, 1.0, 0.0)


def test_a_sliding_mass_under_a_force_as_in_time(structures):
    """Newmark on the same Jenkins element: the amplitude in resonance, to 1 %."""
    import fretflow as ff

    springs, limits, mass, ground = np.array([1.2e4, 8e3]), np.array([2.0, 3.0]), 2.0, 3e4
    reduced = ff.reduce_structure(structures.sliders(springs, limits, mass, ground))
    joint = ff.BoltedJoint(structure=reduced, law=ff.Coulomb(1.0), bolt_load=1.0)
    mode = joint.linear_modes(1)[0]
    curve = ff.quasi_static_backbone(joint, mode, np.geomspace(1e-5, 3e-3, 100))
    force = 3.0
    response = respond_to_force(curve, 1.0 / np.sqrt(mass), force)
    top = int(np.argmax(response.amplitude))
    frequency = float(response.frequency[top])
    seen = _driven(mass, ground, springs, limits, force, frequency, float(response.outputs[top, 0]))
    assert response.outputs[top, 0] == pytest.approx(seen, rel=0.01)


def _driven(mass, ground, stiffness, limits, force, frequency, guess, periods=150, steps=400):
    """Return the amplitude of the first harmonic of the last period, by central differences; `guess` starts on top."""
    step = 1.0 / (frequency * steps)
    x, before, anchored = -guess, -guess, np.zeros(len(stiffness))
    positions = np.zeros(periods * steps)
    for k in range(len(positions)):
        stretch = np.clip(x - anchored, -limits / stiffness, limits / stiffness)
        anchored = x - stretch
        pull = force * np.sin(2.0 * np.pi * frequency * k * step) - ground * x - stiffness @ stretch
        x, before = 2.0 * x - before + step**2 * pull / mass, x
        positions[k] = x
    last = positions[-steps:]
    return 2.0 * abs(np.fft.rfft(last)[1]) / steps
