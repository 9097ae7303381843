"""Volumes and areas against closed forms, integrated by gmsh from the written file, carry the weight.

They fail when a node is out of order, a face is in the wrong group or the two specimens are not crossed.
"""

from dataclasses import replace

import gmsh
import numpy as np
import pytest
from fretflow.case import config
from fretflow.core.files import CASE
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.core.store import read_record
from fretflow_meshes import run_mesh
from fretflow_meshes.gmsh_files import gmsh_session, read_mesh
from fretflow_meshes.hexmesh import specimen_mesh
from fretflow_meshes.quality import measure
from fretflow_meshes.specimen import Side, build_specimen, check_matching, mesh_geometry, sorted_nodes
from hypothesis import given, settings
from hypothesis import strategies as st


def specimen(**mm):
    """Make a specimen of lengths in mm."""
    return config.Specimen(**{k: f"{v} mm" if isinstance(v, float) else v for k, v in mm.items()})


def measures(path):
    """Return volume (mm3) and areas (mm2) of the groups 1, 2 and 3, by gmsh's own shape functions."""
    result = {}
    with gmsh_session(path):
        gmsh.merge(str(path))
        for dim, tag in gmsh.model.getPhysicalGroups():
            (kind,), *_ = gmsh.model.mesh.getElements(dim, tag)
            points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss6")
            _, determinants, _ = gmsh.model.mesh.getJacobians(kind, points, tag)
            assert determinants.min() > 0.0
            result[gmsh.model.getPhysicalName(dim, tag)] = (
                np.sum(determinants.reshape(-1, len(weights)) @ weights) * 1e3**dim)
    return result


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("side", list(Side))
def test_square_specimen_has_its_exact_volume_and_areas(tmp_path, degree, side):
    path = tmp_path / "a.msh"
    summary = build_specimen(specimen(body_width=5.0, body_height=4.0, contact_width=0.8, ridge_height=0.7),
                             config.Mesh(contact_elements=3, degree=degree), side, path)
    measured = measures(path)
    assert measured["body"] == pytest.approx(5.0 * 5.0 * 4.0 + 0.8 * 0.7 * 5.0, rel=1e-11)
    assert measured["contact"] == pytest.approx(0.8**2, rel=1e-11)
    assert measured["clamped"] == pytest.approx(5.0**2, rel=1e-11)
    assert summary.degree == degree
    assert len(summary.contact_nodes) == (3 * degree + 1) ** 2
    # Three layers divide the ridge; the smallest cells are those over the contact.
    assert summary.min_jacobian == pytest.approx((0.8e-3 / 3) ** 2 * 0.7e-3 / 3, rel=1e-10)
    assert summary.min_scaled_jacobian == pytest.approx(1.0, abs=1e-10)


