"""The scores of a trial: shares with intervals, calibration, coverage; tests compute each definition by hand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from fretflow_trial.answers import (
    AMBIGUOUS,
    FAILED,
    NAMED,
    NONE,
    UNKNOWN,
    Answer,
    Key,
    both_found,
    covered,
    located,
    set_right,
    top_right,
    verdict_right,
    wrong_name,
)

STRONG = 10.0  # signal-to-noise from which the targets hold
SURE = 0.9
BINS = 10
SIGNAL_EDGES = (0.0, 1.0, 3.0, 10.0, 30.0, math.inf)
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Result:
    """One case: its name, the truth and the answer."""

    name: str
    key: Key
    answer: Answer


@dataclass(frozen=True)
class Share:
    """`hits` of `cases`."""

    hits: int
    cases: int

    @property
    def value(self) -> float | None:
        """Return the share, None of no case."""
        return self.hits / self.cases if self.cases else None

    def interval(self) -> tuple[float, float] | None:
        """Return Wilson's 95 % interval (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212)."""
        if not self.cases:
            return None
        z2, p = NORMAL_95**2 / self.cases, self.hits / self.cases
        middle = (p + 0.5 * z2) / (1.0 + z2)
        half = math.sqrt(p * (1.0 - p) * z2 + 0.25 * z2**2) / (1.0 + z2)
        return max(middle - half, 0.0), min(middle + half, 1.0)

    def to_json(self) -> dict[str, Any]:
        """Return the share as JSON."""
        return {"value": self.value, "hits": self.hits, "cases": self.cases, "interval_95": self.interval()}


@dataclass(frozen=True)
class Bin:
    """Stated probabilities within one tenth, and how often they held."""

    low: float
    high: float
    stated: float | None  # mean
    held: Share


def share(results: Iterable[Result], right: Callable[[Answer, Key], bool]) -> Share:
    """Return how many of `results` are `right`."""
    hits = [right(one.answer, one.key) for one in results]
    return Share(sum(hits), len(hits))


def reliability(events: Sequence[tuple[float, bool]], bins: int = BINS) -> tuple[Bin, ...]:
    """Return stated probabilities against what held, in bins of equal width; 1 belongs to the last."""
    members: list[list[tuple[float, bool]]] = [[] for _ in range(bins)]
    for stated, held in events:
        members[min(int(stated * bins), bins - 1)].append((stated, held))
    return tuple(Bin(k / bins, (k + 1) / bins, sum(p for p, _ in part) / len(part) if part else None,
                     Share(sum(held for _, held in part), len(part))) for k, part in enumerate(members))


def expected_calibration_error(events: Sequence[tuple[float, bool]], bins: int = BINS) -> float | None:
    """Return the mean over all events of the distance of stated to held in their bin.

    M. P. Naeini, G. F. Cooper, M. Hauskrecht, AAAI 29 (2015) 2901-2907.
    """
    if not events:
        return None
    parts = [one for one in reliability(events, bins) if one.stated is not None]
    return sum(abs(one.held.hits - one.held.cases * (one.stated or 0.0)) for one in parts) / len(events)


def calibration_by_chance(events: Sequence[tuple[float, bool]], draws: int = 400) -> float | None:
    """Return the mean calibration error if every stated probability were right: what so few events show by chance."""
    if not events:
        return None
    stated = np.array([one for one, _ in events])
    held = np.random.default_rng(0).random((draws, len(stated))) < stated
    return float(np.mean([expected_calibration_error(list(zip(stated, row, strict=True))) or 0.0 for row in held]))


