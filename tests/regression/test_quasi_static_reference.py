"""The true periodic solver against histories that others computed.

What carries the weight: the rigid histories come from another code for the same equations and must be met to their
printed digits; those with asperity springs come from an independent implicit time integration, and the distance to
them must be small and fall as samples and harmonics grow.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver, sliding_distance
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

PERIODIC = Path(__file__).parents[1] / "data" / "periodic"
ASPERITY = 2e6 * 1e9  # N/m per m^2


@cache
def problem(force, springs):
    data = np.load(PERIODIC / "krel_49.npz")
    weights = np.ones(7)
    weights[[0, -1]] = 0.5
    areas = np.outer(weights, weights).ravel() / 36.0 * 1e-6
    stiffness = 1e3 * data["K"]
    compliance = np.repeat(1.0 / (ASPERITY * areas), 3) if springs else np.zeros(len(stiffness))
    in_series = np.linalg.inv(np.linalg.inv(stiffness) + np.diag(compliance))
    joint = QuasiStaticJoint.from_stiffness(in_series, LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01))
    interface = Interface(nodes=1e-3 * data["x"][:, :2], areas=areas, gap=np.zeros(len(areas)))
    return rig_problem(joint=joint, interface=interface, friction_coefficient=0.88, frequency=100.0,
                           excitation=force, normal_load=60.0), compliance


@cache
def histories(force, springs, harmonics, samples):
    """Return area-mean displacement of the bodies (um) and friction force (N)."""
    given, compliance = problem(force, springs)
    period = QuasiStaticSolver(Solver(harmonics=harmonics, samples=samples, estimate_error=False)).solve(given)
    bodies = period.displacement - period.force * compliance.reshape(-1, 3)
    mean = bodies[:, :, 0] @ given.interface.areas / given.interface.areas.sum()
    if not springs:
        assert np.ptp(mean) == pytest.approx(sliding_distance(period, given.interface))
    return 1e6 * mean, period.friction_force


def reference(force, kind):
    data = np.genfromtxt(PERIODIC / f"{kind}_{force:.0f}N.csv", delimiter=",", names=True)
    turn = data["time_s"] * 100.0
    keep = turn < 1.0 - 1e-9
    return turn[keep], data["relative_displacement_um"][keep], data["friction_force_N"][keep]


@pytest.mark.parametrize("force", [53.0, 60.0, 75.0])
def test_rigid_contact_is_that_of_another_code_to_its_digits(force):
    displacement, friction = histories(force, False, 25, 256)
    _, expected, expected_force = reference(force, "rigid")
    assert np.abs(displacement - expected).max() < 1e-6  # um
    assert np.abs(friction - expected_force).max() < 2e-6  # N


def distances(force, harmonics, samples):
    """Return the relative error of the sliding distance and the rms distance over the loop's range."""
    displacement, _ = histories(force, True, harmonics, samples)
    turn, expected, _ = reference(force, "asperity")
    own = np.interp(turn, np.arange(samples + 1) / samples, np.append(displacement, displacement[0]))
    span = np.ptp(expected)
    return abs(np.ptp(displacement) / span - 1.0), np.sqrt(np.mean((own - expected)**2)) / span


@pytest.mark.parametrize("force", [53.0, 60.0, 75.0])
def test_asperity_springs_are_those_of_time_integration(force):
    coarse, middle, fine = (np.array(distances(force, h, n)) for h, n in ((15, 64), (25, 128), (50, 256)))
    assert np.all(fine < middle)
    assert np.all(middle < coarse)
    standard = distances(force, 25, 256)
    assert standard[0] < 0.01
    assert standard[1] < 0.02
