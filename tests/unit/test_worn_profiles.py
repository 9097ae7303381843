"""Worn profiles are read in SI, what cannot be is named, and laws of wear that made them are told from one coefficient.

What carries the weight: profiles made by the march itself with oxygen-limited wear, under noise, are not explained by
one coefficient, and their borders wear as one coefficient says.
"""

import numpy as np
import pytest
from fretflow.core.errors import FretflowError
from fretflow.effects.line_cycle import LineContact, LineCycle
from fretflow.effects.oxygen_limited_wear import OxygenLimitedWear
from fretflow.experiments.structure import worn
from fretflow.experiments.structure.profiles import ProfileExperiment
from fretflow.experiments.structure.run import diagnose_structure
from fretflow.inference.experiment import Point
from fretflow.inference.verdict import HeldOut, Verdict
from fretflow.recordings.kinds.structures import read_structure_recording

HEAD = """format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
friction_coefficient = 0.8
[structure.line_contact]
radius = "80 mm"
load = "1000 N/mm"
youngs_modulus = "110 GPa"
poissons_ratio = 0.3
"""
PROFILE = """[[profile]]
file = "{name}.csv"
cycles = 5000
frequency = "{frequency} Hz"
displacement_amplitude = "75 um"
x = {{ column = "x_mm", unit = "mm" }}
depth = {{ column = "z_um", unit = "um", sd = "1 um" }}
"""
VOLUMES = """[volumes]
file = "volumes.csv"
width = "8 mm"
volume = { column = "V", unit = "mm^3", sd = "0.01 mm^3" }
cycles = { column = "N", unit = "1" }
frequency = { column = "f", unit = "Hz" }
displacement_amplitude = { column = "d", unit = "um" }
"""
MODULUS = 0.5 * 110e9 / (1.0 - 0.3**2)


def made(folder, effects=(), frequencies=(0.1, 2.0), coefficient=1e-13):
    """Write profiles of a march with `effects` and return their recording."""
    rng, text = np.random.default_rng(4), HEAD
    for frequency in frequencies:
        line = LineContact(80e-3, MODULUS, 1e6, 75e-6, frequency, 0.8, 6e-3, 121)
        depth = LineCycle(line, effects).wear(coefficient, 5000.0, 60).slow.depth
        name = f"at_{frequency:g}_Hz".replace(".", "p")
        x = np.linspace(-4e-3, 4e-3, 41)
        z = np.interp(x, line.interface.nodes[:, 0], depth) + 1e-6 * rng.standard_normal(41)
        np.savetxt(folder / f"{name}.csv", np.c_[1e3 * x, 1e6 * z], delimiter=",", header="x_mm,z_um", comments="")
        text += PROFILE.format(name=name, frequency=frequency)
    (folder / "volumes.csv").write_text("V,N,f,d\n1.2,5000,2,75\n")
    (folder / "recording.toml").write_text(text)
    return read_structure_recording(folder)


def test_profiles_and_volumes_are_read_in_si(tmp_path):
    made(tmp_path)
    (tmp_path / "recording.toml").write_text((tmp_path / "recording.toml").read_text() + VOLUMES)
    recording = read_structure_recording(tmp_path)
    first, second = recording.profiles
    assert (first.test.frequency, second.test.frequency, first.test.amplitude) == (0.1, 2.0, 75e-6)
    assert first.test.area == pytest.approx(1e-13 * 1e6 * 3e-4 * 5000.0, rel=0.05)
    assert first.depth_sd == pytest.approx(1e-6)
    assert recording.areas[0].area == pytest.approx(1.2e-9 / 8e-3)
    measured = ProfileExperiment(recording).measurement
    assert measured.channels == ("worn depth", "worn volume")
    assert len(measured.values) == 83


@pytest.mark.parametrize(("old", "new", "words"), [
    ('radius = "80 mm"', 'matrices = "a.npz"', "line_contact"),
    ('cycles = 5000', 'cycles = 0', "cycles"),
    ('unit = "um", sd', 'unit = "N", sd', "profile.depth.unit: 'N' is no unit like m"),
    ('poissons_ratio = 0.3', 'poissonratio = 0.3', "did you mean poissons_ratio"),
    ('poissons_ratio = 0.3', 'poissons_ratio = 0.3\npoisson_ratio = 0.3', "poisson_ratio"),
    ('poissons_ratio = 0.3', 'poissons_ratio = 0.6', "poissons_ratio")])
def test_a_bad_key_is_named(tmp_path, old, new, words):
    made(tmp_path)
    text = (tmp_path / "recording.toml").read_text()
    (tmp_path / "recording.toml").write_text(text.replace(old, new))
    with pytest.raises(FretflowError, match=words):
        read_structure_recording(tmp_path)


