"""ParaView files: what is read back from them is what the records hold, at the right points."""

import numpy as np
import pytest
import pyvista as pv
from fretflow.core.specimen_mesh import MeshGeometry, MeshSummary
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ModeShapes
from fretflow.wear.history import WearHistory
from fretflow_post.paraview import write_modes, write_period_series, write_specimen, write_wear_series
from fretflow_post.specimens import MeshedSpecimen

RANDOM = np.random.default_rng(3)


def block():
    """Return 2 x 1 x 1 cubes of 1 mm whose lower face is the contact, with one mid-node as of degree 2."""
    points = 1e-3 * np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)])
    cells = np.array([[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]])
    nodes = 1e-3 * np.array([(0, 0, 0), (0, 1, 0), (0.5, 0.5, 0), (1, 0, 0), (1, 1, 0), (2, 0, 0), (2, 1, 0)])
    summary = MeshSummary(
        file="m.msh", degree=2, cells=2, nodes=12, contact_nodes=nodes, profile=np.zeros(7),
        observation_point=np.zeros(3), min_scaled_jacobian=1.0, min_jacobian=1e-9)
    return MeshedSpecimen(MeshGeometry(points=points, hexahedra=cells), summary)


def test_boundary_and_contact_faces_of_two_cubes():
    free, contact = block().faces()
    assert len(free) == 8
    assert sorted(map(sorted, contact)) == [[0, 1, 3, 4], [1, 2, 4, 5]]


def test_contact_values_stand_at_their_points_and_nowhere_else(tmp_path):
    depth = np.array([1.0, 2.0, 99.0, 4.0, 5.0, 6.0, 7.0])
    grid = pv.read(write_specimen(tmp_path / "a.vtu", block(), {"wear_depth_m": depth}))
    assert grid.n_cells == 2
    assert grid.volume == pytest.approx(2e-9)  # m^3
    read = grid.point_data["wear_depth_m"]
    assert read[[0, 3, 1, 4, 2, 5]] == pytest.approx([1.0, 2.0, 4.0, 5.0, 6.0, 7.0])
    assert np.all(np.isnan(read[6:]))
    assert list(grid.point_data["contact_face"]) == [1] * 6 + [0] * 6


def test_wear_series_reads_back_at_each_cycle_count(tmp_path):
    nodes = 1e-3 * np.array([(x, y) for x in (0.0, 0.5, 1.0) for y in (0.0, 1.0)])
    history = WearHistory(
        cycles=np.array([0, 190_000, 1_900_000]), depth=1e-6 * RANDOM.random((3, 6)),
        rate=1e-12 * RANDOM.random((3, 6)), volume=np.zeros(3), dissipated_energy=np.zeros(3),
        sliding_distance=np.zeros(3), energy=np.zeros(3), approach=np.zeros(3), upper_share=0.25, solves=3,
        stopped_by="cycles")
    reader = pv.get_reader(write_wear_series(tmp_path / "wear.pvd", nodes, history))
    assert reader.time_values == [0.0, 190_000.0, 1_900_000.0]
    for row, time in enumerate(reader.time_values):
        reader.set_active_time_value(time)
        face = reader.read()[0]
        assert face.n_cells == 2
        assert face.points[:, :2] == pytest.approx(nodes)
        assert face.point_data["wear_depth_m"] == pytest.approx( history.depth[row])
        assert face.point_data["wear_depth_upper_m"] == pytest.approx(0.25 * history.depth[row])
        assert face.point_data["wear_depth_lower_m"] == pytest.approx(0.75 * history.depth[row])
        assert face.point_data["wear_rate_m_per_cycle"] == pytest.approx( history.rate[row])
        assert face.point_data["wear_of_lower_m"][:, 2] == pytest.approx(-0.75 * history.depth[row])
        assert face.point_data["wear_of_upper_m"][:, 2] == pytest.approx(0.25 * history.depth[row])


def test_a_period_reads_back_in_time_and_its_tractions_carry_the_load(tmp_path):
    nodes = 1e-3 * np.array([(x, y) for x in (0.0, 0.5, 1.0) for y in (0.0, 1.0)])
    areas, force = np.full(6, 1e-6 / 6), np.zeros((4, 6, 3))
    force[:, :, 2], force[1, :, 0] = 10.0, -5.0
    moved = 1e-6 * RANDOM.random((4, 6, 3))
    period = PeriodicSolution(
        method="none", frequency=50.0, displacement=moved, force=force, state=np.full((4, 6), 1, np.int8),
        internal=np.zeros((4, 0)), outputs={}, friction_force=-force[:, :, 0].sum(axis=1), residual_history=(0.0,),
        error_estimate=0.0)
    reader = pv.get_reader(write_period_series(tmp_path / "period.pvd", nodes, areas, period))
    assert reader.time_values == pytest.approx([0.0, 0.005, 0.010, 0.015])  # s
    reader.set_active_time_value(reader.time_values[1])
    face = reader.read()[0]
    assert face.points[:, :2] == pytest.approx(nodes)
    assert face.point_data["relative_displacement_m"] == pytest.approx(moved[1])
    traction = face.integrate_data().point_data["traction_Pa"]  # over the area, by VTK
    assert traction[0] == pytest.approx([-30.0, 0.0, 60.0])  # N
    assert set(face.point_data["state"]) == {1}


def test_natural_modes_stand_at_the_points_of_the_mesh_whatever_their_order(tmp_path):
    made = block()
    order = RANDOM.permutation(12)
    shape = np.stack([made.geometry.points * [0.0, 0.0, 5.0], made.geometry.points * [7.0, 0.0, 0.0]])
    modes = ModeShapes(frequency=np.array([1200.0, 3456.4]), points=made.geometry.points[order], shape=shape[:, order])
    grid = pv.read(write_modes(tmp_path / "a.vtu", made, modes))
    assert grid.point_data["mode_01_1200_Hz"] == pytest.approx(1e3 * made.geometry.points * [0, 0, 1])  # the largest 1
    assert grid.point_data["mode_02_3456_Hz"] == pytest.approx(500.0 * made.geometry.points * [1, 0, 0])
