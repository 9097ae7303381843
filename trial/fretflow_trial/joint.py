"""Both specimens at their contact: nodes, areas and the relative compliance in sliding and normal direction.

The forces across the sliding direction are left out: the faces are free of friction there. They matter while the
faces stick, by Poisson's effect, and vanish as soon as they slide.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from fretflow_trial.elasticity import FILE

Array = NDArray[np.float64]

YOUNGS_MODULUS = 193e9
DENSITY = 8000.0
CONTACT_AREA = 1e-6  # m^2
SPECIMEN_MASS = DENSITY * (6.0 * 6.0 * 5.0 + 6.0 * 1.0 * 1.0) * 1e-9  # kg, body and ridge
RIGID_SPRINGS = 4e15  # N/m^3, asperities that hardly yield


@dataclass(frozen=True)
class Joint:
    """Compliance blocks in m/N; displacement is upper minus lower, force that on the upper specimen."""

    nodes: Array  # (n, 2), m
    areas: Array  # (n,), m^2
    sliding: Array  # (n, n)
    normal: Array  # (n, n)
    cross: Array  # (n, n), sliding displacement by normal force

    @property
    def size(self) -> int:
        """Return the number of contact nodes."""
        return len(self.areas)

    @cached_property
    def share(self) -> Array:
        """Return each node's share of the area, (n,)."""
        return np.asarray(self.areas / self.areas.sum())


def node_areas(nodes: Array) -> Array:
    """Return the area of each node of the quadrature of order 3 on two elements a side, (n,) m^2."""
    line = np.unique(np.round(nodes[:, 0], 12))
    element = np.array([1.0, 5.0, 5.0, 1.0]) / 12.0 * 0.5 * (line[-1] - line[0])
    weights = np.concatenate([element[:3], [2.0 * element[0]], element[1:]])
    place = [np.argmin(np.abs(line[:, None] - nodes[:, k]), axis=0) for k in (0, 1)]
    return np.asarray(weights[place[0]] * weights[place[1]])


@cache
def specimens(youngs_modulus: float = YOUNGS_MODULUS) -> Joint:
    """Return the joint of two equal specimens, the lower one turned by 90 degrees."""
    with np.load(FILE) as stored:
        nodes, triangle = stored["nodes"], stored["compliance"]
    n = len(nodes)
    upper = np.zeros((3 * n, 3 * n))
    upper[np.triu_indices(3 * n)] = triangle / youngs_modulus
    upper = np.triu(upper) + np.triu(upper, 1).T
    # The lower specimen is the upper one seen in the mirrors x = y and z = 0.
    partner = np.array([np.argmin(np.hypot(*(nodes - place[::-1]).T)) for place in nodes])
    mirror = np.zeros((3 * n, 3 * n))
    for i, j in enumerate(partner):
        mirror[3 * i, 3 * j + 1] = mirror[3 * i + 1, 3 * j] = 1.0
        mirror[3 * i + 2, 3 * j + 2] = -1.0
    both = upper + mirror @ upper @ mirror.T
    return Joint(nodes, node_areas(nodes), both[0::3, 0::3], both[2::3, 2::3], both[0::3, 2::3])
