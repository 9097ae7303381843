"""How probable a hypothesis makes a recording, what models get wrong included.

Beside the errors of measurement and code that a `Measurement` knows, the true system differs from any model by a
discrepancy (M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425-464; J. Brynjarsdottir, A. O'Hagan, Inverse
Problems 30 (2014) 114007), here of three kinds, all smooth in loop phase:

- in proportion to each effect's own signature s_e, by a relative size e: the law is of another form than the
  catalogue's (see `law_forms`);
- any that all loops have in common, by a share sigma of each channel's size;
- any that differs from loop to loop, smoothly in cycles, by a share tau.

With whitened residual r, derivatives J by coordinates z that are standard normal beforehand, whitened smooth functions
C in common and G of single loops, and modulated signatures D, a hypothesis that is linear about its fit has ::

    r + J z ~ N(0, 1 + J J^T + e^2 D D^T + sigma^2 C C^T + tau^2 G G^T)

G, which has the most functions, is decomposed once, so that every tau costs sums over its singular values alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fretflow.core.records import quantity, record
from fretflow.inference.experiment import TOLERANCE, Covariance, Measurement
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import Array
from fretflow.recordings.readings import SEED

LOOP_HARMONICS = 7  # of what no law tells, by the phase; their sd falls with the order, as of continuous functions
MODULATING = 2  # the same, of what a law of another form does to a signature
SIZES = np.geomspace(1e-3, 1.0, 10)  # sigma and tau, from what hardly any channel resolves to all of it
FORMS = np.geomspace(0.003, 1.0, 8)  # e, from below all noise to laws that have nothing in common
DRAWS = 1000  # of a posterior: its 90 % interval is then known to 3 % of its width


@record
class Evidence:
    """log p(recording | hypothesis, e, sigma, tau) over the sizes of discrepancies, up to a constant of the recording.

    Experiments whose rows differ independently have one general discrepancy only, and one axis of sizes.
    """

    table: Array = quantity("1", "(forms, sizes, sizes), one form where the hypothesis has no effects")
    mean: Array = quantity("1", "(forms, sizes, sizes, P), most probable coordinates")
    covariance: Array = quantity("1", "(forms, sizes, sizes, P, P), theirs")

    def averaged(self, prior: Array) -> float:
        """Return the log evidence with a prior of the sizes, of the table's shape, which sums to one."""
        return float(np.logaddexp.reduce(self.table + np.log(np.maximum(prior, 1e-300)), axis=None))

    def sizes(self, prior: Array) -> tuple[float, float, float]:
        """Return the most probable e, sigma and tau."""
        form, sigma, tau = np.unravel_index(int(np.argmax(self.table + np.log(np.maximum(prior, 1e-300)))),
                                            self.table.shape)
        return float(FORMS[form]), float(SIZES[sigma]), float(SIZES[tau])

    def coordinates(self, prior: Array) -> tuple[Array, Array]:
        """Return the mean (P,) and the covariance (P, P) of the coordinates over all sizes."""
        own = self.table + np.log(np.maximum(prior, 1e-300))
        weight = np.exp(own - own.max())
        weight = (weight / weight.sum())[..., None]
        axes = tuple(range(own.ndim))
        mean = np.sum(weight * self.mean, axis=axes)
        away = self.mean - mean
        between = away[..., :, None] * away[..., None, :]
        return mean, np.sum(weight[..., None] * (self.covariance + between), axis=axes)


def drawn(mean: Array, covariance: Array) -> Array:
    """Return DRAWS of normal coordinates (P, DRAWS), the same whenever they are asked for."""
    return np.random.default_rng(SEED).multivariate_normal(mean, covariance, DRAWS, method="eigh").T


