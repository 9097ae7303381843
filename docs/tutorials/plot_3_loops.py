"""
Reading loops
=============

A recording is a folder with a ``recording.toml`` that says what was tested and which column of which file is what.
This one is made here: a slider of 36 N behind a spring of 20 N/µm under 60 N, three repeats at each of two cycle
counts, with noise. With a folder of your own, begin below it.
"""

from pathlib import Path

import fretflow as ff
import numpy as np

folder = Path("runs/slider")
folder.mkdir(parents=True, exist_ok=True)

phase = 2.0 * np.pi * np.arange(256) / 256
x = 10.0 * np.cos(phase)  # um
force = np.maximum(36.0 - 20.0 * (10.0 - x[:128]), -36.0)
force = np.concatenate([force, -force])
noise, rows = np.random.default_rng(1), []
for cycle in (1, 1000):
    for repeat in range(3):
        rows.append(np.column_stack([x + 0.01 * noise.standard_normal(256), force + 0.2 * noise.standard_normal(256),
                                     phase / (2.0 * np.pi * 100.0), np.full(256, cycle), np.full(256, repeat)]))
np.savetxt(folder / "loops.csv", np.vstack(rows), delimiter=",", header="x_um,force_N,time_s,cycle,repeat", comments="")

# %%
# Each channel names its column and unit; ``cycle`` and ``repeat`` say where a row belongs. `All keys
# <../../recordings.html>`_ are listed under recordings.

(folder / "recording.toml").write_text("""
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
""", encoding="utf-8")

# %%
# Loops as labelled arrays in SI; what had to be cleaned or left out is noted with its rows.

recording = ff.read_recording(folder)
loops = recording.loops.arrays
print(*recording.notes or ["nothing had to be cleaned"], sep="\n")
loops

# %%
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
for cycles in loops.cycles.values:
    one = loops.sel(cycles=cycles)
    axes.plot(1e6 * one.displacement.T, one.friction_force.T, lw=0.8, label=[f"cycle {cycles:,}", None, None])
axes.set(xlabel="displacement in µm", ylabel="friction force in N")
axes.legend()

# %%
# What is read off the mean of the repeats. The slider's own values are 0.6, 20 N/µm and 1.18 mJ.

last = loops.mean("repeat").sel(cycles=1000)
readings = ff.read_loop(ff.HysteresisLoop(displacement=last.displacement.values, force=last.friction_force.values),
                        recording.test.normal_load)
print(f"{readings.regime}: friction {readings.friction_coefficient:.3f}, "
      f"stiffness {1e-6 * readings.tangential_stiffness:.1f} N/µm, energy {1e3 * readings.dissipated_energy:.3f} mJ")

# %%
# On a terminal, ``./fretflow loops runs/slider`` reads all loops with uncertainties (of noise, of repeats and of
# calibration), draws them and writes CSV. A single file needs no ``recording.toml``::
#
#     ./fretflow loops loop.csv --displacement "2 [mm]" --force "Ftr [kN]" --normal-load "10 kN"
#
# Next: does a model explain them? See :doc:`diagnosing a recording <plot_4_diagnosis>`.
