"""The pages that are read without building the site: their links lead somewhere, and README stays short."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
TRIALS = sorted((PROJECT / "benchmarks").glob("*/trial.html"))
TWO_SCREENS = 80  # lines
MADE = "_made"  # written when the site is built, which checks them


@pytest.mark.parametrize("page", [page for page in PAGES if MADE not in page.parts], ids=lambda page: page.stem)
def test_links_lead_to_files(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    links = [link for link in targets if "://" not in link and MADE not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_readme_is_two_screens():
    assert len((PROJECT / "README.md").read_text(encoding="utf-8").splitlines()) <= TWO_SCREENS


def test_readme_names_every_command():
    from fretflow.cli import app

    rows = [row for row in (PROJECT / "README.md").read_text(encoding="utf-8").splitlines() if row.startswith("| `")]
    named = {word for row in rows for word in re.findall(r"`([a-z]+)", row.split("|")[1])}
    assert {name for name in app if not name.startswith("-")} <= named


def test_every_effect_says_on_its_page_what_would_confirm_it(monkeypatch):
    """What tells two effects apart is stated once for the pair, and stands on both pages."""
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from fretflow.effects.catalogue import catalogue
    from pages.effects import effect_page

    known = catalogue()
    pages = {name: effect_page(name, kind).partition("## What would confirm it\n")[2] for name, kind in known.items()}
    assert all(text.lstrip("\n").startswith(("- ", "The ")) for text in pages.values())
    pairs = [(name, other) for name, kind in known.items() for other in kind.told_from]
    assert pairs
    assert all(f"[{one}]({one}.md)" in pages[other] for pair in pairs for one, other in (pair, pair[::-1]))
    assert [name for name, text in pages.items() if f"from [{name}]({name}.md)" in text] == []


def test_what_an_effect_changes_a_little_is_drawn_beneath(monkeypatch, tmp_path):
    """A dashpot's loop is by a fiftieth another; axes of a picture are named `axes_1` and on."""
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from fretflow.effects.catalogue import catalogue
    from pages.effects import draw_picture

    for name, panels in (("viscous", 2), ("friction-run-in", 1)):
        draw_picture(catalogue()[name], tmp_path / f"{name}.svg")
        assert (tmp_path / f"{name}.svg").read_text(encoding="utf-8").count('id="axes_') == panels


def test_the_site_is_built_without_the_notes_of_libraries():
    """A style for code that the theme asks for opens the log, on its import, to notes as of animations."""
    pytest.importorskip("a11y_pygments")
    script = (f"import a11y_pygments, logging, runpy; runpy.run_path({str(PROJECT / 'docs' / 'conf.py')!r}); "
              "logging.getLogger('matplotlib.animation').info('x')")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""


def test_prose_has_units_and_large_numbers_as_they_are_printed():
    for page in PAGES:
        prose = re.sub(r"(?s)```.*?```|`[^`]*`|(?m:^    .*?$)", "", page.read_text(encoding="utf-8"))
        assert re.findall(r"\d um\b|\bm[23]/|[\d)]e\d|\d_\d", prose) == [], page


def test_numbers_of_tables_keep_their_units(monkeypatch):
    """A browser breaks lines at a space, at a slash and at the minus of a power."""
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from fretflow.effects.catalogue import catalogue
    from pages.effects import parameter_table
    from pages.verification import verification

    rows = parameter_table(catalogue()["contact-stiffness"]).splitlines()
    default, low, high = (f'<span class="unbroken">{size} N/µm</span>' for size in (60, 15, 150))
    assert rows[2].split(" | ")[1:3] == [default, f"{low} to {high}"]
    bounds = [row.split(" | ")[1].removesuffix(" |") for row in verification().splitlines() if row.startswith("| ")]
    assert '<span class="unbroken">1e-9 relative</span>' in bounds
    assert [bound for bound in bounds if re.search(r"e-0|^\d", bound)] == []


def test_names_of_tests_are_told_with_their_genitives(monkeypatch):
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from pages.verification import spoken

    test = ast.parse("def test_volume_is_the_energy_s_and_the_user_s(): pass").body[0]
    assert spoken(test) == "volume is the energy's and the user's"


@pytest.mark.parametrize("page", TRIALS, ids=lambda page: page.parent.name)
def test_trials_stay_as_they_came_out_but_for_their_looks(monkeypatch, page):
    """On phones the tables of earlier trials showed names without figures."""
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from pages.verification import dressed

    before = page.read_text(encoding="utf-8")
    after = dressed(before)
    assert "@media(max-width" in after.partition("</style>")[0]
    assert after.partition("</style>")[2] == before.partition("</style>")[2]


def test_tables_of_keys_tell_what_a_key_takes(monkeypatch):
    monkeypatch.syspath_prepend(PROJECT / "docs")
    pytest.importorskip("sphinx")
    from pages.keys import bolted_keys, case_keys, recording_keys, structure_keys

    def takes(text, table):
        rows = text.partition(f"### `{table}`\n")[2].partition("\n###")[0].splitlines()
        return {row.split("`")[1]: row.split(" | ")[1] for row in rows if row.startswith("| `")}

    assert takes(case_keys(), "[output]")["figures"] == "texts in brackets"
    assert takes(case_keys(), "[output]")["loop_cycles"] == "whole numbers in brackets"
    assert takes(bolted_keys(), "[structure.sensors.NAME]") == {
        "at": 'three texts as `"1 m"` in brackets', "along": "three numbers in brackets"}
    assert takes(bolted_keys(), "[response]")["forces"] == 'texts as `"1 N"` in brackets'
    assert takes(structure_keys(), "[structure.unknown]")["bolt_load"] == 'two texts as `"1 N"` in brackets'
    assert takes(structure_keys(), "[structure]")["bolt_load"] == 'text as `"1 N"`'
    assert "| name of each channel | a channel |" in recording_keys()
    assert "`channels`" not in recording_keys()  # a file that has this key is refused
    for keys in (case_keys(), bolted_keys(), recording_keys(), structure_keys()):
        assert [row for row in keys.splitlines() if row.endswith("|  |")] == []  # a key without a meaning
