"""Craig-Bampton reduction of a real specimen against its full model.

What carries the weight: the full model is solved here by SciPy alone, from the assembled matrices, and the
reduced one must give its static flexibility to round-off and its frequencies to 0.1 %, better with more modes.
"""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from fretflow.case import config
from fretflow.core.errors import AuditError, InputError, MeshError
from fretflow.core.records import record
from fretflow.structure.fem.elasticity import assemble
from fretflow.structure.fem.mesh_file import read_mesh
from fretflow.structure.reduction import craig_bampton
from fretflow.structure.reduction.modes import _residual_vectors, component_modes, natural_modes
from fretflow.structure.reduction.reduce import reduce_specimen
from fretflow.structure.two_mass_rig.joint import RigJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow_meshes.specimen import Side, build_specimen
from mpi4py import MPI
from petsc4py import PETSc

pytestmark = pytest.mark.fem

SPECIMEN = config.Specimen()


@record
class Full:
    """A specimen, its assembled body and its matrices in SciPy."""

    path: object
    summary: object
    body: object
    stiffness: object
    mass: object
    observation: int


@pytest.fixture(scope="module", params=["square", "round"])
def full(request, tmp_path_factory):
    specimen = config.Specimen(body=request.param)
    path = tmp_path_factory.mktemp("specimen") / "upper.msh"
    summary = build_specimen(specimen, config.Mesh(contact_elements=4), Side.UPPER, path)
    body = assemble(read_mesh(path, MPI.COMM_WORLD), specimen, 1)
    matrices = []
    for matrix in (body.stiffness, body.mass):
        indptr, indices, data = matrix.getValuesCSR()
        matrices.append(sparse.csr_matrix((data, indices, indptr), shape=matrix.getSize()))
    observation = body.nearest_inner_node(summary.observation_point)[0]
    yield Full(path=path, summary=summary, body=body, stiffness=matrices[0], mass=matrices[1],
               observation=observation)
    body.destroy()


def dofs(nodes):
    return (3 * np.atleast_1d(nodes)[:, None] + np.arange(3)).ravel()


def clamped_full(full):
    """Return the full frequencies (Hz) with the clamped face fixed, by SciPy."""
    free = np.setdiff1d(np.arange(full.body.full_dofs), dofs(full.body.clamped.nodes))
    squares = sparse_linalg.eigsh(full.stiffness[free][:, free].tocsc(), 10, full.mass[free][:, free], sigma=0.0,
                                  return_eigenvectors=False)
    return np.sqrt(np.sort(squares)) / (2 * np.pi)


def test_natural_modes_are_those_of_another_solver(full):
    """Each shape meets K x = omega^2 M x in the free DOFs, rests where clamped, and has unit modal mass."""
    modes = natural_modes(full.body, 10)
    assert modes.frequency == pytest.approx(clamped_full(full), rel=1e-9)
    free = np.setdiff1d(np.arange(full.body.full_dofs), dofs(full.body.clamped.nodes))
    for frequency, shape in zip(modes.frequency, modes.shape.reshape(10, -1), strict=True):
        inertia = (2.0 * np.pi * frequency) ** 2 * (full.mass @ shape)
        assert np.abs((full.stiffness @ shape - inertia)[free]).max() < 1e-7 * np.abs(inertia).max()
        assert shape @ full.mass @ shape == pytest.approx(1.0, rel=1e-9)
        assert shape.max() >= -shape.min()
    assert not modes.shape[:, full.body.clamped.nodes].any()


def test_frequencies_within_a_tenth_of_a_percent_and_better_with_more_modes(full):
    exact = clamped_full(full)
    worst, mean = [], []
    for count in (5, 10, 20, 40):
        modes = component_modes(full.body, full.observation, count)
        reduced = craig_bampton.clamped_frequencies(modes, 3 * len(full.body.contact.nodes), 10)
        error = reduced / exact - 1.0
        assert error.min() > -1e-9
        worst.append(error.max())
        mean.append(error.mean())
    assert worst[1] < 1e-3
    assert np.all(np.diff(worst) < 0.0)
    assert mean[-1] < 0.2 * mean[1]


