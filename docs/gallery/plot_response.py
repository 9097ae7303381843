"""
Response, new and worn
======================

Amplitude of the moving mass over frequency at 75 N, about the in-phase sliding mode.
"""

import fretflow as ff
import matplotlib.pyplot as plt

results = ff.run("../../examples/quick.toml", "runs", until="response")
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for (name, curve), line in zip(results.curves.items(), ("-", "--"), strict=True):
    axes.loglog(curve.frequency, 1e6 * curve.amplitude, line, label=name)
axes.set(xlabel="frequency in Hz", ylabel="amplitude in µm")
axes.set_xticks((20, 40, 100, 200), (20, 40, 100, 200))
axes.grid(which="both", alpha=0.3)
axes.legend()
plt.show()
