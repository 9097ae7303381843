"""Public functions and classes refuse what they are given wrongly in one clear line.

What carries the weight: each argument of each public name in turn is of twenty wrong types, NaN, empty, or of a wrong
shape. What comes of it is a result or an error of the project, never one from the inside.
"""

import inspect
import pickle
from dataclasses import is_dataclass, replace
from types import FunctionType

import fretflow as ff
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fretflow.case.config import WearScheme
from fretflow.wear.history import WearSettings
from scipy.sparse import csr_matrix

WRONG = (None, 5, -1.0, float("nan"), float("inf"), True, "x", "", b"x", [], {}, ["a", "b"], {"a": None}, (1, "b"),
         object(), 1j, np.zeros(0), np.zeros((2, 2, 2)), np.array(["a"]), np.full(3, np.nan))
WAVE = np.cos(np.arange(64) * np.pi / 32), -np.sin(np.arange(64) * np.pi / 32)
NOT_MADE = {"Case", "Diagnosis", "Effect", "JointStudy", "LoopReadings", "PeriodicSolution", "ResponseCurve",
            "RunResults"}  # by users: others than functions of fretflow, or, as effects, in case files


def spring(size):
    """Return the stiffness of springs in parallel (3 k of them), N/m."""
    return 1e6 * np.diag([1.0, 1.0, 2.0] * size)


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    """Return arguments that each public name takes."""
    held = np.block([[2.0 * spring(1), -spring(1)], [-spring(1), spring(1)]])
    joint = ff.Joint.from_matrices(held, np.diag([1.0] * 3 + [1e-3] * 3), contact=[1], observe={"tip": 0},
                                   modal_damping=0.05)
    faces = {"nodes": np.zeros((1, 2)), "areas": np.array([1e-6]), "gap": np.zeros(1)}
    force = ff.Harmonic(20.0, {"tip": 8.0})
    problem = ff.PeriodicProblem(joint, ff.Interface(**faces), ff.Coulomb(0.6), force, preload=ff.NormalLoad(60.0))
    loop = dict(zip(("displacement", "force"), WAVE, strict=True))
    rows = np.eye(4)
    bolted = {"mass": np.diag([2.0, 0.0, 0.0, 0.0]), "contact_map": rows[1:], "areas": np.array([1e-6]),
              "stiffness": np.diag([4e4, 1e4, 1e4, 1e4]) - 1e4 * np.eye(4)[[1, 0, 3, 2]] * np.outer(
                  [1, 1, 0, 0], [1, 1, 0, 0]),
              "points": np.zeros((1, 3)), "preload": -rows[3], "outputs": {"mass": rows[0]}}
    slider = {"structure": ff.reduce_structure(ff.StructureMatrices(**bolted)), "law": ff.Coulomb(0.6),
              "bolt_load": 5.0}
    mode = ff.BoltedJoint(**slider).linear_modes(1)[0]
    backbone = {"joint": ff.BoltedJoint(**slider), "mode": mode, "amplitudes": np.array([1e-6])}
    absent = tmp_path_factory.mktemp("empty") / "absent"
    steel = {"youngs_modulus": 2e11, "poissons_ratio": 0.3, "density": 7800.0}
    return {
        "Archard": {"coefficient": 1e-14}, "Bolt": {"head": "a", "nut": "b"}, "Coulomb": {"friction_coefficient": 0.6},
        "BoltedCycle": {"joint": ff.BoltedJoint(**slider), "amplitude": 1e-6}, "BoltedJoint": slider,
        "Harmonic": {"frequency": 20.0, "amplitudes": {"tip": 8.0}}, "HysteresisLoop": loop, "Interface": faces,
        "Material": steel, "NormalLoad": {"force": 60.0},
        "Motion": {"step": 1e-3, **dict.fromkeys(("displacement", "velocity", "acceleration"), np.zeros(32))},
        "PeriodicProblem": {"structure": joint, "interface": ff.Interface(**faces), "law": ff.Coulomb(0.6),
                            "excitation": force},
        "StructureMatrices": bolted, "add_effects": {"folder": absent}, "catalogue": {},
        "continue_response": {"problem": problem, "start": 18.0, "stop": 19.0}, "diagnose": {"recording": absent},
        "find_asymptotic_shape": {"problem": problem, "law": ff.Archard(1e-14), "volume": 1e-12},
        "follow_mode": {**backbone, "harmonics": 1}, "load_case": {"path": absent},
        "march_wear": {"problem": problem, "law": ff.Archard(1e-14), "cycles": 10},
        "parameter": {"default": 1.0, "meaning": "m: mass", "low": 0.5, "high": 2.0},
        "quasi_static_backbone": backbone, "read_loop": {"loop": ff.HysteresisLoop(**loop)},
        "read_recording": {"path": absent}, "reduce_structure": {"matrices": ff.StructureMatrices(**bolted)},
        "run": {"case": absent}, "solve_periodic": {"problem": problem},
        "Joint.from_matrices": {"stiffness": held, "mass": np.diag([1.0] * 3 + [1e-3] * 3), "contact": [1]},
        "Bolt.round": {"head": "a", "nut": "b", "diameter": 0.01, "grip": 0.02},
        "study_joint": {"joint": ff.BoltedJoint(**slider), "amplitudes": np.array([1e-6]), "periodic": 0},
        "structure_from_mesh": {"path": absent, "material": ff.Material(**steel), "interfaces": [("a", "b")]},
    }


