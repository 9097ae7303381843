"""Scalar facts of a rig's tests: figures and statements as a paper gives them, each with its uncertainty.

::

    [test]
    kind = "facts"
    excitation_frequency = "100 Hz"
    excitation_amplitude = "53 N"
    normal_load = "60 N"
    cycles = 1_900_000
    [unknown]                     # 90 % ranges of what is to be found
    moving_mass = ["3 kg", "30 kg"]
    [[facts]]
    quantity = "sliding-distance"
    value = "14 um"
    sd = "0.7 um"
    [[facts]]
    quantity = "resonance-change"
    at_least = 0.0                # a statement: no more is known than that it lies beyond
    sd = 0.002

A fact with a `factor` in place of an `sd` is uncertain by that factor, one standard deviation up or down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from fretflow.case.config import ContactSection, Rig, Section, Specimens
from fretflow.case.sections import MOST_CYCLES
from fretflow.core import units as u
from fretflow.core.errors import did_you_mean
from fretflow.core.records import record
from fretflow.core.units import per_cent
from fretflow.recordings.description import Description, file_at, read_description, validated
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.kinds.structure_columns import parsed
from fretflow.recordings.notes import Note

FACTS = RecordingKind(
    "facts", "facts: figures and statements of a rig's tests with their uncertainty; the full model predicts each",
    "fretflow.experiments.facts.run:diagnose_facts", f"{__name__}:read_facts")
KINDS = (FACTS,)
CORNER = 0.75  # share of the half width from which on, in both directions, a place counts as corner
SETTLED_WITHIN = 0.1  # of the last rate
QUANTITIES = MappingProxyType({  # what a fact may be of: SI unit and meaning
    "sliding-distance": ("m", "relative displacement of the faces, peak to peak, mean of the test up to its cycles"),
    "resonance": ("Hz", "frequency of the largest motion of the driven block under the test's force"),
    "resonance-change": ("1", "that frequency over the unworn joint's, less one"),
    "corner-share": ("1", "share of the worn volume that lies in the corners of the contact, from "
                           f"{per_cent(CORNER)} of its half width on both ways"),
    "corner-depth-ratio": ("1", "worn depth in the corners over that of the whole contact"),
    "corner-depth-growth": ("1", "worn depth in the corners over that at the fact's `since`"),
    "settling-cycles": ("1", f"cycles from which on the wear rate stays within {per_cent(SETTLED_WITHIN)} of its last "
                             "value"),
    "slip-outside": ("1", "how much farther from the middle slip lies than stick while both occur in the unworn "
                          "joint, in half widths"),
    "stick-share": ("1", "share of the contact that never slips in a period of the unworn joint"),
    "wear-volume": ("m^3", "volume worn off both faces"),
    "wear-coefficient": ("m^2/N", "worn volume over normal load and path, that is twice the sliding distance a cycle"),
})
UNWORN = ("slip-outside", "stick-share")
PARAMETERS = MappingProxyType({"moving_mass": "kg", "friction_coefficient": "1", "wear_coefficient": "m^2/N",
                               "compliance": "1"})
CONDITIONS = ("excitation_amplitude", "normal_load", "excitation_frequency")


class FactsTest(Section):
    """The test that facts are of where they do not say otherwise."""

    kind: Literal["facts"]
    excitation_frequency: u.Frequency
    excitation_amplitude: u.Force
    normal_load: u.Force
    cycles: int = Field(ge=1, le=MOST_CYCLES, description="length of the test")


class Fact(Section):
    """One figure or statement, in SI."""

    quantity: str
    value: Any = None
    at_least: Any = None
    at_most: Any = None
    sd: Any = Field(None, description="one standard deviation, in the unit of the quantity")
    factor: float | None = Field(None, gt=1.0, description="one standard deviation up or down, as a factor")
    cycles: int | None = Field(None, ge=0, le=MOST_CYCLES, description="cycles before; by default the whole test")
    since: int | None = Field(None, ge=1, le=MOST_CYCLES, description="cycles that a growth counts from")
    excitation_amplitude: u.Force | None = None
    normal_load: u.Force | None = None
    excitation_frequency: u.Frequency | None = None
    says: str = Field("", description="what the source says, and where")

    @field_validator("quantity")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in QUANTITIES:
            raise ValueError(f"must be one of {', '.join(QUANTITIES)}, got {name!r}{did_you_mean(name, QUANTITIES)}")
        return name

    @model_validator(mode="before")
    @classmethod
    def _in_si(cls, given: Any) -> Any:
        if not isinstance(given, dict) or given.get("quantity") not in QUANTITIES:
            return given
        unit, converted = QUANTITIES[given["quantity"]][0], dict(given)
        for key in ("value", "at_least", "at_most", "sd"):
            if key in given:
                try:
                    converted[key] = parsed(given[key], unit)
                except ValueError as error:
                    raise ValueError(f"{key}: {error}") from error
        return converted

    @model_validator(mode="after")
    def _whole(self) -> Fact:
        if [self.value, self.at_least, self.at_most].count(None) != 2:
            raise ValueError("give one of value, at_least and at_most")
        if (self.sd is None) == (self.factor is None):
            raise ValueError("give one of sd and factor, its uncertainty")
        if self.sd is not None and not self.sd > 0.0:
            raise ValueError(f"sd: must be positive, got {self.sd:g}")
        if self.factor is not None and not self.stated > 0.0:
            raise ValueError(f"factor: is of a positive quantity, got {self.stated:g}; give an sd")
        if (self.quantity == "corner-depth-growth") != (self.since is not None):
            raise ValueError("since: belongs to a corner-depth-growth, which needs it")
        if self.quantity in UNWORN and self.cycles:
            raise ValueError(f"cycles: {self.quantity} is of the unworn joint")
        if self.since is not None and self.cycles is not None and self.since >= self.cycles:
            raise ValueError(f"since: {self.since:,} is no earlier than cycles, {self.cycles:,}")
        return self

    @property
    def stated(self) -> float:
        """Return the value or bound."""
        return float(next(one for one in (self.value, self.at_least, self.at_most) if one is not None))

    @property
    def side(self) -> int:
        """Return 1 for a lower bound, -1 for an upper one, 0 for a value."""
        return (self.at_least is not None) - (self.at_most is not None)

    def distance(self, value: float) -> float:
        """Return how many standard deviations `value` lies above what is stated."""
        if self.factor is None:
            return float((value - self.stated) / self.sd)
        return math.log(max(value, math.ulp(0.0)) / self.stated) / math.log(self.factor)

    @property
    def label(self) -> str:
        """Return the quantity with what tells it from others of its kind."""
        unit = QUANTITIES[self.quantity][0]
        sign = {1: "at least ", -1: "at most ", 0: ""}[self.side]
        at = f" at {self.excitation_amplitude:g} N" if self.excitation_amplitude else ""
        after = f" after {self.cycles:,} cycles" if self.cycles else ""
        return f"{self.quantity.replace('-', ' ')}{at}{after}: {sign}{u.pretty_quantity(self.stated, unit, 3)}"


class UnknownSection(Section):
    """What is to be found, each within a range that holds it by 90 %."""

    moving_mass: Any = Field(None, description="mass of the driven block")
    friction_coefficient: Any = None
    wear_coefficient: Any = None
    compliance: Any = Field(None, description="of the specimens, over that of the bodies as described")

    @model_validator(mode="before")
    @classmethod
    def _ranges(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        return {name: _range(name, pair) if name in PARAMETERS else pair for name, pair in given.items()}

    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the ranges that are given, in SI."""
        return {name: pair for name in PARAMETERS if (pair := getattr(self, name)) is not None}


