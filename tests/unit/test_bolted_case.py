"""Case files of bolted structures: the example is read, what cannot be is one line, and a run keeps what it says."""

from __future__ import annotations

import json
from pathlib import Path

import fretflow as ff
import numpy as np
import pytest
from fretflow.case.bolted import Elasticity, load_bolted_case
from fretflow.case.config import load_case
from fretflow.case.plausibility import implausible
from fretflow.cli.run import _figure
from fretflow.core.errors import ConfigError, MeshError, StoreError

EXAMPLES = Path(__file__).parents[2] / "examples"
EXAMPLE = (EXAMPLES / "bolted_beam.toml").read_text(encoding="utf-8")


def changed(folder, old, new):
    """Return the example's file with a part replaced."""
    assert EXAMPLE.count(old) == 1
    file = folder / "case.toml"
    file.write_text(EXAMPLE.replace(old, new), encoding="utf-8")
    return file


def test_the_example_is_read_in_si():
    case = load_bolted_case(EXAMPLES / "bolted_beam.toml")
    assert case.joint.bolt_load == 8e3
    assert case.backbone.largest == pytest.approx(600e-6)
    assert case.structure.sensors["tip"].along == (0.0, 0.0, 1.0)
    assert load_bolted_case(EXAMPLES / "quick.toml") is None
    with pytest.raises(ConfigError, match="format: is a bolted structure, which `fretflow run` takes"):
        load_case(EXAMPLES / "bolted_beam.toml")


@pytest.mark.parametrize(("old", "new", "said"), [
    ('bolt_load = "8 kN"', 'bolt_load = "8 mm"', "joint.bolt_load: .*wrong dimension"),
    ('smallest = "10 um"', 'smallest = "0 um"', "backbone.smallest: .*positive"),
    ('smallest = "10 um"', 'smallest = "10 mm"', "backbone: .*largest must be above smallest"),
    ("friction_coefficient = 0.6", "", "joint.friction_coefficient: is required"),
    ('mass = "30 g" }', 'mass = "30 g", torque = 1 }', "structure.bolts.0.torque: unknown key"),
    ("lap_beam = {", 'mesh_unit = "1 mm"\nlap_beam = {', "structure: .*materials and mesh_unit are of a mesh"),
    ("lap_beam = {", 'mesh = "absent.msh"\nlap_beam = {', "structure: .*one of mesh and lap_beam"),
])
def test_what_cannot_be_is_one_line(tmp_path, old, new, said):
    with pytest.raises(ConfigError, match=said) as error:
        load_bolted_case(changed(tmp_path, old, new))
    assert "\n" not in str(error.value)


def test_what_no_joint_has_is_named(tmp_path):
    assert not list(implausible(load_bolted_case(EXAMPLES / "bolted_beam.toml")))
    (warning,) = implausible(load_bolted_case(changed(tmp_path, '"205 GPa"', '"205 Pa"')))
    assert warning.startswith("structure.material.youngs_modulus = 205 Pa is beyond what joints have")
    case = load_bolted_case(EXAMPLES / "bolted_beam.toml")
    padded = case.structure.model_copy(update={"materials": {"pad": Elasticity(density="1 kg/m^3")}})
    (warning,) = implausible(case.model_copy(update={"structure": padded}))
    assert warning.startswith("structure.materials.pad.density = 1 kg/m³ is beyond what joints have")


def test_a_lap_beam_of_unknown_keys_is_refused():
    from fretflow_meshes import LapBeam

    assert LapBeam.of({"length": "400 mm", "lap": "10 cm", "bolts": 2}).length == pytest.approx(0.4)
    with pytest.raises(MeshError, match="lap_beam: has no 'holes'; it has length"):
        LapBeam.of({"holes": 3})
    with pytest.raises(MeshError, match=r"lap_beam: .*wrong dimension"):
        LapBeam.of({"length": "3 kg"})


