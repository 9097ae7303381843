"""Case files: no bad input yields a case, and every refusal is one line that names the field.

What carries the weight: each impossible value is refused by its own field's name, and a case survives being
written and read again without losing a bit.
"""

import tomllib

import pytest
from fretflow.case.casefile import dump_case, entries, starting_case
from fretflow.case.config import Case, PeriodicMethod, Solver, load_case, slice_hash, validate_case
from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import catalogue
from hypothesis import given
from hypothesis import strategies as st


def raw(**changes):
    """Return a minimal valid case; ``test__cycles=5`` sets a key in a table, ``None`` removes it."""
    case = {"format": "fretflow-case/1", "name": "x", "test": {"excitation_amplitude": "53 N", "cycles": 100}}
    for path, value in changes.items():
        *tables, key = path.split("__")
        table = case
        for name in tables:
            table = table.setdefault(name, {})
        if value is None:
            del table[key]
        else:
            table[key] = value
    return case


BAD = [
    ({"contact__friction_coefficient": 0}, "contact.friction_coefficient"),
    ({"contact__friction_coefficient": -0.1}, "contact.friction_coefficient"),
    ({"contact__friction_coefficient": True}, "contact.friction_coefficient"),
    ({"contact__friction_coefficient": float("nan")}, "contact.friction_coefficient"),
    ({"rig__moving_mass": "0 kg"}, "rig.moving_mass"),
    ({"rig__arm_mass": "-1 kg"}, "rig.arm_mass"),
    ({"rig__out_of_phase_frequency": "41 Hz"}, "rig: out_of_phase_frequency"),
    ({"test__normal_load": "0 N"}, "test.normal_load"),
    ({"test__normal_load": "-60 N"}, "test.normal_load"),
    ({"test__normal_load": 60}, "test.normal_load"),
    ({"test__normal_load": "60"}, "test.normal_load"),
    ({"test__normal_load": "60 kg"}, "test.normal_load"),
    ({"test__normal_load": "60 blobs"}, "test.normal_load"),
    ({"test__excitation_frequency": "628 rad/s"}, "test.excitation_frequency"),
    ({"test__excitation_amplitude": None}, "test.excitation_amplitude"),
    ({"test": None}, "test"),
    ({"test": 5}, "test"),
    ({"test__cycles": None}, "test: give exactly one of cycles and duration"),
    ({"test__duration": "1 h"}, "test: give exactly one of cycles and duration"),
    ({"test__cycles": -1}, "test.cycles"),
    ({"test__cycles": 1.5}, "test.cycles"),
    ({"output__loop_cycles": 100}, "output.loop_cycles: must be several in brackets, got 100"),
    ({"test__cycles": 10**15 + 1}, "test.cycles"),
    ({"test__cycles": None, "test__duration": "1e20 s"}, "test: duration makes 1e+22 cycles; 1e+15 are the most"),
    ({"tset": {}}, "tset"),
    ({"contact__friction": 0.5}, "contact.friction"),
    ({"specimen__friction": 0.5}, "specimen.friction"),
    ({"specimen__upper__friction": 0.5}, "specimen.upper.friction"),
    ({"specimen__upper": 5}, "specimen.upper"),
    ({"specimen": 5}, "specimen"),
    ({"specimen__density": "8000 kg"}, "specimen.density"),
    ({"specimen__poissons_ratio": 0.5}, "specimen.poissons_ratio"),
    ({"specimen__face": "crowned"}, "specimen: face_radius"),
    ({"specimen__face_radius": "10 mm"}, "specimen: face_radius"),
    ({"specimen__face": "crowned", "specimen__face_radius": "0.9 mm"}, "specimen: face_radius"),
    ({"specimen__face": "crowned", "specimen__face_radius": "2 mm", "specimen__ridge_height": "0.1 mm"},
     "specimen: face_radius"),
    ({"specimen__contact_width": "7 mm"}, "specimen: contact_width"),
    ({"specimen__upper__contact_width": "2 mm"}, "specimen: contact_width must be the same"),
    ({"specimen__observation_distance": "20 mm"}, "specimen: observation_distance"),
    ({"solver__samples": 99}, "solver: samples = 99 is too few for 40 harmonics; at least 160"),
    ({"solver__method": "dlft", "solver__samples": 11}, "solver: samples = 11 is too few for 3 harmonics"),
    ({"solver__method": "magic"}, "solver.method"),
    ({"solver__penalty": "1e7 N/m"}, "solver: penalty"),
    ({"mesh__degree": 3}, "mesh.degree"),
    ({"mesh__upper": "a.msh"}, "mesh: give both"),
    ({"output__loop_cycles": [101]}, "output.loop_cycles goes beyond the 100 cycles"),
    ({"output__wear_map_cycles": [5, 3]}, "output.wear_map_cycles"),
    ({"output__frequency_response__stop": "10 Hz"}, "output.frequency_response: stop"),
    ({"name": "../elsewhere"}, "name"),
    ({"name": 101 * "x"}, "name"),
    ({"mesh__upper": "a\0b", "mesh__lower": "b"}, "mesh.upper"),
    ({"format": "fretflow-case/2"}, "format"),
    ({"format": None}, "format"),
]


