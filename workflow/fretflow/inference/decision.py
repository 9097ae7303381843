"""The verdict on a finished search: what is most probable, and what tests that know no catalogue leave of that."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb, sqrt

import numpy as np
from scipy.stats import chi2, f

from fretflow.inference.parameters import Array, Coordinate
from fretflow.inference.posterior import Posterior, freedom, largest_odds, posterior, visible
from fretflow.inference.search import Names, Search
from fretflow.inference.verdict import FALSE_ALARMS, Candidate, Detection, Estimate, HeldOut, Verdict


@dataclass(frozen=True)
class Decision:
    """The verdict: the sets that are left as alternatives, the one that "after" is predicted with, and how sure."""

    verdict: Verdict
    sets: tuple[Names, ...]
    after: Names
    explained: float
    probability: float
    ranking: tuple[Candidate, ...]
    posterior: Posterior
    against: str = ""  # what the set that would be named does, so that it is not

    @property
    def effects(self) -> tuple[str, ...]:
        """Return all effects that the verdict names."""
        return tuple(sorted(frozenset().union(*self.sets)))

    @property
    def rivals(self) -> tuple[Names, ...]:
        """Return the sets of the verdict, then those that with them hold all but a twentieth of the effects' share."""
        rivals, held = list(self.sets), sum(self.posterior.sets.get(names, 0.0) for names in self.sets)
        for names, own in self.posterior.sets.items() if rivals else ():
            if held >= (1.0 - FALSE_ALARMS) * self.posterior.listed:
                break
            if names and names not in rivals:
                rivals.append(names)
                held += own
        return tuple(rivals)


def decide(search: Search, known: Posterior | None = None) -> Decision:
    """Return the verdict on a finished search: what is most probable of none, the catalogue and something else.

    Where what is `known` to be probable is not given, the search tells it.
    """
    known = posterior(search) if known is None else known
    ranked = [names for names in known.sets if names]
    best = ranked[0] if ranked else frozenset()
    ranking = _ranking(search, known)
    if known.none >= max(known.listed, known.unlisted):
        return Decision(Verdict.NONE, (), frozenset(), 0.0, known.none, ranking, known)
    if known.unlisted >= known.listed:
        return Decision(Verdict.UNKNOWN, (), best, search.explained(best), known.unlisted, ranking, known)
    sets, total = [best], known.sets[best]
    for names in ranked[1:]:
        if total > min(0.5, (1.0 - FALSE_ALARMS) * known.listed):
            break
        sets.append(names)
        total += known.sets[names]
    if all(best <= names for names in sets):  # whatever acts beside it, it does
        acts = sum(own for names, own in known.sets.items() if best <= names)
        return Decision(Verdict.NAMED, (best,), best, search.explained(best), acts, ranking, known)
    return Decision(Verdict.AMBIGUOUS, tuple(sets), best, search.explained(best), total, ranking, known)


def detected(decision: Decision, detection: Detection) -> Decision:
    """Return a verdict held to the classical test of whether the baseline leaves anything: what it misses is nothing.

    The reverse does not hold: the test's null knows the errors of the measurement and not what codes differ by, so that
    a small p-value alone is no physics.
    """
    return decision if detection.p_value < detection.false_alarm_rate else _nothing(decision, detection.p_value)


def beyond_noise(decision: Decision, search: Search) -> Decision:
    """Return a verdict held to what repeats explain: where the baseline leaves no more, there is nothing to explain.

    What takes more of that than noise would let the best of so many sets take (Wilks' test) is still something.
    """
    left, expected = search.chi_squared(frozenset()), search.experiment.measurement.expected
    if left > expected:
        return decision
    p = float(chi2.sf(left, expected))
    if decision.sets:
        more = freedom(search, decision.after) - freedom(search, frozenset())
        sets = comb(len(search.experiment.candidates()), len(decision.after))
        p = min(p, sets * float(chi2.sf(left - search.chi_squared(decision.after), more)))
    return decision if p < FALSE_ALARMS else _nothing(decision, p)


