"""What diagnoses of all experiments hold alike, made of a finished search and its verdict."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from fretflow.core.records import Array
from fretflow.inference.decision import Decision
from fretflow.inference.evidence import drawn
from fretflow.inference.parameters import HALF, Coordinate, Parameters
from fretflow.inference.search import Search
from fretflow.inference.verdict import Detection, Diagnosis, Estimate
from fretflow.inference.words import after_model
from fretflow.recordings.kinds import Recorded

Estimator = Callable[[Coordinate, float, float, Array], Estimate]  # of a coordinate, z, half its interval, draws of z


class Titled(Recorded, Protocol):
    """A recording that has a title."""

    @property
    def title(self) -> str:
        """Return what it is called."""
        ...


def diagnosed(recording: Titled, decision: Decision, detection: Detection, **own: Any) -> Diagnosis:
    """Return the diagnosis of a recording with its verdict; fields that are an experiment's `own` are given by name."""
    return Diagnosis(
        title=recording.title, recording=str(recording.path), kind=recording.kind.id, verdict=decision.verdict,
        effects=decision.effects, probability=decision.probability, ranking=decision.ranking, detection=detection,
        after_model=after_model(decision.verdict, decision.after), **own)


def share_left(search: Search, decision: Decision) -> float:
    """Return the share of what the baseline leaves that the model of the verdict leaves too."""
    return 1.0 - search.explained(decision.after) if decision.after else 1.0


def estimated(space: Parameters, mean: Array, covariance: Array, made: Estimator) -> tuple[Estimate, ...]:
    """Return parameters with their 90 % intervals from the mean (size,) and covariance of coordinates.

    What effects leave to chance is no parameter that anybody asks for.
    """
    return tuple(made(one, float(z), HALF * float(sd), draws) for one, z, sd, draws in zip(
        space.coordinates, mean, np.sqrt(np.diag(covariance)), drawn(mean, covariance), strict=True)
        if not one.chance)
