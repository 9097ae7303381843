"""Property: a recording of a structure is read to the letter of its keys, in SI, and what cannot be is named."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.core.errors import FretflowError
from fretflow.experiments.structure.backbone import outside_of_mode
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.points import BackbonePoints, above_noise, weights_of
from fretflow.experiments.structure.responses import in_order, oscillator, resonance
from fretflow.experiments.structure.run import beyond_stated
from fretflow.inference.evidence import code_size, size_prior
from fretflow.inference.verdict import Estimate
from fretflow.recordings.kinds.structure_sections import Control
from fretflow.recordings.kinds.structures import ControlledResponse, read_structure_recording
from fretflow.solvers.nonlinear_modes.ring_down import instantaneous_mode
from scipy.linalg import block_diag

TOML = """
format = "fretflow-recording/1"
title = "a beam"
[test]
kind = "structure"
[structure]
matrices = "structure.npz"
friction_coefficient = 0.6
[structure.unknown]
bolt_load = ["2 kN", "20 kN"]
modal_damping = {{ low = 1e-4, high = "1 %" }}
[backbone]
file = "backbone.csv"
amplitude_of = "{of}"
amplitude = {{ column = "a", unit = "{unit}", calibration_sd = 0.02 }}
frequency = {{ column = "f", unit = "Hz", sd = "0.01 Hz" }}
damping = {{ column = "zeta", unit = "%" }}
[[frf]]
file = "frf.csv"
control = "response"
of = "tip"
level = "5 um"
frequency = {{ column = "f", unit = "Hz" }}
force = {{ column = "F", unit = "mN" }}
amplitude = {{ column = "x", unit = "um" }}
phase = {{ column = "phi", unit = "deg" }}
[ring_down]
file = "ring.csv"
time = {{ column = "t", unit = "ms" }}
tip = {{ column = "acc", unit = "m/s^2" }}
"""
BACKBONE = "a,f,zeta\n1,80.0,0.1\n2,79.9,0.2\n3,79.8,0.4\n"


@pytest.fixture
def folder(tmp_path, structures):
    """Return a function that writes a recording and returns its folder."""
    def make(text=TOML, of="tip", unit="m/s^2", backbone=BACKBONE, **also):
        beam = structures.lap_beam(5, 3)
        np.savez(tmp_path / "structure.npz", M=beam.mass, K=beam.stiffness, contact_map=beam.contact_map,
                 areas=beam.areas, points=beam.points, preload=beam.preload, **also,
                 **{f"outputs/{name}": row for name, row in beam.outputs.items()})
        (tmp_path / "recording.toml").write_text(text.format(of=of, unit=unit) if text is TOML else text)
        (tmp_path / "backbone.csv").write_text(backbone)
        (tmp_path / "frf.csv").write_text("f,F,x,phi\n79,100,5,10\n80,50,5,90\n81,100,5,170\n")
        (tmp_path / "ring.csv").write_text("t,acc\n0,1\n1,0.5\n2,-1\n")
        return tmp_path

    return make


def test_every_block_is_read_in_si(folder):
    recording = read_structure_recording(folder())
    assert recording.known == {"friction_coefficient": 0.6}
    assert recording.unknown == {"bolt_load": (2e3, 2e4), "modal_damping": (1e-4, 1e-2)}
    backbone, (response,), ring = recording.backbone, recording.responses, recording.ring_down
    assert backbone.amplitude_unit == "m/s^2"
    assert backbone.damping == pytest.approx([1e-3, 2e-3, 4e-3])
    assert (backbone.frequency_sd, backbone.damping_sd, backbone.calibration_sd) == (0.01, None, 0.02)
    assert response.control is Control.RESPONSE
    assert response.level == pytest.approx(5e-6)
    assert response.force == pytest.approx([0.1, 0.05, 0.1])
    assert response.amplitude == pytest.approx([5e-6] * 3)
    assert response.phase == pytest.approx(np.deg2rad([10, 90, 170]))
    assert ring.time == pytest.approx([0.0, 1e-3, 2e-3])
    assert ring.units == {"tip": "m/s^2"}
    assert set(recording.matrices.outputs) == {"tip", "end"}


@pytest.mark.parametrize("unit", ["m*kg^0.5", "mm*kg^0.5", ""])
def test_a_modal_amplitude_is_mass_normalised(folder, unit):
    recording = read_structure_recording(folder(of="modal", unit=unit))
    scale = 1e-3 if unit[:2] == "mm" else 1.0
    assert recording.backbone.amplitude == pytest.approx(np.array([1.0, 2.0, 3.0]) * scale)


def test_damping_in_the_matrices_is_known_and_what_nothing_is_said_of_is_noted(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('bolt_load = ["2 kN", "20 kN"]', "").replace(
        'modal_damping = { low = 1e-4, high = "1 %" }', "")
    recording = read_structure_recording(folder(text, modal_damping=0.002))
    assert recording.known["modal_damping"] == 0.002
    assert set(recording.unknown) == {"bolt_load"}
    assert any("bolt_load is neither known nor given a range" in str(note) for note in recording.notes)


def test_a_damping_matrix_tells_the_ratio_of_the_recorded_mode(folder):
    """Of C = a M it is a / (2 w), w that of the mode; where a range is stated, that holds."""
    text = TOML.format(of="tip", unit="m/s^2").replace(
        'modal_damping = { low = 1e-4, high = "1 %" }', "")
    experiment = StructureExperiment.of(read_structure_recording(folder(text, C=3.0 * np.load(
        folder() / "structure.npz")["M"])))
    (mode,) = experiment._bare[0].linear_modes(1)
    assert experiment.recording.known["modal_damping"] == pytest.approx(
        3.0 / (4.0 * np.pi * mode.frequency), rel=1e-3)  # mid-range, where bolts close most of the faces
    assert experiment.mode == 0
    stated = StructureExperiment.of(read_structure_recording(folder(C=np.load(folder() / "structure.npz")["M"])))
    assert "modal_damping" not in stated.recording.known


@pytest.mark.parametrize(("change", "words"), [
    ({"backbone": "a,f,zeta\n0,80,0.1\n2,79.9,0.2\n3,79.8,0.4\n"}, "amplitude must be positive, row 1 has 0"),
    ({"backbone": "a,f,zeta\n1,80,0.1\n3,79.9,0.2\n2,79.8,0.4\n"}, "the amplitude falls at row 3"),
    ({"backbone": "a,f,zeta\n1,80,0.1\n2,nan,0.2\n3,79.8,0.4\n"}, "frequency, row 2: no number"),
    ({"backbone": "a,f,zeta\n1,80,0.1\n2,79.9,0.2\n"}, "2 points tell no trend"),
    ({"backbone": "a,f,zeta\n2,80,0.1\n2,79.9,0.2\n2,79.8,0.4\n"}, "1 points tell no trend"),
    ({"backbone": "a,f,zeta\n1,80,1\n2,79.9,200\n3,79,3\n"}, "damping must be a ratio from 0 to 1"),
    ({"backbone": "a,f,zeta\n1,80,0.1\n2,79.9,-0.2\n3,79,3\n"}, "damping must not be negative, row 2 has -0.002"),
    ({"backbone": "a,g,zeta\n1,80,0.1\n2,79.9,0.2\n3,79.8,0.4\n"}, "has no column 'f'"),
    ({"backbone": "a,f,zeta\n1,80,0\n2,79.9,0\n3,79.8,0\n"}, "damping holds only zeros; leave it out"),
    ({"of": "nose"}, "'nose' is no output of the structure; it has tip, end"),
    ({"unit": "N"}, "backbone.amplitude.unit: 'N' is no unit like m or m/s or m/s^2"),
    ({"unit": ""}, "backbone.amplitude.unit: is required"),
])
def test_a_bad_backbone_is_told_in_one_line(folder, change, words):
    with pytest.raises(FretflowError) as caught:
        read_structure_recording(folder(**change))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damping_in_per_cent_without_its_unit_is_told(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('column = "zeta", unit = "%"', 'column = "zeta"')
    with pytest.raises(FretflowError, match=r"damping\.unit: is required, as the smallest damping, 0\.1, is above"):
        read_structure_recording(folder(text))


def test_less_damping_than_that_without_the_joint_is_noted(folder):
    recording = read_structure_recording(folder(backbone="a,f,zeta\n1,80,0.001\n2,79.9,0.2\n3,79.8,0.4\n"))
    assert any("to which friction adds" in str(note) for note in recording.notes)


def test_an_angular_frequency_is_read_in_hz(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace(
        'column = "f", unit = "Hz", sd = "0.01 Hz"', 'column = "f", unit = "rad/s"')
    backbone = read_structure_recording(folder(text)).backbone
    assert backbone.frequency == pytest.approx(np.array([80.0, 79.9, 79.8]) / (2.0 * np.pi))


def test_an_error_of_an_angular_frequency_is_read_in_hz_too(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace(
        'column = "f", unit = "Hz", sd = "0.01 Hz"', 'column = "f", unit = "rad/s", sd = "0.5 rad/s"')
    assert read_structure_recording(folder(text)).backbone.frequency_sd == pytest.approx(0.5 / (2.0 * np.pi))


def test_a_frequency_that_no_contact_can_give_its_mode_is_told(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('amplitude_of = "tip"', 'amplitude_of = "tip"\nmode = 1')
    experiment = StructureExperiment.of(read_structure_recording(folder(text)))
    glued = np.sqrt(experiment.structure.eigenvalues[0]) / (2.0 * np.pi)
    for share, told in ((0.99, None), (1.005, "0.5 % beyond .* matched to the parts"), (1.1, "10 % beyond .* unit")):
        points = replace(experiment.points, frequency=np.full(3, share * glued))
        said = outside_of_mode(replace(experiment, points=points))
        assert re.search(told, said[0]) if told else not said


def test_a_stiffness_in_other_units_is_told_before_anything_is_fitted(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('amplitude_of = "tip"', 'amplitude_of = "tip"\nmode = 1')
    made = folder(text)
    arrays = dict(np.load(made / "structure.npz"))
    np.savez(made / "structure.npz", **{**arrays, "K": 1e-3 * arrays["K"]})
    with pytest.raises(FretflowError, match=r"80 Hz is not that of mode 1, .* those of M and K"):
        StructureExperiment.of(read_structure_recording(made))


def with_oscillator(path, frequency):
    """Add to a recording's structure an oscillator apart from it, which no output sees."""
    held = dict(np.load(path / "structure.npz"))
    for name, corner in (("M", 1.0), ("K", (2.0 * np.pi * frequency)**2)):
        held[name] = block_diag(held[name], corner)
    for name in ("contact_map", "preload", *(one for one in held if one.startswith("outputs"))):
        held[name] = np.concatenate([held[name], np.zeros((*held[name].shape[:-1], 1))], axis=-1)
    np.savez(path / "structure.npz", **held)
    return read_structure_recording(path)


