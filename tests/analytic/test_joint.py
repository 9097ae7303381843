"""The joint's condensation against the whole system, solved uncondensed.

What carries the weight: two lattices of springs and masses, the rig and springs in the contact are assembled
DOF by DOF, without any reduction, and solved at each harmonic; the condensed joint with the same contact
springs must give the same relative displacement, rig motion and observed motion.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint, RigJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.linalg import eigh

CONTACT, FACE, INNER = 4, 3, 5
FREQUENCY, EXCITATION, LOAD, HARMONICS = 100.0, 53.0, 60.0, 3
RAYLEIGH = {"rayleigh_mass": 2e3, "rayleigh_stiffness": 1e-6}  # each of them felt in the joint's stiffness


def rig_loads(harmonics, excitation, normal_load):
    """Return loads (H + 1, 3) in N: a vibrating force on the block, and a constant normal load."""
    loads = np.zeros((harmonics + 1, 3), dtype=complex)
    loads[1, 0], loads[0, 2] = excitation, normal_load
    return loads


def lattice(seed, density):
    """Return stiffness and mass of nodes joined by springs that resist every relative translation."""
    rng = np.random.default_rng(seed)
    nodes = CONTACT + FACE + 1 + INNER
    points = rng.uniform(-1e-3, 1e-3, (nodes, 3))
    k = np.zeros((nodes, 3, nodes, 3))
    for i in range(nodes):
        for j in range(i):
            root = rng.normal(size=(3, 3))
            block = 1e6 * (root @ root.T + np.eye(3))
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                k[a, :, b, :] += sign * block
    mass = np.repeat(density * rng.uniform(0.5, 1.5, nodes), 3)
    return k.reshape(3 * nodes, -1), np.diag(mass), points


def rigid_face(points):
    """Return the map from (contact, face translations and rotations, observation, inner) to all DOFs."""
    c, f = 3 * CONTACT, 3 * FACE
    rest = 3 * len(points) - c - f
    t = np.zeros((c + f + rest, c + 6 + rest))
    t[:c, :c] = np.eye(c)
    t[c + f:, c + 6:] = np.eye(rest)
    face = points[CONTACT:CONTACT + FACE]
    for m, r in enumerate(face - face.mean(axis=0)):
        skew = np.array([[0, r[2], -r[1]], [-r[2], 0, r[0]], [r[1], -r[0], 0]])
        t[c + 3 * m:c + 3 * m + 3, c:c + 6] = np.hstack([np.eye(3), skew])
    return t


def specimen(seed, density):
    """Return the whole matrices and the Craig-Bampton record with every inner mode kept."""
    k, m, points = lattice(seed, density)
    t = rigid_face(points)
    k, m = t.T @ k @ t, t.T @ m @ t
    masters = 3 * CONTACT + 9
    lam, phi = eigh(k[masters:, masters:], m[masters:, masters:])
    basis = np.eye(len(k))
    basis[masters:, :masters] = -np.linalg.solve(k[masters:, masters:], k[masters:, :masters])
    basis[masters:, masters:] = phi
    frequencies = np.sqrt(lam) / (2 * np.pi)
    reduced = ReducedSpecimen(
        stiffness=basis.T @ k @ basis, mass=basis.T @ m @ basis, contact_nodes=points[:CONTACT],
        contact_areas=np.ones(CONTACT), profile=np.zeros(CONTACT),
        observation_point=points[CONTACT + FACE],
        fixed_interface_frequencies=frequencies, full_frequencies=frequencies,
        reduced_frequencies=frequencies, full_dofs=len(k), **RAYLEIGH)
    return k, m, reduced


@pytest.fixture(scope="module")
def rig():
    return LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)


def make(rig, density):
    upper, lower = specimen(1, density), specimen(2, density)
    return RigJoint(upper=upper[2], lower=lower[2], rig=rig), upper, lower


def contact_springs():
    root = np.random.default_rng(3).normal(size=(3 * CONTACT, 3 * CONTACT))
    return 1e6 * (root @ root.T + np.eye(3 * CONTACT))


def whole_system(rig, upper, lower, springs):
    """Return per-harmonic solutions of block + upper + lower, held DOFs struck out, by direct assembly."""
    c, size = 3 * CONTACT, len(upper[0])
    total = 1 + 2 * size  # block, upper, lower
    k, m, d = (np.zeros((total, total)) for _ in range(3))
    for first, (kb, mb, _) in ((1, upper), (1 + size, lower)):
        own = slice(first, first + size)
        k[own, own], m[own, own] = kb, mb
    d += RAYLEIGH["rayleigh_mass"] * m + RAYLEIGH["rayleigh_stiffness"] * k
    arm = 1 + c
    k[0, 0] += rig.ground_stiffness
    d[0, 0] += rig.ground_damping
    for p, q, sign in ((0, 0, 1), (arm, arm, 1), (0, arm, -1), (arm, 0, -1)):
        k[p, q] += sign * rig.hinge_stiffness
        d[p, q] += sign * rig.hinge_damping
    m[0, 0] += rig.moving_mass
    m[arm, arm] += rig.arm_mass
    relative = np.zeros((c, total))
    relative[:, 1:1 + c], relative[:, 1 + size:1 + size + c] = np.eye(c), -np.eye(c)
    k = k + relative.T @ springs @ relative
    held = [arm + 1, arm + 3, arm + 4, arm + 5, *range(1 + size + c, 1 + size + c + 6)]
    free = np.setdiff1d(np.arange(total), held)
    out = np.zeros((HARMONICS + 1, total), dtype=complex)
    for h in range(HARMONICS + 1):
        w = 2 * np.pi * FREQUENCY * h
        load = np.zeros(total)
        load[arm + 2] = -LOAD if h == 0 else 0.0
        load[0] = EXCITATION if h == 1 else 0.0
        z = k - w**2 * m + 1j * w * d
        out[h, free] = np.linalg.solve(z[np.ix_(free, free)], load[free])
    return out, out @ relative.T


def condensed_solution(joint):
    springs = contact_springs()
    z = joint.dynamic_stiffness(FREQUENCY, rig_loads(HARMONICS, EXCITATION, LOAD))
    u = np.array([np.linalg.solve(zk + springs, gk) for zk, gk in zip(z.stiffness, z.load, strict=True)])
    return u, joint.motion_amplitudes(FREQUENCY, u, rig_loads(HARMONICS, EXCITATION, LOAD))


def close(a, b, tolerance):
    return np.abs(a - b).max() <= tolerance * np.abs(b).max()


def test_the_exact_condensation_is_the_whole_system(rig):
    joint, upper, lower = make(rig, density=1e-3)
    whole, relative = whole_system(rig, upper, lower, contact_springs())
    u, motion = condensed_solution(joint)
    size, observed = len(upper[0]), 3 * CONTACT + 6
    pairs = ((u, relative), (motion.rig, whole[:, [0, 1 + 3 * CONTACT]]),
             (motion.upper_observation, whole[:, 1 + observed:4 + observed]),
             (motion.lower_observation, whole[:, 1 + size + observed:4 + size + observed]))
    for condensed, expected in pairs:
        assert np.abs(expected[:2]).max(axis=1).min() > 0.0
        assert close(condensed[0], expected[0], 1e-8)
        assert close(condensed[1], expected[1], 1e-8)
        assert not np.any(condensed[2:])  # harmonics 2 and 3 carry no load


def test_higher_harmonics_see_their_own_frequency(rig):
    """The stiffness of harmonic 3 at f is that of harmonic 1 at 3 f."""
    joint, _, _ = make(rig, density=1e-3)
    high = joint.dynamic_stiffness(FREQUENCY, rig_loads(3, EXCITATION, LOAD)).stiffness[3]
    assert close(high, joint.dynamic_stiffness(3 * FREQUENCY, rig_loads(1, EXCITATION, LOAD)).stiffness[1], 1e-12)


def test_vertical_rigid_motion_is_free_at_rest_and_passes_the_normal_load_whole(rig):
    joint, _, _ = make(rig, density=1e-3)
    for each in (joint, joint.quasi_static()):
        z = each.dynamic_stiffness(FREQUENCY, rig_loads(1, EXCITATION, LOAD))
        lift = np.tile([0.0, 0.0, 1.0], CONTACT)
        assert np.abs(z.stiffness[0] @ lift).max() < 1e-8 * np.abs(z.stiffness[0]).max()
        assert lift @ z.load[0] == pytest.approx(-LOAD, rel=1e-9)


def test_quasi_static_condensation_differs_by_the_specimens_inertia(rig):
    """The difference is the specimens' inertia: it falls in proportion with their density."""
    undamped = {"rayleigh_mass": 0.0, "rayleigh_stiffness": 0.0}
    differences = []
    for density in (1e-4, 1e-5):
        joint, _, _ = make(rig, density)
        joint = RigJoint(upper=replace(joint.upper, **undamped), lower=replace(joint.lower, **undamped), rig=rig)
        u, motion = condensed_solution(joint)
        v, massless = condensed_solution(joint.quasi_static())
        differences.append([np.abs(a[:2] - b[:2]).max() / np.abs(a[:2]).max() for a, b in (
            (u, v), (motion.rig, massless.rig), (motion.upper_observation, massless.upper_observation),
            (motion.lower_observation, massless.lower_observation))])
    assert np.max(differences[0]) < 1e-3
    assert np.array(differences[0]) / differences[1] == pytest.approx(10.0, rel=0.1)


