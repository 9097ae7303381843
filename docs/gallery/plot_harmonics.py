"""
Harmonics of friction
=====================

Amplitudes of the friction force's harmonics at 75 N. A loop that is the same in both directions has odd ones alone; a
friction that differs with the direction of sliding shows in the mean and in the even ones.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

case = ff.load_case("../../examples/quick.toml")
directional = {"directional-friction": {"difference": 0.1}}
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for label, effects, shift in (("Coulomb", {}, -0.18), ("10 % more in one direction", directional, 0.18)):
    changed = case.model_copy(update={"name": "quick-driven", "effects": effects})
    force = ff.run(changed, "runs", until="solve").loops.friction_force.sel(cycles=0)
    sizes = np.abs(np.fft.rfft(force)) / len(force) * np.r_[1.0, np.full(len(force) // 2, 2.0)]
    axes.bar(np.arange(10) + shift, np.maximum(sizes[:10], 1e-4), 0.36, label=label)
axes.set(yscale="log", ylim=(1e-3, 100), xticks=range(10), xlabel="harmonic", ylabel="amplitude in N")
axes.legend()
plt.show()
