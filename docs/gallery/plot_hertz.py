"""
A crowned face against Hertz
============================

Pressure of a crowned face of 40 mm radius on a flat one under 60 N, at each node of the contact, beside the closed form
for two half-spaces (K. L. Johnson, Contact Mechanics, 1985, section 4.2).
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

case = ff.load_case("../../examples/crowned.toml")
mesh = case.mesh.model_copy(update={"contact_elements": 8})  # coarser than the example's
results = ff.run(case.model_copy(update={"mesh": mesh}), "runs", until="preload")
steel, load = case.specimen.upper, case.test.normal_load
modulus = steel.youngs_modulus / (2.0 * (1.0 - steel.poissons_ratio**2))
radius = (3.0 * load * steel.face_radius / (4.0 * modulus)) ** (1.0 / 3.0)
peak = 3.0 * load / (2.0 * np.pi * radius**2)

r = np.linspace(0.0, radius, 200)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.plot(1e3 * r, 1e-6 * peak * np.sqrt(1.0 - (r / radius) ** 2), label="Hertz")
axes.plot(1e3 * np.hypot(*results.nodes.T), 1e-6 * results.static_pressure, "o", markersize=3, label="nodes")
axes.set(xlabel="distance from the middle in mm", ylabel="pressure in MPa")
axes.legend()
plt.show()
