"""Words that the diagnoses of all kinds of recordings share."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import combinations

from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Block
from fretflow.inference.verdict import Verdict

EVERYTHING = "the same test at another amplitude, another normal load and another frequency"
BLOCKS = {Block.CONTACT: "contact law", Block.WEAR: "wear law"}


def blocks_of(effects: Iterable[str]) -> str:
    """Return the blocks that effects change, in words."""
    found = dict.fromkeys(BLOCKS.get(block, block.value) for block in (catalogue()[name].block for name in effects))
    return " and ".join(found)


def listed(names: Iterable[str], last: str = "and") -> str:
    """Return names in one phrase."""
    every = sorted(names)
    return every[0] if len(every) == 1 else f"{', '.join(every[:-1])} {last} {every[-1]}"


def after_model(verdict: Verdict, effects: Iterable[str]) -> str:
    """Return what is predicted as "after", the baseline with `effects`, and why with these."""
    names = sorted(effects)
    why = {Verdict.UNKNOWN: ", the best of the catalogue", Verdict.AMBIGUOUS: ", one of the set"} if names else {}
    return " + ".join(("baseline", *names)) + why.get(verdict, "")


def separating(sets: Sequence[Collection[str]]) -> str:
    """Return the measurement that would tell alternatives apart; where there is one only, what would confirm it.

    Parameters
    ----------
    sets
        The alternatives, each a set of effects; the most probable first.
    """
    known = catalogue()
    if len(sets) == 1:
        return " ".join(known[name].confirmed_by for name in sorted(sets[0]) if known[name].confirmed_by)
    told: dict[str, list[str]] = {}
    for one, other in combinations([frozenset(names) for names in sets], 2):
        left, right = one - other, other - one
        told.setdefault(_between(left, right), []).append(f"{_named(left, one)} from {_named(right, other)}")
    said = [f"{what[0].upper()}{what[1:]} would tell {' and '.join(pairs)}." for what, pairs in told.items()]
    return " ".join(said)


def _named(own: Collection[str], whole: Collection[str]) -> str:
    return listed(own) if own else f"{listed(whole)} alone"


def _between(one: Collection[str], other: Collection[str]) -> str:
    known = catalogue()
    for first in sorted(one):
        for second in sorted(other):
            told = known[first].told_from.get(second) or known[second].told_from.get(first)
            if told:
                return told
    return next((known[name].told_by for name in sorted({*one, *other}) if known[name].told_by), EVERYTHING)