@pytest.mark.parametrize(
    ("changes", "field"), BAD, ids=[f"{next(iter(c))}={next(iter(c.values()))}" for c, _ in BAD]
)
def test_bad_input_is_one_line_that_names_the_field(changes, field):
    with pytest.raises(ConfigError) as caught:
        validate_case(raw(**changes), source="case.toml")
    message = str(caught.value)
    assert message.startswith(f"case.toml: {field}")
    assert "\n" not in message
    assert (
        "(and " not in message
    )  # a single mistake counts once, also in a table that holds for both specimens


@pytest.mark.parametrize(("changes", "line"), [
    ({"contact__friction_coefficient": -0.1}, "contact.friction_coefficient: must be greater than 0, got -0.1"),
    ({"test__cycles": 1.5}, "test.cycles: must be a whole number, got 1.5"),
    ({"output__loop_cycles": 100}, "output.loop_cycles: must be several in brackets, got 100"),
    ({"test__cycles": "many"}, "test.cycles: must be a number without quotes, got 'many'"),
    ({"specimen__face": "bumpy"}, "specimen.face: must be 'flat', 'crowned' or 'cylindrical', got 'bumpy'"),
    ({"measured__sliding_distance": "-5 um"}, "measured.sliding_distance: must be positive, got '-5 um'"),
    ({"effects": ["viscous"]}, "effects: must be a table of keys; `fretflow init` writes a file with them"),
    ({"mesh__degree": [1]}, "mesh.degree: must be 1 or 2")])
def test_what_is_wanted_and_what_was_given_stand_in_the_line(changes, line):
    with pytest.raises(ConfigError) as caught:
        validate_case(raw(**changes), source="case.toml")
    assert str(caught.value) == f"case.toml: {line}"


def test_several_mistakes_are_counted():
    with pytest.raises(ConfigError, match=r"rig\.moving_mass: .* \(and 1 more\)$"):
        validate_case(raw(rig__moving_mass="0 kg", contact__friction_coefficient=-1))


def test_values_are_si_floats_whatever_unit_they_came_in():
    case = validate_case(raw(test__cycles=None, test__duration="5.5 h", test__normal_load="0.06 kN",
                             wear__coefficient="1.1e-8 mm^3/(N*mm)", specimen__youngs_modulus="193 GPa"))
    assert case.test.normal_load == pytest.approx(60.0, rel=1e-15)
    assert case.test.total_cycles == 1_980_000
    assert case.wear.coefficient == pytest.approx(1.1e-14, rel=1e-14)
    assert case.specimen.lower.youngs_modulus == pytest.approx(193e9, rel=1e-15)


def test_specimen_keys_hold_for_both_sides_and_a_side_overrides():
    case = validate_case(raw(specimen__density="7000 kg/m^3", specimen__lower__density="2700 kg/m^3"))
    assert (case.specimen.upper.density, case.specimen.lower.density) == (7000.0, 2700.0)


def test_each_method_has_its_own_defaults():
    paper = Solver(method=PeriodicMethod.DLFT)
    assert (paper.resolved_harmonics, paper.resolved_samples) == (3, 128)
    assert (Solver().resolved_harmonics, Solver().resolved_samples) == (40, 256)
    assert Solver(method=PeriodicMethod.DLFT, harmonics=7).resolved_harmonics == 7


@given(load=st.floats(1e-3, 1e9), width=st.floats(1e-6, 4e-3), cycles=st.integers(0, 10**12),
       damping=st.floats(0.0, 0.99))
