"""Effects within the period against a plain integration in time, and against closed forms.

What carries the weight: one rubbing node on the rig's two masses, stepped by Runge-Kutta with a slider on a spring,
shares no code with the solver; each effect is written there once more, as its equation reads. From the solver's first
sample on, the integrated motion must stay the periodic one, and must leave it where the effect is left out.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.effects.backlash import Backlash
from fretflow.effects.contact_stiffness import Asperities, ContactStiffness
from fretflow.effects.directional_friction import DirectionalFriction
from fretflow.effects.excitation_distortion import ExcitationDistortion
from fretflow.effects.force_offset import ForceOffset
from fretflow.effects.initial_gap import InitialGap
from fretflow.effects.load_dependent_friction import LoadDependentFriction
from fretflow.effects.model import EffectModel
from fretflow.effects.normal_load_coupling import NormalLoadCoupling
from fretflow.effects.parallel_stiffness import ParallelStiffness
from fretflow.effects.support_nonlinearity import SupportNonlinearity
from fretflow.effects.velocity_dependent_friction import VelocityDependentFriction
from fretflow.effects.viscous import Viscous
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.fourier import time_derivative
from fretflow.solvers.quasi_static.march import press
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.time_integration import settle
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 900.0, 0.02)  # a hinge within the harmonics that are kept
SAMPLES, STEPS, PERIODS = 512, 6, 2
K, MU, N, F, OMEGA = 20e6, 0.8, 60.0, 75.0, 2.0 * math.pi * 100.0
SOLVER = QuasiStaticSolver(Solver(harmonics=60, samples=SAMPLES, estimate_error=False))


def one_node(nodes=1, areas=1e-6):
    stiffness = np.kron(np.eye(nodes), np.diag([K, K, 2.0 * K]) / nodes)
    face = Interface(nodes=np.column_stack([np.linspace(-5e-4, 5e-4, nodes), np.zeros(nodes)]),
                     areas=np.full(nodes, areas / nodes), gap=np.zeros(nodes))
    return rig_problem(joint=QuasiStaticJoint.from_stiffness(stiffness, RIG), interface=face,
                           friction_coefficient=MU, frequency=100.0, excitation=F, normal_load=N)


def integrate(period, friction=lambda x, v, way: 1.0, support=lambda x: 0.0, drive=lambda t: 0.0, spring=K,
              play=0.0, beside=lambda x, v: 0.0):
    """Step both masses; return the arm's motion and the friction force at the samples of the last period.

    `friction` gives the limit over mu N at the arm's position and speed for sliding to `way`; `beside` is a force on
    the arm, `play` that of the hinge's spring from end to end.
    """
    step = 0.01 / (SAMPLES * STEPS)
    velocity = time_derivative(period.rig_displacement, OMEGA)[0]
    state = np.concatenate([period.rig_displacement[0], velocity])
    slider = state[1] + float(-period.friction_force[0]) / spring  # the force on the arm is spring (slider - arm)

    def rate(t, y, held):
        xb, xa, vb, va = y
        crossed = xa - xb - math.copysign(min(abs(xa - xb), play / 2), xa - xb)
        hinge = RIG.hinge_stiffness * crossed + RIG.hinge_damping * (va - vb)
        ground = RIG.ground_stiffness * xb + RIG.ground_damping * vb
        return np.array([vb, va,
                         (F * math.cos(OMEGA * t) + drive(t) + hinge - ground - support(xb)) / RIG.moving_mass,
                         (-hinge + spring * (held - xa) + beside(xa, va)) / RIG.arm_mass])

    arm, force = np.empty(SAMPLES), np.empty(SAMPLES)
    for n in range(SAMPLES * STEPS * PERIODS):
        if n % STEPS == 0:
            arm[n // STEPS % SAMPLES], force[n // STEPS % SAMPLES] = state[1], -spring * (slider - state[1])
        t = n * step
        k1 = rate(t, state, slider)
        k2 = rate(t + step / 2, state + step / 2 * k1, slider)
        k3 = rate(t + step / 2, state + step / 2 * k2, slider)
        k4 = rate(t + step, state + step * k3, slider)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        way = 1.0 if state[1] > slider else -1.0
        limit = MU * N * friction(state[1], state[3], way)
        if spring * abs(state[1] - slider) > limit:
            slider = state[1] - way * limit / spring
    return arm, force


def speed_factor(x, v, way):
    return 1.0 + 0.3 * math.exp(-abs(v) / 2e-3)


CASES = {
    "baseline": (None, {}),
    "velocity": (VelocityDependentFriction(strength=0.3), {"friction": speed_factor}),
    "load": (LoadDependentFriction(exponent=0.25).changed(reference_pressure=100e6),
             {"friction": lambda x, v, way: 0.6**-0.25}),
    "direction": (DirectionalFriction(difference=0.08), {"friction": lambda x, v, way: 1.0 + 0.08 * way}),
    "direction, the mean at rest": (DirectionalFriction(difference=0.08, rest=0.0), {
        "friction": lambda x, v, way: 1.0 + 0.08 * (way if way * v > 0.0 else 0.0)}),
    "direction by the speed": (DirectionalFriction(difference=0.08, rest=-1.0, speed_scale="2 mm/s"), {
        "friction": lambda x, v, way: 1.0 + 0.08 * v / math.hypot(v, 2e-3)}),
    "coupling": (NormalLoadCoupling().changed(slope=1e6), {"friction": lambda x, v, way: 1.0 + 1e6 * x / N}),
    "curved coupling": (NormalLoadCoupling().changed(slope=3e5, curvature=1e4),
                        {"friction": lambda x, v, way: 1.0 + 3e5 * x * (1.0 + 1e4 * x) / N}),
    "support": (SupportNonlinearity().changed(stiffness=1e15), {"support": lambda x: 1e15 * x**3}),
    "drive": (ExcitationDistortion(fundamental=0.05, second=0.2, second_phase=1.0, third=0.1, third_phase=-0.5,
                                   fifth=0.2, fifth_phase=2.0),
              {"drive": lambda t: F * (0.05 * math.cos(OMEGA * t) + 0.2 * math.cos(2 * OMEGA * t + 1.0)
                                       + 0.1 * math.cos(3 * OMEGA * t - 0.5) + 0.2 * math.cos(5 * OMEGA * t + 2.0))}),
    "asperities": (ContactStiffness(exponent=0.5).changed(stiffness=30e6), {"spring": K * 30e6 / (K + 30e6)}),
    "beside": (ParallelStiffness().changed(stiffness=1e6), {"beside": lambda x, v: -1e6 * x}),
    "beside, hardening": (ParallelStiffness(hardening=1.0 / 3.0).changed(stiffness=3e5),
                          {"beside": lambda x, v: -3e5 * x - 1e15 * x**3}),
    "dashpot": (Viscous().changed(damping=1500.0), {"beside": lambda x, v: -1500.0 * v}),
    "orifice": (Viscous(power=2.0).changed(damping=1500.0), {"beside": lambda x, v: -1500.0 / 6.3e-3 * abs(v) * v}),
    "offset": (ForceOffset().changed(force_offset=5.0), {"drive": lambda t: 5.0}),
    "play": (Backlash().changed(play=3e-6), {"play": 3e-6})}


@pytest.mark.parametrize("name", CASES)
def test_integration_in_time_stays_with_the_period(name):
    effect, written_again = CASES[name]
    model = EffectModel.build(one_node(), [] if effect is None else [effect])
    period = SOLVER.solve(model.problem(model.initial()))
    for values, own in zip(integrate(period, **written_again),
                           (period.rig_displacement[:, 1], period.friction_force), strict=True):
        assert np.sqrt(np.mean((values - own)**2)) < 0.006 * np.ptp(own)
    if effect is not None:  # without it, they part
        arm, force = integrate(period)
        parted = max(np.sqrt(np.mean((values - own)**2)) / np.ptp(own) for values, own in (
            (arm, period.rig_displacement[:, 1]), (force, period.friction_force)))
        assert parted > 0.015


@pytest.mark.parametrize("name", ["velocity", "coupling", "curved coupling", "support", "drive"])
def test_the_check_of_runs_knows_effects(name):
    effect, _ = CASES[name]
    model = EffectModel.build(one_node(), [effect])
    problem = model.problem(model.initial())
    period = SOLVER.solve(problem)
    history = settle(problem, period, (2, 2), 2 * SAMPLES, 0.0)
    assert history.sliding_distance[-1] == pytest.approx(np.ptp(period.displacement[:, 0, 0]), rel=1e-3)
    force = history.of_period(history.friction_force)[::2]
    assert np.sqrt(np.mean((force - period.friction_force)**2)) < 1e-3 * np.ptp(force)


def test_a_tilted_bed_of_springs_is_pressed_linearly():
    """On springs that do not know each other the pressure is linear, and zero where the tilt would pull."""
    problem = one_node(nodes=11)
    tilt = 4e-7
    pressed = press(InitialGap().changed(tilt_x=tilt).period(problem, None))
    x = np.linspace(0.0, 1.0, 11)
    slope = -2.0 * K / 11 * tilt
    expected = N / 11 + slope * (x - 0.5)
    assert pressed.force[2::3] == pytest.approx(expected, rel=1e-9)
    steep = press(InitialGap().changed(tilt_x=4e-6).period(problem, None)).force[2::3]
    closed = int(np.sum(steep > 0.0))
    assert 0 < closed < 11
    # a triangle of forces: differences of -k tilt / 10 between neighbours, and N in all
    assert np.diff(steep[:closed]) == pytest.approx(np.full(closed - 1, -2.0 * K / 11 * 4e-7), rel=1e-9)
    assert steep.sum() == pytest.approx(N, rel=1e-12)


def test_crown_and_cylinder_are_shallow_spheres_and_cylinders():
    nodes = np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, -1e-3], [1e-3, 1e-3], [-1e-3, -1e-3]])
    flat = replace(one_node(nodes=5), interface=Interface(nodes=nodes, areas=np.ones(5), gap=np.zeros(5)))
    radius = 0.5
    crown = InitialGap().changed(tilt_x=0.0, crown=2.0 * 1e-6 / (2.0 * radius)).period(flat, None).interface.gap
    sphere = radius - np.sqrt(radius**2 - np.sum(nodes**2, axis=1))
    assert crown == pytest.approx(sphere, rel=1e-5, abs=1e-15)
    bent = InitialGap().changed(tilt_x=0.0, cylinder=1e-6 / (2.0 * radius)).period(flat, None).interface.gap
    assert bent == pytest.approx(radius - np.sqrt(radius**2 - nodes[:, 0]**2), rel=1e-5, abs=1e-15)


def test_rounded_edges_are_arcs_beside_a_flat():
    places = np.linspace(-1e-3, 1e-3, 21)
    nodes = np.column_stack([places, np.zeros(21)])
    flat = replace(one_node(nodes=21), interface=Interface(nodes=nodes, areas=np.ones(21), gap=np.zeros(21)))
    radius, end = 0.5, 0.6e-3
    rounded = InitialGap().changed(tilt_x=0.0, cylinder=(1e-3 - end)**2 / (2.0 * radius), flat=0.6).period(flat, None)
    beyond = np.maximum(np.abs(places) - end, 0.0)
    assert rounded.interface.gap == pytest.approx(radius - np.sqrt(radius**2 - beyond**2), rel=1e-5, abs=1e-15)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 0.8, 1.0])
def test_asperities_integrate_their_power_law(exponent):
    """The compression is the integral of dp / k(p), taken numerically."""
    law = Asperities(stiffness=5e13, exponent=exponent, ratio=1.2, reference_pressure=60e6)
    pressure = np.linspace(0.0, 200e6, 100_001)
    stiffness = 5e13 * np.maximum(pressure / 60e6, 0.01)**exponent
    slices = 0.5 * (1.0 / stiffness[1:] + 1.0 / stiffness[:-1]) * np.diff(pressure)
    expected = np.concatenate([[0.0], np.cumsum(slices)])
    assert law.compression(pressure) == pytest.approx(expected, rel=1e-6, abs=1e-15)


def test_asperities_carry_the_load_at_rest_by_their_full_law():
    """Between rigid bodies of different heights each asperity carries what its own compression says."""
    problem = one_node(nodes=4)
    rigid = QuasiStaticJoint.from_stiffness(1e8 * problem.structure.stiffness, RIG)
    heights = np.array([0.0, 1e-7, 2e-7, 9e-7])
    problem = replace(problem, structure=rigid, interface=replace(problem.interface, gap=heights))
    effect = ContactStiffness(exponent=0.5).changed(stiffness=60e6)
    pressed = press(effect.period(problem, None))
    force = pressed.force[2::3]
    compression = effect.asperities(problem.interface.areas).compression(force / 0.25e-6)
    assert force.sum() == pytest.approx(N, rel=1e-12)
    assert compression + heights == pytest.approx(np.full(4, compression[0]), rel=1e-5)
