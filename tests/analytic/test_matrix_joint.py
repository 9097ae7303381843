"""A joint given by its matrices: both solvers against each other, time integration, another code and exact balances.

What carries the weight: time integration knows no harmonics, DLFT keeps the mass that the quasi-static solver leaves
out of the contact, and the other code's solution is in numbers.
"""

import json
import warnings
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.core.errors import FretflowWarning, HeavyContactWarning, InputError, StoreError
from fretflow.effects.cycle import PeriodicCycle, find_asymptotic_shape, march_wear
from fretflow.solvers.audit import energy_balance
from fretflow.solvers.continuation.follow import continue_response
from fretflow.solvers.continuation.system import ContinuationSystem
from fretflow.solvers.fourier import analysis_matrix, synthesis_matrix
from fretflow.solvers.periodic import Harmonic, NormalLoad, PeriodicProblem
from fretflow.solvers.quasi_static.cautions import neglected_damping, neglected_inertia
from fretflow.solvers.quasi_static.internal import seen_coordinates
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.quasi_static.starts import settled_starts
from fretflow.solvers.solve import solve_periodic
from fretflow.solvers.time_integration import settle
from fretflow.structure.matrix_joint import Joint
from fretflow.wear.archard import Archard
from scipy.linalg import eigh

MASSES, FACES = 6, 3
PEERS = Path(__file__).parents[1] / "data" / "peers"


def matrices():
    """Return stiffness, mass (36, 36) and contact map (9, 36); the faces' own masses are small."""
    spring = np.zeros((MASSES, MASSES))
    for i in range(MASSES - 1):
        spring[i:i + 2, i:i + 2] += np.array([[1.0, -1.0], [-1.0, 1.0]])
    bar = np.kron(spring, np.diag([2e7, 6e6, 1e7]))
    stiffness, mass = np.kron(np.eye(2), bar), 0.1 * np.eye(6 * MASSES)
    stiffness[:3, :3] += np.diag([2e7, 6e6, 1e7])  # the upper bar is held at its left end
    stiffness[-3:, -3:] += np.diag([1e6, 1e6, 1e7])  # the lower one rests on springs at its right end
    contact_map = np.zeros((3 * FACES, 6 * MASSES))
    for j in range(FACES):
        for c in range(3):
            above, below = 3 * (MASSES - FACES + j) + c, 3 * (MASSES + j) + c
            contact_map[3 * j + c, above], contact_map[3 * j + c, below] = 1.0, -1.0
            mass[above, above] = mass[below, below] = 2e-3
    return stiffness, mass, contact_map


def problem(frequency, force, **options):
    """Return the pair under a force on the right end of its lower bar, Hz and N."""
    stiffness, mass, contact_map = matrices()
    joint = Joint.from_matrices(stiffness, mass, contact_map=contact_map, observe={"tip": 33, "middle": 9},
                                **{"modal_damping": 0.02, **options})
    face = Interface(np.zeros((FACES, 2)), np.full(FACES, 1e-4), np.zeros(FACES))
    return PeriodicProblem(joint, face, Coulomb(0.4), Harmonic(frequency, {"tip": force}), preload=NormalLoad(100.0))


@pytest.mark.parametrize(("frequency", "force"), [(60.0, 60.0), (100.0, 50.0)])
def test_both_solvers_and_time_integration_agree_on_a_bolted_pair(frequency, force):
    given = problem(frequency, force)
    quasi_static = solve_periodic(given, harmonics=21, samples=512, tolerance=1e-8)
    assert 0.05 < np.mean(quasi_static.state == 1) < 0.95  # sticks and slips
    other = solve_periodic(given, "dlft", harmonics=31, samples=512)
    history = settle(given, quasi_static, (3, 20), 1024, 1e-4)
    swing = np.ptp(history.of_period(history.outputs["tip"]))
    for period in (quasi_static, other):
        assert np.ptp(period.output("tip")) == pytest.approx(swing, rel=0.01)
        assert period.dissipated_energy == pytest.approx(history.dissipated_energy[-1], rel=0.03)


