"""The DLFT Jacobian against central differences, in every contact state that a node can have over a period.

What carries the weight: the prediction of each node is prescribed so that the state is known, and the state
is asserted before the Jacobian is compared, so that no branch of the return mapping goes untested.
"""

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.solvers.dlft.equations import DenseStiffness, DlftEquations
from fretflow.solvers.fourier import to_complex, to_real

HARMONICS, SAMPLES, PENALTY = 2, 64, 3.0
ZERO = [0.0, 0.0, 0.0, 0.0, 0.0]

# coefficients [a0, c1, s1, c2, s2] of the prediction in x, y and z; mu = 0.5
STATES = {
    "stick": ([0.1, 0.2, 0.1, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0, 0.05], [2.0, 0.1, 0.0, 0.0, 0.0]),
    "slip in one direction": ([0.0, 3.0, 0.4, 0.2, 0.1], ZERO, [2.0, 0.0, 0.0, 0.0, 0.0]),
    "slip in two directions": ([0.1, 3.0, 0.4, 0.0, 0.3], [0.2, 0.7, -2.0, 0.3, 0.1],
                               [2.0, 0.0, 0.0, 0.0, 0.0]),
    "slip with varying normal load": ([0.1, 2.0, 0.4, 0.1, 0.3], [0.2, 0.3, -1.0, 0.0, 0.1],
                                      [2.0, 0.7, 0.5, -0.3, 0.1]),
    "separation": ([0.1, 1.0, 0.4, 0.0, 0.3], [0.2, 0.7, -1.0, 0.0, 0.1], [-3.0, 0.5, 0.4, 0.1, 0.0]),
    "re-contact": ([0.1, 1.0, 0.4, 0.0, 0.3], [0.2, 0.7, -1.0, 0.0, 0.1], [0.5, 1.5, 0.4, 0.3, 0.2]),
    "stuck after a first slip": ([1.5, 0.2, 0.1, 0.0, 0.05], [0.3, 0.1, 0.2, 0.0, 0.0],
                                 [2.0, 0.1, 0.0, 0.0, 0.0]),
}


def observed_state(evaluation, node):
    closed = evaluation.trial_normal[:, node] > 0.0
    slips = closed & (np.abs(evaluation.friction.trial[:, node]) > evaluation.limit[:, node])
    first = np.any(np.abs(evaluation.friction.first_trial[:, node]) > evaluation.limit[:, node])
    lateral = np.any(evaluation.drive[:, node, 1] != 0.0) and np.ptp(evaluation.drive[:, node, 1]) > 1e-9
    varying = np.ptp(evaluation.limit[closed, node]) > 1e-9 if closed.any() else False
    if not closed.any():
        return "separation"
    if not closed.all():
        return "re-contact"
    if not slips.any():
        return "stuck after a first slip" if first else "stick"
    if varying:
        return "slip with varying normal load"
    return "slip in two directions" if lateral else "slip in one direction"


def equations_and_point(drives, seed, gap=None):
    """Return equations of coupled nodes and the point at which node m has prediction `drives[m]`."""
    rng = np.random.default_rng(seed)
    nodes = len(drives)
    size = 3 * nodes
    root, damp = rng.normal(size=(size, size)), rng.normal(size=(size, size))
    k, c = root @ root.T / size + np.eye(size), damp @ damp.T / size
    stiffness = np.array([k - 0.3 * h**2 * np.eye(size) + 0.2j * h * c for h in range(HARMONICS + 1)])
    load = rng.normal(size=(HARMONICS + 1, size)) + 0j
    drive = np.array(drives).transpose(2, 0, 1).reshape(2 * HARMONICS + 1, size)
    shifted = stiffness - PENALTY * np.eye(size)
    amplitudes = np.array([np.linalg.solve(z, w + g) for z, w, g in
                           zip(shifted, to_complex(drive), load, strict=True)])
    equations = DlftEquations(stiffness=DenseStiffness(stiffness), load=load,
                              gap=np.zeros(nodes) if gap is None else gap,
                              law=Coulomb(friction_coefficient=0.5), penalty=PENALTY, samples=SAMPLES)
    return equations, to_real(amplitudes)


