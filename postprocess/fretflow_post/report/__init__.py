"""The report of a diagnosis: one page of HTML that needs nothing else, neither files nor a network."""

from __future__ import annotations

import base64
import datetime
import hashlib
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fretflow.core.provenance import commit, versions
from fretflow.core.store import write_whole
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Effect
from fretflow.inference import words
from fretflow.inference.verdict import Candidate, Diagnosis, Estimate, HeldOut, Place, Verdict
from fretflow.recordings.kinds import kinds
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from fretflow_post.diagnosed import FIGURES, drawn_parameters
from fretflow_post.report.charts import LOOKS, figure_image, script, svg_image
from fretflow_post.report.loops import curve_views, evolution_views, loop_views
from fretflow_post.report.maps import PlausibleRange, law_view, map_views, plausible_range, tests_view
from fretflow_post.report.wear import wear_views

PAGE = Path(__file__).parent / "page"
MOST_RANKED, MOST_PLACES = 8, 10  # shown at once; the rest unfolds
AS_GOOD_AS_REPEATED = 1.1  # times the repeatability floor


def write_report(path: Path, diagnosis: Diagnosis) -> Path:
    """Write the page about `diagnosis` to `path`.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    write_whole(path, render_report(diagnosis).encode())
    return path


def render_report(diagnosis: Diagnosis) -> str:
    """Return the page about `diagnosis`."""
    loops = loop_views(diagnosis)
    with_after = loops.with_after or diagnosis.verdict is Verdict.NAMED
    content = {
        "d": diagnosis, "words": words, "verdict": diagnosis.verdict.value,
        "headline": words.headline(diagnosis),
        "kind": kinds()[diagnosis.kind].words if diagnosis.kind in kinds() else diagnosis.kind,
        "with_after": with_after,
        "tiles": tuple(_tiles(diagnosis)), "physics": tuple(_physics(diagnosis)), "sure": _how_sure(diagnosis),
        "ranking": _split(_ranking(diagnosis), MOST_RANKED), "loops": loops,
        "evolution": evolution_views(diagnosis, with_after), "stills": dict(_stills(diagnosis)),
        "maps": map_views(diagnosis),
        "after_words": words.after_words(diagnosis),
        "places": _split(_places(diagnosis), MOST_PLACES),
        "where": tuple(_where(diagnosis)),
        "parameters": tuple(_row(one, diagnosis.kind) for one in diagnosis.parameters),
        "fit": None if diagnosis.held_out is None else _fit(diagnosis.held_out, with_after),
        "wear": wear_views(diagnosis.wear_map, with_after), "law": law_view(diagnosis.residual_law),
        "tests": tests_view(diagnosis.wear_tests, diagnosis.verdict is not Verdict.NONE),
        "curves": curve_views(diagnosis.curves, diagnosis.verdict is not Verdict.NONE),
        "visible": tuple(sorted(diagnosis.smallest_visible.items(), key=lambda item: _last_if_unknown(item[1]))),
        "made": datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"), "versions": versions(),
        "commit": commit(),
    }
    return _environment().get_template("report.html.j2").render(content)


class _Script:
    """A script of the page, and its hash, by which a browser runs it and no other."""

    def __init__(self, text: str) -> None:
        self.text = Markup(text)
        self.hash = Markup("'sha256-{}'").format(base64.b64encode(hashlib.sha256(text.encode()).digest()).decode())


@cache
def _environment() -> Environment:
    environment = Environment(loader=FileSystemLoader(PAGE), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    environment.filters["prose"] = _prose
    css, js = ((PAGE / f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    environment.globals["css"] = Markup(css)
    environment.globals["rig"] = svg_image((PAGE / "rig.svg").read_bytes(), "the two-mass rig with its specimens")
    environment.globals["scripts"] = [_Script(text) for text in (
        'document.documentElement.classList.add("live");', f"{script()}\nconst LOOKS = {json.dumps(LOOKS)};\n{js}")]
    return environment


def _prose(text: str) -> Markup:
    """Return a sentence with no line break between a number and its unit, and what is typed set as such."""
    kept = re.sub(r"(?<=\d) (?=(?:%|[kMGmnµ]?(?:N|Pa|Hz|J|m|s|g))(?![\w²³]))", "\u00a0", text)
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(kept))))


def _stills(d: Diagnosis) -> Iterator[tuple[str, Markup]]:
    """Return each figure as a picture: the parameters in pairs, and what stands for charts where no script runs."""
    for what, draw in FIGURES.items():
        if (what != "parameters" or len(drawn_parameters(d)) > 1) and (figure := draw(d)) is not None:
            yield what, figure_image(figure, f"{what} of this diagnosis")


def _split(items: tuple[object, ...], most: int) -> tuple[tuple[object, ...], tuple[object, ...]]:
    """Return the items that are shown at once, and the rest; no rest of one or two."""
    return (items, ()) if len(items) <= most + 2 else (items[:most], items[most:])


def _last_if_unknown(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _ranking(d: Diagnosis) -> tuple[Candidate, ...]:
    """Return the explanations that were compared; the baseline alone is compared with nothing."""
    return d.ranking if any(one.effects for one in d.ranking) else ()


def _places(d: Diagnosis) -> tuple[Place, ...]:
    """Return the places of the difference, the least probable by chance first; where nothing is missing, no others."""
    rare = d.detection.false_alarm_rate
    return tuple(sorted((place for place in d.location.places if d.verdict is not Verdict.NONE or place.p_value < rare),
                        key=_place_order))


def _place_order(place: object) -> tuple[float, float]:
    p, share = getattr(place, "p_value", math.nan), getattr(place, "share", math.nan)
    return _last_if_unknown(p), -share if math.isfinite(share) else math.inf


@dataclass(frozen=True)
class Tile:
    """A figure under the verdict."""

    name: str
    value: str
    note: str


def _tiles(d: Diagnosis) -> Iterator[Tile]:
    best = _accepted(d)
    yield Tile("Probability", words.probability(d.probability), words.probability_of(d))
    if best is not None and d.verdict is not Verdict.NONE:
        what = "by the best of the catalogue" if d.verdict is Verdict.UNKNOWN else "of what the baseline leaves"
        yield Tile("Explained", words.percent(best.explained), what)
    if not d.faults:
        yield Tile("Errors of measurement alone", f"p = {words.p_value(d.detection.p_value)}".replace("= <", "<"),
                   "of a difference this large by them")
    if d.held_out is not None and math.isfinite(d.held_out.before):
        changed = d.verdict is not Verdict.NONE and math.isfinite(d.held_out.after)
        value = words.number(d.held_out.before) + (f" → {words.number(d.held_out.after)}" if changed else "")
        yield Tile("Held-out error", value, f"times the repeatability; floor {words.number(d.held_out.floor)}")


def _accepted(d: Diagnosis) -> Candidate | None:
    """Return the candidate that the verdict is about: the named one, else the most probable that adds something."""
    named = next((one for one in d.ranking if one.effects and set(one.effects) == set(d.effects)), None)
    return named or words.leading(d)


@dataclass(frozen=True)
class Physics:
    """What the catalogue says of an effect."""

    name: str
    kind: type[Effect]


def _physics(d: Diagnosis) -> Iterator[Physics]:
    known = catalogue()
    for name in d.effects:
        if name in known:
            yield Physics(name, known[name])


def _how_sure(d: Diagnosis) -> tuple[str, ...]:
    """Return why something, or nothing, is taken to be missing, and why it is or is not named."""
    if d.faults:
        return ("Before any model was fitted, the channels were held to the rig's equations of motion, which hold "
                "whatever the contact does. Once they are put right, diagnose the recording again.",)
    p, rate = words.p_value(d.detection.p_value), words.percent(d.detection.false_alarm_rate)
    test = f" ({d.detection.statistic})" if d.detection.statistic else ""
    refit = ("The baseline's own parameters were refitted first, so that a wrong friction coefficient is not taken "
             "for missing physics. What is left would be this large by errors of measurement alone with probability "
             f"p = {p}{test}. ")
    rule = f"The threshold raises a false alarm in {rate} of recordings from which nothing is missing."
    lines = [(refit + rule).replace("p = <", "p <")]
    best = _accepted(d)
    if d.verdict is Verdict.NONE and d.detection.p_value < d.detection.false_alarm_rate:
        lines.append("So they alone are not the reason; errors of the model itself, which the probability takes into "
                     "account, explain it better than any effect.")
    if best is None or d.verdict is Verdict.NONE:
        return tuple(lines)
    share = f"{words.together(best.effects)} explains {words.percent(best.explained)} of the difference"
    if d.verdict is Verdict.UNKNOWN:
        lines.append(f"Of the catalogue {share}: that something else acts is more probable than all that it holds.")
    elif d.verdict is Verdict.AMBIGUOUS:
        lines.append("The effects of the set act alike on what was measured, so this recording cannot tell them apart. "
                     f"Here {share}.")
    else:
        lines.append(f"Here {share}.")
    return tuple(lines)


def _where(d: Diagnosis) -> Iterator[tuple[str, str]]:
    place = d.location
    if d.verdict is Verdict.NONE:
        return
    cycles = words.cycles_words(place.cycles) if place.cycles[1] > 0 else ""
    for name, value in (("Block", place.block), ("Channel", place.channel), ("Loop phase", place.phase),
                        ("Cycles", cycles), ("Harmonic", place.harmonic), ("Parity", place.parity),
                        ("Condition", place.condition), ("Contact zone", place.zone)):
        if value:
            yield name, value


@dataclass(frozen=True)
class ParameterRow:
    """A parameter as the table shows it."""

    name: str
    full_name: str
    of: str
    meaning: str
    interval: words.Interval
    plausible: PlausibleRange | None


def _row(one: Estimate, recorded: str) -> ParameterRow:
    return ParameterRow(words.parameter_words(one.name), one.name, one.name.rpartition(".")[0], one.meaning,
                        words.interval(one), plausible_range(one, recorded))


@dataclass(frozen=True)
class HeldOutBars:
    """The held-out errors as bars, in shares of the longest, and what they mean."""

    what: str
    bars: tuple[tuple[str, str, float], ...]  # look, value, length
    floor: str
    floor_at: float
    text: str


def _fit(fit: HeldOut, after: bool) -> HeldOutBars | None:
    shown = [("before", fit.before)] + ([("after", fit.after)] if after else [])
    shown = [(look, value) for look, value in shown if math.isfinite(value)]
    if not shown:
        return None
    floor = fit.floor if math.isfinite(fit.floor) else 0.0
    longest = max(floor, *(value for _, value in shown)) or 1.0
    bars = tuple((look, words.number(value), value / longest) for look, value in shown)
    return HeldOutBars(fit.what, bars, words.number(fit.floor), floor / longest, _fit_text(dict(shown), floor))


def _fit_text(shown: dict[str, float], floor: float) -> str:
    left = shown.get("after", shown.get("before", math.nan))
    text = ""
    if "after" in shown and "before" in shown and shown["after"] > 0.0:
        ratio = shown["before"] / shown["after"]
        less = words.percent(1.0 - 1.0 / ratio) if ratio < 2.0 else _times(ratio)
        text = (f"On what was not used in the fit the error is {less} smaller. " if ratio >= 1.05 else
                "What was not used in the fit is not predicted better. ")
    if floor > 0.0:
        times = "" if left <= AS_GOOD_AS_REPEATED * floor else f"{_times(left / floor)} "
        text += f"The error that is left is {times}what repeats of the recording differ by."
    return text


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times" if ratio < 99.5 else f"{ratio:.0f} times"