@dataclass(frozen=True)
class Discrepancy:
    """The general discrepancies of a measurement, in the space that `covariance` whitens."""

    measurement: Measurement
    covariance: Covariance

    @cached_property
    def _modes(self) -> tuple[Array, Array, Array]:
        """Return the functions (M, any) in common, and an orthonormal basis of those of single loops with its sizes."""
        common, single = map(self.covariance.whiten, smooth_functions(self.measurement))
        left, size, _ = np.linalg.svd(single, full_matrices=False)
        kept = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
        return common, left[:, kept], size[kept]

    def of_sizes(self, sizes: tuple[float, float, float], formed: Array, chance: Array) -> Covariance:
        """Return the covariance of all errors with discrepancies of sizes e, sigma and tau.

        `formed` (M, any) and `chance` (M, any) are in SI, as in `evidence`.
        """
        form, sigma, tau = sizes
        common, single = smooth_functions(self.measurement)
        return self.measurement.covariance().with_modes(
            np.hstack([sigma * common, tau * single, form * formed, chance]))

    def evidence(self, fit: Fit, formed: Array | None = None, chance: Array | None = None) -> Evidence:
        """Return the evidence of a fitted hypothesis; `formed` (M, any) in SI are what laws of other forms change.

        What the hypothesis leaves to `chance` (M, any) in SI are coordinates too, which nobody asks for. Coordinates
        that are held at limits stay there.
        """
        common, left, size = self._modes
        blank = formed is None or not formed.shape[1]
        modulated = np.zeros((len(left), 0)) if blank else self.covariance.whiten(np.asarray(formed))
        # a fit may have been made under another covariance than the evidence is of
        start, slopes = (self.covariance.whiten(one) for one in (
            self.measurement.values - fit.predicted + fit.jacobian @ fit.z, fit.jacobian))
        if chance is not None:
            slopes = np.column_stack([slopes, self.covariance.whiten(chance)])
        every = np.column_stack([start, slopes, common, modulated])
        inside = left.T @ every
        outside: Array = every.T @ every - inside.T @ inside
        own, forms = len(fit.z), FORMS[:1] if blank else FORMS
        wanted = np.eye(every.shape[1] - 1)[:, :own]
        table = np.empty((len(forms), len(SIZES), len(SIZES)))
        mean, covariance = np.empty((*table.shape, own)), np.empty((*table.shape, own, own))
        for k, tau in enumerate(SIZES):
            kept = 1.0 / (1.0 + np.square(tau * size))
            gram = inside.T @ (kept[:, None] * inside) + outside
            for (i, form), (j, sigma) in product(enumerate(forms), enumerate(SIZES)):
                scale = np.repeat([1.0, sigma, form], [slopes.shape[1], common.shape[1], modulated.shape[1]])
                root = cho_factor(np.eye(len(scale)) + scale[:, None] * gram[1:, 1:] * scale, lower=True,
                                  overwrite_a=True, check_finite=False)
                pulled = scale * gram[1:, 0]
                solved = cho_solve(root, np.column_stack([pulled, wanted]), check_finite=False)
                table[i, j, k] = -0.5 * (gram[0, 0] - pulled @ solved[:, 0] - float(np.log(kept).sum())) - float(
                    np.log(np.diag(root[0])).sum())
                mean[i, j, k] = solved[:own, 0]
                covariance[i, j, k] = solved[:own, 1:]
        mean[..., fit.held] = fit.z[fit.held]
        covariance[..., fit.held, :] = covariance[..., :, fit.held] = 0.0
        return Evidence(table=table, mean=mean, covariance=covariance)


