"""Words that the diagnoses of all kinds of recordings share."""

from __future__ import annotations

from collections.abc import Iterable

from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Block
from fretflow.inference.verdict import Verdict

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