def callables():
    made = {name: getattr(ff, name) for name in ff.__all__ if isinstance(getattr(ff, name, None), FunctionType)
            or (is_dataclass(getattr(ff, name, None)) and name not in NOT_MADE | {"Joint"})}
    return {**made, "Joint.from_matrices": ff.Joint.from_matrices, "Bolt.round": ff.Bolt.round}


NAMES = [name for name in callables() if name != "structure_from_mesh"]


@pytest.mark.parametrize("name", [*NAMES, pytest.param("structure_from_mesh", marks=pytest.mark.fem)])
def test_wrong_arguments_are_an_error_of_the_project_or_none(name, right, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # what takes a relative path writes here
    function, given = callables()[name], right[name]
    kinds = inspect.signature(function).parameters
    refused, faults = 0, []
    for argument in (key for key, one in kinds.items() if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)):
        for wrong in WRONG:
            try:
                function(**{**given, argument: wrong})
            except ff.FretflowError as error:
                refused += 1
                faults += [str(error)] if "\n" in str(error) else []
            except Exception as error:  # noqa: BLE001 - any other is a fault
                faults.append(f"{argument}={wrong!r}: {type(error).__name__}: {error}")
    assert faults == []
    assert refused >= 10 * len(given)


@pytest.mark.parametrize(("call", "said"), [
    (lambda: ff.run(5), "run: case must be a Case or a Path or text, got 5"),
    (lambda: ff.read_recording(3), "read_recording: path must be a Path or text, got 3"),
    (lambda: ff.solve_periodic("joint"), "solve_periodic: problem must be a PeriodicProblem, got 'joint'"),
    (lambda: ff.Harmonic(100, 53), "Harmonic: amplitudes must be a mapping of text to a finite number, got 53"),
    (lambda: ff.Archard("1e-14"), "wear coefficient: '1e-14' m^2/N is no finite number from 0 on"),
    (lambda: ff.Archard(float("nan")), "wear coefficient: nan m^2/N is no finite number from 0 on"),
    (lambda: ff.read_loop(ff.HysteresisLoop(displacement=WAVE[0], force=WAVE[1]), float("nan")),
     "read_loop: normal_load must be a finite number or None, got nan"),
    (lambda: ff.HysteresisLoop(displacement="x", force=WAVE[1]),
     "HysteresisLoop: displacement must be an array of finite numbers, got 'x'"),
    (lambda: ff.Material(youngs_modulus=2.05e5, poissons_ratio=0.3, density=7.85e-9),
     "density: 7.85e-09 kg/m^3 is below that of any solid; all is in SI, also where a mesh counts in millimetres"),
    (lambda: ff.Material(youngs_modulus=205e3, poissons_ratio=0.3, density=7850.0),
     "youngs_modulus: 205000 Pa is below that of soft rubber; all is in SI, also where a mesh counts in millimetres"),
    (lambda: ff.Joint.from_matrices(csr_matrix(np.eye(3)), np.eye(3), contact=[0]),
     "Joint.from_matrices: stiffness must be an array of finite numbers, got a sparse csr_matrix; give its toarray()"),
    (lambda: ff.HysteresisLoop(displacement=np.ma.masked_greater(WAVE[0], 0.9), force=WAVE[1]),
     "loop: displacement or force is NaN or infinite; clean the recording first"),
    (lambda: ff.Interface([0], [np.inf], [0.0]), "interface: areas must be positive, and nodes, areas and gaps finite"),
    (lambda: ff.Coulomb(np.full((2, 1), 0.5)),
     "friction_coefficient: must be a finite number, or one for each node, and not negative"),
])
def test_what_is_wrong_is_named(call, said):
    with pytest.raises(ff.InputError) as caught:
        call()
    assert str(caught.value) == said


