"""
Tractions over a period
=======================

Tangential traction along the middle line of the contact, over one period in gross slip: both plateaus, and the
turns between them. Friction tilts the faces, so that one end of the ridge carries most.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

results = ff.run("../../examples/quick.toml", "runs", until="solve")
period, nodes = results.periods[0], results.nodes
line = np.flatnonzero(np.abs(nodes[:, 1]) < 1e-9)
traction = 1e-6 * period.force[:, line, 0] / results.areas[line]  # MPa, (samples, nodes)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
share = np.arange(len(traction)) / len(traction)
scale = np.quantile(np.abs(traction), 0.98)  # the ends of the ridge reach further
shown = axes.pcolormesh(1e3 * nodes[line, 0], share, traction, cmap="PuOr_r", vmin=-scale, vmax=scale,
                        shading="nearest")
axes.set(xlim=(-0.5, 0.5), xlabel="x in mm, sliding direction", ylabel="share of the period")
figure.colorbar(shown, ax=axes, label="traction on the upper face in MPa")
plt.show()
