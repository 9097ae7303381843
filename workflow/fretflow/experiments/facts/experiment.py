"""Scalar facts of tests under the inference engine: each one row, in units of its standard deviation.

A value y with its sd s is the row ``(y - model) / s``; one that is uncertain by a factor is compared by logarithms. Of
a bound nothing is known but that the quantity lies beyond it, the bound itself uncertain by s: with the quantity t
standard deviations beyond it the statement has the likelihood ``Phi(t)``, the distribution function of a normal
variable (a probit). Its row is the deviance residual ``sqrt(-2 ln Phi(t))`` (P. McCullagh, J. A. Nelder, Generalized
Linear Models (1989), section 2.4), whose square is what a least-squares fit has to have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, sqrt

import numpy as np
from scipy.special import log_ndtr

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue, described
from fretflow.effects.effect import in_sensors_alone
from fretflow.experiments.facts.model import Condition, worn_test
from fretflow.experiments.facts.quantities import quantity_of
from fretflow.experiments.independent import IndependentExperiment
from fretflow.experiments.rig.experiment import rig_effects
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.experiment import Measurement, Point, Prediction
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.recordings.kinds.facts import PARAMETERS, Fact, FactsFile
from fretflow.wear.history import WearSettings

MEANINGS = {"moving_mass": "mass of the driven block", "friction_coefficient": "friction coefficient",
            "wear_coefficient": "Archard wear coefficient",
            "compliance": "of the specimens, over that of the bodies as described"}


@dataclass(frozen=True)
class Shown:
    """What a hypothesis shows: the facts' quantities (M,) in SI, and the unworn resonance of each test, if it is known.

    A neighbour's resonance is sought beside it.
    """

    quantities: Array
    resonances: Mapping[tuple[float, float, float], float | None]


@dataclass(frozen=True)
class FactsExperiment(IndependentExperiment):
    """A rig's model against facts of its tests; `correction` (M,) is what the coarse model leaves out, in sd."""

    file: FactsFile
    rig: RigModel
    correction: Array
    code_error: Array  # (M, any), what is not known of it

    @classmethod
    def of(cls, file: FactsFile, rig: RigModel) -> FactsExperiment:
        """Return the experiment with a model whose numerical errors nothing tells."""
        size = len(file.facts)
        return cls(file, rig, np.zeros(size), np.zeros((size, 0)))

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Return the tests that the facts are of, each under other conditions."""
        counts: dict[tuple[float, float, float], set[int]] = {}
        for fact in self.file.facts:
            own = counts.setdefault(self.file.condition_of(fact), {1})
            own.update(one for one in (self.file.cycles_of(fact), fact.since) if one)
        return tuple(Condition(*key, tuple(sorted(own))) for key, own in counts.items())

    @cached_property
    def measurement(self) -> Measurement:
        """Return the facts in units of their sd, one row and one channel each."""
        facts, size = self.file.facts, len(self.file.facts)
        labels, every = tuple(fact.label for fact in facts), np.arange(size)
        return Measurement.of(np.array([_level(fact) for fact in facts]), np.ones(size), code_error=self.code_error,
                              channel=every, channels=labels, group=every, groups=labels)

    @property
    def modulations(self) -> Array:
        """Return the facts one by one: what a law of another form does to each is its own."""
        return np.eye(len(self.file.facts))

    def choice(self, effect: str) -> float:
        """Return zero: each effect has one law."""
        return 0.0

    def candidates(self) -> tuple[str, ...]:
        """Return the effects of the rig; sensors that would show something else are not looked through."""
        return tuple(name for name in rig_effects() if not in_sensors_alone(catalogue()[name]))

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of what is unknown of the rig, and of `effects`."""
        return Parameters.of([Coordinate.within("", name, *pair, True)
                              for name, pair in self.file.unknown.ranges().items()], effects, signs)

    def hypothesis(self, point: Point) -> Hypothesis:
        """Return a point as the rig's model takes it."""
        own = point.parameters.values(point.z)[""]
        stated = {"moving_mass": self.file.rig.moving_mass, "wear_coefficient": self.rig.wear_coefficient,
                  "friction_coefficient": self.file.contact.friction_coefficient, "compliance": 1.0}
        mass, friction, wear, compliance = (own.get(name, stated[name]) / stated[name] for name in (
            "moving_mass", "friction_coefficient", "wear_coefficient", "compliance"))
        return Hypothesis(effects=point.built(), friction=friction, wear=wear, mass=mass, compliance=compliance)

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return the facts of a hypothesis; its state is a `Shown`.

        Raises
        ------
        NonConvergenceError
            If a period is not found, or a test does not show what a fact is of.
        """
        hypothesis, quantities = self.hypothesis(point), []
        known = {} if near is None else shown(near).resonances
        with np.errstate(over="ignore", invalid="ignore"):
            tests = {one.key: worn_test(self.rig, hypothesis, one, known.get(one.key)) for one in self.conditions}
            for fact in self.file.facts:
                own = quantity_of(fact, self.file.cycles_of(fact), tests[self.file.condition_of(fact)])
                if own is None or not np.isfinite(own):
                    raise NonConvergenceError(f"the hypothesis shows no {fact.quantity}")
                quantities.append(own)
            resonances = {key: tests[key].resonance(0) for fact in self.file.facts
                          if fact.quantity in ("resonance", "resonance-change")
                          for key in (self.file.condition_of(fact),)}
        return Prediction(point, np.array([_row(fact, fact.distance(own) + more) for fact, own, more in zip(
            self.file.facts, quantities, self.correction, strict=True)]), Shown(np.array(quantities), resonances))

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return nan (M, V): nothing tells a test's neighbours for less than they cost."""
        return np.full((len(prediction.values), len(points)), np.nan)

    def checked_by(self, finer: RigModel, prediction: Prediction) -> FactsExperiment:
        """Return the same with what a finer model changes of a prediction added, and counted as an error as well.

        The corners of the ridges let a contact converge slowly, so that the difference to the next mesh is no bound.
        """
        after = replace(self, rig=replace(finer, wear_tolerance=WearSettings.tolerance)).predict(prediction.point)
        more = np.array([fact.distance(fine) - fact.distance(coarse) for fact, fine, coarse in zip(
            self.file.facts, shown(after).quantities, shown(prediction).quantities, strict=True)])
        return replace(self, correction=more, code_error=np.diag(np.abs(more)))

    def described(self, coordinate: Coordinate) -> tuple[str, str]:
        """Return the unit and the meaning of a parameter."""
        if coordinate.effect:
            return described(coordinate.effect, coordinate.field)
        return PARAMETERS[coordinate.field], MEANINGS[coordinate.field]


def shown(prediction: Prediction) -> Shown:
    """Return what is behind a prediction of facts."""
    state: Shown = prediction.state
    return state


def _level(fact: Fact) -> float:
    """Return where a fact's row stands: at the size of a value in sd, so that a share of it is known; a bound at 0."""
    if fact.side:
        return 0.0
    return fact.stated / fact.sd if fact.factor is None else 1.0 / log(fact.factor)


def _row(fact: Fact, distance: float) -> float:
    """Return the row of a quantity that lies by `distance` in sd above what is stated."""
    if not fact.side:
        return _level(fact) + distance
    return -fact.side * sqrt(-2.0 * float(log_ndtr(fact.side * distance)))
