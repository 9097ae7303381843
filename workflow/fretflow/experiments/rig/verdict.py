"""What the search in the rig's recordings comes to: verdict, alternatives, probabilities, what would have been seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, sqrt

import numpy as np

from fretflow.experiments.rig.detection import BETWEEN_CODES, GAINS, unsteady
from fretflow.experiments.rig.search import LEAST_GAIN, NEARLY_ALL, Names, RigSearch
from fretflow.inference.covariance import SYSTEMATIC
from fretflow.inference.verdict import EXPLAINED_GATE, Candidate, Detection, HeldOut, Verdict

SURE = 0.9  # probability from which one set is named alone
MOST_ALTERNATIVES = 3
GATE_WIDTH = 0.05  # of the explained share, over which the catalogue's claim fades
MOST_RANKED = 40
# Shares of the verdicts in a trial of 60 recordings (seed 2026): of "unknown" that nothing of the catalogue was hidden
# (in that of 200 which followed, see benchmarks/trial, half), and of names that were wrong where the baseline's misfit
# was within what codes differ by. The gate says nothing there; it does where the misfit is beyond that by `ROOM` of
# the expected chi-squared.
UNLISTED, FAINT, ROOM = 0.56, 0.45, 0.5
# Odds of an effect ten times the noise to none of that size, where detection sees nothing: 1 to 36 in the trial of 200,
# with gains of some 0.3 in the mean.
OVERLOOKED = 0.1
# A fit that still leaves so many times the expected chi-squared names nothing, unless it explains nearly all there was.
BAD = 1.5
WORSE = 1.005  # what noise and a refit may do; some effects show in the wear or in zeros alone
BESIDE = 10.0  # times the expected chi-squared: three times what repeats differ by, beside which that is a trifle
CHANCE = 1e-3  # p-value below which a promise is no chance


@dataclass(frozen=True)
class Found:
    """The verdict: the sets that are left as alternatives, the one that "after" is predicted with, and how sure."""

    verdict: Verdict
    sets: tuple[Names, ...]
    after: Names
    explained: float
    probability: float
    ranking: tuple[Candidate, ...]
    widened: float  # factor on intervals: how much more than noise even the best fit leaves

    @property
    def effects(self) -> tuple[str, ...]:
        """Return all effects that the verdict names."""
        return tuple(sorted(frozenset().union(*self.sets)))


def decide(looked: RigSearch, chosen: Names, detection: Detection) -> Found:
    """Return the verdict on a finished search."""
    probability, ranking = looked.probabilities(), _ranking(looked)
    if detection.p_value >= detection.false_alarm_rate or (not chosen and _only_promised(detection)):
        return Found(Verdict.NONE, (), frozenset(), 0.0, _of_none(looked), ranking, _widened(looked, frozenset()))
    share = looked.explained(chosen) if chosen else 0.0
    claim = (1.0 - FAINT / (1.0 + looked.excess(looked.baseline) / (ROOM * looked.expected))) / (
        1.0 + exp(-(share - EXPLAINED_GATE) / GATE_WIDTH))
    if not chosen or not explains(looked, chosen) or _unsteady_beside(looked, share):
        best = chosen or next((names for names in probability if names), frozenset())
        return Found(Verdict.UNKNOWN, (), best, share, UNLISTED, ranking, _widened(looked, best))
    rivals = {names: value for names, value in probability.items()
              if len(names) <= len(chosen) and names and explains(looked, names)}
    total = sum(rivals.values())
    sets, sum_ = [chosen], rivals.get(chosen, 0.0) / max(total, 1e-300)
    for names, value in rivals.items():
        if sum_ >= SURE or len(sets) == MOST_ALTERNATIVES:
            break
        if names != chosen:
            sets.append(names)
            sum_ += value / total
    verdict = Verdict.NAMED if len(sets) == 1 else Verdict.AMBIGUOUS
    return Found(verdict, tuple(sets), chosen, share, sum_ * claim, ranking, _widened(looked, chosen))


def predicts(error: HeldOut | None) -> bool:
    """Return whether held-out loops are predicted no worse with the verdict's effects than without."""
    return error is None or error.after <= WORSE * error.before


def held_to(found: Found, error: HeldOut | None) -> Found:
    """Return the verdict once held-out loops were predicted: effects that do not help there are not named."""
    if found.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS) or predicts(error):
        return found
    return replace(found, verdict=Verdict.UNKNOWN, sets=(), probability=UNLISTED)


def _only_promised(detection: Detection) -> bool:
    """Return whether nothing but the first-order gains of the screening sees anything, and that no more than just.

    Where no fit keeps such a promise, it was chance. One that chance does not make stays unexplained.
    """
    others = [value for name, value in detection.tests.items() if name != GAINS]
    return (detection.statistic == GAINS and detection.p_value > CHANCE
            and all(len(detection.tests) * value >= detection.false_alarm_rate for value in others))


def _unsteady_beside(looked: RigSearch, share: float) -> bool:
    """Return whether repeats differ smoothly, and not by a trifle beside what is explained nearly whole."""
    large = looked.baseline.chi_squared > BESIDE * looked.expected
    return unsteady(looked.fitter.rig.observation) and not (large and share >= NEARLY_ALL)


def explains(looked: RigSearch, names: Names) -> bool:
    """Return whether a set explains enough to be named."""
    share, left = looked.explained(names), looked.fits[names].chi_squared / looked.expected
    return share >= EXPLAINED_GATE and (left <= BAD or share >= NEARLY_ALL)


def _widened(looked: RigSearch, names: Names) -> float:
    return sqrt(max(1.0, looked.fits[names].chi_squared / looked.expected))


def _of_none(looked: RigSearch) -> float:
    """Return the probability that nothing is left out that could be seen, by the effects' gains at the baseline."""
    seen = looked.screen(frozenset())
    gains = np.array([seen.gain((name,)) for name in seen.columns]) / SYSTEMATIC
    return float(1.0 / (1.0 + OVERLOOKED * np.mean(np.exp(np.minimum(gains, 50.0)))))


def _ranking(looked: RigSearch) -> tuple[Candidate, ...]:
    """Return all sets that were fitted, and the effects that were only screened, most probable first."""
    rows = [Candidate(effects=tuple(sorted(names)), probability=value, explained=looked.explained(names) if names
                      else 0.0, chi_squared=looked.fits[names].chi_squared,
                      degrees_of_freedom=round(looked.expected) - len(looked.fits[names].z),
                      log_evidence=looked.fits[names].log_evidence, converged=looked.fits[names].converged)
            for names, value in looked.probabilities().items()]
    return tuple(rows[:MOST_RANKED])


def smallest_visible(looked: RigSearch) -> dict[str, float]:
    """Return the share of its plausible range at which each effect would have been seen.

    There half the square of its signature's norm, over `BETWEEN_CODES`, is `LEAST_GAIN`; that at the middle of its
    ranges is taken as linear in its size.
    """
    seen = looked.screen(frozenset())
    least = sqrt(2.0 * LEAST_GAIN * BETWEEN_CODES)
    found = {}
    for name, columns in seen.columns.items():
        size = float(np.linalg.norm(columns[:, 0]))
        found[name] = float(min(1.0, least / size)) if size > 0.0 else 1.0
    return found
