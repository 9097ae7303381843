"""The report as text: everything that a diagnosis holds is there, escaped and drawn where the numbers say.

What carries the weight: the curves' points, turned back by the axes' scales as a reader would, are the record's
numbers; and a page holds nothing that would be fetched.
"""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import report_cases
from fretflow.inference.verdict import Estimate, Place, Remainder, Verdict
from fretflow.inference.words import probability
from fretflow_post import style
from fretflow_post.report import charts, render_report, write_report
from matplotlib.colors import to_rgb

VOID = {"meta", "link", "input", "br", "img"}


@pytest.fixture
def cases():
    return report_cases


class Page(HTMLParser):
    """A page taken apart: elements with their attributes, and its text; unbalanced elements are an error."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.words = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join("".join(self.words).split())

    @property
    def sections(self):
        return [a["id"] for tag, a in self.elements if tag == "section"]

    def charts(self, words):
        return [a for _, a in self.elements if a.get("class") == "chart" and words in a["aria-label"]]


@pytest.fixture(autouse=True)
def _charts_alone(request, monkeypatch):
    """Leave out the pictures that stand for charts where no script runs: slow ones, with a test of their own."""
    if "stills" not in request.node.name:
        monkeypatch.setattr("fretflow_post.report.FIGURES", {})


def page_of(diagnosis):
    return Page(render_report(diagnosis))


def curves(cases, text, description):
    """Return the curves (name: (2, N)) of the first chart so described, in its axes' units."""
    return {name: np.array([one["x"], one["y"]]) for name, one in cases.drawn(text, description).items() if "x" in one}


def test_curves_lie_where_the_numbers_say(cases):
    diagnosis = cases.named()
    text = render_report(diagnosis)
    one = diagnosis.comparisons[3]
    drawn = curves(cases, text, f"{one.label}: friction force over")
    for name, x, force in (("measured", one.displacement, one.force),
                           ("before", one.before_displacement, one.before_force),
                           ("after", one.after_displacement, one.after_force)):
        assert drawn[name].shape == (2, cases.SAMPLES + 1)
        assert drawn[name][0, :-1] == pytest.approx(x * 1e6, rel=1e-6, abs=1e-6)
        assert drawn[name][1, :-1] == pytest.approx(force, rel=1e-6, abs=1e-6)
        assert np.array_equal(drawn[name][:, 0], drawn[name][:, -1]), "a loop is closed"


def test_differences_are_measured_minus_predicted(cases):
    diagnosis = cases.named()
    one = diagnosis.comparisons[0]
    drawn = curves(cases, render_report(diagnosis),
                   "friction force, measured − predicted (N), over the share of the period")
    assert drawn["before"][1] == pytest.approx(one.force - one.before_force, abs=1e-5)
    assert drawn["after"][1] == pytest.approx(one.force - one.after_force, abs=1e-5)
    assert drawn["after"][0] == pytest.approx(np.arange(cases.SAMPLES) / cases.SAMPLES, abs=1e-6)


def test_missing_samples_leave_gaps_in_their_places(cases):
    diagnosis = cases.odd()
    drawn = curves(cases, render_report(diagnosis), "friction force, measured − predicted (N)")
    assert np.array_equal(np.isnan(drawn["before"][1]), np.isnan(diagnosis.comparisons[0].force))


def test_a_channel_that_is_given_has_no_difference(cases):
    text = render_report(cases.named("imposed-displacement"))
    assert "friction force, measured − predicted" in text
    assert "relative displacement, measured − predicted" not in text
    text = render_report(cases.named("lumped"))
    assert "displacement over time" in text
    assert "force over time" not in text