def _range(name: str, pair: object) -> tuple[float, float]:
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError(f'{name}: {pair!r} is no range; give its two ends, such as ["5 kg", "20 kg"] or [0.5, 2.0]')
    try:
        low, high = (parsed(end, PARAMETERS[name]) for end in pair)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    if not 0.0 < low < high:
        raise ValueError(f"{name}: {pair!r}: the lower end must be positive and below the upper one")
    return low, high


class FactsFile(Description):
    """A whole file of facts."""

    test: FactsTest
    rig: Rig = Field(default_factory=Rig)
    specimen: Specimens = Field(default_factory=Specimens)
    contact: ContactSection = Field(default_factory=ContactSection)
    unknown: UnknownSection = Field(default_factory=UnknownSection)
    facts: tuple[Fact, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _within_the_test(self) -> FactsFile:
        for k, fact in enumerate(self.facts):
            if (fact.cycles or 0) > self.test.cycles or (fact.since or 0) >= self.cycles_of(fact) > 0:
                raise ValueError(f"facts.{k}: cycles lie beyond the {self.test.cycles:,} of the test")
        return self

    def cycles_of(self, fact: Fact) -> int:
        """Return the cycles before what a fact is of."""
        if fact.quantity in UNWORN:
            return 0
        return self.test.cycles if fact.cycles is None else fact.cycles

    def condition_of(self, fact: Fact) -> tuple[float, float, float]:
        """Return force, load and frequency of what a fact is of, in SI."""
        force, load, frequency = (getattr(fact, name) or getattr(self.test, name) for name in CONDITIONS)
        return force, load, frequency


@record
class FactsRecording:
    """Facts as they were read."""

    kind: ClassVar[RecordingKind] = FACTS

    path: Path
    title: str
    file: FactsFile
    notes: tuple[Note, ...] = ()


def read_facts(path: Path) -> FactsRecording:
    """Read a file of facts, or the folder that holds it.

    Raises
    ------
    CorruptRecordingError
        If it cannot be read.
    ConfigError
        Naming the file, the field and the way out.
    """
    toml = file_at(path)
    file = validated(FactsFile, read_description(toml), toml)
    return FactsRecording(path=path, title=file.title or toml.stem, file=file)