@pytest.mark.parametrize(("settings", "said"), [
    ({"scheme": "implict"}, "wear.scheme: must be explicit or implicit, got 'implict'"),
    ({"stop": [5]}, "march_wear: there is no setting stop; .*; did you mean stops?"),
    ({"cycles": -5}, "cycles: must not be negative, got -5")])
def test_a_wrong_setting_of_wear_is_named(right, settings, said):
    with pytest.raises(ff.InputError, match=said):
        ff.march_wear(**{**right["march_wear"], **settings})


def test_a_scheme_named_by_text_is_taken():
    """Explicit steps that were asked for by name were implicit ones."""
    assert WearSettings(coefficient=1e-14, cycles=10, scheme="explicit").scheme is WearScheme.EXPLICIT


@pytest.mark.parametrize(("settings", "said"), [
    ({"method": "DLFT"}, "solve_periodic: method: must be 'quasi-static' or 'dlft', got 'DLFT'"),
    ({"harmonic": 3}, "solve_periodic: harmonic: unknown key; .*; did you mean harmonics?")])
def test_a_wrong_setting_is_named(right, settings, said):
    with pytest.raises(ff.InputError, match=said):
        ff.solve_periodic(**right["solve_periodic"], **settings)


def test_numbers_as_arrays_without_dimensions_are_numbers():
    assert ff.Coulomb(np.array(0.6)).friction_coefficient == 0.6
    assert ff.NormalLoad(np.float64(60.0)).force == 60.0


def test_a_checked_function_is_one_object_by_either_name_and_in_another_process():
    from fretflow.recordings import hysteresis

    assert ff.read_loop is hysteresis.read_loop
    assert pickle.loads(pickle.dumps(ff.read_loop)) is ff.read_loop


def test_arrays_stay_their_maker_s():
    """They became read-only, so that the next change of a gap or a stiffness was an error of numpy's."""
    made = [1e6 * np.eye(3), np.eye(3), np.zeros((1, 2)), np.ones(1), np.zeros(1), np.array([0.5]), np.eye(3)[0]]
    stiffness, mass, nodes, areas, gap, friction, row = made
    joint = ff.Joint.from_matrices(stiffness, mass, contact=[0], contact_compliance=1e-9, observe={"tip": row})
    held = joint.stiffness, joint.mass, *vars(ff.Interface(nodes, areas, gap)).values(), (
        ff.Coulomb(friction).friction_coefficient), joint.observed["tip"]
    for given, kept in zip(made, held, strict=True):
        before = kept.copy()
        given += 5.0
        np.testing.assert_array_equal(kept, before)


@pytest.mark.parametrize("kind", [list, tuple, pd.Series, xr.DataArray, lambda one: np.rint(1e9 * one).astype(int)])
def test_columns_of_tables_and_whole_numbers_are_arrays(kind):
    loop = ff.HysteresisLoop(displacement=kind(WAVE[0]), force=kind(WAVE[1]))
    seen, due = ff.read_loop(loop), ff.read_loop(ff.HysteresisLoop(displacement=WAVE[0], force=WAVE[1]))
    assert seen.sliding_distance / seen.peak_to_peak == pytest.approx(due.sliding_distance / due.peak_to_peak)
    assert ff.Joint.from_matrices(1e6 * np.eye(6), np.eye(6), contact=np.array([1])).contact_map.shape == (3, 6)


def slider(nodes=1, **options):
    """Return a mass of 1 kg on each of some contact nodes, dragged over the ground behind a compliant face."""
    joint = ff.Joint.from_matrices(1e6 * np.eye(3 * nodes), np.eye(3 * nodes), contact=[*range(nodes)],
                                   observe={"tip": 0}, **{"contact_compliance": 1e-9, "modal_damping": 0.02, **options})
    face = ff.Interface([*range(nodes)], [1e-6] * nodes, [0.0] * nodes)
    return ff.PeriodicProblem(joint, face, ff.Coulomb(0.5), ff.Harmonic(5.0, {"tip": 100.0}),
                              preload=ff.NormalLoad(60.0 * nodes))