def smooth_functions(measurement: Measurement) -> tuple[Array, Array]:
    """Return smooth functions of all rows that loops have in common (M, any), and of single loops (M, any).

    Each is the sd of a general discrepancy of size one. Over the loops' phase they are harmonics; single loops differ
    by a random walk over the cycles, and each condition has its own; what has no phase is off in proportion to its
    size. A loop may be early or late as well, by angles in radians that are as smooth: of a sine that is a change of
    the same relative size, and corners, which are not smooth, move. Of an input the whole loop alone is early or late.
    Single loops may also be those of slightly other forces, masses, springs or dampers, as `Measurement.embedded` has
    them: near the onset of motion small ones make large differences (errors embedded in the model: K. Sargsyan,
    H. N. Najm, R. Ghanem, Int. J. Chem. Kinet. 47 (2015) 246-276).
    """
    size, early = discrepancy_sizes(measurement), harmonics(measurement.phase, MODULATING)
    early[size == 0.0, 1:] = 0.0
    functions = [np.hstack([_products(measurement, waves(measurement, LOOP_HARMONICS), courses, size),
                            _products(measurement, early, courses, rates(measurement))])
                 for courses in (np.ones((len(measurement.values), 1)), _courses(measurement))]
    if measurement.embedded is not None:
        products = measurement.embedded[:, :, None] * _courses(measurement)[:, None, :]
        functions[1] = np.hstack([functions[1], products.reshape(len(size), -1)])
    return functions[0], functions[1]


def modulations(measurement: Measurement, signature: Array) -> Array:
    """Return smooth functions (M, any) in proportion to a `signature` (M,), of unit variance in all.

    A law of the motion is off alike in all loops, by a function of their phase; one of time or energy alike at all
    phases, by one of the cycles; at other conditions both may differ, and loops of a few counts are off each by itself,
    so that an error in one of them needs no larger size than it has. What a law's form is off by is a share of all
    that the law does: it may be as large where the law happens to do little, as late in a run-in, so that no loop of a
    channel counts for less than the rms of all. A loop's zero, which no sensor knows, is none of a signature; a level
    that is measured, such as an approach over the test, is off by itself, from the mean of all loops.
    """
    seen, level = np.array(signature, dtype=float), np.zeros(len(signature))
    for own in loops_of(measurement):
        level[own] = seen[own].mean()
    seen -= level
    for k, name in enumerate(measurement.channels):
        rows = (measurement.channel == k) & np.isfinite(measurement.phase)
        level[rows] = level[rows] - level[rows].mean() if name in measurement.levels else 0.0
    single = np.column_stack([measurement.group == one for one in range(len(measurement.groups))]).astype(float)
    beside = [_courses(measurement), single]
    functions = _levelled(measurement, seen)[:, None] * _unit(np.hstack([waves(measurement, MODULATING), *beside]))
    return np.hstack([functions, level[:, None] * _unit(np.hstack(beside))]) if level.any() else np.asarray(functions)


def _levelled(measurement: Measurement, signature: Array) -> Array:
    """Return a signature (M,) with what single groups of rows show of it raised to the rms of all with this channel."""
    share, raised = np.square(signature / sizes(measurement)), signature.copy()
    for channel in range(len(measurement.channels)):
        parts = [rows for rows in groups_of(measurement) if measurement.channel[rows][0] == channel]
        own = np.sqrt([np.mean(share[rows]) for rows in parts])
        rms = float(np.sqrt(np.mean(own**2)))
        for rows, size in zip(parts, own, strict=True):
            if TOLERANCE < size < rms:  # what is less has no direction
                raised[rows] *= rms / size
    return raised


def relative_size(measurement: Measurement, signatures: Array) -> float:
    """Return what `signatures` (M, E) come to over the sizes of the channels, both over the noise.

    What they do to a loop's zero counts over that of the whole channel.
    """
    zero = np.zeros(np.shape(signatures))
    for own in loops_of(measurement):
        zero[own] = np.asarray(signatures)[own].mean(axis=0)
    larger = sizes(measurement, whole=True) / sizes(measurement)
    squares = np.sum(np.square(signatures - zero), axis=1) + np.sum(np.square(zero), axis=1) / larger**2
    return _over_sizes(measurement, squares, np.ones(len(squares), dtype=bool))


def code_size(measurement: Measurement) -> float:
    """Return what codes differ by over the size of the channels, both over the noise; noise itself if nothing tells.

    It is what finer meshes and steps change of the model's prediction, loops' zeros aside: two codes of this resolution
    differ by as much.
    """
    squares = _code_squares(measurement)
    return _over_sizes(measurement, squares, squares > 0.0)


