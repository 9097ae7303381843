"""The scoreboard as one self-contained page: no script, no network."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

STYLE = """
:root{--ink:#1d2530;--soft:#5b6675;--line:#d9dee5;--good:#1f7a4d;--bad:#b3372f;--mark:#2f5f9e;--back:#fff}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#9aa5b4;--line:#38414d;--good:#5fc08f;--bad:#ef8078;
--mark:#7fb0ee;--back:#15191f}}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--back);max-width:68rem;margin:2rem auto;
padding:0 1rem}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin-top:2.2rem}p,figcaption{color:var(--soft)}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{padding:.3rem .7rem;text-align:left;
border-bottom:1px solid var(--line);white-space:nowrap}th{font-weight:600;color:var(--soft)}
.n{text-align:right!important;font-variant-numeric:tabular-nums}.met{color:var(--good)}.missed{color:var(--bad)}
svg{max-width:26rem;width:100%;height:auto}svg text{fill:var(--soft);font-size:11px}
figure{margin:0}code{font-size:.9em}
"""


def page(scores: Mapping[str, Any]) -> str:
    """Return the page of a trial's `scores`."""
    settings, facts = scores["settings"], scores["facts"]
    mode = "fast settings" if settings["fast"] else "full settings"
    told = "; ".join(f"{escape(name)} {escape(value)}" for name, value in facts.items())
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>Trial of {settings['cases']} concealed recordings</title><style>{STYLE}</style></head><body>",
        f"<h1>Trial of {settings['cases']} concealed recordings</h1>",
        f"<p>Seed {settings['seed']}, {mode}{'; ' + told if told else ''}. Answers were sealed before any diagnosis; "
        "salts and keys are in <code>keys/</code>.</p>",
        _targets(scores["targets"], "Targets, effects at signal-to-noise 10 or more",
                 "Signal-to-noise: root mean square of what an effect changes after the baseline is refitted, over the "
                 "noise of one sample, in the channel that shows it most; of a pair, that of the weaker effect."),
        _targets(scores["targets_distinct"], "Same scores, all effects 10 standard deviations apart or more",
                 "Here an effect counts if all samples together set it 10 standard deviations apart from the refitted "
                 "baseline, noise, offsets and scatter taken in: nearly every effect that can be seen at all."),
        "<h2>Stated and held probabilities</h2>", _diagram(scores["reliability_all"], scores["all"]),
        "<h2>By what was hidden</h2>", _by_kind(scores), "<h2>By effect</h2>", _by_effect(scores["by_effect"]),
        "<h2>By signal-to-noise</h2>", _by_signal(scores["by_signal"]), "<h2>Further figures, all cases</h2>",
        _further(scores["all"]), "<h2>Every case</h2>", _cases(scores["cases"]), "</body></html>\n"]
    return "\n".join(parts)


def _targets(targets: Sequence[Mapping[str, Any]], title: str, told: str) -> str:
    rows = []
    for one in targets:
        unknown = "too few cases" if one["cases"] else "no case"
        verdict = unknown if one["met"] is None else "met" if one["met"] else "missed"
        style = "" if one["met"] is None else verdict
        rows.append([escape(one["name"]), _n(one["value"]), _n(one["cases"], 0), escape(one["target"]),
                     f"<span class='{style}'>{verdict}</span>"])
    return f"<h2>{escape(title)}</h2><p>{escape(told)}</p>" + _table(
        ["score", "reached", "of", "target", ""], rows, numbers=(1, 2))


def _diagram(bins: Sequence[Mapping[str, Any]], scores: Mapping[str, Any]) -> str:
    """Return the reliability diagram: a dot a bin, its area by cases, with its 95 % interval."""
    marks = []
    for one in bins:
        if one["stated"] is None:
            continue
        x, y = 40 + 300 * one["stated"], 320 - 300 * one["held"]["value"]
        low, high = (320 - 300 * bound for bound in one["held"]["interval_95"])
        radius = 2.0 + 1.2 * math.sqrt(one["held"]["cases"])
        marks.append(f"<line x1='{x:.1f}' x2='{x:.1f}' y1='{low:.1f}' y2='{high:.1f}' stroke='var(--mark)'/>"
                     f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{radius:.1f}' fill='var(--mark)'>"
                     f"<title>{one['held']['hits']} of {one['held']['cases']}</title></circle>")
    ticks = "".join(f"<text x='{40 + 300 * t:.0f}' y='336' text-anchor='middle'>{t:g}</text>"
                    f"<text x='34' y='{324 - 300 * t:.0f}' text-anchor='end'>{t:g}</text>" for t in (0.0, 0.5, 1.0))
    error = _n(scores["calibration_error"]["value"])
    return ("<figure><svg viewBox='0 0 360 355' role='img' aria-label='reliability diagram'>"
            "<rect x='40' y='20' width='300' height='300' fill='none' stroke='var(--line)'/>"
            f"<line x1='40' y1='320' x2='340' y2='20' stroke='var(--line)'/>{''.join(marks)}{ticks}"
            "<text x='190' y='352' text-anchor='middle'>stated probability</text>"
            "<text x='46' y='34'>share that held</text></svg>"
            f"<figcaption>All cases; 95 % intervals. Expected calibration error {error}.</figcaption></figure>")


