"""Wear schemes on the stiffness of two crossed ridge specimens, sliding under a held load.

Normal contact is solved exactly at each depth (active sets), and the slip path shrinks with the elastic
shear under the friction of the pressure, so that the schemes' Jacobian with frozen slip path is not exact.
The weight lies on fitted orders, on the implicit scheme meeting the explicit one at a fraction of its
solutions, and on the face found directly being the one that marching tends to.
"""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver, WearScheme
from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.effects.cycle import PeriodicCycle
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.asymptotic import solve_asymptotic_shape
from fretflow.wear.cycle import CycleResponse, WearAlone
from fretflow.wear.feedback import Feedback
from fretflow.wear.history import WearSettings
from fretflow.wear.implicit import ACCURATE, DAMPING, Implicit
from fretflow.wear.march import run_history
from fretflow.wear.scheme import WearingJoint
from fretflow.wear.slow import SlowState

DATA = Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz"
K_W, LOAD, MU, CYCLES = 1.1e-14, 60.0, 0.88, 1_900_000
PITCH = 1e-3 / 6
EQUIVALENT_MODULUS = 193e9 / (2.0 * (1.0 - 0.29**2))


@record
class Nothing:
    """A state that carries nothing over."""

    flag: float = quantity("1")


class Ridges(WearAlone):
    """Crossed ridges sliding by a stroke (m, one way) of their back faces."""

    state_type = Nothing

    def __init__(self, stroke=7.5e-6, radius=None):
        data = np.load(DATA)
        flexibility = np.linalg.inv(data["K"] * 1e3)
        place = data["x"][:, :2] * 1e-3
        inside = np.isclose(np.abs(place - place.mean(axis=0)), 0.5e-3, atol=1e-9)
        self.areas = PITCH**2 * np.prod(np.where(inside, 0.5, 1.0), axis=1)
        self.flexibility, self.shear_flexibility = flexibility[2::3, 2::3], flexibility[0::3, 0::3]
        self.gap = np.zeros(49)
        if radius is not None:
            self.gap = np.sum((place - place.mean(axis=0)) ** 2, axis=1) / (2.0 * radius)
        self.stroke, self.calls = stroke, 0

    def press(self, gap):
        """Return forces and gaps of the frictionless contact under the load."""
        closed = np.ones(49, dtype=bool)
        while True:
            index = np.flatnonzero(closed)
            matrix = np.ones((index.size + 1, index.size + 1))
            matrix[:-1, :-1], matrix[-1, -1] = self.flexibility[np.ix_(index, index)], 0.0
            *forces, approach = np.linalg.solve(matrix, np.r_[-gap[index], LOAD])
            force = np.zeros(49)
            force[index] = forces
            opening = gap + approach + self.flexibility @ force
            new = (closed & (force > 0.0)) | (~closed & (opening < 0.0))
            if np.array_equal(new, closed):
                return force, opening
            closed = new

    def normal_flexibility(self, slow):
        return self.flexibility

    def at(self, depth):
        return self.cycle(SlowState.worn_by(depth), None)[0]

    def cycle(self, slow, start):
        self.calls += 1
        force, opening = self.press(self.gap + slow.depth)
        path = 4.0 * (self.stroke - self.shear_flexibility @ (MU * force))
        path = np.where(force > 0.0, path, 0.0)
        pressure = force / self.areas
        return CycleResponse(
            pressure_sliding=pressure * path, mean_pressure=pressure, slip_path=path,
            mean_opening=np.maximum(opening, 0.0), contact_share=(force > 0.0) * 1.0,
            dissipated_energy=float(MU * force @ path),
            sliding_distance=float(self.areas @ path / self.areas.sum() / 2.0)), Nothing(flag=0.0)


def settings(**changes):
    return WearSettings(**{"coefficient": K_W, "cycles": CYCLES, **changes})


@pytest.fixture(scope="module")
def explicit():
    return run_history(Ridges(), settings(stops=(190_000,), max_depth_per_jump=5e-8))


@pytest.fixture(scope="module")
def implicit():
    return run_history(Ridges(), settings(stops=(190_000,), scheme=WearScheme.IMPLICIT))


def test_setting_is_that_of_the_rig():
    response = Ridges().at(np.zeros(49))
    assert 10e-6 < response.sliding_distance < 14e-6
    assert response.contact_share.min() == 1.0


