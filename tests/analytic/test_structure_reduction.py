"""Property: a structure reduced to its contact has the whole one's statics exactly, and its modes ever closer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.structure import matrices as m
from fretflow.structure.reduction import contact_modes as c
from scipy import sparse
from scipy.linalg import eigh, null_space


@pytest.fixture(scope="module")
def beam(structures):
    return structures.lap_beam(15)


def between(beam):
    """Return a beam whose contact points lie halfway between its nodes, so that neighbours share a node's motion."""
    halfway = 0.5 * np.kron(np.eye(beam.contacts - 1, beam.contacts) + np.eye(beam.contacts - 1, beam.contacts, 1),
                            np.eye(3))
    return replace(beam, contact_map=halfway @ beam.contact_map, areas=beam.areas[1:],
                   points=0.5 * (beam.points[1:] + beam.points[:-1]))


@pytest.mark.parametrize("placed", [lambda beam: beam, between], ids=["at nodes", "between nodes"])
def test_constraint_modes_are_the_static_solution_of_the_whole_structure(beam, placed):
    beam = placed(beam)
    reduced = c.reduce_structure(beam)
    assert reduced.rigid_motions == 3
    force = np.sin(np.arange(3.0 * beam.contacts))
    force -= 0.3
    # the whole structure, contact springs of 1e6 N/m in place of the joint, under forces on both faces
    k = beam.stiffness + 1e6 * beam.contact_map.T @ beam.contact_map
    whole = beam.contact_map @ np.linalg.lstsq(k, beam.contact_map.T @ force, rcond=1e-13)[0]
    own = np.linalg.solve(reduced.stiffness + 1e6 * np.eye(len(force)), force)
    assert own == pytest.approx(whole, rel=1e-6, abs=1e-8 * np.abs(whole).max())


def test_closed_and_open_modes_are_those_of_the_whole_structure(beam):
    reduced = c.reduce_structure(beam)
    closed = null_space(beam.contact_map)
    exact = eigh(closed.T @ beam.stiffness @ closed, closed.T @ beam.mass @ closed, eigvals_only=True)[3:9]
    assert reduced.eigenvalues[:6] == pytest.approx(exact, rel=1e-6)
    own = eigh(*c.assembled(reduced), eigvals_only=True)
    whole = eigh(beam.stiffness, beam.mass, eigvals_only=True)
    assert own[3:9] == pytest.approx(whole[6:12], rel=1e-6)  # either half alone is free: three motions are relative


def test_error_of_a_reduction_is_told_and_falls_with_the_modes(beam):
    errors = [c.reduce_structure(beam, modes).error for modes in (4, 8, 16)]
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2] > 0.0
    assert c.reduce_structure(beam).error == 0.0


def test_large_sparse_structures_are_reduced_to_the_same(beam, monkeypatch):
    dense = c.reduce_structure(beam, 12)
    monkeypatch.setattr(c, "DENSE", 10)
    thin = replace(beam, **{name: sparse.csr_matrix(getattr(beam, name)) for name in
                            ("mass", "stiffness", "contact_map")})
    reduced = c.reduce_structure(thin, 12)
    scale = np.abs(dense.stiffness).max()
    assert np.abs(reduced.stiffness - dense.stiffness).max() < 1e-6 * scale
    assert reduced.eigenvalues == pytest.approx(dense.eigenvalues, rel=1e-6)
    assert np.abs(reduced.coupling) == pytest.approx(np.abs(dense.coupling), rel=1e-4, abs=1e-6)
    assert reduced.preload[0] == pytest.approx(dense.preload[0], rel=1e-6, abs=1e-9)
    assert reduced.error == pytest.approx(dense.error, rel=1e-2)


