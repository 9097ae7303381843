"""How effects are found, read and described.

What carries the weight: a user's file in a folder takes part like any other, and what is wrong with a file, an id or a
parameter is said in one line that names it.
"""

import re
from pathlib import Path

import fretflow
import fretflow_meshes
import fretflow_post
import numpy as np
import pytest
from fretflow.cli.terminal import describe
from fretflow.core.errors import ConfigError, InputError
from fretflow.effects.catalogue import catalogue, parse_effects, tables
from fretflow.effects.effect import Effect
from fretflow.structure.driven import Sliders, driven_force
from fretflow.structure.motion import Motion

OWN = '''
from dataclasses import replace
from typing import ClassVar
import numpy as np
from fretflow.core import units as u
from fretflow.effects.effect import Block, Effect, Sketch, parameter


class Heavier(Effect):
    """A weight on the arm."""

    id: ClassVar[str] = "{id}"
    title: ClassVar[str] = "a weight on the arm"
    block: ClassVar[Block] = Block.CONTACT
    equation: ClassVar[str] = "N + W"
    source: ClassVar[str] = "the scales"
    observables: ClassVar[tuple[str, ...]] = ("normal force",)

    weight: u.SignedForce = parameter(5.0, "W: the weight", 1.0, 20.0, neutral=0.0)

    def period(self, problem, slow):
        return problem.vary(normal_load=problem.normal_load + self.weight)

    def sketch(self):
        return Sketch("weight in N", "load in N", {{"": (np.arange(3.0), np.arange(3.0))}})
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("FRETFLOW_EFFECTS", str(tmp_path))
    return tmp_path


def test_a_file_in_a_folder_takes_part(folder):
    (folder / "heavier.py").write_text(OWN.format(id="heavier"))
    assert "heavier" in catalogue()
    assert "friction-run-in" in catalogue()
    (effect,) = parse_effects({"heavier": {"weight": "7 N"}})
    assert effect.weight == 7.0
    assert tables([effect]) == {"heavier": {"weight": "7 N"}}
    assert catalogue()["heavier"].priors()["weight"].high == 20.0
    assert catalogue()["heavier"].priors()["weight"].source == "stated in heavier.py"
    assert "SS304" in catalogue()["viscous"].priors()["damping"].source


def test_a_parameter_that_is_taken_over_keeps_whose_range_it_has(folder):
    (folder / "mine.py").write_text("""
from fretflow.effects.viscous import Viscous as Theirs
from fretflow.effects.effect import parameter


class Mine(Theirs):
    id = "mine"
    more: float = parameter(1.0, "m: more", 0.5, 2.0)
""")
    priors = catalogue()["mine"].priors()
    assert priors["more"].source == "stated in mine.py"
    assert "SS304" in priors["damping"].source


def test_what_does_nothing_is_said_by_the_parameters(folder):
    (folder / "heavier.py").write_text(OWN.format(id="heavier"))
    assert catalogue()["heavier"].neutral().weight == 0.0
    (folder / "heavier.py").unlink()
    (folder / "unsaid.py").write_text(OWN.format(id="unsaid").replace(", neutral=0.0", ""))
    catalogue.__globals__["_collect"].cache_clear()
    with pytest.raises(InputError, match="effect unsaid: no parameter says with what it changes nothing"):
        catalogue()["unsaid"].neutral()


def test_an_id_may_come_once(folder):
    (folder / "mine.py").write_text(OWN.format(id="third-body"))
    with pytest.raises(InputError, match=r"mine\.py: effect 'third-body' is already that of .*third_body\.py"):
        catalogue()


def test_a_file_that_fails_is_named(folder):
    (folder / "broken.py").write_text("import nothing_of_that_name\n")
    with pytest.raises(InputError, match=r"broken\.py: ModuleNotFoundError: .*nothing_of_that_name"):
        catalogue()


def test_a_sheet_that_lacks_something_is_named(folder):
    text = "from fretflow.effects.effect import Effect\n\n\nclass Bare(Effect):\n    id = 'bare'\n"
    (folder / "bare.py").write_text(text)
    with pytest.raises(InputError, match=r"bare\.py: effect Bare lacks title, block, equation, source, observables"):
        catalogue()


def test_an_empty_folder_is_named(folder):
    with pytest.raises(InputError, match=r"FRETFLOW_EFFECTS: no \.py file in .*; name the folder of an effect's file"):
        catalogue()


@pytest.mark.parametrize(("old", "new", "words"), [
    ('    id: ', '    kinds = ("imposed-displacement",)\n    id: ', "effect 'heavier': kinds must be a set of kinds"),
    ("1.0, 20.0", "20.0, 1.0", r"'W: the weight': its range, 20\.0 to 1\.0, must rise")])
def test_a_sheet_that_says_what_cannot_be_is_named(folder, old, new, words):
    """No recording was of such kinds, so that the effect was never looked for; a range that falls fits nothing."""
    (folder / "heavier.py").write_text(OWN.format(id="heavier").replace(old, new))
    with pytest.raises(InputError, match=rf"heavier\.py: .*{words}"):
        catalogue()


def test_a_fault_in_a_user_s_file_is_told_with_its_line(folder):
    (folder / "heavier.py").write_text(OWN.format(id="heavier").replace("problem.vary", "problem.vari"))
    with pytest.raises(AttributeError) as caught:
        catalogue()["heavier"]().period(object(), None)
    assert re.match(r".*heavier\.py, line 22: AttributeError: ", describe(caught.value)[0])


@pytest.mark.parametrize("limits", [1.0, (1.0,), (np.ones(3), 1.0), (np.nan, 1.0)])
def test_limits_of_another_shape_than_two_factors_are_told(limits):
    class Odd(Effect):
        """Nothing."""

        id = "odd"

        def limit(self, motion):
            return limits

    moving = dict.fromkeys(("displacement", "velocity", "acceleration"), np.sin(np.arange(100.0)))
    motion = Motion(step=1e-3, **moving)
    with pytest.raises(InputError, match="effect odd: limit "):
        driven_force(motion, Sliders.one(1e6, 1.0), 0.0, (Odd(),))


@pytest.mark.parametrize(("table", "words"), [
    ({"thrid-body": {}}, r"effects\.thrid-body: there is no such effect; `fretflow effects` lists them; did you mean "
     r"third-body\?"),
    ({"oil-film": {}}, r"`fretflow effects` lists them; one of your own needs its folder in FRETFLOW_EFFECTS"),
    ({"third-body": {"retaind": 0.5}}, r"effects\.third-body\.retaind: unknown key"),
    ({"viscous": {"damping": "3 N"}}, r"effects\.viscous\.damping: '3 N' has the wrong dimension"),
    ({"viscous": {"damping": 3.0}}, r"effects\.viscous\.damping: 3\.0 is not text with a number and its unit"),
    ({"load-dependent-friction": {"exponent": 1.5}}, r"effects\.load-dependent-friction\.exponent: .*less than 1")])
def test_what_is_wrong_is_named(table, words):
    with pytest.raises(ConfigError, match=words):
        parse_effects(table, "my.toml")


def test_the_catalogue_holds_every_effect_that_was_asked_for():
    asked = """friction-run-in contact-stiffness contact-stiffness-evolution third-body velocity-dependent-friction
        load-dependent-friction directional-friction normal-load-coupling normal-load-drift scar-edge initial-gap
        wear-coefficient-evolution wear-threshold wear-power-law sensor-path-compliance sensor-inertia channel-delay
        sensor-drift excitation-distortion extra-mode parallel-stiffness viscous support-nonlinearity backlash
        coulomb-friction force-offset distributed-micro-slip joint-damping bolt-load-spread bending-gap
        oxygen-limited-wear""".split()
    assert set(asked) <= set(catalogue())


def test_no_id_stands_outside_the_effects_own_files():
    """What is said of an effect is said in its file: elsewhere no string is an id that only an effect can have."""
    ids = "|".join(name for name in catalogue() if "-" in name)
    quoted = re.compile(f"[\"']({ids})[\"'.]")
    for package in (fretflow, fretflow_meshes, fretflow_post):
        for file in Path(package.__file__).parent.rglob("*.py"):
            if "effects" not in file.parts:
                assert not quoted.findall(file.read_text()), file
    assert quoted.search((Path(fretflow.__file__).parent / "effects" / "third_body.py").read_text())


@pytest.mark.parametrize("kind", catalogue().values(), ids=list(catalogue()))
def test_the_equation_is_there_for_pages_that_set_it(kind):
    assert kind.formula
    assert kind.formula.isascii()
    assert kind.formula.count("{") == kind.formula.count("}")
    assert kind.formula.count(r"\left") == kind.formula.count(r"\right")
