"""
Friction that runs in
=====================

The quick case with friction that begins at 0.4 and settles with the dissipated energy: loops of the whole model at four
cycle counts, and the friction coefficient that is read off every one.
"""

import fretflow as ff
import matplotlib.pyplot as plt

case = ff.load_case("../../examples/quick.toml")
output = case.output.model_copy(update={"loop_cycles": (500, 1_000, 2_000, 4_000, 8_000, 14_000)})
run_in = {"friction-run-in": {"initial": 0.4, "energy": "20 J"}}
results = ff.run(case.model_copy(update={"name": "run-in", "effects": run_in, "output": output}), "runs", until="wear")

figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
cycles, friction = results.loops.cycles.values, []
for number in cycles:
    loop = results.loops.sel(cycles=number)
    readings = ff.read_loop(ff.HysteresisLoop(displacement=loop.displacement.values, force=loop.friction_force.values),
                            case.test.normal_load)
    friction.append(readings.friction_coefficient)
    if number in cycles[[0, 2, 4, -1]]:
        loop = loop.isel(phase=[*range(loop.sizes["phase"]), 0])
        left.plot(1e6 * loop.displacement, loop.friction_force, label=f"{number:,} cycles")
left.set(xlabel="displacement in µm", ylabel="friction force in N")
left.legend(fontsize=8, loc="center")
right.plot(cycles, friction, "o-")
right.set(xlabel="cycles", xticks=[0, 10_000, 20_000], xticklabels=["0", "10,000", "20,000"],
          ylabel="friction coefficient from the loop")
plt.show()
