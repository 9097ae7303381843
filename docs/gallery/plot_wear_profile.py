"""
A face wears
============

Depth worn off both faces along the sliding direction, through the middle of the contact, as the test goes on. The edges
wear first, where a flat ridge presses hardest; then the pressure evens out.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

results = ff.run("../../examples/quick.toml", "runs", until="wear")
wear = results.wear
middle = np.abs(wear.y) < 1e-9
x = 1e3 * wear.x[middle]

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
shown = np.linspace(1, wear.sizes["cycles"] - 1, 6).round().astype(int)
for colour, row in zip(plt.cm.viridis(np.linspace(0, 0.9, len(shown))), shown, strict=True):
    cycles = int(wear.cycles[row])
    axes.plot(x, -1e6 * wear.depth[row, middle], "o-", color=colour, label=f"{cycles:,}")
axes.set(xlabel="x in mm, sliding direction", ylabel="height in µm")
axes.legend(title="cycles", loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()
