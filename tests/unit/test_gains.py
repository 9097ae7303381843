"""Gains of a rig's channels, which its equations of motion tell, and what is none."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.case.config import Rig
from fretflow.experiments.rig import instruments
from fretflow.experiments.rig.equations import Equations
from fretflow.experiments.rig.instruments import _small_gains
from fretflow.experiments.rig.setup import case_of
from fretflow.recordings.kinds import read_recording
from fretflow.recordings.loopset import LoopSet
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from rig_channels import altered, said


@pytest.mark.real_data
@pytest.mark.parametrize("size", [0.9, 1.1])
@pytest.mark.parametrize("name", ["friction_force", "excitation"])
def test_a_small_gain_is_told_with_its_size(name: str, size: float, recordings: Path) -> None:
    """Within its interval, of the channel that has it alone."""
    recording = altered(read_recording(recordings / "example_baseline"), name, lambda _, values: size * values)
    (told,), doubted = said(recording)
    low, high = map(float, re.search(r"\((\S+) to (\S+)\)", told).groups())
    assert told.startswith(f"the {name.replace('_', ' ')} is ")
    assert low <= size <= high
    assert round(high - low, 3) <= 0.03
    assert not doubted


def test_noise_of_channels_makes_no_gain_smaller() -> None:
    """A regressor with a noise of a fifth of its size has plain least squares find 1 / 1.04 of its factor."""
    rng = np.random.default_rng(1)
    loop, harmonic = (own.ravel() for own in np.meshgrid(np.repeat(np.arange(40), 40), np.arange(1, 6)))
    key = 6 * loop + harmonic

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    x, force, every = drawn(1.0, key), drawn(1.0, key), np.arange(len(key))
    solution = Equations(x / 0.9 + force, x + drawn(0.2, every), force + drawn(0.2, every), drawn(1.0, key),
                         drawn(1.0, key), harmonic.astype(float), harmonic, loop, every // 5, loop).solve()
    sd = np.sqrt(np.diag(solution.covariance))
    off = np.abs(solution.values - [1.0 / 0.9, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert off == pytest.approx(np.zeros(6), abs=4.0 * sd.max())
    assert solution.values[0] - solution.attenuated[0] == pytest.approx(1.0 / 0.9 / 1.04, rel=0.02)
    assert not solution.holds


def test_gains_are_no_surer_than_the_repeats_that_tell_them() -> None:
    """Each of 32 repeats has a gain of its own in all of its harmonics: what is found scatters as much as is told."""
    rng = np.random.default_rng(2)
    repeat, harmonic = (own.ravel() for own in np.meshgrid(np.arange(32), np.arange(1, 6), indexing="ij"))
    loop = repeat // 4

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    estimates, told = [], []
    for _ in range(200):
        x, force, other, damped = (drawn(1.0, 6 * loop + harmonic) for _ in range(4))
        gains = 1.0 + 0.05 * rng.standard_normal((2, 32))[:, repeat]
        one = Equations(x + force + drawn(1e-3, np.arange(160)), x * gains[0], force * gains[1], other, damped,
                        harmonic.astype(float), harmonic, loop, repeat, loop).solve()
        estimates.append(one.values[[0, 2]])
        told.append(np.sqrt(np.diag(one.covariance)[[0, 2]]))
    assert np.std(estimates, axis=0) == pytest.approx(np.mean(told, axis=0), rel=0.25)


@pytest.mark.real_data
def test_a_displacement_gain_is_told_beside_the_mass_that_explains_the_same(recordings: Path) -> None:
    """Receptances go with the total mass: 10.5 / 0.9 kg less the arm's 0.5 kg are 11.7 % above 10 kg."""
    recording = altered(read_recording(recordings / "example_baseline"), "displacement", lambda _, values: 0.9 * values)
    told, (doubted,) = said(recording)
    match = re.search(r"would be (\S+) % above the file's: a displacement gain of (\S+) ", doubted)
    mass, gain = map(float, match.groups())
    assert not told
    assert mass == pytest.approx(11.7, abs=1.0)
    assert gain == pytest.approx(0.9, abs=0.01)