@pytest.mark.parametrize("mode", ["", "mode = 1"])
def test_a_mode_that_the_output_does_not_see_is_not_the_recorded_one(folder, mode):
    path = folder(TOML.format(of="tip", unit="m/s^2").replace('amplitude_of = "tip"', f'amplitude_of = "tip"\n{mode}'))
    recording = with_oscillator(path, 80.0)
    if mode:
        with pytest.raises(FretflowError, match="mode 1 does not move 'tip'"):
            StructureExperiment.of(recording)
    else:
        assert StructureExperiment.of(recording).mode == 1


def test_no_other_mode_is_taken_that_cannot_have_the_recorded_frequency(folder):
    path = folder()
    glued = np.sqrt(StructureExperiment.of(read_structure_recording(path)).structure.eigenvalues[0]) / (2.0 * np.pi)
    own = 1.2 * glued
    (path / "backbone.csv").write_text(f"a,f,zeta\n1,{own},0.1\n2,{0.999 * own},0.2\n3,{0.998 * own},0.4\n")
    with pytest.raises(FretflowError, match="mode 2, which does not move 'tip', and that of mode 1"):
        StructureExperiment.of(with_oscillator(path, own))


def test_discrepancies_have_a_size_where_steps_of_load_change_nothing(folder):
    text = TOML.format(of="tip", unit="mm/s^2").replace("0.01 Hz", "1e-7 Hz")
    own = StructureExperiment.of(read_structure_recording(folder(
        text, backbone="a,f,zeta\n1,80.0,0.1\n2,60,0.2\n3,40,0.4\n"))).measurement
    assert size_prior(code_size(own)).sum() == pytest.approx(1.0)


