"""What an effect is: the protocol of every file in this room, and of users' own.

An effect is a table of the case file, ``[effects.<id>]``; its fields are its parameters. It acts through the methods
below, each of which does nothing unless it is overridden:

- `period` changes the problem of one period (friction, load, gap, joint, forces on the rig, excitation);
- `initial_memory`, `evolve` and `wear_factor` act over cycles;
- `bolted` changes a structure's joint, where frequency and damping of its modes were recorded over amplitude;
- `volume_laws` change the worn volumes of a series of tests;
- `sense` changes what the sensors show;
- `moved`, `limit`, `sliders` and `force` act where a measured motion drives the joint (recordings without a full
  model).

Derivatives by parameters need not be written: `model` differentiates the data of a problem, not its solution.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import Field

from fretflow.case.config import Section
from fretflow.core import units as u
from fretflow.core.errors import InputError
from fretflow.core.records import Array as Array
from fretflow.effects.sketches import Sketch as Sketch
from fretflow.effects.sketches import loop_sketch
from fretflow.recordings.kinds import RecordingKind as RecordingKind
from fretflow.recordings.kinds.joints import FRETTING_RIG, IMPOSED_DISPLACEMENT
from fretflow.recordings.kinds.joints import LUMPED as LUMPED
from fretflow.recordings.kinds.joints import STRUCTURE as STRUCTURE
from fretflow.structure.motion import Motion as Motion  # what effects need is in this file
from fretflow.structure.sensors import Signals

if TYPE_CHECKING:
    from fretflow.contact.interface import Interface
    from fretflow.effects.volume_law import VolumeLaw, WornTests
    from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
    from fretflow.solvers.periodic import PeriodicProblem
    from fretflow.structure.driven import Sliders
    from fretflow.wear.cycle import CycleResponse
    from fretflow.wear.slow import SlowState


class Block(StrEnum):
    """The part of the model that an effect changes."""

    RIG = "rig"
    EXCITATION = "excitation"
    CONTACT = "contact"
    WEAR = "wear"
    GEOMETRY = "geometry"
    SENSOR = "sensor"


ALL_KINDS = frozenset({FRETTING_RIG, IMPOSED_DISPLACEMENT, LUMPED})
STRUCTURES = frozenset({STRUCTURE})
RIG_ONLY = frozenset({FRETTING_RIG})
DRIVEN = frozenset({IMPOSED_DISPLACEMENT, LUMPED})
INTERFACES = frozenset({FRETTING_RIG, IMPOSED_DISPLACEMENT})


@dataclass(frozen=True)
class Prior:
    """Plausible range of a parameter in SI, whether it spans decades, where the range is from, and where it acts.

    One that is `held` goes with the size of a joint that a motion drives, but is not fitted there.
    """

    low: float
    high: float
    logarithmic: bool
    source: str
    rig_only: bool = False
    held: bool = False
    neutral: float | None = None  # the value with which, all neutral ones alike, nothing changes
    periodic: bool = False  # whether values a range apart are the same, as angles a turn apart are


# What would show an effect, in words that every kind of recording shares.
OTHER_LOAD = "the same test at another normal load"
OTHER_RATES = "the same test at half and at twice the frequency"
OTHER_LENGTHS = "tests of one condition over several numbers of cycles,"
UNLOADED = "the channels at rest and with the specimens apart, before and after the test,"
ESTIMATE = "engineering estimate for SS304, 60 N, 1 mm², 100 Hz"


def parameter(default: float | None, meaning: str, low: float, high: float, *, source: str = "",
              neutral: float | None = None, logarithmic: bool | None = None, rig_only: bool = False,
              held: bool = False, periodic: bool = False, **limits: Any) -> Any:
    """Declare a parameter: default and range in SI, its meaning, and pydantic's limits (``ge=0.0``).

    A `source` of the range that is not given is the catalogue's estimate, or for users' effects the file they are in.
    With the `neutral` values of all parameters that have one, the effect changes nothing.
    A range that lies on one side of zero and spans more than a decade counts as logarithmic, unless said otherwise.
    One that acts in the fretting rig only is not fitted where a measured motion drives the joint, nor is one that is
    `held` there, as the force tells only its ratio to another one. Values of a `periodic` one that lie a range apart
    are the same.

    Examples
    --------
    >>> import fretflow as ff
    >>> class Grip(ff.Effect):
    ...     strength: float = ff.parameter(0.2, "a: rise of the friction", 0.05, 0.5, neutral=0.0, gt=-1.0)
    >>> Grip().strength, Grip.priors()["strength"].high, Grip.neutral().strength
    (0.2, 0.5, 0.0)
    """
    if not low < high:
        raise InputError(f"parameter {meaning!r}: its range, {low} to {high}, must rise")
    decades = low > 0.0 and high / low >= 10.0
    prior = Prior(low, high, decades if logarithmic is None else logarithmic, source, rig_only, held, neutral,
                  periodic)
    return Field(default, description=meaning, json_schema_extra={"prior": prior}, **limits)  # type: ignore[dict-item]


@cache
def declared_priors(section: type[Section]) -> Mapping[str, Prior]:
    """Return the ranges of the fields of `section` that `parameter` declared."""
    extras = {name: info.json_schema_extra for name, info in section.model_fields.items()}
    priors: dict[str, Prior] = {name: extra["prior"] for name, extra in extras.items()  # type: ignore[misc]
                                if isinstance(extra, dict) and "prior" in extra}
    return MappingProxyType({name: prior if prior.source else replace(prior, source=_whose_range(section, name))
                             for name, prior in priors.items()})


def _whose_range(section: type[Section], field: str) -> str:
    """Return who says the range of a field that does not say where it is from: the catalogue, or a user's file."""
    room = next(one for one in section.__mro__ if field in vars(one).get("__annotations__", {})).__module__
    if room.startswith(f"{__package__}."):
        return ESTIMATE
    file = getattr(sys.modules.get(room), "__file__", None)
    return f"stated in {Path(file).name if file else room}"


