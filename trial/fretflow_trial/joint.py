"""Both specimens at their contact: nodes, areas and the relative compliance in sliding and normal direction.

The forces across the sliding direction are left out: the faces are free of friction there. They matter while the
faces stick, by Poisson's effect, and vanish as soon as they slide.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from fretflow_trial.elasticity import FILE, MM, ORDER, POISSONS_RATIO, lobatto, specimen_compliance

Array = NDArray[np.float64]

YOUNGS_MODULUS = 193e9
DENSITY = 8000.0
RIGID_SPRINGS = 4e15  # N/m^3, asperities that hardly yield


@dataclass(frozen=True)
class Specimen:
    """What the drawing of both specimens says: a square body with a ridge across it, SI."""

    youngs_modulus: float = YOUNGS_MODULUS
    poissons_ratio: float = POISSONS_RATIO
    contact_width: float = 1e-3
    ridge_height: float = 1e-3
    body_width: float = 6e-3
    body_height: float = 5e-3

    @property
    def mass(self) -> float:
        """Return the mass of body and ridge in kg."""
        ridge = self.body_width * self.contact_width * self.ridge_height
        return DENSITY * (self.body_width**2 * self.body_height + ridge)


STANDARD = Specimen()


@dataclass(frozen=True)
class Joint:
    """Compliance blocks in m/N; displacement is upper minus lower, force that on the upper specimen."""

    nodes: Array  # (n, 2), m
    areas: Array  # (n,), m^2
    sliding: Array  # (n, n)
    normal: Array  # (n, n)
    cross: Array  # (n, n), sliding displacement by normal force
    specimen: Specimen = STANDARD

    @property
    def size(self) -> int:
        """Return the number of contact nodes."""
        return len(self.areas)

    @property
    def half(self) -> float:
        """Return half the width of the contact, m."""
        return 0.5 * self.specimen.contact_width

    @cached_property
    def share(self) -> Array:
        """Return each node's share of the area, (n,)."""
        return np.asarray(self.areas / self.areas.sum())


def node_areas(nodes: Array) -> Array:
    """Return the area of each node of the quadrature of order 3 on whole elements a side, (n,) m^2."""
    line = np.unique(np.round(nodes[:, 0], 12))
    ends, weights = np.arange(0, len(line), ORDER), np.zeros(len(line))
    for first, last in itertools.pairwise(ends):
        weights[first:last + 1] += lobatto()[1] * 0.5 * (line[last] - line[first])
    place = [np.argmin(np.abs(line[:, None] - nodes[:, k]), axis=0) for k in (0, 1)]
    return np.asarray(weights[place[0]] * weights[place[1]])


@cache
def specimens() -> Joint:
    """Return the joint of the specimens whose compliance is stored."""
    with np.load(FILE) as stored:
        nodes, triangle = stored["nodes"], stored["compliance"]
    upper = np.zeros((3 * len(nodes), 3 * len(nodes)))
    upper[np.triu_indices(len(upper))] = triangle / YOUNGS_MODULUS
    return crossed(nodes, np.triu(upper) + np.triu(upper, 1).T, STANDARD)


def meshed(specimen: Specimen, inside: Sequence[float], outside: Sequence[float], upwards: Sequence[float]) -> Joint:
    """Return the joint of specimens on a spectral mesh of their own.

    Parameters
    ----------
    specimen : Specimen
    inside : sequence of float
        Boundaries of elements between the contact's edges, -1 and 1, as shares of its half width.
    outside : sequence of float
        Boundaries between the contact's edge (0) and the body's (1), as shares.
    upwards : sequence of float
        Boundaries between the ridge's root (0) and the clamped top (1), as shares.
    """
    half, beyond = 0.5 * specimen.contact_width, 0.5 * (specimen.body_width - specimen.contact_width)
    out = half + beyond * np.array([*outside, 1.0])
    line = np.concatenate([-out[::-1], half * np.array([-1.0, *inside, 1.0]), out]) / MM
    ridge, body = specimen.ridge_height, specimen.body_height
    rise = np.array([0.0, 0.4 * ridge, *(ridge + body * np.array([0.0, *upwards, 1.0]))]) / MM
    nodes, compliance = specimen_compliance(tuple(line), tuple(line), tuple(rise), specimen.poissons_ratio, half, ridge)
    return crossed(nodes, compliance / specimen.youngs_modulus, specimen)


