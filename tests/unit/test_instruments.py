"""Faults of the instruments of a rig, on loops that satisfy its equations of motion exactly.

What carries the weight: the contact plays no part. Any friction force, with the motion that the rig makes of it, has no
fault; a wrong unit, gain, delay or a channel that saturates is told with its size.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.case.config import Rig
from fretflow.experiments.rig.instruments import faults
from fretflow.structure.two_mass_rig.lumped import LumpedRig

SAMPLES, FREQUENCY, LOAD = 100, 100.0, 60.0
OMEGA = 2.0 * np.pi * FREQUENCY


class Loops:
    """Loops of displacement and friction force, one repeat each."""

    force_name = "friction_force"

    def __init__(self, channels: dict[str, np.ndarray]) -> None:
        self.channels = {name: values[:, None] for name, values in channels.items()}
        self.phase = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
        self.cycles = np.arange(len(channels["displacement"]))

    def mean(self, name: str) -> np.ndarray:
        """Return the loops (K, N)."""
        return np.asarray(self.channels[name][:, 0])


def recorded(gain: float = 1.0, late: float = 0.0, limit: float = np.inf) -> tuple[Any, Any]:
    """Return a recording of four loops at other drives and friction forces, and its case; the force sensor is wrong."""
    rig = Rig()
    solved = LumpedRig.from_modes(rig.moving_mass, rig.arm_mass, rig.in_phase_frequency, rig.out_of_phase_frequency,
                                  rig.damping_ratio)
    receptance = np.linalg.inv(solved.impedance(np.array([OMEGA])))[0]
    turn = np.exp(1j * OMEGA / FREQUENCY * np.arange(SAMPLES) / SAMPLES)
    drive, friction = np.array([50.0, 60.0, 70.0, 60.0]), np.array([48.0, 50.0, 52.0, 40.0]) * np.exp(
        1j * np.array([-1.0, -0.8, -0.7, -0.5]))
    motion = receptance[1, 0] * drive - receptance[1, 1] * friction
    noise = 0.05 * np.random.default_rng(1).standard_normal((4, SAMPLES))
    shown = gain * friction * np.exp(-1j * OMEGA * late)
    loops = {"displacement": np.real(np.outer(motion, turn)), "excitation": np.real(np.outer(drive, turn)),
             "friction_force": np.clip(np.real(np.outer(shown, turn)) + abs(gain) * noise, -limit, limit)}
    test = SimpleNamespace(excitation_amplitude=60.0, excitation_frequency=FREQUENCY, normal_load=LOAD)
    return SimpleNamespace(loops=Loops(loops), sweep=None, test=test), SimpleNamespace(rig=rig)


def test_a_rig_in_motion_with_any_friction_has_no_fault() -> None:
    """The loops satisfy the equations of motion."""
    assert faults(*recorded()) == ()


@pytest.mark.parametrize(("change", "said"), [
    ({"gain": 1e-3}, "friction force is 0.001 times what the rig's masses"),
    ({"gain": 3.0}, "friction force is 3 times"),
    ({"gain": -1.0}, "friction force is recorded with its sign reversed"),
    ({"late": 5e-4}, "friction force comes 500 µs late"), ({"limit": 42.0}, "friction force saturates at 42 N in")])
def test_a_fault_is_told_with_its_size(change: dict[str, float], said: str) -> None:
    """Unit, gain, sign, delay and saturation of the force."""
    found = faults(*recorded(**change))
    assert said in found[0]


def test_what_effects_of_the_catalogue_do_is_no_fault() -> None:
    """A delay of a filter and a gain that is off by a fifth are left to the diagnosis."""
    assert faults(*recorded(late=2e-4)) == ()
    assert faults(*recorded(gain=1.2)) == ()


def test_loops_without_a_record_of_their_drive_tell_no_gain() -> None:
    """Their phase is counted from the displacement, so that the stated drive's is not known."""
    recording, case = recorded()
    loops = recording.loops.channels
    del loops["excitation"]
    for name, values in loops.items():
        loops[name] = np.roll(values, SAMPLES // 3, axis=-1)
    assert faults(recording, case) == ()


def test_further_forces_on_the_rig_are_no_fault_of_an_instrument() -> None:
    """A force that follows the cube of the motion, of the size of the drive: no two gains make the equations hold."""
    recording, case = recorded()
    x = recording.loops.channels["displacement"]
    drive = recording.loops.channels["excitation"]
    recording.loops.channels["excitation"] = drive - 3.0 * np.abs(drive).max() * (x / np.abs(x).max())**3
    assert faults(recording, case) == ()
