"""Wear of bolted interfaces: volume follows energy, a held load wears to even pressure, and springs to none.

What carries the weight: closed forms. With one friction coefficient the worn volume is K_w / mu times the energy,
point by point; a plate under a force wears until every point sinks at one rate; nodes that springs press wear until
the springs have relaxed, each by its load over its stiffness.
"""

from __future__ import annotations

import fretflow as ff
import numpy as np
import pytest
from fretflow.effects.bolted_cycle import BoltedCycle
from fretflow.wear.asymptotic import solve_asymptotic_shape

K_W, MU = 1e-14, 0.5


def plate(springs, areas, force):
    """Return a joint of a plate on one spring along x, pressed by a force to nodes that hang on `springs` (m,), N/m."""
    m = len(springs)
    size = 3 + 3 * m
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    mass[:3, :3] = 2.0 * np.eye(3)
    stiffness[0, 0], stiffness[1, 1] = 4e4, 1e11  # along z nothing but the nodes holds it
    for j, spring in enumerate(springs):
        node = 3 + 3 * j + np.arange(3)
        for axis, k in enumerate((1e3 * spring, 1e3 * spring, spring)):
            own = np.ix_([axis, node[axis]], [axis, node[axis]])
            stiffness[own] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    preload = np.zeros(size)
    preload[2] = -1.0
    matrices = ff.StructureMatrices(mass=mass, stiffness=stiffness, contact_map=np.eye(size)[3:], areas=areas,
                                    points=np.column_stack([np.arange(m), np.zeros((m, 2))]), preload=preload)
    return ff.BoltedJoint(structure=ff.reduce_structure(matrices), law=ff.Coulomb(MU), bolt_load=force)


def test_worn_volume_is_the_energy_s_point_by_point(structures):
    joint = ff.BoltedJoint(structure=ff.reduce_structure(structures.lap_beam(25)), law=ff.Coulomb(MU), bolt_load=6e3)
    history = ff.march_wear(BoltedCycle(joint, 1e-4), ff.Archard(K_W), cycles=3_000_000)
    assert history.volume[0] == 0.0
    assert len(history.cycles) > 3
    wears = history.rate > 0.0
    assert wears[0].any()
    assert not wears.all()  # partial slip
    rate = history.rate @ joint.structure.areas
    assert rate == pytest.approx(K_W / MU * history.dissipated_energy, rel=1e-6)
    assert history.volume[-1] == pytest.approx(K_W / MU * history.energy[-1], rel=0.02)  # to the march's tolerance


def test_a_plate_under_a_force_wears_to_one_rate():
    springs, areas = np.array([2e6, 3e6, 5e6, 4e6, 1e6]), 1e-6 * np.array([1.0, 2.0, 1.0, 0.5, 1.5])
    cycle = BoltedCycle(plate(springs, areas, 60.0), 1e-8, mode=2)  # along x, 100 N, of which friction takes 30
    before = cycle.cycle(cycle.initial(), None)[0].mean_pressure
    assert np.ptp(before) > 0.5 * before.mean()
    asymptotic = solve_asymptotic_shape(cycle, K_W, 1e-9)
    pressed = cycle.cycle(cycle.initial().after(1.0, asymptotic.depth, 0.0), None)[0].mean_pressure
    assert pressed == pytest.approx(60.0 / areas.sum(), rel=1e-3)
    assert areas @ asymptotic.depth == pytest.approx(1e-9, rel=1e-6)
    marched = ff.march_wear(cycle, ff.Archard(K_W), cycles=round(1e-9 / (areas.sum() * asymptotic.rate)))
    shape = asymptotic.depth - asymptotic.depth.mean()
    assert marched.depth[-1] - marched.depth[-1].mean() == pytest.approx(shape, abs=0.02 * np.abs(shape).max())


def test_nodes_on_springs_wear_until_these_have_relaxed(structures):
    springs, limits = np.array([1e4, 2e4, 4e4]), np.array([1.0, 3.0, 2.0])  # each N at a friction of 1
    reduced = ff.reduce_structure(structures.sliders(springs, limits))
    joint = ff.BoltedJoint(structure=reduced, law=ff.Coulomb(1.0), bolt_load=1.0)
    ended = solve_asymptotic_shape(BoltedCycle(joint, 1e-2), K_W, 1.0)
    assert ended.rate == 0.0
    assert ended.depth == pytest.approx(limits / springs, rel=1e-6)
