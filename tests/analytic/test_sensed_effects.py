"""What sensors do to the channels, against closed forms and the integrated equations of motion.

What carries the weight: a resonance is integrated as a second-order equation by another library, a delay is compared
with the shifted function, the slope of a leaning loop is read by the reader of loops, and the spread of friction over
nodes is summed by a plain march.
"""

from dataclasses import replace

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.effects.catalogue import catalogue
from fretflow.effects.channel_delay import ChannelDelay
from fretflow.effects.distributed_micro_slip import DistributedMicroSlip
from fretflow.effects.extra_mode import ExtraMode
from fretflow.effects.model import EffectModel
from fretflow.effects.parallel_stiffness import ParallelStiffness
from fretflow.effects.sensor_drift import SensorDrift
from fretflow.effects.sensor_inertia import SensorInertia
from fretflow.effects.sensor_path_compliance import SensorPathCompliance
from fretflow.effects.viscous import Viscous
from fretflow.pipeline.problem import rig_problem
from fretflow.recordings.hysteresis import HysteresisLoop, read_loop
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.sensors import Signals, in_sensing_order
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.integrate import solve_ivp

N, T = 512, 0.01
OMEGA = 2.0 * np.pi / T
TIME = T * np.arange(N) / N
K, S, X = 28e6, 50.0, 7e-6


def force_at(t):
    return 40.0 * np.cos(OMEGA * t) + 12.0 * np.sin(3.0 * OMEGA * t) + 3.0 * np.cos(5.0 * OMEGA * t) + 2.0


def period(**channels):
    x = X * np.cos(OMEGA * TIME)
    return Signals(**{"step": T / N, "displacement": x, "friction_force": force_at(TIME), "arm": x, **channels})


def test_a_compliant_path_leans_the_loop():
    x = X * np.cos(OMEGA * TIME)
    force = np.where(TIME < T / 2, np.maximum(S - K * (X - x), -S), np.minimum(-S + K * (x + X), S))
    seen = SensorPathCompliance().changed(compliance=2e-8).sense(period(friction_force=force))
    loop = HysteresisLoop(displacement=seen.displacement, force=seen.friction_force)
    assert 1.0 / read_loop(loop, 60.0).tangential_stiffness == pytest.approx(1.0 / K + 2e-8, rel=1e-9)
    assert np.ptp(seen.displacement) == pytest.approx(2.0 * X + 2e-8 * 2.0 * S, rel=1e-9)


def test_mass_spring_and_dashpot_add_their_forces():
    v, a = -X * OMEGA * np.sin(OMEGA * TIME), -X * OMEGA**2 * np.cos(OMEGA * TIME)
    for effect, expected in ((SensorInertia().changed(mass=2.0), 2.0 * a),
                             (ParallelStiffness().changed(stiffness=3e5), 3e5 * X * np.cos(OMEGA * TIME)),
                             (Viscous().changed(damping=80.0), 80.0 * v)):
        added = effect.sense(period()).friction_force - force_at(TIME)
        assert added == pytest.approx(expected, abs=1e-9)
        record = period(periodic=False, arm_velocity=v, arm_acceleration=a)
        assert effect.sense(record).friction_force - force_at(TIME) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("delay", [1.7e-4, -0.6e-4])
def test_a_delay_shifts_the_force_alone(delay):
    late = ChannelDelay().changed(delay=delay)
    seen = late.sense(period())
    assert seen.friction_force == pytest.approx(force_at(TIME - delay), abs=1e-10)
    assert np.array_equal(seen.displacement, period().displacement)
    record = late.sense(period(periodic=False)).friction_force
    inside = slice(20, -20)
    # linear between samples: the second derivative times the step squared over 8
    assert record[inside] == pytest.approx(force_at(TIME - delay)[inside],
                                           abs=(5.0 * OMEGA)**2 * 55.0 * (T / N)**2 / 8.0)


@pytest.mark.parametrize("poles", [1, 3])
def test_a_delay_by_filters_is_that_of_low_passes_in_a_row(poles):
    """Each integrated in time: steady over a period, and from rest over a record."""
    delay = 2.5e-4
    late = ChannelDelay(rounding=1.0 / poles).changed(delay=delay)

    def passed(times, forcing):
        def rate(t, y):
            return (np.r_[forcing(t), y[:-1]] - y) * poles / delay

        return solve_ivp(rate, (times[0], times[-1]), np.full(poles, forcing(times[0])), t_eval=times, rtol=1e-9,
                         atol=1e-9, max_step=T / N).y[-1]

    steady = passed(T * np.arange(3 * N) / N, force_at)[-N:]
    assert late.sense(period()).friction_force == pytest.approx(steady, abs=2e-3)
    assert np.array_equal(late.sense(period()).displacement, period().displacement)
    record = passed(T * np.arange(N) / N, force_at)
    # samples stand for what is about them: half the second derivative times a twelfth of the step squared, and the rest
    assert late.sense(period(periodic=False)).friction_force == pytest.approx(record, abs=0.05)


def test_many_low_passes_are_a_mere_delay():
    delay = 2.5e-4
    many, none = (ChannelDelay(rounding=share).changed(delay=delay).sense(period()) for share in (1e-6, 0.0))
    assert many.friction_force == pytest.approx(none.friction_force, abs=1e-3)


def test_drift_grows_over_the_test():
    drift = SensorDrift().changed(drift=2.0)
    for elapsed in (0.0, 0.25, 1.0):
        assert drift.sense(period(elapsed=elapsed)).friction_force == pytest.approx(force_at(TIME) + 2.0 * elapsed)
    record = drift.sense(period(periodic=False)).friction_force - force_at(TIME)
    assert record[[0, -1]] == pytest.approx([0.0, 2.0], abs=1e-12)
    assert np.diff(record) == pytest.approx(np.full(N - 1, 2.0 / (N - 1)), rel=1e-9)


