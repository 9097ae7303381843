"""Property: a structure on a coarser mesh of its faces is that of the full matrices with fewer contact rows."""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.experiments.structure.coarser import coarser, mesh_errors, sparser, thinned
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.periodic_mode import condensed
from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone
from fretflow.structure.reduction.contact_modes import reduce_structure


@pytest.mark.parametrize("points", [12, 25])
def test_a_row_is_thinned_to_every_second_point_with_both_ends(points):
    row = np.c_[np.linspace(0.3, 0.42, points), np.zeros((points, 2))]
    kept = sparser(row)
    assert {0, points - 1} <= set(kept)
    assert len(kept) == (points + 1) // 2
    assert np.diff(kept).max() <= 3


def test_a_plane_is_thinned_in_both_directions_and_one_place_not_at_all():
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(5.0), [0.0]), axis=-1).reshape(-1, 3)
    left = grid[sparser(grid)]
    apart = np.linalg.norm(left[:, None] - left, axis=2) + 9.0 * np.eye(len(left))
    assert np.allclose(apart.min(axis=1), 2.0)
    assert len(left) == 15
    assert len(sparser(np.repeat(grid, 2, axis=0))) == 30  # two faces in one place
    assert len(sparser(np.zeros((4, 3)))) == 4


def test_points_without_contact_follow_as_those_of_the_full_matrices(structures):
    beam = structures.lap_beam(25)
    structure = reduce_structure(beam)
    kept = sparser(structure.points)
    rows = (3 * kept[:, None] + np.arange(3)).ravel()
    plainly = reduce_structure(replace(
        beam, contact_map=beam.contact_map[rows], areas=beam.areas[kept], points=beam.points[kept]))
    curves = []
    for own in (plainly, thinned(structure, kept)):
        joint = BoltedJoint(structure=own, law=Coulomb(0.45), bolt_load=6e3)
        curves.append(quasi_static_backbone(joint, joint.linear_modes(1)[0], np.geomspace(5e-6, 1e-4, 6)))
    one, other = curves
    assert np.allclose(other.frequency, one.frequency, rtol=1e-4)
    assert np.allclose(other.damping, one.damping, rtol=1e-2)
    assert np.allclose(np.abs(other.outputs), np.abs(one.outputs), rtol=1e-3)


def test_areas_are_kept_and_a_lumped_joint_has_no_coarser_mesh(structures):
    structure = reduce_structure(structures.lap_beam(12))
    assert coarser(structure).areas.sum() == pytest.approx(structure.areas.sum())
    assert coarser(reduce_structure(structures.sliders(np.full(4, 1e3), np.full(4, 0.1)))) is None


def test_sliders_side_by_side_are_no_mesh(structures):
    """Half of the load and of the stiffness would go with half of them."""
    row = structures.sliders(np.full(12, 1e3), np.full(12, 0.1))
    assert coarser(reduce_structure(replace(row, points=0.01 * np.outer(np.arange(12.0), [1.0, 0.0, 0.0])))) is None


def test_modes_of_a_soft_suspension_are_counted_on_both_meshes(structures):
    beam = structures.lap_beam(25)
    soft = beam.stiffness.copy()
    for end in (1, len(soft) - 52):  # the deflection of either end
        soft[end, end] += 70.0
    structure = condensed(reduce_structure(replace(beam, stiffness=soft)), 12)
    first, second = ([one.frequency for one in BoltedJoint(
        structure=own, law=Coulomb(0.45), bolt_load=6e3).linear_modes(4)] for own in (structure, coarser(structure)))
    assert first[1] < 5.0 < first[2]
    assert np.allclose(first, second, rtol=0.05)


def test_what_a_mesh_changes_of_the_joint_at_rest_it_changes_at_every_amplitude():
    """A shift of all frequencies is one error, known by its first point; what comes with the amplitude is not."""
    place, shift = np.log(np.geomspace(1e-6, 1e-4, 12)), np.full(12, -0.4)
    modes = mesh_errors(place, shift, 0.0)
    assert modes @ modes.T == pytest.approx(np.full((12, 12), (0.4 / 3.0)**2), rel=1e-6)
    later = mesh_errors(place, shift + np.where(place > place[5], 0.1, 0.0), 0.0)
    covariance = later @ later.T
    first, last = covariance[0, 0], covariance[-1, -1]
    assert covariance[0, -1] < 0.98 * np.sqrt(first * last)