@pytest.mark.parametrize("method", ["quasi-static", "dlft"])
def test_faces_that_never_touch_are_told(method):
    """A joint that nothing presses is a linear one, of which one would think that it has no friction to show."""
    with pytest.warns(FretflowWarning, match="touch at no time"):
        period = solve_periodic(replace(problem(60.0, 60.0), interface=Interface(
            np.zeros((FACES, 2)), np.full(FACES, 1e-4), np.full(FACES, 1e-3)), preload=NormalLoad(0.0)), method)
    assert np.abs(period.force).max() < 1e-9 * 60.0  # of the excitation; the solver leaves round-off
    assert np.ptp(period.output("tip")) > 0.0


def test_the_work_of_the_excitation_is_what_contact_and_dashpots_take():
    """To round-off in the harmonics; friction by slips of the samples tends to it."""
    given, shares = problem(100.0, 50.0), []
    for samples in (128, 256):
        balance = energy_balance(given, solve_periodic(given, harmonics=15, samples=samples, tolerance=1e-10))
        assert balance.error < 1e-8
        assert 0.02 < balance.contact / balance.excitation < 0.98
        shares.append(abs(balance.friction / balance.contact - 1.0))
    assert shares[1] < 0.7 * shares[0] < 0.1


def test_tangent_of_three_modes_is_that_of_central_differences():
    given = problem(100.0, 50.0, modes=3)
    seen = seen_coordinates(given.boundary)
    assert len(seen) == 3
    synthesis, rng = synthesis_matrix(3, 64), np.random.default_rng(4)
    motion = 2e-5 * rng.normal(size=(7, 3)) / np.sqrt(np.diag(given.boundary.internal.stiffness)) * 1e3
    way = rng.normal(size=(7, 3, 1)) * np.abs(motion).max()

    def march(by):
        contact, directions = ContactMarch.of(given, seen), np.einsum("jh,hdp->jdp", synthesis, way)
        return contact, contact.period(synthesis @ (motion + by * way[:, :, 0]), directions, contact.preloaded(), None,
                                       1e-12)

    contact, marched = march(0.0)
    assert np.any(marched.history.state == 1)
    h = 1e-6
    plus, minus = (march(by)[1].history.force @ contact.system.transfer.T for by in (h, -h))
    differences = (plus - minus) / (2.0 * h)
    assert marched.tangent[:, :, 0] == pytest.approx(differences, abs=1e-4 * np.abs(differences).max())


