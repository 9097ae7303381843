"""
A bolted beam
=============

Two steel beams, lapped over 120 mm and held by three bolts: a structure that is given by its matrices. As it vibrates,
the lap slips from its ends, so that frequency and damping of a mode depend on the amplitude. What fretflow needs is
mass, stiffness with the joint open, and which motion is that of the contact; any finite-element program writes these.
"""

from itertools import pairwise

import fretflow as ff
import numpy as np

YOUNG, DENSITY, WIDTH, HALF = 2e11, 7850.0, 25.4e-3, 6.35e-3  # SI; each half is 6.35 mm thick in the lap
LENGTH, LAP, POINTS, ELEMENTS = 0.72, (0.30, 0.42), 25, 10


def element(length, thickness, offset):
    """Return K and M (6, 6) of a beam whose axis lies `offset` beside its nodes (axial, across, slope)."""
    area, inertia, a = WIDTH * thickness, WIDTH * thickness**3 / 12.0, length
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    axial, bent = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    k[axial] = YOUNG * area / a * np.array([[1, -1], [-1, 1]])
    m[axial] = DENSITY * area * a / 6.0 * np.array([[2, 1], [1, 2]])
    k[bent] = YOUNG * inertia / a**3 * np.array(
        [[12, 6 * a, -12, 6 * a], [6 * a, 4 * a * a, -6 * a, 2 * a * a],
         [-12, -6 * a, 12, -6 * a], [6 * a, 2 * a * a, -6 * a, 4 * a * a]])
    m[bent] = DENSITY * area * a / 420.0 * np.array(
        [[156, 22 * a, 54, -13 * a], [22 * a, 4 * a * a, 13 * a, -3 * a * a],
         [54, 13 * a, 156, -22 * a], [-13 * a, -3 * a * a, -22 * a, 4 * a * a]])
    shift = np.eye(6)
    shift[0, 2] = shift[3, 5] = -offset
    return shift.T @ k @ shift, shift.T @ m @ shift


# %%
# Both halves, from the contact plane: below it the left one, above it the right one. Across the beam nothing moves
# here; light nodes on springs stand for that direction.

places = np.linspace(*LAP, POINTS)
sides = (np.r_[np.linspace(0.0, LAP[0], ELEMENTS + 1), places[1:]],
         np.r_[places, np.linspace(LAP[1], LENGTH, ELEMENTS + 1)[1:]])
plane = 3 * sum(map(len, sides))
size = plane + 2 * POINTS
K, M, first = np.zeros((size, size)), np.zeros((size, size)), 0
for side, sign in zip(sides, (-1.0, 1.0), strict=True):
    for e, (left, right) in enumerate(pairwise(side)):
        lapped = left > LAP[0] - 1e-9 and right < LAP[1] + 1e-9
        k, m = element(right - left, HALF if lapped else 2.0 * HALF, 0.5 * sign * HALF if lapped else 0.0)
        at = np.s_[first + 3 * e:first + 3 * e + 6]
        K[at, at] += k
        M[at, at] += m
    first += 3 * len(side)
across = plane + np.arange(2 * POINTS)
K[across, across], M[across, across] = 1e7, 1e-3

# %%
# The contact: at each point the relative displacement along the beam, across it, and normal to the lap, positive when
# it opens. The bolts press with bells of force, as washers and bodies spread it.

lower = 3 * (ELEMENTS + np.arange(POINTS))
upper = 3 * (len(sides[0]) + np.arange(POINTS))
contact, row = np.zeros((3 * POINTS, size)), 3 * np.arange(POINTS)
contact[row, upper], contact[row, lower] = 1.0, -1.0
contact[row + 1, across[POINTS:]], contact[row + 1, across[:POINTS]] = 1.0, -1.0
contact[row + 2, upper + 1], contact[row + 2, lower + 1] = 1.0, -1.0

bells = sum(np.exp(-(((places - LAP[0]) / (LAP[1] - LAP[0]) - bolt) / 0.12) ** 2) for bolt in (0.25, 0.5, 0.75))
preload = np.zeros(size)  # per newton of a bolt's load
preload[lower + 1], preload[upper + 1] = 3.0 * bells / bells.sum(), -3.0 * bells / bells.sum()

tip = np.zeros(size)
tip[1] = 1.0
beam = ff.StructureMatrices(
    mass=M, stiffness=K, contact_map=contact, areas=np.full(POINTS, WIDTH * (LAP[1] - LAP[0]) / POINTS),
    points=np.c_[places, np.zeros(POINTS), np.zeros(POINTS)], preload=preload, inputs={"tip": tip},
    outputs={"tip": tip})
print(f"{beam.size} DOF, {beam.contacts} contact points")

# %%
# Reduced to its contact and a few modes, tightened, and with friction: its first linear modes, about the preload.

reduced = ff.reduce_structure(beam)
asperities = np.full(3 * POINTS, 2e-9)  # m/N, springs in series with each point, so that many share what slides
joints = {load: ff.BoltedJoint(structure=reduced, law=ff.Coulomb(0.4), bolt_load=load, springs=asperities)
          for load in (4e3, 8e3)}
for load, joint in joints.items():
    print(f"bolts at {1e-3 * load:.0f} kN:", *(f"{mode.frequency:.1f} Hz" for mode in joint.linear_modes(2)))

# %%
# Frequency and damping of the first bending mode over its amplitude, from static loads in its shape
# (:doc:`theory </theory/nonlinear_modes>`). Tighter bolts slip later: higher frequency, less damping.

import matplotlib.pyplot as plt

figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5.5), sharex=True, layout="constrained")
for load, joint in joints.items():
    mode = joint.linear_modes(1)[0]
    backbone = ff.quasi_static_backbone(joint, mode, np.geomspace(5e-6, 6e-5, 12) * load / 8e3)
    swing = 1e6 * np.abs(backbone.outputs[:, 0])
    above.semilogx(swing, backbone.frequency, "o-", label=f"{1e-3 * load:.0f} kN a bolt")
    below.semilogx(swing, 100.0 * backbone.friction_damping, "o-")
above.set(ylabel="frequency in Hz")
below.set(xlabel="amplitude of the beam's end in µm", ylabel="damping ratio of the joint in %")
below.set_xticks((5, 10, 20, 50), (5, 10, 20, 50))
above.legend()
plt.show()
