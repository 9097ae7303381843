"""
Debris turns W into U
=====================

Depth worn off along the sliding direction with and without a third body. Bare faces are deepest at the edges (W);
debris stays longest in the middle, carries load there, and the profile follows the layer (U).
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

case = ff.load_case("../../examples/quick.toml")
test = case.test.model_copy(update={"cycles": 200_000})
debris = {"third-body": {"retained_fraction": 0.8, "residence": 5e4}}
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name, label, effects in (("quick-bare", "bare faces", {}), ("quick-debris", "with debris", debris)):
    changed = case.model_copy(update={"name": name, "test": test, "effects": effects})
    wear = ff.run(changed, "runs", until="wear").wear
    middle = np.abs(wear.y) < 1e-9
    depth = wear.depth.isel(cycles=-1)[middle]
    mean = float(depth.mean())
    axes.plot(1e3 * wear.x[middle], 1e6 * (mean - depth), "o-", label=f"{label}, {1e6 * mean:.1f} µm deep")
axes.set(xlabel="x in mm, sliding direction", ylabel="height above the mean in µm")
axes.legend()
plt.show()
