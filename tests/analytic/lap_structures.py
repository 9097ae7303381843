"""Small structures with friction joints that tests share: parallel sliders, and a lap of two beams."""

from __future__ import annotations

import numpy as np
from fretflow.structure.matrices import StructureMatrices

BACKBONE = """
format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
matrices = "structure.npz"
[structure.unknown]
bolt_load = [{bolts}]
modal_damping = [1e-4, 1e-2]
friction_coefficient = [0.2, 1.2]
[backbone]
file = "backbone.csv"
amplitude_of = "{of}"
amplitude = {{ column = "a", unit = "um" }}
frequency = {{ column = "f", unit = "Hz" }}
damping = {{ column = "zeta", unit = "%" }}
"""


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


def newmark(mass, ground, stiffness, limits, amplitude, step, count, damper=0.0):
    """Return the decay of a mass on a spring and Jenkins sliders, by the average acceleration and their own mapping."""
    x, v, anchored = amplitude, 0.0, np.zeros(len(stiffness))
    positions = np.zeros(count)

    def forces(x, anchored):
        stretch = np.clip(x - anchored, -limits / stiffness, limits / stiffness)
        return float(stiffness @ stretch) + ground * x, x - stretch

    force, anchored = forces(x, anchored)
    a = -force / mass
    for k in range(count):
        positions[k] = x
        ahead = x + step * v + 0.25 * step**2 * a
        after = ahead
        for _ in range(6):  # a contraction by step^2 k / (4 m), some 1e-4
            speed = 2.0 / step * (after - x) - v
            after = ahead - 0.25 * step**2 * (forces(after, anchored)[0] + damper * speed) / mass
        force, anchored = forces(after, anchored)
        speed = 2.0 / step * (after - x) - v
        v, x, a = speed, after, -(force + damper * speed) / mass
    return positions


class Jenkins:
    """Springs with sliders behind them, m points: the contact of `decay_in_time`, x, y and z of each in turn."""

    def __init__(self, tangential, normal, friction):
        self.tangential, self.normal, self.friction = tangential, normal, friction
        self.slid = np.zeros((len(tangential), 2))

    def force(self, u):
        """Return forces (3 m,) on the upper faces, and where sliders are then, at relative displacements u (3 m,)."""
        u = u.reshape(-1, 3)
        pressing = self.normal * np.maximum(-u[:, 2], 0.0)
        trial = -self.tangential[:, None] * (u[:, :2] - self.slid)
        size = np.maximum(np.hypot(*trial.T), 1e-300)
        held = trial * np.minimum(1.0, self.friction * pressing / size)[:, None]
        return np.column_stack([held, pressing]).ravel(), u[:, :2] + held / self.tangential[:, None]

    def slope(self, u):
        """Return the derivative (3 m, 3 m) of the force."""
        at = u.reshape(-1, 3)
        closed = at[:, 2] < 0.0
        trial = -self.tangential[:, None] * (at[:, :2] - self.slid)
        size = np.maximum(np.hypot(*trial.T), 1e-300)
        slides = size > self.friction * self.normal * np.maximum(-at[:, 2], 0.0)
        derivative = np.zeros((u.size, u.size))
        for j in range(len(at)):
            x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
            if not closed[j]:
                continue
            derivative[z, z] = -self.normal[j]
            if slides[j]:
                way, limit = trial[j] / size[j], -self.friction * self.normal[j] * at[j, 2]
                derivative[x:z, z] = -self.friction * self.normal[j] * way
                derivative[x:z, x:z] = -self.tangential[j] * limit / size[j] * (np.eye(2) - np.outer(way, way))
            else:
                derivative[x, x] = derivative[y, y] = -self.tangential[j]
        return derivative