@pytest.mark.parametrize("leaf", [5, 50, 10**6])
def test_constraint_modes_have_the_inertia_of_modes_that_are_formed(full, monkeypatch, leaf):
    """SciPy forms all modes of the contact with the clamped face held, however finely the body is divided."""
    monkeypatch.setattr("fretflow.structure.reduction.condensation.LEAF", leaf)
    component = component_modes(full.body, full.observation, 5)
    contact, seen = dofs(full.body.contact.nodes), dofs(full.observation)
    inner = np.setdiff1d(np.arange(full.body.full_dofs), np.r_[contact, seen, dofs(full.body.clamped.nodes)])
    modes = np.zeros((full.body.full_dofs, len(contact)))
    modes[contact] = np.eye(len(contact))
    across = full.stiffness[inner][:, contact].toarray()
    modes[inner] = -sparse_linalg.splu(full.stiffness[inner][:, inner].tocsc()).solve(across)
    n = len(contact)
    for matrix, own in ((full.stiffness, component.constraint_stiffness), (full.mass, component.constraint_mass)):
        exact = modes.T @ (matrix @ modes)
        size = np.sqrt(np.diag(exact))
        assert np.all(np.abs(own[:n, :n] - exact) < 1e-9 * np.outer(size, size))


def test_free_body_with_rigid_clamped_face(full):
    """With no support at all, the reduced body keeps six rigid motions and the first elastic frequencies."""
    body = full.body
    clamped = dofs(body.clamped.nodes)
    free = np.setdiff1d(np.arange(body.full_dofs), clamped)
    arm = body.clamped.points - body.clamped.centroid
    spin = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2).reshape(-1, 3)
    motion = sparse.lil_matrix((body.full_dofs, len(free) + 6))
    motion[free, np.arange(len(free))] = 1.0
    motion[clamped, len(free):] = np.hstack([np.tile(np.eye(3), (len(arm), 1)), spin])
    motion = motion.tocsr()
    stiffness, mass = ((motion.T @ m @ motion).tocsc() for m in (full.stiffness, full.mass))
    squares = np.sort(sparse_linalg.eigsh(stiffness, 10, mass, sigma=-1e9, return_eigenvectors=False))
    modes = component_modes(body, full.observation, 10)
    reduced = scipy.linalg.eigh(modes.stiffness, modes.mass, eigvals_only=True)[:10]
    assert np.all(np.abs(reduced[:6]) < 1e-7 * reduced[6])
    assert np.sqrt(reduced[6:] / squares[6:]) == pytest.approx(1.0, abs=1e-3)


def test_static_flexibility_is_that_of_the_full_model(full):
    body = full.body
    free = np.setdiff1d(np.arange(body.full_dofs), dofs(body.clamped.nodes))
    masters = np.concatenate([dofs(body.contact.nodes), dofs(full.observation)])
    position = np.searchsorted(free, masters)
    loads = np.zeros((len(free), len(masters)))
    loads[position, np.arange(len(masters))] = 1.0
    exact = sparse_linalg.splu(full.stiffness[free][:, free].tocsc()).solve(loads)[position]
    modes = component_modes(body, full.observation, 3)
    n = 3 * len(body.contact.nodes)
    kept = np.concatenate([np.arange(n), np.arange(n + 6, n + 9)])
    reduced = np.linalg.inv(modes.stiffness[np.ix_(kept, kept)])
    assert np.abs(reduced - exact).max() < 1e-10 * np.abs(exact).max()


