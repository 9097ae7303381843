"""
Friction laws in a loop
=======================

What four changes of the friction law do to the loop of the whole model at 75 N; grey: Coulomb's law with one
coefficient.
"""

import fretflow as ff
import matplotlib.pyplot as plt

case = ff.load_case("../../examples/quick.toml")
laws = {"velocity-dependent-friction": {"strength": 0.3, "speed_scale": "3 mm/s"},
        "directional-friction": {"difference": 0.1},
        "load-dependent-friction": {"exponent": 0.3}, "normal-load-coupling": {"slope": "0.5 N/um"}}


def loop_with(effects):
    """Return displacement (um) and force (N) of the closed loop under `effects`."""
    changed = case.model_copy(update={"name": "quick-driven", "effects": effects})
    loop = ff.run(changed, "runs", until="solve").loops.sel(cycles=0)
    loop = loop.isel(phase=[*range(loop.sizes["phase"]), 0])
    return 1e6 * loop.displacement, loop.friction_force


baseline = loop_with({})
figure, panels = plt.subplots(2, 2, figsize=(8, 6), sharex=True, sharey=True, layout="constrained")
for axes, (name, parameters) in zip(panels.flat, laws.items(), strict=True):
    axes.plot(*baseline, color="0.7")
    axes.plot(*loop_with({name: parameters}))
    axes.set_title(name, fontsize=10)
figure.supxlabel("displacement in µm")
figure.supylabel("friction force in N")
plt.show()
