"""Property: a meshed beam bolted from two halves has a beam's frequencies, moves freely as a whole, and balances."""

from __future__ import annotations

import numpy as np
import pytest
from fretflow.core.errors import FretflowError, InputError, MeshError
from scipy.sparse.linalg import eigsh

pytestmark = pytest.mark.fem

STEEL = {"youngs_modulus": 210e9, "poissons_ratio": 0.29, "density": 7800.0}  # the measured beam weighs 1.796 kg
COARSE = {"across": 2, "rings": (1, 1), "stretch": 2.0}


@pytest.fixture(scope="module")
def meshed(tmp_path_factory):
    """Return a function that meshes a beam and assembles it."""
    from fretflow.structure.bodies import Bolt, Material
    from fretflow.structure.fem.bodies import structure_from_mesh
    from fretflow_meshes import LapBeam

    def make(bolted=True, clamped=(), **sizes):
        beam = LapBeam(**(COARSE | sizes))
        path = beam.write(tmp_path_factory.mktemp("beam") / "beam.msh")
        bolts = [Bolt.round(f"head {k}", f"nut {k}", diameter=8e-3, grip=beam.thickness, mass=0.03)
                 for k in range(1, beam.bolts + 1)] if bolted else []
        return beam, structure_from_mesh(path, Material(**STEEL), [("upper lap", "lower lap")], bolts, clamped, {
            "tip": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))})

    return make


@pytest.fixture(scope="module")
def bolted(meshed):
    """Return the default beam on a coarse mesh, with its bolts."""
    return meshed()


def lowest(matrices):
    """Return the first eigenvalues (1/s^2, ascending) and modes of the open joint."""
    shift = 1e-9 * matrices.stiffness.diagonal().max() / matrices.mass.diagonal().max()
    values, modes = eigsh(matrices.stiffness, 12, matrices.mass, sigma=-shift, which="LM")
    order = np.argsort(values)
    return values[order], modes[:, order]


def tied(matrices, modes=3):
    """Return the first frequencies (Hz) with the whole lap closed."""
    from fretflow.structure.reduction.contact_modes import reduce_structure

    return np.sqrt(reduce_structure(matrices, modes).eigenvalues) / (2.0 * np.pi)


def test_a_lap_of_the_whole_length_is_a_solid_bar(meshed):
    """Euler and Bernoulli, free-free: beta L = 4.7300; shear and rotation take 0.5 %."""
    beam, matrices = meshed(bolted=False, length=0.36, lap=0.36, bolts=1, hole=1e-3, washer=4e-3)
    speed = np.sqrt(STEEL["youngs_modulus"] / STEEL["density"])
    bar = 4.7300408**2 / (2.0 * np.pi * beam.length**2) * speed * beam.thickness / np.sqrt(12.0)
    assert tied(matrices)[0] == pytest.approx(bar, rel=0.01)


def test_a_tied_beam_sounds_as_published(meshed):
    """Half Brake-Reuss beam, lap fully tied and no bolts: 114.7 Hz (the shoulders at the ends of the lap are open)."""
    assert tied(meshed(bolted=False, across=4)[1])[0] == pytest.approx(114.7, rel=0.015)


def test_mass_areas_and_motions_of_the_whole(bolted):
    beam, matrices = bolted
    quarter = np.pi / 4.0
    sides = 2 * (COARSE["across"] + 2)  # of the polygon that stands for a hole
    polygon = quarter * beam.hole**2 * np.sin(2.0 * np.pi / sides) * sides / (2.0 * np.pi)
    holes = beam.bolts * polygon
    assert matrices.areas.sum() == pytest.approx(beam.lap * beam.width - holes, rel=0.02)
    solid = STEEL["density"] * beam.thickness * (beam.length * beam.width - holes)
    along = np.zeros((matrices.size, 3))
    for axis in range(3):
        along[axis::3, axis] = 1.0
    assert np.diag(along.T @ (matrices.mass @ along)) == pytest.approx(solid + 3 * 0.03, rel=2e-3)
    values, rigid = lowest(matrices)
    assert np.sum(np.abs(values) < 1e-6 * values[-1]) == 6  # the bolts alone hold the bars together
    size = np.abs(rigid[:, :6]).max()
    assert np.abs(matrices.contact_map @ rigid[:, :6]).max() < 1e-5 * size
    assert np.abs(rigid[:, :6].T @ matrices.preload).max() < 1e-5 * size


def test_contact_rows_read_the_opening(bolted):
    _, matrices = bolted
    up = np.zeros(matrices.size)
    up[2::3] = 1.0
    moved = (matrices.contact_map @ up).reshape(-1, 3)
    assert np.abs(moved).max() < 1e-9  # both bodies together
    spread = (abs(matrices.contact_map) @ np.ones(matrices.size)).reshape(-1, 3)
    assert np.all(spread > 1.9)


def test_bolts_press_the_faces_with_their_own_load(bolted):
    from fretflow.contact.coulomb import Coulomb
    from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
    from fretflow.structure.reduction.contact_modes import reduce_structure

    beam, matrices = bolted
    reduced = reduce_structure(matrices, 20)
    assert reduced.error < 1e-3
    joint = BoltedJoint(structure=reduced, bolt_load=10e3, law=Coulomb(0.6))
    pressing = joint.preloaded.force[0, 2::3]
    # three bolts; what the shanks give back as the bars are squeezed between washers is a part of it
    assert 0.6 * 30e3 < pressing.sum() < 30e3
    middle = pressing @ matrices.points / pressing.sum()
    assert middle[0] == pytest.approx(0.5 * beam.length, abs=1e-5)
    nearest = np.abs(matrices.points[:, :1] - beam.bolt_places).min(axis=1)
    assert pressing[nearest > 0.6 * beam.pitch].sum() < 0.05 * pressing.sum()  # the ends gape
    frequency = joint.linear_modes(1)[0].frequency
    assert 75.0 < frequency < 100.0  # partial contact: measured 80.3, tied 114.7