def test_a_long_record_is_thinned_to_its_extremes(cases):
    """Every fifth sample of a ringing of five samples would be a line that stays where it is."""
    diagnosis = cases.named("lumped")
    one = diagnosis.comparisons[0]
    ringing = one.displacement + 2e-3 * np.sin(0.4 * np.pi * np.arange(len(one.time)))
    diagnosis = replace(diagnosis, comparisons=(replace(one, displacement=ringing), *diagnosis.comparisons[1:]))
    drawn = curves(cases, render_report(diagnosis), "displacement over time")["measured"]
    assert drawn.shape[1] <= 600
    assert np.all(np.diff(drawn[0]) >= 0.0)
    for begin in np.arange(0.5, 5.0, 0.5):
        own = drawn[:, np.abs(drawn[0] - begin) < 0.1]
        rings = own[1] - np.interp(own[0], one.time, one.displacement) * 1e3
        assert np.ptp(rings) == pytest.approx(4.0 * np.sin(0.4 * np.pi), abs=0.3)


def test_samples_stand_beside_the_harmonics_that_are_compared(cases):
    diagnosis = cases.named()
    assert '"every sample"' not in render_report(diagnosis).partition("<main>")[2].partition("<script>")[0]
    one = diagnosis.comparisons[0]
    ringing = one.force + 30.0 * np.sin(20.0 * np.pi * np.arange(cases.SAMPLES) / cases.SAMPLES)
    text = render_report(replace(diagnosis, comparisons=(
        replace(one, raw_displacement=one.displacement, raw_force=ringing), *diagnosis.comparisons[1:])))
    raw = curves(cases, text, f"{one.label}: friction force over")["every sample"][1]
    assert raw[:-1] == pytest.approx(ringing, rel=1e-6)
    assert "every sample" in Page(text).text


@pytest.mark.parametrize("maker", ["named", "none"])
def test_the_map_says_what_is_left(maker, cases):
    """A coloured map stood under "no missing physics" without a word of how much it was."""
    diagnosis = replace(getattr(cases, maker)(), remainder=Remainder(share=0.05, times_noise=5.84, where=""))
    text = render_report(diagnosis)
    assert "What the model of the verdict leaves is 5.84 times the noise and errors of calibration and simul" in text
    assert "far from 1, a pattern is none of them; near 1, a faint pattern that loops share may be such an" in text


def test_loops_that_are_compared_and_not_drawn_are_told(cases):
    diagnosis = cases.named()
    assert "loops are drawn, all" not in render_report(diagnosis)
    few = replace(diagnosis, comparisons=diagnosis.comparisons[:4])
    assert (f"4 of {len(diagnosis.comparisons)} loops are drawn, all that are held out among them; all are "
            "compared") in render_report(few)


def test_differences_before_and_after_have_one_unit(cases):
    """They stood as 0.15 µm and 80 nm in one sentence."""
    diagnosis = cases.named()
    for before, after, told in ((1.5e-7, 8e-8, "0.150 µm before, 0.0800 µm after"),
                                (8e-8, 5e-8, "80.0 nm before, 50.0 nm after")):
        first = replace(diagnosis.comparisons[0], before_displacement=diagnosis.comparisons[0].displacement + before,
                        after_displacement=diagnosis.comparisons[0].displacement + after)
        text = page_of(replace(diagnosis, comparisons=(first,))).text.replace("\xa0", " ")
        assert f"relative displacement {told}" in text


def test_maps_share_one_scale_of_colours_and_keep_their_values(cases):
    diagnosis = cases.named()
    page = page_of(diagnosis)
    largest = np.quantile(np.abs(np.concatenate([m.before.ravel() for m in diagnosis.residual_maps])), 0.99)
    limit = style.round_scale(largest)[0]
    assert f"full from {limit:g} standard deviations on" in page.text
    text = render_report(diagnosis)
    for one in diagnosis.residual_maps:
        for when, values in (("before", one.before), ("after", one.after)):
            rows = next(v for v in cases.drawn(text, f"{one.channel} {when}: difference").values() if "image" in v)
            assert np.vstack(rows["image"]) == pytest.approx(values, rel=1e-6)
            assert rows["told"] == list(one.rows)
            assert np.all(np.diff(rows["y"]) < 0.0), "the first row is on top"
    scale = re.findall(r'"palette":(\[[^]]*\]),"nan_color":[^}]*?,"low":([^,]*),"high":([^,}]*)', text)
    assert {(low, high) for _, low, high in scale[:4]} == {(f"{-limit}", f"{limit}")}
    violet, orange = (to_rgb(json.loads(scale[0][0])[k]) for k in (40, 216))
    assert orange[0] > orange[2], "orange where more was measured"
    assert violet[2] > violet[0], "violet where less was measured"