def contact_map(nodes):
    """Return that of the other code's DOF order: normal, t1, t2 with compression positive."""
    return np.kron(np.eye(nodes), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


def grounded(nodes, compliance):
    """Return contacts to ground of the other code; all their mass is at the contact."""
    data = np.load(PEERS / f"problem_{nodes}.npz")
    face = Interface(np.zeros((nodes, 2)), np.ones(nodes), np.zeros(nodes))
    static, moving = data["F0"], data["Fc"] - 1j * data["Fs"]
    drive = Harmonic(0.8 / (2.0 * np.pi), {str(k): force for k, force in enumerate(moving)},
                     overtones=((0, {str(k): force for k, force in enumerate(static)}),))
    joint = Joint.from_matrices(data["K"], data["M"], data["C"], contact_map=contact_map(nodes),
                                observe={str(k): k for k in range(3 * nodes)}, contact_compliance=compliance)
    return PeriodicProblem(joint, face, Coulomb(0.3), drive)


@pytest.mark.parametrize("nodes", [1, 10])
def test_grounded_contacts_of_another_code(nodes):
    case = next(c for c in json.loads((PEERS / "coupled_dlft_3d.json").read_text())["B_dlft3d"]
                if c["N"] == nodes and c["eps"] == 100.0)
    stiff = solve_periodic(grounded(nodes, 1e-10), "dlft", harmonics=3, samples=128, penalty="100 N/m",
                           tolerance=1e-11)
    moved = analysis_matrix(3, 128) @ stiff.displacement.reshape(128, -1)
    assert moved == pytest.approx(np.array(case["X"]) @ contact_map(nodes).T, abs=1e-7)
    soft = grounded(nodes, 0.02)
    true = solve_periodic(soft, harmonics=15, samples=256, tolerance=1e-8)
    other = solve_periodic(soft, "dlft", harmonics=15, samples=256, tolerance=1e-8)
    history = settle(soft, true, (2, 6), 512, 1e-4)
    for k in range(3):
        swing = np.ptp(history.of_period(history.outputs[str(k)]))
        for period in (true, other):
            assert np.ptp(period.output(str(k))) == pytest.approx(swing, rel=0.01)


def test_a_response_and_wear_of_any_structure():
    given = problem(100.0, 30.0, modes=4)
    curve = continue_response(given, 90.0, 100.0, harmonics=7, samples=48, fine_harmonics=7, fine_samples=48)
    assert curve.channels == ("relative", "tip", "middle")
    end = solve_periodic(given, harmonics=7, samples=48, tolerance=1e-8)
    last = curve.along(1)[-1]
    assert curve.peak_to_peak[last, 1] == pytest.approx(np.ptp(end.output("tip")), rel=1e-3)
    worn = march_wear(problem(100.0, 50.0, modes=4), Archard(1e-13), 10_000)
    assert worn.cycles[-1] == 10_000
    assert worn.volume[-1] > 0.0


def test_what_makes_no_joint_is_refused():
    stiffness, mass, rows = matrices()
    for words, change in (("K: is not symmetric", {"stiffness": stiffness + np.eye(36, k=1) * 1e6}),
                          ("rows depend on each other", {"contact_map": np.vstack([rows[:6], rows[:3]])}),
                          ("observe: tip is DOF 40", {"observe": {"tip": 40}}),
                          ("modes = 90", {"modes": 90}), ("modal_damping", {"modal_damping": 2.0}),
                          ("either the numbers", {"contact": [1]})):
        with pytest.raises(InputError, match=words):
            Joint.from_matrices(**{"stiffness": stiffness, "mass": mass, "contact_map": rows, **change})
    with pytest.raises(InputError, match="contact_compliance"):
        Joint.from_matrices(np.eye(3), np.eye(3), contact=[0])
    wrong = replace(problem(100.0, 30.0), excitation=Harmonic(100.0, {"nose": 1.0}))
    with pytest.raises(InputError, match="input 'nose': unknown; choose one of tip, middle"):
        solve_periodic(wrong)


@pytest.mark.parametrize("own", [0.1, 1e-3])
def test_contact_nodes_whose_mass_counts_are_told_by_their_share_of_the_kinetic_energy(own):
    """A contact that slides almost freely moves as its neighbour, so that it holds m / (1 + m) of the energy."""
    stiffness, mass = np.diag([2e6, 1e6, 1e6, 1e6]), np.diag([1.0, own, own, own])
    stiffness[0, 1] = stiffness[1, 0] = -1e6
    joint = Joint.from_matrices(stiffness, mass, contact_map=np.eye(4)[1:], observe={"tip": 0}, modal_damping=0.02)
    face = Interface(np.zeros((1, 2)), np.array([1e-4]), np.zeros(1))
    given = PeriodicProblem(joint, face, Coulomb(1e-4), Harmonic(100.0, {"tip": 90.0}), preload=NormalLoad(100.0))
    with pytest.warns(HeavyContactWarning, match="dlft") if own > 0.02 else nullcontext():
        period = solve_periodic(given, harmonics=9, samples=64)
    share = neglected_inertia(given, period)
    assert share == pytest.approx(own / (1.0 + own), rel=0.01)
    square = eigh(stiffness[:2, :2], mass[:2, :2], eigvals_only=True)[0]  # with all mass; without the contact's 1e6
    assert 1.0 - square / 1e6 == pytest.approx(share, rel=0.1)
    whole = solve_periodic(given, "dlft", harmonics=9, samples=64)  # keeps all mass, and has nothing to say
    assert (abs(np.ptp(whole.output("tip")) / np.ptp(period.output("tip")) - 1.0) > 0.01) == (own > 0.02)


def test_a_response_in_partial_slip_ends_and_is_that_of_time_integration():
    given = problem(60.0, 60.0)
    curve = continue_response(given, 60.0, 63.0)
    assert not curve.bridged.any()
    assert set(curve.direction) == {1, -1}
    assert {60.0, 63.0} == set(np.round(curve.frequency[[0, curve.along(1)[-1]]], 6))
    history = settle(given.vary(frequency=63.0), None, (10, 40), 512, 1e-4)
    swing = np.ptp(history.of_period(history.outputs["tip"]))
    for end in (curve.along(1)[-1], curve.along(-1)[0]):
        assert curve.peak_to_peak[end, 1] == pytest.approx(swing, rel=0.02)
    up, down = (curve.along(direction)[np.argsort(curve.frequency[curve.along(direction)])] for direction in (1, -1))
    again = np.interp(curve.frequency[up], curve.frequency[down], curve.peak_to_peak[down, 1])
    assert again == pytest.approx(curve.peak_to_peak[up, 1], rel=0.02)


def test_secants_lead_across_the_kinks_of_ten_contacts_that_begin_to_slip():
    """Where Newton's own steps creep from one to the next; the period is that of a joint stepped in time."""
    given = grounded(10, 0.02).vary(frequency=0.0497)
    system = ContinuationSystem(given, 21, 128, 0.1 / 128, 8)
    near = next(settled_starts(given, system.equations(given.omega), system.march, None))
    point = system.at_frequency(given.omega, near.start.seen, near.contact)
    assert point.norm < 0.1 / 128 < 0.1 * system.evaluate(np.append(near.start.seen, given.omega), near.contact, None,
                                                          1.0).norm
    history = settle(given, None, (2, 6), 256, 1e-3)
    internal = system.motion(point)
    loads = given.loads_at(2.0 * np.pi * np.arange(128) / 128)
    outputs = given.boundary.observe(internal, system.period(point).displacement, system.period(point).force, loads)
    swings = np.array([np.ptp(history.of_period(history.outputs[str(k)])) for k in range(30)])
    assert [np.ptp(outputs[str(k)]) for k in range(30)] == pytest.approx(swings, abs=0.02 * swings.max())


LINK, HOLD = np.diag([20e6, 20e6, 40e6]), np.diag([1e6, 1e6, 1e6])  # of the contributor's guide
GUIDE = np.block([[LINK + HOLD, -LINK], [-LINK, LINK]]), np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])


