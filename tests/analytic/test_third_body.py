"""The third body: debris that is made, retained and ejected, and what it does to the worn face.

What carries the weight: the layer at a constant rate is that of the closed form whatever the jumps; volumes balance to
round-off and a loss is refused; the residence is the exit time of a random walk; and on the elastic faces the worn
profile turns from W to U, while approach and wear depth part by the layer.
"""

from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import WearScheme
from fretflow.core.errors import AuditError
from fretflow.effects.third_body import Balance, ThirdBody, edge_position
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.history import WearSettings
from fretflow.wear.march import run_history

DATA = Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz"
K_W, LOAD, HALF_STROKE, AREA = 1e-14, 60.0, 5e-6, 1e-6
RATE = K_W * LOAD / AREA * 4.0 * HALF_STROKE
LAYER, MADE, RETAINED, EJECTED = (f"third-body.{name}" for name in ("layer_m", "made_m3", "retained_m3", "ejected_m3"))
EVEN = {"retained_fraction": 0.6, "residence": 2e4, "edge_residence": 1.0, "separating_thickness": 1e3}


def settings(cycles, **changes):
    return WearSettings(**{"coefficient": K_W, "cycles": cycles, "scheme": WearScheme.IMPLICIT, **changes})


def debris(**values):
    return ThirdBody().changed(**values)


@pytest.fixture(scope="module")
def elastic(face_problem):
    """Return the problem of two crossed ridges with 49 contact nodes."""
    data = np.load(DATA)
    line = np.full(7, 1e-3 / 6)
    line[[0, -1]] *= 0.5
    place = 1e-3 * data["x"][:, :2]
    order = np.lexsort((place[:, 1], place[:, 0]))
    areas = np.empty(49)
    areas[order] = np.outer(line, line).ravel()
    return face_problem(place, areas, np.linalg.inv(1e3 * data["K"])[2::3, 2::3])


def test_the_layer_at_a_constant_rate_is_the_closed_form_whatever_the_jumps(dragged, winkler):
    histories = [run_history(dragged(winkler(), [debris(**EVEN)]), settings(200_000, **changes)) for changes in (
        {}, {"stops": (17, 3_000, 71_000)}, {"scheme": WearScheme.EXPLICIT, "max_depth_per_jump": 2e-8})]
    for history in histories:
        exact = 0.6 * RATE * 2e4 * -np.expm1(-history.cycles / 2e4)
        np.testing.assert_allclose(history.memory[LAYER], np.outer(exact, np.ones(9)), rtol=1e-9, atol=0.0)
        np.testing.assert_allclose(history.depth, np.outer(RATE * history.cycles, np.ones(9)), rtol=1e-9, atol=0.0)
    assert exact[-1] == pytest.approx(0.6 * RATE * 2e4, rel=1e-4, abs=0.0)  # phi times rate times n_e


def test_debris_closes_the_gap_it_leaves(dragged, winkler):
    """Approach falls behind the wear depth by the layer; its springs add their compression."""
    model = dragged(winkler(), [debris(**EVEN, modulus=1e9)])
    history = run_history(model, settings(50_000))
    layer = history.memory[LAYER].mean(axis=1)
    behind = layer - layer * LOAD / AREA / 1e9
    np.testing.assert_allclose(history.depth.mean(axis=1) - history.approach, behind, rtol=1e-9, atol=1e-18)
    assert behind[-1] > 0.1 * history.depth[-1].mean()


def test_wear_under_a_layer_stops_itself_as_in_the_closed_form(dragged, winkler):
    """All debris kept for good: ``dh/dn = r exp(-h / h_0)`` gives ``h = h_0 ln(1 + r n / h_0)``."""
    kept = debris(retained_fraction=1.0, residence=1e15, separating_thickness=1e-7)
    history = run_history(dragged(winkler(), [kept]), settings(300_000, tolerance=1e-3))
    exact = 1e-7 * np.log1p(RATE * history.cycles / 1e-7)
    np.testing.assert_allclose(history.depth, np.outer(exact, np.ones(9)), rtol=2e-3, atol=0.0)
    # the thinner the layer's effect on the gap, the closer both faces stay: nothing opens
    np.testing.assert_allclose(history.memory[LAYER], history.depth, rtol=1e-7)


@pytest.mark.parametrize("scheme", list(WearScheme))
def test_volumes_are_balanced_at_every_step(dragged, elastic, scheme):
    history = run_history(dragged(elastic, [debris(residence=5e3)]), settings(30_000, scheme=scheme))
    made, retained, ejected = (history.memory[name] for name in (MADE, RETAINED, EJECTED))
    assert np.all(np.diff(made) > 0.0)
    assert np.all(np.diff(ejected) > 0.0)
    np.testing.assert_allclose(made, history.volume, rtol=1e-12, atol=0.0)
    np.testing.assert_allclose(retained, history.memory[LAYER] @ elastic.interface.areas, rtol=1e-12, atol=0.0)
    assert np.abs(made - retained - ejected).max() < 1e-12 * made[-1]
    steps = np.diff(made) - np.diff(retained) - np.diff(ejected)
    assert np.abs(steps).max() < 1e-12 * made[-1]
    assert 0.05 * made[-1] < retained[-1] < 0.6 * made[-1]