def test_a_slow_slider_is_stable_and_has_its_energy():
    """Rigid Coulomb friction behind a spring c: 4 mu N (X - mu N c); the tip moves as the mass on its spring does."""
    problem = slider()
    period = ff.solve_periodic(problem)
    swing = 0.5 * np.ptp(period.output("tip"))
    assert period.dissipated_energy == pytest.approx(4.0 * 30.0 * (swing - 30.0 * 1e-9), rel=1e-6)


def test_a_start_of_another_joint_is_refused_by_both_solvers():
    other = ff.solve_periodic(slider(3))
    for method in ("quasi-static", "dlft"):
        with pytest.raises(ff.InputError, match="start: is a period of 3 contact nodes, and the problem has 1"):
            ff.solve_periodic(slider(), method, start=other)


def test_overtones_that_the_harmonics_do_not_hold_are_refused():
    def driven(order, force=20.0):
        return replace(slider(), excitation=ff.Harmonic(20.0, {"tip": 20.0}, overtones=((order, {"tip": force}),)))

    with pytest.raises(ff.InputError, match="its overtone of order 5 is above harmonics = 3; give as many or more"):
        ff.solve_periodic(driven(5), "dlft")
    with pytest.raises(ff.InputError, match="above harmonics = 21"):
        ff.continue_response(driven(41), 20.0, 30.0)
    for order in (-1, 2.5):
        with pytest.raises(ff.InputError, match=f"overtone {order} must be a whole number"):
            driven(order)
    with pytest.raises(ff.InputError, match="no finite number"):
        driven(3, np.nan)


@pytest.mark.parametrize(("settings", "words"), [
    ({"samples": 16, "harmonics": 40}, "samples = 16 is too few for 40 harmonics"),
    ({"fine_samples": 16}, "fine_.*samples = 16 is too few"), ({"harmonics": 0}, "harmonics"),
    ({"harmonics": "many"}, "harmonics"), ({"longest_step": "x"}, "longest_step = 'x' must be a positive number"),
    ({"effort": 2.5}, "effort = 2.5"), ({"directions": ()}, "directions"), ({"directions": ("across",)}, "directions")])
def test_settings_of_a_response_are_checked(settings, words):
    with pytest.raises(ff.InputError, match=words):
        ff.continue_response(slider(), 100.0, 220.0, **settings)


@pytest.mark.parametrize(("settings", "words"), [
    ({"stops": 5}, "stops = 5 must be a sequence"), ({"stops": "abc"}, "stops = 'abc' must be"),
    ({"tolerance": "x"}, "wear.tolerance: 'x' is no number"), ({"vanishing_rate": -1.0}, "wear.vanishing_rate"),
    ({"vanishing_rate": float("nan")}, "wear.vanishing_rate"),
    ({"max_depth_per_jump": "1e-6"}, "wear.max_depth_per_jump: '1e-6' is no number")])
def test_settings_of_a_march_are_checked(settings, words):
    with pytest.raises(ff.InputError, match=words):
        ff.march_wear(slider(), ff.Archard(1e-14), 1000, **settings)


def test_bolted_joints_check_friction_and_counts_of_modes_and_motions(right):
    given = right["BoltedJoint"]
    with pytest.raises(ff.InputError, match="friction coefficient: 2 values for 1 contact points"):
        ff.BoltedJoint(**{**given, "law": ff.Coulomb([0.5, 0.5])})
    joint = ff.BoltedJoint(**given)
    for count in (0, -1):
        with pytest.raises(ff.InputError, match=f"modes: asked for {count}; give at least 1"):
            joint.linear_modes(count)
    assert callable(ff.follow_mode)  # whose arguments are checked from now on
    assert ff.study_joint(joint, np.array([1e-6]), periodic=0).motions == ()


