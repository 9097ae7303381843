"""
Volume against energy
=====================

In gross slip with one friction coefficient the volume per dissipated energy is K/µ exactly (dashed): a balance that
every run keeps.
"""

import fretflow as ff
import matplotlib.pyplot as plt

results = ff.run("../../examples/quick.toml", "runs", until="wear")
energy, volume = results.wear.energy, results.wear.volume
slope = results.case.wear.coefficient / results.case.contact.friction_coefficient

figure, axes = plt.subplots(figsize=(6.5, 4), layout="constrained")
axes.plot(energy, 1e9 * volume, "o", label="jumps of cycles")
axes.plot(energy, 1e9 * slope * energy, "k--", lw=1, label="K/µ times energy")
axes.set(xlabel="dissipated energy in J", ylabel="worn volume in mm³")
axes.legend()
plt.show()