def test_a_loss_of_debris_is_refused():
    Balance(made=1e-12, retained=4e-13, ejected=6e-13, present=1e-12).check()
    with pytest.raises(AuditError, match=r"effects\.third-body: of 1e-12 m³ .* are lost"):
        Balance(made=1e-12, retained=4e-13, ejected=6e-13 * (1.0 + 1e-11), present=1e-12).check()


def test_the_residence_is_the_exit_time_of_a_random_walk():
    """Mean steps from each of 41 places to either end, from the linear equations of the walk."""
    steps = np.eye(41) - 0.5 * (np.eye(41, k=1) + np.eye(41, k=-1))
    exit_time = np.linalg.solve(steps, np.ones(41))
    walk = np.linspace(-1.0, 1.0, 43)[1:-1]  # the ends themselves are outside
    place = np.stack([np.r_[-1.0, walk, 1.0], np.zeros(43)], axis=1)
    stay = debris(residence=7e4, edge_residence=1e-12).stay(place, np.full(43, 0.05**2), np.ones(43, dtype=bool))
    np.testing.assert_allclose(stay[1:-1], 7e4 * exit_time / exit_time.max(), rtol=1e-9)
    assert stay[0] == pytest.approx(7e-8)


def test_edges_are_those_of_the_contact_along_the_sliding():
    x, y = np.meshgrid(np.arange(-4.0, 5.0), np.arange(-4.0, 5.0), indexing="ij")
    place, areas = np.stack([x.ravel(), y.ravel()], axis=1), np.ones(81)
    closed = np.hypot(*place.T) < 4.05
    positions = edge_position(place, areas, closed).reshape(9, 9)
    np.testing.assert_allclose(positions[:, 4], np.arange(-4.0, 5.0) / 4.0)
    np.testing.assert_allclose(positions[2:7, 1], [-2 / 2, -1 / 2, 0.0, 1 / 2, 1.0])
    assert positions[4, 0] == 1.0  # a line of one node is all edge
    assert (edge_position(place, areas, closed & (place[:, 1] > 0.0)).reshape(9, 9)[:, 0] == 1.0).all()
    shifted = edge_position(place, areas, closed & (place[:, 0] >= -1.0)).reshape(9, 9)
    np.testing.assert_allclose(shifted[3:, 4], (np.arange(-1.0, 5.0) - 1.5) / 2.5)


def test_debris_of_nodes_that_open_leaves_soon(winkler):
    effect = debris(residence=1e4, edge_residence=0.01, retained_fraction=0.5)
    problem = winkler()
    shut = np.ones(9)
    start = effect.initial_memory(problem.interface)
    response = CycleResponse(pressure_sliding=shut, mean_pressure=shut, mean_opening=shut, slip_path=shut,
                             contact_share=np.where(np.arange(9) < 5, 1.0, 0.0), dissipated_energy=1.0,
                             sliding_distance=1e-5)
    stay = effect.stay(start["third-body.place_m"], problem.interface.areas, response.contact_share > 0.0)
    np.testing.assert_allclose(stay[5:], 100.0)
    assert stay[2] == pytest.approx(1e4)  # the middle of what is left


def middle_profile(elastic, depth):
    """Return the depth along the sliding direction through the middle."""
    x, y = elastic.interface.nodes.T
    row = np.flatnonzero(np.abs(y - np.median(y)) < 1e-9)
    return depth[row[np.argsort(x[row])]]


def test_the_worn_profile_turns_from_w_to_u(dragged, elastic):
    bare = run_history(dragged(elastic, [debris(retained_fraction=0.0)]), settings(400_000, stops=(5_000,)))
    covered = run_history(dragged(elastic, [debris(residence=1e5)]), settings(400_000, stops=(5_000,)))
    assert covered.solves < 1.7 * bare.solves  # jumps are hardly shorter than without debris
    early = [h.depth[h.cycles == 5_000][0] for h in (bare, covered)]
    for depth in (*early, bare.depth[-1]):
        profile = middle_profile(elastic, depth)
        assert profile[[0, -1]].min() > profile[1:-1].max()  # W: deepest at the edges
    profile = middle_profile(elastic, covered.depth[-1])
    assert np.all(np.diff(profile[:4]) > 0.0)  # U: deepest in the middle
    assert np.all(np.diff(profile[3:]) < 0.0)
    # the layer is as much deeper in the middle as the steady one, by the residence there
    layer = covered.memory[LAYER][-1]
    rate = covered.rate[-1]
    np.testing.assert_allclose(layer, 0.6 * rate * covered.memory["third-body.residence_cycles"][-1], rtol=0.05)
    behind = elastic.interface.areas @ (covered.depth[-1] - layer) / AREA
    assert covered.approach[-1] == pytest.approx(behind, rel=0.02, abs=0.0)
    assert covered.approach[-1] < 0.95 * covered.volume[-1] / AREA
    assert bare.approach[-1] == pytest.approx(bare.volume[-1] / AREA, rel=5e-3, abs=0.0)
    assert covered.dissipated_energy[-1] == pytest.approx(bare.dissipated_energy[-1], rel=1e-9)  # friction as before