def guide_problem(stiffness=GUIDE[0], mass=GUIDE[1], contact=(1,), observe=None, frequency=100, force=80, load=60,
                  mu=0.6, nodes=1):
    held = Joint.from_matrices(stiffness, mass, contact=contact, observe=observe or {"tip": 0}, modal_damping=0.05)
    faces = Interface(nodes=np.zeros((nodes, 2)), areas=np.full(nodes, 1e-6), gap=np.zeros(nodes))
    return PeriodicProblem(held, faces, Coulomb(mu), Harmonic(frequency, {"tip": force}),
                              preload=NormalLoad(load))


@pytest.mark.parametrize(("wrong", "said"), [
    ({"stiffness": GUIDE[0] * (1.0 + 0.01j)}, "must be real"), ({"mass": -GUIDE[1]}, "M: is not positive definite"),
    ({"contact": (1.5,)}, "contact: .* must be whole numbers"), ({"observe": ["tip"]}, "observe: .* names no places"),
    ({"frequency": "100 Hz"}, "frequency '100 Hz' .* without quotes"), ({"force": "80 N"}, "excitation: tip = '80 N'"),
    ({"force": np.nan}, "excitation: tip = nan"), ({"load": -60}, "preload: -60"),
    ({"load": "60 N"}, "preload: '60 N'"),
    ({"mu": "0.6"}, "friction_coefficient: must be"), ({"nodes": 2}, "interface: has 2 nodes, but")])
