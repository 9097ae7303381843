"""How far published forms of one law differ: the size of a law-form error, by itself.

Each family holds forms by which the literature writes one behaviour, as functions of a scaled state x from 0 to 1. One
form, with its own scales refitted, is taken for another; what is left, over the size of the law's whole change, is the
relative error that a catalogue makes which holds one of them. No recording has a part in it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.optimize import minimize_scalar

from fretflow.inference.parameters import Array

Form = Callable[[Array, float], Array]  # state, rate: the change

def families() -> tuple[tuple[Form, ...], ...]:
    """Return the forms of each behaviour: settling, falling with speed, growing."""
    # Run-in, settling and debris layers: exponential (P. J. Blau, Wear 71 (1981) 29-43), rational (a second-order
    # rate), hyperbolic tangent (of a regularised law), algebraic.
    settling: tuple[Form, ...] = (
        lambda x, a: 1.0 - np.exp(-a * x), lambda x, a: a * x / (1.0 + a * x), lambda x, a: np.tanh(a * x),
        lambda x, a: a * x / np.sqrt(1.0 + np.square(a * x)))
    # Friction that falls with speed: exponential and Gaussian (B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit,
    # Automatica 30 (1994) 1083-1138), rational (D. P. Hess, A. Soom, J. Tribol. 112 (1990) 147-152), linear.
    falling: tuple[Form, ...] = (
        lambda x, a: np.exp(-a * x), lambda x, a: np.exp(-np.square(a * x)), lambda x, a: 1.0 / (1.0 + a * x),
        lambda x, a: 1.0 / (1.0 + np.square(a * x)), lambda x, a: np.maximum(1.0 - a * x, 0.0))
    # Springs of asperities, friction by load, hardening edges: power (J. A. Greenwood, J. B. P. Williamson, Proc. R.
    # Soc. A 295 (1966) 300-319), exponential, with a cubic term, linear beyond a threshold.
    growing: tuple[Form, ...] = (
        lambda x, a: x**np.clip(a, 0.1, 5.0), lambda x, a: np.expm1(a * x) / np.expm1(a + 1e-9),
        lambda x, a: x + a * x**3, lambda x, a: np.maximum(x - 0.5 * np.tanh(a), 0.0))
    return settling, falling, growing


@cache
def law_form_errors() -> Array:
    """Return the relative errors (any,) of all pairs of forms within each family."""
    x, rates = np.linspace(0.0, 1.0, 101), (0.5, 1.0, 3.0)  # from a law that has barely bent to one that ran its course
    errors = [_left(true(x, rate), other, x) for family in families() for true in family
              for other in family if other is not true for rate in rates]
    return np.asarray(errors)


def density(sample: Array, at: Array) -> Array:
    """Return the shares (K,) of a sample of sizes around each of `at` (K,), smoothed in the logarithm.

    A Gaussian kernel of Silverman's width; sizes beyond the ends of `at` count at these.
    """
    logs, own = np.log(np.clip(sample, at[0], at[-1])), np.log(at)
    silverman = 1.06 * float(np.std(logs)) / float(len(logs)**0.2)
    width: float = max(silverman, float(own[1] - own[0]))
    weights = np.exp(-0.5 * np.square((own[:, None] - logs) / width)).sum(axis=1)
    return np.asarray(weights / weights.sum())


def _left(law: Array, form: Form, x: Array) -> float:
    """Return the rms that a form with refitted scale and rate leaves of a law, over the law's rms.

    The best scale at a rate follows at once (variable projection).
    """
    def left(log_rate: float) -> float:
        own = form(x, math.exp(log_rate))
        return 1.0 - float(law @ own)**2 / float(law @ law) / float(own @ own)

    starts = np.linspace(-9.0, 5.0, 57)  # laws that are straight, to laws that have run their course at once
    best = int(np.argmin([left(one) for one in starts]))
    ends = starts[max(best - 1, 0)], starts[min(best + 1, len(starts) - 1)]
    return math.sqrt(max(float(minimize_scalar(left, bounds=ends, method="bounded").fun), 0.0) + sys.float_info.epsilon)