def test_a_written_case_reads_back_to_the_bit(load, width, cycles, damping):
    case = validate_case(raw(test__normal_load=f"{load!r} N", specimen__upper__contact_width=f"{width!r} m",
                             specimen__lower__contact_width=f"{width!r} m", test__cycles=cycles,
                             rig__damping_ratio=damping, solver__method="dlft", solver__penalty="3 N/um",
                             specimen__face="cylindrical", specimen__face_radius="1 m", title='a "b" µ'))
    assert validate_case(tomllib.loads(dump_case(case))) == case


def test_large_numbers_are_written_as_they_are_typed():
    written = dump_case(validate_case(raw(test__cycles=150_000)))
    assert "cycles = 150_000\n" in written
    assert "100_000" in [entry.toml for entry in entries(catalogue()["third-body"]()) if entry.key == "residence"]


def test_the_file_to_start_from_is_valid_and_shows_every_key(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(starting_case())
    case = load_case(path)
    assert case.test.excitation_amplitude == 53.0
    known = {entry.key for entry in entries(case)}
    shown = {line.lstrip("# ").split()[0] for line in starting_case().splitlines() if "  # " in line}
    assert known == shown


def test_its_commented_defaults_are_the_defaults(tmp_path):
    lines = [line.removeprefix("# ") if " = " in line else line for line in starting_case().splitlines()]
    path = tmp_path / "case.toml"
    path.write_text("\n".join(lines))
    everything = load_case(path)
    path.write_text(starting_case())
    assert slice_hash(everything) == slice_hash(load_case(path))


def test_every_key_has_a_meaning_and_every_float_field_a_unit_or_none_by_intent():
    case = validate_case(raw())
    for entry in entries(case):
        assert entry.meaning, entry.key
    plain = {entry.key for entry in entries(case) if isinstance(entry.value, float) and not entry.unit}
    assert plain == {"damping_ratio", "poissons_ratio", "growth", "friction_coefficient", "tolerance",
                     "upper_share", "vanishing_rate"}


def test_readable_values_use_engineering_units():
    shown = {entry.key: entry.readable for entry in entries(validate_case(raw(test__normal_load="0.25 N")))}
    assert shown["youngs_modulus"] == "193 GPa"
    assert shown["body_width"] == "6 mm"
    assert shown["normal_load"] == "250 mN"
    assert shown["harmonics"] == "40"
    assert shown["penalty"] == "not set"


def test_a_missing_or_broken_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read"):
        load_case(tmp_path / "absent.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(ConfigError, match=r"broken\.toml: not valid TOML"):
        load_case(broken)
    broken.write_bytes(b"name = '\xff'")
    with pytest.raises(ConfigError, match=r"broken\.toml: not valid TOML"):
        load_case(broken)


def test_own_meshes_count_from_the_case_file(tmp_path):
    path = tmp_path / "case.toml"
    own = 'format = "fretflow-case/1"\nname = "x"\n[test]\nexcitation_amplitude = "1 N"\ncycles = 1\n' \
          '[mesh]\nupper = "u.msh"\nlower = "l.msh"\n'
    path.write_text(own)
    (tmp_path / "u.msh").touch()
    with pytest.raises(ConfigError, match=r"mesh\.lower: there is no .*l\.msh"):
        load_case(path)
    (tmp_path / "l.msh").mkdir()
    with pytest.raises(ConfigError, match=r"mesh\.lower: .*l\.msh is a folder; name a file"):
        load_case(path)
    (tmp_path / "l.msh").rmdir()
    (tmp_path / "l.msh").touch()
    assert load_case(path).mesh.lower == tmp_path / "l.msh"


def test_hashes_tell_cases_apart_and_refuse_what_has_no_stable_text():
    case = validate_case(raw())
    assert slice_hash(case) == slice_hash(validate_case(raw()))
    assert slice_hash(case.contact) != slice_hash(
        validate_case(raw(contact__friction_coefficient=0.8800001)).contact
    )
    with pytest.raises(TypeError, match="no stable text"):
        slice_hash(object())


def test_a_case_never_changes():
    case = validate_case(raw())
    with pytest.raises(ValueError, match="frozen"):
        case.name = "y"
    assert isinstance(case, Case)