def test_what_python_is_given_wrongly_is_refused_by_name(wrong, said):
    with pytest.raises(InputError, match=said):
        solve_periodic(guide_problem(**wrong))


@pytest.fixture
def chain():
    """Return a function that makes three masses in a row whose last one, N/m along z, 80 N press on the ground."""
    def make(gap, upright=5e6, **loads):
        row = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
        joint = Joint.from_matrices(np.kron(row, np.diag([5e6, 5e6, 3.0 * upright])),
                                    np.diag([1.0] * 6 + [1e-3] * 3), contact=[2], observe={"first": 0},
                                    modal_damping=0.02)
        face = Interface(np.zeros((1, 2)), np.array([1e-6]), np.array([gap]))
        return PeriodicProblem(joint, face, Coulomb(0.5), Harmonic(45.0, {"first": 300.0}),
                               **{"preload": NormalLoad(80.0), **loads})

    return make


@pytest.mark.parametrize("gap", [16.01e-6, 17e-6, 20e-6])
def test_a_contact_that_has_come_apart_moves_as_the_open_joint(chain, gap):
    """80 N close 16 um of springs of 5 N/um; beyond, a division by zero or a broken law was reported."""
    with pytest.warns(FretflowWarning, match="touch at no time"):
        free, other = (solve_periodic(chain(gap), method, samples=256) for method in ("quasi-static", "dlft"))
    assert np.abs(free.force).max() < 1e-6
    assert free.dissipated_energy == pytest.approx(0.0, abs=1e-12)
    assert free.output("first") == pytest.approx(other.output("first"), abs=1e-4 * np.ptp(other.output("first")))


def test_wear_ends_where_the_springs_carry_the_load(chain):
    worn = march_wear(chain(0.0), Archard(1e-14), cycles=1_000_000)
    assert worn.depth[-1, 0] == pytest.approx(80.0 / 5e6, rel=1e-3)  # m


def test_wear_kept_in_a_folder_is_of_one_joint(chain, tmp_path):
    """Another joint was given the first one's wear."""
    first = march_wear(chain(0.0), Archard(1e-14), 1000, folder=tmp_path)
    again = march_wear(chain(0.0), Archard(1e-14), 1000, folder=tmp_path)
    assert again.volume.tolist() == first.volume.tolist()
    with pytest.raises(StoreError, match="holds the wear of another joint; remove it or choose another folder"):
        march_wear(chain(0.0).vary(friction_coefficient=0.4), Archard(1e-14), 1000, folder=tmp_path)


def test_outputs_may_have_any_name(chain):
    """An output called arm was taken for the rig's, which has others; one called relative for the faces' sliding."""
    given = chain(0.0)
    named = replace(given, structure=replace(given.structure, observed={
        name: given.structure.observed["first"] for name in ("first", "arm", "relative")}))
    worn = [march_wear(one, Archard(1e-14), 1000).volume[-1] for one in (given, named)]
    assert worn[1] == pytest.approx(worn[0], rel=1e-9)
    with pytest.raises(InputError, match="relative is what response curves call the sliding of the faces"):
        continue_response(named, 40.0, 50.0)


def test_faces_on_springs_relax_by_all_that_gives_way():
    """With internal masses held still the faces seemed stiffer than they are, and no end of wear was found."""
    given, law = problem(60.0, 60.0), Archard(1e-13)
    stiffness, _, rows = matrices()
    normal = rows[2::3]
    flexibility = normal @ np.linalg.solve(stiffness, normal.T)
    solver = QuasiStaticSolver(Solver(samples=64, harmonics=15, estimate_error=False))
    cycle = PeriodicCycle(solver, given)
    assert cycle.normal_flexibility(cycle.initial()) == pytest.approx(flexibility, rel=1e-9)
    assert not cycle.load_held
    worn = march_wear(given, law, 10_000_000, solver=solver)
    assert find_asymptotic_shape(given, law, float(worn.volume[-1]), solver=solver).distance(worn.depth[-1]) < 5e-3
    ended = find_asymptotic_shape(given, law, 1.0, solver=solver)  # m^3: until nothing presses any more
    assert ended.depth == pytest.approx(flexibility @ np.full(FACES, 100.0 / FACES), rel=1e-6)
    assert ended.rate == 0.0


