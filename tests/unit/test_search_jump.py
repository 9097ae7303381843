"""A motion that jumps: what explains it until then is fitted first, and leads to all of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.parameters import Array
from fretflow.inference.search import FAST
from fretflow.inference.strategy import run_search, start_search
from waves import LOOPS, SAMPLES, Waves, cosine, measurement, wave

LAST = np.repeat(np.arange(LOOPS), SAMPLES) >= LOOPS - 2
TRUE = 0.55


@dataclass(frozen=True)
class Jumping(Waves):
    """Waves of which one turns round in the last loops, but near one size, beside which nothing leads there."""

    kept: Array = field(default_factory=lambda: np.ones(LOOPS * SAMPLES, dtype=bool))
    known: bool = True  # whether it is seen that the motion jumps

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the sum of the waves, with what the last loops jump by."""
        values = super().predict(point, near).values
        if "viscous" in point.effects - point.neutral:
            size = point.parameters.values(point.z)["viscous"]["size"]
            values = values + np.where(LAST, jump(size), 0.0) * wave("viscous")
        return Prediction(point, values[self.kept])

    def before_jump(self, leading: Prediction) -> Any:
        """Return the loops before the last ones."""
        own = self.measurement
        if not self.known or not self.kept.all():
            return None
        rows = ("values", "variance", "modes", "code_error", "repeatable", "channel", "phase", "group", "cycles",
                "condition")
        return replace(self, kept=~LAST, measurement=replace(
            own, **{name: getattr(own, name)[~LAST] for name in rows}))


def jump(size: float) -> float:
    """Return what a wave of a size jumps by in the last loops."""
    return -3.0 * size if size < 0.5 else 3.0 if size < 0.6 else 9.0


@pytest.mark.parametrize("known", [True, False])
def test_what_explains_a_test_until_it_jumps_leads_to_the_whole(known: bool) -> None:
    values = cosine() + (TRUE + np.where(LAST, jump(TRUE), 0.0)) * wave("viscous")
    experiment: Any = Jumping(measurement(values), known=known)
    first = experiment.predict(Point(experiment.parameters(()), np.zeros(1)))
    search = start_search(experiment, first, FAST, lambda function, arguments: [function(one) for one in arguments])
    run_search(search, lambda share, text: None)
    fit = search.fits[frozenset({"viscous"})]
    size = fit.parameters.values(fit.z)["viscous"]["size"]
    assert search.leaves_noise(frozenset({"viscous"})) is known
    if known:
        assert size == pytest.approx(TRUE, abs=0.02)
