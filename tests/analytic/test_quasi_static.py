"""The true periodic solver against laws that its solution must obey, and its tangent against differences.

What carries the weight: every sample of every node is audited against equilibrium, complementarity and the friction
disc; the work of the excitation must equal friction and damping losses; a joint that sticks must be the linear one;
and the tangent through the history must be that of central differences.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.errors import AuditError, NonConvergenceError
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.audit import audit_period
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix, to_complex
from fretflow.solvers.periodic import NormalLoad
from fretflow.solvers.quasi_static import solver as quasi_static
from fretflow.solvers.quasi_static.march import ContactMarch, press
from fretflow.solvers.quasi_static.newton import InternalNewton
from fretflow.solvers.quasi_static.sample import SampleState
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint, change_rig
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
MU, LOAD = 0.88, 60.0
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
JOINT = QuasiStaticJoint.from_stiffness(1e3 * DATA["K"], RIG)
NODES = len(DATA["x"])
ARM = np.array([1])  # the internal coordinate that moves the contact
DOME = 4e-7 * np.sum((DATA["x"][:, :2] / 0.5)**2, axis=1)  # m; opens the corners in part of the period


def problem(force, gap=None, mu=MU):
    interface = Interface(nodes=1e-3 * DATA["x"][:, :2], areas=np.full(NODES, 1e-6 / NODES),
                          gap=np.zeros(NODES) if gap is None else gap)
    return rig_problem(joint=JOINT, interface=interface, friction_coefficient=mu, frequency=100.0,
                           excitation=force, normal_load=LOAD)


@cache
def solution(force, domed=False, samples=128):
    settings = Solver(harmonics=25, samples=samples, estimate_error=False)
    return QuasiStaticSolver(settings).solve(problem(force, DOME if domed else None))


CASES = [(30.0, False), (53.0, False), (75.0, False), (50.0, True), (75.0, True)]


@pytest.mark.parametrize(("force", "domed"), CASES)
def test_every_sample_obeys_the_contact_laws(force, domed):
    period, gap = solution(force, domed), DOME if domed else np.zeros(NODES)
    pressing, friction = period.force[:, :, 2], np.hypot(period.force[:, :, 0], period.force[:, :, 1])
    opening = gap + period.displacement[:, :, 2]
    small = 1e-8 * LOAD
    assert pressing.min() >= -small
    assert opening.min() >= -1e-14
    assert np.abs(pressing * opening).max() < 1e-14 * LOAD
    assert np.all(friction <= MU * pressing + small)
    slip = period.displacement[:, :, :2] - np.roll(period.displacement[:, :, :2], 1, axis=0)
    slips = period.state == ContactState.SLIP
    assert np.all(np.abs(friction - MU * pressing)[slips] < small)
    power = np.sum(period.force[:, :, :2] * slip, axis=2)
    assert np.abs(power + MU * pressing * np.hypot(slip[..., 0], slip[..., 1]))[slips].max(initial=0.0) < 1e-6 * small
    assert np.abs(slip[period.state == ContactState.STICK]).max() < 1e-15
    assert np.any(period.state == ContactState.SEPARATION) or not domed


@pytest.mark.parametrize(("law", "channel", "factor", "shift"), [
    ("cone", "force", (1.0 + 1e-5, 1.0 + 1e-5, 1.0), 0.0), ("slip_direction", "displacement", (-1.0, 1.0, 1.0), 0.0),
    ("penetration", "displacement", (1.0, 1.0, 1.0), -1e-9)])
def test_a_period_that_breaks_the_contact_law_at_one_sample_is_refused(law, channel, factor, shift):
    """With all that friction may depend on a period keeps its own law; spoiled at one sliding node it does not."""
    whole = replace(problem(75.0), law=Coulomb(MU, exponent=0.1, asymmetry=0.2),
                    structure=change_rig(JOINT, load_slope=2e5))
    period = QuasiStaticSolver(Solver(harmonics=15, samples=64, estimate_error=False)).solve(whole)
    audit_period(whole, period, 1e-7)
    values = getattr(period, channel).copy()
    j, m = np.argwhere(period.state == ContactState.SLIP)[20]
    values[j, m] = values[j, m] * factor + np.array([0.0, 0.0, shift])
    with pytest.raises(AuditError, match=law):
        audit_period(whole, replace(period, **{channel: values}), 1e-7)
    with pytest.raises(AuditError, match="cone"):
        audit_period(replace(whole, law=replace(whole.law, asymmetry=0.0)), period, 1e-7)


def test_the_solver_audits_its_periods(monkeypatch):
    """What a march leaves outside of the cone does not get out of the solver."""
    monkeypatch.setattr(quasi_static, "_solution", lambda *given: spoiled(made(*given)))
    with pytest.raises(AuditError, match="cone"):
        QuasiStaticSolver(Solver(harmonics=5, samples=32, estimate_error=False)).solve(problem(60.0))


made = quasi_static._solution


def spoiled(period):
    """Return a period with a hundred-thousandth more friction."""
    return replace(period, force=period.force * np.array([1.0 + 1e-5, 1.0 + 1e-5, 1.0]))


@pytest.mark.parametrize(("force", "domed"), CASES)
def test_equilibrium_of_the_contact_and_of_the_load(force, domed):
    period = solution(force, domed)
    forces = period.force.reshape(len(period.force), -1)
    assert period.force[:, :, 2].sum(axis=1) == pytest.approx(LOAD, rel=1e-8)
    assert -period.force[:, :, 0].sum(axis=1) == pytest.approx(period.friction_force, abs=1e-12)
    # u - flexibility f is a rigid motion of the arm: all nodes share x and z, and y stays
    rigid = (period.displacement.reshape(forces.shape) - forces @ JOINT.flexibility).reshape(len(forces), NODES, 3)
    assert np.ptp(rigid, axis=1).max() < 1e-14
    assert rigid[:, :, 0] == pytest.approx(np.broadcast_to(period.rig_displacement[:, 1:], rigid.shape[:2]), abs=1e-14)
    assert np.abs(rigid[:, :, 1]).max() < 1e-14


@pytest.mark.parametrize("domed", [False, True])
def test_faces_bear_what_a_curved_wedge_presses(domed):
    """Equilibrium along z under ``N + s x + b x^2``, and the arm comes down by what the contact's flexibility gives."""
    slope, bend = 5e5, 2e10
    whole = problem(60.0, DOME if domed else None)
    period = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(
        replace(whole, structure=change_rig(JOINT, load_slope=slope, load_curvature=bend)))
    arm = period.rig_displacement[:, 1]
    pressed = LOAD + slope * arm + bend * arm**2
    assert np.ptp(bend * arm**2) > 0.03 * LOAD
    assert period.force[:, :, 2].sum(axis=1) == pytest.approx(pressed, rel=1e-8)
    forces = period.force.reshape(len(arm), -1)
    rigid = (period.displacement.reshape(forces.shape) - forces @ JOINT.flexibility).reshape(len(arm), NODES, 3)
    assert np.ptp(rigid, axis=1).max() < 1e-14
    assert rigid[:, 0, 2] == pytest.approx(period.output("approach"), abs=1e-14)