def test_the_specimens_mass_moves_with_the_arm(rig):
    joint, _, _ = make(rig, density=1e-3)
    nodes_mass = np.trace(lattice(1, 1e-3)[1]) / 3
    assert joint.quasi_static().rig.arm_mass == pytest.approx(rig.arm_mass + nodes_mass, rel=1e-12)


def test_bare_stiffness_gives_the_same_contact_equations(rig):
    joint, _, _ = make(rig, density=1e-3)
    whole = joint.quasi_static()
    bare = QuasiStaticJoint.from_stiffness(whole.stiffness, whole.rig)
    a, b = (j.dynamic_stiffness(FREQUENCY, rig_loads(2, EXCITATION, LOAD)) for j in (whole, bare))
    assert close(a.stiffness, b.stiffness, 1e-12)
    assert close(a.load, b.load, 1e-12)
    assert close(bare.flexibility, whole.flexibility, 1e-9)


@pytest.mark.parametrize(("matrix", "words"), [
    (np.eye(4), "shape"), (np.eye(6) + np.eye(6, k=1), "symmetric"), (-np.eye(3), "positive definite")])
def test_unusable_stiffness_is_refused(rig, matrix, words):
    with pytest.raises(InputError, match=words):
        QuasiStaticJoint.from_stiffness(matrix, rig)


def test_unmatched_faces_are_refused(rig):
    joint, _, _ = make(rig, density=1e-3)
    fewer = replace(joint.lower, contact_nodes=joint.lower.contact_nodes[:-1])
    with pytest.raises(InputError, match="contact nodes"):
        RigJoint(upper=joint.upper, lower=fewer, rig=rig)