def test_static_stiffness_is_that_of_the_full_model(full):
    """On all masters, and condensed onto the contact: a pair of the same specimens has half of it."""
    specimen, _ = reduce_specimen(full.path, full.summary, SPECIMEN, config.Reduction(), 1, MPI.COMM_SELF)
    n = specimen.contact_size
    free = np.setdiff1d(np.arange(full.body.full_dofs), dofs(full.body.clamped.nodes))
    masters = np.concatenate([dofs(full.body.contact.nodes), dofs(full.observation)])
    kept = np.r_[:n, specimen.observation]
    pair = RigJoint(upper=specimen, lower=specimen, rig=LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01))
    for condensed, own in ((specimen.stiffness[np.ix_(kept, kept)], masters),
                           (2.0 * pair.quasi_static().stiffness, masters[:n])):
        inner = np.setdiff1d(free, own)
        across = full.stiffness[inner][:, own].toarray()
        factor = sparse_linalg.splu(full.stiffness[inner][:, inner].tocsc(), "MMD_AT_PLUS_A",
                                    options={"SymmetricMode": True})
        exact = full.stiffness[own][:, own].toarray() - across.T @ factor.solve(across)
        assert np.abs(condensed - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.fixture(scope="module")
def reduced(tmp_path_factory):
    path = tmp_path_factory.mktemp("reduced") / "lower.msh"
    summary = build_specimen(SPECIMEN, config.Mesh(contact_elements=3, degree=2), Side.LOWER, path)
    return path, summary, reduce_specimen(path, summary, SPECIMEN, config.Reduction(), 2, MPI.COMM_WORLD)[0]


def test_reduced_specimen_at_degree_two(reduced):
    _, summary, specimen = reduced
    assert specimen.contact_nodes == pytest.approx(summary.contact_nodes, abs=1e-12)
    assert specimen.contact_areas.sum() == pytest.approx(1e-6, rel=1e-12)
    assert specimen.observation_point == pytest.approx(summary.observation_point, abs=1e-12)
    assert specimen.full_dofs == 3 * summary.nodes
    assert specimen.frequency_error.max() < 1e-3
    motion = np.zeros(len(specimen.stiffness))
    motion[1:specimen.rigid.start:3] = motion[specimen.rigid.start + 1] = motion[specimen.observation.start + 1] = 1.0
    volume = 6e-3 * 6e-3 * 5e-3 + 1e-3 * 1e-3 * 6e-3
    assert motion @ specimen.mass @ motion == pytest.approx(8000.0 * volume, rel=1e-9)


@pytest.mark.parametrize(("change", "law"), [
    (lambda k, m: (k + np.triu(k, 1) * 1e-6, m), "asymmetry of the reduced stiffness"),
    (lambda k, m: (k + np.eye(len(k)) * 1e-5 * k[0, 0], m), "rigid motion"),
    (lambda k, m: (k, m * 1.001), "mass of the reduced body"),
    (lambda k, m: (k, m + np.diag(np.append(np.zeros(len(m) - 1), 1e-3))), "orthonormality"),
])
def test_the_audit_sees_a_broken_law(reduced, change, law):
    path, _, specimen = reduced
    body = assemble(read_mesh(path, MPI.COMM_WORLD), SPECIMEN, 2)
    body.destroy()
    craig_bampton.audit(specimen, body.clamped.centroid, body.total_mass)
    stiffness, mass = change(specimen.stiffness, specimen.mass)
    fields = {f: getattr(specimen, f) for f in specimen.__dataclass_fields__}
    broken = type(specimen)(**{**fields, "stiffness": stiffness, "mass": mass})
    with pytest.raises(AuditError, match=law):
        craig_bampton.audit(broken, body.clamped.centroid, body.total_mass)


def test_a_mesh_that_does_not_fit_its_summary_is_refused(reduced):
    path, summary, _ = reduced
    with pytest.raises(MeshError, match="contact nodes at this degree"):
        reduce_specimen(path, summary, SPECIMEN, config.Reduction(), 1, MPI.COMM_WORLD)
    fields = {f: getattr(summary, f) for f in summary.__dataclass_fields__}
    moved = type(summary)(**{**fields, "contact_nodes": summary.contact_nodes + 1e-5})
    with pytest.raises(MeshError, match="not those of its summary"):
        reduce_specimen(path, moved, SPECIMEN, config.Reduction(), 2, MPI.COMM_WORLD)


def test_other_degrees_are_refused(reduced):
    path, summary, _ = reduced
    with pytest.raises(InputError, match=r"mesh\.degree"):
        reduce_specimen(path, summary, SPECIMEN, config.Reduction(), 3, MPI.COMM_WORLD)


def test_residual_vectors_that_are_nearly_dependent_are_orthonormal():
    """Normalised once they were off by 1e-9, so that a specimen 5.6 mm wide was refused."""
    rng = np.random.default_rng(2)
    mass, stiffness = rng.uniform(1e-9, 5e-9, 300), rng.uniform(1e3, 1e6, 300)
    modes = np.linalg.qr(rng.standard_normal((300, 20)))[0] / np.sqrt(mass)[:, None]
    answers = rng.standard_normal((300, 4))
    answers = 1e3 * modes @ rng.standard_normal((20, 8)) + np.hstack([
        answers, answers + 2.5e-3 * rng.standard_normal((300, 4))])
    rows = np.arange(301, dtype=np.int32)
    of = [PETSc.Mat().createAIJ((300, 300), csr=(rows, rows[:300], one)) for one in (stiffness, mass)]
    squares, vectors = _residual_vectors(*of, modes, answers)
    basis = np.hstack([modes, vectors])
    assert np.abs(basis.T @ (mass[:, None] * basis) - np.eye(28)).max() < 1e-13
    ritz = vectors.T @ (stiffness[:, None] * vectors)
    assert np.abs(ritz - np.diag(squares)).max() < 1e-12 * squares.max()