def test_amplitudes_that_repeat_are_one_point(folder):
    recording = read_structure_recording(folder(backbone="a,f,zeta\n1,80,0.1\n2,79.9,0.2\n2,79.7,0.2\n3,79.8,0.4\n"))
    points = BackbonePoints.of(recording.backbone)
    assert points.amplitude == pytest.approx([1.0, 2.0, 3.0])
    assert points.frequency == pytest.approx([80.0, 79.8, 79.8])


def test_bad_points_count_less_and_a_smooth_difference_does_not():
    rng = np.random.default_rng(11)
    place, sd = np.linspace(0.0, 3.0, 24), np.full(24, 0.02)
    bend = 0.2 * (place / 3.0)**3  # ten times the noise at its end
    for missed in (sd * rng.standard_normal(24), bend + sd * rng.standard_normal(24)):
        assert np.median(weights_of(place, missed, sd)) > 0.9
        assert np.min(weights_of(place, missed, sd)) > 0.3
        missed[[0, -1]] += [0.3, -0.3]  # of fifteen times the noise
        assert np.max(weights_of(place, missed, sd)[[0, -1]]) < 0.02
        assert np.median(weights_of(place, missed, sd)[1:-1]) > 0.8


def test_errors_wider_than_neighbours_tell_are_told_by_what_is_missed():
    rng = np.random.default_rng(12)
    place, sd = np.linspace(0.0, 3.0, 24), np.full(24, 0.01)
    left = []
    for _ in range(10):
        missed = 2.0 * sd * rng.standard_normal(24)
        left.append(np.mean(np.square(missed / sd) * weights_of(place, missed, sd)))
    assert 0.6 < np.mean(left) < 1.4


