"""Laws over cycles against closed forms, on faces dragged by a given stroke.

What carries the weight: friction that runs in by its own dissipated energy follows the solution of that equation
whatever jumps the error control makes; load, wear coefficient, threshold and powers wear what their integrals say;
with six laws at once both schemes meet the integration of the equations written out, the implicit one in second order.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import WearScheme
from fretflow.effects.catalogue import catalogue
from fretflow.effects.model import EffectModel
from fretflow.effects.wear_threshold import frictional_power
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.recordings.kinds.joints import FRETTING_RIG
from fretflow.wear.history import WearSettings
from fretflow.wear.implicit import Implicit
from fretflow.wear.march import run_history
from fretflow.wear.scheme import WearingJoint
from fretflow.wear.slow import SlowState
from scipy.integrate import solve_ivp

K_W, LOAD, HALF_STROKE, AREA, MU = 1e-14, 60.0, 5e-6, 1e-6, 0.7
RATE = K_W * LOAD / AREA * 4.0 * HALF_STROKE  # of even wear
SCHEMES = list(WearScheme)


def make(name, **values):
    return catalogue()[name]().changed(**values)


def settings(cycles, **changes):
    return WearSettings(**{"coefficient": K_W, "cycles": cycles, "scheme": WearScheme.IMPLICIT, **changes})


def run_in_energy(cycles, effect):
    """Return E of ``dE/dn = 4 mu(E) N X``, in z = exp(E / E_0) linear: ``dz/dn = c (mu_inf z - (mu_inf - mu_0))``."""
    missing = (effect.final - effect.initial) / effect.final
    turns = 4.0 * LOAD * HALF_STROKE / effect.energy * effect.final * cycles
    return effect.energy * np.log(missing + (1.0 - missing) * np.exp(turns))


@pytest.fixture
def run_in():
    return make("friction-run-in", initial=0.3, final=0.85, energy=8.0)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_running_in_follows_its_own_energy_and_converges_with_the_tolerance(dragged, winkler, run_in, scheme):
    tolerances, errors = [4e-2, 2e-2, 1e-2, 5e-3], []
    for tolerance in tolerances:
        history = run_history(dragged(winkler(), [run_in]), settings(40_000, scheme=scheme, tolerance=tolerance))
        exact = run_in_energy(history.cycles, run_in)
        errors.append(np.abs(history.energy - exact).max() / exact[-1])
        # depth alone would allow one jump to the end
        longest = np.diff(history.energy[exact < 2.0 * run_in.energy]).max()
        assert longest < run_in.energy
    assert np.all(errors < np.array(tolerances))
    assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.3)


def test_friction_is_that_of_the_energy(dragged, winkler, run_in):
    model = dragged(winkler(), [run_in])
    history = run_history(model, settings(40_000))
    coefficients = [model.model.problem(history.slow(k)).friction_coefficient for k in range(len(history.cycles))]
    np.testing.assert_allclose(coefficients, 0.85 - 0.55 * np.exp(-history.energy / 8.0), rtol=1e-12)
    np.testing.assert_allclose(coefficients, history.dissipated_energy / (4.0 * LOAD * HALF_STROKE), rtol=1e-12)
    by_default = dragged(winkler(), [run_in.changed(final=None)]).model.problem(history.slow(-1))
    assert float(by_default.friction_coefficient) == pytest.approx(MU - 0.4 * np.exp(-history.energy[-1] / 8.0))


def test_a_drifting_load_wears_what_its_integral_says(dragged, winkler):
    effect = make("normal-load-drift", loss=0.3, settling=2e4)
    model = dragged(winkler(), [effect])
    history = run_history(model, settings(100_000, tolerance=2e-3))
    n = history.cycles
    pressing = n - 0.3 * (n - 2e4 * -np.expm1(-n / 2e4))
    np.testing.assert_allclose(history.depth[1:], np.outer(RATE * pressing[1:], np.ones(9)), rtol=5e-4)
    load = model.areas @ model.cycle(history.slow(-1), None)[0].mean_pressure
    assert load == pytest.approx(LOAD * (1.0 - 0.3 * -np.expm1(-5.0)), rel=1e-12)


@pytest.mark.parametrize("share", [0.2, 4.0])
def test_an_evolving_coefficient_wears_its_integral(dragged, winkler, share):
    effect = make("wear-coefficient-evolution", final_share=share, settling=2e4)
    history = run_history(dragged(winkler(), [effect]), settings(150_000, tolerance=1e-3))
    n = history.cycles
    integral = share * n + (1.0 - share) * 2e4 * -np.expm1(-n / 2e4)
    np.testing.assert_allclose(history.depth[1:], np.outer(RATE * integral[1:], np.ones(9)), rtol=1e-3)


def test_a_threshold_bars_wear_below_and_is_linear_above(dragged, winkler):
    threshold = 5e4
    strokes = HALF_STROKE * np.array([0.2, 0.5, 0.9, 1.2, 2.0, 4.0])
    power = MU * LOAD / AREA * 4.0 * strokes * 100.0
    rates = []
    for stroke in strokes:
        model = dragged(winkler(), [make("wear-threshold", power_density=threshold)], half_stroke=stroke)
        history = run_history(model, settings(1_000))
        rates.append(history.depth[-1] / 1_000)
    expected = K_W / (MU * 100.0) * np.maximum(power - threshold, 0.0)
    assert np.count_nonzero(expected == 0.0) == 2
    for rate, one in zip(rates, expected, strict=True):
        np.testing.assert_allclose(rate, one, rtol=1e-9, atol=0.0)


def test_the_power_of_the_nodes_is_the_dissipated_one(dragged, winkler):
    gap = 1e-7 * np.linspace(-1.0, 1.0, 9)**2
    problem = winkler(gap=gap)
    response, _ = dragged(problem).cycle(dragged(problem).initial(), None)
    power = frictional_power(response, problem)
    assert problem.interface.areas @ power == pytest.approx(100.0 * response.dissipated_energy, rel=1e-12, abs=0.0)
    np.testing.assert_allclose(power, MU * 100.0 * response.pressure_sliding, rtol=1e-12)


def test_the_power_law_has_its_exponents_as_slopes(dragged, winkler):
    effect = make("wear-power-law", pressure_exponent=0.4, sliding_exponent=-0.3, frequency_exponent=-0.45)

    def depth(load=60.0, stroke=HALF_STROKE, frequency=100.0):
        problem = winkler(normal_load=load, frequency=frequency)
        return run_history(dragged(problem, [effect], half_stroke=stroke), settings(1_000)).depth[-1].mean()

    share = np.array([0.5, 1.0, 2.0])
    slopes = [np.polyfit(np.log(share), np.log([depth(**{name: value * s}) for s in share]), 1)[0]
              for name, value in (("load", 60.0), ("stroke", HALF_STROKE), ("frequency", 100.0))]
    np.testing.assert_allclose(slopes, [1.4, 0.7, -0.45], atol=1e-9)
    at_reference = depth(load=60.0, stroke=25e-6 / 4.0)
    assert at_reference == pytest.approx(K_W * 60e6 * 25e-6 * 1_000, rel=1e-9, abs=0.0)


WAVE = 2e-8 * (1.0 + np.cos(np.arange(9.0)))
CYCLES, FOUNDATION = 15_360, 4e14
LAWS = {"friction-run-in": {"initial": 0.3, "energy": 20.0}, "normal-load-drift": {"loss": 0.2, "settling": 9e3},
        "wear-coefficient-evolution": {"final_share": 0.4, "settling": 1e4}, "wear-threshold": {"power_density": 1e4},
        "wear-power-law": {"pressure_exponent": 0.25, "sliding_exponent": 0.0, "frequency_exponent": 0.0},
        "third-body": {"retained_fraction": 0.6, "separating_thickness": 2e-7, "residence": 6e3,
                       "edge_residence": 0.1, "modulus": 1e8}}


@pytest.fixture(scope="module")
def integrated(winkler):
    """Return depth, layer and energy at the end of all LAWS, written out for springs and integrated by LSODA."""
    areas = winkler().interface.areas
    stay = 6e3 * (0.1 + 0.9 * (1.0 - np.linspace(-1.0, 1.0, 9)**2))

    def slopes(n, state):
        depth, layer, energy = state[:9], state[9:18], state[18]
        load = LOAD * (1.0 - 0.2 * (1.0 - np.exp(-n / 9e3)))
        mu = MU - (MU - 0.3) * np.exp(-energy / 20.0)
        spring = 1.0 / (1.0 / FOUNDATION + layer / 1e8)
        height = WAVE + depth - layer
        pressure = spring * ((load + areas @ (spring * height)) / (areas @ spring) - height)
        sliding = pressure * 4.0 * HALF_STROKE
        power = mu * 100.0 * sliding
        rate = (K_W * sliding * (0.4 + 0.6 * np.exp(-n / 1e4)) * np.maximum(0.0, 1.0 - 1e4 / power)
                * (pressure / 60e6)**0.25 * np.exp(-layer / 2e-7))
        return np.r_[rate, 0.6 * rate - layer / stay, mu * areas @ sliding]

    solution = solve_ivp(slopes, (0.0, CYCLES), np.zeros(19), method="LSODA", rtol=1e-10, atol=1e-17)
    return {"depth": solution.y[:9, -1], "layer": solution.y[9:18, -1], "energy": solution.y[18, -1]}


def differences(slow, integrated):
    """Return the largest difference of depth, layer and energy, relative to their largest value."""
    marched = {"depth": slow.depth, "layer": slow.memory["third-body.layer_m"], "energy": slow.energy}
    return np.array([np.abs(marched[name] - value).max() / np.max(value) for name, value in integrated.items()])


def lawful(dragged, winkler):
    return dragged(winkler(foundation=FOUNDATION, gap=WAVE), [make(name, **values) for name, values in LAWS.items()])


def test_the_scheme_is_of_second_order_with_many_laws_at_once(dragged, winkler, integrated):
    model, errors = lawful(dragged, winkler), []
    for parts in (16, 32, 64):
        joint = WearingJoint(model, settings(CYCLES))
        now, state = joint.unworn()
        for _ in range(parts):
            end, _, state = Implicit(joint).attempt(now, CYCLES // parts, state)
            now, state = joint.settled(end, state, 1)
        errors.append(differences(now.slow, integrated))
    assert np.all(errors[-1] < 2e-3)
    orders = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0]
    np.testing.assert_allclose(orders, 2.0, atol=0.3)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_error_control_keeps_its_tolerance_with_many_laws_at_once(dragged, winkler, integrated, scheme):
    model, errors = lawful(dragged, winkler), []
    for tolerance in (2e-2, 5e-3):
        slow = run_history(model, settings(CYCLES, tolerance=tolerance, scheme=scheme)).slow(-1)
        errors.append(differences(slow, integrated))
        assert np.all(errors[-1] < tolerance)
    assert np.all(errors[1] < 0.5 * errors[0])


def test_laws_at_their_neutral_parameters_march_as_without(dragged, winkler):
    gap = 2e-8 * (1.0 + np.cos(np.arange(9.0)))
    bare = dragged(winkler(gap=gap))
    bare.has_laws = False
    neutral = [catalogue()[name].neutral().changed(**changes) for name, changes in {
        "friction-run-in": {"initial": MU}, "normal-load-drift": {}, "wear-coefficient-evolution": {},
        "wear-threshold": {}, "wear-power-law": {}, "third-body": {}, "scar-edge": {}}.items()]
    for scheme in SCHEMES:
        expected, history = (run_history(model, settings(30_000, scheme=scheme))
                             for model in (bare, dragged(winkler(gap=gap), neutral)))
        np.testing.assert_array_equal(history.cycles, expected.cycles)
        np.testing.assert_allclose(history.depth, expected.depth, rtol=1e-12)
        np.testing.assert_allclose(history.energy, expected.energy, rtol=1e-12)


def test_wear_may_begin_late_and_pause(dragged, winkler):
    """Without friction enough to wear at first, the run goes on, while one without laws would end."""
    run_in = make("friction-run-in", initial=0.2, final=0.8, energy=5.0)
    threshold = make("wear-threshold", power_density=0.4 * LOAD / AREA * 4.0 * HALF_STROKE * 100.0)
    model = dragged(winkler(), [run_in, threshold])
    history = run_history(model, settings(20_000, tolerance=1e-3))
    begins = np.searchsorted(run_in_energy(np.arange(20_001), run_in), 5.0 * np.log(0.6 / 0.4))
    assert history.volume[history.cycles < 0.9 * begins].max() == 0.0
    grown = np.arange(begins, 20_000)
    friction = 0.8 - 0.6 * np.exp(-run_in_energy(grown, run_in) / 5.0)
    expected = RATE * np.sum(1.0 - 0.4 / friction)
    assert history.depth[-1] == pytest.approx(expected, rel=1e-2, abs=0.0)
    assert history.stopped_by == "cycles"


def test_asperities_feel_the_load_and_the_gap_that_other_effects_leave(winkler):
    """At half the load the springs are those of half the pressure; a gap from elsewhere counts as one of the case."""
    problem = winkler(foundation=1e14)
    asperities = make("contact-stiffness", stiffness=40e6, exponent=0.5, reference_pressure=60e6)
    late = replace(SlowState.unworn(9), cycles=1e9)
    lighter = EffectModel.build(problem, [asperities, make("normal-load-drift", loss=0.5)]).problem(late)
    springs = lighter.structure.flexibility - problem.structure.flexibility
    expected = np.repeat(1.0 / (40e12 * np.sqrt(0.5) * problem.interface.areas), 3)
    np.testing.assert_allclose(np.diag(springs)[0::3], expected[0::3], rtol=1e-9)
    tilt = make("initial-gap", tilt_x=3e-7)
    tilted = tilt.period(problem, late)
    combined, own = (EffectModel.build(*given).problem(late) for given in ((problem, [asperities, tilt]),
                                                                         (tilted, [asperities])))
    np.testing.assert_allclose(combined.interface.gap, own.interface.gap, rtol=1e-12)
    np.testing.assert_allclose(combined.structure.flexibility, own.structure.flexibility, rtol=1e-12)


def test_stiffening_springs_end_as_those_of_the_stiffer_contact(winkler):
    problem = winkler(foundation=1e14)
    soft = make("contact-stiffness", stiffness=40e6, exponent=0.0)
    effect = make("contact-stiffness-evolution", stiffness=40e6, exponent=0.0, gain=1.5, energy=20.0)
    slow = replace(SlowState.unworn(9), energy=20.0)
    grown = 40e6 * (1.0 + 1.5 * (1.0 - np.exp(-1.0)))
    own, other = (one.period(problem, slow).structure for one in (effect, soft.changed(stiffness=grown)))
    np.testing.assert_allclose(own.flexibility, other.flexibility, rtol=1e-12)
    # all nodes moved together along x: bulk and asperities in series, k = 1 / (1/100 + 1/k_c) N/um
    together = own.stiffness[0::3, 0::3].sum()
    assert together == pytest.approx(1.0 / (1.0 / 100e6 + 1.0 / grown), rel=1e-9)
    start = effect.period(problem, replace(slow, energy=0.0)).structure
    np.testing.assert_allclose(start.flexibility, soft.period(problem, slow).structure.flexibility, rtol=1e-12)


def data_of(problem):
    """Return what a period depends on, as one vector; forces at some motion."""
    motion = 1e-5 * np.stack([np.linspace(-1.0, 1.0, 7), np.linspace(1.1, -0.9, 7)], axis=1)
    forces = [np.ravel(force(motion, 30.0 * motion).force) for force in problem.boundary.forces]
    factors = [np.ravel(factor(motion[:, 1], 30.0 * motion[:, 1]).factor) for factor in problem.law.motion_factors]
    return np.concatenate([
        np.ravel(problem.friction_coefficient), problem.interface.gap, problem.boundary.flexibility.ravel(),
        problem.boundary.free_coupling.ravel(),
        [problem.normal_load, problem.law.exponent, problem.law.asymmetry, problem.excitation.amplitude, len(forces),
         len(problem.excitation.overtones)], *forces, *factors])


@pytest.mark.parametrize("name", [name for name, kind in catalogue().items() if FRETTING_RIG in kind.kinds])
def test_effects_that_follow_cycles_say_so(winkler, name):
    """Those that say nothing march by the baseline's error control, so that none may be forgotten."""
    model = EffectModel.build(winkler(foundation=1e14), [catalogue()[name]()])
    start = replace(model.initial(), depth=np.full(9, 1e-6))
    memory = {key: value + 1e-7 if key.startswith(name) and value.shape in ((), (9,)) else value
              for key, value in start.memory.items()}
    later = replace(start, cycles=5e4, energy=30.0, memory=memory)
    one, other = data_of(model.problem(start)), data_of(model.problem(later))
    changed = len(one) != len(other) or bool(np.any(one != other))
    assert changed == catalogue()[name].over_cycles


@pytest.mark.parametrize("strength", [1.0, 2.0])
def test_a_face_worn_by_hundreds_of_its_elastic_depths_stays_settled(monkeypatch, strength):
    """All of it wears alike; jumps far longer than pressure takes to follow left scars of 5 to 17 um."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    counts = (0, 23_900, 126_800, 269_200, 413_700, 530_000)
    rig = small_rig.rig(small_rig.observed({"displacement": 3e-8}, counts, (), 2e-15, 3e-9), np.arange(49))
    rig = replace(rig, problem=rig.problem.vary(amplitude=120.0, frequency=80.0))
    law = make("wear-coefficient-evolution", final_share=2.2, settling=1.6e5)
    end = rig.simulate(Hypothesis(effects=(law,), wear=strength)).steps[-1]
    assert end.depth.mean() > 1e-4  # pressure follows a tenth of a micrometre
    assert np.ptp(end.rate) < 0.02 * end.rate.mean()
    assert end.solves < 50  # with patterns of single nodes, which grew from jump to jump, 59 and 105
