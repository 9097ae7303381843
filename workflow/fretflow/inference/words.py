"""Numbers, units, names and verdicts in words, as reports and the command line write them."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

from markupsafe import Markup, escape

from fretflow.core.units import pretty_unit, readable_unit
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Block, Effect, declared_priors
from fretflow.inference.verdict import Candidate, Diagnosis, Estimate, Verdict

EVERYTHING = "the same test at another amplitude, another normal load and another frequency"
BLOCKS = {Block.CONTACT: "contact law", Block.WEAR: "wear law"}
NOTHING = "–"
INSTRUMENTS = ("kg", "s")  # units of what belongs to them, and does not go with a joint's size
_LETTERS = {"mu": "μ", "xi": "ξ", "phi": "φ", "tau": "τ", "zeta": "ζ", "eps": "ε"}
_PLAIN = range(-4, 7)  # powers of ten of numbers that are written without one, as C's %g does, and millions
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

VERDICT_WORDS = {
    Verdict.NONE: "No missing physics seen",
    Verdict.NAMED: "Missing physics named",
    Verdict.AMBIGUOUS: "One of several effects",
    Verdict.UNKNOWN: "Not in the catalogue",
}
PROBABILITY_OF = {
    Verdict.NONE: "that nothing is missing", Verdict.NAMED: "that this acts, alone or beside others",
    Verdict.AMBIGUOUS: "of the set, taken together", Verdict.UNKNOWN: "that it is something the catalogue lacks",
}
UNLISTED = "something that the catalogue lacks"


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in a few words; faults of instruments are none about physics."""
    return "Instruments at fault" if diagnosis.faults else VERDICT_WORDS[diagnosis.verdict]


def probability_of(diagnosis: Diagnosis) -> str:
    """Return what the probability of a verdict is of."""
    return "that an instrument is at fault" if diagnosis.faults else PROBABILITY_OF[diagnosis.verdict]


def number(value: float, resolution: float | None = None) -> str:
    """Return `value` rounded to `resolution`, or to three figures; with a power of ten if far from 1."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    resolution = resolution if resolution and math.isfinite(resolution) else 10.0 ** (power - 2)
    if power in _PLAIN:
        return _signed(f"{value:,.{_decimals(resolution)}f}")
    return _signed(f"{value / 10.0**power:.{_decimals(resolution / 10.0**power)}f}·10{str(power).translate(_RAISED)}")


def _decimals(resolution: float) -> int:
    return min(9, max(0, -math.floor(math.log10(resolution) + 1e-9)))


def _signed(text: str) -> str:
    return text.replace("-", "−")


def percent(share: float) -> str:
    """Return `share` of 1 in per cent; what is all but certain as a bound."""
    if not math.isfinite(share):
        return NOTHING
    if round(share, 3) == 1.0 > share:
        return "> 99.9 %"
    if round(share, 3) == 0.0 < share:
        return "< 0.1 %"
    digits = 1 if 0.0 < share < 0.0095 or 0.99 < share < 1.0 else 0
    return _signed(f"{100.0 * share:.{digits}f} %")


def probability(p: float) -> str:
    """Return a probability in per cent; none is 0 or 1, whatever round-off leaves of it."""
    return percent(min(max(p, sys.float_info.min), 1.0 - sys.float_info.epsilon))  # nan stays


def p_value(p: float) -> str:
    """Return a p-value with two figures at most."""
    if not math.isfinite(p):
        return NOTHING
    if p < sys.float_info.epsilon:  # what round-off leaves of 1 - p
        return "< 10⁻¹⁵"
    if p < 1e-3:
        power = math.floor(math.log10(p))
        return f"{p / 10.0**power:.0f}·10{str(power).translate(_RAISED)}"
    return f"{p:.2g}"


def duration(seconds: float) -> str:
    """Return a wall time for people."""
    if not math.isfinite(seconds) or seconds <= 0.0:
        return ""
    if seconds < 90.0:
        return f"{seconds:.0f} s" if seconds >= 10.0 else f"{seconds:.1f} s"
    return f"{seconds // 60:.0f} min {seconds % 60:02.0f} s" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def cost(diagnosis: Diagnosis) -> str:
    """Return what a diagnosis took: wall time, by stage from a second on, and memory."""
    stages = ", ".join(f"{name} {duration(spent)}" for name, spent in diagnosis.stages.items() if spent >= 1.0)
    own, other = (number(size / 1e9, 0.1) for size in diagnosis.memory)
    held = f"{own} GB of memory" + (f", and up to {other} GB in each process" if other != "0.0" else "")
    told = (duration(diagnosis.seconds), stages, held if diagnosis.memory[0] else "")
    return "; ".join(part for part in told if part)


def channel_words(channel: str) -> str:
    """Return a channel's name for people."""
    return channel.replace("_", " ")


