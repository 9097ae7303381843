"""Laws of the worn volume over a series of tests, and their fit.

The baseline is Archard's law in its energy form, ``V = alpha E`` with one coefficient; the effects' laws act on it.

Scatter grows with the volume by a power that is not known beforehand, so that both sides of a law are transformed
alike, ``h(V) = h(M) + noise`` with ``h(V) = G^(1 - lambda) V^lambda / lambda`` (G ln V at zero), G the geometric mean
(R. J. Carroll, D. Ruppert, J. Am. Stat. Assoc. 79 (1984) 321-328).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fretflow.effects.volume_law import LawParameter, VolumeLaw, WornTests

Array = NDArray[np.float64]

POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)  # lambda: 0 is scatter in proportion to the volume, 1 scatter of one size
NOTHING = 1e-9  # of the usual volume: no wear at all, of which there is no logarithm
STEEPEST = 30.0  # of a logarithm of a factor


@dataclass(frozen=True)
class Tests(WornTests):
    """What a law is fitted to, n tests."""

    __test__: ClassVar[bool] = False

    power: float = 0.0  # lambda
    scale: float = 1.0  # G in m^3

    @property
    def count(self) -> float:
        """Return how many independent tests there are."""
        return float(self.weight.sum())

    def transformed(self, volume: Array) -> Array:
        """Return h(volume), (n,), m^3."""
        volume = np.maximum(volume, NOTHING * self.scale)
        if self.power == 0.0:
            return np.asarray(self.scale * np.log(volume))
        return np.asarray(self.scale**(1.0 - self.power) * volume**self.power / self.power)

    def residual(self, model: Array) -> Array:
        """Return h(measured) - h(model), (n,), m^3."""
        return self.transformed(self.volume) - self.transformed(model)

    def square(self, model: Array) -> float:
        """Return the weighted sum of squares, m^6."""
        return float(self.weight @ self.residual(model)**2)

    def some(self, kept: NDArray[np.bool_]) -> Tests:
        """Return some of the tests, transformed as all are."""
        return Tests(self.volume[kept], self.energy[kept], {name: x[kept] for name, x in self.states.items()},
                     self.varied, self.weight[kept], self.power, self.scale)


@dataclass(frozen=True)
class Law:
    """Archard's law with those of effects, in the order in which they act."""

    laws: tuple[VolumeLaw, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the effects that it adds, sorted."""
        return tuple(sorted(one.effect for one in self.laws))

    @property
    def states(self) -> tuple[str, ...]:
        """Return the states that it has powers of."""
        return tuple(name for one in self.laws for name in one.powers)

    @property
    def parameters(self) -> tuple[LawParameter, ...]:
        """Return the parameters of the effects."""
        return tuple(own for one in self.laws for own in one.parameters)

    @property
    def size(self) -> int:
        """Return the number of parameters, the coefficient among them."""
        return 1 + len(self.parameters)

    @property
    def linear(self) -> bool:
        """Return whether its logarithm is linear in all parameters."""
        return all(one.powers for one in self.laws)

    def inner(self, values: Sequence[float]) -> Array:
        """Return parameters of the effects as they are fitted, logarithms where they span decades."""
        return np.array([np.log(v) if own.logarithmic else v for own, v in zip(self.parameters, values, strict=True)])

    def values(self, value: Array) -> Array:
        """Return the parameters of the effects in SI, where `value` holds ln alpha and theirs as they are fitted."""
        return np.array([np.exp(np.clip(v, -300.0, 300.0)) if own.logarithmic else v
                         for own, v in zip(self.parameters, value[1:], strict=True)])

    def predict(self, tests: Tests, value: Array) -> Array:
        """Return the worn volume (n,), m^3; `value` holds ln alpha and the effects' parameters as they are fitted."""
        middle = float(np.log(np.median(tests.volume / tests.energy)))
        volume = tests.energy * np.exp(np.clip(value[0], middle - STEEPEST, middle + STEEPEST))
        values, at = self.values(value), 0
        for one in self.laws:
            volume = one.wear(volume, tests.states, values[at:at + len(one.parameters)])
            at += len(one.parameters)
        return np.asarray(volume)


@dataclass(frozen=True)
class LawFit:
    """A law at its best."""

    law: Law
    value: Array
    square: float  # m^6
    jacobian: Array  # (n, size) of the weighted residual

    def predict(self, tests: Tests) -> Array:
        """Return the worn volume (n,), m^3."""
        return self.law.predict(tests, self.value)


def fit(law: Law, tests: Tests, near: Array | None = None) -> LawFit:
    """Return the law with the least squares, begun from either end of its parameters' ranges.

    Parameters
    ----------
    near : array, optional
        Parameters to begin from instead.
    """
    root = np.sqrt(tests.weight)
    if law.linear:
        found = _fit_powers(_design(law, tests), tests, near)
    else:
        def left(value: Array) -> Array:
            return np.asarray(root * tests.residual(law.predict(tests, value)) / tests.scale)

        starts = [near] if near is not None else _starts(law, tests)
        found = min((least_squares(left, start, method="lm", x_scale="jac", max_nfev=400) for start in starts),
                    key=lambda one: float(one.cost))
    square = float(2.0 * found.cost) * tests.scale**2
    return LawFit(law, np.asarray(found.x), square, np.asarray(found.jac) * tests.scale)


def _design(law: Law, tests: Tests) -> Array:
    """Return the derivatives (n, k) of the logarithm of the volume by ln alpha and the exponents."""
    alone = np.ones(len(tests.energy))
    columns = [np.log(one.wear(alone, tests.states, own)) for one in law.laws for own in np.eye(len(one.powers))]
    return np.stack([alone, *columns], axis=1)


def _linear(design: Array, tests: Tests) -> Array:
    root = np.sqrt(tests.weight)
    return np.asarray(np.linalg.lstsq(design * root[:, None], root * np.log(tests.volume / tests.energy),
                                      rcond=None)[0])


def _starts(law: Law, tests: Tests) -> list[Array]:
    powers = Law(tuple(one for one in law.laws if one.powers))
    begin = _linear(_design(powers, tests), tests)
    ends = [law.inner([getattr(own, end) for own in law.parameters]) for end in ("low", "high")]
    for end in ends:  # laws with powers come first
        end[:len(begin) - 1] = begin[1:]
    return [np.r_[begin[0], end] for end in ends]


def _fit_powers(design: Array, tests: Tests, near: Array | None = None) -> Any:
    """Return the least squares of ``V = E exp(design b)``, with ``dh/db = G (M / G)^lambda design``."""
    root = np.sqrt(tests.weight)
    middle = float(np.log(np.median(tests.volume / tests.energy)))

    def model(b: Array) -> Array:
        return np.asarray(tests.energy * np.exp(np.clip(design @ b, middle - STEEPEST, middle + STEEPEST)))

    return least_squares(lambda b: root * tests.residual(model(b)) / tests.scale,
                         _linear(design, tests) if near is None else near,
                         lambda b: -(root * (model(b) / tests.scale)**tests.power)[:, None] * design,
                         method="lm", x_scale="jac", max_nfev=200)


def curve_square(design: Array, tests: Tests) -> float:
    """Return the least sum of squares of ``V = E exp(design b)``, m^6; the `design` (n, k) has full rank."""
    return float(2.0 * _fit_powers(design, tests).cost) * tests.scale**2
