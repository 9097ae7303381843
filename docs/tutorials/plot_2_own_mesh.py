"""
Own geometry and mesh
=====================

The specimens that fretflow makes are bodies with crossed ridges. Any other geometry comes as two mesh files, one a
specimen, with three named groups. Here: two flat pins of 1.2 mm diameter, meshed with gmsh's Python interface.
"""

from pathlib import Path

import fretflow as ff
import gmsh

RADIUS, HEIGHT, LAYERS = 0.6e-3, 1.5e-3, 5  # m, m, elements along z


# %%
# What a mesh must have
# ---------------------
# - Hexahedra of 8 or 27 nodes, in **metres**.
# - The physical surface ``contact`` in the plane z = 0, the physical surface ``clamped``, the physical volume ``body``.
# - The upper specimen in z > 0, the lower one in z < 0; x is the direction of sliding.
# - Contact nodes of both files at the same places; their order does not matter.
#
# A disc of quadrilaterals, extruded in layers, has all of it. Both pins start from the same disc, so that their nodes
# match.

def make_pin(side: str, direction: int) -> Path:
    """Write a pin whose body lies in z > 0 (`direction` 1) or z < 0 (-1)."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    disc = gmsh.model.occ.addDisk(0.0, 0.0, 0.0, RADIUS, RADIUS)
    made = gmsh.model.occ.extrude([(2, disc)], 0.0, 0.0, direction * HEIGHT, numElements=[LAYERS], recombine=True)
    gmsh.model.occ.synchronize()
    back, body = made[0][1], made[1][1]
    for name, dimension, entity in (("contact", 2, disc), ("clamped", 2, back), ("body", 3, body)):
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [entity]), name)
    gmsh.model.mesh.setRecombine(2, disc)
    gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 2)  # quadrilaterals only
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.5 * RADIUS)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5 * RADIUS)
    gmsh.model.mesh.generate(3)
    file = Path(f"{side}.msh")
    gmsh.write(str(file))
    gmsh.finalize()
    return file


Path("runs").mkdir(exist_ok=True)
meshes = [make_pin(f"runs/{side}", direction) for side, direction in (("upper", 1), ("lower", -1))]
print(*meshes)

# %%
# The case
# --------
# ``[mesh]`` names both files, counted from the case file's folder. Material and the distance of the observed point from
# the interface still come from ``[specimen]``; here it is titanium, not steel.

Path("runs/pins.toml").write_text("""
format = "fretflow-case/1"
name = "pins"

[test]
excitation_amplitude = "75 N"
normal_load = "60 N"
cycles = 10_000

[specimen]
youngs_modulus = "114 GPa"
poissons_ratio = 0.33
density = "4430 kg/m^3"
observation_distance = "0.9 mm"

[mesh]
upper = "upper.msh"
lower = "lower.msh"

[reduction]
checked_frequencies = 5

[contact]
friction_coefficient = 0.7

[solver]
harmonics = 9
samples = 64

[output]
wear_map_cycles = [10_000]
""", encoding="utf-8")
results = ff.run("runs/pins.toml", "runs", until="wear")
for name in ("mesh quality", "Craig-Bampton error", "static load"):
    print(f"{name:22} {results.summary[name].text}")

# %%
# Two equal pins press, and so wear, almost evenly; mind how narrow the scales are.

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

maps = results.maps
x, y = 1e3 * maps.x.values, 1e3 * maps.y.values
figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for axes, values, label in ((panels[0], 1e-6 * maps.mean_pressure.sel(cycles=0), "mean pressure, unworn, in MPa"),
                            (panels[1], 1e6 * maps.wear_depth.isel(cycles=-1), "wear depth in µm")):
    shown = axes.tripcolor(Triangulation(x, y), np.asarray(values), shading="gouraud")
    axes.plot(x, y, ".", color="white", markersize=2)
    axes.set(aspect="equal", xlabel="x in mm, sliding direction", ylabel="y in mm", title=label)
    figure.colorbar(shown, ax=axes)

# %%
# What cannot be used is refused in one line that names the file, the group and the way out:

try:
    broken = Path("runs/pins.toml").read_text(encoding="utf-8").replace('"lower.msh"', '"upper.msh"')
    Path("runs/broken.toml").write_text(broken.replace('"pins"', '"broken"'), encoding="utf-8")
    ff.run("runs/broken.toml", "runs", until="mesh")
except ff.InputError as error:
    print(str(error).replace(f"{Path.cwd()}/", ""))
