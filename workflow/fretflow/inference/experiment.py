"""What the inference engine knows of an experiment: what was measured, and how a hypothesis predicts it.

An experiment (loops of a rig, a driven joint, a series of wear tests) is any object with the members of `Experiment`;
the engine fits, compares and judges hypotheses through these alone. A hypothesis is a point: the coordinates of the
baseline's and the effects' parameters (see `parameters`) and their values. ::

    measured = predicted(point) + errors,    errors ~ N(0, diag(variance) + modes modes^T)

to which `evidence` adds what models get wrong. The covariance is ``Sigma = D + B B^T`` with D diagonal and few columns
of B (gains, offsets, solver error, each of unit variance). With ``U = D^-1/2 B = V s W^T``, its inverse root is
``(1 - V (1 - (1 + s^2)^-1/2) V^T) D^-1/2``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import ConfigError, FretflowError
from fretflow.core.records import quantity, record
from fretflow.effects.catalogue import catalogue, check_together
from fretflow.effects.effect import Effect
from fretflow.inference.parameters import Array, Parameters

# Relative, to which predictions are solved: it changes them by less than a hundredth of the noise, and what they show
# of an effect below it is round-off.
TOLERANCE = 1e-4
STEP = 0.02  # of a coordinate, for derivatives: a fiftieth of what was uncertain beforehand


@record
class Measurement:
    """What was measured, M values in the order of the experiment's rows, their errors, and what each row is of."""

    values: Array = quantity("SI", "(M,)")
    variance: Array = quantity("SI^2", "(M,), of independent errors")
    modes: Array = quantity("SI", "(M, B), of errors that rows share: gains, zeros")
    code_error: Array = quantity("SI", "(M, C), modes of what a finer solution of the model would change")
    repeatable: Array = quantity("1", "(M,), share of the variance that repeats show")
    channel: NDArray[np.int64] = quantity("1", "(M,), index into `channels`")
    channels: tuple[str, ...]
    phase: Array = quantity("1", "(M,), share of the period; nan where a row is of none")
    group: NDArray[np.int64] = quantity("1", "(M,), index into `groups`: the loop, test or stretch of a record")
    groups: tuple[str, ...]
    cycles: Array = quantity("1", "(M,), share of the test that had passed; nan where that says nothing")
    condition: NDArray[np.int64] = quantity("1", "(M,), 0 as in the test, others at other conditions")
    inputs: frozenset[str] = frozenset()  # channels of what drives the joint, which no code and no law gets wrong
    levels: frozenset[str] = frozenset()  # channels whose means over a loop are measured, beside a zero of all loops
    embedded: Array | None = quantity("SI", "(M, K), what relative errors of one in the model's own forces, masses, "
                                      "springs and dampers would change", default=None)
    place: Array | None = quantity("1", "(M, 2), shares of the extent of a map; nan where a row is of no place",
                                   default=None)

    @classmethod
    def of(cls, values: Array, variance: Array, *, channels: tuple[str, ...], groups: tuple[str, ...], **told: Any
           ) -> Measurement:
        """Return a measurement of fields as told; the others are those of rows of one kind.

        All rows are then of the first channel, of the first group and as in the test, at no phase and no cycle count,
        with errors that repeats show in full and that no rows share.
        """
        size = len(values)
        first, nowhere, unshared = np.zeros(size, dtype=np.int64), np.full(size, np.nan), np.zeros((size, 0))
        of_one_kind = {"modes": unshared, "code_error": unshared, "repeatable": np.ones(size), "channel": first,
                       "phase": nowhere, "group": first, "cycles": nowhere, "condition": first}
        return cls(values=values, variance=variance, channels=channels, groups=groups, **{**of_one_kind, **told})

    @property
    def expected(self) -> float:
        """Return the chi-squared that repeats explain."""
        return float(self.repeatable.sum())

    def covariance(self) -> Covariance:
        """Return the errors' covariance."""
        return Covariance(self.variance, np.hstack([self.modes, self.code_error]))


@dataclass(frozen=True)
class Point:
    """A hypothesis: coordinates and their values z (size,); some of its effects may be put out of work."""

    parameters: Parameters
    z: Array
    neutral: frozenset[str] = frozenset()

    @property
    def effects(self) -> frozenset[str]:
        """Return the effects of the hypothesis."""
        return frozenset(self.parameters.effects)

    def built(self) -> tuple[Effect, ...]:
        """Return the effects with their parameters."""
        return tuple(put_out(one) if one.id in self.neutral else one for one in self.parameters.built(self.z))

    def turned(self) -> Point:
        """Return the same hypothesis, its ranges on the side of zero where its parameters are."""
        return Point(*self.parameters.turned(self.z), self.neutral)

    def beside(self, step: float = STEP) -> tuple[list[Point], Array]:
        """Return the points a step away along each coordinate, toward the middle, and the steps (size,) taken."""
        steps = np.where(self.z <= 0.0, step, -step)
        return [replace(self, z=self.z + own) for own in np.diag(steps)], steps


