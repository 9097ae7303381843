"""Sphere on flat under tangential load, against Cattaneo and Mindlin, on half-spaces of Boussinesq and Cerruti.

What carries the weight: contact radius, approach and peak pressure of Hertz; friction force against displacement,
stick radius and tractions of Cattaneo and Mindlin, with errors falling with refinement; the loop of Mindlin and
Deresiewicz and its energy. The flexibility is written here, free of meshes: square patches of uniform traction with
their displacements at the middle of each patch.

Two equal bodies, so that normal and tangential tractions do not couple. The closed forms neglect the slip across the
force (K. L. Johnson, Contact Mechanics, 1985, section 7.2 (d)), which vanishes for Poisson's ratio 0; there they are
the exact solution, and at 0.29 the difference is stated.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.sample import SEPARATION, STICK
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

G, MU = 75e9, 0.5
RADIUS, CONTACT = 10e-3, 0.2e-3
LEVELS = (0.2, 0.4, 0.6, 0.8, 0.95)  # friction force over mu P


def patch_flexibility(points, side, nu):
    """Return the relative flexibility (3 n, 3 n), m/N, of two equal half-spaces with square patches at `points`.

    A force Q_x at the origin of one half-space moves its surface by ``u_x = Q_x ((1 - nu) / r + nu x^2 / r^3) /
    (2 pi G)`` and ``u_y = Q_x nu x y / r^3 / (2 pi G)``, a force Q_z by ``u_z = Q_z (1 - nu) / r / (2 pi G)``
    (Johnson 1985, sections 3.2 and 3.6). The integrals over a square are sums over its corners (Love 1929).
    """
    x, y = np.moveaxis(points[:, None] - points[None], -1, 0)

    def integral(antiderivative):
        corners = [(i, j) for i in (1, -1) for j in (1, -1)]
        return sum(i * j * antiderivative(x + 0.5 * i * side, y + 0.5 * j * side) for i, j in corners) / side**2

    xx = integral(lambda x, y: y * np.arcsinh(x / np.abs(y)))  # of x^2 / r^3
    yy = integral(lambda x, y: x * np.arcsinh(y / np.abs(x)))
    xy = integral(lambda x, y: -np.hypot(x, y))
    n = len(points)
    flexibility = np.zeros((n, 3, n, 3))
    flexibility[:, 0, :, 0] = (1 - nu) * (xx + yy) + nu * xx
    flexibility[:, 1, :, 1] = (1 - nu) * (xx + yy) + nu * yy
    flexibility[:, 0, :, 1] = flexibility[:, 1, :, 0] = nu * xy
    flexibility[:, 2, :, 2] = (1 - nu) * (xx + yy)
    return flexibility.reshape(3 * n, 3 * n) / (np.pi * G)


class Sphere:
    """The contact on patches, `fineness` of them along the contact radius, and its closed forms."""

    def __init__(self, fineness, nu):
        self.side = CONTACT / fineness
        line = self.side * np.arange(-fineness - 2, fineness + 3)
        points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
        self.points = points[np.hypot(*points.T) < CONTACT + 1.6 * self.side]
        self.r, self.size = np.hypot(*self.points.T), len(self.points)
        self.load = 4 * G / (1 - nu) * CONTACT**3 / (3 * RADIUS)  # E* = G / (1 - nu) for equal bodies
        self.peak = 1.5 * self.load / (np.pi * CONTACT**2)
        self.travel = 3 * MU * self.load * (2 - nu) / (8 * G * CONTACT)  # of both bodies when gross slip begins
        flexibility = patch_flexibility(self.points, self.side, nu)
        stiffness = np.linalg.inv(flexibility)
        joint = QuasiStaticJoint.from_stiffness(
            0.5 * (stiffness + stiffness.T), LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01))
        face = Interface(nodes=self.points, areas=np.full(self.size, self.side**2),
                         gap=np.sum(self.points**2, axis=1) / (2 * RADIUS))
        problem = rig_problem(joint, face, MU, frequency=100.0, excitation=1.0, normal_load=self.load)
        self.flexibility = flexibility
        self.march = ContactMarch.of(problem, np.array([1]))
        self.march.solver.tolerance = 1e-9 * self.load / self.size

    def displacement(self, q):
        """Return the travel at the friction force ``q mu P`` (Johnson 1985, equation (7.43))."""
        return self.travel * (1 - (1 - q)**(2 / 3))

    def traction(self, q):
        """Return Cattaneo's traction at the patches, Pa."""
        stick = CONTACT * (1 - q)**(1 / 3)
        dome, inner = (np.sqrt(np.maximum(1 - (self.r / b)**2, 0.0)) for b in (CONTACT, stick))
        return MU * self.peak * (dome - stick / CONTACT * inner)

    def radius(self, nodes):
        """Return the radius of the disc as large as the patches of `nodes`."""
        return np.sqrt(np.count_nonzero(nodes) / np.pi) * self.side


class Errors(NamedTuple):
    """Deviations at each of LEVELS: force over mu P, stick radius over the spacing, tractions, transverse force."""

    force: np.ndarray
    stick: np.ndarray
    traction: np.ndarray
    transverse: np.ndarray


