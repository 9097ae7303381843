"""Loops as labelled arrays: a recording is read and cleaned, its arrays and readings are used.

The recording is made here: a slider of 36 N behind a spring of 20 N/um under 60 N, recorded three times at each of two
cycle counts, with noise. Of your own you have the folder already, and need the five lines of `main`.
"""

import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np

RECORDING = """
format = "fretflow-recording/1"
[test]
kind = "fretting-rig"
excitation_frequency = "100 Hz"
normal_load = "60 N"
cycles = 1000
[loops]
file = "loops.csv"
displacement_of = "contact-faces"
displacement = { column = "x_um", unit = "um" }
friction_force = { column = "force_N", unit = "N" }
time = { column = "time_s", unit = "s" }
cycle = { column = "cycle" }
repeat = { column = "repeat" }
"""


def make_recording(folder: Path) -> None:
    """Write the recording to `folder`."""
    phase = 2.0 * np.pi * np.arange(256) / 256
    x = 10.0 * np.cos(phase)  # um
    force = np.empty(256)
    force[:128] = np.maximum(36.0 - 20.0 * (10.0 - x[:128]), -36.0)
    force[128:] = -force[:128]
    noise, rows = np.random.default_rng(1), []
    for cycle in (1, 1000):
        for repeat in range(3):
            seen = [x + 0.01 * noise.standard_normal(256), force + 0.2 * noise.standard_normal(256)]
            rows.append(np.column_stack([*seen, phase / (2.0 * np.pi * 100.0), np.full(256, cycle),
                                         np.full(256, repeat)]))
    np.savetxt(folder / "loops.csv", np.vstack(rows), delimiter=",", header="x_um,force_N,time_s,cycle,repeat",
               comments="")
    (folder / "recording.toml").write_text(RECORDING, encoding="utf-8")


def main(folder: Path) -> None:
    """Read the recording in `folder`."""
    recording = ff.read_recording(folder)
    loops = recording.loops.arrays.mean("repeat")  # xarray: dimensions cycles and phase
    last = loops.sel(cycles=1000)
    loop = ff.HysteresisLoop(displacement=last.displacement.values, force=last.friction_force.values)
    readings = ff.read_loop(loop, recording.test.normal_load)

    assert dict(loops.sizes) == {"cycles": 2, "phase": 256}
    assert recording.loops.arrays.friction_force.attrs["units"] == "N"
    assert abs(readings.friction_coefficient / 0.6 - 1.0) < 0.01  # 36 N / 60 N
    assert abs(readings.tangential_stiffness / 20e6 - 1.0) < 0.05
    assert abs(readings.dissipated_energy / (4.0 * 36.0 * (10e-6 - 36.0 / 20e6)) - 1.0) < 0.01
    assert abs(np.ptp(last.displacement.values) / 20e-6 - 1.0) < 0.01


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        make_recording(Path(made))
        main(Path(made))
