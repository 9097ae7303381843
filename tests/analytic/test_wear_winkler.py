"""Wear of an elastic foundation under a held load, sliding everywhere, which has a closed form.

With a uniform foundation of stiffness k per area and slip path s the shape ``h = gap + depth`` levels out
as ``h - mean h = (h0 - mean h0) exp(-K_w s k n)`` while the mean depth grows by ``K_w s p`` a cycle. The
weight lies on the schemes' orders against it, on the explicit stability limit lying exactly where the
closed form puts it, and on wear and energy sharing one quadrature.
"""

import numpy as np
import pytest
from fretflow.case.config import WearScheme
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.wear.archard import split_between_faces, wear_rate
from fretflow.wear.asymptotic import solve_asymptotic_shape
from fretflow.wear.capped_contact import CappedContact, solve_capped_contact
from fretflow.wear.cycle import CycleResponse, WearAlone, summarise_cycle
from fretflow.wear.feedback import Feedback
from fretflow.wear.history import WearSettings
from fretflow.wear.implicit import Implicit
from fretflow.wear.march import run_history
from fretflow.wear.scheme import WearingJoint
from fretflow.wear.slow import SlowState

K_W, LOAD, PATH, FOUNDATION, MU = 2e-14, 60.0, 20e-6, 4e14, 0.7
DECAY = K_W * PATH * FOUNDATION
AREAS = 1e-6 * np.array([0.5, 1.0, 1.0, 2.0, 1.5, 0.5, 1.5]) / 8.0
WEIGHTS = AREAS / AREAS.sum()
MEAN_PRESSURE = LOAD / AREAS.sum()
WAVE = 2e-8 * np.array([1.0, -2.0, 0.5, 1.0, -0.3, 0.8, -1.0])


@record
class Nothing:
    """A state that carries nothing over."""

    flag: float = quantity("1")


class Winkler(WearAlone):
    """Independent springs under one rigid plate that moves freely in z, with separation."""

    state_type = Nothing

    def __init__(self, gap=WAVE, path=PATH):
        self.areas, self.gap, self.calls = AREAS, gap, 0
        self.path = np.broadcast_to(path, AREAS.shape)

    def normal_flexibility(self, slow):
        return np.diag(1.0 / (FOUNDATION * AREAS))

    def cycle(self, slow, start):
        self.calls += 1
        height = self.gap + slow.depth
        order = np.argsort(height)
        for count in range(len(order), 0, -1):
            closed = order[:count]
            approach = (LOAD / FOUNDATION + AREAS[closed] @ height[closed]) / AREAS[closed].sum()
            if approach > height[closed[-1]]:
                break
        pressure = FOUNDATION * np.maximum(approach - height, 0.0)
        path = np.where(pressure > 0.0, self.path, 0.0)
        return CycleResponse(
            pressure_sliding=pressure * path, mean_pressure=pressure, slip_path=path,
            mean_opening=np.maximum(height - approach, 0.0), contact_share=(pressure > 0.0) * 1.0,
            dissipated_energy=float(MU * AREAS @ (pressure * path)), approach=approach,
            sliding_distance=float(WEIGHTS @ path / 2)), Nothing(flag=0.0)


def unworn(model):
    return model.cycle(model.initial(), None)[0]


def feedback():
    return Feedback(Winkler().normal_flexibility(SlowState.unworn(7)), AREAS)


def exact_depth(cycles):
    shape = WAVE - WEIGHTS @ WAVE
    return K_W * PATH * MEAN_PRESSURE * cycles + shape * np.expm1(-DECAY * cycles)


def order_of(errors, ratio=2.0):
    """Return the slope of the error against the step, fitted."""
    steps = ratio ** -np.arange(len(errors))
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_explicit_scheme_is_of_first_order():
    errors = []
    for most in (2e-9, 1e-9, 5e-10, 2.5e-10):
        settings = WearSettings(coefficient=K_W, cycles=10_000, max_depth_per_jump=most)
        history = run_history(Winkler(), settings)
        errors.append(np.abs(history.depth[-1] - exact_depth(10_000)).max())
    assert order_of(errors) == pytest.approx(1.0, abs=0.1)