def test_wear_maps_keep_depth_and_orientation(cases):
    diagnosis = cases.named()
    wear = diagnosis.wear_map
    wear = replace(wear, measured=1e-6 * (1.0 + wear.y / 1e-3 + 0.5 * wear.x / 1e-3))
    (picture,) = cases.drawn(render_report(replace(diagnosis, wear_map=wear)), "wear depth measured")[None]["image"]
    read = picture[::-1]
    assert read[0, 0] == pytest.approx(1.0 + 0.5 - 0.25, abs=0.02), "first row is on top, first column on the left"
    assert read[-1, -1] == pytest.approx(1.0 - 0.5 + 0.25, abs=0.02)
    assert read.mean() == pytest.approx(1.0, abs=0.02)


def test_even_wear_is_drawn_on_colours_that_begin_above_zero(cases):
    diagnosis = cases.named()
    assert "The colours begin" not in page_of(diagnosis).text
    even = [9.3e-6 + 0.9e-6 * np.abs(diagnosis.wear_map.x) / 0.5e-3 * share for share in (1.0, 0.8, 0.9)]
    wear = replace(diagnosis.wear_map, measured=even[0], before=even[1], after=even[2])
    text = render_report(replace(diagnosis, wear_map=wear))
    assert "The colours begin at 9.30 µm, not at zero" in Page(text).text
    assert {*re.findall(r"sliding direction \(([^)]*)\)", text)} == {"mm"}  # of maps and profiles alike
    (picture,) = cases.drawn(text, "wear depth measured")[None]["image"]
    assert (picture.min(), picture.max()) == pytest.approx((9.3, 10.2), abs=0.02)


def test_where_nothing_is_missing_no_ranking_and_no_place_by_chance_is_shown(cases):
    diagnosis = cases.none()
    likely, rare = (Place(cut="phase", where=where, share=0.8, p_value=p)
                    for where, p in (("knee", 1.0), ("far", 0.01)))
    page = page_of(replace(diagnosis, ranking=(replace(cases.RANKING[0], effects=()),),
                           location=replace(diagnosis.location, places=(likely, rare))))
    assert "No ranking: explanations are compared only when something is missing" in page.text
    assert "nothing added (baseline)" not in page.text
    assert "knee" not in page.text
    assert "far" in page.text


@pytest.mark.parametrize(("p", "told"), [(1e-15, True), (0.5, False)])
def test_nothing_missing_beside_a_small_p_value_is_explained(cases, p, told):
    """Its null knows the errors of measurement alone, as of a motion that was smoothed."""
    diagnosis = cases.none()
    page = page_of(replace(diagnosis, detection=replace(diagnosis.detection, p_value=p)))
    assert ("errors of the model itself" in page.text) == told


def test_values_of_a_model_that_explains_little_are_no_parameters(cases):
    diagnosis = replace(cases.unknown(), parameters=cases.named().parameters)
    assert "of a model that does not explain the recording" in page_of(diagnosis).text
    assert "of a model that does not explain the recording" not in page_of(cases.named()).text


@pytest.mark.parametrize(("kind", "told"), [("fretting-rig", True), ("imposed-displacement", False)])
def test_a_length_has_the_range_of_a_rig_on_pages_of_rigs_alone(cases, kind, told):
    """A damper's play of some millimetres is no more implausible than its strokes."""
    play = Estimate(name="backlash.play", value=3.2e-3, low=2.9e-3, high=3.5e-3, unit="m")
    page = render_report(replace(cases.named(), kind=kind, parameters=(play,)))
    assert ('<svg class="range"' in page) == ("plausible 0.500 to 10.0 µm" in page) == told


