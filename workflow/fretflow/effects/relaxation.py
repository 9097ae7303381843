"""What is left of a change on its way to its end: relaxation of an order, as reactions have.

With the share y that is left after x, counted in the scale of the start, ``dy/dx = -y^o``: an exponential for o = 1,
the rational 1 / (1 + x) for o = 2, a straight line to an end for o = 0 (P. Atkins, J. de Paula, Physical Chemistry,
10th ed. (2014), 20B: integrated rate laws). Published run-in laws are of orders about 1 and 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import boxcox, inv_boxcox

from fretflow.effects.effect import Array, parameter


def share_left(passed: Array | float, order: float) -> Array:
    """Return the share y that is left after `passed` x >= 0, of any shape."""
    if order == 1.0:
        return np.asarray(np.exp(-np.asarray(passed, dtype=float)))
    within = np.asarray(passed, dtype=float)
    if order < 1.0:
        within = np.minimum(within, 1.0 / (1.0 - order))  # nothing is left beyond
    return np.asarray(inv_boxcox(-within, 1.0 - order))


def mean_left(passed: Array | float, order: float) -> Array:
    """Return the mean of the share y from the start to `passed` x > 0: of y dx = -y^(1 - o) dy."""
    end = share_left(passed, order)
    return np.asarray(-boxcox(end, 2.0 - order) / np.asarray(passed, dtype=float))


def order_of_relaxation() -> Any:
    """Declare the order as a parameter of an effect."""
    return parameter(1.0, "o: order with which it settles, 1 exponentially, 2 as 1 / (1 + x)", 1.0, 2.0, ge=0.5, le=4.0,
                     logarithmic=True, source="published run-in laws, exponential to rational")
