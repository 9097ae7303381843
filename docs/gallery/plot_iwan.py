"""
Damping of a joint by Iwan's closed form
========================================

Sixty sliders beside a spring hold a mass of 2 kg; they slip one after the other as the amplitude grows. Damping ratio
from static loads in the shape of the mode, beside the closed form of Iwan's model with slip displacements that are
spread evenly (J. Appl. Mech. 33, 1966); at small amplitudes only few of the sixty slip.
"""

import fretflow as ff
import matplotlib.pyplot as plt
import numpy as np

TOTAL, LONGEST, MASS, GROUND, COUNT = 4e4, 1e-4, 2.0, 3e4, 60  # N/m, m, kg, N/m
spring = TOTAL / COUNT
limits = spring * LONGEST * (np.arange(COUNT) + 0.5) / COUNT  # N, each slider's

size = 1 + 3 * COUNT  # the mass, and a massless node for each slider that touches the ground
M, K = np.zeros((size, size)), spring * np.eye(size)
M[0, 0], K[0, 0] = MASS, GROUND + TOTAL
K[0, 1::3] = K[1::3, 0] = -spring
preload, head = np.zeros(size), np.eye(size)[0]
preload[3::3] = -limits
structure = ff.StructureMatrices(
    mass=M, stiffness=K, contact_map=np.eye(size)[1:], areas=np.full(COUNT, 1e-6), points=np.zeros((COUNT, 3)),
    preload=preload, inputs={"head": head}, outputs={"head": head})
joint = ff.BoltedJoint(structure=ff.reduce_structure(structure), law=ff.Coulomb(1.0), bolt_load=1.0)
mode = joint.linear_modes(1)[0]
backbone = ff.quasi_static_backbone(joint, mode, np.geomspace(0.03, 0.6, 15) * LONGEST * np.sqrt(MASS))

x = np.geomspace(0.02, 0.8, 100) * LONGEST
density = TOTAL / LONGEST
work, stiffness = 2.0 / 3.0 * density * x**3, GROUND + TOTAL - 0.5 * density * x
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.loglog(1e6 * x, 100.0 * work / (2.0 * np.pi * stiffness * x**2), label="closed form")
axes.loglog(1e6 * backbone.amplitude / np.sqrt(MASS), 100.0 * backbone.friction_damping, "o", label="60 sliders")
axes.set(xlabel="amplitude in µm", ylabel="damping ratio in %")
axes.set_xticks((2, 5, 10, 20, 50), (2, 5, 10, 20, 50))
axes.set_yticks((0.1, 0.3, 1, 3), (0.1, 0.3, 1, 3))
axes.legend()
plt.show()