def test_explicit_order():
    coarse, middle, fine, finest = (
        run_history(Ridges(), settings(cycles=20_000, max_depth_per_jump=most)).depth[-1]
        for most in (4e-8, 2e-8, 1e-8, 2e-10))
    errors = [np.abs(depth - finest).max() for depth in (coarse, middle, fine)]
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.1)


def implicit_depth(parts, cycles, gamma):
    joint = WearingJoint(Ridges(), settings())
    now, state = joint.unworn()
    for _ in range(parts):
        end, _, state = Implicit(joint).attempt(now, cycles // parts, state, gamma=gamma)
        now, state = joint.settled(end, state, 1)
    return now.depth


@pytest.mark.parametrize("gamma", [ACCURATE, DAMPING])
def test_implicit_order_with_an_inexact_jacobian(gamma):
    cycles = 61_440
    finest = implicit_depth(1024, cycles, ACCURATE)
    errors = [np.abs(implicit_depth(parts, cycles, gamma) - finest).max() for parts in (30, 60, 120, 240)]
    assert np.polyfit(np.log([8.0, 4.0, 2.0, 1.0]), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.25)


class Softer(Ridges):
    """Ridges of which every node slides alike, and which say that they are softer than they are by a factor."""

    def __init__(self, factor):
        super().__init__()
        self.factor, self.shear_flexibility = factor, np.zeros((49, 49))

    def normal_flexibility(self, slow):
        return self.factor * self.flexibility


@pytest.mark.parametrize("gamma", [ACCURATE, DAMPING])
@pytest.mark.parametrize("factor", [0.5, 1.0, 1.5, 4.0])
def test_patterns_that_settle_within_a_jump_are_left_with_what_the_stability_function_says(factor, gamma):
    """Of the linear problem by hand, for jumps without end; the uniform depth is nobody's pattern."""
    ridges = Softer(factor)
    uniform = ridges.areas / ridges.areas.sum() * LOAD
    settled = 1e-6 - ridges.gap - ridges.flexibility @ uniform  # under which all press alike
    pattern = 1e-12 * np.random.default_rng(1).standard_normal(49)
    joint = WearingJoint(ridges, settings(cycles=10**12))
    now, state = joint.settled(SlowState.worn_by(settled + pattern), None, 1)
    end, _, _ = Implicit(joint).attempt(now, 10**9, state, gamma=gamma)
    left = end.depth - settled
    x = factor / gamma
    expected = (1.0 - 2.0 * x + 0.5 * x**2) * (pattern - pattern.mean())
    size = max(np.abs(pattern).max(), np.abs(expected).max())
    assert left - left.mean() == pytest.approx(expected, abs=1e-2 * size)


class Narrow(Ridges):
    """Ridges whose period is found from another one only where the faces have changed little since."""

    def __init__(self):
        super().__init__()
        self.last, self.refused, self.anew = np.zeros(49), 0, 0

    def cycle(self, slow, start):
        if start is not None and np.abs(slow.depth - self.last).max() > 1e-7:
            self.refused += 1
            raise NonConvergenceError("too far from where it was")
        self.anew += start is None
        self.last = slow.depth
        return super().cycle(slow, start)


def test_a_period_that_is_lost_in_a_jump_asks_for_a_shorter_one_and_for_nothing_anew():
    model = Narrow()
    history = run_history(model, settings(cycles=60_000, scheme=WearScheme.IMPLICIT))
    finest = run_history(Ridges(), settings(cycles=60_000, max_depth_per_jump=1e-9))
    assert model.refused > 0
    assert model.anew == 1
    assert history.volume[-1] == pytest.approx(finest.volume[-1], rel=2e-3)


class Ending(Ridges):
    """Ridges without a period near another one from a depth on; from nothing there may be one."""

    def __init__(self, lasts):
        super().__init__()
        self.refused, self.anew, self.lasts = 0, 0, lasts

    def cycle(self, slow, start):
        if slow.depth.max() > 1e-6:
            self.refused += 1
            if start is not None or not self.lasts:
                raise NonConvergenceError("no such period")
            self.anew += 1
        return super().cycle(slow, start)


@pytest.mark.parametrize(("lasts", "anew"), [(True, True), (False, True), (True, False)])
def test_a_branch_that_ends_is_left_once_no_shorter_jump_is_another_state(lasts, anew):
    """And not jump by jump down to a single cycle, of 1.1e-10 m here; a search does not begin anew at all."""
    model = Ending(lasts)
    joint = WearingJoint(model, settings(cycles=60_000, scheme=WearScheme.IMPLICIT))
    scheme = Implicit(joint, anew)
    now, state = joint.unworn()
    with suppress(NonConvergenceError):
        while now.depth.max() < 1e-6:
            model.refused = 0
            now, state = scheme.advance(now, state)
    assert (now.depth.max() > 1e-6) == (model.anew > 0) == (lasts and anew)
    assert now.depth.max() > (1.0 - joint.settings.tolerance) * 1e-6
    assert model.refused <= 5


def test_halving_the_jump_hardly_changes_the_volume(explicit):
    halved = run_history(Ridges(), settings(stops=(190_000,), max_depth_per_jump=2.5e-8))
    default = run_history(Ridges(), settings(stops=(190_000,)))
    for cycles in (190_000, CYCLES):
        volumes = [h.volume[h.cycles == cycles][0] for h in (default, explicit, halved)]
        assert np.ptp(volumes) < 1e-3 * volumes[0]


def test_halving_the_jump_of_a_vibrating_joint_hardly_changes_the_volume():
    """At 53 N, where the stroke follows the contact: each period is solved on the rig, and slip and load vary in it."""
    ridges, data = Ridges(), np.load(DATA)
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    problem = rig_problem(
        joint=QuasiStaticJoint.from_stiffness(1e3 * data["K"], rig), frequency=100.0, excitation=53.0,
        interface=Interface(nodes=1e-3 * data["x"][:, :2], areas=ridges.areas, gap=ridges.gap),
        friction_coefficient=MU, normal_load=LOAD)
    solver, volumes = QuasiStaticSolver(Solver(harmonics=7, samples=64, estimate_error=False)), []
    assert PeriodicCycle(solver, problem).load_held  # by the arm, which nothing else holds along z
    for most in (1e-7, 5e-8):
        history = run_history(PeriodicCycle(solver, problem), settings(cycles=30_000, max_depth_per_jump=most))
        energy = history.dissipated_energy[:-1] @ np.diff(history.cycles)
        assert history.volume[-1] == pytest.approx(K_W / MU * energy, rel=1e-6, abs=0.0)
        assert history.shortened_jumps == 0
        volumes.append((len(history.cycles), history.volume[-1]))
    assert volumes[1][0] > 1.8 * volumes[0][0]
    assert volumes[1][1] == pytest.approx(volumes[0][1], rel=5e-3, abs=0.0)


def test_implicit_meets_explicit_at_a_fifth_of_the_solutions(explicit, implicit):
    default = run_history(Ridges(), settings(stops=(190_000,)))
    assert implicit.solves <= default.solves / 5
    for cycles in (190_000, CYCLES):
        a, b = (h.depth[h.cycles == cycles][0] for h in (explicit, implicit))
        volumes = [h.volume[h.cycles == cycles][0] for h in (explicit, implicit)]
        assert volumes[1] == pytest.approx(volumes[0], rel=2e-3, abs=0.0)
        assert np.abs(a - b).max() < 2e-3 * a.max()


def test_stability_bound_agrees_with_the_estimate_and_with_what_happens():
    model = Ridges()
    response = model.at(np.zeros(49))
    feedback = Feedback(model.flexibility, model.areas)
    mean_pressure = LOAD / model.areas.sum()
    estimate = mean_pressure * PITCH / EQUIVALENT_MODULUS
    assert feedback.depth_scale(response) == pytest.approx(estimate, rel=0.2, abs=0.0)
    flat = solve_asymptotic_shape(model, K_W, 1e-12)
    worn = model.at(flat.depth)
    bound = feedback.stability_bound(K_W, worn)
    wave = 1e-11 * np.random.default_rng(1).standard_normal(49)
    sizes = []
    for share in (0.9, 1.1):
        depth, base = flat.depth + wave, flat.depth
        for _ in range(60):
            depth = depth + share * bound * K_W * model.at(depth).pressure_sliding
            base = base + share * bound * K_W * model.at(base).pressure_sliding
        sizes.append(np.linalg.norm(depth - base) / np.linalg.norm(wave))
    assert sizes[0] < 0.1
    assert sizes[1] > 10.0


def test_marching_tends_to_the_asymptotic_face(implicit):
    face = solve_asymptotic_shape(Ridges(), K_W, float(implicit.volume[-1]))
    distance = [solve_asymptotic_shape(Ridges(), K_W, float(v)).distance(d)
                for v, d in zip(implicit.volume[2::3], implicit.depth[2::3], strict=True)]
    assert np.all(np.diff(distance) < 0.0)
    assert distance[0] > 0.5
    assert face.distance(implicit.depth[-1]) < 1e-5
    assert face.solves <= 10
    assert np.ptp(Ridges().at(face.depth).pressure_sliding) * K_W < 2e-6 * face.rate


def test_a_crowned_face_grows_into_contact_alike_by_every_way():
    crowned = {"radius": 0.05}
    marched = run_history(Ridges(**crowned), settings(scheme=WearScheme.IMPLICIT))
    reference = run_history(Ridges(**crowned), settings())
    closed = [(rate > 0.0).sum() for rate in reference.rate]
    assert closed[0] < 20
    assert closed[-1] == 49
    assert marched.solves <= reference.solves / 3
    assert marched.volume[-1] == pytest.approx(reference.volume[-1], rel=2e-3, abs=0.0)
    assert np.abs(marched.depth[-1] - reference.depth[-1]).max() < 2e-3 * reference.depth[-1].max()
    face = solve_asymptotic_shape(Ridges(**crowned), K_W, float(marched.volume[-1]))
    assert face.distance(marched.depth[-1]) < 1e-4


def test_asymptotic_face_of_a_crowned_face_leaves_its_corners_unworn():
    model = Ridges(radius=0.01)
    face = solve_asymptotic_shape(model, K_W, 1e-11)
    assert face.solves <= 10
    worn = face.depth > 0.0
    assert np.flatnonzero(~worn).tolist() == [0, 6, 42, 48]
    rate = K_W * model.at(face.depth).pressure_sliding
    np.testing.assert_allclose(rate[worn], face.rate, rtol=1e-5)
    assert np.all(rate[~worn] <= face.rate)


def test_a_looser_tolerance_takes_fewer_periods_where_a_crowned_face_wears_deep():
    """Nodes at the border of the scar come to touch within jumps; the scar is 5 times as deep as the crown is high."""
    crowned = {"radius": 0.01}
    loose, close = (run_history(Ridges(**crowned), settings(
        scheme=WearScheme.IMPLICIT, tolerance=tolerance, cycles=20_000_000)) for tolerance in (0.1, 1e-3))
    height = Ridges(**crowned).gap.max()
    assert close.depth[-1].max() > 5.0 * height
    assert loose.solves < 0.5 * close.solves
    assert loose.volume[-1] == pytest.approx(close.volume[-1], rel=2e-3)
    assert np.abs(loose.depth[-1] - close.depth[-1]).max() < 2e-3 * close.depth[-1].max()


@pytest.mark.parametrize("load_held", [True, False])
def test_nodes_that_touch_ahead_are_those_of_the_contact_with_a_layer(load_held):
    """Forces press, gaps are open or shut by a layer that yields as wear does, and the load stays."""
    model = Ridges(radius=0.02)
    response, rng = model.cycle(SlowState.unworn(49), None)[0], np.random.default_rng(3)
    feedback = Feedback(model.flexibility, model.areas, load_held)
    force, softness = response.mean_pressure * model.areas, np.full(49, 4e-7)
    worn = softness * force * rng.uniform(0.5, 3.0, 49)
    touch = feedback.touching(response, worn, softness)
    before, ahead = response.contact_share > 0.0, np.zeros(49)
    assert np.any(touch != before)
    pressed = np.flatnonzero(touch)
    gap = np.where(before, 0.0, response.mean_opening) + worn - softness * force - model.flexibility @ force
    matrix = np.zeros((pressed.size + 1, pressed.size + 1))
    matrix[:-1, :-1] = (model.flexibility + np.diag(softness))[np.ix_(pressed, pressed)]
    matrix[-1, :-1] = matrix[:-1, -1] = float(load_held)
    matrix[-1, -1] = float(not load_held)
    *ahead[pressed], approach = np.linalg.solve(matrix, np.r_[-gap[pressed], LOAD if load_held else 0.0])
    assert np.all(ahead[pressed] > 0.0)
    opened = gap + model.flexibility @ ahead + softness * ahead + approach
    assert np.all(opened[~touch] > 0.0)