def test_marched_history_follows_the_closed_form():
    settings = WearSettings(coefficient=K_W, cycles=20_000, stops=(3_000, 9_000), max_depth_per_jump=4e-10)
    history = run_history(Winkler(), settings)
    for cycles, depth, volume in zip(history.cycles, history.depth, history.volume, strict=True):
        assert np.abs(depth - exact_depth(cycles)).max() < 3e-10  # of 5e-8
        assert volume == pytest.approx(K_W * PATH * LOAD * cycles, rel=1e-12, abs=0.0)
    assert {0, 3_000, 9_000, 20_000} <= set(history.cycles)
    assert history.stopped_by == "cycles"
    assert history.solves == len(history.cycles)


def test_implicit_scheme_is_of_second_order():
    errors = []
    for parts in (4, 8, 16, 32):
        model = Winkler()
        joint = WearingJoint(model, WearSettings(coefficient=K_W, cycles=16_000))
        now, state = joint.unworn()
        for _ in range(parts):
            end, _, state = Implicit(joint).attempt(now, 16_000 // parts, state)
            now, state = joint.settled(end, state, 1)
        errors.append(np.abs(now.depth - exact_depth(16_000)).max())
    assert order_of(errors) == pytest.approx(2.0, abs=0.15)


def test_implicit_jumps_outlast_the_stability_bound_and_keep_the_tolerance():
    model = Winkler()
    history = run_history(model, WearSettings(coefficient=K_W, cycles=10_000_000, scheme=WearScheme.IMPLICIT))
    bound = feedback().stability_bound(K_W, unworn(model))
    assert np.diff(history.cycles).max() > 50 * bound
    error = max(np.abs(d - exact_depth(n)).max() for n, d in zip(history.cycles, history.depth, strict=True))
    assert error < 1e-2 * np.ptp(WAVE)
    assert np.all(np.diff(history.depth, axis=0) >= 0.0)
    assert history.solves == model.calls - 1
    assert history.solves < 60


@pytest.mark.parametrize(("share", "growth"), [(0.5, 0.0), (0.9, 0.8), (1.0, 1.0), (1.1, 1.2)])
def test_stability_bound_is_where_a_pattern_neither_grows_nor_decays(share, growth):
    model = Winkler()
    response = unworn(model)
    bound = feedback().stability_bound(K_W, response)
    assert bound == pytest.approx(2.0 / DECAY, rel=1e-12, abs=0.0)
    after = WAVE + share * bound * wear_rate(K_W, response)
    ratio = np.linalg.norm(after - WEIGHTS @ after) / np.linalg.norm(WAVE - WEIGHTS @ WAVE)
    assert ratio == pytest.approx(growth, abs=1e-9)


def test_wear_that_falls_with_pressure_bounds_no_jump():
    """A law p^(1 + a) with a < -1 has a negative slope: patterns grow there, and nothing decays."""
    response = unworn(Winkler())
    assert feedback().stability_bound(np.full(len(AREAS), -K_W), response) == np.inf
    mixed = np.where(np.arange(len(AREAS)) < 4, K_W, -K_W)  # four nodes still level out among themselves
    assert feedback().stability_bound(mixed, response) == pytest.approx(2.0 / DECAY, rel=1e-12, abs=0.0)
    with pytest.raises(NonConvergenceError, match="not finite"):
        feedback().stability_bound(np.full(len(AREAS), np.nan), response)


def test_a_jump_above_the_bound_is_split_and_one_below_is_not():
    bound = 0.5 * 2.0 / DECAY
    deep = WearSettings(coefficient=K_W, cycles=100_000, max_depth_per_jump=1e-6)
    history = run_history(Winkler(), deep)
    assert history.shortened_jumps == len(history.cycles) - 1
    assert np.diff(history.cycles).max() <= bound
    shallow = WearSettings(coefficient=K_W, cycles=20_000, max_depth_per_jump=3e-9)
    history = run_history(Winkler(), shallow)
    assert history.shortened_jumps == 0
    assert np.max(np.diff(history.depth, axis=0)) <= 3e-9 * (1.0 + 1e-12)
    assert np.max(np.diff(history.depth, axis=0)[0]) > 2.9e-9


def test_depth_scale_is_the_foundation_s_own_compression():
    scale = feedback().depth_scale(unworn(Winkler()))
    assert scale == pytest.approx(MEAN_PRESSURE / FOUNDATION, rel=1e-12, abs=0.0)


def test_a_coefficient_in_the_wrong_unit_is_refused():
    with pytest.raises(InputError, match=r"wear\.coefficient.*check its unit"):
        run_history(Winkler(), WearSettings(coefficient=1.1e-8, cycles=1000))


def test_closed_nodes_alone_feed_back():
    gap = np.where(np.arange(7) == 3, 1e-5, 0.0)
    jacobian = feedback().rate_jacobian(K_W, unworn(Winkler(gap=gap)))
    closed = np.arange(7) != 3
    inside = DECAY * (np.outer(np.ones(6), AREAS[closed]) / AREAS[closed].sum() - np.eye(6))
    np.testing.assert_allclose(jacobian[np.ix_(closed, closed)], inside, atol=1e-12 * DECAY)
    assert not np.any(jacobian[3]) and not np.any(jacobian[:, 3])  # noqa: PT018


def test_volume_per_energy_in_gross_slip_is_kw_over_mu():
    rng = np.random.default_rng(3)
    angle = 2.0 * np.pi * np.arange(48) / 48
    displacement = np.zeros((48, 7, 3))
    displacement[..., 0] = PATH / 4 * np.cos(angle)[:, None] * rng.uniform(0.5, 1.5, 7)
    displacement[..., 1] = PATH / 30 * np.sin(2.0 * angle)[:, None]
    steps = displacement[..., :2] - np.roll(displacement[..., :2], 1, axis=0)
    slip = np.linalg.norm(steps, axis=2)
    force = np.empty((48, 7, 3))
    force[..., 2] = rng.uniform(0.0, 20.0, (48, 7))  # separation and reloading within the period
    force[..., :2] = -MU * force[..., 2:] * steps / slip[..., None]
    response = summarise_cycle(displacement, force, slip, force[..., 2] > 0.0, 0.0 * AREAS, AREAS)
    volume = AREAS @ wear_rate(K_W, response)
    assert volume / response.dissipated_energy == pytest.approx(K_W / MU, rel=1e-12, abs=0.0)
    np.testing.assert_allclose(response.slip_path, slip.sum(axis=0))


def test_split_between_faces_adds_up():
    upper, lower = split_between_faces(np.array([1e-6, 3e-6]), 0.3)
    np.testing.assert_allclose(upper, [0.3e-6, 0.9e-6])
    np.testing.assert_allclose(upper + lower, [1e-6, 3e-6])


def test_asymptotic_face_levels_the_gap():
    volume = 5e-13
    face = solve_asymptotic_shape(Winkler(), K_W, volume)
    level = volume / AREAS.sum() + WEIGHTS @ WAVE
    np.testing.assert_allclose(face.depth, level - WAVE, atol=1e-15)
    assert face.rate == pytest.approx(K_W * PATH * MEAN_PRESSURE, rel=1e-9, abs=0.0)


def test_asymptotic_face_wears_nodes_apart_in_proportion_to_their_path():
    path = PATH * np.array([1.0, 2.0, 1.5, 1.0, 0.5, 1.0, 3.0])
    face = solve_asymptotic_shape(Winkler(path=path), K_W, 5e-12)
    pressure = LOAD / path / (AREAS @ (1.0 / path))  # uniform p s under the load
    shape = -WAVE - pressure / FOUNDATION
    np.testing.assert_allclose(face.depth - WEIGHTS @ face.depth, shape - WEIGHTS @ shape, atol=1e-13)


def test_little_wear_leaves_the_valleys_unworn():
    deep = 100.0 * WAVE
    face = solve_asymptotic_shape(Winkler(gap=deep), K_W, 1e-12)
    worn = face.depth > 0.0
    assert worn.sum() == 3
    assert face.solves <= 3
    level = (face.depth + deep)[worn]
    # worn nodes carry equal pressure, hence lie in one plane; unworn ones lie below it
    np.testing.assert_allclose(level, level[0], rtol=1e-9)
    assert np.all(deep[~worn] > level[0])
    assert AREAS @ face.depth == pytest.approx(1e-12, rel=1e-9, abs=0.0)


def test_wear_beside_sticking_nodes_ends_when_they_carry_the_load():
    path = np.where(np.arange(7) < 3, 0.0, PATH)
    gap = np.zeros(7)
    touching = LOAD / FOUNDATION / AREAS[:3].sum()
    face = solve_asymptotic_shape(Winkler(gap=gap, path=path), K_W, 1.0)
    np.testing.assert_allclose(face.depth, np.where(path > 0.0, touching, 0.0), rtol=1e-9)
    assert face.rate == 0.0
    settings = WearSettings(coefficient=K_W, cycles=10**9, scheme=WearScheme.IMPLICIT, vanishing_rate=1e-6)
    history = run_history(Winkler(gap=gap, path=path), settings)
    assert history.stopped_by == "vanishing rate"
    assert history.cycles[-1] < 10**9
    assert face.distance(history.depth[-1]) < 1e-3


@pytest.mark.parametrize("scheme", WearScheme)
@pytest.mark.parametrize("least", [0.1, 0.01])
def test_wear_ends_where_its_rate_has_fallen_as_far_as_asked(scheme, least):
    path = np.where(np.arange(7) < 3, 0.0, PATH)
    settings = WearSettings(coefficient=K_W, cycles=10**9, scheme=scheme, vanishing_rate=least)
    history = run_history(Winkler(gap=np.zeros(7), path=path), settings)
    share = history.rate @ AREAS / (history.rate[0] @ AREAS)
    assert history.stopped_by == "vanishing rate"
    assert np.all(share[:-1] > least)
    assert 0.0 < share[-1] <= least


def test_nodes_that_have_come_to_stick_wear_no_more():
    """Three nodes on springs of their own: those that stick, though begun as worn, carry all of their springs' load."""
    springs, overlap, area, volume = 1e7, 1e-5, 1e-6, 1e-12
    contact = CappedContact(np.eye(3) / springs, np.full(3, -overlap), np.array([np.inf, 1e13, np.inf]),
                            np.full(3, area), None)
    worn = np.array([True, False, True])
    face = solve_capped_contact(contact, volume, worn, ~worn)
    np.testing.assert_allclose(face.depth, [0.0, volume / area, 0.0], rtol=1e-9)
    np.testing.assert_allclose(face.force, springs * (overlap - face.depth), rtol=1e-9)


def test_asymptotic_face_needs_sliding_and_a_volume():
    with pytest.raises(InputError, match="nothing slides"):
        solve_asymptotic_shape(Winkler(path=0.0), K_W, 1e-12)
    with pytest.raises(InputError, match="volume must be positive"):
        solve_asymptotic_shape(Winkler(), K_W, 0.0)


def test_without_sliding_the_history_ends_at_once():
    history = run_history(Winkler(path=0.0), WearSettings(coefficient=K_W, cycles=1000))
    assert history.stopped_by == "vanishing rate"
    assert history.cycles.tolist() == [0]
