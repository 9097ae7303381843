"""The diagnosis of a wear series: whether one coefficient explains the worn volumes, else which effect does.

The baseline is Archard's law in its energy form with the coefficient refitted. What it leaves is tested against powers
of the conditions, a smooth curve through all columns, and repeats; laws of the catalogue compete for it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fretflow.effects.volume_law import CYCLES, UNITS
from fretflow.experiments.wear_series import words
from fretflow.experiments.wear_series.data import Array, Ids, WearData, tests_of_detection, wear_data
from fretflow.experiments.wear_series.laws import Law, LawFit
from fretflow.experiments.wear_series.search import (
    SIGNIFICANT,
    Effects,
    Progress,
    Search,
    alternatives,
    estimates,
    folds_in_words,
    held_out,
    ranking,
    search,
)
from fretflow.inference.verdict import (
    EXPLAINED_GATE,
    Candidate,
    Detection,
    Diagnosis,
    HeldOut,
    Location,
    Place,
    ResidualLaw,
    Verdict,
    WearTests,
)
from fretflow.inference.words import after_model
from fretflow.recordings.wear_series import KIND, WearSeries

FALSE_ALARMS = SIGNIFICANT
GATE_WIDTH = 0.05  # of the explained share, over which the catalogue's claim fades
VISIBLE = 4.0  # standard deviations at which an effect would have been seen
PARTS, LAW_BINS = 3, 6  # of the range of a condition


@dataclass(frozen=True)
class _Found:
    """What the search came to."""

    verdict: Verdict
    sets: tuple[Effects, ...]  # that explain as well as each other, the best first
    ranking: tuple[Candidate, ...]
    after: LawFit
    errors: tuple[float, float]  # of what is held out, before and after

    @property
    def effects(self) -> Effects:
        """Return all effects that the verdict names."""
        if self.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
            return ()
        return tuple(sorted({name for own in self.sets for name in own}))


def diagnose_wear_series(series: WearSeries, fast: bool, progress: Progress) -> Diagnosis:
    """Return what the worn volumes of a series show that one wear coefficient leaves out.

    Raises
    ------
    RecordingError
        If the series has too few conditions.
    """
    began = time.monotonic()
    data = wear_data(series)
    progress(0.2, "tests of one coefficient")
    tests = tests_of_detection(data)
    name = min(tests, key=lambda key: tests[key], default="")
    detection = Detection(p_value=min(1.0, len(tests) * tests[name]) if name else 1.0, statistic=name, tests=tests,
                          false_alarm_rate=FALSE_ALARMS)
    looked = search(data, not fast, lambda share, text: progress(0.2 + 0.6 * share, text))
    progress(0.8, "what is held out")
    found = _found(looked, detection)
    progress(0.95, "parameters and pictures")
    unknown = found.verdict is Verdict.UNKNOWN
    law = _residual_law(looked) if unknown else None
    parameters = estimates(looked, looked.baseline if unknown else found.after)
    view = _view(data, looked.baseline, found)
    share = looked.explained(found.after)
    return Diagnosis(
        title=series.title, recording=str(series.path), kind=KIND, verdict=found.verdict, effects=found.effects,
        probability=_probability(looked, found, detection), ranking=found.ranking,
        sentence=words.sentence(found.verdict, found.effects, found.after.law, share, (view.r2_before, view.r2_after),
                                law),
        detection=detection, location=_location(looked, found.verdict), parameters=parameters,
        held_out=HeldOut(what=folds_in_words(data), before=found.errors[0], after=found.errors[1], floor=1.0),
        separating_measurement=words.separating(found.sets, looked, found.after, law),
        smallest_visible=_visible(looked) if found.verdict is Verdict.NONE else {}, residual_law=law, wear_tests=view,
        notes=words.warnings(looked, found.after, found.verdict, parameters),
        case_file=words.case_text(series.title, found.after, parameters) if found.effects else "",
        after_model=after_model(found.verdict, found.after.law.effects),
        seconds=time.monotonic() - began, fast=fast)


def _found(looked: Search, detection: Detection) -> _Found:
    ranked, data = ranking(looked), looked.data
    before = held_out(data, Law())
    if detection.p_value >= FALSE_ALARMS:
        return _Found(Verdict.NONE, (), ranked, looked.baseline, (before, before))
    sets = alternatives(looked, ranked)
    best = sets[0] if sets else next((one.effects for one in ranked if one.effects), ())
    after = looked.fits[best][0]
    behind = held_out(data, after.law)
    if not sets or not behind < before:
        return _Found(Verdict.UNKNOWN, (), ranked, after, (before, behind))
    return _Found(Verdict.AMBIGUOUS if len(sets) > 1 else Verdict.NAMED, sets, ranked, after, (before, behind))


def _probability(looked: Search, found: _Found, detection: Detection) -> float:
    """Return the probability of the verdict: of its sets among all, if the catalogue holds the cause at all."""
    if found.verdict is Verdict.NONE:
        p = detection.p_value
        odds = 1.0 / (-np.e * p * np.log(p)) if 0.0 < p < 1.0 / np.e else 1.0
        return float(1.0 / (1.0 + odds * FALSE_ALARMS / (1.0 - FALSE_ALARMS)))
    best = looked.explained(found.after)
    listed = float(1.0 / (1.0 + np.exp(-(best - EXPLAINED_GATE) / GATE_WIDTH)))
    if found.verdict is Verdict.UNKNOWN:
        return 1.0 - listed
    return listed * float(sum(one.probability for one in found.ranking if one.effects in found.sets))


def _view(data: WearData, before: LawFit, found: _Found) -> WearTests:
    tests = data.tests
    old, new = before.predict(tests), found.after.predict(tests)
    return WearTests(rows=data.series.rows, measured=tests.volume, before=old, after=new,
                     r2_before=_r2(data, old), r2_after=_r2(data, new))


def _r2(data: WearData, model: Array) -> float:
    """Return the share of the worn volumes' variance that a law explains; a test that stands twice counts once."""
    volume, weight = data.tests.volume, data.tests.weight
    mean = np.average(volume, weights=weight)
    return float(1.0 - weight @ (volume - model)**2 / (weight @ (volume - mean)**2))