def _balance(jenkins, flexibility, free, guess):
    """Return u with ``u = free + flexibility f(u)`` by Newton, halved where it goes astray."""
    u = guess
    for _ in range(200):
        force, slid = jenkins.force(u)
        left = u - free - flexibility @ force
        if np.abs(left).max() < 1e-7 * max(np.abs(u).max(), 1e-12):
            return u, force, slid
        step = np.linalg.solve(np.eye(len(u)) - flexibility @ jenkins.slope(u), left)
        size = np.abs(left).max()
        for share in 0.5**np.arange(12):
            ahead = u - share * step
            if np.abs(ahead - free - flexibility @ jenkins.force(ahead)[0]).max() < size:
                break
        u = ahead
    raise RuntimeError(f"no balance: {np.abs(left).max():.1e} of {np.abs(u).max():.1e}")


def decay_in_time(matrices, modes, springs, friction, bolt_load, damping, amplitude, periods, steps=100):
    """Return time (N,) and the motion (N,) of the first output: average acceleration, all masses, Jenkins springs.

    Nothing of the package but the change of coordinates to (u, eta): `springs` is the normal stiffness (m,) in N/m of
    each contact point, the tangential one is that over 1.2; it is struck in the shape of the first mode about
    the preload, to so many m kg^0.5.
    """
    from fretflow.structure.reduction.contact_modes import assembled, reduce_structure
    from scipy.linalg import eigh

    reduced = reduce_structure(matrices, modes)
    k, m = assembled(reduced)
    b = len(reduced.stiffness)
    jenkins = Jenkins(springs / 1.2, springs, friction)
    load = np.zeros(len(k))
    load[:b] = bolt_load * reduced.preload[0]
    # tightened: a soft ground keeps the flexibility finite, and is iterated away
    soft = 1e-6 * np.abs(np.diag(k)[:b]).max()
    flexibility, u, force = np.linalg.inv(k[:b, :b] + soft * np.eye(b)), np.zeros(b), np.zeros(b)
    u[2::3] = -1e-9
    for _ in range(400):
        before = u
        u, force, slid = _balance(jenkins, flexibility, flexibility @ (load[:b] + soft * u), u)
        if np.abs(u - before).max() < 1e-10 * np.abs(u).max():
            break
    jenkins.slid = slid
    stuck = k.copy()
    stuck[:b, :b] -= jenkins.slope(u)
    values, shapes = eigh(stuck, m, subset_by_index=[0, 0])
    omega, shape = float(np.sqrt(values[0])), shapes[:, 0]
    step = 2.0 * np.pi / (omega * steps)
    c = 2.0 * damping / omega * k  # stiffness-proportional: the ratio at the first mode
    rest = np.r_[u, np.zeros(len(k) - b)]
    x, v, a = rest, amplitude * omega * shape, np.zeros(len(k))  # struck while in balance, so that nothing rattles
    row = np.concatenate(next(iter(reduced.outputs.values())))
    inverse = np.linalg.inv(k + (4.0 / step**2) * m + (2.0 / step) * c)
    seen = np.zeros(int(periods * steps))
    for n in range(len(seen)):
        seen[n] = row @ (x - rest)
        free = inverse @ (load + m @ (4.0 / step**2 * x + 4.0 / step * v + a) + c @ (2.0 / step * x + v))
        u, force, jenkins.slid = _balance(jenkins, inverse[:b, :b], free[:b], x[:b] + step * v[:b])
        after = free + inverse[:, :b] @ force
        new = 4.0 / step**2 * (after - x) - 4.0 / step * v - a
        x, v, a = after, v + 0.5 * step * (a + new), new
    return step * np.arange(len(seen)), seen, omega / (2.0 * np.pi)


def write_backbone(folder, matrices, table, bolts, of):
    """Write a recording of matrices and of amplitude, frequency and damping (P, 3) of an output, in um, Hz and %."""
    np.savez(folder / "structure.npz", M=matrices.mass, K=matrices.stiffness, contact_map=matrices.contact_map,
             areas=matrices.areas, points=matrices.points, preload=matrices.preload,
             **{f"outputs/{name}": row for name, row in matrices.outputs.items()})
    np.savetxt(folder / "backbone.csv", table, delimiter=",", header="a,f,zeta", comments="")
    (folder / "recording.toml").write_text(BACKBONE.format(bolts=bolts, of=of))
