"""What a diagnosis answered, and whether it is right: the definitions that all scores rest on.

Aliases. Two effects are one name where no recording of these channels can tell them apart (`ALIASES`), or where
the diagnosis itself declared them a class (verdict ``ambiguous``) of at most `LARGEST_CLASS` alternatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

NONE, NAMED, AMBIGUOUS, UNKNOWN, FAILED = "none", "named", "ambiguous", "unknown", "failed"
LARGEST_CLASS = 3
CLASS_PROBABILITY = 0.9  # ranked alternatives up to this sum are the class of an ambiguous verdict
VISIBLE = 3.0  # total signal-to-noise under which "none" is a right answer too

# Pairs that are physically indistinguishable, unless the channel in the second place was recorded.
ALIASES: tuple[tuple[frozenset[str], str | None], ...] = (
    # both bend the stick slope alike; only the normal springs' approach under other loads differs
    (frozenset({"contact-stiffness", "sensor-path-compliance"}), "approach"),
    # springs that have stiffened before the second loop are springs
    (frozenset({"contact-stiffness-evolution", "sensor-path-compliance"}), "approach"),
    # both make wear fall faster than the pressure; one map of one test has one curve of wear against pressure
    (frozenset({"wear-threshold", "wear-power-law"}), None),
    # at constant excitation the loops see mu N only
    (frozenset({"friction-run-in", "normal-load-drift"}), "normal_force"),
)

Effects = frozenset[str]


@dataclass(frozen=True)
class Key:
    """The truth of a case, as far as it is scored."""

    kind: str  # "nothing", "single", "pair", "unlisted"
    effects: Effects  # listed ones
    blocks: Effects  # right as a location
    channels: Effects
    signal: float  # smallest signal-to-noise of what is hidden; infinite where nothing is
    total_signal: float
    catalogue_laws: bool
    parameters: Mapping[str, float]  # "effect.parameter" and those of the baseline, SI
    hidden: tuple[str, ...]
    world: int = 1

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> Key:
        """Return the key from its file."""
        hidden = raw["hidden"]
        values = {f"{one['id']}.{name}": value for one in hidden for name, value in one["parameters"].items()}
        if "friction-run-in" not in raw["effects"]:
            values["contact.friction_coefficient"] = raw["baseline"]["friction_coefficient"]
        values["wear.coefficient"] = raw["baseline"]["wear_coefficient"]
        values["rig.moving_mass"] = raw["baseline"]["moving_mass"]
        return cls(
            raw["kind"], frozenset(raw["effects"]), frozenset(block for one in hidden for block in one["blocks"]),
            frozenset(raw["channels"]), min((one["signal_to_noise"] for one in hidden), default=float("inf")),
            min((one["total_signal_to_noise"] for one in hidden), default=float("inf")), raw["catalogue_laws"], values,
            tuple(one["id"] for one in hidden), raw.get("world", 1))


@dataclass(frozen=True)
class Answer:
    """What a diagnosis said, and how long it took."""

    verdict: str
    effects: Effects
    probability: float
    ranking: tuple[tuple[Effects, float], ...]
    block: str
    parameters: Mapping[str, tuple[float, float, float]]  # value, low, high
    before: float | None
    after: float | None
    floor: float | None
    seconds: float
    failure: str = ""

    @classmethod
    def read(cls, raw: Mapping[str, Any], seconds: float) -> Answer:
        """Return the answer from the JSON of ``fretflow diagnose``.

        Raises
        ------
        ValueError
            If it is not in that form.
        """
        try:
            verdict = raw["verdict"]
            if verdict not in (NONE, NAMED, AMBIGUOUS, UNKNOWN):
                raise ValueError(f"verdict {verdict!r} is none of {NONE}, {NAMED}, {AMBIGUOUS}, {UNKNOWN}")
            fit = raw["fit"] or {}
            before, after, floor = (_number(fit.get(name)) for name in ("before", "after", "floor"))
            return cls(
                verdict, frozenset(raw["effects"]), _number(raw["probability"]) or 0.0,
                tuple((frozenset(one["effects"]), _number(one["probability"]) or 0.0) for one in raw["ranking"]),
                raw["location"]["block"],
                {name: (float(one["value"]), float(one["low"]), float(one["high"]))
                 for name, one in raw["parameters"].items() if None not in (one["value"], one["low"], one["high"])},
                before, after, floor, seconds)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the diagnosis is not in the agreed form: {type(error).__name__} {error}") from error

    @classmethod
    def failed(cls, reason: str, seconds: float) -> Answer:
        """Return the answer of a diagnosis that gave none."""
        return cls(FAILED, frozenset(), 0.0, (), "", {}, None, None, None, seconds, reason)

    @property
    def alternatives(self) -> tuple[Effects, ...]:
        """Return the sets of effects that the answer leaves open: one if named, a class if ambiguous."""
        if self.verdict == NAMED:
            return (self.effects,)
        if self.verdict != AMBIGUOUS:
            return ()
        sets, sum_ = [frozenset({one}) for one in sorted(self.effects)], 0.0
        for effects, probability in self.ranking:
            if sum_ >= CLASS_PROBABILITY:
                break
            sum_ += probability
            if effects and effects not in sets:
                sets.append(effects)
        return tuple(sets)


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def merged(effects: Effects, channels: Effects) -> Effects:
    """Return `effects` with aliases under one name: of effects joined by pairs, the first by the alphabet."""
    names = {name: name for pair, _ in ALIASES for name in pair}
    for pair, separated_by in ALIASES:
        if separated_by in channels:
            continue
        first, second = sorted(names[name] for name in pair)
        names = {name: first if root == second else root for name, root in names.items()}
    return frozenset(names.get(effect, effect) for effect in effects)


def same(effects: Effects, key: Key) -> bool:
    """Return whether a set of effects is the hidden one, aliases merged."""
    return merged(effects, key.channels) == merged(key.effects, key.channels)


def top_right(answer: Answer, key: Key) -> bool:
    """Return whether the first answer is right: the verdict if nothing or an unlisted effect is hidden, else the name.

    Of an ambiguous verdict the first of the ranking counts.
    """
    if key.kind == "nothing":
        return answer.verdict == NONE
    if key.kind == "unlisted":
        return answer.verdict == UNKNOWN
    if answer.verdict == NAMED:
        return same(answer.effects, key)
    return answer.verdict == AMBIGUOUS and bool(answer.ranking) and same(answer.ranking[0][0], key)


def set_right(answer: Answer, key: Key) -> bool:
    """Return whether the answer, or one of the alternatives of a small declared class, is right."""
    small = len(answer.alternatives) <= LARGEST_CLASS
    return top_right(answer, key) or (
        bool(key.effects) and small and any(same(one, key) for one in answer.alternatives))


def wrong_name(answer: Answer, key: Key) -> bool:
    """Return whether an effect was named that is not hidden, aliases merged."""
    return answer.verdict == NAMED and not merged(answer.effects, key.channels) <= merged(key.effects, key.channels)


def both_found(answer: Answer, key: Key) -> bool:
    """Return whether all hidden effects are in the name, or in one alternative of a small declared class."""
    small = len(answer.alternatives) <= LARGEST_CLASS
    return small and any(merged(key.effects, key.channels) <= merged(one, key.channels)
                         for one in answer.alternatives)


def verdict_right(answer: Answer, key: Key) -> bool:
    """Return whether the verdict holds: the event that the stated probability is of.

    "None" also holds where what is hidden cannot be seen (total signal-to-noise under `VISIBLE`).
    """
    if answer.verdict == NONE:
        return key.kind == "nothing" or key.total_signal < VISIBLE
    if answer.verdict == UNKNOWN:
        return key.kind == "unlisted"
    return set_right(answer, key) and key.kind in ("single", "pair")


def located(answer: Answer, key: Key) -> bool:
    """Return whether every block that is named is one in which something is hidden.

    A diagnosis says "contact law and excitation" where the key has ``contact`` and ``excitation``.
    """
    named = {part.removesuffix(" law") for part in answer.block.split(" and ") if part}
    return bool(named) and named <= key.blocks


def covered(answer: Answer, key: Key) -> dict[str, bool]:
    """Return, for each stated parameter whose truth is known, whether its interval holds it."""
    return {name: low <= key.parameters[name] <= high
            for name, (_, low, high) in answer.parameters.items() if name in key.parameters}
