"""
How sliding depends on the drive
================================

Sliding distance over the amplitude of the excitation. Just above the friction limit of 52.8 N a little force moves it a
lot, so that a prediction there is no better than the load and the friction put in.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

case = ff.load_case("../../examples/quick.toml")
forces, sliding = np.array([40, 46, 50, 52, 53, 54, 56, 60, 66, 75.0]), []
for force in forces:
    test = case.test.model_copy(update={"excitation_amplitude": force})
    driven = case.model_copy(update={"name": "quick-driven", "test": test})
    loop = ff.run(driven, "runs", until="solve").loops.sel(cycles=0)
    sliding.append(1e6 * np.ptp(loop.face_displacement.values))

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.plot(forces, sliding, "o-")
axes.axvline(case.contact.friction_coefficient * case.test.normal_load, color="k", ls="--", lw=1)
axes.set(xlabel="excitation in N", ylabel="sliding distance in µm, peak to peak")
plt.show()
