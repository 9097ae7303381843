"""The contact face as drawn: cells and node patches cover the face once, and period shares are right.

The patches of a grid must have the trapezoid rule's areas, found here from the node spacing alone.
"""

import numpy as np
import pytest
from fretflow.contact.law import ContactState
from fretflow.core.errors import MeshError
from fretflow.solvers.periodic import PeriodicSolution
from fretflow_post.contact_grid import Regime, contact_cells, node_patches, state_shares

STICK, SLIP, SEPARATION = ContactState


def grid(x, y):
    return np.array([(a, b) for a in x for b in y], dtype=float)


def polygon_areas(points, cells):
    corner = points[cells][:, :, :2]
    following = np.roll(corner, -1, axis=1)
    return 0.5 * np.sum(corner[..., 0] * following[..., 1] - corner[..., 1] * following[..., 0], axis=1)


def node_areas(points, cells):
    patches, quads, owner = node_patches(np.column_stack([points, np.zeros(len(points))]), cells)
    return np.bincount(owner, weights=polygon_areas(patches, quads), minlength=len(points))


def test_grid_gives_counter_clockwise_quads_and_trapezoid_node_areas():
    x, y = np.array([-1.0, -0.2, 0.1, 2.0]), np.array([0.0, 0.5, 3.0])
    nodes = grid(x, y)
    cells = contact_cells(nodes)
    assert cells.shape == (6, 4)
    assert np.all(polygon_areas(nodes, cells) > 0.0)
    weights = [np.convolve(np.diff(axis), [0.5, 0.5]) for axis in (x, y)]
    assert node_areas(nodes, cells) == pytest.approx(np.outer(*weights).ravel(), rel=1e-12)


def test_noisy_grid_of_a_text_file_is_still_a_grid():
    nodes = grid(np.linspace(0.0, 1e-3, 11), np.linspace(0.0, 1e-3, 11))
    nodes += np.random.default_rng(1).uniform(-1e-12, 1e-12, nodes.shape)
    assert contact_cells(nodes).shape == (100, 4)


@pytest.mark.parametrize("remove", [0, 12])
def test_irregular_nodes_are_triangulated_and_cover_the_face(remove):
    nodes = np.delete(grid(np.arange(5.0), np.arange(5.0)), remove, axis=0)
    cells = contact_cells(nodes)
    assert cells.shape[1] == 3
    areas = polygon_areas(nodes, cells)
    assert np.all(areas > 0.0)
    covered = 16.0 if remove else 15.5  # a lost corner cuts half a cell off
    assert areas.sum() == pytest.approx(covered)
    assert node_areas(nodes, cells).sum() == pytest.approx(covered)


def test_nodes_on_a_line_are_refused():
    with pytest.raises(MeshError, match="span no area"):
        contact_cells(grid([0.0], np.arange(4.0)))


def test_state_shares_and_regimes_of_hand_made_nodes():
    state = np.array([
        [STICK, SLIP, SLIP, SEPARATION, SEPARATION],
        [STICK, STICK, SLIP, SLIP, SEPARATION],
        [STICK, SLIP, SLIP, SEPARATION, SEPARATION],
        [STICK, STICK, SLIP, STICK, SEPARATION]], dtype=np.int8)
    shares = state_shares(period_with(state))
    assert shares.stick == pytest.approx([1.0, 0.5, 0.0, 0.25, 0.0])
    assert shares.slip == pytest.approx([0.0, 0.5, 1.0, 0.25, 0.0])
    assert shares.open == pytest.approx([0.0, 0.0, 0.0, 0.5, 1.0])
    assert list(shares.regime) == [Regime.STICKS, Regime.STICKS_AND_SLIPS, Regime.SLIPS, Regime.LIFTS_OFF,
                                   Regime.STAYS_OPEN]


def period_with(state):
    samples, nodes = state.shape
    return PeriodicSolution(
        method="test", frequency=100.0, displacement=np.zeros((samples, nodes, 3)),
        force=np.zeros((samples, nodes, 3)), state=state, internal=np.zeros((samples, 2)),
        outputs={},
        friction_force=np.zeros(samples), residual_history=(0.0,), error_estimate=0.0)
