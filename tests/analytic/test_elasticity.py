"""Elastic operators on distorted bricks.

What carries the weight: the patch test (a linear displacement is found exactly on a distorted mesh) and
rigid motions without force; they hold only if shape functions, quadrature, numbering and law are all right.
"""

import dolfinx
import numpy as np
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from fretflow.case.config import Specimen
from fretflow.structure.fem.elasticity import assemble, sorted_by_position
from fretflow.structure.fem.mesh_file import TaggedMesh
from mpi4py import MPI

pytestmark = pytest.mark.fem

LENGTHS = np.array([2e-3, 1e-3, 1.5e-3])
STEEL = Specimen(youngs_modulus="193 GPa", poissons_ratio=0.29, density="8000 kg/m^3")
VOLUME = LENGTHS.prod()


def distorted_block():
    """Return a block whose inner nodes are moved; its ends z = 0 (contact) and z = top (clamped) stay flat."""
    domain = dolfinx.mesh.create_box(MPI.COMM_WORLD, [np.zeros(3), LENGTHS], [4, 3, 3],
                                     dolfinx.mesh.CellType.hexahedron)
    marked = [dolfinx.mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
              for z in (0.0, LENGTHS[2])]
    facets = np.concatenate(marked)
    values = np.repeat([1, 2], [len(m) for m in marked]).astype(np.int32)
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(domain, 2, facets[order], values[order])
    x = domain.geometry.x
    inside = np.all((x > 1e-9) & (x < LENGTHS - 1e-9), axis=1)
    x[inside] += np.random.default_rng(3).uniform(-0.12, 0.12, (inside.sum(), 3)) * LENGTHS / [4, 3, 3]
    return TaggedMesh(MPI.COMM_WORLD, domain, tags, 1, 2, "block")


@pytest.fixture(scope="module", params=[1, 2], ids=["degree1", "degree2"])
def body(request):
    body = assemble(distorted_block(), STEEL, request.param)
    yield body
    body.destroy()


def csr(matrix):
    indptr, indices, data = matrix.getValuesCSR()
    return sparse.csr_matrix((data, indices, indptr), shape=matrix.getSize())


def test_matrices_are_symmetric(body):
    for matrix in (csr(body.stiffness), csr(body.mass)):
        assert abs(matrix - matrix.T).max() < 1e-14 * abs(matrix).max()


def test_patch_test_finds_a_constant_strain_exactly(body):
    stiffness = csr(body.stiffness)
    gradient = np.array([[3.0, -1.0, 2.0], [0.5, 1.0, -4.0], [2.5, 1.5, -2.0]]) * 1e-4
    exact = (body.points @ gradient.T).ravel()
    boundary = np.any((body.points < 1e-9) | (body.points > LENGTHS - 1e-9), axis=1)
    fixed = np.repeat(boundary, 3)
    free = ~fixed
    displacement = sparse_linalg.spsolve(stiffness[free][:, free].tocsc(), -stiffness[free][:, fixed] @ exact[fixed])
    assert np.abs(displacement - exact[free]).max() < 1e-12 * np.abs(exact).max()
    strain = 0.5 * (gradient + gradient.T)
    shear, lame = 193e9 / (2 * 1.29), 193e9 * 0.29 / (1.29 * 0.42)
    energy = VOLUME * (shear * np.sum(strain**2) + 0.5 * lame * np.trace(strain) ** 2)
    assert 0.5 * exact @ stiffness @ exact == pytest.approx(energy, rel=1e-12)


def test_six_rigid_motions_and_no_more_are_without_energy(body):
    stiffness = csr(body.stiffness)
    x, y, z = (body.points - LENGTHS / 2).T / LENGTHS.max()
    o, i = np.zeros_like(x), np.ones_like(x)
    fields = [(i, o, o), (o, i, o), (o, o, i), (o, -z, y), (z, o, -x), (-y, x, o)]
    motions = np.stack([np.stack(f, axis=1).ravel() for f in fields], axis=1)
    force = np.abs(stiffness @ motions).max()
    assert force < 1e-13 * abs(stiffness).max() * np.abs(motions).max() * 81
    squares = sparse_linalg.eigsh(stiffness, 7, sigma=-1e-6 * abs(stiffness).max(), return_eigenvectors=False)
    squares = np.sort(np.abs(squares))
    assert squares[5] < 1e-10 * squares[6]


def test_mass_is_that_of_the_block_and_moves_with_its_inertia(body):
    assert body.total_mass == pytest.approx(8000.0 * VOLUME, rel=1e-13)
    mass = csr(body.mass)
    spin = np.cross([0.0, 0.0, 1.0], body.points - LENGTHS / 2).ravel()
    inertia = 8000.0 * VOLUME * (LENGTHS[0] ** 2 + LENGTHS[1] ** 2) / 12
    # Cubic Jacobians of the distorted bricks are integrated inexactly by the two points of degree 1.
    assert spin @ mass @ spin == pytest.approx(inertia, rel=2e-4)


def test_contact_areas_follow_the_shape_functions(body):
    contact = body.contact
    assert contact.areas.sum() == pytest.approx(LENGTHS[0] * LENGTHS[1], rel=1e-13)
    assert body.contact.centroid == pytest.approx([1e-3, 0.5e-3, 0.0], abs=1e-15)
    element = LENGTHS[0] * LENGTHS[1] / 12
    corner, edge, inside = (1 / 4, 1 / 2, 1) if len(contact.areas) == 20 else (1 / 36, 4 / 36, 16 / 36)
    assert contact.areas[0] == pytest.approx(corner * element, rel=1e-12)
    assert contact.areas[1] == pytest.approx(edge * element, rel=1e-12)
    assert contact.areas.max() == pytest.approx(inside * element, rel=1e-12)


def test_contact_nodes_are_sorted_by_x_then_y(body):
    x, y, z = body.contact.points.T
    assert np.all(np.abs(z) < 1e-15)
    steps = np.diff(x)
    assert np.all((steps > 1e-9) | ((np.abs(steps) < 1e-9) & (np.diff(y) > 1e-9)))


def test_sorting_ignores_round_off():
    grid = np.array([(i, j, 0.0) for i in range(5) for j in range(5)]) / 7.0
    shuffled = np.random.default_rng(1).permutation(25)
    noisy = grid[shuffled] + np.random.default_rng(2).uniform(-1e-13, 1e-13, (25, 3))
    assert np.array_equal(shuffled[sorted_by_position(noisy)], np.arange(25))


def test_nearest_inner_node_is_on_neither_face(body):
    node, point = body.nearest_inner_node(np.array([0.0, 0.0, -1.0]))
    assert node not in body.contact.nodes
    assert point[2] > 1e-9
    assert np.array_equal(point, body.points[node])