@pytest.mark.parametrize("force", [53.0, 75.0])
def test_work_of_the_excitation_is_friction_and_damping(force):
    """Work over a period by Fourier series of the motion alone; friction by forces times slips."""
    period = solution(force, samples=256)
    amplitudes = to_complex(analysis_matrix(25, 256) @ period.rig_displacement)
    given = np.pi * force * np.imag(np.conj(amplitudes[1, 0]))
    omega = 2 * np.pi * 100.0 * np.arange(26)
    damped = sum(np.pi * w * k * (np.conj(a) @ RIG.damping @ a).real
                 for w, k, a in zip(omega, np.arange(26), amplitudes, strict=True))
    slid = period.displacement - np.roll(period.displacement, 1, axis=0)
    rubbed = -np.sum(period.force[:, :, :2] * slid[:, :, :2])
    assert given == pytest.approx(rubbed + damped, rel=5e-3)


def test_a_joint_that_sticks_is_the_linear_joint():
    period = solution(30.0)
    omega = 2 * np.pi * 100.0
    impedance = RIG.impedance(np.array([omega]))[0]
    impedance[1, 1] += JOINT.motion[:, 0] @ JOINT.stiffness @ JOINT.motion[:, 0]
    expected = np.linalg.solve(impedance, [30.0, 0.0])
    amplitudes = to_complex(analysis_matrix(3, 128) @ period.rig_displacement)
    assert amplitudes[1] == pytest.approx(expected, rel=2e-3)


def friction(march):
    """Return the x force on the upper nodes of a marched period, (N,)."""
    return march.history.force[:, 0::3].sum(axis=1)


