"""Laws of the worn volume over a series of tests, and their fit.

The baseline is Archard's law in its energy form, ``V = alpha E`` with one coefficient. An effect multiplies it by
powers of conditions, ``(x / x_0)^a``, or by a shape of its own; all are written for the mean of a contact.

Scatter grows with the volume by a power that is not known beforehand, so that both sides of a law are transformed
alike, ``h(V) = h(M) + noise`` with ``h(V) = G^(1 - lambda) V^lambda / lambda`` (G ln V at zero), G the geometric mean
(R. J. Carroll, D. Ruppert, J. Am. Stat. Assoc. 79 (1984) 321-328).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)  # lambda: 0 is scatter in proportion to the volume, 1 scatter of one size
LEAST_SHARE = 0.02  # of the wear, below a threshold: what is lost or read there all the same; keeps its logarithm
NOTHING = 1e-9  # of the usual volume: no wear at all, of which there is no logarithm
STEEPEST = 30.0  # of a logarithm of a factor


@dataclass(frozen=True)
class Tests:
    """What a law is fitted to, n tests; `weight` is one over how often a test stands in the table."""

    __test__: ClassVar[bool] = False

    volume: Array  # (n,), m^3
    energy: Array  # (n,), J
    states: Mapping[str, Array]  # by name, (n,)
    weight: Array  # (n,)
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
                     self.weight[kept], self.power, self.scale)


class Shape(ABC):
    """What changes a worn volume other than by powers; its parameters are logarithms."""

    effect: ClassVar[str]
    needs: ClassVar[tuple[str, ...]]  # states
    names: ClassVar[tuple[str, ...]]  # full names of the parameters
    units: ClassVar[tuple[str, ...]]
    meanings: ClassVar[tuple[str, ...]]

    @abstractmethod
    def volume(self, plain: Array, tests: Tests, sizes: Array) -> Array:
        """Return the volume (n,) where the law without the shape wears `plain`; `sizes` are the parameters."""

    @abstractmethod
    def starts(self, tests: Tests) -> Sequence[tuple[float, ...]]:
        """Return parameters from which a fit begins."""

    @abstractmethod
    def weak(self, tests: Tests) -> tuple[float, ...]:
        """Return parameters at which the effect is small on these tests."""

    def size(self, weak: tuple[float, ...]) -> float:
        """Return the size of a small effect, in the unit of the first plausible range; nan where that has another."""
        return weak[0]


class Threshold(Shape):
    """No wear below a frictional power density: ``1 - q_th / q``."""

    effect = "wear-threshold"
    needs = ("power density",)
    names = ("wear-threshold.power_density",)
    units = ("W/m^2",)
    meanings = ("q_th: power per area below which nothing wears",)

    def volume(self, plain: Array, tests: Tests, sizes: Array) -> Array:
        """Return the volume by the power beyond the threshold."""
        return np.asarray(plain * np.maximum(1.0 - sizes[0] / tests.states["power density"], LEAST_SHARE))

    def starts(self, tests: Tests) -> Sequence[tuple[float, ...]]:
        """Return thresholds from below the least to among the lower powers."""
        q = tests.states["power density"]
        return tuple((float(share * at),) for share, at in ((0.5, q.min()), (0.95, q.min()),
                                                             (0.95, np.quantile(q, 0.25))))

    def weak(self, tests: Tests) -> tuple[float, ...]:
        """Return a threshold far below the least power."""
        return (0.01 * float(tests.states["power density"].min()),)


class Debris(Shape):
    """Debris that stays and keeps the faces apart: ``dV/dE = alpha exp(-V / V_0)``, so ``V_0 ln(1 + alpha E / V_0)``.

    It is the catalogue's third body while all its debris stays, with V_0 = A h_0 / phi.
    """

    effect = "third-body"
    needs = ()
    names = ("third-body.separating_volume",)
    units = ("m^3",)
    meanings = ("V_0 = A h_0 / phi: worn volume at which wear has fallen to 1/e",)

    def volume(self, plain: Array, tests: Tests, sizes: Array) -> Array:
        """Return the volume that has slowed itself down."""
        return np.asarray(sizes[0] * np.log1p(plain / sizes[0]))

    def starts(self, tests: Tests) -> Sequence[tuple[float, ...]]:
        """Return volumes about the measured ones."""
        middle = float(np.median(tests.volume))
        return ((0.3 * middle,), (3.0 * middle,))

    def weak(self, tests: Tests) -> tuple[float, ...]:
        """Return a volume far above all."""
        return (100.0 * float(tests.volume.max()),)

    def size(self, weak: tuple[float, ...]) -> float:
        """Return nan: the catalogue's thickness takes the area of the contact."""
        return float("nan")


