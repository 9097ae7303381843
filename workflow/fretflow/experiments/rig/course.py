"""The search for the effects that explain a recording of the rig: screening, fits of single effects, then of pairs.

All effects are screened by their first-order changes at the fitted baseline; the most promising are fitted, first a
few steps each, then the best of them to the end. Around the best single effects the catalogue is screened again for
a second one. A set is chosen only if each of its effects earns its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fretflow.experiments.rig.coordinates import Space
from fretflow.experiments.rig.fit import Fitter
from fretflow.experiments.rig.model import RigModel, Simulation
from fretflow.experiments.rig.screening import alike, extends, rig_effects, starts_beside, strong
from fretflow.experiments.rig.search import LEAST_GAIN, NEARLY_ALL, Names, Pool, RigSearch

# Share of what one effect leaves, beyond what codes differ by in the mean where nothing is hidden, that a second one
# must explain: what a law that is not quite the catalogue's leaves, no other effect makes.
SECOND, BETWEEN = 0.6, 1.07
# Share of the baseline's excess that it must explain, times how alike it looks to the first: a law that is wrong by a
# third leaves a tenth of the squares, and the effect that looks most like it takes them.
MISTAKEN = 0.2
PROMISING = 3  # effects by screening that are fitted on whatever their first steps came to
RIVALS = 3  # sets of a size that are looked at in turn
POLISHING = 8  # steps at most
# times the best one's objective: what promises no less is not fitted further where that explains nearly all
HOPELESS = 2.0


@dataclass(frozen=True)
class Effort:
    """How much is fitted: steps of the baseline, how many single effects, steps of each, how many go on, and pairs."""

    base_steps: int
    base_more: int  # steps of a baseline that may be all there is
    singles: int
    first_steps: int
    kept: int
    last_steps: int
    more: int  # other ones that are fitted where the first ones explain too little
    bases: int  # single effects to which a second one is sought
    pairs: int  # for each of them
    surveyed: int  # single effects that are begun at all their starts, where the baseline is astray


FAST = Effort(base_steps=4, base_more=4, singles=6, first_steps=2, kept=3, last_steps=6, more=5, bases=1,
              pairs=2, surveyed=0)
FULL = Effort(base_steps=8, base_more=0, singles=100, first_steps=2, kept=6, last_steps=10, more=0, bases=2,
              pairs=4, surveyed=6)


def start_search(fitter: Fitter, first: Simulation, effort: Effort, pool: Pool,
                 checks: Sequence[RigModel] = ()) -> RigSearch:
    """Return a search with the baseline refitted from its first simulation.

    Where that is astray, its last steps are left out: it says nothing about its own parameters then.
    """
    space = Space.of(())
    base = fitter.fit(space, np.zeros(space.size), first, effort.base_steps)
    found = RigSearch(fitter, pool, {frozenset(): base}, checks)
    if effort.base_more and not found.baseline_biased:
        found.continue_fits([frozenset()], effort.base_more)
    return found


def search(found: RigSearch, effort: Effort, progress: Callable[[float, str], None]) -> None:
    """Fit the sets of effects that may explain the recording."""
    progress(0.0, "screening all effects")
    ranked = found.screen(frozenset()).ranked()
    progress(0.1, "fitting single effects")
    if found.baseline_biased and effort.surveyed:
        starts = found.screen(frozenset()).starts
        found.survey([start for name in ranked[:effort.surveyed] for start in starts[name]], len(starts),
                     effort.first_steps)
    found.add(frozenset(), ranked[:effort.singles], effort.first_steps)
    if max(map(found.explained, found.fits)) < NEARLY_ALL:
        rest = [name for name in rig_effects() if name not in ranked[:effort.singles]]
        found.add(frozenset(), rest, 0)
        found.continue_fits(found.promising(rest, effort.more), effort.first_steps)
    if found.lost:
        progress(0.4, "looking for strong effects")
        found.survey([one for one in starts_beside(found.baseline, rig_effects()) if strong(one)], PROMISING,
                     effort.first_steps)
    progress(0.5, "fitting the most promising")
    # a start may be so far off that an effect that promises much is still behind
    found.continue_fits(contenders(found, dict.fromkeys([
        *found.best(1, effort.kept), *(frozenset({name}) for name in ranked[:PROMISING]
                                       if frozenset({name}) in found.fits)])), effort.last_steps)
    found.swap(found.best(1, effort.bases), effort.last_steps)
    found.correct(found.best(1, effort.bases + 1), effort.last_steps)
    for place, one in enumerate(found.best(1, effort.bases)):
        progress(0.65 + 0.3 * place / effort.bases, f"what could act beside {', '.join(one)}")
        seen = found.screen(one)
        promising = [name for name in seen.ranked()[:effort.pairs] if seen.gain((name,)) > LEAST_GAIN]
        found.add(one, promising, effort.first_steps)
        found.continue_fits(found.best(2, 2, one), effort.last_steps)
        found.swap(found.best(2, 1, one), effort.last_steps)
        found.correct(found.best(2, 1, one), effort.last_steps)
    pair = chosen_set(found)
    if len(pair) > 1:  # one of the two may have brought the other out of a bad start
        found.thin(pair, effort.last_steps)


def contenders(found: RigSearch, sets: Iterable[Names]) -> list[Names]:
    """Return the sets that may still come near the best one; all of them where that does not explain nearly all."""
    best = found.best(1, 1)[0]
    if found.explained(best) < NEARLY_ALL:
        return list(sets)
    most = HOPELESS * found.fits[best].objective
    return [names for names in sets if found.fitter_of(names).promise(found.fits[names]) < most]


def refine(found: RigSearch, chosen: Names) -> None:
    """Fit the chosen set to the end; the baseline alone stays as what the screening began from."""
    if chosen:
        found.continue_fits([chosen], POLISHING)


def chosen_set(found: RigSearch) -> Names:
    """Return the set that explains best and in which each effect earns its place; none if no effect does."""
    best: Names = frozenset()
    for size in (1, 2):
        best = next((names for names in found.best(size, RIVALS) if _earned(found, names)), best)
    return _plainest(found, best)


def _plainest(found: RigSearch, chosen: Names) -> Names:
    """Return the set with the plainer law where one that extends it does not bring what any effect must."""
    for names in sorted(found.fits, key=lambda names: -found.fits[names].log_evidence):
        less = found.fits[chosen].log_evidence - found.fits[names].log_evidence
        if len(names) == len(chosen) and less < LEAST_GAIN and extends(chosen - names, names - chosen):
            return names
    return chosen


def _earned(found: RigSearch, wider: Names) -> bool:
    """Return whether each effect of a set earns its place."""
    fewer = max((names for names in found.fits if names < wider and len(names) == len(wider) - 1),
                key=lambda names: found.fits[names].log_evidence)
    gain = found.fits[wider].log_evidence - found.fits[fewer].log_evidence
    return gain >= LEAST_GAIN and (len(wider) == 1 or _placed(found, fewer, wider))


def _placed(found: RigSearch, one: Names, pair: Names) -> bool:
    """Return whether a pair's weaker effect is no stand-in for what the law of the other, `one` alone, leaves."""
    before, alone, both = (found.fits[names].chi_squared for names in (frozenset(), one, pair))
    mistaken = MISTAKEN * alike(found.fits[pair], *sorted(pair))
    return alone - both >= max(SECOND * (alone - BETWEEN * found.expected), mistaken * (before - found.expected))
