"""
Where it sticks
===============

Share of the period that each place of the contact sticks, at an excitation below and above the friction limit of
52.8 N. Below it the ends of the contact along the sliding direction begin to slip; above it all of it slides, and
sticks only while it turns.
"""

import fretflow as ff
import matplotlib.pyplot as plt
from matplotlib.tri import Triangulation

case = ff.load_case("../../examples/quick.toml")
figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for axes, newton in zip(panels, (45, 60), strict=True):
    test = case.test.model_copy(update={"excitation_amplitude": float(newton)})
    driven = case.model_copy(update={"name": "quick-driven", "test": test})
    maps = ff.run(driven, "runs", until="solve").maps.sel(cycles=0)
    places = Triangulation(1e3 * maps.x, 1e3 * maps.y)
    shown = axes.tripcolor(places, maps.stick.values, cmap="cividis", vmin=0.0, vmax=1.0, shading="gouraud")
    axes.set(title=f"{newton} N", xlabel="x in mm", ylabel="y in mm", aspect="equal")
figure.colorbar(shown, ax=panels, label="share of the period that sticks")
plt.show()
