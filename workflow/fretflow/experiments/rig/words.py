"""What is said of a diagnosis of the rig: the sentence, and what to measure next."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from fretflow.inference.parameters import Array, Parameters
from fretflow.inference.posterior import Found
from fretflow.inference.search import BENT
from fretflow.inference.verdict import Location, Remainder, ResidualLaw, Verdict
from fretflow.inference.words import blocks_of as blocks_of
from fretflow.inference.words import listed
from fretflow.inference.words import separating as separating

Names = Collection[str]
WORTH_TELLING = 0.2  # of the squares that a law explains


def sentence(found: Found, remainder: Remainder, location: Location, law: ResidualLaw | None) -> str:
    """Return the verdict in one sentence: what is known, how sure it is, and what stays unexplained."""
    share = f"{100.0 * found.explained:.0f} % of the difference"
    if found.verdict is Verdict.NONE:
        return ("The baseline with its own parameters refitted explains the recording within the errors of measurement "
                "and simulation.")
    if found.verdict is Verdict.NAMED:
        (names,) = found.sets
        return (f"{grade(found.probability)}, the model leaves out {listed(names)}, which "
                f"{'explain' if len(names) > 1 else 'explains'} {share}; {_rest(remainder)}.")
    if found.verdict is Verdict.AMBIGUOUS:
        sure = frozenset.intersection(*found.sets)
        either = [listed(names - sure) if names - sure else "nothing else" for names in found.sets]
        also = f"{listed(sure)}, and " if sure else ""
        return (f"{grade(found.probability)}, the model leaves out {also}one of {', or '.join(either)}, which act "
                f"alike on this recording; {share} is explained; {_rest(remainder)}.")
    return _unknown(found, remainder, location, law)


def grade(probability: float) -> str:
    """Return how sure a probability is, as J. B. Kadane's grades of evidence have it for a reader."""
    for least, word in ((0.99, "Almost surely"), (0.9, "Very probably"), (0.7, "Probably")):
        if probability >= least:
            return word
    return "Perhaps"


def _rest(remainder: Remainder) -> str:
    where = f": it lies in {remainder.where}" if remainder.where else ""
    return (f"what remains ({100.0 * remainder.share:.0f} % of the difference, {remainder.times_noise:.1f} times the "
            f"noise) is not explained{where}")


def _unknown(found: Found, remainder: Remainder, location: Location, law: ResidualLaw | None) -> str:
    where = [f"in the block '{location.block}'"] if location.block else []
    where += [f"on the {location.channel}"] if location.channel else []
    where += [f"in the phase '{location.phase}' of the loop"] if location.phase else []
    near = [one for one in found.ranking if one.effects][:3]
    best = ", ".join(f"{listed(one.effects)} would explain {100.0 * one.explained:.0f} %" for one in near)
    told = f"; what is left follows the {law.state}" if law is not None and law.explained >= WORTH_TELLING else ""
    return (f"Something that is not in the catalogue acts {', '.join(where) or 'here'}: "
            f"{best or 'no effect of the catalogue explains any of it'}, and what the nearest leaves "
            f"({remainder.times_noise:.1f} times the noise) is more than another form of its law would{told}.")


def of_instruments(wrong: Sequence[str]) -> str:
    """Return what is said where the instruments are at fault."""
    return f"No physics is looked for, because the instruments are at fault: {'; '.join(wrong)}."


def at_bounds(space: Parameters, z: Array) -> list[str]:
    """Return a warning of parameters that stand far outside of their plausible ranges."""
    own = [one.name for one, at in zip(space.coordinates, z, strict=True) if abs(at) > BENT]
    return [f"{listed(own)} {'stand' if len(own) > 1 else 'stands'} far outside of what is plausible: the fit may "
            "stand for something else"] if own else []


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
