"""
What three harmonics lose
=========================

One joint near its friction limit, solved with the contact at every instant and by DLFT with 3 harmonics and with 20.
What is cut off depends on the penalty; each DLFT solution states its error.
"""

import fretflow as ff
import matplotlib.pyplot as plt

case = ff.load_case("../../examples/quick.toml")
test = case.test.model_copy(update={"excitation_amplitude": 56.0})
settings = {"every instant": {"method": "quasi-static", "harmonics": 40, "samples": 256},
            "DLFT, 3 harmonics": {"method": "dlft", "harmonics": 3, "samples": 128},
            "DLFT, 20 harmonics": {"method": "dlft", "harmonics": 20, "samples": 256}}
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for label, chosen in settings.items():
    solver = type(case.solver).model_validate(chosen)
    changed = case.model_copy(update={"name": "quick-driven", "test": test, "solver": solver})
    results = ff.run(changed, "runs", until="solve")
    loop = results.loops.sel(cycles=0)
    loop = loop.isel(phase=[*range(loop.sizes["phase"]), 0])
    error = results.periods[0].error_estimate
    axes.plot(1e6 * loop.face_displacement, loop.friction_force, label=f"{label}, states {100 * error:.1f} %")
axes.set(xlabel="displacement of the faces in µm", ylabel="friction force in N")
axes.legend()
plt.show()