@cache
def pushed(fineness, nu):
    """Return the sphere, its preload, and the Errors of one push without a way back."""
    sphere = Sphere(fineness, nu)
    preload = state = sphere.march.preloaded()
    system = sphere.march.system
    rows, before = [], system.pull
    for q in LEVELS:
        pull = system.pull + system.coupling[:, 0] * sphere.displacement(q)
        state = sphere.march.solver.solve(pull, state.displacement, state, before)
        before = pull
        x, y = state.force[0::3], state.force[1::3]
        exact = sphere.traction(q)
        rows.append((-x.sum() / (MU * sphere.load) - q,
                     (sphere.radius(state.state == STICK) - CONTACT * (1 - q)**(1 / 3)) / sphere.side,
                     np.linalg.norm(-x / sphere.side**2 - exact) / np.linalg.norm(exact),
                     np.abs(y).max() / np.abs(x).max()))
    return sphere, preload, Errors(*np.array(rows).T)


def test_the_preload_is_that_of_hertz():
    for fineness in (5, 7, 10):
        sphere, preload, _ = pushed(fineness, 0.0)
        assert abs(sphere.radius(preload.state != SEPARATION) - CONTACT) < 0.5 * sphere.side
        approach = preload.displacement[2] - sphere.flexibility[2] @ preload.force
        assert -approach == pytest.approx(CONTACT**2 / RADIUS, rel=0.05 / fineness**2)
        assert preload.force[2::3].max() / sphere.side**2 == pytest.approx(sphere.peak, rel=0.005)


@pytest.mark.parametrize("nu", [0.0, 0.29])
def test_force_and_stick_radius_are_those_of_cattaneo_and_mindlin(nu):
    """At Poisson's ratio 0.29 the closed form neglects some slip; its force still holds to 0.06 % of mu P."""
    for fineness, within in ((5, 4e-3), (7, 2e-3), (10, 6e-4)):
        *_, errors = pushed(fineness, nu)
        assert np.abs(errors.force).max() < within
        assert np.abs(errors.stick).max() < 0.3  # of the spacing


def test_errors_fall_with_refinement():
    *_, coarse = pushed(5, 0.0)
    *_, fine = pushed(10, 0.0)
    assert np.sqrt(np.mean(fine.force**2)) < 0.25 * np.sqrt(np.mean(coarse.force**2))
    assert np.all(fine.traction < 0.5 * coarse.traction)
    assert fine.traction[-1] < 0.03


def test_the_first_stiffness_is_mindlins():
    """Without slip the compliance is (2 - nu) / (4 G a) for both bodies together; q = 0.01 slips hardly."""
    for nu in (0.0, 0.29):
        sphere, preload, _ = pushed(10, nu)
        arm = 0.01 * sphere.travel * 2 / 3
        system = sphere.march.system
        pull = system.pull + system.coupling[:, 0] * arm
        state = sphere.march.solver.solve(pull, preload.displacement, preload, system.pull)
        stiffness = -state.force[0::3].sum() / arm
        assert stiffness == pytest.approx(4 * G * CONTACT / (2 - nu), rel=0.01)


def test_forces_across_the_push_need_poissons_ratio():
    *_, none = pushed(7, 0.0)
    *_, some = pushed(7, 0.29)
    assert none.transverse.max() < 1e-9
    assert 0.03 < some.transverse.max() < 0.06


@pytest.fixture(scope="module")
def loops():
    """Return, by fineness, the sphere, the arm's motion and the friction force of a period at q = 0.9."""
    periods = {}
    for fineness in (4, 5, 7):
        sphere = Sphere(fineness, 0.0)
        arm = sphere.displacement(0.9) * np.cos(2 * np.pi * np.arange(32) / 32)
        march = sphere.march.period(arm[:, None], np.zeros((32, 1, 0)), sphere.march.preloaded(), None, 1e-9)
        periods[fineness] = sphere, arm, -march.history.force[:, 0::3].sum(axis=1)
    return periods


def loop_energy_error(sphere, arm, friction, q=0.9):
    """Return the relative error of the energy per cycle (Johnson 1985, equation (7.57), both bodies)."""
    exact = 4.8 * MU * sphere.load * sphere.travel * (
        1 - (1 - q)**(5 / 3) - 5 * q / 6 * (1 + (1 - q)**(2 / 3)))
    work = np.sum(0.5 * (friction + np.roll(friction, -1)) * (np.roll(arm, -1) - arm))
    # the trapezoidal rule on the 32 points of the exact loop, so that only the contact's error is left
    turned = np.where(np.arange(32) < 16, 1.0, -1.0)
    branch = mindlin_branch(sphere, turned * arm, q)
    rule = np.sum(0.5 * (turned * branch + np.roll(turned * branch, -1)) * (np.roll(arm, -1) - arm))
    assert rule == pytest.approx(exact, rel=0.02)
    return work / rule - 1


def mindlin_branch(sphere, position, q):
    """Return the force on the way back from a turn at ``+q mu P``, by Masing's rule."""
    back = (sphere.displacement(q) - position) / (2 * sphere.travel)
    return MU * sphere.load * (q - 2 * (1 - (1 - back)**1.5))


def test_the_loop_is_that_of_mindlin_and_deresiewicz(loops):
    errors = []
    for sphere, arm, friction in loops.values():
        way_back = slice(0, 17)
        exact = mindlin_branch(sphere, arm[way_back], 0.9)
        errors.append(np.abs(friction[way_back] - exact).max() / (0.9 * MU * sphere.load))
        assert friction[16:] == pytest.approx(-friction[:16], abs=1e-6 * sphere.load)
    assert errors[-1] < 3e-3
    assert errors[0] > errors[1] > errors[2]


def test_the_dissipated_energy_is_that_of_mindlin_and_deresiewicz(loops):
    errors = [abs(loop_energy_error(*loop)) for loop in loops.values()]
    assert errors[-1] < 0.01
    assert errors[0] > errors[1] > errors[2]