def _location(looked: Search, verdict: Verdict) -> Location:
    data = looked.data
    cycles = data.tests.states.get(CYCLES, np.zeros(1))
    places = _places(looked) if verdict is not Verdict.NONE else []
    if not places:
        return Location(block="", channel="", phase="", zone="", cycles=(0, 0))
    first = min(places, key=lambda one: (one.p_value, -one.share))
    return Location(block="wear law", channel="worn volume", phase="", zone="", condition=first.where,
                    cycles=(int(cycles.min()), int(cycles.max())), places=tuple(places),
                    text=f"One coefficient parts from the worn volumes most at {first.where}.")


def _conditions(data: WearData) -> dict[str, Array]:
    """Return all recorded conditions that vary, known ones by their names."""
    own = {name: data.tests.states[name] for name in data.varied}
    return own | {name: x for name, x in data.series.further.items() if np.isfinite(x).all() and np.ptp(x) > 0.0}


def _places(looked: Search) -> list[Place]:
    """Return the ranges of each condition in which the mean of what is left is not zero."""
    data, tests = looked.data, looked.data.tests
    model = looked.baseline.predict(tests)
    left = tests.residual(model)
    groups = [(name, x[own], own) for name, x in _conditions(data).items() for own in _split(x, PARTS)]
    free = max(data.pure_freedom, tests.count - data.curve.shape[1])
    found = []
    for name, x, own in groups:
        weight = tests.weight[own]
        mean, ratio = np.average(left[own], weights=weight), weight @ tests.volume[own] / (weight @ model[own])
        square = float(mean**2 * weight.sum())
        p = 2.0 * float(stats.t.sf(np.sqrt(square) / data.sd, free))
        found.append(Place(
            cut="condition", where=f"{words.within(name, float(x.min()), float(x.max()))}, with {ratio:.2g} times the "
                                   "wear that it predicts",
            share=float(np.clip((square - data.sd**2) / max(looked.excess, 1e-300), 0.0, 1.0)),
            p_value=min(1.0, p * len(groups))))
    return found


def _split(x: Array, parts: int) -> list[Ids]:
    """Return the indices of tests in at most `parts` ranges of a condition, about as many in each."""
    values = np.unique(x)
    if len(values) <= parts:
        return [np.flatnonzero(x == value) for value in values]
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, parts + 1)[1:-1], method="nearest"))
    place = np.searchsorted(edges, x, side="left")
    return [np.flatnonzero(place == k) for k in np.unique(place)]


def _residual_law(looked: Search) -> ResidualLaw | None:
    """Return wear over the baseline's against the condition that tells most of it; bins pay for what they fit."""
    data, tests = looked.data, looked.data.tests
    model = looked.baseline.predict(tests)
    left, ratio = tests.residual(model), tests.volume / model - 1.0
    best: ResidualLaw | None = None
    for name, x in _conditions(data).items():
        groups = _split(x, LAW_BINS)
        inside = sum(float(tests.weight[own] @ (left[own] - np.average(left[own], weights=tests.weight[own]))**2)
                     for own in groups)
        gain = looked.baseline.square - inside - (len(groups) - 1) * data.sd**2
        explained = float(np.clip(gain / max(looked.excess, 1e-300), 0.0, 1.0))
        if best is not None and explained <= best.explained:
            continue
        at, mean = (np.array([np.average(v[own], weights=tests.weight[own]) for own in groups]) for v in (x, ratio))
        sd = np.array([data.sd / tests.scale / np.sqrt(tests.weight[own].sum()) for own in groups])
        best = ResidualLaw(channel="worn volume over the law's", state=name, state_unit=UNITS.get(name, "1"),
                           channel_unit="1", x=at, y=mean, sd=sd, explained=explained)
    return best


def _visible(looked: Search) -> dict[str, float]:
    """Return the smallest size of each effect that would have been seen, over its largest plausible one."""
    return {fits[0].law.effects[0]: min(_smallest(looked, one.law) for one in fits)
            for effects, fits in looked.fits.items() if len(effects) == 1}


def _smallest(looked: Search, law: Law) -> float:
    """Return what is seen over the largest plausible size, from the change by the effect at its largest."""
    tests, base = looked.data.tests, looked.baseline
    root = np.sqrt(tests.weight)
    plain = base.predict(tests)
    most = law.inner([own.high for own in law.parameters])
    change = root * (tests.transformed(law.predict(tests, np.r_[base.value, most])) - tests.transformed(plain))
    absorbed = root * (plain / tests.scale)**tests.power  # by the coefficient
    change -= absorbed * float(absorbed @ change) / float(absorbed @ absorbed)
    return float(VISIBLE * looked.data.sd / max(float(np.linalg.norm(change)), 1e-300))