def median_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % interval of the median from the order statistics, None where so few values give none.

    The number of values under the median is binomial with 1/2 (W. J. Conover, Practical Nonparametric Statistics,
    3rd ed. (1999), section 3.2).
    """
    count, ordered, tail = len(values), sorted(values), 0.0
    for rank in range(count // 2 + 1):
        tail += math.comb(count, rank) / 2**count
        if tail > 0.025:
            return (ordered[rank - 1], ordered[count - rank]) if rank else None
    return None


def strong(result: Result) -> bool:
    """Return whether all that is hidden stands out of the noise of a sample; true where nothing is hidden."""
    return result.key.signal >= STRONG


def distinct(result: Result) -> bool:
    """Return whether all that is hidden is far from the baseline by all samples together; true where nothing is."""
    return result.key.total_signal >= STRONG


def scoreboard(results: Sequence[Result]) -> dict[str, Any]:
    """Return all scores of a trial as JSON."""
    loud = [one for one in results if strong(one)]
    return {
        "targets": targets(loud, results),
        "targets_distinct": targets([one for one in results if distinct(one)], results),
        "by_world": {str(world): targets([one for one in loud if one.key.world == world],
                                         [one for one in results if one.key.world == world])
                     for world in sorted({one.key.world for one in results})},
        "all": _scores(results),
        "strong": _scores(loud),
        "by_effect": _by_effect(results),
        "by_signal": _by_signal(results),
        "by_kind": {kind: _accuracy([one for one in results if one.key.kind == kind])
                    for kind in ("nothing", "single", "pair", "unlisted")},
        "reliability": [{"low": one.low, "high": one.high, "stated": one.stated, "held": one.held.to_json()}
                        for one in reliability(_events(loud))],
        "reliability_all": [{"low": one.low, "high": one.high, "stated": one.stated, "held": one.held.to_json()}
                            for one in reliability(_events(results))],
        "verdicts": {kind: {verdict: sum(one.key.kind == kind and one.answer.verdict == verdict for one in results)
                            for verdict in (NONE, NAMED, AMBIGUOUS, UNKNOWN, FAILED)}
                     for kind in ("nothing", "single", "pair", "unlisted")},
        "cases": [_line(one) for one in results],
    }


def _within(share: Mapping[str, Any], low: float, high: float) -> bool | None:
    """Return whether a share lies in a range; None where so few cases could lie in it all the same."""
    if share["value"] is None or low <= share["value"] <= high:
        return None if share["value"] is None else True
    below, above = share["interval_95"]
    return None if below <= high and low <= above else False


def targets(loud: Sequence[Result], everything: Sequence[Result]) -> list[dict[str, Any]]:
    """Return each target, what was reached, within which 95 % interval, and whether that meets it (None: no case).

    A calibration error has no interval but what chance alone would show: one no larger than that misses nothing.

    All are of the cases `loud`, at signal-to-noise 10 or more, but for the last, which is of `everything`.
    """
    scores, quiet = _scores(loud), _scores(everything)

    def at_least(name: str, key: str, least: float) -> dict[str, Any]:
        value = scores[key]["value"]
        return {"name": name, "value": value, "cases": scores[key]["cases"], "target": f"at least {least:g}",
                "interval_95": scores[key]["interval_95"], "by_chance": None,
                "met": None if value is None else value >= least}

    def at_most(name: str, one: Mapping[str, Any], most: float) -> dict[str, Any]:
        value, by_chance = one["value"], one.get("by_chance") or 0.0
        return {"name": name, "value": value, "cases": one["cases"], "target": f"at most {most:g}",
                "interval_95": one.get("interval_95"), "by_chance": one.get("by_chance"),
                "met": None if value is None or most < value <= by_chance else value <= most}

    coverage = at_least("90 % intervals that hold the truth", "coverage", 0.85)
    coverage.update(target="0.85 to 0.95", met=_within(scores["coverage"], 0.85, 0.95))
    return [
        at_least("right name, aliases merged", "right_name", 0.94),
        at_most("wrong name at probability above 0.9", scores["wrong_and_sure"], 0.01),
        at_most("false alarms", scores["false_alarms"], 0.05),
        at_least("unlisted effects called unknown", "unknown_recognised", 0.90),
        at_least("both effects of a pair", "pairs", 0.80),
        at_least("location", "location", 0.90),
        at_most("expected calibration error", scores["calibration_error"], 0.03),
        coverage,
        at_most("held-out error over the repeatability floor, median", scores["held_out"], 1.05),
        at_most("expected calibration error, all sizes", quiet["calibration_error"], 0.05)]


def _scores(results: Sequence[Result]) -> dict[str, Any]:
    kinds = {kind: [one for one in results if one.key.kind == kind]
             for kind in ("nothing", "single", "pair", "unlisted")}
    hidden = [one for one in results if one.key.hidden]
    right = [one for one in results if one.key.effects and set_right(one.answer, one.key)]
    events = _events(results)
    told = [one for one in results if one.key.kind == "nothing" and one.answer.verdict == NONE]
    told += [one for one in right if one.answer.verdict == NAMED]
    parameters = [hit for one in told if one.key.catalogue_laws for hit in covered(one.answer, one.key).items()]
    effects = [hit for name, hit in parameters if name.partition(".")[0] not in ("contact", "wear", "rig")]
    floors = [one.answer.after / one.answer.floor for one in right
              if one.answer.after is not None and one.answer.floor]
    gains = [one.answer.before / one.answer.after for one in right
             if one.answer.before is not None and one.answer.after]
    seconds = [one.answer.seconds for one in results]
    return {
        "cases": len(results),
        "right_name": share(kinds["single"], set_right).to_json(),
        "top_1": share(kinds["single"], top_right).to_json(),
        "wrong_and_sure": share(results, lambda a, k: wrong_name(a, k) and a.probability > SURE).to_json(),
        "wrong_name": share(results, wrong_name).to_json(),
        "false_alarms": share(kinds["nothing"], lambda a, k: a.verdict not in (NONE, FAILED)).to_json(),
        "missed": share(hidden, lambda a, k: a.verdict == NONE).to_json(),
        "unknown_recognised": share(kinds["unlisted"], lambda a, k: a.verdict == UNKNOWN).to_json(),
        "pairs": share(kinds["pair"], both_found).to_json(),
        "location": share(_to_locate(results), located).to_json(),
        "failed": share(results, lambda a, k: a.verdict == FAILED).to_json(),
        "calibration_error": {"value": expected_calibration_error(events), "cases": len(events),
                              "by_chance": calibration_by_chance(events)},
        "coverage": Share(sum(effects), len(effects)).to_json(),
        "coverage_with_baseline": Share(sum(hit for _, hit in parameters), len(parameters)).to_json(),
        "held_out": {"value": median(floors) if floors else None, "cases": len(floors),
                     "interval_95": median_interval(floors),
                     "at_most_1.05": Share(sum(ratio <= 1.05 for ratio in floors), len(floors)).to_json()},
        "improvement": {"value": median(gains) if gains else None, "cases": len(gains)},
        "seconds": {"value": median(seconds) if seconds else None, "longest": max(seconds, default=None),
                    "cases": len(seconds)},
    }


def _to_locate(results: Sequence[Result]) -> list[Result]:
    """Return the cases in which something is hidden and was noticed."""
    return [one for one in results if one.key.hidden and one.answer.verdict not in (NONE, FAILED)]


def _events(results: Sequence[Result]) -> list[tuple[float, bool]]:
    return [(one.answer.probability, verdict_right(one.answer, one.key)) for one in results
            if one.answer.verdict != FAILED]


def _accuracy(results: Sequence[Result]) -> dict[str, Any]:
    return {"top_1": share(results, top_right).to_json(), "set": share(results, set_right).to_json(),
            "location": share(_to_locate(results), located).to_json(),
            "wrong_and_sure": share(results, lambda a, k: wrong_name(a, k) and a.probability > SURE).to_json()}


def _by_effect(results: Sequence[Result]) -> dict[str, Mapping[str, Any]]:
    names = sorted({name for one in results for name in one.key.hidden})
    return {name: {**_accuracy(own := [one for one in results if name in one.key.hidden]),
                   "strong": share([one for one in own if strong(one)], set_right).to_json()} for name in names}


def _by_signal(results: Sequence[Result]) -> list[dict[str, Any]]:
    hidden = [one for one in results if one.key.hidden]
    return [{"low": low, "high": None if math.isinf(high) else high,
             **_accuracy([one for one in hidden if low <= one.key.signal < high])}
            for low, high in itertools.pairwise(SIGNAL_EDGES)]


def _line(one: Result) -> dict[str, Any]:
    key, answer = one.key, one.answer
    return {"case": one.name, "world": key.world, "kind": key.kind, "hidden": list(key.hidden),
            "signal_to_noise": None if math.isinf(key.signal) else key.signal,
            "total_signal_to_noise": None if math.isinf(key.total_signal) else key.total_signal,
            "verdict": answer.verdict, "effects": sorted(answer.effects), "probability": answer.probability,
            "right": verdict_right(answer, key), "top_1": top_right(answer, key), "set": set_right(answer, key),
            "located": located(answer, key) if key.hidden else None, "block": answer.block,
            "after": answer.after, "floor": answer.floor, "before": answer.before,
            "seconds": answer.seconds, "failure": answer.failure}
