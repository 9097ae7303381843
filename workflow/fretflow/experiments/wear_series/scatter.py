"""How worn volumes of a series scatter, and how well laws with powers, or a smooth curve, can follow them.

Scatter grows with the volume by a power that is not known beforehand, so that both sides of a law are transformed
alike, ``h(V) = h(M) + noise`` with ``h(V) = G^(1 - lambda) V^lambda / lambda`` (G ln V at zero), G the geometric mean
(R. J. Carroll, D. Ruppert, J. Am. Stat. Assoc. 79 (1984) 321-328).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares

from fretflow.core.records import Array
from fretflow.effects.catalogue import catalogue
from fretflow.effects.volume_law import VolumeLaw, WornTests

POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)  # lambda: 0 is scatter in proportion to the volume, 1 scatter of one size


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
        volume = np.maximum(volume, np.finfo(float).eps * self.scale)
        if self.power == 0.0:
            return np.asarray(self.scale * np.log(volume))
        return np.asarray(self.scale**(1.0 - self.power) * volume**self.power / self.power)

    def residual(self, model: Array) -> Array:
        """Return h(measured) - h(model), (n,), m^3."""
        return self.transformed(self.volume) - self.transformed(model)

    def square(self, model: Array) -> float:
        """Return the weighted sum of squares, m^6."""
        return float(self.weight @ self.residual(model)**2)


def volume_laws(tests: Tests) -> dict[str, tuple[VolumeLaw, ...]]:
    """Return the laws that the effects have of such tests, by effect."""
    by_effect = {name: kind.volume_laws(tests) for name, kind in catalogue().items()}
    return {name: laws for name, laws in by_effect.items() if laws}


def power_designs(tests: Tests) -> dict[tuple[str, ...], Array]:
    """Return the derivatives (n, k) of ln V by ln alpha and exponents, by the states of which a law has powers."""
    alone = np.ones(len(tests.energy))
    laws = [one for own in volume_laws(tests).values() for one in own if one.powers]
    return {(): alone[:, None], **{one.powers: np.stack([alone, *(
        np.log(one.wear(alone, tests.states, own)) for own in np.eye(len(one.powers)))], axis=1) for one in laws}}


def curve_square(design: Array, tests: Tests) -> float:
    """Return the least sum of squares of ``V = E exp(design b)``, m^6; the `design` (n, k) has full rank.

    ``dh/db = G (M / G)^lambda design``; it begins from where all is proportional.
    """
    root, ratio = np.sqrt(tests.weight), np.log(tests.volume / tests.energy)
    begin = np.linalg.lstsq(design * root[:, None], root * ratio, rcond=None)[0]

    def model(b: Array) -> Array:  # no factor that the tests do not span twice
        return np.asarray(tests.energy * np.exp(np.clip(design @ b, 2.0 * ratio.min() - ratio.max(),
                                                        2.0 * ratio.max() - ratio.min())))

    fit = least_squares(lambda b: root * tests.residual(model(b)) / tests.scale, begin,
                        lambda b: -(root * (model(b) / tests.scale)**tests.power)[:, None] * design,
                        method="lm", x_scale="jac")
    return float(2.0 * fit.cost) * tests.scale**2