def discrepancy_sizes(measurement: Measurement) -> Array:
    """Return the sd (M,) of a general discrepancy of size one: the channel's size, of what drives the joint none.

    Of a worn face codes tell less than of loops: there it is by as much larger as they differ by more.
    """
    sd, squares = sizes(measurement), _code_squares(measurement)
    sd[np.isin(measurement.channel, [measurement.channels.index(one) for one in measurement.inputs])] = 0.0
    if measurement.place is not None:
        face = np.isfinite(measurement.place).all(axis=1) & (squares > 0.0)
        if face.any():
            sd[face] *= max(1.0, _over_sizes(measurement, squares, face) / code_size(measurement))
    return sd


def _code_squares(measurement: Measurement) -> Array:
    """Return the variance (M,) of what codes differ by, loops' zeros aside; that of the noise if nothing tells."""
    error = measurement.code_error.copy()
    for own in loops_of(measurement):
        error[own] -= error[own].mean(axis=0)
    squares = np.asarray(np.sum(error**2, axis=1))
    return squares if squares.any() else measurement.variance * measurement.repeatable


def _over_sizes(measurement: Measurement, squares: Array, rows: NDArray[np.bool_]) -> float:
    """Return the root of what `squares` (M,) and the channels' sizes come to over the noise, by each other.

    A channel that holds noise alone has no size that anything could be compared with, and does not count so.
    """
    noise = measurement.variance[rows]
    return float(np.sqrt(np.sum(squares[rows] / noise) / np.sum(sizes(measurement)[rows]**2 / noise)))


def size_prior(code: float, formed: Array | None = None) -> Array:
    """Return the prior (forms, sizes) of sigma or tau: normal, its variance that of all that makes such differences.

    Codes differ by `code`; laws of another form by `formed` (forms,), one row each. Without laws there is one row.
    """
    sd = np.maximum(np.hypot(code, np.zeros(1) if formed is None else formed), SIZES[0])[:, None]  # no less is told
    prior = SIZES * np.exp(-0.5 * np.square(SIZES / sd))
    return np.asarray(prior / prior.sum(axis=1, keepdims=True))


def groups_of(measurement: Measurement) -> list[NDArray[np.bool_]]:
    """Return the rows (M,) of each channel of each group: of a loop, a map, a test."""
    keys = measurement.channel * len(measurement.groups) + measurement.group
    return [keys == key for key in np.unique(keys)]


def loops_of(measurement: Measurement) -> list[NDArray[np.bool_]]:
    """Return the rows (M,) of each channel of each loop."""
    return [rows for rows in groups_of(measurement) if np.isfinite(measurement.phase[rows]).any()]


def sizes(measurement: Measurement, whole: bool = False) -> Array:
    """Return the size (M,) of each row's channel: the largest rms of its loops about their means, else of values.

    The `whole` of it has the means in it.
    """
    size = np.zeros(len(measurement.values))
    for channel in range(len(measurement.channels)):
        rows = measurement.channel == channel
        groups = [measurement.values[rows & (measurement.group == g)] for g in np.unique(measurement.group[rows])]
        periodic = np.isfinite(measurement.phase[rows]).all() and not whole
        size[rows] = max(float(np.std(own) if periodic else np.sqrt(np.mean(own**2))) for own in groups)
    return np.maximum(size, np.finfo(float).tiny)