def test_a_load_on_a_body_that_nothing_else_holds_is_held():
    """The lower bar without its spring along z; the flexibility of what strains it is told but for its own motion."""
    stiffness, mass, rows = matrices()
    stiffness[-1, -1] -= 1e7
    joint = Joint.from_matrices(stiffness, mass, contact_map=rows, modal_damping=0.02)
    given = replace(problem(60.0, 60.0), structure=joint, excitation=Harmonic(60.0, {}))
    cycle = PeriodicCycle(QuasiStaticSolver(Solver()), given)
    assert cycle.load_held
    between = np.eye(FACES)[:-1] - np.eye(FACES)[1:]  # differences of nodes' forces, which move no body
    exact = rows[2::3] @ np.linalg.pinv(stiffness) @ rows[2::3].T
    own = cycle.normal_flexibility(cycle.initial())
    assert between @ own @ between.T == pytest.approx(between @ exact @ between.T, rel=1e-6)


def test_nothing_that_moves_is_seen_by_a_contact_of_its_own():
    """Uncoupled DOF were an error of numpy's."""
    joint = Joint.from_matrices(1e6 * np.eye(6), np.diag([1.0] * 3 + [1e-3] * 3), contact=[1], observe={"free": 0})
    face = Interface(np.zeros((1, 2)), np.array([1e-6]), np.zeros(1))
    period = solve_periodic(PeriodicProblem(joint, face, Coulomb(0.5), Harmonic(100.0, {"free": 1.0}),
                                            preload=NormalLoad(10.0)))
    exact = 1.0 / (1e6 - (200.0 * np.pi) ** 2)
    assert np.abs(period.output("free")).max() == pytest.approx(exact, rel=1e-9)


def damped(damping, force=1.0, friction=1.0, load=1e4, **given):
    """Return a mass of 1 kg on 1e6 N/m to the ground, linked by 1e6 N/m to a contact node that hardly weighs."""
    one = np.eye(3)
    stiffness = np.block([[2e6 * one, -1e6 * one], [-1e6 * one, 1e6 * one]])
    joint = Joint.from_matrices(stiffness, np.diag([1.0] * 3 + [1e-9] * 3), damping, contact=[1], observe={"tip": 0},
                                **given)
    return PeriodicProblem(joint, Interface(np.zeros((1, 2)), np.array([1e-6]), np.zeros(1)), Coulomb(friction),
                           Harmonic(np.sqrt(2e6) / (2.0 * np.pi), {"tip": force}), preload=NormalLoad(load))


def test_damping_of_the_contact_that_a_massless_one_misses_is_told_by_its_share():
    """Where the contact sticks, a mass between two dashpots as its springs: alone the one to the ground is kept."""
    stiffness = np.array([[2e6, -1e6], [-1e6, 1e6]])
    whole = 2e-4 * np.kron(stiffness, np.eye(3))
    problem = damped(whole)
    with pytest.warns(HeavyContactWarning, match='damping C of the contact.* use method="dlft"'):
        period = solve_periodic(problem, harmonics=5, samples=64)
    assert neglected_damping(problem, period) == pytest.approx(1.0, rel=1e-2)
    exact = 1.0 / (problem.omega * whole[0, 0])  # at resonance of the stuck joint
    assert np.ptp(period.output("tip")) == pytest.approx(4.0 * exact, rel=1e-3)
    assert np.ptp(solve_periodic(problem, "dlft", harmonics=5, samples=64).output("tip")) == pytest.approx(
        2.0 * exact, rel=1e-3)
    ground = np.diag([200.0] * 3 + [0.0] * 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", HeavyContactWarning)
        period = solve_periodic(damped(ground), harmonics=5, samples=64)
        solve_periodic(damped(None, modal_damping=0.02), harmonics=5, samples=64)
    assert neglected_damping(damped(ground), period) == pytest.approx(0.0, abs=1e-9)
