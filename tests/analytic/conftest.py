"""A joint dragged by a given stroke, with effects: a fast `wear.CycleModel` whose laws are those of the real one."""

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.core.records import quantity, record
from fretflow.effects.model import EffectModel
from fretflow.pipeline.problem import rig_problem
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.cycle import CycleResponse

RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)


@record
class Nothing:
    """A state that carries nothing over."""

    flag: float = quantity("1")


def press(flexibility, gap, load):
    """Return forces, openings and approach of frictionless bodies of a normal `flexibility`, by active sets."""
    closed = np.ones(len(gap), dtype=bool)
    while True:
        index = np.flatnonzero(closed)
        matrix = np.ones((index.size + 1, index.size + 1))
        matrix[:-1, :-1], matrix[-1, -1] = flexibility[np.ix_(index, index)], 0.0
        *forces, rise = np.linalg.solve(matrix, np.r_[-gap[index], load])
        force = np.zeros(len(gap))
        force[index] = forces
        opening = gap + rise + flexibility @ force
        new = (closed & (force > 0.0)) | (~closed & (opening < 0.0))
        if np.array_equal(new, closed):
            return force, opening, -rise
        closed = new


class Dragged:
    """Bodies pressed without friction and dragged by `half_stroke` (m) to either side; every closed node slides alike.

    The model's problem says load, friction, gap, layers and springs; what it says of the rig does not matter.
    """

    state_type = Nothing
    has_laws = True
    load_held = True

    def __init__(self, problem, effects=(), half_stroke=5e-6):
        self.model = EffectModel.build(problem, effects)
        self.areas, self.half_stroke = problem.interface.areas, half_stroke
        self.initial, self.evolve = self.model.initial, self.model.evolve
        self.wear_factor, self.opening_share = self.model.wear_factor, self.model.opening_share

    def normal_flexibility(self, slow):
        return self.model.problem(slow).structure.flexibility[2::3, 2::3]

    def gap(self, slow):
        return self.model.problem(slow).interface.gap

    def cycle(self, slow, start):
        problem = self.model.problem(slow)
        force, opening, approach = press(self.normal_flexibility(slow), problem.interface.gap, problem.normal_load)
        path = np.where(force > 0.0, 4.0 * self.half_stroke, 0.0)
        pressure = force / self.areas
        return CycleResponse(
            pressure_sliding=pressure * path, mean_pressure=pressure, slip_path=path,
            mean_opening=np.maximum(opening, 0.0), contact_share=(force > 0.0) * 1.0,
            dissipated_energy=float(problem.friction_coefficient * force @ path),
            sliding_distance=2.0 * self.half_stroke, arm_range=2.0 * self.half_stroke, approach=approach,
        ), Nothing(flag=0.0)


def make_face_problem(place, areas, flexibility, gap=None, **changes):
    """Return the problem of bodies with the same `flexibility` (nodes, nodes), m/N, in all three directions."""
    joint = QuasiStaticJoint.from_stiffness(np.linalg.inv(np.kron(flexibility, np.eye(3))), RIG)
    gap = np.zeros(len(areas)) if gap is None else gap
    return rig_problem(**{
        "joint": joint, "interface": Interface(nodes=place, areas=areas, gap=gap), "friction_coefficient": 0.7,
        "frequency": 100.0, "excitation": 60.0, "normal_load": 60.0, **changes})


@pytest.fixture(scope="session")
def dragged():
    """Return the class of dragged joints."""
    return Dragged


@pytest.fixture(scope="session")
def face_problem():
    """Return the function that makes the problem of two faces."""
    return make_face_problem


@pytest.fixture(scope="session")
def winkler():
    """Return a function that makes the problem of nine independent springs, side by side along x."""
    areas = 1e-6 * np.array([0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5]) / 8.0
    place = np.stack([np.linspace(-0.5e-3, 0.5e-3, 9), np.zeros(9)], axis=1)

    def make(foundation=4e14, **changes):
        return make_face_problem(place, areas, np.diag(1.0 / (foundation * areas)), **changes)

    return make
