"""
From sticking to sliding
========================

Loops of one joint at six amplitudes of the excitation: a line while it sticks, a thin loop in partial slip, a
parallelogram with the height of the friction limit, 52.8 N, where all of it slides.
"""

import fretflow as ff
import matplotlib.pyplot as plt

case = ff.load_case("../../examples/quick.toml")
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for newton in (75, 60, 53, 45, 38, 30):
    test = case.test.model_copy(update={"excitation_amplitude": float(newton)})
    driven = case.model_copy(update={"name": "quick-driven", "test": test})
    loop = ff.run(driven, "runs", until="solve").loops.sel(cycles=0)
    loop = loop.isel(phase=[*range(loop.sizes["phase"]), 0])  # closed
    axes.plot(1e6 * loop.displacement, loop.friction_force, label=f"{newton} N")
axes.set(xlabel="displacement in µm", ylabel="friction force in N")
axes.legend(title="excitation", loc="upper left", bbox_to_anchor=(1.0, 1.0))
plt.show()
