"""The marched period: states repeat, and a long plain march, which carries the weight, ends there too."""

import json
from pathlib import Path

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb, audit_contact, return_mapping
from fretflow.core.errors import AuditError, InputError
from fretflow.solvers.dlft.march import friction_derivative, periodic_friction
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix

PEERS = Path(__file__).parents[1] / "data" / "peers"


def march_period(state, increments, limit):
    """Return the forces of one period, sample after sample."""
    force = np.empty_like(increments)
    for j in range(len(limit)):
        state = force[j] = return_mapping(state + increments[j], limit[j])
    return force


def random_period(nodes=40, samples=96, seed=5):
    """Return drives and limits of nodes that stick, slip and open, weakly and strongly."""
    rng = np.random.default_rng(seed)
    basis = synthesis_matrix(3, samples)
    decay = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.1, 0.1])[:, None]
    x, y, z = (basis @ (decay * rng.normal(size=(7, nodes))) for _ in range(3))
    return (x + 1j * y) * rng.uniform(0.2, 2.0, nodes), np.maximum(0.5 * (1.5 + z), 0.0)


def test_the_state_repeats_and_a_long_march_ends_there():
    drive, limit = random_period()
    period = periodic_friction(drive, limit)
    assert period.periods > 2  # otherwise the acceleration is not exercised
    force = march_period(period.force[-1], drive - np.roll(drive, 1, axis=0), limit)
    assert np.abs(force - period.force).max() < 1e-12
    state = drive[-1]
    for _ in range(1000):
        state = march_period(state, drive - np.roll(drive, 1, axis=0), limit)[-1]
    assert np.abs(state - period.force[-1]).max() < 1e-8


def test_two_periods_of_marching_are_not_enough():
    """The reason why the state is iterated to repeat."""
    drive, limit = random_period()
    increments = drive - np.roll(drive, 1, axis=0)
    state = drive[-1]
    for _ in range(2):
        state = march_period(state, increments, limit)[-1]
    assert np.abs(state - periodic_friction(drive, limit).force[-1]).max() > 1e-4


def test_return_mapping_is_the_nearest_point_of_the_disc():
    """Against a brute search over the disc."""
    rng = np.random.default_rng(0)
    trial = rng.normal(size=20) + 1j * rng.normal(size=20)
    radius, angle = np.meshgrid(np.linspace(0, 0.8, 201), np.linspace(0, 2 * np.pi, 721))
    disc = (radius * np.exp(1j * angle)).ravel()
    nearest = disc[np.abs(disc[None] - trial[:, None]).argmin(axis=1)]
    assert np.abs(return_mapping(trial, np.full(20, 0.8)) - nearest).max() < 6e-3


@pytest.mark.parametrize("case", json.loads((PEERS / "jenkins_closed_form_tmdsimpy.json").read_text()),
                         ids=lambda c: f"A={c['A']}, {c['Nt']} samples")
def test_jenkins_element_against_griffin_and_another_code(case):
    """An elastic dry-friction element is the marched period with drive k_t u and a constant limit."""
    tau = 2 * np.pi * np.arange(case["Nt"]) / case["Nt"]
    drive = (case["k"] * case["A"] * np.cos(tau))[:, None] + 0j
    force = periodic_friction(drive, np.full(drive.shape, case["Fs"])).force.real
    coefficients = (analysis_matrix(3, case["Nt"]) @ force)[:, 0]
    assert coefficients == pytest.approx(case["tmdsimpy"], abs=1e-12)
    closed = [case["closed_cos"], case["closed_sin"]]
    assert coefficients[1:3] == pytest.approx(closed, abs=20.0 / case["Nt"]**2)


@pytest.mark.parametrize("point", json.loads((PEERS / "xcheck_sdof_jenkins_tmd.json").read_text()),
                         ids=lambda p: f"omega={p['w']}")
def test_oscillator_with_jenkins_element_against_three_codes(point):
    """With m = k = 1, c = 0.05, k_t = 1, limit 0.5, F = 1; balanced here, friction from the library."""
    basis, analysis, w = synthesis_matrix(3, 128), analysis_matrix(3, 128), point["w"]
    limit = np.full((128, 1), 0.5)

    def residual(a, derivative=False):
        period = periodic_friction((basis @ a)[:, None] + 0j, limit)
        force = analysis @ period.force.real[:, 0]
        linear = np.zeros((7, 7))
        linear[0, 0] = 1.0
        for h in (1, 2, 3):
            own, damping = 1 - (h * w)**2, 0.05 * h * w
            linear[2 * h - 1:2 * h + 1, 2 * h - 1:2 * h + 1] = [[own, damping], [-damping, own]]
        if derivative:
            slopes = friction_derivative(period, limit, np.zeros_like(limit), basis, analysis)
            return linear + slopes[0, :, 0].real
        return linear @ a + force - np.eye(7)[1]

    expected = np.array([0, point["c1"], point["s1"], 0, 0, point["c3"], point["s3"]])
    root = 1.2 * expected
    for _ in range(12):
        root = root - np.linalg.solve(residual(root, derivative=True), residual(root))
    assert root == pytest.approx(expected, abs=1e-10)


def sliding_contact():
    opening = np.zeros((4, 1))
    slip = np.array([[1e-6], [0.0], [-1e-6], [0.0]]) + 0j
    force = np.array([[[-5.0, 0.0, 10.0]], [[-3.0, 0.0, 10.0]], [[5.0, 0.0, 10.0]], [[0.0, 0.0, 10.0]]])
    return opening, force, slip, np.full((4, 1), 5.0)


def test_the_audit_passes_a_lawful_contact():
    audit = audit_contact(*sliding_contact())
    assert max(audit) == 0.0


@pytest.mark.parametrize(("change", "word"), [
    (lambda o, f, s: f.__setitem__((1, 0, 2), -0.1), "tension"),
    (lambda o, f, s: o.__setitem__((1, 0), -1e-7), "penetration"),
    (lambda o, f, s: o.__setitem__((1, 0), 1e-7), "complementarity"),
    (lambda o, f, s: f.__setitem__((1, 0, 1), 4.5), "cone"),
    (lambda o, f, s: f.__setitem__((0, 0, 0), 5.0), "slip_direction"),
    (lambda o, f, s: s.__setitem__((1, 0), 1e-7), "slip_direction"),
])
def test_the_audit_names_each_violation(change, word):
    opening, force, slip, limit = sliding_contact()
    change(opening, force, slip)
    with pytest.raises(AuditError, match=word):
        audit_contact(opening, force, slip, limit)


@pytest.mark.parametrize("mu", [-0.1, np.nan, np.array([0.5, -0.5])])
def test_impossible_friction_is_refused(mu):
    with pytest.raises(InputError, match="friction_coefficient"):
        Coulomb(friction_coefficient=np.asarray(mu))
