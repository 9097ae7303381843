"""What diagnoses of all experiments hold alike, made of a finished search and its verdict."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fretflow.core.records import Array
from fretflow.inference.evidence import drawn
from fretflow.inference.parameters import HALF, Coordinate, Parameters
from fretflow.inference.verdict import Estimate

Estimator = Callable[[Coordinate, float, float, Array], Estimate]  # of a coordinate, z, half its interval, draws of z


def estimated(space: Parameters, mean: Array, covariance: Array, made: Estimator) -> tuple[Estimate, ...]:
    """Return parameters with their 90 % intervals from the mean (size,) and covariance of coordinates.

    What effects leave to chance is no parameter that anybody asks for.
    """
    return tuple(made(one, float(z), HALF * float(sd), draws) for one, z, sd, draws in zip(
        space.coordinates, mean, np.sqrt(np.diag(covariance)), drawn(mean, covariance), strict=True)
        if not one.chance)