def test_massless_boundary_keeps_the_first_modes_of_a_sprung_joint(beam):
    reduced = c.reduce_structure(beam, 20)
    springs = np.zeros(len(reduced.stiffness) + 20)
    springs[:len(reduced.stiffness)] = 1e9
    frequencies = []
    for massless in (False, True):
        k, mass = c.assembled(reduced, massless)
        k = k + np.diag(springs)
        b = len(reduced.stiffness)
        if massless:  # the boundary follows at once
            k, mass = k[b:, b:] - k[b:, :b] @ np.linalg.solve(k[:b, :b], k[:b, b:]), mass[b:, b:]
        frequencies.append(np.sqrt(eigh(k, mass, eigvals_only=True)[:3]))
    assert frequencies[1] == pytest.approx(frequencies[0], rel=2e-4)


@pytest.mark.parametrize(("change", "words"), [
    (lambda s: {"stiffness": s.stiffness + 1e9 * np.eye(s.size, k=1)}, "K: is not symmetric"),
    (lambda s: {"mass": -s.mass}, "M: is not positive definite"),
    (lambda s: {"stiffness": -s.stiffness}, "K: "),
    (lambda s: {"stiffness": s.stiffness[:-1, :-1]}, "K: has the shape"),
    (lambda s: {"mass": np.where(np.eye(s.size) > 0, np.nan, s.mass)}, "M: holds numbers that are not finite"),
    (lambda s: {"contact_map": np.vstack([s.contact_map[:3], s.contact_map[:-3]])}, "contact_map: its rows depend"),
    (lambda s: {"contact_map": np.vstack([np.zeros((1, s.size)), s.contact_map[1:]])}, "contact_map: row 0 is empty"),
    (lambda s: {"areas": -s.areas}, "areas: must be positive"),
    (lambda s: {"preload": s.preload[:-1]}, "preload: has the shape"),
    (lambda s: {"outputs": {"tip": np.ones(3)}}, "outputs: tip has the shape"),
    (lambda s: {"preload": np.abs(s.preload)}, "preload: the bolts' forces push the whole structure away"),
    (lambda s: {"modal_damping": 3.0}, "modal_damping: 3.0 is no damping ratio"),
])
def test_bad_matrices_are_refused_in_one_line(beam, change, words):
    with pytest.raises(InputError) as caught:
        c.reduce_structure(replace(beam, **change(beam)))
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)


def test_free_motions_of_modal_coordinates_may_have_a_rounded_stiffness(beam):
    """Where modes are coordinates, that of a free motion is zero but for rounding, of either sign."""
    free = sparse.block_diag([beam.stiffness, np.diag([-1e-5, 1e-5])]).toarray()
    assert np.abs(beam.stiffness).max() > 1e9
    padded = {"stiffness": free, "mass": sparse.block_diag([beam.mass, np.eye(2)]).toarray(),
              "contact_map": np.pad(beam.contact_map, ((0, 0), (0, 2))), "preload": np.pad(beam.preload, (0, 2)),
              "outputs": {}, "inputs": {}}
    assert c.reduce_structure(replace(beam, **padded)).rigid_motions == 3 + 2
    with pytest.raises(InputError, match="K: is not positive definite"):
        replace(beam, **{**padded, "stiffness": np.where(free == -1e-5, -1e-2, free)})


def test_a_force_map_is_the_transposed_contact_map_up_to_areas(beam):
    m.check_force_map(beam.contact_map.T * np.repeat(beam.areas, 3), beam.contact_map)
    with pytest.raises(InputError, match="force_map: is not the transposed contact_map"):
        m.check_force_map(-beam.contact_map.T, beam.contact_map)


def test_a_part_that_hangs_loose_is_refused(structures):
    structure = structures.sliders(np.ones(9), np.ones(9))
    loose = np.zeros((structure.size + 8,) * 2)
    mass = np.eye(len(loose))
    loose[:structure.size, :structure.size] = structure.stiffness
    mass[:structure.size, :structure.size] = structure.mass
    wide = np.zeros((27, len(loose)))
    wide[:, :structure.size] = structure.contact_map
    with pytest.raises(InputError, match="a part hangs loose"):
        c.reduce_structure(m.StructureMatrices(mass=mass, stiffness=loose, contact_map=wide, areas=structure.areas,
                                               points=structure.points))
