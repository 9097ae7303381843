"""What is said of a diagnosis of the rig: the sentence, and what to measure next."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from fretflow.inference.verdict import EXPLAINED_GATE, Location, ResidualLaw, Verdict
from fretflow.inference.words import blocks_of as blocks_of
from fretflow.inference.words import listed
from fretflow.inference.words import separating as separating

Names = Collection[str]
WORTH_TELLING = 0.2  # of the squares that a law explains



def sentence(verdict: Verdict, sets: Sequence[Names], explained: float, location: Location, law: ResidualLaw | None,
             repeats: bool = True, predicts: bool = True) -> str:
    """Return the verdict in one sentence.

    Parameters
    ----------
    verdict
        What is said.
    sets
        The alternatives, each a set of effects; the most probable first.
    explained
        The share of the excess chi-squared that the first of them (or the best that was tried) explains.
    location
        Where measured and predicted part.
    law
        What an unlisted effect does.
    repeats
        Whether the motion repeats itself with the drive.
    predicts
        Whether loops that were not fitted are predicted better with them.
    """
    share = f"{100.0 * explained:.0f} % of what the baseline leaves"
    if verdict is Verdict.NONE:
        return ("The baseline with its own parameters refitted explains the recording within the errors of measurement "
                "and simulation.")
    if verdict is Verdict.NAMED:
        (names,) = sets
        return f"The model leaves out {listed(names)}, which {'explain' if len(names) > 1 else 'explains'} {share}."
    if verdict is Verdict.AMBIGUOUS:
        sure = frozenset.intersection(*map(frozenset, sets))
        either = [listed(frozenset(names) - sure) for names in sets if frozenset(names) - sure]
        also = f"{listed(sure)}, and " if sure else ""
        return f"The model leaves out {also}one of {', or '.join(either)}, which act alike on this recording; " \
               f"{share} is explained."
    return _unknown(explained, location, law, repeats, predicts)


def _unknown(explained: float, location: Location, law: ResidualLaw | None, repeats: bool,
             predicts: bool) -> str:
    where = [f"in the block '{location.block}'"] if location.block else []
    where += [f"on the {location.channel}"] if location.channel else []
    where += [f"in the phase '{location.phase}' of the loop"] if location.phase else []
    best = f"the best of the catalogue explains {100.0 * explained:.0f} % of what the baseline leaves" \
        if explained > 0.0 else "no effect of the catalogue earns a place"
    if not repeats:
        best += ", but the motion does not repeat itself with the drive, which it does with all of them"
    elif not predicts and explained > 0.0:
        best += ", but predicts loops that it was not fitted to no better than the baseline does"
    elif explained >= EXPLAINED_GATE:
        best += ", but not down to the noise"
    told = f"; what is left follows the {law.state}" if law is not None and law.explained >= WORTH_TELLING else ""
    return f"Something that is not in the catalogue acts {', '.join(where) or 'here'}: {best}{told}."


def unfinished(sets: Collection[Names]) -> list[str]:
    """Return a warning for each set of effects whose fit the verdict uses though it has not come to rest."""
    return [f"the fit of the baseline{' with ' + listed(names) if names else ' alone'} was stopped before it came to "
            "rest: it may explain a little more, with slightly other parameters" for names in sorted(sets, key=len)]


def not_repeated() -> str:
    """Return the warning of loops that differ smoothly from repeat to repeat."""
    return ("the repeats of a cycle count differ by smooth changes of the whole loop, not by noise: the motion does "
            "not repeat itself with the drive (a subharmonic, an intermittent contact, a drive or load that wanders), "
            "as it does in every model here; record some consecutive periods to see what it follows")


def next_measurement(law: ResidualLaw) -> str:
    """Return what to measure where nothing of the catalogue fits."""
    return (f"Loops at other amplitudes, normal loads and frequencies, to see whether what is left still follows the "
            f"{law.state}, and a record of the normal force, the approach and the excitation, where they were not "
            "recorded.")
