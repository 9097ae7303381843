"""How probable a hypothesis makes a recording, what models get wrong included.

Beside the errors of measurement and code that a `Measurement` knows, the true system differs from any model by a
discrepancy (M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425-464; J. Brynjarsdottir, A. O'Hagan, Inverse
Problems 30 (2014) 114007), here of two kinds, both smooth in loop phase, cycles and condition:

- in proportion to each effect's own signature s_e, by a relative size e: the law is of another form than the
  catalogue's (see `law_forms`);
- any, by a share tau of each channel's size.

With whitened residual r, derivatives J by coordinates z that are standard normal beforehand, whitened smooth functions
G and modulated signatures D, a hypothesis that is linear about its fit has ::

    r + J z ~ N(0, 1 + J J^T + e^2 D D^T + tau^2 G G^T)

G is decomposed once, so that every tau costs sums over its singular values alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import quantity, record
from fretflow.inference.experiment import Covariance, Measurement
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import Array

HARMONICS = 7  # of the loop phase that a discrepancy is made of; sd falls with the order, as of continuous functions
MODULATING = 2  # the same, of what a law of another form does to a signature
SIZES = np.geomspace(1e-3, 1.0, 16)  # tau, from what hardly any channel resolves to all of it
FORMS = np.geomspace(0.003, 1.0, 11)  # e, from below all noise to laws that have nothing in common


@record
class Evidence:
    """log p(recording | hypothesis, e, tau) over the sizes of both discrepancies, up to a constant of the recording."""

    table: Array = quantity("1", "(forms, sizes), one row where the hypothesis has no effects")
    mean: Array = quantity("1", "(forms, sizes, P), most probable coordinates")
    spread: Array = quantity("1", "(forms, sizes, P), their standard deviations")

    def averaged(self, forms: Array, sizes: Array) -> float:
        """Return the log evidence with priors of e (forms,) and of tau (sizes,), which sum to one."""
        prior = np.log(np.maximum(np.outer(forms if len(self.table) > 1 else np.ones(1), sizes), 1e-300))
        return float(np.logaddexp.reduce(self.table + prior, axis=None))

    def coordinates(self, forms: Array, sizes: Array) -> tuple[Array, Array]:
        """Return the mean and the standard deviation (P,) of the coordinates over both sizes."""
        prior = np.log(np.maximum(np.outer(forms if len(self.table) > 1 else np.ones(1), sizes), 1e-300))
        weight = np.exp(self.table + prior - (self.table + prior).max())
        weight = (weight / weight.sum())[:, :, None]
        mean = np.sum(weight * self.mean, axis=(0, 1))
        return mean, np.sqrt(np.sum(weight * (self.spread**2 + (self.mean - mean)**2), axis=(0, 1)))

    def most_probable(self, forms: Array, sizes: Array) -> tuple[float, float]:
        """Return the most probable e and tau."""
        own = np.log(np.maximum(np.outer(forms if len(self.table) > 1 else np.ones(1), sizes), 1e-300))
        i, k = np.unravel_index(int(np.argmax(self.table + own)), self.table.shape)
        return (float(FORMS[i]) if len(self.table) > 1 else 0.0), float(SIZES[k])


@dataclass(frozen=True)
class Discrepancy:
    """The general discrepancy of a measurement, in the space that `covariance` whitens."""

    measurement: Measurement
    covariance: Covariance

    @cached_property
    def _modes(self) -> tuple[Array, Array]:
        left, size, _ = np.linalg.svd(self.covariance.whiten(smooth_functions(self.measurement)), full_matrices=False)
        kept = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
        return left[:, kept], size[kept]

    def evidence(self, fit: Fit, signatures: Array | None = None) -> Evidence:
        """Return the evidence of a fitted hypothesis; `signatures` (M, effects) in SI are what its effects change."""
        left, size = self._modes
        blank = signatures is None or not signatures.shape[1]
        modulated = np.zeros((len(left), 0)) if blank else self.covariance.whiten(
            modulations(self.measurement, np.asarray(signatures)))
        start = fit.residual + fit.whitened_jacobian @ fit.z
        every = np.column_stack([start, fit.whitened_jacobian, modulated])
        inside = left.T @ every
        outside = every.T @ every - inside.T @ inside
        own, forms = len(fit.z), FORMS[:1] if blank else FORMS
        table = np.empty((len(forms), len(SIZES)))
        mean, spread = (np.empty((*table.shape, own)) for _ in range(2))
        for k, tau in enumerate(SIZES):
            kept = 1.0 / (1.0 + np.square(tau * size))
            gram = inside.T @ (kept[:, None] * inside) + outside
            for i, form in enumerate(forms):
                scale = np.concatenate([np.ones(own), np.full(modulated.shape[1], form)])
                inner = np.eye(len(scale)) + scale[:, None] * gram[1:, 1:] * scale
                pulled = scale * gram[1:, 0]
                inverse = np.linalg.inv(inner)
                table[i, k] = -0.5 * (gram[0, 0] - pulled @ inverse @ pulled + np.linalg.slogdet(inner)[1]
                                      - float(np.log(kept).sum()))
                mean[i, k] = (inverse @ pulled)[:own]
                spread[i, k] = np.sqrt(np.diag(inverse)[:own])
        return Evidence(table=table, mean=mean, spread=spread)


def smooth_functions(measurement: Measurement) -> Array:
    """Return smooth functions (M, any) of all rows, each the sd of a general discrepancy at tau = 1.

    Over the loops' phase they are harmonics, over loops one function that all share, one that each condition has, and
    broken lines over the cycles; what has no phase is off in proportion to its size.
    """
    return _products(measurement, harmonics(measurement.phase, HARMONICS), _courses(measurement), sizes(measurement))


def modulations(measurement: Measurement, signatures: Array) -> Array:
    """Return each of `signatures` (M, E) times smooth functions of unit variance in all, (M, any).

    A loop's zero, which no sensor knows, is none of a signature.
    """
    waves = harmonics(measurement.phase, MODULATING)
    seen = np.array(signatures, dtype=float)
    for own in loops_of(measurement):
        seen[own] -= seen[own].mean(axis=0)
    found = [_products(measurement, waves, _courses(measurement), one, apart=False) for one in seen.T]
    return np.hstack(found) if found else np.zeros((len(measurement.values), 0))


def code_size(measurement: Measurement) -> float:
    """Return what codes differ by over the size of the channels, rms over the rows; that of noise where nothing tells.

    It is what finer meshes and steps change of the model's prediction: two codes of this resolution differ by as much.
    """
    squares = np.sum(measurement.code_error**2, axis=1)
    if not squares.any():
        squares = measurement.variance * measurement.repeatable
    share = squares / np.maximum(sizes(measurement), 1e-300)**2
    return float(np.sqrt(np.mean(share[squares > 0.0])))


def size_prior(code: float) -> Array:
    """Return the prior (sizes,) of tau where nothing is left out: normal, with what codes differ by as its sd."""
    found = SIZES * np.exp(-0.5 * np.square(SIZES / code))
    return np.asarray(found / found.sum())


def loops_of(measurement: Measurement) -> list[NDArray[np.bool_]]:
    """Return the rows (M,) of each channel of each loop."""
    keys = measurement.channel * len(measurement.groups) + measurement.group
    return [keys == key for key in np.unique(keys[np.isfinite(measurement.phase)])]


def sizes(measurement: Measurement) -> Array:
    """Return the size (M,) of each row's channel: the largest rms of its loops about their means, else of values."""
    found = np.zeros(len(measurement.values))
    for channel in range(len(measurement.channels)):
        rows = measurement.channel == channel
        groups = [measurement.values[rows & (measurement.group == g)] for g in np.unique(measurement.group[rows])]
        periodic = np.isfinite(measurement.phase[rows]).all()
        found[rows] = max(float(np.std(own) if periodic else np.sqrt(np.mean(own**2))) for own in groups)
    return found


