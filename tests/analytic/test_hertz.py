"""A crowned face pressed on a flat block, against Hertz.

What carries the weight: contact radius and peak pressure within 5 % on the finest mesh, both errors falling with
refinement. The block is 4 mm wide and deep under a contact of 0.35 mm radius, so nearly a half-space.
"""

import dolfinx
import numpy as np
import pytest
from fretflow.case.config import Specimen
from fretflow.structure.fem.elasticity import assemble
from fretflow.structure.fem.mesh_file import TaggedMesh
from fretflow.structure.fem.preload import frictionless_preload
from fretflow.structure.reduction.modes import component_modes
from fretflow.structure.reduction.reduced_specimen import OBSERVATION_DOFS, RIGID_DOFS
from mpi4py import MPI

pytestmark = pytest.mark.fem

SIZE, PATCH, RADIUS = 4e-3, 1e-3, 10e-3
MODULUS = 193e9 / (1 - 0.29**2)
CONTACT_RADIUS = 0.35e-3
LOAD = 4 * MODULUS * CONTACT_RADIUS**3 / (3 * RADIUS)  # Hertz
PEAK = 3 * LOAD / (2 * np.pi * CONTACT_RADIUS**2)
STEEL = Specimen(youngs_modulus="193 GPa", poissons_ratio=0.29)


def graded(start, end, count):
    """Return `count` positions after `start` up to `end`, each step half as long again as the one before."""
    steps = np.cumsum(1.6 ** np.arange(count))
    return start + steps / steps[-1] * (end - start)


def block(cells):
    """Return a block z <= 0 with `cells` elements a side of the contact patch about the origin, on top."""
    outside = graded(PATCH / 2, SIZE / 2, 4)
    lateral = np.concatenate([-outside[::-1], np.linspace(-PATCH / 2, PATCH / 2, cells + 1), outside])
    depth = np.concatenate([np.linspace(0.0, PATCH / 2, cells // 2 + 1), graded(PATCH / 2, SIZE, 5)])
    axes = [lateral, lateral, -depth[::-1]]
    counts = [len(a) - 1 for a in axes]
    domain = dolfinx.mesh.create_box(MPI.COMM_WORLD, [np.zeros(3), np.array(counts, dtype=float)], counts,
                                     dolfinx.mesh.CellType.hexahedron)
    for i, axis in enumerate(axes):
        domain.geometry.x[:, i] = axis[np.rint(domain.geometry.x[:, i]).astype(int)]
    inside = PATCH / 2 * (1 + 1e-9)
    ends = [dolfinx.mesh.locate_entities_boundary(domain, 2, where) for where in (
        lambda x: (np.abs(x[2]) < 1e-9) & (np.abs(x[0]) < inside) & (np.abs(x[1]) < inside),
        lambda x: np.abs(x[2] + SIZE) < 1e-9)]
    facets = np.concatenate(ends)
    values = np.repeat([1, 2], [len(e) for e in ends]).astype(np.int32)
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(domain, 2, facets[order], values[order])
    return assemble(TaggedMesh(MPI.COMM_WORLD, domain, tags, 1, 2, "block"), STEEL, 1)


def pressed(cells):
    """Return the nodes (n, 3) of the patch and the preload of a rigid crowned face on the block."""
    body = block(cells)
    observation, _ = body.nearest_inner_node(np.array([0.0, 0.0, -SIZE / 2]))
    stiffness = component_modes(body, observation, 1).constraint_stiffness
    body.destroy()
    n = 3 * len(body.contact.nodes)
    free = np.append(np.arange(n), n + RIGID_DOFS + np.arange(OBSERVATION_DOFS))
    flexibility = np.linalg.inv(stiffness[np.ix_(free, free)])[2:n:3, 2:n:3]
    profile = np.sum(body.contact.points[:, :2] ** 2, axis=1) / (2 * RADIUS)
    return body.contact.points, frictionless_preload(flexibility, profile, body.contact.areas, LOAD)


@pytest.fixture(scope="module")
def errors():
    """Return the relative errors of contact radius and peak pressure at 4, 8 and 16 elements a side."""
    pairs = []
    for cells in (4, 8, 16):
        points, contact = pressed(cells)
        # For Hertz' half-ellipsoid of pressure, the mean of r^2 weighted with force is 2 a^2 / 5.
        radius = np.sqrt(2.5 * contact.force @ np.sum(points[:, :2] ** 2, axis=1) / LOAD)
        pairs.append((radius / CONTACT_RADIUS - 1.0, contact.pressure.max() / PEAK - 1.0))
    return np.abs(np.array(pairs))


def test_contact_radius_and_peak_pressure_are_those_of_hertz(errors):
    assert np.all(errors[-1] < 0.05)


def test_errors_fall_with_refinement(errors):
    assert np.all(errors[1:] < 0.6 * errors[:-1])