def test_ridges_are_crossed_and_bodies_face_each_other(tmp_path):
    mesh, shape = config.Mesh(contact_elements=4), specimen(ridge_height=0.7)
    for side, along, across, sign in ((Side.UPPER, 0, 1, 1.0), (Side.LOWER, 1, 0, -1.0)):
        build_specimen(shape, mesh, side, tmp_path / "a.msh")
        points = read_mesh(tmp_path / "a.msh").points * 1e3
        height = sign * points[:, 2]
        assert height.min() == 0.0
        assert height.max() == pytest.approx(5.7)
        ridge = points[height < 0.69]
        assert np.ptp(ridge[:, along]) == pytest.approx(6.0)
        assert np.ptp(ridge[:, across]) == pytest.approx(1.0)
        assert np.any(np.abs(height - 0.7) < 1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_contact_nodes_lie_on_the_uniform_grid_sorted_by_x_then_y(tmp_path, degree):
    mesh = config.Mesh(contact_elements=6, degree=degree)
    upper, lower = (build_specimen(specimen(), mesh, s, tmp_path / f"{s}.msh") for s in Side)
    line = np.linspace(-0.5e-3, 0.5e-3, 6 * degree + 1)
    grid = [(x, y, 0.0) for x in line for y in line]
    for summary in (upper, lower):
        np.testing.assert_allclose(summary.contact_nodes, grid, rtol=0.0, atol=1e-16)
        np.testing.assert_array_equal(summary.profile, 0.0)
    check_matching(upper, lower)


def test_sorting_ignores_noise():
    line = np.linspace(-0.5e-3, 0.5e-3, 33)
    grid = np.array([(x, y, 0.0) for x in line for y in line])
    rng = np.random.default_rng(1)
    noisy = grid + rng.uniform(-1e-12, 1e-12, grid.shape)
    np.testing.assert_allclose(sorted_nodes(noisy[rng.permutation(len(grid))]), grid, rtol=0.0, atol=1.1e-12)


def test_default_specimen_is_as_large_as_meant():
    for body in config.BodyShape:
        hexahedra = specimen_mesh(config.Specimen(body=body), config.Mesh())
        assert 6000 < len(hexahedra.points) < 8500
        corners = hexahedra.points[hexahedra.cells]
        sizes = np.ptp(corners, axis=1)
        assert np.max(sizes.max(axis=1) / sizes.min(axis=1)) < 12.0
        touching = np.isin(hexahedra.cells, hexahedra.contact).sum(axis=1) == 4
        np.testing.assert_allclose(sizes[touching], 1e-4, rtol=0.1)


def test_first_layers_beside_the_contact_are_near_the_contact_element():
    hexahedra = specimen_mesh(config.Specimen(), config.Mesh(contact_elements=8, growth=1.5))
    for axis, edge in ((0, 0.5e-3), (1, 0.5e-3), (2, 0.0)):
        levels = np.unique(np.round(hexahedra.points[:, axis], 12))
        sizes = np.diff(levels[levels > edge - 1e-9])
        assert 0.5 * 0.125e-3 < sizes[0] < 1.6 * 0.125e-3
        assert np.max(sizes[1:] / sizes[:-1]) < 1.5 * (1.0 + 1e-6)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(body=st.sampled_from(list(config.BodyShape)), side=st.sampled_from(list(Side)),
       width=st.floats(1.6, 12.0), height=st.floats(0.3, 8.0), ridge=st.floats(0.1, 3.0),
       mesh=st.builds(config.Mesh, degree=st.sampled_from([1, 2]), contact_elements=st.integers(2, 7),
                      growth=st.floats(1.15, 2.5)))
def test_any_specimen_has_sound_elements(tmp_path_factory, body, side, width, height, ridge, mesh):
    path = tmp_path_factory.mktemp("mesh") / "a.msh"
    shape = specimen(body=body, body_width=width, body_height=height, ridge_height=ridge,
                     observation_distance=0.1)
    summary = build_specimen(shape, mesh, side, path)
    assert summary.min_jacobian > 0.0
    # At the core's corners of a round body the angle outside, 270 degrees, is halved; nothing is worse.
    assert summary.min_scaled_jacobian > np.sin(np.pi / 4.0) - 1e-9
    assert measures(path)["contact"] == pytest.approx(1.0, rel=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_jacobians_are_those_of_gmsh(tmp_path, degree):
    path = tmp_path / "a.msh"
    shape = specimen(body=config.BodyShape.ROUND, body_width=3.0)
    summary = build_specimen(shape, config.Mesh(contact_elements=2, degree=degree), Side.LOWER, path)
    lattice = [-1.0, 0.0, 1.0]
    local = [c for x in lattice for y in lattice for z in lattice for c in (x, y, z)]
    with gmsh_session(path):
        gmsh.merge(str(path))
        jacobians, determinants, _ = gmsh.model.mesh.getJacobians({1: 5, 2: 12}[degree], local)
    lengths = np.linalg.norm(jacobians.reshape(-1, 3, 3), axis=2).prod(axis=1)
    # gmsh's reference cube has side 2.
    assert summary.min_jacobian == pytest.approx(8.0 * determinants.min(), rel=1e-9)
    assert summary.min_scaled_jacobian == pytest.approx((determinants / lengths).min(), rel=1e-9)


def test_scaled_jacobian_of_a_sheared_box():
    hexahedra = specimen_mesh(specimen(), config.Mesh(contact_elements=2))
    sheared = hexahedra.points.copy()
    sheared[:, 0] += sheared[:, 2]  # 45 degrees in the plane x, z: sin 45 of the scaled Jacobian is left
    quality = measure(replace(hexahedra, points=sheared))
    np.testing.assert_allclose(quality.scaled_jacobian, np.sqrt(0.5), rtol=1e-9)
    np.testing.assert_allclose(quality.jacobian, measure(hexahedra).jacobian, rtol=1e-9)


def test_observation_points_lie_on_the_flanks(tmp_path):
    mesh = config.Mesh(contact_elements=4)
    for d, snapped in ((1.0, 1.0), (0.01, 0.0), (5.9, 6.0)):
        upper, lower = (build_specimen(specimen(observation_distance=d), mesh, s, tmp_path / f"{s}.msh")
                        for s in Side)
        np.testing.assert_allclose(upper.observation_point * 1e3, [0.0, 0.5, snapped], atol=1e-12)
        np.testing.assert_allclose(lower.observation_point * 1e3, [0.5, 0.0, -snapped], atol=1e-12)


def test_observation_point_of_an_odd_grid_is_the_same_on_both(tmp_path):
    upper, lower = (build_specimen(specimen(), config.Mesh(contact_elements=3), s, tmp_path / f"{s}.msh")
                    for s in Side)
    np.testing.assert_allclose(upper.observation_point * 1e3, [1.0 / 6.0, 0.5, 1.0], atol=1e-12)
    np.testing.assert_array_equal(lower.observation_point, upper.observation_point[[1, 0, 2]] * [1, 1, -1])


def test_curved_faces_are_gaps(tmp_path):
    mesh = config.Mesh(contact_elements=4)
    for side, across in ((Side.UPPER, 1), (Side.LOWER, 0)):
        flat = build_specimen(specimen(), mesh, side, tmp_path / "flat.msh")
        for face, radius in (("crowned", 20.0), ("cylindrical", 30.0)):
            curved = build_specimen(specimen(face=face, face_radius=radius), mesh, side, tmp_path / "a.msh")
            xy = flat.contact_nodes[:, :2] if face == "crowned" else flat.contact_nodes[:, [across]]
            # The exact sphere or cylinder; the parabola differs from it by a share of r^2 / 4 R^2.
            exact = radius * 1e-3 - np.sqrt((radius * 1e-3) ** 2 - np.sum(xy**2, axis=1))
            np.testing.assert_allclose(curved.profile, exact, rtol=4e-4, atol=1e-18)
            np.testing.assert_array_equal(curved.contact_nodes, flat.contact_nodes)


@pytest.mark.parametrize("degree", [1, 2])
def test_geometry_for_pictures_is_in_vtk_order(tmp_path, degree):
    build_specimen(specimen(), config.Mesh(contact_elements=2, degree=degree), Side.UPPER, tmp_path / "a.msh")
    geometry = mesh_geometry(tmp_path / "a.msh")
    corners = geometry.points[geometry.hexahedra]
    assert geometry.hexahedra.max() == len(geometry.points) - 1
    # VTK_HEXAHEDRON: 0-1-2-3 counter-clockwise seen from 4-5-6-7, each above its partner.
    first, second, third = (corners[:, n] - corners[:, 0] for n in (1, 3, 4))
    volume = np.einsum("ci,ci->c", np.cross(first, second), third)
    assert volume.min() > 0.0
    assert volume.sum() == pytest.approx(186e-9, rel=1e-10)
    np.testing.assert_allclose(corners[:, 6] - corners[:, 0], first + second + third, atol=1e-15)


def test_stage_writes_meshes_and_records(tmp_path):
    case = config.validate_case({"format": CASE, "name": "a", "mesh": {"contact_elements": 3},
                                 "test": {"excitation_amplitude": "53 N", "cycles": 1},
                                 "specimen": {"lower": {"body_width": "4 mm", "body": "round"}}})
    upper, lower = run_mesh(case, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        f"{side}{end}" for side in Side for end in (".msh", ".h5", "_geometry.h5"))
    for summary, side in ((upper, "upper"), (lower, "lower")):
        stored = read_record(tmp_path / f"{side}.h5", MeshSummary)
        assert stored.file == f"{side}.msh"
        assert stored.nodes == summary.nodes == len(read_mesh(tmp_path / stored.file).points)
        np.testing.assert_array_equal(stored.contact_nodes, summary.contact_nodes)
        geometry = read_record(tmp_path / f"{side}_geometry.h5", MeshGeometry)
        assert len(geometry.hexahedra) == summary.cells
    assert measures(tmp_path / "upper.msh")["clamped"] == pytest.approx(36.0, rel=1e-10)
    assert measures(tmp_path / "lower.msh")["clamped"] == pytest.approx(4.0 * np.pi, rel=0.02)
