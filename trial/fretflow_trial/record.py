"""A recording in the exchange format ``fretflow-recording/1``: noise, gains, offsets and scatter, then the files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.signal import lfilter

from fretflow_trial.case import Simulated
from fretflow_trial.joint import DENSITY, Joint
from fretflow_trial.physics import Channels
from fretflow_trial.world import BASIC

Array = NDArray[np.float64]

UNITS = {"displacement": ("displacement_um", "um", 1e6, 5), "friction_force": ("friction_force_N", "N", 1.0, 4),
         "normal_force": ("normal_force_N", "N", 1.0, 4), "approach": ("approach_um", "um", 1e6, 5)}
DRIVE = ("excitation_N",)


def write(simulated: Simulated, folder: Path, title: str) -> Path:
    """Write the recording of a simulated case to `folder`, which is made, and return it."""
    case = simulated.case
    rng = np.random.default_rng(case.seed)
    joint = case.joint
    gains = {name: 1.0 + case.noise.calibration * rng.standard_normal() for name in case.channels}
    folder.mkdir(parents=True)
    counts = case.plan.cycles
    for file, heading, marks, loops, first in (
            ("loops.csv", "cycle", counts, simulated.outcome.loops, 0),
            ("sweep.csv", "condition", range(len(case.plan.sweep)), simulated.outcome.sweep, len(counts))):
        lines = [",".join([heading, "repeat", "time_s", *(DRIVE if case.drive_recorded else ()),
                           *(UNITS[name][0] for name in case.channels)])]
        for k, (mark, loop) in enumerate(zip(marks, loops, strict=True)):
            lines += _loop_rows(simulated, rng, loop, f"{mark}", first + k, gains)
        (folder / file).write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "wear_depth.csv").write_text(_map(simulated, rng, joint), encoding="utf-8")
    volume = float(simulated.outcome.depth @ joint.areas)
    spread = case.noise.volume * max(volume, 1e-13)
    volume = max(volume + spread * rng.standard_normal(), 0.0)
    (folder / "recording.toml").write_text(_toml(simulated, title, volume, spread), encoding="utf-8")
    return folder


def _loop_rows(simulated: Simulated, rng: Generator, loop: Channels, mark: str, row: int, gains: dict[str, float]
               ) -> list[str]:
    case, noise = simulated.case, simulated.case.noise
    samples = len(loop.time) // loop.periods
    offsets = {name: noise.offset[name] * rng.standard_normal() for name in case.channels}
    first = int(rng.integers(loop.periods))
    lines = []
    for repeat in range(case.repeats):
        begin = (first + repeat) % loop.periods * samples
        part = slice(begin, begin + samples)
        friction = noise.repeat_friction * rng.standard_normal()
        drive = loop.excitation[part] + noise.sample["excitation"] * coloured(rng, samples, noise.colour)
        columns = [loop.time[:samples], *([drive] if case.drive_recorded else [])]
        for name in case.channels:
            scatter = gains[name] * (1.0 + noise.repeat_gain * rng.standard_normal() * (name in BASIC))
            ideal = getattr(loop, name)[part] + friction * simulated.rates.friction[name][row]
            columns.append(UNITS[name][2] * (scatter * ideal + offsets[name]
                                             + noise.sample[name] * coloured(rng, samples, noise.colour)))
        places = [6, *([4] if case.drive_recorded else []), *(UNITS[name][3] for name in case.channels)]
        lines += [f"{mark},{repeat}," + ",".join(f"{value:.{digits}f}" for value, digits in zip(
            values, places, strict=True)) for values in zip(*columns, strict=True)]
    return lines


def coloured(rng: Generator, count: int, colour: float) -> Array:
    """Return noise (`count`,) of unit variance, each sample correlated by `colour` with the one before."""
    fresh = rng.standard_normal(count)
    fresh[1:] *= np.sqrt(1.0 - colour**2)
    return np.asarray(lfilter([1.0], [1.0, -colour], fresh))


def _map(simulated: Simulated, rng: Generator, joint: Joint) -> str:
    """Return the map of total depth on an even grid, as a profilometer gives it."""
    line = np.unique(np.round(joint.nodes[:, 0], 12))
    depth = RectBivariateSpline(line, line, simulated.outcome.depth.reshape(len(line), -1), kx=1, ky=1)
    even = np.linspace(line[0], line[-1], simulated.case.map_points)
    measured = depth(even, even) + simulated.case.noise.depth * rng.standard_normal(2 * [len(even)])
    rows = [f"{1e3 * x:.5f},{1e3 * y:.5f},{1e6 * measured[i, j]:.4f}" for i, x in enumerate(even)
            for j, y in enumerate(even)]
    return "\n".join(["x_mm,y_mm,depth_um", *rows]) + "\n"


def _toml(simulated: Simulated, title: str, volume: float, spread: float) -> str:
    case, rig, main, part = (simulated.case, simulated.case.physics.rig, simulated.case.plan.main,
                             simulated.case.stated)
    calibrated = "\n".join(
        f'{name} = {{ column = "{UNITS[name][0]}", unit = "{UNITS[name][1]}", '
        f"calibration_sd = {case.noise.calibration} }}" for name in case.channels)
    if case.drive_recorded:
        calibrated += '\nexcitation = { column = "excitation_N", unit = "N" }'
    conditions = "\n".join(
        f'[[sweep.conditions]]\nid = {k}\nexcitation_amplitude = "{one.amplitude} N"\nnormal_load = "{one.load} N"\n'
        f'excitation_frequency = "{one.frequency} Hz"' for k, one in enumerate(case.plan.sweep))
    return f"""format = "fretflow-recording/1"
title = "{title}"

[test]
kind = "fretting-rig"
excitation_frequency = "{main.frequency} Hz"
excitation_amplitude = "{main.amplitude} N"
normal_load = "{main.load} N"
cycles = {case.plan.cycles[-1]}

[rig]
moving_mass = "{case.stated_mass} kg"
arm_mass = "{rig.arm_mass} kg"
in_phase_frequency = "{rig.in_phase} Hz"
out_of_phase_frequency = "{rig.out_of_phase} Hz"
damping_ratio = {rig.damping_ratio}

[specimen]
youngs_modulus = "{1e-9 * part.youngs_modulus:g} GPa"
poissons_ratio = {part.poissons_ratio:g}
density = "{DENSITY:.0f} kg/m^3"
contact_width = "{1e3 * part.contact_width:g} mm"
ridge_height = "{1e3 * part.ridge_height:g} mm"
body = "square"
body_width = "{1e3 * part.body_width:g} mm"
body_height = "{1e3 * part.body_height:g} mm"

[wear]
worn_volume = "{1e9 * volume:.6g} mm^3"
worn_volume_sd = "{1e9 * spread:.2g} mm^3"

[loops]
file = "loops.csv"
displacement_of = "contact-faces"
{calibrated}
time = {{ column = "time_s", unit = "s" }}
cycle = {{ column = "cycle" }}
repeat = {{ column = "repeat" }}

[sweep]                       # loops at other conditions, recorded at the end of the test, with negligible wear
file = "sweep.csv"
same_channels_as = "loops"
condition = {{ column = "condition" }}
{conditions}

[wear_depth]
file = "wear_depth.csv"
x = {{ column = "x_mm", unit = "mm" }}
y = {{ column = "y_mm", unit = "mm" }}
depth = {{ column = "depth_um", unit = "um", sd = "{1e6 * case.noise.depth:.2g} um" }}
"""
