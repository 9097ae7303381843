"""Hum of the mains on a rig's channels, and what is none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.core.units import parse_quantity
from fretflow.experiments.rig.hum import hum_between_repeats
from fretflow.recordings.kinds import read_recording
from fretflow.recordings.loopset import LoopSet
from rig_channels import altered, said


def test_noise_that_a_filter_has_passed_is_no_hum() -> None:
    """Interpolation, as of periods that are sampled anew, takes off high frequencies of noise and leaves the low."""
    rng, frequency, told = np.random.default_rng(8), np.array([122.0, 122.0]), []
    for _ in range(500):
        white = rng.standard_normal((2, 3, 101))
        passed = 0.85 * white[..., :-1] + 0.15 * white[..., 1:]
        loops = SimpleNamespace(channels={"normal_force": 50.0 + 0.1 * passed}, phase=np.arange(100),
                                repeats=np.full(2, 3), usable=np.ones((2, 3), dtype=bool))
        hum = hum_between_repeats([(loops, frequency)], "normal_force", 50.0)
        told += [] if hum is None else [hum[0]]
    assert 0.02 < np.mean(np.array(told) < 0.05) < 0.08  # uniform but for three standard errors


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "size", "anew"), [
    ("displacement", 0.4e-6, False), ("friction_force", 2.0, False), ("displacement", 0.4e-6, True),
    ("excitation", 2.0, False), ("excitation", 6.0, True), ("friction_force", 5.0, True)])
def test_hum_is_told_with_its_size(name: str, size: float, anew: bool, recordings: Path) -> None:
    """Of 50 Hz, in periods of 10 ms that cannot tell it from 60."""
    recording, rng = read_recording(recordings / "example_baseline"), np.random.default_rng(7)
    swept = np.array([one.excitation_frequency for one in recording.sweep.conditions])

    def humming(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        frequency = np.full(len(loops.cycles), 100.0) if loops is recording.loops else swept
        turns = np.arange(values.shape[2]) / values.shape[2] / frequency[:, None, None]
        begin = 0.0 if anew else rng.uniform(0.0, 2.0 * np.pi, (*values.shape[:2], 1))
        return values + size * np.sin(2.0 * np.pi * 50.0 * turns + begin)

    (told,), _ = said(altered(recording, name, humming))
    match = re.match(r"the (.+) has a hum of the mains, (.+) to (.+) in all", told)
    low, high = (parse_quantity(match.group(k), "m" if name == "displacement" else "N") for k in (2, 3))
    assert match.group(1) == name.replace("_", " ")
    assert 0.75 * low < size < 1.25 * high


@pytest.mark.real_data
def test_hum_of_the_normal_force_is_told(recordings: Path) -> None:
    """A channel that no equation of motion holds: its repeats differ by the hum, those of motion and force do not."""
    recording, rng = read_recording(recordings / "example_baseline"), np.random.default_rng(3)

    def pressed(loops: LoopSet, size: float) -> LoopSet:
        shape = loops.channels["displacement"].shape
        turns = np.arange(shape[2]) / shape[2] / 100.0
        hum = size * np.sin(2.0 * np.pi * 50.0 * turns + rng.uniform(0.0, 2.0 * np.pi, (*shape[:2], 1)))
        pressing = 60.0 + hum + 0.3 * rng.standard_normal(shape)
        return replace(loops, channels={**loops.channels, "normal_force": pressing})

    for size, expected in ((0.0, 0), (2.0, 1)):
        changed = replace(recording, loops=pressed(recording.loops, size),
                          sweep=replace(recording.sweep, loops=pressed(recording.sweep.loops, size)))
        told, _ = said(changed)
        assert len(told) == expected
        assert all(one.startswith("the normal force has a hum of the mains") for one in told)
