"""Wear of a sphere on a flat in gross slip: a Hertzian contact whose area grows as its pressure evens out.

What carries the weight: the true periodic solver with implicit jumps against a marching of its own (Polonsky and
Keer's conjugate gradients for the pressure, tiny explicit steps), worn volume against dissipated energy, and the
closed form that a long test tends to. Late in the test the pressure is uniform, so that the worn disc of radius b is
the cap cut off by the plane, less what the elastic deflection u under p = P / (pi b^2) gives way at the middle::

    V = pi b^4 / (4 R) - integral (u - u(b)) dA,   mean u = 16 p b / (3 pi E*),   u(b) = 4 p b / (pi E*)
    V = pi b^4 / (4 R) - 4 P b / (3 pi E*)

(deflection under uniform pressure: K. L. Johnson, Contact Mechanics, 1985, section 3.4 (a)).
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from fretflow.case.config import Solver, WearScheme
from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.effects.cycle import PeriodicCycle
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.quasi_static.march import press_frictionless
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.asymptotic import solve_asymptotic_shape
from fretflow.wear.cycle import CycleResponse, WearAlone
from fretflow.wear.history import WearHistory, WearSettings
from fretflow.wear.march import run_history

G, MU, K_W = 75e9, 0.6, 1e-14  # Poisson's ratio 0: E* = G for equal bodies, no forces across the sliding


def grid(count, side):
    """Return the places (n, 2) of `count` patches to every side of the middle one."""
    line = side * np.arange(-count, count + 1)
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


RADIUS, CONTACT = 20e-3, 0.15e-3
LOAD = 4 * G * CONTACT**3 / (3 * RADIUS)  # 16.9 N
SIDE = CONTACT / 3
PLACE = grid(6, SIDE)
AREAS = np.full(len(PLACE), SIDE**2)
CROWN = np.sum(PLACE**2, axis=1) / (2 * RADIUS)
CYCLES = 4_000


def love(place, side):
    """Return the flexibility (n, n), m/N, of two half-spaces of Poisson's ratio 0, normal as tangential."""
    x, y = np.moveaxis(place[:, None] - place[None], -1, 0)
    total = np.zeros(x.shape)
    for i in (1, -1):
        for j in (1, -1):
            a, b = x + 0.5 * i * side, y + 0.5 * j * side
            total += i * j * (a * np.arcsinh(b / np.abs(a)) + b * np.arcsinh(a / np.abs(b)))
    return total / (np.pi * G * side**2)


FLEXIBILITY = love(PLACE, SIDE)


def joint():
    """Return the half-spaces on a rig whose arm follows its driven block rigidly and far."""
    flexibility = np.kron(FLEXIBILITY, np.eye(3))
    rig = LumpedRig.from_modes(1.0, 0.1, 40.0, 5000.0, 0.01)
    return QuasiStaticJoint.from_stiffness(np.linalg.inv(flexibility), rig)


class Worn(NamedTuple):
    """A wear history with, at each of its K steps, area in contact, mean forces (K, n), and the arm's amplitude."""

    history: WearHistory
    area: np.ndarray
    force: np.ndarray
    arm: np.ndarray


@cache
def worn(scheme):
    """Return the wear of the vibrating joint, each period solved on the rig."""
    problem = rig_problem(
        joint=joint(), interface=Interface(nodes=PLACE, areas=AREAS, gap=CROWN), friction_coefficient=MU,
        frequency=100.0, excitation=20.0, normal_load=LOAD)
    model = PeriodicCycle(QuasiStaticSolver(Solver(harmonics=7, samples=64, estimate_error=False)), problem)
    seen, cycle = {}, model.cycle

    def watched(slow, start):
        response, state = cycle(slow, start)
        seen[slow.depth.tobytes()] = (AREAS @ (response.contact_share > 0.5), AREAS * response.mean_pressure,
                                 0.5 * np.ptp(state.rig_displacement[:, 1]))
        return response, state

    model.cycle = watched
    history = run_history(model, WearSettings(coefficient=K_W, cycles=CYCLES, scheme=scheme, tolerance=3e-2))
    kept = zip(*(seen[depth.tobytes()] for depth in history.depth), strict=True)
    return Worn(history, *(np.array(values) for values in kept))


def press(gap, force):
    """Return the forces (n,) under LOAD by Polonsky and Keer's constrained conjugate gradients (Wear 231, 1999)."""
    direction, last, restart = np.zeros(len(gap)), 1.0, 0.0
    for _ in range(400):
        closed = force > 0.0
        residual = FLEXIBILITY @ force + gap
        residual -= residual[closed].mean()
        size = residual[closed] @ residual[closed]
        direction = np.where(closed, residual + restart * size / last * direction, 0.0)
        bent = FLEXIBILITY @ direction
        bent -= bent[closed].mean()
        length = (residual[closed] @ direction[closed]) / (bent[closed] @ direction[closed])
        force = np.maximum(np.where(closed, force - length * direction, force), 0.0)
        pulled = ~(force > 0.0) & (residual < 0.0)
        force, last, restart = np.where(pulled, force - length * residual, force), size, float(not pulled.any())
        force *= LOAD / force.sum()
        if not pulled.any() and np.abs(residual[force > 0.0]).max() < 1e-6 * CONTACT**2 / RADIUS:
            return force
    raise AssertionError("conjugate gradients did not settle")


