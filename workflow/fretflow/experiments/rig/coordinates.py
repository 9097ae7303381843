"""Parameters of a hypothesis as coordinates that are standard normal before anything was measured.

A range counts as the 90 % interval of its parameter; a logarithmic one that of its logarithm. A parameter that may have
either sign has its range on the side where the search begins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Effect, parameter_limits
from fretflow.experiments.rig.model import SPREAD, Hypothesis
from fretflow.experiments.rig.observation import Array

WIDTH = 3.29  # of a 90 % interval, in sd
FARTHEST = 4.0  # sd that a coordinate may go


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

    @property
    def name(self) -> str:
        """Return its full name."""
        return f"{self.effect}.{self.field}" if self.effect else f"baseline.{self.field}"

    def value(self, z: float) -> float:
        """Return the parameter at coordinate z."""
        z = min(max(z, -FARTHEST), FARTHEST)
        inner = self.middle + z * self.size
        value = self.sign * (math.exp(inner) if self.logarithmic else inner)
        return min(max(value, self.lowest), self.highest)


@dataclass(frozen=True)
class Space:
    """The coordinates of a hypothesis with given effects: first the baseline's, then theirs."""

    effects: tuple[str, ...]
    coordinates: tuple[Coordinate, ...]
    signs: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, effects: Sequence[str], signs: dict[str, float] | None = None) -> Space:
        """Return the space of `effects`; `signs` are those of parameters that may have either."""
        own = [Coordinate("", name, 0.0, sd, True) for name, sd in SPREAD.items()]
        for name in sorted(effects):
            own += _of_effect(catalogue()[name], signs or {})
        return cls(tuple(sorted(effects)), tuple(own), signs or {})

    @property
    def size(self) -> int:
        """Return the number of coordinates."""
        return len(self.coordinates)

    def hypothesis(self, z: Array) -> Hypothesis:
        """Return the hypothesis at coordinates z (size,)."""
        values: dict[str, dict[str, float]] = {name: {} for name in ("", *self.effects)}
        for coordinate, at in zip(self.coordinates, z, strict=True):
            values[coordinate.effect][coordinate.field] = coordinate.value(float(at))
        built = tuple(catalogue()[name]().changed(**values[name]) for name in self.effects)
        return Hypothesis(effects=built, **values[""])

    def beside(self, z: Array, step: float) -> list[Hypothesis]:
        """Return the hypotheses one step further along each coordinate, inward where a limit is near."""
        found = []
        for i in range(self.size):
            moved = np.array(z, dtype=float)
            moved[i] += step if z[i] <= 0.0 else -step
            found.append(self.hypothesis(moved))
        return found


def _of_effect(kind: type[Effect], signs: dict[str, float]) -> list[Coordinate]:
    found = []
    for name, prior in kind.priors().items():
        if getattr(kind(), name) is None:  # follows the case
            continue
        lowest, highest = parameter_limits(kind, name)
        if prior.logarithmic:
            low, high = math.log(prior.low), math.log(prior.high)
        else:
            low, high = prior.low, prior.high
        sign = signs.get(f"{kind.id}.{name}", 1.0) if lowest < 0.0 <= prior.low else 1.0
        found.append(Coordinate(kind.id, name, 0.5 * (low + high), (high - low) / WIDTH, prior.logarithmic, lowest,
                                highest, sign))
    return found


def signed_fields(kind: type[Effect]) -> list[str]:
    """Return the parameters of an effect whose range is positive but which may be negative as well."""
    return [name for name, prior in kind.priors().items()
            if prior.low > 0.0 and parameter_limits(kind, name)[0] < 0.0]