@pytest.mark.real_data
@pytest.mark.parametrize("size", [-0.2, 0.05])
@pytest.mark.parametrize("name", ["displacement", "friction_force", "excitation"])
def test_a_gain_that_drifts_is_told_with_its_size(name: str, size: float, recordings: Path) -> None:
    """It goes with the root of the cycles, as no law here knows."""
    recording = read_recording(recordings / "example_baseline")
    last = recording.loops.cycles[-1]

    def drift(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        share = np.sqrt(loops.cycles / last) if loops is recording.loops else np.ones(len(loops.cycles))
        return values * (1.0 + size * share)[:, None, None]

    (told,), _ = said(altered(recording, name, drift))
    match = re.fullmatch(r"the gain of the (.+) drifts: at 300,000 cycles it is (\S+) times that at 0", told)
    assert match.group(1) == name.replace("_", " ")
    assert float(match.group(2)) == pytest.approx(1.0 + size, abs=0.015)


@pytest.mark.real_data
@pytest.mark.parametrize("share", [-0.3, 0.03, 0.1, 0.3])
@pytest.mark.parametrize("law", [lambda x: x**3, lambda x: np.abs(x) * x,
                                 lambda x: np.gradient(x, axis=-1) * x.shape[-1] / (2.0 * np.pi)])
def test_further_forces_on_a_recorded_rig_are_no_gain(law: Callable[[np.ndarray], np.ndarray], share: float,
                                                      recordings: Path) -> None:
    """A support or a damper of up to a third of the drive, of either sign: neither a fault nor another mass."""
    recording = read_recording(recordings / "example_baseline")

    def drive(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        lines = np.fft.rfft(np.nanmean(loops.channels["displacement"], axis=1, keepdims=True))
        lines[..., 0] = lines[..., 13:] = 0.0
        return values + share * 60.0 * law(np.fft.irfft(lines, values.shape[-1]) / 20e-6)

    assert said(altered(recording, "excitation", drive)) == ((), ())


def test_friction_that_differs_from_repeat_to_repeat_is_no_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """What repeats of a force differ by is no error of its sensor where the drive answers to it."""
    rng = np.random.default_rng(3)
    repeat, harmonic = (own.ravel() for own in np.meshgrid(np.arange(80), np.arange(1, 6), indexing="ij"))
    loop, every = repeat // 4, np.arange(400)

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    made: dict[str, Any] = {}
    monkeypatch.setattr(instruments.Equations, "of", lambda *_: made["equations"])
    monkeypatch.setattr(instruments, "further_forces", lambda *_: [])
    recording, told, apart = SimpleNamespace(loops=SimpleNamespace(calibration_sd={}, force_name="force")), 0, []
    for _ in range(100):
        x, force, other, damped = (drawn(1.0, 6 * loop + harmonic) for _ in range(4))
        force = force + drawn(0.1, every)
        made["equations"] = Equations(x + force + drawn(0.1, every), x, force, other, damped, harmonic.astype(float),
                                      harmonic, loop, repeat, loop)
        solved = made["equations"].solve()
        apart.append((solved.values[2] - 1.0) / np.sqrt(solved.covariance[2, 2]))
        told += bool(_small_gains(recording, SimpleNamespace(rig=Rig()))[0])
    assert np.mean(apart) > 1.0  # that sd off, by what is taken off for errors
    assert told <= 1


@pytest.mark.real_data
def test_a_force_in_step_with_the_friction_s_fundamental_is_no_gain_of_it(recordings: Path) -> None:
    """By its first harmonic the friction force would be a third of what it is; by the others, all of it."""
    recording = read_recording(recordings / "example_baseline")
    rig = case_of(recording).rig
    solved = LumpedRig.from_modes(rig.moving_mass, rig.arm_mass, rig.in_phase_frequency, rig.out_of_phase_frequency,
                                  rig.damping_ratio)

    def drive(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        lines = np.fft.rfft(np.nanmean(loops.channels["friction_force"], axis=1, keepdims=True))
        lines[..., 0] = lines[..., 2:] = 0.0
        receptance = np.linalg.inv(solved.impedance(2.0 * np.pi * np.asarray(loops.frequency)))
        turned = (receptance[:, 1, 1] / receptance[:, 1, 0])[:, None, None] * lines
        return values + 2.0 * np.fft.irfft(turned, values.shape[-1])

    assert said(altered(recording, "excitation", drive))[0] == ()
