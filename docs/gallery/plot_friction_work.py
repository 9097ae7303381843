"""
Where the work goes
===================

Work of friction per area and cycle over the contact: tangential force times slip, summed over the period at each node;
in all it is the area of the loop.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

results = ff.run("../../examples/quick.toml", "runs", until="solve")
period, areas = results.periods[0], results.areas
slip = np.diff(period.displacement[:, :, :2], axis=0, prepend=period.displacement[-1:, :, :2])
work = -np.sum(period.force[:, :, :2] * slip, axis=(0, 2))  # J a cycle at each node

figure, axes = plt.subplots(figsize=(5.5, 4), layout="constrained")
shown = axes.tripcolor(Triangulation(*(1e3 * results.nodes.T)), 1e-3 * work / areas, cmap="inferno", shading="gouraud")
axes.set(aspect="equal", xlabel="x in mm, sliding direction", ylabel="y in mm",
         title=f"in all {1e3 * work.sum():.2f} mJ a cycle")
figure.colorbar(shown, ax=axes, label="work in mJ/mm² a cycle")
plt.show()
