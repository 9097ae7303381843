"""What is said of a diagnosis of any experiment: its verdict in one sentence, and warnings of its fits."""

from __future__ import annotations

import sys
from collections.abc import Collection

from fretflow.core.records import Array
from fretflow.inference.decision import Decision
from fretflow.inference.parameters import Parameters, is_bent
from fretflow.inference.verdict import Location, Remainder, ResidualLaw, Verdict
from fretflow.inference.words import listed, not_enough, percent, probability

WORTH_TELLING = 0.2  # of the squares that a law explains


def sentence(decision: Decision, remainder: Remainder, location: Location, law: ResidualLaw | None) -> str:
    """Return the verdict in one sentence: what is known, how sure it is, and what stays unexplained."""
    share = f"{percent(decision.explained)} of the difference"
    if decision.verdict is Verdict.NONE:
        return ("The baseline with its own parameters refitted explains the recording within the errors of measurement "
                f"and simulation{_taken_as_noise(decision)}.")
    if decision.verdict is Verdict.NAMED:
        (names,) = decision.sets
        each = [f"{name} ({probability(decision.posterior.of(name))})" for name in names] if len(names) > 1 else names
        return (f"{grade(decision.probability)}, the model leaves out {listed(each)}, which "
                f"{'explain' if len(names) > 1 else 'explains'} {share}; {_rest(remainder)}.")
    if decision.verdict is Verdict.AMBIGUOUS:
        sure = frozenset.intersection(*decision.sets)
        either = [listed(names - sure) if names - sure else "nothing else" for names in decision.sets]
        also = f"{listed(sure)}, and " if sure else ""
        return (f"{grade(decision.probability)}, the model leaves out {also}one of {', or '.join(either)}, which act "
                f"alike on this recording; {share} is explained; {_rest(remainder)}.")
    return _unknown(decision, remainder, location, law)


def _taken_as_noise(decision: Decision) -> str:
    """Return in words what would be more probable than nothing if what it takes were no noise."""
    shares = {listed(names): own for names, own in decision.posterior.sets.items() if names}
    shares["something that the catalogue lacks"] = decision.posterior.unlisted
    taken = {name: own for name, own in shares.items() if own > decision.probability}
    if not taken:
        return ""
    sure = probability(sum(taken.values()))
    return (f"; {', or '.join(taken)} would be more probable ({sure}), but no test sees more than noise in what the "
            "baseline leaves")


def grade(p: float) -> str:
    """Return how sure a probability is, as J. B. Kadane's grades of evidence have it for a reader."""
    for least, word in ((0.99, "Almost surely"), (0.9, "Very probably"), (0.7, "Probably")):
        if p >= least:
            return word
    return "Perhaps"


def _rest(remainder: Remainder) -> str:
    times = f"{remainder.times_noise:.1f} times the noise"
    little = percent(max(remainder.share, sys.float_info.min))
    if round(remainder.times_noise, 1) <= 1.0:  # noise lies nowhere
        return f"what remains ({little} of the difference) is no larger than the noise"
    where = f": it lies in {remainder.where}" if remainder.where else ""
    if remainder.share < 0.01:
        return f"{little} of it remains, {times}{where}"
    return f"what remains ({little} of the difference, {times}) is not explained{where}"


def _unknown(decision: Decision, remainder: Remainder, location: Location, law: ResidualLaw | None) -> str:
    where = [f"in the block '{location.block}'"] if location.block else []
    where += [f"on the {location.channel}"] if location.channel else []
    where += [f"in the phase '{location.phase}' of the loop"] if location.phase else []
    near = [one for one in decision.ranking if one.effects][:3]
    best = ", ".join(f"{listed(one.effects)} would explain {percent(one.explained)}" for one in near)
    told = f"; what is left follows the {law.state}" if law is not None and law.explained >= WORTH_TELLING else ""
    why = not_enough(decision.against, remainder.times_noise)
    return (f"Something that is not in the catalogue acts {', '.join(where) or 'here'}: "
            f"{best or 'no effect of the catalogue explains any of it'}, {why}{told}.")


def at_bounds(space: Parameters, z: Array) -> list[str]:
    """Return a warning of parameters that stand far outside of their plausible ranges."""
    own = [one.name for one, far in zip(space.coordinates, is_bent(z) & ~space.chances, strict=True) if far]
    return [f"{listed(own)} {'stand' if len(own) > 1 else 'stands'} far outside of what is held plausible: the fit "
            "may stand for something else, or the range be too narrow"] if own else []


def unfinished(sets: Collection[Collection[str]]) -> list[str]:
    """Return a warning for each set of effects whose fit the verdict uses though it has not come to rest."""
    return [f"the fit of the baseline{' with ' + listed(names) if names else ' alone'} was stopped before it came to "
            "rest: it may explain a little more, with slightly other parameters" for names in sorted(sets, key=len)]
