"""Small structures with friction joints that tests share: parallel sliders, and a lap of two beams."""

from __future__ import annotations

import numpy as np
from fretflow.structure.matrices import StructureMatrices


def sliders(stiffness, limits, mass=2.0, ground=3e4):
    """Return a mass on a spring and N sliders beside it; under a bolt load of 1 with mu = 1 they slip at `limits` (N,).

    Each slider is a massless node on a spring of `stiffness` (N,) to the mass, touching the ground.
    """
    count = len(limits)
    n = 1 + 3 * count
    m, k = np.zeros((n, n)), np.zeros((n, n))
    m[0, 0], k[0, 0] = mass, ground + np.sum(stiffness)
    contact, preload = np.zeros((3 * count, n)), np.zeros(n)
    for j, spring in enumerate(stiffness):
        x, y, z = 1 + 3 * j, 2 + 3 * j, 3 + 3 * j
        k[x, x], k[0, x], k[x, 0] = spring, -spring, -spring
        k[y, y] = k[z, z] = spring
        contact[3 * j:3 * j + 3, x:x + 3] = np.eye(3)
        preload[z] = -limits[j]
    head = np.zeros(n)
    head[0] = 1.0
    return StructureMatrices(mass=m, stiffness=k, contact_map=contact, areas=np.full(count, 1e-6),
                             points=np.zeros((count, 3)), preload=preload, outputs={"head": head},
                             inputs={"head": head})


YOUNG, DENSITY, WIDTH, HALF = 2e11, 7850.0, 25.4e-3, 6.35e-3  # of the beam, SI
LENGTH, LAP = 0.72, (0.30, 0.42)


def lap_beam(points=25, elements=10):
    """Return the two halves of a lapped beam, free in space: axial and bending Bernoulli elements, M and K (n, n).

    Its mid plane is that of the contact; in the lap each half is as thick as `HALF` and lies beside it. Three bolts
    press with bells of force, as washers and bodies spread it.
    """
    lap = np.linspace(*LAP, points)
    sides = (np.r_[np.linspace(0.0, LAP[0], elements + 1), lap[1:]],
             np.r_[lap, np.linspace(LAP[1], LENGTH, elements + 1)[1:]])
    plane, lateral = 3 * sum(map(len, sides)), 2 * points
    n = plane + lateral
    k, m = np.zeros((n, n)), np.zeros((n, n))
    first = 0
    for side, sign in zip(sides, (-1.0, 1.0), strict=True):
        for e in range(len(side) - 1):
            inside = side[e] > LAP[0] - 1e-9 and side[e + 1] < LAP[1] + 1e-9
            own_k, own_m = _element(side[e + 1] - side[e], HALF if inside else 2.0 * HALF,
                                    0.5 * sign * HALF if inside else 0.0)
            at = np.s_[first + 3 * e:first + 3 * e + 6]
            k[at, at] += own_k
            m[at, at] += own_m
        first += 3 * len(side)
    lower, upper = 3 * (elements + np.arange(points)), 3 * (len(sides[0]) + np.arange(points))
    across = plane + np.arange(points)
    for dof in range(plane, n):  # across the beam nothing moves: light nodes on springs
        k[dof, dof], m[dof, dof] = 1e7, 1e-3
    contact, preload = np.zeros((3 * points, n)), np.zeros(n)
    row = 3 * np.arange(points)
    contact[row, upper], contact[row, lower] = 1.0, -1.0
    contact[row + 1, across + points], contact[row + 1, across] = 1.0, -1.0
    contact[row + 2, upper + 1], contact[row + 2, lower + 1] = 1.0, -1.0
    areas = np.full(points, WIDTH * (LAP[1] - LAP[0]) / (points - 1))
    areas[[0, -1]] *= 0.5
    share = areas * sum(np.exp(-((np.linspace(0.0, 1.0, points) - bolt) / 0.12)**2) for bolt in (0.25, 0.5, 0.75))
    share *= 3.0 / share.sum()
    preload[lower + 1], preload[upper + 1] = share, -share
    tip, end = np.zeros(n), np.zeros(n)
    tip[1], end[plane - 2] = 1.0, 1.0
    return StructureMatrices(
        mass=m, stiffness=k, contact_map=contact, areas=areas, points=np.c_[lap, np.zeros(points), np.zeros(points)],
        preload=preload, inputs={"tip": tip}, outputs={"tip": tip, "end": end})


def _element(length, thickness, offset):
    """Return K and M (6, 6) of a beam element whose axis lies `offset` beside the nodes (u, w, slope)."""
    area, bending = WIDTH * thickness, WIDTH * thickness**3 / 12.0
    a, weight = length, DENSITY * WIDTH * thickness * length
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    axial, bent = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    k[axial] = YOUNG * area / a * np.array([[1, -1], [-1, 1]])
    m[axial] = weight / 6.0 * np.array([[2, 1], [1, 2]])
    k[bent] = YOUNG * bending / a**3 * np.array([[12, 6 * a, -12, 6 * a], [6 * a, 4 * a * a, -6 * a, 2 * a * a],
                                                 [-12, -6 * a, 12, -6 * a], [6 * a, 2 * a * a, -6 * a, 4 * a * a]])
    m[bent] = weight / 420.0 * np.array([[156, 22 * a, 54, -13 * a], [22 * a, 4 * a * a, 13 * a, -3 * a * a],
                                         [54, 13 * a, 156, -22 * a], [-13 * a, -3 * a * a, -22 * a, 4 * a * a]])
    shift = np.eye(6)
    shift[0, 2] = shift[3, 5] = -offset
    return shift.T @ k @ shift, shift.T @ m @ shift