def cycles_words(cycles: tuple[int, int]) -> str:
    """Return a range of cycles for people."""
    first, last = cycles
    return f"{first:,}" if first == last else f"{first:,} to {last:,}"


def effect_title(name: str) -> str:
    """Return what the catalogue calls effect `name`, or nothing where it has none of that name."""
    kind = catalogue().get(name)
    return kind.title if kind is not None else ""


def equation(text: str) -> Markup:
    """Return an equation in plain text as it is printed: ``mu_0^2`` with a Greek letter, an index and a power."""
    printed = str(escape(text))
    for plain, letter in _LETTERS.items():
        printed = re.sub(rf"\b{plain}(?=\b|_)", letter, printed)
    printed = re.sub(r"_inf\b", "_∞", printed)
    printed = re.sub(r"(?<!\w)(\w{1,2})_([A-Za-z0-9∞]+)", r"\1<sub>\2</sub>", printed)
    printed = re.sub(r"\^(-?[A-Za-z0-9]+)", lambda m: f"<sup>{_signed(m[1])}</sup>", printed)
    return Markup(re.sub(r"(?<![A-Za-z])-", "−", printed.replace("+-", "±").replace("-+", "∓")))


def together(effects: tuple[str, ...]) -> str:
    """Return a set of effects in one phrase."""
    return " + ".join(effects) if effects else "nothing added (baseline)"


def unlisted(diagnosis: Diagnosis) -> float:
    """Return the probability that something acts which is not in the catalogue: what all sets leave."""
    return max(0.0, 1.0 - sum(one.probability for one in diagnosis.ranking))


def leading(diagnosis: Diagnosis) -> Candidate | None:
    """Return the most probable explanation that adds something, or None."""
    return next((one for one in diagnosis.ranking if one.effects), None)


def explained(diagnosis: Diagnosis, one: Candidate) -> str:
    """Return the share of the difference that an explanation explains; where noise is all there is, none."""
    return NOTHING if diagnosis.verdict is Verdict.NONE else percent(one.explained)


def fitted(one: Candidate) -> str:
    """Return how far a set was fitted: what is given up early may misfit by more than the baseline that it extends."""
    return "fully" if one.converged else "given up early"


def after_words(diagnosis: Diagnosis) -> str:
    """Return what "after" was predicted with; the baseline with the named effects where that is not told."""
    return diagnosis.after_model or " + ".join(("baseline", *diagnosis.effects))


@dataclass(frozen=True)
class Interval:
    """An estimate in the unit that engineers read it in."""

    value: str
    low: str
    high: str
    unit: str

    @property
    def ends(self) -> str:
        """Return from where to where it goes; a parameter has no interval where both ends are its bound."""
        if self.low == self.high:
            return self.low if self.low == NOTHING else "stands at its bound"
        return f"{self.low} to {self.high}"