def test_a_material_is_named_as_everywhere_else_and_earlier_files_are_still_read(tmp_path):
    """`elastic_modulus` and `poisson_ratio` stood in these files alone."""
    contact = made(tmp_path).contact
    toml = tmp_path / "recording.toml"
    toml.write_text(toml.read_text().replace("youngs_modulus", "elastic_modulus").replace("poissons_", "poisson_"))
    assert read_structure_recording(tmp_path).contact == contact


def test_a_modulus_in_a_wrong_unit_is_noted(tmp_path):
    """110 Pa came to "not in the catalogue" at more than 99.9 % without a word."""
    assert not made(tmp_path).notes
    text = (tmp_path / "recording.toml").read_text()
    (tmp_path / "recording.toml").write_text(text.replace("110 GPa", "110 Pa"))
    (note,) = read_structure_recording(tmp_path).notes
    assert "youngs_modulus = 110 Pa is beyond what joints have (100 MPa to 1.3 TPa)" in str(note)


MAP = PROFILE.format(name="map", frequency=1).replace("[[profile]]", "[wear_depth]").replace(
    "depth =", 'y = { column = "y_mm", unit = "mm" }\ndepth =')


def test_a_map_is_the_profile_of_its_lines(tmp_path):
    """Known as well as lines agree: here they differ by 3 µm beside a stated noise of 1 µm."""
    made(tmp_path, frequencies=(1.0,))
    x, z = np.loadtxt(tmp_path / "at_1_Hz.csv", delimiter=",", skiprows=1, unpack=True)
    rows = [(own, y, depth + 3.0 * (-1.0)**y) for y in range(6) for own, depth in zip(x, z, strict=True)]
    np.savetxt(tmp_path / "map.csv", rows, delimiter=",", header="x_mm,y_mm,z_um", comments="")
    (tmp_path / "recording.toml").write_text(HEAD + MAP)
    recording = read_structure_recording(tmp_path)
    (profile,) = recording.profiles
    assert profile.x == pytest.approx(1e-3 * x, abs=1e-12)
    assert profile.depth == pytest.approx(1e-6 * z, abs=1e-12)
    assert profile.depth_sd == pytest.approx(3e-6, rel=0.15)
    assert diagnose_structure(recording, True, lambda share, text: None).verdict is Verdict.NONE


@pytest.mark.parametrize(("old", "new", "words"), [
    ("cycles = 5000", "", r"wear_depth\.cycles: "),
    ('y = { column = "y_mm", unit = "mm" }', "", r"wear_depth\.y: "),
    ("y_mm,z_um", "y_mm,z", "z_um"),
    ("1.0,0,", "1.01,0,", "x = 1 mm has one depth; give a map in lines")])
def test_a_map_that_cannot_be_is_told(tmp_path, old, new, words):
    lines = "x_mm,y_mm,z_um\n" + "".join(f"{x}.0,{y},{z}\n" for y in (0, 1) for x, z in enumerate((1, 5, 9, 5, 1)))
    (tmp_path / "map.csv").write_text(lines.replace(old, new))
    (tmp_path / "recording.toml").write_text((HEAD + MAP).replace(old, new))
    with pytest.raises(FretflowError, match=words):
        read_structure_recording(tmp_path)


def test_the_march_that_made_them_is_found_again(tmp_path):
    effect = OxygenLimitedWear().changed(distance=0.8e-3, adhesive_share=0.15)
    experiment = ProfileExperiment(made(tmp_path, [effect]))
    own = experiment.measurement
    space = experiment.parameters([effect.id])
    true = {"wear_coefficient": 1e-13, "friction_coefficient": 0.8, "distance": 0.8e-3, "adhesive_share": 0.15}
    z = np.array([(np.log(true[one.field]) if one.logarithmic else true[one.field]) - one.middle
                  for one in space.coordinates]) / np.array([one.size for one in space.coordinates])
    left = (experiment.predict(Point(space, z)).values - own.values) / np.sqrt(own.variance)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(1.0, abs=0.3)


def test_one_coefficient_is_enough_where_nothing_else_acts(tmp_path):
    diagnosis = diagnose_structure(made(tmp_path, frequencies=(1.0,)), True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NONE
    (curve,) = diagnosis.curves
    assert np.abs(curve.measured - curve.before).max() < 5e-6


def test_laws_that_predict_the_other_profile_worse_than_one_coefficient_are_not_named(tmp_path, monkeypatch):
    monkeypatch.setattr(worn, "held_out", lambda *told: HeldOut(what="", before=3.0, after=9.0, floor=1.0))
    diagnosis = diagnose_structure(made(tmp_path, (OxygenLimitedWear(),)), True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.UNKNOWN
    assert diagnosis.held_out.after == 9.0
    assert "what was held out worse" in diagnosis.sentence
