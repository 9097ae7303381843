"""The condensed joint against the dense algebra of its bodies.

What carries the weight: `RigJoint.dynamic_stiffness` condenses both bodies afresh at each harmonic, with complex dense
factors; the polynomials must give its stiffness, load and motion to round-off, damping of both kinds included.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.solvers.fourier import to_complex
from fretflow.structure.mirror import MirrorPlane
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen
from fretflow.structure.two_mass_rig.compliant import with_springs
from fretflow.structure.two_mass_rig.condensed import condensed
from fretflow.structure.two_mass_rig.joint import RigJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

NODES, MODES = 4, 3
LOADS = (53.0, 60.0)
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)


def rig_loads(harmonics, excitation, normal_load):
    """Return loads (H + 1, 3) in N: a vibrating force on the block, and a constant normal load."""
    loads = np.zeros((harmonics + 1, 3), dtype=complex)
    loads[1, 0], loads[0, 2] = excitation, normal_load
    return loads


def specimen(seed, places=None):
    """Return a free body: nodes bound to each other by springs, lowest frequency held at its face 84 kHz."""
    rng = np.random.default_rng(seed)
    size = 3 * NODES + 6 + 3 + MODES
    places = rng.uniform(-1, 1, (NODES, 2)) if places is None else places
    nodes = np.column_stack([places, np.zeros(NODES)]) * 5e-4
    points = np.vstack([nodes, [0.0, 0.0, 1e-3]])
    moves = np.zeros((size, 3 * (NODES + 1)))  # motion of the points less that of the face, as one rigid body
    moves[:3 * NODES, :3 * NODES], moves[3 * NODES + 6:3 * NODES + 9, 3 * NODES:] = np.eye(3 * NODES), np.eye(3)
    for m, point in enumerate(points):
        spin = np.cross(np.eye(3), point)
        moves[3 * NODES:3 * NODES + 6, 3 * m:3 * m + 3] = -np.vstack([np.eye(3), spin])
    root = rng.normal(size=(3 * NODES + 3, 3 * NODES + 3))
    stiffness = moves @ (1e7 * (root @ root.T / len(root) + np.eye(len(root)))) @ moves.T
    stiffness[-MODES:, -MODES:] += np.diag((2 * np.pi * np.array([2e5, 3e5, 4e5])) ** 2)
    spread = rng.normal(size=(size, size)) * np.sqrt(2e-6)
    mass = spread @ spread.T / size + 1e-6 * np.eye(size)
    mass[-MODES:, -MODES:] = np.eye(MODES)
    mass[-MODES:, :-MODES] *= 0.1
    mass[:-MODES, -MODES:] = mass[-MODES:, :-MODES].T
    return ReducedSpecimen(
        stiffness=stiffness, mass=mass, contact_nodes=nodes, contact_areas=np.full(NODES, 1e-7),
        profile=np.zeros(NODES), observation_point=points[-1], fixed_interface_frequencies=np.array([2e5, 3e5, 4e5]),
        full_frequencies=np.array([8.4e4]), reduced_frequencies=np.array([8.4e4]), rayleigh_mass=50.0,
        rayleigh_stiffness=1e-8, full_dofs=100)


@pytest.fixture(scope="module")
def joint():
    return RigJoint(upper=specimen(1), lower=specimen(2), rig=RIG)


@pytest.fixture(scope="module")
def mirrored():
    """Return a joint that is symmetric about y = 0, as the mean of bodies and their mirror images is, and that plane.

    Two nodes are images of each other, two lie on the plane.
    """
    places = np.array([[-1.0, -0.7], [-1.0, 0.7], [0.3, 0.0], [1.0, 0.0]])
    signs = np.r_[np.tile([1.0, -1.0, 1.0], NODES + 1), -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, np.ones(MODES)]
    dofs = np.r_[3:6, 0:3, 6:len(signs)]

    def mean(matrix):
        return 0.5 * (matrix + signs[:, None] * matrix[np.ix_(dofs, dofs)] * signs)

    bodies = [replace(body, stiffness=mean(body.stiffness), mass=mean(body.mass))
              for body in (specimen(1, places), specimen(2, places))]
    return RigJoint(upper=bodies[0], lower=bodies[1], rig=RIG), MirrorPlane.through(places)


def far(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("frequency", [40.0, 100.0, 250.0])
def test_stiffness_and_load_are_the_dense_ones(joint, frequency):
    dense, stiffness = (model.dynamic_stiffness if model is joint else model.relative
                        for model in (joint, condensed(joint)))
    dense, stiffness = dense(frequency, rig_loads(15, *LOADS)), stiffness(frequency, rig_loads(15, *LOADS))
    u = np.random.default_rng(0).normal(size=(31, 3 * NODES))
    product = stiffness.apply(to_complex(u))
    for k, z in enumerate(dense.stiffness):
        assert far(product[k], z @ to_complex(u)[k]) < 1e-12
        assert far(stiffness.real_part(k), z.real) < 1e-12
    assert far(stiffness.load, dense.load) < 1e-9  # K times rigid motion: what cancels sets the accuracy


def test_single_precision_keeps_the_terms_that_it_tells(joint):
    stiffness = condensed(joint).relative(100.0, rig_loads(15, *LOADS))
    u, single = to_complex(np.random.default_rng(0).normal(size=(31, 3 * NODES))), stiffness.single()
    assert 1 < len(single.terms) < len(stiffness.terms)
    product = single.apply(u.astype(np.complex64))
    assert product.dtype == np.complex64
    assert far(product, stiffness.apply(u)) < 1e-5
    assert far(single.real_part(2), stiffness.real_part(2)) < 1e-6


def test_motion_is_the_dense_one(joint):
    """Of a displacement that goes with forces which the rig can bear: any."""
    u = to_complex(1e-6 * np.random.default_rng(0).normal(size=(7, 3 * NODES)))
    loads = rig_loads(len(u) - 1, *LOADS)
    dense, amplitudes = (model.motion_amplitudes(100.0, u, loads) for model in (joint, condensed(joint)))
    for name in ("rig", "upper_observation", "lower_observation"):
        assert far(getattr(amplitudes, name), getattr(dense, name)) < 1e-9, name


def test_the_massless_joint_is_condensed_exactly(joint):
    given = joint.quasi_static()
    loads = rig_loads(3, *LOADS)
    dense, stiffness = (solve(100.0, loads) for solve in (given.dynamic_stiffness, condensed(given).relative))
    u = to_complex(np.random.default_rng(0).normal(size=(7, 3 * NODES)))
    assert far(stiffness.apply(u), np.einsum("kij,kj->ki", dense.stiffness, u)) < 1e-13
    motions = [model.motion_amplitudes(100.0, 1e-6 * u, loads) for model in (given, condensed(given))]
    assert far(motions[1].upper_observation, motions[0].upper_observation) < 1e-12
    assert condensed(given).reaches(1e6, 100)


@pytest.mark.parametrize("massless", [False, True])
def test_one_side_of_a_symmetric_joint_moves_as_the_whole_does(mirrored, massless):
    joint, plane = mirrored
    joint = joint.quasi_static() if massless else joint
    whole, half = condensed(joint), condensed(joint, plane)
    assert (whole.plane, half.plane) == (None, plane)
    loads, motion = rig_loads(3, *LOADS), 1e-6 * np.random.default_rng(0).normal(size=(7, 9))
    motion = to_complex(plane.mean(plane.whole(motion)))  # nothing moves across the plane on it
    of_all, of_half = whole.relative(100.0, loads), half.relative(100.0, loads)
    force = of_all.apply(plane.whole(motion))
    assert plane.is_symmetric(force)
    assert far(of_half.apply(motion), plane.total(force)) < 1e-12
    assert far(of_half.load, plane.total(of_all.load)) < 1e-9
    ours, theirs = (model.motion_amplitudes(100.0, u, loads) for model, u in (
        (half, motion), (whole, plane.whole(motion))))
    for name in ("rig", "upper_observation", "lower_observation"):
        assert far(getattr(ours, name), getattr(theirs, name)) < 1e-9, name
    value, vector = np.linalg.eigh(whole.stiffness[0])
    assert half.spectral_radius == pytest.approx(value[[plane.is_symmetric(one) for one in vector.T]].max(), rel=1e-9)


def test_bodies_that_differ_across_the_plane_are_not_halved(joint, mirrored):
    assert condensed(joint, mirrored[1]).plane is None
    assert condensed(joint.quasi_static(), mirrored[1]).plane is None


def test_the_first_harmonics_alone(joint):
    given = condensed(joint)
    whole, part = given.relative(100.0, rig_loads(7, *LOADS)).up_to(3), given.relative(100.0, rig_loads(3, *LOADS))
    u = to_complex(np.random.default_rng(0).normal(size=(7, 3 * NODES)))
    assert far(whole.apply(u), part.apply(u)) < 1e-13
    assert np.array_equal(whole.load, part.load)


def test_its_reach_ends_below_the_bodies_own_frequencies(joint):
    assert condensed(joint).reaches(280.0, 15)
    assert not condensed(joint).reaches(281.0, 15)


def test_what_has_no_such_form_is_left_to_dense_algebra(joint):
    other = replace(joint.lower, rayleigh_stiffness=2e-8)
    assert condensed(replace(joint, lower=other)) is None
    assert condensed(with_springs(joint, np.full(3 * NODES, 1e-8))) is None