def test_the_page_says_whose_a_plausible_range_is(cases, monkeypatch):
    monkeypatch.setenv("FRETFLOW_EFFECTS", str(Path(__file__).parents[2] / "examples" / "own_effects"))
    estimates = [Estimate(name=name, value=0.3, low=0.2, high=0.4, unit="") for name in (
        "friction-bump.height", "directional-friction.difference")]
    text = page_of(replace(cases.named(), parameters=tuple(estimates))).text
    assert "stated in friction_bump.py (friction-bump.height)" in text
    assert "1 mm², 100 Hz (directional-friction.difference)" in text


@pytest.mark.parametrize(("maker", "there", "absent"), [
    ("named", {"loops", "where", "parameters", "held-out", "wear", "next", "notes"}, {"law", "visible"}),
    ("none", {"loops", "where", "held-out", "visible"}, {"law", "next", "notes"}),
    ("ambiguous", {"loops", "where", "next"}, {"law", "visible"}),
    ("unknown", {"loops", "where", "law"}, {"parameters", "visible"}),
    ("empty", {"verdict", "sure", "origin"}, {"loops", "where", "parameters", "held-out", "wear", "law", "next"}),
])
def test_empty_sections_are_left_out_and_links_lead_somewhere(maker, there, absent, cases):
    page = page_of(getattr(cases, maker)())
    assert there <= set(page.sections)
    assert not absent & set(page.sections)
    links = [a["href"][1:] for tag, a in page.elements if tag == "a"]
    assert links == [name for name in page.sections if name != "verdict"]


@pytest.mark.parametrize("kind", ["fretting-rig", "imposed-displacement", "lumped"])
@pytest.mark.parametrize("maker", ["named", "none", "ambiguous", "unknown"])
def test_each_verdict_and_kind_says_what_it_is(maker, kind, cases):
    diagnosis = getattr(cases, maker)(kind)
    page = page_of(diagnosis)
    assert diagnosis.sentence in page.text
    assert all(name in page.text for name in diagnosis.effects)
    assert all(chart["aria-label"] for chart in page.charts(""))
    assert page.text.count("How to read it") >= 3
    held_out = sum(one.held_out for one in diagnosis.comparisons)
    assert page.text.count("held out") >= 2 * held_out


def test_why_a_probable_explanation_is_not_a_name(cases):
    page = page_of(cases.unknown())
    assert "explains 37 % of the difference: that something else acts is more probable" in page.text
    page = page_of(cases.named())
    assert f"explains {cases.RANKING[0].explained:.0%}".replace("%", " %") in page.text
    rest = 1.0 - sum(one.probability for one in cases.RANKING)
    assert f"something that the catalogue lacks {probability(rest)}" in " ".join(page.text.split())
    assert "is needed" not in page.text


@pytest.mark.parametrize(("before", "after", "floor", "words"), [
    (8.4, 1.06, 1.0, "7.9 times smaller. The error that is left is what repeats"),
    (8.4, 4.0, 1.0, "2.1 times smaller. The error that is left is 4 times what repeats"),
    (2.72, 2.56, 1.0, "the error is 6 % smaller. The error that is left is 2.6 times"),
    (377.0, 2.45, 1.0, "the error is 154 times smaller"),
    (2.0, 2.1, 1.0, "is not predicted better. The error that is left is 2.1 times"),
])
def test_the_held_out_fit_is_judged_against_repeats(before, after, floor, words, cases):
    fit = replace(cases.named().held_out, before=before, after=after, floor=floor)
    assert words in page_of(replace(cases.named(), held_out=fit)).text