def crossed(nodes: Array, upper: Array, specimen: Specimen) -> Joint:
    """Return the joint of two equal specimens, the lower one turned by 90 degrees."""
    n = len(nodes)
    # The lower specimen is the upper one seen in the mirrors x = y and z = 0.
    partner = np.array([np.argmin(np.hypot(*(nodes - place[::-1]).T)) for place in nodes])
    mirror = np.zeros((3 * n, 3 * n))
    for i, j in enumerate(partner):
        mirror[3 * i, 3 * j + 1] = mirror[3 * i + 1, 3 * j] = 1.0
        mirror[3 * i + 2, 3 * j + 2] = -1.0
    both = upper + mirror @ upper @ mirror.T
    return Joint(nodes, node_areas(nodes), both[0::3, 0::3], both[2::3, 2::3], both[0::3, 2::3], specimen)


def rigid_modes(nodes: Array) -> Array:
    """Return sliding and normal displacement (2 n, 4) by unit sliding, approach and tilt (per m) about both axes."""
    one, none = np.ones(len(nodes)), np.zeros(len(nodes))
    return np.vstack([np.stack([one, none, none, none], axis=1), np.stack([none, one, *nodes.T], axis=1)])


def half_spaces(like: Joint, patches: int) -> Joint:
    """Return elastic half-spaces under `patches` squares a side, on bodies that yield as a whole as those of `like`.

    What the bodies yield beyond half-spaces, as rigid faces do, is added.
    """
    nodes, sliding, normal = half_space_compliance(like.specimen, patches)
    none = np.zeros_like(normal)
    local, modes = np.block([[sliding, none], [none, normal]]), rigid_modes(nodes)
    whole = np.block([[like.sliding, like.cross], [like.cross.T, like.normal]])
    body = _as_rigid(whole, rigid_modes(like.nodes)) - _as_rigid(local, modes)
    both, n = local + modes @ body @ modes.T, len(nodes)
    return Joint(nodes, np.full(n, like.areas.sum() / n), both[:n, :n], both[n:, n:], both[:n, n:], like.specimen)


def half_space_compliance(specimen: Specimen, patches: int) -> tuple[Array, Array, Array]:
    """Return the middles (n, 2) in m of squares and how two half-spaces yield there, sliding and normal (n, n) in m/N.

    The surface displacement at the middle of a square by uniform traction on another is A. E. H. Love's (Phil. Trans.
    R. Soc. A 228 (1929) 377-420) and, in sliding, that of V. Cerruti's kernel integrated alike (K. L. Johnson, Contact
    Mechanics (1985), sections 3.2 and 3.6).
    """
    width = specimen.contact_width / patches
    line = width * (np.arange(patches) - 0.5 * (patches - 1))
    nodes = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    apart = nodes[:, None, :] - nodes[None, :, :]
    along = across = np.zeros(apart.shape[:2])
    for sx, sy in itertools.product((-1.0, 1.0), repeat=2):
        x, y = apart[..., 0] + 0.5 * sx * width, apart[..., 1] + 0.5 * sy * width
        r = np.hypot(x, y)
        along, across = along + sx * sy * y * np.log(x + r), across + sx * sy * x * np.log(y + r)
    poisson, area = specimen.poissons_ratio, width**2
    soft = 2.0 * (1.0 + poisson) / (np.pi * specimen.youngs_modulus * area)  # of both bodies, by force
    normal = soft * (1.0 - poisson) * (along + across)
    return nodes, soft * (along + (1.0 - poisson) * across), normal


def _as_rigid(compliance: Array, modes: Array) -> Array:
    # how the faces yield where they move as rigid ones
    return np.asarray(np.linalg.inv(modes.T @ np.linalg.solve(compliance, modes)))