def _nothing(decision: Decision, p: float) -> Decision:
    """Return that nothing is left out, at least as probable as the p-value alone of a test of that leaves it."""
    if decision.verdict is Verdict.NONE:
        return decision
    before, none = decision.posterior.none, max(decision.posterior.none, 1.0 / (1.0 + largest_odds(p)))
    return replace(shared_anew(decision, none, (1.0 - none) / (1.0 - before) if before < 1.0 else 0.0),
                   verdict=Verdict.NONE, sets=(), after=frozenset(), explained=0.0, probability=none)


def ruled_out(decision: Decision, against: str, p: float = 0.0) -> Decision:
    """Return that something else acts than what would be named, at least as probable as a test of that leaves it.

    With a p-value of zero all that the catalogue held falls to what it lacks.
    """
    none, listed = decision.posterior.none, decision.posterior.listed
    kept = min(listed, (1.0 - none) / (1.0 + largest_odds(p)))
    return replace(shared_anew(decision, none, kept / listed if listed > 0.0 else 0.0), verdict=Verdict.UNKNOWN,
                   sets=(), probability=1.0 - none - kept, against=against)


def shared_anew(decision: Decision, none: float, left: float) -> Decision:
    """Return a verdict's posterior and ranking with another probability of nothing, and what is `left` of all sets'.

    The rest falls to what the catalogue lacks.
    """
    sets = {names: left * share if names else none for names, share in decision.posterior.sets.items()}
    ranking = sorted((replace(one, probability=sets.get(frozenset(one.effects), 0.0)) for one in decision.ranking),
                     key=lambda one: -one.probability)
    return replace(decision, ranking=tuple(ranking), posterior=replace(
        decision.posterior, sets=sets, unlisted=1.0 - sum(sets.values())))


def held_to(decision: Decision, error: HeldOut | None, rows: int) -> Decision:
    """Return a verdict that names nothing which explains nothing, or predicts what was held out worse than without it.

    Worse is beyond a standard deviation of the mean square of so many independent `rows`; how sure that makes, says the
    F test of both.
    """
    if decision.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return decision
    if decision.explained <= 0.0:
        return ruled_out(decision, "explains nothing")
    count = max(rows, 1)
    if error is None or not error.after**2 > error.before**2 * (1.0 + sqrt(2.0 / count)):
        return decision
    p = float(f.sf((error.after / error.before)**2, count, count)) if error.before > 0.0 else 0.0
    return ruled_out(decision, "predicts what was held out worse than the baseline", p)


def estimate(coordinate: Coordinate, z: float, half: float, draws: Array, told: tuple[str, str]) -> Estimate:
    """Return a parameter at coordinate `z` with its interval `half` to either side, its unit and meaning as told."""
    ends = sorted(coordinate.value(z + way * half) for way in (-1.0, 1.0))
    return Estimate(name=coordinate.name, value=coordinate.value(z), low=ends[0], high=ends[1], unit=told[0],
                    meaning=told[1], draws=coordinate.values(draws))


def smallest_visible(search: Search) -> dict[str, float]:
    """Return the share of its plausible range at which each effect would have been as probable as none.

    The signature is taken as linear in the effect's size.
    """
    least = visible(len(search.experiment.candidates()))
    seen: dict[str, float] = {}
    for one in search.starts:
        size = float(np.linalg.norm(one.changes[:, 0]))
        seen[one.effect] = min(seen.get(one.effect, 1.0), least / size if size > least else 1.0)
    return seen


def _ranking(search: Search, known: Posterior) -> tuple[Candidate, ...]:
    """Return all sets that hold a share of the posterior, the most probable first, then those that were fitted."""
    rest = [names for names in (*search.best(1), *search.best(2)) if names not in known.sets]
    expected = search.experiment.measurement.expected
    return tuple(Candidate(
        effects=tuple(sorted(names)), probability=known.sets.get(names, 0.0), explained=search.explained(names),
        chi_squared=search.chi_squared(names), degrees_of_freedom=round(expected) - len(search.fits[names].z),
        log_evidence=search.log_evidence(names, None if names in known.sets else frozenset()),
        converged=search.fits[names].converged)
        for names in (*known.sets, *rest))