@pytest.mark.parametrize("stroke", [2.2e-6, 8e-6])
def test_tangent_of_the_friction_force_is_that_of_central_differences(stroke):
    """In partial slip, where the contact remembers, and in gross slip, where it forgets."""
    samples, harmonics = 64, 5
    synthesis = synthesis_matrix(harmonics, samples)
    arm = np.zeros(2 * harmonics + 1)
    arm[[1, 2, 5]] = 0.5 * stroke, 0.02 * stroke, 0.05 * stroke
    direction = np.random.default_rng(3).normal(size=len(arm)) * 1e-6

    def march(coefficients):
        marching = ContactMarch.of(problem(1.0), ARM)
        return marching.period((synthesis @ coefficients)[:, None], synthesis[:, None], marching.preloaded(), None,
                               1e-12)

    marched = march(arm)
    h = 1e-6
    plus, minus = (friction(march(arm + s * h * direction)) for s in (1, -1))
    differences = (plus - minus) / (2 * h)
    assert marched.tangent[:, 0] @ direction == pytest.approx(
        differences, rel=1e-5, abs=1e-5 * np.abs(differences).max())


@pytest.mark.parametrize("stroke", [3.4e-6, 3.8e-6, 4.2e-6])
def test_tangent_is_exact_though_the_period_need_not_repeat_closely(stroke):
    """Where a contact just slides as a whole, its memory fades over periods, and that of its tangent likewise."""
    samples, harmonics = 64, 5
    synthesis = synthesis_matrix(harmonics, samples)
    arm = synthesis[:, [1, 2, 5]] @ np.array([0.5, 0.02, 0.05]) * stroke
    direction = synthesis @ np.random.default_rng(3).normal(size=2 * harmonics + 1)

    def march(position, directions, before=None, repeat=0.0):
        marching = ContactMarch.of(problem(1.0), ARM)
        start, near = (marching.preloaded(), None) if before is None else (SampleState.of(before), before)
        return marching.period(position[:, None], directions[:, None], start, near, 1e-12, repeat)

    plus, minus = (friction(march(arm + h * direction, np.zeros((samples, 0)))) for h in (1e-12, -1e-12))
    differences = (plus - minus) / 2e-12
    settled = march(arm, np.zeros((samples, 0))).history
    tangent = march(arm, direction[:, None], settled, repeat=1e-4).tangent[:, 0, 0]
    assert tangent == pytest.approx(differences, abs=1e-4 * np.abs(differences).max())


def test_a_tangent_repeats_by_itself_and_not_by_what_a_period_before_ended_with():
    """Where all slide for some samples, forces forget what was before; the directions of sliding do later."""
    samples, harmonics = 64, 5
    synthesis = synthesis_matrix(harmonics, samples)
    arm = synthesis[:, [1, 2, 6]] @ np.array([0.5, 0.02, 0.05]) * 4.46e-6

    def march(position, directions):
        marching = ContactMarch.of(problem(1.0, DOME), ARM)
        return marching.period(position[:, None], directions[:, None], marching.preloaded(), None, 1e-8, 1e-5)

    marched, none = march(arm, synthesis), np.zeros((samples, 0))
    direction = np.random.default_rng(3).normal(size=2 * harmonics + 1)
    plus, minus = (friction(march(arm + h * synthesis @ direction, none)) for h in (1e-12, -1e-12))
    differences = (plus - minus) / 2e-12
    assert marched.tangent[:, 0] @ direction == pytest.approx(differences, abs=1e-3 * np.abs(differences).max())


@pytest.mark.parametrize("stroke", [3.0e-6, 3.4e-6, 3.8e-6])
def test_a_period_is_the_same_with_what_another_taught_of_the_memory(stroke):
    """How a period's end follows its start is kept from motion to motion; only the periods needed may differ."""
    motion = synthesis_matrix(5, 64)[:, [1, 2, 5]] @ np.array([0.5, 0.02, 0.05])
    none = np.zeros((64, 1, 0))

    def march(marching, amplitude):
        return marching.period(amplitude * motion[:, None], none, marching.preloaded(), None, 1e-12)

    fresh, taught = (ContactMarch.of(problem(1.0), ARM) for _ in range(2))
    march(taught, 0.98 * stroke)
    expected, marched = march(fresh, stroke), march(taught, stroke)
    assert friction(marched) == pytest.approx(friction(expected), abs=1e-8 * LOAD)


