"""A response curve that was interrupted goes on from its last points.

What carries the weight: the finished curve is that of an uninterrupted run to the last byte of its file, wherever it
was interrupted, of one coordinate as of several whose derivative goes from point to point; and points are not solved
again.
"""

from functools import cache

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.core.store import write_record
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.continuation import checkpoint
from fretflow.solvers.continuation.follow import Sweep, respond
from fretflow.solvers.periodic import Harmonic, NormalLoad, PeriodicProblem
from fretflow.structure.matrix_joint import Joint
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig


def rig():
    """Return one node that slides on the rig."""
    lumped = LumpedRig(moving_mass=10.0, arm_mass=0.5, ground_stiffness=6e5, hinge_stiffness=4e6, ground_damping=120.0,
                       hinge_damping=30.0)
    joint = QuasiStaticJoint.from_stiffness(np.diag([1.5e6, 1.5e6, 2e6]), lumped)
    face = Interface(nodes=np.zeros((1, 2)), areas=np.ones(1), gap=np.zeros(1))
    return rig_problem(joint=joint, interface=face, friction_coefficient=0.3, frequency=100.0, excitation=20.0,
                       normal_load=60.0)


def masses():
    """Return two masses in a row, each over a node that rubs on the ground; the contact sees six coordinates."""
    link, hold = np.diag([2e7, 2e7, 4e7]), np.diag([1e6, 1e6, 1e6])
    chain = np.array([[1.0, -1.0], [-1.0, 1.0]])
    stiffness = np.kron(chain, np.kron(np.eye(2), link)) + np.kron(
        np.diag([1.0, 0.0]), np.kron(0.2 * chain, link) + np.kron(np.eye(2), hold))
    mass = np.kron(np.diag([1.0, 1e-3]), np.eye(6))
    joint = Joint.from_matrices(stiffness, mass, contact=[2, 3], observe={"tip": 0}, modal_damping=0.05)
    face = Interface(np.array([[0.0, 0.0], [1e-3, 0.0]]), np.full(2, 1e-6), np.zeros(2))
    return PeriodicProblem(joint, face, Coulomb(0.6), Harmonic(100.0, {"tip": 80.0}), preload=NormalLoad(60.0))


PROBLEMS = {
    "one coordinate": (rig(), Sweep(start=50.0, stop=70.0, harmonics=15, samples=64, fine_harmonics=15,
                                    fine_samples=64)),
    "several": (masses(), Sweep(start=180.0, stop=200.0, harmonics=7, samples=48, fine_harmonics=7, fine_samples=48,
                                tolerance=1e-3, fine_tolerance=1e-3, channel="tip")),
}


class Counter:
    """Counts points and interrupts at one of them."""

    def __init__(self, last=None):
        self.last, self.count = last, 0

    def __call__(self, direction, frequency):
        self.count += 1
        if self.count == self.last:
            raise KeyboardInterrupt


@cache
def uninterrupted(name):
    counter = Counter()
    return respond(*PROBLEMS[name], counter), counter.count


@pytest.mark.parametrize("name", list(PROBLEMS))
def test_an_interrupted_curve_becomes_the_same_file(name, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "RARELY", 0.0)
    whole, total = uninterrupted(name)
    expected = write_record(tmp_path / "whole.h5", whole).read_bytes()
    for share in (0.2, 0.8):  # on the way up, and down
        unfinished = tmp_path / f"{share}.part"
        solved = int(share * total)
        with pytest.raises(KeyboardInterrupt):
            respond(*PROBLEMS[name], Counter(solved), unfinished)
        rest = Counter()
        curve = respond(*PROBLEMS[name], rest, unfinished)
        assert write_record(tmp_path / "curve.h5", curve).read_bytes() == expected
        assert rest.count <= total - solved + 1 + (share > 0.5) * 0.4 * total  # the peak of the way up is refined again


def test_writing_takes_a_twentieth_of_the_time(tmp_path, monkeypatch):
    """On a clock that each write moves on by 1 s and each point by 3 s, one of seven points is written."""
    clock, written = [0.0], []

    def write(file, record):
        clock[0] += 1.0
        written.append(len(record.points["omega_rad_s"]))
        return write_record(file, record)

    monkeypatch.setattr(checkpoint, "write_record", write)
    monkeypatch.setattr(checkpoint, "monotonic", lambda: clock[0])

    def note(direction, frequency):
        clock[0] += 3.0

    respond(*PROBLEMS["one coordinate"], note, tmp_path / "curve.part")
    assert written[:4] == [1, 8, 15, 22]