def rates(measurement: Measurement) -> Array:
    """Return the derivative (M,) of the values by the angle of the loop's phase; zero where there is no phase.

    It is that of the Fourier series up to half of what the samples of the loop could hold, so that noise counts little.
    """
    derivative = np.zeros(len(measurement.values))
    for own in loops_of(measurement):
        angle = 2.0 * np.pi * measurement.phase[own][:, None]
        order = np.arange(1, max(1, len(angle) // 4) + 1)
        series = np.hstack([np.ones_like(angle), np.cos(angle * order), np.sin(angle * order)])
        slopes = np.hstack([np.zeros_like(angle), -order * np.sin(angle * order), order * np.cos(angle * order)])
        derivative[own] = slopes @ np.linalg.lstsq(series, measurement.values[own], rcond=None)[0]
    return derivative


def waves(measurement: Measurement, most: int) -> Array:
    """Return waves (M, any) over phase or place, each row's of unit variance in all; a constant where it has neither.

    Over a face they are products of those along its sides, whose orders' product is at most `most`.
    """
    over_phase = harmonics(measurement.phase, most)
    if measurement.place is None:
        return over_phase
    on_face = np.isfinite(measurement.place).all(axis=1)[:, None]
    order = np.arange(most + 1)
    falling = np.where(order > 0, np.sqrt(2.0) / np.maximum(order, 1), 1.0)  # sd, times the rms of a cosine
    x, y = (falling * np.cos(np.pi * order * side[:, None]) for side in np.nan_to_num(measurement.place).T)
    kept = np.multiply.outer(np.maximum(order, 1), np.maximum(order, 1)) <= most
    both = (x[:, :, None] * y[:, None, :])[:, kept]
    total = float(np.sum(np.multiply.outer(*2 * [1.0 / np.maximum(order, 1)**2])[kept]))
    return np.hstack([np.where(on_face, 0.0, over_phase), np.where(on_face, both / np.sqrt(total), 0.0)])


def harmonics(phase: Array, most: int) -> Array:
    """Return a constant and waves (M, 1 + 2 most) over the phase, of unit variance in all; a constant without phase."""
    order = np.arange(1, most + 1)
    angle = 2.0 * np.pi * np.nan_to_num(phase)[:, None] * order
    waves = np.hstack([np.cos(angle) / order, np.sin(angle) / order])
    waves = np.where(np.isfinite(phase)[:, None], waves, 0.0)
    columns = np.column_stack([np.ones(len(phase)), waves])
    return np.asarray(columns / np.sqrt(1.0 + float(np.sum(1.0 / order**2))))


def _courses(measurement: Measurement) -> Array:
    """Return functions (M, any) by which loops differ, of unit variance in all: over the cycles, and by condition."""
    shown = np.where(np.isfinite(measurement.cycles), measurement.cycles, 1.0)
    knots = np.unique(shown)
    steps = np.sqrt(np.diff(np.linspace(0.0, 1.0, len(knots))))  # a random walk over the recorded counts
    columns = [np.where(shown >= knot, step, 0.0) for knot, step in zip(knots[1:], steps, strict=True)]
    columns += [(measurement.condition == one).astype(float) for one in np.unique(measurement.condition) if one]
    return _unit(np.column_stack(columns)) if columns else np.zeros((len(shown), 0))


def _unit(functions: Array) -> Array:
    """Return functions (M, any) scaled to unit variance in all."""
    return np.asarray(functions / np.sqrt(np.mean(np.sum(functions**2, axis=1))))


def _products(measurement: Measurement, waves: Array, courses: Array, size: Array) -> Array:
    """Return functions (M, any) with the covariance of all products of waves and courses times a size (M,).

    Those of each channel are its own, and no more than it has rows.
    """
    product = (waves[:, :, None] * courses[:, None, :]).reshape(len(waves), -1) * size[:, None]
    columns = []
    for channel in range(len(measurement.channels)):
        rows = measurement.channel == channel
        own = np.where(rows[:, None], product, 0.0)
        if np.count_nonzero(np.any(own, axis=0)) > np.count_nonzero(rows):
            left, strength, _ = np.linalg.svd(own[rows], full_matrices=False)
            own = np.zeros((len(rows), len(strength)))
            own[rows] = left * strength
        columns.append(own)
    every = np.hstack(columns)
    return np.asarray(every[:, np.any(every, axis=0)])
