"""Factors of the contact's equations that follow its state, and Newton's steps by them."""

from __future__ import annotations

import numpy as np
import pytest
from fretflow.contact.kernels.equations import SEPARATION, SLIP, STICK, Contact, try_forces, turn_cone, unknowns
from fretflow.contact.kernels.factors import (
    CLOSE,
    WORTH,
    empty_factor,
    factorise_state,
    krylov_step,
    newton_step,
    reusable,
    solve,
)

NODES = 8
FIRST = np.array([SLIP, SLIP, SLIP, STICK, STICK, SLIP, SEPARATION, SLIP], dtype=np.int8)
CHANGES = {
    "a node begins to slip": {3: SLIP},
    "a node sticks": {1: STICK},
    "a node opens": {2: SEPARATION},
    "a node closes": {6: SLIP},
    "all at once": {0: STICK, 2: SEPARATION, 3: SLIP, 4: SEPARATION, 6: STICK},
    "nothing": {},
}


class Faces:
    """A contact of `NODES` nodes in motion: forces and cones at a displacement."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        half = random.standard_normal((3 * NODES, 3 * NODES))
        stiffness = half @ half.T + 3 * NODES * np.eye(3 * NODES)
        ones = np.ones(NODES)
        self.data = Contact(stiffness, np.zeros((3 * NODES, 1)), np.zeros((1, 3 * NODES)), np.zeros((1, 1)), 0.0 * ones,
                            0.6 * ones, ones, 0.1, 0.05, 5.0)
        self.u, self.previous = random.standard_normal((2, 3 * NODES))
        self.pull = stiffness @ self.u - np.tile([1.0, 0.5, 9.0], NODES) * (1.0 + random.random(3 * NODES))

    def at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return force, trial force and cone at the displacement u."""
        f, trial, cone = self.data.stiffness @ u - self.pull, np.empty((3, NODES)), np.empty((4, NODES))
        try_forces(self.data, u, f, self.previous, trial)
        turn_cone(self.data, f, trial, 1.0, cone)
        return f, trial, cone

    def residual(self, u: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the equations' residual, written out."""
        f, trial, cone = self.at(u)
        unknown = unknowns(state)[1]
        wanted = np.zeros(3 * NODES)
        for i in np.flatnonzero(state == SLIP):
            wanted[3 * i:3 * i + 2] = cone[0, i] * trial[:2, i]
        return (f - wanted)[unknown]

    def derivative(self, state: np.ndarray) -> np.ndarray:
        """Return its derivative by the unknowns, by central differences."""
        unknown, step = unknowns(state)[1], 1e-6
        columns = []
        for dof in unknown:
            up, down = self.u.copy(), self.u.copy()
            up[dof], down[dof] = up[dof] + step, down[dof] - step
            columns.append((self.residual(up, state) - self.residual(down, state)) / (2.0 * step))
        return np.array(columns).T


def changed(change: dict[int, int]) -> np.ndarray:
    state = FIRST.copy()
    for i, kind in change.items():
        state[i] = kind
    return state


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_bordered_factors_are_those_of_the_new_state(change):
    """Whatever a change of the state adds and takes away, the same solution as by the derivative itself."""
    faces, factor, state = Faces(), empty_factor(3 * NODES), changed(change)  # room for all that is appended
    _, trial, cone = faces.at(faces.u)
    assert factorise_state(faces.data, trial, cone, FIRST, factor, 0)
    kept = int(factor.size[0])
    assert factorise_state(faces.data, trial, cone, state, factor, kept)
    assert factor.size[0] >= kept
    unknown = unknowns(state)[1]
    columns = np.random.default_rng(1).standard_normal((2, len(unknown)))
    expected = np.linalg.solve(faces.derivative(state), columns.T).T
    solve(factor, unknown, columns)
    assert columns == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_states_that_come_and_go_are_followed_many_times():
    """Nodes that stick and slip again are unknowns anew; blocks that serve no more are left out."""
    faces, factor, random = Faces(2), empty_factor(NODES), np.random.default_rng(3)
    _, trial, cone = faces.at(faces.u)
    assert factorise_state(faces.data, trial, cone, FIRST, factor, 0)
    bordered = 0
    for _ in range(30):
        state = factor.state.copy()
        state[random.integers(NODES)] = random.choice([STICK, SLIP, SEPARATION])
        kept = reusable(factor, state)
        bordered += kept > 0
        assert factorise_state(faces.data, trial, cone, state, factor, kept)
        unknown = unknowns(state)[1]
        right = random.standard_normal((1, len(unknown)))
        expected = np.linalg.solve(faces.derivative(state), right[0])
        solve(factor, unknown, right)
        assert right[0] == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert bordered > 10


def test_former_factors_lead_to_newtons_step_of_the_equations_now():
    """GMRES finds the step of the derivative here, with factors of a displacement far from here."""
    faces, factor = Faces(4), empty_factor(WORTH, single=True)
    there = faces.u + 2.0 * np.random.default_rng(5).standard_normal(3 * NODES)
    _, trial, cone = faces.at(there)
    assert factorise_state(faces.data, trial, cone, FIRST, factor, 0)
    _, trial, cone = faces.at(faces.u)
    m, unknown = unknowns(FIRST)
    residual, slope = faces.residual(faces.u, FIRST), faces.derivative(FIRST)
    by_factors = slope @ newton_step(factor, unknown, residual) + residual
    assert np.linalg.norm(by_factors) > 2.0 * CLOSE * np.linalg.norm(residual)
    found, step = krylov_step(faces.data, trial, cone, m, unknown, factor, residual)
    assert found
    assert np.linalg.norm(slope @ step + residual) < 1.001 * CLOSE * np.linalg.norm(residual)


def test_factors_that_do_not_serve_are_told():
    """With factors of another contact altogether the step is not called found."""
    faces, factor = Faces(6), empty_factor(WORTH, single=True)
    _, trial, cone = faces.at(faces.u)
    assert factorise_state(faces.data, trial, cone, FIRST, factor, 0)
    q = int(factor.size[0])
    factor.matrix[:q, :q] = np.diag(10.0 ** np.random.default_rng(7).uniform(-3, 3, q))
    m, unknown = unknowns(FIRST)
    assert not krylov_step(faces.data, trial, cone, m, unknown, factor, faces.residual(faces.u, FIRST))[0]


def test_nothing_is_reused_of_factors_that_there_are_not():
    assert reusable(empty_factor(NODES), FIRST) == 0