def put_out(effect: Effect) -> Effect:
    """Return an effect with what its law is named after at the value that does nothing; the rest is as it was."""
    neutral = type(effect).neutral()
    return effect.changed(**{name: getattr(neutral, name) for name in neutral.model_fields_set})


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a hypothesis predicts, and whatever its experiment keeps of how, for its neighbours to begin from."""

    point: Point
    values: Array  # (M,), SI
    state: Any = None


class Experiment(Protocol):
    """An experiment under the engine; what derives from it has the members below that return something."""

    @property
    def measurement(self) -> Measurement:
        """Return what was measured."""
        ...

    def candidates(self) -> tuple[str, ...]:
        """Return the ids of the effects that may act in it."""
        ...

    def together(self, effects: Sequence[str]) -> bool:
        """Tell whether effects may act at once."""
        try:
            check_together([catalogue()[name]() for name in effects])
        except ConfigError:
            return False
        return True

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the coordinates of the baseline with `effects`."""
        ...

    def predict(self, point: Point, near: Prediction | None = None) -> Prediction:
        """Return what a hypothesis predicts; `near` is a prediction to begin from.

        Raises
        ------
        NonConvergenceError
            If it has no solution.
        """
        ...

    def has_made(self, prediction: Prediction) -> bool:
        """Tell whether a prediction is of this very model, and not of a coarser or finer one; it is, by default."""
        return True

    def changes(self, prediction: Prediction, points: Sequence[Point]) -> Array:
        """Return the first-order changes (M, V) from a prediction to hypotheses beside it; each predicted, by default.

        A column of nan says that nothing is known of one.
        """
        return differences(self, prediction, points)

    def by_chance(self, prediction: Prediction) -> Array:
        """Return modes (M, any), of unit variance, of what a prediction leaves to chance: which point slips first."""
        return np.zeros((len(prediction.values), 0))

    def before_jump(self, leading: Prediction) -> Experiment | None:
        """Return the part of the measurement before its motion jumps to another one.

        None where it does not, or where the `leading` prediction jumps as it does.
        """
        return None

    def finer(self) -> Experiment | None:
        """Return the same with smaller numerical errors, for fits that these bring to a halt; None if there is none."""
        return None

    def as_recorded(self, prediction: Prediction) -> Array:
        """Return predicted values (M,) with the errors in them that the recording tells of what is not fitted."""
        return prediction.values

    def corrected(self, prediction: Prediction) -> Experiment | None:
        """Return the same with its numerical errors at a prediction put right; None where nothing finer tells them."""
        return None


def differences(experiment: Experiment, prediction: Prediction, points: Sequence[Point]) -> Array:
    """Return the changes (M, V) from a prediction to hypotheses, each predicted; nan where one has no solution.

    Where several have the same other coordinates, the first of them is the neighbour that the next begin from.
    """
    changes, near = np.full((len(prediction.values), len(points)), np.nan), prediction
    for column, point in zip(changes.T, points, strict=True):
        first = near.point.parameters != point.parameters
        try:
            one = experiment.predict(point, prediction if first else near)
        except FretflowError:
            continue
        column[:], near = one.values - prediction.values, one if first else near
    return changes


def jacobian(experiment: Experiment, prediction: Prediction) -> Array:
    """Return the derivative (M, size) of a prediction by its coordinates; zero where a point beside has no solution.

    What first-order changes do not know is differenced.
    """
    points, steps = prediction.point.beside()
    changes = np.asarray(experiment.changes(prediction, points))
    unknown = np.flatnonzero(~np.isfinite(changes).all(axis=0))
    changes[:, unknown] = differences(experiment, prediction, [points[k] for k in unknown])
    return np.asarray(np.nan_to_num(changes) / steps)


@dataclass(frozen=True)
class Covariance:
    """`variance` (M,) of independent noise and `modes` (M, B)."""

    variance: Array
    modes: Array

    @cached_property
    def _shared(self) -> tuple[Array, Array]:
        scaled = self.modes / np.sqrt(self.variance)[:, None]
        if not scaled.size:
            return np.zeros((len(self.variance), 0)), np.zeros(0)
        # three times faster than singular values; what is lost of small ones is far below the noise
        wide = scaled.shape[1] >= len(scaled)
        square, vectors = np.linalg.eigh(scaled @ scaled.T if wide else scaled.T @ scaled)
        kept = square > np.finfo(float).eps * max(1.0, float(square[-1]))
        square, vectors = square[kept], vectors[:, kept]
        left = vectors if wide else scaled @ (vectors / np.sqrt(square))
        return left, 1.0 - 1.0 / np.sqrt(1.0 + square)

    @property
    def log_density(self) -> float:
        """Return the log of the density of no error at all, up to a constant; wide errors make it small."""
        return float(np.sum(np.log1p(-self._shared[1])) - 0.5 * np.sum(np.log(self.variance)))

    def with_modes(self, modes: Array) -> Covariance:
        """Return the same with further shared `modes` (M, any)."""
        return Covariance(self.variance, np.hstack([self.modes, modes]))

    def hiding(self, rows: NDArray[np.bool_]) -> Covariance:
        """Return the same with errors of some rows (M,) without bound, so that these tell nothing."""
        return Covariance(np.where(rows, np.inf, self.variance), self.modes)

    def whiten(self, values: Array) -> Array:
        """Return `values` (M, ...) in units of which each is independent with unit variance."""
        flat = values.reshape(len(values), -1) / np.sqrt(self.variance)[:, None]
        left, damping = self._shared
        flat = flat - left @ (damping[:, None] * (left.T @ flat))
        return np.asarray(flat.reshape(values.shape))

    def shared(self, error: Array) -> Array:
        """Return the most probable size (B,) of each shared mode in an `error` (M,), in standard deviations."""
        scaled = self.modes / np.sqrt(self.variance)[:, None]
        inner = np.eye(scaled.shape[1]) + scaled.T @ scaled
        return np.asarray(np.linalg.solve(inner, scaled.T @ (error / np.sqrt(self.variance))))