def interval(estimate: Estimate) -> Interval:
    """Return `estimate` to two figures of its interval (JCGM 100:2008, 7.2.6); a power of ten goes to the unit.

    Of a skewed interval each number keeps two figures of its own at least: 10 may go from 0.50 to 800.
    """
    largest = max((abs(v) for v in (estimate.low, estimate.value, estimate.high) if math.isfinite(v)), default=0.0)
    unit, size = readable_unit(largest, estimate.unit)
    printed, power = pretty_unit(unit), math.floor(math.log10(largest / size)) if largest > 0.0 else 0
    if power not in _PLAIN:
        printed, size = f"10{str(power).translate(_RAISED)} {printed}".rstrip(), size * 10.0**power
    half = 0.5 * (estimate.high - estimate.low)
    step = 0.1 * half / size if half > 0.0 and math.isfinite(half) else None
    value, low, high = (number(v / size, step and min(step, 0.1 * abs(v / size)))
                        for v in (estimate.value, estimate.low, estimate.high))
    return Interval(value, low, high, printed)


def of_any_size(kind: type[Effect], unit: str) -> bool:
    """Tell whether a plausible range holds for any joint, as of numbers and of masses and delays of instruments.

    Forces, lengths and frequencies go with the joint and its motion.
    """
    return unit in ("", "1") or (kind.block is Block.SENSOR and unit in INSTRUMENTS)


def implausible(made: Iterable[Estimate]) -> list[str]:
    """Return a warning for each parameter of an effect outside of what the catalogue holds plausible.

    Not where that goes with the size of a joint, see `of_any_size`.
    """
    notes = []
    for one in made:
        effect, _, field = one.name.rpartition(".")
        kind = catalogue().get(effect)
        if kind is None or not of_any_size(kind, one.unit):
            continue
        prior = declared_priors(kind).get(field)
        size = abs(one.value) if prior is not None and prior.low >= 0.0 else one.value
        if prior is not None and not prior.low <= size <= prior.high:
            unit = pretty_unit(one.unit)
            notes.append(f"{one.name} = {f'{number(one.value, 0.1 * size)} {unit}'.rstrip()} lies beyond the plausible "
                         f"{f'{prior.low:g} to {prior.high:g} {unit}'.rstrip()} ({prior.source})")
    return notes


def parameter_words(name: str) -> str:
    """Return the last part of a parameter's name in words."""
    return name.rpartition(".")[2].replace("_", " ")


def blocks_of(effects: Iterable[str]) -> str:
    """Return the blocks that effects change, in words."""
    blocks = dict.fromkeys(BLOCKS.get(block, block.value) for block in (catalogue()[name].block for name in effects))
    return " and ".join(blocks)


def listed(names: Iterable[str], last: str = "and") -> str:
    """Return names in one phrase."""
    every = sorted(names)
    return every[0] if len(every) == 1 else f"{', '.join(every[:-1])} {last} {every[-1]}"


def after_model(verdict: Verdict, effects: Iterable[str]) -> str:
    """Return what is predicted as "after", the baseline with `effects`, and why with these."""
    names = sorted(effects)
    why = {Verdict.UNKNOWN: ", the best of the catalogue", Verdict.AMBIGUOUS: ", one of the set"} if names else {}
    return " + ".join(("baseline", *names)) + why.get(verdict, "")


def not_enough(against: str, times_noise: float) -> str:
    """Return why the nearest effect, which leaves so many times the noise, is not it: a check is `against` it, or that.

    Examples
    --------
    >>> from fretflow.inference.words import not_enough
    >>> not_enough("explains nothing", 4.7)
    'but the nearest explains nothing, and leaves 4.7 times the noise'
    """
    times = f"{times_noise:.1f} times the noise"
    return (f"but the nearest {against}, and leaves {times}" if against else
            f"and what the nearest leaves ({times}) is more than another form of its law would")


def separating(sets: Sequence[Collection[str]]) -> str:
    """Return the measurement that would tell alternatives apart; where there is one only, what would confirm it.

    Parameters
    ----------
    sets
        The alternatives, each a set of effects; the most probable first.
    """
    known = catalogue()
    told: dict[str, list[str]] = {}
    if len(sets) == 1:
        for name in sorted(sets[0]):
            if not known[name].confirmed_by:
                told.setdefault(known[name].told_by or EVERYTHING, []).append(name)
        return " ".join([*(known[name].confirmed_by for name in sorted(sets[0]) if known[name].confirmed_by), *(
            f"{what[0].upper()}{what[1:]} would confirm {listed(names)}." for what, names in told.items())])
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