def harmonics(phase: Array, most: int) -> Array:
    """Return a constant and waves (M, 1 + 2 most) over the phase, of unit variance in all; a constant without phase."""
    order = np.arange(1, most + 1)
    angle = 2.0 * np.pi * np.nan_to_num(phase)[:, None] * order
    waves = np.hstack([np.cos(angle) / order, np.sin(angle) / order])
    waves = np.where(np.isfinite(phase)[:, None], waves, 0.0)
    found = np.column_stack([np.ones(len(phase)), waves])
    return np.asarray(found / np.sqrt(1.0 + float(np.sum(1.0 / order**2))))


def _courses(measurement: Measurement) -> Array:
    """Return functions (M, any) over the loops, of unit variance in all: constant, over the cycles, by condition."""
    shown = np.where(np.isfinite(measurement.cycles), measurement.cycles, 1.0)
    knots = np.unique(shown)
    columns = [np.ones(len(shown))]
    if len(knots) > 1:  # a random walk over the recorded counts, of unit variance over the test
        steps = np.sqrt(np.diff(np.linspace(0.0, 1.0, len(knots))))
        columns += [np.where(shown >= knot, step, 0.0) for knot, step in zip(knots[1:], steps, strict=True)]
    for condition in np.unique(measurement.condition):
        if condition:
            columns.append((measurement.condition == condition).astype(float))
    found = np.column_stack(columns)
    return np.asarray(found / np.sqrt(np.mean(np.sum(found**2, axis=1))))


def _products(measurement: Measurement, waves: Array, courses: Array, size: Array, apart: bool = True) -> Array:
    """Return all products of waves and courses times a size (M,); of each channel `apart`, or of all alike."""
    product = (waves[:, :, None] * courses[:, None, :]).reshape(len(waves), -1) * size[:, None]
    if not apart:
        return np.asarray(product)
    found = [np.where((measurement.channel == channel)[:, None], product, 0.0)
             for channel in range(len(measurement.channels))]
    every = np.hstack(found)
    return np.asarray(every[:, np.any(every, axis=0)])