def jacobian_errors(equations, u, step=1e-6):
    rng = np.random.default_rng(7)
    apply, _ = equations.linearise(equations.evaluate(u))
    for _ in range(4):
        v = rng.normal(size=u.shape)
        difference = equations.evaluate(u + step * v).residual - equations.evaluate(u - step * v).residual
        exact = apply(v.ravel()).reshape(u.shape)
        yield np.abs(exact - difference / (2 * step)).max() / np.abs(exact).max()


@pytest.mark.parametrize("state", STATES)
def test_jacobian_in_one_state(state):
    equations, u = equations_and_point([STATES[state]], seed=1)
    assert observed_state(equations.evaluate(u), 0) == state
    assert max(jacobian_errors(equations, u)) < 1e-6


def test_jacobian_of_coupled_nodes_in_all_states_at_once():
    equations, u = equations_and_point(list(STATES.values()), seed=2)
    evaluation = equations.evaluate(u)
    assert [observed_state(evaluation, m) for m in range(len(STATES))] == list(STATES)
    assert max(jacobian_errors(equations, u)) < 1e-6


def settling_drives(nodes, seed):
    """Return predictions whose mean drags nodes along in the first periods, then leaves them stuck."""
    rng = np.random.default_rng(seed)
    for _ in range(nodes):
        mean, swing = rng.uniform(0.8, 2.0), rng.uniform(0.1, 0.4, size=(2, 4)) * rng.choice([-1, 1], size=(2, 4))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        yield [mean * np.cos(angle), *swing[0]], [mean * np.sin(angle), *swing[1]], [2.0, 0.3, 0.2, 0.0, 0.1]


def test_jacobian_of_nodes_that_came_to_rest_on_the_disc():
    """Round-off leaves some just inside of the disc, others outside; it must not matter to the derivative."""
    equations, u = equations_and_point(list(settling_drives(24, seed=11)), seed=5)
    at = equations.evaluate(u)
    excess = np.max(np.abs(at.friction.trial) - at.limit, axis=0)
    rests = np.abs(excess) < 1e-12
    assert np.sum(excess[rests] > 0.0) > 1
    assert np.sum(excess[rests] <= 0.0) > 1
    assert rests.sum() > 12
    assert max(jacobian_errors(equations, u, step=1e-7)) < 1e-6


def test_jacobian_with_a_gap():
    """A gap of 0.55 turns an always closed node into one that opens: the prediction loses eps times gap."""
    drive = STATES["slip with varying normal load"]
    equations, u = equations_and_point([drive], seed=3, gap=np.array([0.55]))
    assert observed_state(equations.evaluate(u), 0) == "re-contact"
    assert max(jacobian_errors(equations, u)) < 1e-6


def test_an_ever_sticking_node_stays_at_its_place():
    """Its residual is eps u whatever the dynamic stiffness: the contact takes all of the linear residual."""
    equations, u = equations_and_point([STATES["stick"]], seed=4)
    assert equations.evaluate(u).residual == pytest.approx(PENALTY * u, rel=1e-12)


def test_derivatives_of_many_nodes_are_those_of_each(monkeypatch):
    """Nodes are marched in parts to bound memory; the parts must not change anything."""
    equations, u = equations_and_point(list(STATES.values()), seed=2)
    at = equations.evaluate(u)
    whole = equations.force_derivative(at)
    monkeypatch.setattr("fretflow.solvers.dlft.march.NODES_AT_ONCE", 2)
    assert equations.force_derivative(at) == pytest.approx(whole, rel=1e-13, abs=1e-15)


def test_large_systems_take_the_same_product_in_single_precision(monkeypatch):
    equations, u = equations_and_point(list(STATES.values()), seed=2)
    v = np.random.default_rng(3).normal(size=u.size)
    exact = equations.linearise(equations.evaluate(u))[0](v)
    monkeypatch.setattr("fretflow.solvers.dlft.equations.LARGE", 1)
    single = equations.linearise(equations.evaluate(u))[0](v)
    assert 0.0 < np.abs(single - exact).max() < 1e-5 * np.abs(exact).max()