@pytest.mark.parametrize("form", ["csr", "csc", "coo", "bsr", "lil", "dok", "dia"])
def test_sparse_matrices_of_any_format_are_taken(right, form):
    given = right["StructureMatrices"]
    made = ff.StructureMatrices(**{**given, **{name: csr_matrix(given[name]).asformat(form) for name in (
        "mass", "stiffness", "contact_map")}})
    due = ff.reduce_structure(ff.StructureMatrices(**given))
    assert ff.reduce_structure(made).eigenvalues == pytest.approx(due.eigenvalues, rel=1e-12)


def test_no_excitation_has_no_response():
    still = replace(slider(), excitation=ff.Harmonic(20.0, {}))
    with pytest.raises(ff.InputError, match="excitation: is zero"):
        ff.continue_response(still, 100.0, 220.0)
    with pytest.raises(ff.InputError, match="excitation: is zero"):
        still.vary(amplitude=3.0)


def test_lists_are_arrays_and_of_the_right_length():
    loop = ff.HysteresisLoop(displacement=[0.0, 1.0, 0.0, -1.0] * 4, force=[1.0, 0.0, -1.0, 0.0] * 4)
    assert loop.force.shape == (16,)
    one = slider()
    assert ff.solve_periodic(replace(one, law=ff.Coulomb([0.5])), "dlft").dissipated_energy > 0.0
    with pytest.raises(ff.InputError, match="friction coefficient: 2 values for 1 contact nodes"):
        replace(one, law=ff.Coulomb([0.5, 0.5]))
    for method in ("quasi-static", "dlft"):
        with pytest.raises(ff.InputError, match="interface: has 2 nodes, but the structure has 1 contact nodes"):
            ff.solve_periodic(replace(one, interface=slider(2).interface), method)
    with pytest.raises(ff.InputError, match="contact_compliance: has 2 values, but the contact has 3 DOF"):
        slider(contact_compliance=[1e-9, 1e-9])


@pytest.mark.parametrize(("change", "words"), [
    ({"observe": {"tip": 1.7}}, "tip is 1.7, which is no whole number"),
    ({"observe": {"tip": np.full(3, np.nan)}}, "tip must be finite"),
    ({"observe": {"tip": np.zeros(3)}}, "tip must be finite"),
    ({"stiffness": np.diag([1e6, -2e5, 1e6]), "modal_damping": None}, "K: is not positive"),
    ({"mass": np.array([[1.0, 1.5, 0.0], [1.5, 1.0, 0.0], [0.0, 0.0, 1.0]])}, "M: is not positive"),
    ({"damping": -np.eye(3)}, "C: is not positive")])
def test_what_no_passive_structure_has_is_refused(change, words):
    given = {"stiffness": 1e6 * np.eye(3), "mass": np.eye(3), "contact": [0], "contact_compliance": 1e-9, **change}
    with pytest.raises(ff.InputError, match=words):
        ff.Joint.from_matrices(**given)


def test_friction_that_falls_with_pressure_has_a_reference():
    """Below zero it held the faces together, whatever pulled."""
    for pressure in (0.0, -5e6):
        with pytest.raises(ff.InputError, match=f"reference_pressure {pressure} Pa must be positive"):
            ff.Coulomb(0.5, exponent=0.3, reference_pressure=pressure)
    with pytest.raises(ff.InputError, match="friction: reference_pressure is required"):
        replace(slider(), law=ff.Coulomb(0.5, exponent=0.3), preload=ff.NormalLoad(0.0))
    tight = ff.Interface([0, 1], [1e-6] * 2, [-6e-5, 1e-2])  # closed without a load, and a node out of reach
    assert ff.solve_periodic(replace(slider(2), interface=tight, preload=ff.NormalLoad(0.0))).dissipated_energy > 0.0


def test_an_effect_of_the_rig_alone_is_named():
    with pytest.raises(ff.InputError, match=r"effects\.viscous: acts on the two-mass rig"):
        ff.march_wear(slider(), ff.Archard(1e-14), 10, effects=[ff.catalogue()["viscous"]()])


def test_free_bodies_that_are_pressed_together_need_the_quasi_static_solver():
    link = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), 1e6 * np.eye(3))
    rows = np.hstack([np.eye(3), -np.eye(3)])
    joint = ff.Joint.from_matrices(link, np.eye(6), contact_map=rows, observe={"tip": 0}, contact_compliance=1e-9)
    problem = replace(slider(), structure=joint)
    with pytest.raises(ff.InputError, match='use method="quasi-static"'):
        ff.solve_periodic(problem, "dlft")