def test_a_number_is_not_parted_from_its_unit_and_commands_are_set_as_such(cases):
    told = "it takes 20 % of 5.2 N/µm, as `fretflow loops` reads, in 3 pieces <b>"
    text = render_report(replace(cases.named(), notes=(told,)))
    assert "20\u00a0% of 5.2\u00a0N/µm, as <code>fretflow loops</code> reads, in 3 pieces &lt;b&gt;" in text


def test_a_channel_that_was_given_has_no_map(cases):
    diagnosis = cases.named()
    given = replace(diagnosis.residual_maps[0], channel="excitation", before=0.0 * diagnosis.residual_maps[0].before)
    assert "excitation</h3>" not in render_report(replace(diagnosis, residual_maps=(*diagnosis.residual_maps, given)))


def test_text_is_escaped_and_what_is_not_known_is_no_number(cases):
    diagnosis = cases.odd()
    text = render_report(diagnosis)
    page = Page(text)
    assert "<b>" not in text.partition("<style>")[2].partition("</style>")[2].partition(charts.script())[0]
    assert text.count("</script>") == text.count("<script")
    assert page.text.count(cases.NASTY) > 10
    assert not re.search(r"\b(nan|inf|None|NaN)\b", page.text)
    assert "nan" not in "".join(str(v) for _, a in page.elements for v in a.values() if not str(v).startswith("data:"))


def test_nothing_is_fetched(cases):
    for maker in (cases.named, cases.unknown, cases.odd):
        page = page_of(maker())
        assert not [a for tag, a in page.elements if tag == "script" and a not in ({}, {"type": "application/json"})]
        for _, attributes in page.elements:
            for name in ("src", "href", "data", "srcset"):
                assert attributes.get(name, "#").startswith(("#", "data:"))
        assert any("default-src 'none'" in a.get("content", "") for tag, a in page.elements if tag == "meta")


def test_stills_stand_where_no_script_runs(cases):
    """Every figure of the diagnosis is there as a picture, outside of what a script fills; all is under 5 MB."""
    text = render_report(cases.named())
    without = re.findall(r"<noscript>(.*?)</noscript>", text)
    assert [re.search(r'alt="(\w+)', one)[1] for one in without] == ["loops", "evolution", "maps", "wear"]
    assert all(one.startswith('<img class="figure" src="data:image/svg+xml;base64,') for one in without)
    assert len(text.encode()) < 5_000_000


def test_no_script_but_the_pages_own_runs(cases):
    """A browser runs what has one of the hashes in the page's policy, which are of its two scripts."""
    text = render_report(cases.named())
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    allowed = re.search(r"script-src ([^;]*)", policy)[1].split()
    own = [base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
           for code in re.findall(r"<script>(.*?)</script>", text, re.DOTALL)]
    assert allowed == [f"'sha256-{one}'" for one in own]
    assert "connect-src" not in policy
    assert "default-src 'none'" in policy


def test_the_rig_is_drawn_on_its_own_pages_alone(cases):
    assert 'alt="the two-mass rig with its specimens"' in render_report(cases.named())
    assert "two-mass rig" not in render_report(cases.named("lumped"))


def test_the_file_is_of_reasonable_size(cases, tmp_path):
    path = write_report(tmp_path / "report.html", cases.named())
    assert path.stat().st_size - len(charts.script().encode()) < 1_000_000
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_what_after_was_predicted_with_can_be_said(cases):
    assert "after: baseline + friction-run-in" in page_of(cases.named()).text
    assert "after: baseline + sensor-inertia, one of the set" in page_of(cases.ambiguous()).text
    diagnosis = replace(cases.unknown(), after_model="baseline + the law from the data")
    assert "after: baseline + the law from the data" in page_of(diagnosis).text
    assert "after:" not in page_of(replace(cases.none(), verdict=Verdict.NONE)).text


def test_fits_that_were_given_up_are_told_from_finished_ones(cases):
    page = page_of(cases.named())
    finished = sum(one.converged for one in cases.RANKING)
    assert page.text.count("fully") == finished
    assert page.text.count("given up early") == len(cases.RANKING) - finished + 1, "and once in the caption"
