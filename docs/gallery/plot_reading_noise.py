"""
How noise moves what is read
============================

A slider of 36 N behind 20 N/µm under 60 N, read two hundred times at each of six noise levels: mean and standard
deviation of friction and stiffness.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

phase = 2.0 * np.pi * np.arange(256) / 256
x = 10e-6 * np.cos(phase)
force = np.maximum(36.0 - 20e6 * (10e-6 - x[:128]), -36.0)
force = np.concatenate([force, -force])
exact = ff.HysteresisLoop(displacement=x, force=force)

levels, noise = np.array([0.0, 0.2, 0.5, 1.0, 1.5, 2.0]), np.random.default_rng(0)
read = np.empty((len(levels), 200, 2))
for k, level in enumerate(levels):
    for trial in range(200):
        seen = ff.HysteresisLoop(displacement=x, force=force + level * noise.standard_normal(256))
        readings = ff.read_loop(seen, 60.0, guide=exact)
        read[k, trial] = readings.friction_coefficient, 1e-6 * readings.tangential_stiffness

figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for axes, column, label, truth in zip(panels, (0, 1), ("friction coefficient", "stiffness in N/µm"), (0.6, 20.0),
                                      strict=True):
    axes.errorbar(levels, read[:, :, column].mean(axis=1), read[:, :, column].std(axis=1), fmt="o", capsize=4)
    axes.axhline(truth, color="k", ls="--", lw=1)
    axes.set(xlabel="noise of the force in N", ylabel=label)
plt.show()