def marched(cycles, arm, steps=200):
    """Return depth (n,) and forces (n,) after CYCLES of the arm's amplitude `arm` (K,), m, known at `cycles` (K,)."""
    depth, force = np.zeros(len(AREAS)), np.full(len(AREAS), LOAD / len(AREAS))
    for k in range(steps):
        force = press(CROWN + depth, force + 1e-9 * LOAD)
        amplitude = np.interp((k + 0.5) * CYCLES / steps, cycles, arm)
        # there and back, each way less the elastic travel between the friction of both directions
        path = 4.0 * np.maximum(amplitude - FLEXIBILITY @ (MU * force), 0.0)
        depth += CYCLES / steps * K_W * force / SIDE**2 * path
    return depth, press(CROWN + depth, force + 1e-9 * LOAD)


@pytest.fixture(params=[WearScheme.IMPLICIT, WearScheme.EXPLICIT], ids=str)
def wear(request):
    return worn(request.param)


def test_the_contact_begins_as_hertz_and_grows_while_its_pressure_falls(wear):
    peak = wear.force.max(axis=1) / SIDE**2
    assert peak[0] == pytest.approx(1.5 * LOAD / (np.pi * CONTACT**2), rel=0.02)
    assert abs(np.sqrt(wear.area[0] / np.pi) - CONTACT) < 0.5 * SIDE
    assert np.all(np.diff(wear.area) >= 0.0)
    assert wear.area[-1] > 2.0 * wear.area[0]
    assert np.all(np.diff(peak) < 0.0)
    ratio = peak * wear.area / LOAD  # of peak to mean pressure: 1.5 for Hertz, 1 for a flat worn face
    assert ratio[-1] < 1.12
    assert np.all(wear.history.sliding_distance > 8e-5)  # gross slip


def test_worn_volume_is_that_of_the_dissipated_energy(wear):
    cycles, energy = wear.history.cycles, wear.history.dissipated_energy
    total = np.sum(0.5 * (energy[1:] + energy[:-1]) * np.diff(cycles))
    assert wear.history.volume[-1] == pytest.approx(K_W / MU * total, rel=5e-4, abs=0.0)


def test_both_schemes_meet_a_marching_of_its_own(wear):
    """The own marching is given the arm's amplitude and nothing else of the periods."""
    depth, force = marched(wear.history.cycles, wear.arm)
    assert wear.history.volume[-1] == pytest.approx(AREAS @ depth, rel=1e-3, abs=0.0)
    assert np.abs(wear.history.depth[-1] - depth).max() < 5e-3 * depth.max()
    assert np.array_equal(wear.force[-1] > 1e-3 * LOAD / len(AREAS), force > 0.0)


@record
class Nothing:
    """A state that carries nothing over."""

    flag: float = quantity("1")


class Dragged(WearAlone):
    """The sphere dragged along a path, m per cycle, that is the same all over the contact."""

    state_type = Nothing
    path = 2e-4

    def __init__(self, count, side):
        self.place, self.areas = grid(count, side), np.full((2 * count + 1)**2, side**2)
        self.crown = np.sum(self.place**2, axis=1) / (2 * RADIUS)
        self.flexibility = love(self.place, side)

    def normal_flexibility(self, slow):
        return self.flexibility

    def cycle(self, slow, start):
        depth = slow.depth
        force, approach, closed = press_frictionless(self.crown + depth, self.flexibility,
                                                     np.ones((len(depth), 1)), np.array([LOAD]))
        pressure = force / self.areas
        opening = np.maximum(self.crown + depth + approach + self.flexibility @ force, 0.0)
        return CycleResponse(
            pressure_sliding=pressure * self.path, mean_pressure=pressure, slip_path=self.path * closed,
            mean_opening=opening, contact_share=1.0 * closed, dissipated_energy=MU * LOAD * self.path,
            sliding_distance=0.5 * self.path), Nothing(flag=0.0)


def test_the_uniformly_worn_face_is_the_closed_form():
    """Depth at the middle and rate of the disc 2.5 times as wide as the first contact; errors with refinement."""
    b = 2.5 * CONTACT
    volume = np.pi * b**4 / (4 * RADIUS) - 4 * LOAD * b / (3 * np.pi * G)
    middle = b**2 / (2 * RADIUS) - (2 - 4 / np.pi) * LOAD / (np.pi * b * G)  # u(0) = 2 p b / E*
    rate = K_W * Dragged.path * LOAD / (np.pi * b**2)
    errors = []
    for count in (6, 12):
        face = solve_asymptotic_shape(Dragged(count, 1.2 * b / count), K_W, volume)
        errors.append(np.abs([face.depth.max() / middle - 1, face.rate / rate - 1]))
    assert np.all(errors[0] < [0.01, 0.02])
    assert np.all(errors[1] < 0.5 * errors[0])


def test_marching_tends_to_the_uniformly_worn_face():
    """The marched face nears that of its own volume, while its area grows by more than four."""
    model = Dragged(6, CONTACT / 2)
    history = run_history(model, WearSettings(coefficient=K_W, cycles=12_000, scheme=WearScheme.IMPLICIT))
    area = [model.areas @ (rate > 0.0) for rate in history.rate]
    distance = [solve_asymptotic_shape(model, K_W, float(history.volume[k])).distance(history.depth[k])
                for k in (len(area) // 4, len(area) // 2, -1)]
    assert area[-1] > 4.0 * area[0]
    assert history.volume[-1] == pytest.approx(K_W * LOAD * model.path * 12_000, rel=1e-9, abs=0.0)
    assert distance[0] > distance[1] > distance[2]
    assert distance[2] < 0.05


def test_faces_that_nothing_holds_apart_have_no_static_pressure():
    """A flexibility without resistance, as springs of no sense would have, is no solution and no crash."""
    with pytest.raises(NonConvergenceError, match="static preload"):
        press_frictionless(np.zeros(2), np.zeros((2, 2)), np.ones((2, 1)), np.array([LOAD]))