@pytest.mark.parametrize(("old", "new", "words"), [
    ('matrices = "structure.npz"', "", "give one of matrices"),
    ('matrices = "structure.npz"', 'matrices = "none.npz"', "none.npz: there is no such file"),
    ("friction_coefficient = 0.6", 'friction_coefficient = "much"', "'much' is no number"),
    ("friction_coefficient = 0.6", "friction_coefficient = -1.0", "structure.friction_coefficient"),
    ('["2 kN", "20 kN"]', '["20 kN", "2 kN"]', "the lower end must be positive and below the upper one"),
    ('["2 kN", "20 kN"]', "[2, 20]", "structure.unknown.bolt_load"),
    ("[structure.unknown]", "[structure.unknown]\nfriction_coefficient = [0.1, 0.2]", "both a value and"),
    ('kind = "structure"', 'kind = "structure"\nspeed = 3', "unknown key"),
    ('high = "1 %"', 'high = 1.0', "structure.unknown.modal_damping: is a range of damping ratios below 1"),
    ('level = "5 um"', 'level = "5 N"', "frf.level"),
    ('level = "5 um"', 'level = "-5 um"', "frf.level: must be positive, got '-5 um'"),
    ('control = "response"', 'control = "none"', "frf.0.control"),
    ("[ring_down]", "[ring_down]\nextra = 3", "ring_down: each key but file is a table"),
    ('format = "fretflow-recording/1"', 'format = "x"', "format: must be"),
])
def test_a_bad_key_is_named(folder, old, new, words):
    text = TOML.format(of="tip", unit="m/s^2")
    assert old in text
    with pytest.raises(FretflowError) as caught:
        read_structure_recording(folder(text.replace(old, new)))
    assert words in str(caught.value)


@pytest.mark.parametrize(("file", "content", "words"), [
    ("frf.csv", "f,F,x,phi\n-79,100,5,10\n80,50,5,90\n", "frf: frequency must be positive, row 1 has -79"),
    ("frf.csv", "f,F,x,phi\n79,-100,5,10\n80,50,5,90\n", "frf: force must be positive, row 1 has -0.1"),
    ("frf.csv", "f,F,x,phi\n79,100,5,10\n80,50,-5,90\n", "frf: amplitude must be positive, row 2 has -5e-06"),
    ("ring.csv", "t,acc\n0,1\n", "ring.csv: ring_down: 1 samples are no decay"),
])
def test_bad_rows_of_responses_and_decays_are_named(folder, file, content, words):
    (path := folder()).joinpath(file).write_text(content)
    with pytest.raises(FretflowError) as caught:
        read_structure_recording(path)
    assert words in str(caught.value)