def test_a_load_pressed_on_against_friction_shears_the_faces_within_their_limit():
    """No lateral slip, hence no lateral motion at all, where every node sticks; no net friction force either."""
    given = replace(problem(53.0), preload=NormalLoad(LOAD, frictional=True))
    pressed, smooth = press(given), press(problem(53.0))
    normal, tangential = pressed.force[2::3], pressed.force.reshape(NODES, 3).T[:2]
    assert normal.sum() == pytest.approx(LOAD, rel=1e-10)
    assert np.all(np.hypot(*tangential) < MU * normal)
    assert np.abs(tangential.sum(axis=1)).max() < 1e-9 * LOAD
    assert np.hypot(*tangential).sum() > 0.1 * LOAD
    assert np.all(pressed.displacement == 0.0)
    assert np.any(np.abs(smooth.displacement.reshape(NODES, 3)[:, :2]) > 1e-8)
    # held laterally, the bodies are stiffer
    assert abs(approach(given, pressed)) < abs(approach(given, smooth))


def approach(given, pressed):
    """Return how far the arm has come, m."""
    boundary = given.boundary
    return boundary.free_motion(np.zeros((1, 2)), pressed.displacement[None], given.loads_at(np.zeros(1)))[0, 0]


def test_a_warm_start_finds_the_same_period():
    cold = solution(60.0)
    warm = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(problem(60.5), cold)
    again = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False)).solve(problem(60.5))
    assert len(warm.residual_history) < 6
    assert warm.friction_force == pytest.approx(again.friction_force, abs=1e-5)
    assert warm.displacement == pytest.approx(again.displacement, abs=1e-11)


def test_giving_up_keeps_the_history():
    with pytest.raises(NonConvergenceError) as error:
        QuasiStaticSolver(Solver(harmonics=25, samples=128, max_iterations=1)).solve(problem(60.0))
    assert len(error.value.history) == 2
    assert error.value.exit_code == 3


def test_former_tangents_that_lead_astray_are_done_without(monkeypatch):
    """Where steps with a former tangent end in a dead end, the period is the one that is found without them."""
    period = solution(53.0)

    search, ended = InternalNewton._searched, []

    def dead_end(newton, now, tangent, lagged_below, shortest):
        if lagged_below and now.norm < lagged_below:
            ended.append(now)
            raise NonConvergenceError("a dead end", [now.norm])
        return search(newton, now, tangent, lagged_below, shortest)

    monkeypatch.setattr(InternalNewton, "_searched", dead_end)
    solver = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False))
    again = solver.solve(problem(53.0))
    assert ended
    assert again.rig_displacement == pytest.approx(period.rig_displacement, rel=1e-6, abs=1e-12)


def test_a_residual_that_stalls_by_the_tolerance_is_taken_by_who_asks_for_it(monkeypatch):
    """Where the samples leave no root, as kinks fall between them: within what these miss of the period anyway."""
    exact, dense = solution(53.0), solution(53.0, samples=256)
    stall = max(norm for norm in exact.residual_history if norm < 1e-3)
    searched = InternalNewton._searched

    def stalling(self, now, tangent, lagged_below, shortest):
        return None if now.norm <= 1.01 * stall else searched(self, now, tangent, lagged_below, shortest)

    monkeypatch.setattr(InternalNewton, "_searched", stalling)

    def solved(tolerance, takes_stalled=True):
        settings = Solver(harmonics=25, samples=128, tolerance=tolerance, estimate_error=False)
        return QuasiStaticSolver(settings, takes_stalled=takes_stalled).solve(problem(53.0))

    period = solved(0.2 * stall)
    assert period.residual_history[-1] == pytest.approx(stall, rel=0.01)
    missed = np.abs(period.friction_force - exact.friction_force).max()
    assert missed < np.abs(dense.friction_force[::2] - exact.friction_force).max()
    for finer, takes_stalled in ((0.05 * stall, True), (0.2 * stall, False)):
        with pytest.raises(NonConvergenceError, match="residual"):
            solved(finer, takes_stalled)


def test_a_neighbour_that_is_far_does_not_slow_the_solution_down():
    """Where a neighbouring period is far from balance, the start from nothing is looked at too."""
    solver = QuasiStaticSolver(Solver(harmonics=25, samples=128, estimate_error=False))
    alone, far = solver.solve(problem(75.0)), solver.solve(problem(40.0))
    period = solver.solve(problem(75.0), far)
    assert period.rig_displacement == pytest.approx(alone.rig_displacement, rel=1e-6, abs=1e-12)
    assert period.residual_history[0] == pytest.approx(alone.residual_history[0], rel=0.1)