@pytest.mark.fem
@pytest.mark.render
def test_a_run_keeps_figures_curves_and_pictures(tmp_path):
    from fretflow.pipeline.bolted import run_bolted

    (tmp_path / "measured.csv").write_text("amplitude_m,frequency_Hz,damping_ratio\n1e-5,90,1e-3\n1e-4,89,2e-3\n")
    text = EXAMPLE.replace("across = 4", "across = 2, bolts = 1").replace('lap = "120 mm"', 'lap = "60 mm"')
    text = text.partition("[response]")[0] + 'points = 4\nperiodic = 1\nmeasured = "measured.csv"\n'
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    study = run_bolted(load_bolted_case(tmp_path / "case.toml"), tmp_path / "runs")
    home = tmp_path / "runs" / "bolted-beam"
    figures = json.loads((home / "summary.json").read_text(encoding="utf-8"))
    assert figures["linear_frequency_Hz"] == pytest.approx(study.mode.frequency)
    kept = np.genfromtxt(home / "backbone.csv", delimiter=",", names=True)
    assert kept["frequency_Hz"] == pytest.approx(study.curve.frequency)
    assert all((home / f"{name}.png").stat().st_size > 20_000 for name in ("structure", "contact", "curves"))
    assert study.measured.shape == (3, 2)
    own = study.write(str(tmp_path / "of" / "one's own"))  # a folder that is made
    assert {file.name for file in own} >= {"summary.json", "backbone.csv", "curves.png"}
    # the facets that are drawn are the interface's own
    assert len(study.states) == study.joint.structure.contacts


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    from fretflow.pipeline.bolted import run_bolted

    (tmp_path / "case.toml").write_text(EXAMPLE, encoding="utf-8")
    with pytest.raises(StoreError, match="cannot be written"):
        run_bolted(load_bolted_case(tmp_path / "case.toml"), Path("/proc/nothing"))


@pytest.mark.filterwarnings("error")
def test_a_joint_that_sticks_is_drawn_too(tmp_path):
    """Of the energy of its cycles, round-off about zero, there is no logarithm, which matplotlib warned of."""
    link, hold = np.diag([2e6, 3e6, 4e6]), np.diag([1e6, 1e6, 2e6])
    bar = ff.StructureMatrices(
        mass=np.diag([1.0] * 3 + [0.2] * 3), stiffness=np.block([[link + hold, -link], [-link, link]]),
        contact_map=np.eye(3, 6, 3), areas=np.array([1e-4]), points=np.zeros((1, 3)), preload=-np.eye(6)[5],
        outputs={"tip": np.eye(6)[0]})
    joint = ff.BoltedJoint(structure=ff.reduce_structure(bar), law=ff.Coulomb(0.5), bolt_load=100.0)
    study = ff.study_joint(joint, np.array([1e-6, 1e-5]))
    assert study.curve.dissipated.max() < 1e-18
    assert [file.name for file in study.draw(tmp_path)] == ["contact.png", "curves.png"]


@pytest.mark.parametrize(("name", "value", "shown"), [
    ("largest_pressure_Pa", 42.168e6, ("largest pressure", "42.17 MPa")),
    ("points_closed", 84, ("points closed", "84")),
    ("linear_frequency_Hz", 87.832, ("linear frequency", "87.83 Hz")),
    ("energy_power", 2.0018, ("energy power", "2.002")),
    ("worn_volume_m3", 7.69058e-10, ("worn volume", "0.7691 mm³"))])
def test_figures_are_printed_in_words_and_units(name, value, shown):
    assert _figure(name, value) == shown


@pytest.mark.fem
def test_a_mesh_on_which_its_reader_crashes_is_refused(tmp_path, capfd):
    """A count of no nodes above a list of them aborts some versions of gmsh; others may find words for it."""
    from fretflow.cli import execute
    from fretflow_meshes import LapBeam

    mesh = tmp_path / "beam.msh"
    LapBeam(across=2, stretch=3.0).write(mesh)
    content = bytearray(mesh.read_bytes())
    count = content.index(b"$Nodes\n") + 15
    content[count:count + 8] = bytes(8)
    mesh.write_bytes(content)
    lap = next(line for line in EXAMPLE.splitlines() if line.startswith("lap_beam"))
    case = changed(tmp_path, lap, 'mesh = "beam.msh"')
    named = case.read_text(encoding="utf-8").replace("{ diameter", '{ head = "head 1", nut = "nut 1", diameter')
    case.write_text(named, encoding="utf-8")
    assert execute(["run", str(case), "--out", str(tmp_path / "runs")]) == 2
    said = capfd.readouterr().err.strip()
    assert said.startswith(f"fretflow: {mesh}: ")
    assert "gmsh cannot read" in said or "breaks off in it" in said