def test_a_clamped_end_holds_the_beam(meshed):
    _, matrices = meshed(clamped=["right"])
    assert lowest(matrices)[0][0] > (2.0 * np.pi * 5.0)**2


def test_what_cannot_be_is_one_line(meshed, tmp_path):
    from fretflow.structure.bodies import Bolt, Material
    from fretflow.structure.fem.bodies import structure_from_mesh
    from fretflow_meshes import LapBeam

    path = LapBeam(**COARSE).write(tmp_path / "beam.msh")
    steel = Material(**STEEL)
    with pytest.raises(MeshError, match=r"no physical surface named 'lid'; it has head 1"):
        structure_from_mesh(path, steel, [("lid", "lower lap")])
    with pytest.raises(MeshError, match=r"does not lie on .nut 1."):
        structure_from_mesh(path, steel, [("upper lap", "nut 1")])
    with pytest.raises(InputError, match=r"tip: lies .* mm off the nearest node"):
        structure_from_mesh(path, steel, [("upper lap", "lower lap")], sensors={"tip": ((1.0, 0, 0), (0, 0, 1))})
    with pytest.raises(InputError, match=r"in one place"):
        structure_from_mesh(path, steel, [("upper lap", "lower lap")], [Bolt(head="nut 1", nut="nut 1")])
    with pytest.raises(InputError, match=r"bolts: 'lower lap' is a face of an interface; name the faces under head"):
        structure_from_mesh(path, steel, [("upper lap", "lower lap")], [Bolt(head="head 1", nut="lower lap")])
    with pytest.raises(InputError, match=r"degree: 3"):
        structure_from_mesh(path, steel, [("upper lap", "lower lap")], degree=3)
    with pytest.raises(MeshError, match=r"washer: .* must be wider than the hole"):
        LapBeam(washer=5e-3)
    with pytest.raises(MeshError, match=r"across: 4,000 elements over the width make some 75,\d+,000 contact points"):
        LapBeam(across=4000)

RECORDING = """
format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
mesh = "beam.msh"
bolts = [
  { head = "head 1", nut = "nut 1", diameter = "8 mm", grip = "12.7 mm", mass = "30 g" },
  { head = "head 2", nut = "nut 2", diameter = "8 mm", grip = "12.7 mm", mass = "30 g" },
  { head = "head 3", nut = "nut 3", diameter = "8 mm", grip = "12.7 mm", mass = "30 g" },
]
sensors.tip = { at = ["0 mm", "0 mm", "0 mm"], along = [0.0, 0.0, 1.0] }
material = { youngs_modulus = "210 GPa", poissons_ratio = 0.29, density = "7800 kg/m^3" }
friction_coefficient = 0.5
modal_damping = 1e-3
[structure.unknown]
bolt_load = ["4 kN", "16 kN"]
[backbone]
file = "backbone.csv"
amplitude_of = "tip"
amplitude = { column = "a", unit = "um" }
frequency = { column = "f", unit = "Hz" }
"""


@pytest.fixture
def recorded(meshed, tmp_path):
    """Return a function that writes a recording of the default beam and returns its folder."""
    beam, _ = meshed()
    beam.write(tmp_path / "beam.msh")
    (tmp_path / "backbone.csv").write_text("a,f\n1,86.0\n2,86.0\n4,86.0\n")

    def write(old="", new=""):
        assert old in RECORDING
        (tmp_path / "recording.toml").write_text(RECORDING.replace(old, new))
        return tmp_path

    return write


def test_a_recording_names_a_mesh_in_place_of_matrices(recorded, bolted):
    from fretflow.contact.coulomb import Coulomb
    from fretflow.experiments.structure.experiment import StructureExperiment
    from fretflow.recordings.kinds.structures import read_structure_recording
    from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
    from fretflow.structure.reduction.contact_modes import reduce_structure

    recording, own = read_structure_recording(recorded()), bolted[1]
    assert recording.matrices.contacts == own.contacts
    assert recording.matrices.mass.sum() == pytest.approx(own.mass.sum(), rel=1e-9)
    assert abs(recording.matrices.preload - own.preload).max() < 1e-9
    joint = BoltedJoint(structure=reduce_structure(own), law=Coulomb(0.5), bolt_load=8e3)  # the middle of the range
    first = StructureExperiment.of(recording).first_prediction()
    assert first.values[0] == pytest.approx(joint.linear_modes(1)[0].frequency, rel=1e-4)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('mesh = "beam.msh"', 'mesh = "none.msh"', "none.msh: no such mesh file"),
    ('head = "head 2"', 'head = "lid"', "lid"),
    ('head = "head 3", ', "", "name the faces under its head and nut"),
    ('"210 GPa"', '"210 mm"', "structure.material.youngs_modulus"),
    ('material = {', 'material = "steel"\nclamped = ["end"]\n#', "material: of a mesh is a table"),
    ('mesh = "beam.msh"', 'matrices = "structure.npz"', "bolts: belongs to a mesh, which is not given"),
])
def test_what_a_recording_says_wrongly_of_a_mesh_is_named(recorded, old, new, words):
    from fretflow.recordings.kinds.structures import read_structure_recording

    with pytest.raises(FretflowError, match=words) as caught:
        read_structure_recording(recorded(old, new))
    assert "\n" not in str(caught.value)
