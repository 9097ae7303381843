"""Parameters of a hypothesis as coordinates that are standard normal before anything was measured.

A range counts as the 90 % interval of its parameter; a logarithmic one that of its logarithm. A parameter that may have
either sign has its range on the side where the search begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from fretflow.core.records import Array as Array
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Effect, Prior, parameter_limits
from fretflow.recordings.periods import LEVEL

HALF = float(norm.ppf(0.95))  # standard deviations of half a 90 % interval
FARTHEST = 6.0  # standard deviations that a coordinate may go: beyond, the prior holds two of 1e9

# effect, field and its range: the range at the size of what was measured, None where it does nothing there
Scaled = Callable[[str, str, Prior], Prior | None]


@dataclass(frozen=True)
class Coordinate:
    """One parameter: of the baseline where `effect` is empty."""

    effect: str
    field: str
    middle: float
    size: float
    logarithmic: bool
    lowest: float = -math.inf
    highest: float = math.inf
    sign: float = 1.0
    chance: bool = False  # whether it is one of those that an effect leaves to chance, and nobody asks for

    @classmethod
    def within(cls, effect: str, field: str, low: float, high: float, logarithmic: bool, lowest: float = -math.inf,
               highest: float = math.inf, sign: float = 1.0) -> Coordinate:
        """Return a parameter that lies in a range by 90 %."""
        if logarithmic:
            low, high = math.log(low), math.log(high)
        return cls(effect, field, 0.5 * (low + high), (high - low) / (2.0 * HALF), logarithmic, lowest,
                   highest, sign)

    @property
    def name(self) -> str:
        """Return its full name."""
        return f"{self.effect}.{self.field}" if self.effect else f"baseline.{self.field}"

    @property
    def signed(self) -> bool:
        """Tell whether it may be on the other side of zero than its range."""
        return not self.logarithmic and self.lowest < 0.0 < self.highest and self.middle > 0.0

    def value(self, z: float) -> float:
        """Return the parameter at coordinate z."""
        z = min(max(z, -FARTHEST), FARTHEST)
        inner = self.middle + z * self.size
        value = self.sign * (math.exp(inner) if self.logarithmic else inner)
        return min(max(value, self.lowest), self.highest)

    def values(self, z: Array) -> Array:
        """Return the parameter at coordinates z (n,)."""
        return np.array([self.value(float(one)) for one in z])

    def place(self, value: float) -> float:
        """Return the coordinate of a parameter's value, within `FARTHEST`."""
        inner = self.sign * value
        if self.logarithmic:
            inner = math.log(max(inner, math.exp(self.middle - FARTHEST * self.size)))
        return min(max((inner - self.middle) / self.size, -FARTHEST), FARTHEST)


@dataclass(frozen=True)
class Parameters:
    """The coordinates of a hypothesis with given effects: first the baseline's, then theirs."""

    effects: tuple[str, ...]
    coordinates: tuple[Coordinate, ...]
    signs: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, baseline: Sequence[Coordinate], effects: Sequence[str], signs: Mapping[str, float] | None = None,
           scaled: Scaled | None = None, chances: bool = False) -> Parameters:
        """Return the coordinates of a baseline with `effects`.

        Parameters
        ----------
        baseline
            The baseline's own coordinates.
        effects
            Ids of the catalogue.
        signs
            Those of parameters that may have either, by full name; positive where not given.
        scaled
            Ranges of the catalogue, which are a fretting rig's, at the size of what was measured.
        chances
            Whether what effects leave to chance within a period has coordinates as well.
        """
        own = list(baseline)
        for name in sorted(effects):
            own += _of_effect(catalogue()[name], signs or {}, scaled)
            own += [Coordinate(name, str(number), 0.0, 1.0, False, chance=True)
                    for number in range(catalogue()[name].chances if chances else 0)]
        return cls(tuple(sorted(effects)), tuple(own), dict(signs or {}))

    @property
    def size(self) -> int:
        """Return the number of coordinates."""
        return len(self.coordinates)

    @cached_property
    def ends(self) -> Array:
        """Return the least and the largest coordinates (2, size): beyond, values are what they are there."""
        return np.array([[one.place(own) for own in ((one.lowest, one.highest)[::int(one.sign)])]
                         for one in self.coordinates]).reshape(-1, 2).T

    def values(self, z: Array) -> dict[str, dict[str, float]]:
        """Return the parameters' values in SI by effect (none: the baseline) and field at coordinates z (size,)."""
        values: dict[str, dict[str, float]] = {name: {} for name in ("", *self.effects)}
        for coordinate, at in zip(self.coordinates, z, strict=True):
            if not coordinate.chance:
                values[coordinate.effect][coordinate.field] = coordinate.value(float(at))
        return values

    def built(self, z: Array) -> tuple[Effect, ...]:
        """Return the effects at coordinates z (size,)."""
        values = self.values(z)
        return tuple(catalogue()[name]().changed(**values[name]).drawn(z[self.own(name) & self.chances])
                     for name in self.effects)

    @property
    def chances(self) -> NDArray[np.bool_]:
        """Return which coordinates (size,) are of what effects leave to chance."""
        return np.array([one.chance for one in self.coordinates], dtype=bool)

    def turned(self, z: Array) -> tuple[Parameters, Array]:
        """Return the same values with ranges on the side of zero where the parameters at coordinates z (size,) are."""
        coordinates, signs, at = list(self.coordinates), dict(self.signs), np.array(z, dtype=float)
        for place, one in enumerate(self.coordinates):
            value = one.value(float(z[place]))
            if one.signed and one.sign * value < 0.0:
                coordinates[place] = replace(one, sign=-one.sign)
                signs[one.name], at[place] = -one.sign, coordinates[place].place(value)
        return replace(self, coordinates=tuple(coordinates), signs=signs), at

    def own(self, effect: str) -> NDArray[np.bool_]:
        """Return which coordinates (size,) are those of an effect; of the baseline where its name is empty."""
        return np.array([one.effect == effect for one in self.coordinates], dtype=bool)


def is_bent(z: Array) -> NDArray[np.bool_]:
    """Tell which coordinates lie further out than all but one in a thousand (`LEVEL`) of their prior."""
    return np.asarray(2.0 * norm.sf(np.abs(z)) < LEVEL)


def _of_effect(kind: type[Effect], signs: Mapping[str, float], scaled: Scaled | None) -> list[Coordinate]:
    coordinates = []
    for name, stated in kind.priors().items():
        if getattr(kind(), name) is None:  # follows the case
            continue
        prior = stated if scaled is None else scaled(kind.id, name, stated)
        if prior is None:
            continue
        lowest, highest = parameter_limits(kind, name)
        sign = signs.get(f"{kind.id}.{name}", 1.0) if lowest < 0.0 <= prior.low else 1.0
        coordinates.append(Coordinate.within(
            kind.id, name, prior.low, prior.high, prior.logarithmic, lowest, highest, sign))
    return coordinates


def signed_fields(kind: type[Effect]) -> list[str]:
    """Return the parameters of an effect whose range is positive but which may be negative as well."""
    return [name for name, prior in kind.priors().items()
            if prior.low > 0.0 and parameter_limits(kind, name)[0] < 0.0]