class RunIn(Shape):
    """A coefficient that goes from 1 to x over cycles; over N of them ``x + (1 - x) (n_K / N) (1 - exp(-N / n_K))``."""

    effect = "wear-coefficient-evolution"
    needs = ("cycles",)
    names = ("wear-coefficient-evolution.final_share", "wear-coefficient-evolution.settling")
    units = ("1", "1")
    meanings = ("x: coefficient in the end over that at the start", "n_K: cycles over which it changes")

    def volume(self, plain: Array, tests: Tests, sizes: Array) -> Array:
        """Return the volume by the mean coefficient over each test's cycles."""
        passed = tests.states["cycles"] / sizes[1]
        return np.asarray(plain * (sizes[0] - (1.0 - sizes[0]) * np.expm1(-passed) / passed))

    def starts(self, tests: Tests) -> Sequence[tuple[float, ...]]:
        """Return falling and rising coefficients."""
        middle = float(np.median(tests.states["cycles"]))
        return ((0.3, 0.3 * middle), (3.0, middle))

    def weak(self, tests: Tests) -> tuple[float, ...]:
        """Return a coefficient that hardly changes."""
        return 0.99, float(np.median(tests.states["cycles"]))

    def size(self, weak: tuple[float, ...]) -> float:
        """Return how far the coefficient goes from where it began."""
        return abs(1.0 - weak[0])


SHAPES: tuple[Shape, ...] = (Threshold(), Debris(), RunIn())
POWER_LAW = "wear-power-law"


@dataclass(frozen=True)
class Law:
    """Archard's law with powers of `states`, and a shape."""

    states: tuple[str, ...] = ()
    shape: Shape | None = None

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the effects that it adds, sorted."""
        return tuple(sorted(([POWER_LAW] if self.states else []) + ([self.shape.effect] if self.shape else [])))

    @property
    def size(self) -> int:
        """Return the number of parameters, the coefficient among them."""
        return 1 + len(self.states) + (len(self.shape.names) if self.shape else 0)

    def predict(self, tests: Tests, references: Mapping[str, float], value: Array) -> Array:
        """Return the worn volume (n,), m^3; `value` holds ln alpha, the exponents and the logarithms of the shape's."""
        m = 1 + len(self.states)
        logs = value[0] + sum((a * np.log(tests.states[name] / references[name])
                               for name, a in zip(self.states, value[1:m], strict=True)), np.zeros(len(tests.energy)))
        middle = float(np.log(np.median(tests.volume / tests.energy)))
        plain = tests.energy * np.exp(np.clip(logs, middle - STEEPEST, middle + STEEPEST))
        if self.shape is None:
            return np.asarray(plain)
        return self.shape.volume(plain, tests, np.exp(np.clip(value[m:], -300.0, 300.0)))


@dataclass(frozen=True)
class LawFit:
    """A law at its best."""

    law: Law
    references: Mapping[str, float]  # of the states, at which the powers are 1
    value: Array
    square: float  # m^6
    jacobian: Array  # (n, size) of the weighted residual

    def predict(self, tests: Tests) -> Array:
        """Return the worn volume (n,), m^3."""
        return self.law.predict(tests, self.references, self.value)


def references_of(tests: Tests) -> dict[str, float]:
    """Return the geometric means of the states."""
    return {name: float(np.exp(np.average(np.log(x), weights=tests.weight))) for name, x in tests.states.items()}


def fit(law: Law, tests: Tests, references: Mapping[str, float], near: Array | None = None) -> LawFit:
    """Return the law with the least squares, begun from logarithms that a linear fit gives and the shape's own starts.

    Parameters
    ----------
    near : array, optional
        Parameters to begin from instead.
    """
    root = np.sqrt(tests.weight)
    if law.shape is None:
        found = _fit_powers(_design(law, tests, references), tests, near)
    else:
        def left(value: Array) -> Array:
            return np.asarray(root * tests.residual(law.predict(tests, references, value)) / tests.scale)

        starts = [near] if near is not None else _starts(law, tests, references)
        found = min((least_squares(left, start, method="lm", x_scale="jac", max_nfev=400) for start in starts),
                    key=lambda one: float(one.cost))
    square = float(2.0 * found.cost) * tests.scale**2
    return LawFit(law, references, np.asarray(found.x), square, np.asarray(found.jac) * tests.scale)


def _design(law: Law, tests: Tests, references: Mapping[str, float]) -> Array:
    columns = [np.log(tests.states[name] / references[name]) for name in law.states]
    return np.stack([np.ones(len(tests.energy)), *columns], axis=1)


def _linear(design: Array, tests: Tests) -> Array:
    root = np.sqrt(tests.weight)
    return np.asarray(np.linalg.lstsq(design * root[:, None], root * np.log(tests.volume / tests.energy),
                                      rcond=None)[0])


def _starts(law: Law, tests: Tests, references: Mapping[str, float]) -> list[Array]:
    linear = _linear(_design(law, tests, references), tests)
    return [np.r_[linear, np.log(sizes)] for sizes in (() if law.shape is None else law.shape.starts(tests))]


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