def _by_kind(scores: Mapping[str, Any]) -> str:
    words = {"nothing": "nothing", "single": "one effect", "pair": "two effects", "unlisted": "an unlisted effect"}
    verdicts = list(next(iter(scores["verdicts"].values())))
    rows = [[words[kind], *(_n(scores["verdicts"][kind][verdict], 0) for verdict in verdicts),
             _of(one["top_1"]), _of(one["set"]), _of(one["location"])] for kind, one in scores["by_kind"].items()]
    return _table(["hidden", *verdicts, "top-1 right", "set right", "located"], rows, numbers=range(1, 9))


def _by_effect(effects: Mapping[str, Any]) -> str:
    rows = [[escape(name), _of(one["top_1"]), _of(one["set"]), _of(one["strong"]), _of(one["location"]),
             _of(one["wrong_and_sure"])] for name, one in effects.items()]
    return _table(["effect", "top-1 right", "set right", "set right, signal 10 or more", "located", "wrong and sure"],
                  rows, numbers=range(1, 6))


def _by_signal(signals: Sequence[Mapping[str, Any]]) -> str:
    rows = [[f"{one['low']:g} to {one['high']:g}" if one["high"] else f"{one['low']:g} and more", _of(one["top_1"]),
             _of(one["set"]), _of(one["location"]), _of(one["wrong_and_sure"])] for one in signals]
    return _table(["signal-to-noise", "top-1 right", "set right", "located", "wrong and sure"], rows,
                  numbers=range(1, 5))


def _further(one: Mapping[str, Any]) -> str:
    rows = [["wrong names", _of(one["wrong_name"])], ["effects missed (verdict none)", _of(one["missed"])],
            ["diagnoses that failed", _of(one["failed"])],
            ["intervals that hold the truth, baseline's parameters included", _of(one["coverage_with_baseline"])],
            ["held-out error at most 1.1 times the floor", _of(one["held_out"]["at_most_1.1"])],
            ["held-out error before over after, median", _n(one["improvement"]["value"])],
            ["seconds a case, median", _n(one["seconds"]["value"])],
            ["seconds a case, longest", _n(one["seconds"]["longest"])]]
    return _table(["figure", ""], rows, numbers=(1,))


def _cases(cases: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for one in cases:
        style, word = ("met", "right") if one["right"] else ("missed", "wrong")
        said = escape(one["failure"] or ", ".join([one["verdict"], *one["effects"]]))
        rows.append([escape(one["case"]), escape(", ".join(one["hidden"]) or "nothing"), _n(one["signal_to_noise"]),
                     _n(one["total_signal_to_noise"]), said, _n(one["probability"]),
                     f"<span class='{style}'>{word}</span>", escape(one["block"]), _n(one["before"]), _n(one["after"]),
                     _n(one["floor"]), _n(one["seconds"], 0)])
    return _table(["case", "hidden", "signal", "apart, sd", "said", "probability", "verdict", "block", "before",
                   "after", "floor", "s"], rows, numbers=(2, 3, 5, 8, 9, 10, 11))


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    head = "".join(f"<th scope='col'{' class=n' if k in numbers else ''}>{escape(one)}</th>"
                   for k, one in enumerate(heads))
    body = "".join("<tr>" + "".join(f"<td{' class=n' if k in numbers else ''}>{cell}</td>"
                                    for k, cell in enumerate(row)) + "</tr>" for row in rows)
    return f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _n(value: float | None, digits: int = 3) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if digits == 0 else f"{value:.{digits}g}"


def _of(one: Mapping[str, Any]) -> str:
    return "–" if one["value"] is None else f"{100.0 * one['value']:.0f} % ({one['hits']}/{one['cases']})"
