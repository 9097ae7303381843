"""
First run
=========

A case file goes in, a worn joint comes out. ``examples/quick.toml`` is a coarse case for a first look: two crossed
ridges of steel, 75 N of excitation at 100 Hz under a normal load of 60 N, 20,000 cycles. On a terminal::

    ./fretflow run examples/quick.toml

runs all stages, draws the pictures and ends with a summary. The same from Python, which is the clone's
own: ``.venv/bin/python my_script.py``, or with its full path from anywhere. Results go to ``runs`` where it is called.
"""

import fretflow as ff

case = ff.load_case("../../examples/quick.toml")
results = ff.run(case, "runs", until="response")

# %%
# Stages that are complete are reused, and an interrupted one goes on where it stopped: a second call takes no time.
# What was found stands in the summary, each figure with its unit.

for name, figure in results.summary.items():
    print(f"{name}: {figure.text}")

# %%
# At a glance: loops, the contact in the end, worn volume, and the response before and after.

results.plot()

# %%
# Loops, maps and curves are labelled arrays (xarray) in SI, with the unit of each in its attributes.

results.loops

# %%
# The loop of the unworn joint and of the last one kept, by hand: displacement of the observed points, 1 mm from the
# interface, against friction force.

import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
for cycles in results.loops.cycles.values[[0, -1]]:
    loop = results.loops.sel(cycles=cycles).isel(phase=[*range(results.loops.sizes["phase"]), 0])  # closed
    axes.plot(1e6 * loop.displacement, loop.friction_force, label=f"after {cycles:,} cycles")
axes.set(xlabel="displacement in µm", ylabel="friction force in N")
axes.legend()

# %%
# What engineers read off a loop: its height is the friction limit, its steep sides the joint's tangential stiffness,
# its area the work of friction in a period. Of the 64 samples of this case too few lie where it sticks; with
# ``samples = 256`` under ``[solver]`` the stiffness is 44 N/µm.

unworn = results.loops.sel(cycles=0)
readings = ff.read_loop(ff.HysteresisLoop(displacement=unworn.displacement.values,
                                          force=unworn.friction_force.values), case.test.normal_load)
print(f"friction coefficient  {readings.friction_coefficient:.3f}")
stiffness = readings.tangential_stiffness
print("tangential stiffness ", f"{1e-6 * stiffness:.1f} N/µm" if stiffness else "too few samples where it sticks")
print(f"dissipated energy     {1e3 * readings.dissipated_energy:.2f} mJ a cycle")
print(f"sliding distance      {1e6 * readings.sliding_distance:.1f} µm")

# %%
# Next: ``examples/test1.toml`` is the paper's first test on a mesh that can be relied upon; `every key of a case file
# <../../case.html>`_ is listed with its default, and ``./fretflow show CASE`` lists what a run would use.