def ringing(share, frequency, zeta, times, forcing):
    """Integrate the oscillator that the force drives, from its rest under the first force."""
    natural = 2.0 * np.pi * frequency

    def rate(t, y):
        return [y[1], natural**2 * (forcing(t) - y[0]) - 2.0 * zeta * natural * y[1]]

    solution = solve_ivp(rate, (times[0], times[-1]), [forcing(times[0]), 0.0], t_eval=times, rtol=1e-9, atol=1e-9,
                         max_step=2e-4)
    return (1.0 - share) * forcing(times) + share * solution.y[0]


@pytest.mark.parametrize(("share", "frequency", "zeta"), [(1.0, 270.0, 0.1), (0.4, 430.0, 0.06)])
def test_an_extra_mode_is_the_integrated_oscillator(share, frequency, zeta):
    mode = ExtraMode(damping_ratio=zeta, share=share).changed(frequency=frequency)
    times = T * np.arange(16 * N) / N  # until nothing is left of the start
    steady = ringing(share, frequency, zeta, times, force_at)[-N:]
    assert mode.sense(period()).friction_force == pytest.approx(steady, abs=2e-3)

    # a record that is linear between samples, with corners and a step in slope, from rest on
    coarse = T / 40 * np.arange(200)
    values = np.clip(90.0 * np.sin(0.8 * OMEGA * coarse + 0.3), -S, S)
    fine = T / 400 * np.arange(1991)
    own = ringing(share, frequency, zeta, fine, lambda t: np.interp(t, coarse, values))[::10]
    record = Signals(step=T / 40, displacement=values, friction_force=values, arm=values, periodic=False)
    assert mode.sense(record).friction_force == pytest.approx(own, abs=2e-3)


def test_sensors_follow_each_other_from_the_joint_to_the_recording():
    """A delay comes after what the force path adds, whatever the ids say."""
    effects = [catalogue()[name]() for name in ("channel-delay", "sensor-inertia", "parallel-stiffness")]
    assert [effect.id for effect in in_sensing_order(effects)] == [
        "parallel-stiffness", "sensor-inertia", "channel-delay"]
    seen = period()
    for effect in in_sensing_order(effects):
        seen = effect.sense(seen)

    def whole(t):
        return force_at(t) + (0.15e6 - 0.5 * OMEGA**2) * X * np.cos(OMEGA * t)

    assert seen.friction_force == pytest.approx(whole(TIME - 100e-6), abs=1e-9)


@pytest.fixture
def bare():
    """Return nodes on springs of their own between rigid bodies."""
    nodes, stiffness = 12, np.diag([2e6, 2e6, 4e6])
    joint = QuasiStaticJoint.from_stiffness(np.kron(np.eye(nodes), stiffness),
                                            LumpedRig.from_modes(10.0, 0.5, 40.0, 900.0, 0.02))
    areas = 1e-6 / nodes * np.linspace(0.8, 1.2, nodes)
    return rig_problem(joint=joint, interface=Interface(nodes=np.zeros((nodes, 2)), areas=areas,
                           gap=np.zeros(nodes)), friction_coefficient=0.8, frequency=100.0, excitation=60.0,
                           normal_load=60.0)


def test_friction_that_is_spread_over_nodes_is_the_sum_of_their_sliders(bare):
    """Nodes on springs of their own between rigid bodies slide one by one."""
    nodes, areas = bare.interface.size, bare.interface.areas
    effect = DistributedMicroSlip(spread=0.9, power=1.5)
    model = EffectModel.build(bare, [effect])
    problem = model.problem(model.initial())
    mu = problem.friction_coefficient
    assert mu @ areas / areas.sum() == pytest.approx(0.8, rel=1e-14)
    assert np.sort(mu) / 0.8 == pytest.approx(effect.shares((np.arange(nodes) + 0.5) / nodes), rel=0.02)
    assert np.abs(np.corrcoef(np.arange(nodes), mu)[0, 1]) < 0.3
    solution = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(problem)
    arm = solution.rig_displacement[:, 1]
    force, summed = np.zeros(nodes), []
    for moved in np.diff(np.tile(arm, 3), prepend=arm[0]):
        force = np.clip(force + 2e6 * moved, -mu * 5.0, mu * 5.0)
        summed.append(force.sum())
    assert solution.friction_force == pytest.approx(np.array(summed[-128:]), abs=1e-6)
    smooth = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(bare)
    assert np.abs(solution.friction_force - smooth.friction_force).max() > 2.0


def test_the_places_of_a_face_have_the_same_limits_on_every_mesh(bare):
    """A finer mesh has more nodes in each place, and nodes that lie nowhere follow one another."""
    effect, found = DistributedMicroSlip(spread=0.7, power=2.0), []
    for side in (5, 9, 17):
        x, y = (one.ravel() for one in np.meshgrid(*2 * [np.linspace(0.0, 1e-3, side)], indexing="ij"))
        face = Interface(nodes=np.column_stack([x, y]), areas=np.full(side**2, 1e-6 / side**2), gap=np.zeros(side**2))
        problem = effect.period(replace(bare, interface=face), None)
        at_lattice = problem.friction_coefficient.reshape(side, side)[::(side - 1) // 4, ::(side - 1) // 4]
        found.append(at_lattice / at_lattice.mean())
        assert len(np.unique(np.round(problem.friction_coefficient, 12))) == 25
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-12)
    np.testing.assert_allclose(np.sort(found[0].ravel()), effect.shares((np.arange(25) + 0.5) / 25), rtol=2e-2)
