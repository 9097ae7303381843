"""The preconditioner against the inverse where it is exact, and how few iterations it leaves elsewhere.

What carries the weight: nodes that stick, open nodes and a mixture of both have Jacobians that it inverts exactly, in
single precision; one node by itself too, in whatever state.
"""

import numpy as np
import pytest
from fretflow.solvers.dlft.preconditioner import NodePreconditioner, bands
from fretflow.solvers.newton import gmres

NODES, HARMONICS, PENALTY = 6, 2, 2.0
Q = 2 * HARMONICS + 1


def stiffnesses(nodes=NODES, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * nodes, 3 * nodes))
    static = root @ root.T / (3 * nodes) + np.eye(3 * nodes)
    return tuple((static - 0.1 * k * np.eye(3 * nodes)).astype(np.float32) for k in range(HARMONICS + 1))


def jacobian(derivative, stiffness):
    nodes = len(derivative)
    size = Q * 3 * nodes
    by_node = np.zeros((Q, nodes, 3, Q, nodes, 3))
    for m in range(nodes):
        by_node[:, m, :, :, m, :] = derivative[m]
    d, z = by_node.reshape(size, size), np.zeros((Q, 3 * nodes, Q, 3 * nodes))
    for k in range(Q):
        z[k, :, k] = stiffness[(k + 1) // 2]
    return (np.eye(size) - d) @ z.reshape(size, size) + PENALTY * d


def states(**held):
    """Return D of nodes that are held, or free, at all harmonics, by direction."""
    derivative = np.zeros((NODES, Q, 3, Q, 3))
    for direction, nodes in held.items():
        for m in nodes:
            derivative[m, np.arange(Q), "xyz".index(direction), np.arange(Q), "xyz".index(direction)] = 1.0
    return derivative


@pytest.mark.parametrize("derivative", [
    states(), states(x=range(NODES), y=range(NODES), z=range(NODES)), states(z=range(NODES)),
    states(x=[0, 3], y=[0, 3], z=[0, 1, 3, 5])], ids=["open", "stuck", "sliding", "mixed"])
def test_exact_where_nodes_stick_slide_or_are_open(derivative):
    exact = jacobian(derivative, stiffnesses())
    approximate = NodePreconditioner(derivative, stiffnesses(), PENALTY)
    v = np.random.default_rng(1).normal(size=len(exact))
    assert exact @ approximate(v) == pytest.approx(v, abs=2e-5)


def test_few_iterations_where_states_couple_harmonics():
    """Each node between held and free, all harmonics and directions coupled; a stiffness of wide range."""
    nodes, rng = 20, np.random.default_rng(2)
    directions, _ = np.linalg.qr(rng.normal(size=(3 * nodes, 3 * nodes)))
    static = (directions * np.geomspace(1e-2, PENALTY, 3 * nodes)) @ directions.T
    derivative = (rng.uniform(0.0, 1.0, (nodes, 1, 1, 1, 1)) * np.eye(3 * Q).reshape(1, Q, 3, Q, 3)
                  + 0.1 * rng.normal(size=(nodes, Q, 3, Q, 3)))
    exact, right = jacobian(derivative, (static,) * (HARMONICS + 1)), rng.normal(size=Q * 3 * nodes)
    approximate = NodePreconditioner(derivative, (static.astype(np.float32),) * (HARMONICS + 1), PENALTY)
    x, iterations = gmres(lambda v: exact @ v, right, approximate, 1e-8)
    _, without = gmres(lambda v: exact @ v, right, lambda v: v, 1e-8)
    assert exact @ x == pytest.approx(right, abs=1e-6)
    assert iterations < 0.4 * without


@pytest.mark.parametrize(("harmonics", "first"), [(0, (0,)), (3, (0, 1, 2, 3)), (5, (0, 1, 2, 3, 4)),
                                                  (15, (0, 1, 2, 3, 4, 8)), (16, (0, 1, 2, 3, 4, 8, 16))])
def test_harmonics_share_matrices_by_octaves(harmonics, first):
    begin, end = bands(harmonics)
    assert begin == first
    assert [k for a, b in zip(begin, end, strict=True) for k in range(a, b)] == list(range(harmonics + 1))