def parameter_limits(section: type[Section], field: str) -> tuple[float, float]:
    """Return the limits of a declared parameter, infinite where it has none.

    An excluded end is kept clear of by a billionth of the range.
    """
    prior, marks = declared_priors(section)[field], section.model_fields[field].metadata
    clear = 1e-9 * (prior.high - prior.low)
    low, high = -np.inf if u.smallest(marks) is None else clear, np.inf
    for limit in marks:
        if isinstance(limit, Ge | Gt):
            low = float(limit.ge) if isinstance(limit, Ge) else float(limit.gt) + clear  # type: ignore[arg-type]
        elif isinstance(limit, Le | Lt):
            high = float(limit.le) if isinstance(limit, Le) else float(limit.lt) - clear  # type: ignore[arg-type]
    return low, high


class RecordedSize(NamedTuple):
    """The largest modal amplitude of a backbone (m kg^0.5), the damping ratio there, and the least damping ratio."""

    amplitude: float
    damping: float
    least_damping: float


class Effect(Section):
    """One effect; subclasses set the class variables and override what they need.

    Parameters are fields made by `parameter`, in SI, or given as text with a unit. ``docs/effects.md`` tells which
    method acts where, `examples/own_effect.py` shows a whole one.

    Examples
    --------
    >>> import fretflow as ff
    >>> delay = ff.catalogue()["channel-delay"]()
    >>> delay.changed(delay=50e-6).delay  # s
    5e-05
    """

    id: ClassVar[str]
    title: ClassVar[str]
    block: ClassVar[Block]
    equation: ClassVar[str]
    formula: ClassVar[str] = ""  # the equation in LaTeX, for pages that set it
    source: ClassVar[str]  # of the equation, in the literature
    observables: ClassVar[tuple[str, ...]]  # that show it, most telling first
    kinds: ClassVar[frozenset[RecordingKind]] = RIG_ONLY
    excludes: ClassVar[Mapping[str, str]] = {}  # ids that it cannot work with, and why
    needs_time: ClassVar[bool] = False  # whether it acts by rates or times, which points off a figure lack
    told_by: ClassVar[str] = ""  # the measurement that shows it besides those recorded
    told_from: ClassVar[Mapping[str, str]] = {}  # ids that act alike, and what would tell it from each; once a pair
    confirmed_by: ClassVar[str] = ""  # the sentence of what would confirm it where it is named alone
    over_cycles: ClassVar[bool] = False  # whether `period` follows cycles, energy or memory
    acts_at: ClassVar[int] = 0  # when `period` acts: 1 after those that change gap, load or layers, which it depends on
    first_order: ClassVar[bool] = True  # whether its change of the data tells how the period will change
    smooth: ClassVar[str] = ""  # the parameter whose large values smooth its corners, at which it strikes the bodies
    chances: ClassVar[int] = 0  # how many things it leaves to chance within a period: `drawn` takes them
    sensed_at: ClassVar[int] = 0  # where `sense` acts: 0 at the joint, 1 in the force path, 2 in the channels

    @classmethod
    def neutral(cls) -> Self:
        """Return the effect with its neutral parameters: nothing changes.

        Raises
        ------
        InputError
            If no parameter says its neutral value.
        """
        values = {name: prior.neutral for name, prior in cls.priors().items() if prior.neutral is not None}
        if not values:
            raise InputError(f"effect {cls.id}: no parameter says with what it changes nothing; give one neutral=0.0")
        return cls().changed(**values)

    @classmethod
    def plainest(cls) -> Self:
        """Return the effect with parameters at which it does no more than a law that it extends, if there is one."""
        return cls.neutral()

    @classmethod
    def priors(cls) -> Mapping[str, Prior]:
        """Return the range of every parameter that has one."""
        return declared_priors(cls)

    def changed(self, **values: float | None) -> Self:
        """Return the effect with other values (SI) of some parameters."""
        return self.model_copy(update=values)

    def sketch(self) -> Sketch:
        """Return a small picture of what the effect does; by default a loop without and with it."""
        return loop_sketch(self)

    # Within the period

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Return `problem` with the effect in it; changes of effects that act at the same commute.

        The gap of `problem` includes the wear of `slow`.
        """
        return problem

    def drawn(self, deviations: Array) -> Self:
        """Return the effect with each of the `chances` that it leaves so many standard deviations off."""
        return self

    @classmethod
    def acts_in(cls) -> frozenset[RecordingKind]:
        """Return the kinds of recordings that it is looked for in: its `kinds`, and structures where it is `bolted`."""
        return cls.kinds | STRUCTURES if "bolted" in vars(cls) else cls.kinds

    # In a bolted structure whose modes are recorded over their amplitude

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Return a bolted joint with the effect in it; it acts on structures if it overrides this."""
        return joint

    def bolted_anew(self, joint: BoltedJoint, draw: int) -> BoltedJoint:
        """Return a bolted joint with the effect in it as it may be as well, where chance decides: one of many draws."""
        return self.bolted(joint)

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior | None:
        """Return the range of a parameter at the size of a bolted joint; None of one that does nothing there.

        Parameters
        ----------
        field, prior
            Which parameter, and its range on the rig.
        joint
            The joint without effects, its parameters in the middle of their ranges.
        recorded
            How large the motions and the damping of the backbone are.
        """
        return prior

    # Over cycles

    def initial_memory(self, interface: Interface) -> dict[str, Array]:
        """Return what the effect remembers at the start, under names that begin with its id."""
        return {}

    def evolve(self, before: SlowState, cycles: float, worn: Array, energy: float, response: CycleResponse
               ) -> dict[str, Array]:
        """Return the effect's memory after a jump, by names that begin with its id and end in the unit.

        Parameters
        ----------
        before
            The joint before the jump: cycles, depth (nodes,) in m, energy in J and memory, the arrays by name.
        cycles, worn, energy
            What the jump adds: cycles, depth (nodes,) in m of both faces, dissipated energy in J.
        response
            The period that stands for the jump.
        """
        return {}

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array | float:
        """Return the factor on the wear rate, () or (nodes,)."""
        return 1.0

    def opening_share(self, slow: SlowState, cycles: float) -> Array | float:
        """Return the share of a jump's wear that opens the gap, () or (nodes,); a debris layer keeps some closed."""
        return 1.0

    def layer(self, slow: SlowState) -> Array | float:
        """Return the thickness of what lies between the faces, () or (nodes,), m."""
        return 0.0

    @classmethod
    def worn_range(cls, field: str, prior: Prior, depth: float, cycles: float) -> Prior:
        """Return the range of a parameter where the faces of a line contact wore by `depth` (m) in `cycles`."""
        return prior

    # Over a series of wear tests

    @classmethod
    def volume_laws(cls, tests: WornTests) -> tuple[VolumeLaw, ...]:
        """Return the forms of the effect's law of worn volumes that `tests` can tell, if there are any."""
        return ()

    # In the sensors

    def sense(self, signals: Signals) -> Signals:
        """Return what the sensors show of `signals`."""
        return signals

    # Where a measured motion drives the joint

    def moved(self, motion: Motion) -> Motion:
        """Return the motion that reaches the contact."""
        return motion

    def limit(self, motion: Motion) -> tuple[Array | float, Array | float]:
        """Return the factors on the friction limit for sliding to positive and to negative x, () or (N,)."""
        return 1.0, 1.0

    def sliders(self, sliders: Sliders) -> Sliders:
        """Return the friction elements in place of `sliders`."""
        return sliders

    def force(self, motion: Motion) -> Array | float:
        """Return the force that is added to the friction, () or (N,) in N, positive against positive motion."""
        return 0.0


def in_acting_order(effects: Iterable[Effect]) -> list[Effect]:
    """Return `effects` as they change a problem or a bolted joint one after the other, then by id."""
    return sorted(effects, key=lambda effect: (effect.acts_at, effect.id))


def in_sensors_alone(kind: type[Effect]) -> bool:
    """Tell whether an effect changes nothing but what the sensors show."""
    return kind.sense is not Effect.sense and kind.period is Effect.period