def test_a_decay_without_a_period_is_told_in_one_line(folder):
    head, _, decay = TOML.format(of="tip", unit="m/s^2").partition("[ring_down]")
    recording = read_structure_recording(folder(head.partition("[backbone]")[0] + "[ring_down]" + decay))
    with pytest.raises(FretflowError, match="ring_down: samples every"):
        StructureExperiment.of(recording)


def test_friction_that_no_joint_has_is_noted(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace("friction_coefficient = 0.6", "friction_coefficient = 60")
    assert any("friction_coefficient = 60 is beyond what joints have (0.02 to 3)" in str(note)
               for note in read_structure_recording(folder(text)).notes)


BAD_STRUCTURES = {
    "a mass that is not definite": ({"M": lambda m: -m}, "M: is not positive definite"),
    "a stiffness that is not definite": ({"K": lambda k: -k}, "K: "),
    "bolts that pull the faces apart": ({"preload": lambda p: -p}, "preload: the bolts' forces find no path"),
    "bolts that do not pull": ({"preload": lambda p: 0.0 * p}, "preload: the bolts' forces find no path"),
    "interfaces that face the wrong way": ({"contact_map": lambda q: q * np.tile([1, 1, -1], len(q) // 3)[:, None]},
                                           "signs of the normal rows|check their signs"),
    "a frequency in mHz": ({"backbone": lambda text: text.replace("80.0", "80000").replace("79.", "79900")},
                           "backbone.frequency: 8e[+]04 Hz is none of the structure's"),
}


@pytest.mark.parametrize("name", BAD_STRUCTURES)
def test_a_structure_that_cannot_be_is_told_in_one_line(folder, name):
    changes, words = BAD_STRUCTURES[name]
    made = folder(backbone=changes.get("backbone", str)(BACKBONE))
    arrays = dict(np.load(made / "structure.npz"))
    np.savez(made / "structure.npz", **{key: changes.get(key, np.asarray)(value) for key, value in arrays.items()})
    with pytest.raises(FretflowError, match=words) as caught:
        StructureExperiment.of(read_structure_recording(made)).first_prediction()
    assert "\n" not in str(caught.value)
    assert str(made) in str(caught.value)


def test_a_recording_without_a_title_has_its_folders_name(folder, monkeypatch):
    """It was "." of a folder in which one stands."""
    text = TOML.format(of="tip", unit="m/s^2").replace('title = "a beam"', "")
    monkeypatch.chdir(made := folder(text))
    assert read_structure_recording(Path()).title == made.name


def test_a_value_beyond_what_the_recording_states_is_told(folder):
    made = [Estimate(name="structure.bolt_load", value=50e3, low=38e3, high=67e3, unit="N"),
            Estimate(name="structure.modal_damping", value=2e-3, low=1e-3, high=3e-3, unit="1"),
            Estimate(name="contact-stiffness.exponent", value=0.3, low=0.2, high=0.4, unit="1")]
    assert beyond_stated(read_structure_recording(folder()), made) == [
        "structure.bolt_load = 50 kN lies beyond the stated 2 kN to 20 kN"]


def test_damping_in_per_cent_without_its_unit_is_told_where_the_rest_of_the_damping_is_known(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('column = "zeta", unit = "%"', 'column = "zeta"').replace(
        'modal_damping = { low = 1e-4, high = "1 %" }', "").replace("[structure.unknown]", "modal_damping = 5e-4\n"
                                                                    "[structure.unknown]")
    with pytest.raises(FretflowError, match=r'backbone.damping.unit: is required.* write "%"'):
        read_structure_recording(folder(text))


@pytest.mark.parametrize("sd", ["0.01", '"0.01"', '"0.01 %"'])
def test_the_sd_of_a_column_in_per_cent_is_in_per_cent(folder, sd):
    text = TOML.format(of="tip", unit="m/s^2").replace('"zeta", unit = "%"', f'"zeta", unit = "%", sd = {sd}')
    assert read_structure_recording(folder(text)).backbone.damping_sd == pytest.approx(1e-4)


@pytest.mark.parametrize(("heading", "refused"), [
    ("zeta 1", False), ("zeta_1", False), ("zeta [1]", True), ("zeta in 1", True), ("zeta (%)", False)])
def test_the_end_of_a_heading_is_a_unit_where_it_is_set_apart(folder, heading, refused):
    text = TOML.format(of="tip", unit="m/s^2").replace('"zeta"', f'"{heading}"')
    made = folder(text, backbone=BACKBONE.replace("zeta", heading))
    if refused:
        with pytest.raises(FretflowError, match="says '1' of column"):
            read_structure_recording(made)
    else:
        assert read_structure_recording(made).backbone.damping[0] == pytest.approx(1e-3)


def test_an_amplitude_of_another_dimension_in_a_name_is_a_name(folder):
    text = TOML.format(of="tip", unit="m/s^2").replace('"a"', '"a_m"')
    assert read_structure_recording(folder(text, backbone="a_m" + BACKBONE[1:])).backbone.amplitude[0] == 1.0
    text = TOML.format(of="tip", unit="m/s^2").replace('"f", unit = "Hz", sd', '"f_kHz", unit = "Hz", sd')
    with pytest.raises(FretflowError, match="says 'kHz' of column f_kHz"):
        read_structure_recording(folder(text, backbone=BACKBONE.replace("f", "f_kHz")))
    for heading, said in (("a m/s", "m/s"), ("a_mm", "mm")):  # of another dimension, and no part of a name
        text = TOML.format(of="tip", unit="m/s^2").replace('"a"', f'"{heading}"')
        with pytest.raises(FretflowError, match=f"says '{said}' of column"):
            read_structure_recording(folder(text, backbone=heading + BACKBONE[1:]))


def test_a_response_is_driven_where_it_is_observed(folder):
    text = TOML.format(of="tip", unit="m/s^2")
    assert read_structure_recording(folder(text.replace('level', 'at = "end"\nlevel'))).responses[0].at == "end"
    with pytest.raises(FretflowError, match=r"frf.at: 'rear' is no input or output of the structure; it has tip, end"):
        read_structure_recording(folder(text.replace('level', 'at = "rear"\nlevel')))


def resonant(frequency, level=1.0, of=80.0, damping=0.005):
    """Return the amplitude of a linear oscillator under a force of `level`, and the response as it is read."""
    amplitude = level / np.hypot(of**2 - frequency**2, 2.0 * damping * of * frequency)
    return ControlledResponse(control=Control.FORCE, of="tip", at=None, level=level, frequency=frequency,
                              force=np.full(len(frequency), level), amplitude=amplitude, amplitude_unit="m", phase=None)


def test_a_response_is_read_alike_whatever_the_order_of_its_rows_and_however_often_each_stands():
    frequency = np.linspace(78.0, 82.0, 41)
    plain = resonance(in_order(resonant(frequency)))
    assert plain[1] == pytest.approx(80.0 * np.sqrt(1.0 - 2.0 * 0.005**2), abs=2e-3)
    shuffled = np.random.default_rng(3).permutation(np.repeat(frequency, 2))
    assert resonance(in_order(resonant(shuffled))) == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize(("low", "high", "rows"), [
    (60.0, 75.0, 31), (81.0, 90.0, 31), (79.0, 81.0, 2), (80.0, 80.0, 1)])
def test_a_response_that_ends_before_its_resonance_tells_none(low, high, rows):
    one = in_order(resonant(np.linspace(low, high, rows)))
    with pytest.raises(FretflowError, match="no largest amplitude within its frequencies"):
        resonance(one)
    with pytest.raises(FretflowError, match=r"least value|do not tell a resonance"):
        oscillator(one)


def test_a_decay_is_read_down_to_the_noise_that_it_ends_in():
    """A linear decay by 0.5 % at 80 Hz in white noise, by its closed form."""
    time = np.arange(0.0, 10.0, 1.0 / 2000.0)
    decay = np.exp(-0.005 * 2.0 * np.pi * 80.0 * time) * np.cos(2.0 * np.pi * 80.0 * time)
    clean = instantaneous_mode(time[:4000], decay[:4000], 80.0)
    assert above_noise(clean) == len(clean.amplitude)
    noisy = instantaneous_mode(time, decay + 1e-3 * np.random.default_rng(7).standard_normal(len(time)), 80.0)
    told = above_noise(noisy)
    assert 5 < told < 0.5 * len(noisy.amplitude)
    assert np.median(noisy.damping[:told]) == pytest.approx(0.005, rel=0.02)
    assert noisy.frequency[:told] == pytest.approx(80.0, rel=0.01)
    assert np.abs(noisy.frequency[told:] / 80.0 - 1.0).max() > 0.02  # what is left out is none of its motion
