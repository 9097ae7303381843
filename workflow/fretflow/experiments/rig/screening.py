"""Which effects could explain what is left, before any of them is fitted.

At a fitted hypothesis, each effect is laid out at a few points of its ranges; the first-order changes of the recording
from no effect to these points span what it can do. With a standard normal weight on each column, and what is fitted
already projected out, the gain in log evidence of a set of columns S over none is::

    (S^T r)^T (1 + S^T S)^-1 (S^T r) / 2 - log det(1 + S^T S) / 2
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import lsq_linear

from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import catalogue, check_together
from fretflow.effects.effect import Effect, Kind
from fretflow.experiments.rig.coordinates import Space, signed_fields
from fretflow.experiments.rig.fit import Fit, Fitter
from fretflow.experiments.rig.model import Hypothesis
from fretflow.experiments.rig.observation import Array
from fretflow.experiments.rig.tangent import neighbours

AWAY = 1.2  # coordinate of a point beside the middle of the ranges
FAINT = 1e-9
LINEAR = 0.1  # curvature over slope, up to which points between starts are known from these
WIDEST, FINE, ROUGH = 2.4, 25, 3  # points of ranges that are looked through: of the first coordinate, of the others


@dataclass(frozen=True)
class Start:
    """A point of an effect's ranges at which it is laid out: its coordinates, and the signs that go with them."""

    effect: str
    z: Array
    signs: dict[str, float]

    @property
    def sign(self) -> tuple[float, ...]:
        """Return the signs alone."""
        return tuple(self.signs.values())


@dataclass(frozen=True)
class Signatures:
    """Whitened changes (M, columns) by effect, with what is fitted already projected out.

    `starts` are the points of which the columns are.
    """

    residual: Array
    columns: Mapping[str, Array]
    starts: Mapping[str, tuple[Start, ...]]

    def gain(self, effects: Sequence[str]) -> float:
        """Return the gain in log evidence over what is fitted."""
        s = np.hstack([self.columns[name] for name in effects])
        inner = np.eye(s.shape[1]) + s.T @ s
        pulled = s.T @ self.residual
        return float(0.5 * pulled @ np.linalg.solve(inner, pulled) - 0.5 * np.linalg.slogdet(inner)[1])

    def explained(self, effects: Sequence[str]) -> float:
        """Return the share of what is left that the effects' columns can take up, at any weight."""
        s = np.hstack([self.columns[name] for name in effects])
        basis = _basis(s)
        return float(np.sum((basis.T @ self.residual)**2) / max(float(self.residual @ self.residual), FAINT))

    def ranked(self) -> list[str]:
        """Return the effects, the one with the largest gain first."""
        return sorted(self.columns, key=lambda name: -self.gain((name,)))

    def begin(self, effect: str) -> list[Start]:
        """Return the points of an effect's ranges from which fits begin: for either sign, where least would be left."""
        left = np.sum((self.residual[:, None] - self.columns[effect])**2, axis=0)
        found: dict[tuple[float, ...], Start] = {}
        for place in np.argsort(left):
            one = self.starts[effect][place]
            found.setdefault(one.sign, one)
        return [self._between(one) or one for one in found.values()]

    def _between(self, start: Start) -> Start | None:
        """Return where least would be left of all points between an effect's starts; None if it is not linear there."""
        known = {tuple(one.z): column for one, column in zip(self.starts[start.effect], self.columns[start.effect].T,
                                                             strict=True) if one.sign == start.sign}
        steps = AWAY * np.eye(len(start.z))
        wanted = [tuple(way * step) for step in steps for way in (1.0, -1.0)]
        middle = known.get(tuple(np.zeros(len(start.z))))
        if middle is None or not all(z in known for z in wanted):
            return None
        ahead, behind = (np.column_stack([known[tuple(way * step)] for step in steps]) for way in (1.0, -1.0))
        bent = np.linalg.norm(ahead + behind - 2.0 * middle[:, None], axis=0)
        if np.any(bent > LINEAR * np.linalg.norm(ahead - behind, axis=0)):
            return None
        own = [one for one in Space.of((start.effect,), start.signs).coordinates if one.effect]
        limits = np.array([((one.lowest - one.middle) / one.size, (one.highest - one.middle) / one.size)
                           for one in own])
        best = lsq_linear(np.vstack([(ahead - behind) / (2.0 * AWAY), np.eye(len(own))]),
                          np.append(self.residual - middle, np.zeros(len(own))),
                          np.clip(limits, -WIDEST, WIDEST).T)
        return replace(start, z=best.x)


def rig_effects() -> tuple[str, ...]:
    """Return the ids of the effects that act in the rig."""
    return tuple(name for name, kind in catalogue().items() if Kind.FRETTING_RIG in kind.kinds)


def starts_beside(fit: Fit, effects: Sequence[str]) -> list[Start]:
    """Return the points at which `effects` are laid out beside a fit, those left out that it cannot work with."""
    found = []
    for name in effects:
        if name in fit.space.effects:
            continue
        try:
            check_together([catalogue()[one]() for one in (*fit.space.effects, name)])
        except ConfigError:
            continue
        found += _starts(name)
    return found


def _starts(name: str) -> list[Start]:
    """Return the middle of an effect's ranges and points beside it, for either sign of what may have both."""
    signed = signed_fields(catalogue()[name])
    found = []
    for sign in (1.0, -1.0) if signed else (1.0,):
        signs = {f"{name}.{field}": sign for field in signed}
        own = Space.of((name,), signs).size - Space.of(()).size
        found.append(Start(name, np.zeros(own), signs))
        for i in range(own):
            for way in (-AWAY, AWAY):
                z = np.zeros(own)
                z[i] = way
                found.append(Start(name, z, signs))
    return found


def strong(start: Start) -> bool:
    """Tell whether a start is of medium size or more, by an effect's first parameter, all others in the middle."""
    return bool(start.z[0] >= 0.0) and not np.any(start.z[1:])


def with_start(fit: Fit, start: Start) -> tuple[Space, Array]:
    """Return the space of a fit's effects and another one, and the coordinates at which that is added."""
    space = Space.of((*fit.space.effects, start.effect), {**fit.space.signs, **start.signs})
    known = dict(zip((one.name for one in fit.space.coordinates), fit.z, strict=True))
    own = iter(start.z)
    z = [float(next(own)) if one.effect == start.effect else float(known[one.name]) for one in space.coordinates]
    return space, np.array(z)


def swapped(fit: Fit) -> list[tuple[Space, Array]]:
    """Return where fits begin in which an effect of a fit gives way to one whose law extends its own, or the reverse.

    What both laws have is as it was fitted; the rest is at the middle of its ranges, for either sign.
    """
    found = []
    for old in fit.space.effects:
        for new in rig_effects():
            if new in fit.space.effects or not (extends((old,), (new,)) or extends((new,), (old,))):
                continue
            known = {(new if one.effect == old else one.effect, one.field): z
                     for one, z in zip(fit.space.coordinates, fit.z, strict=True)}
            effects = [new if name == old else name for name in fit.space.effects]
            for signs in {one.sign: one.signs for one in _starts(new)}.values():
                space = Space.of(effects, {**fit.space.signs, **signs})
                found.append((space, np.array([known.get((one.effect, one.field), 0.0) for one in space.coordinates])))
    return found


def without(fit: Fit, effect: str) -> tuple[Space, Array]:
    """Return the space of a fit's other effects, and where these were fitted."""
    rest = [name for name in fit.space.effects if name != effect]
    kept = [own.effect != effect for own in fit.space.coordinates]
    signs = {name: sign for name, sign in fit.space.signs.items() if name.split(".")[0] in rest}
    return Space.of(rest, signs), fit.z[kept]


def extends(wider: Iterable[str], plainer: Iterable[str]) -> bool:
    """Tell whether the law of the one effect extends that of the other one."""
    pair = [*wider], [*plainer]
    return [len(one) for one in pair] == [1, 1] and issubclass(catalogue()[pair[0][0]], catalogue()[pair[1][0]])


def changes(fitter: Fitter, fit: Fit, starts: Sequence[Start]) -> Array:
    """Return the first-order changes (M, starts) of the recording from a fit to each of `starts`."""
    laid: list[Hypothesis] = []
    for one in starts:
        space, z = with_start(fit, one)
        laid.append(space.hypothesis(z))
    return neighbours(fitter.rig, fit.simulation, laid)


def seen_through(fitter: Fitter, fit: Fit, effect: str) -> Start:
    """Return where in its ranges an effect that acts in the sensors alone leaves least beside a fit.

    Nothing has to be simulated for it, so that all its ranges are looked at: a resonance is missed by any slope.
    """
    own = _basis(fit.whitened_jacobian)
    count = Space.of((effect,)).size - Space.of(()).size
    least, best = np.inf, Start(effect, np.zeros(count), {})
    for z in product(np.linspace(-WIDEST, WIDEST, FINE), *[np.linspace(-WIDEST, WIDEST, ROUGH)] * (count - 1)):
        start = Start(effect, np.array(z), {})
        space, whole = with_start(fit, start)
        model = replace(fit.simulation.model, effects=space.hypothesis(whole).effects)
        left = fitter.covariance.whiten(fitter.rig.observation.values - fitter.predict(
            replace(fit.simulation, model=model)))
        left = left - own @ (own.T @ left)
        if float(left @ left) < least:
            least, best = float(left @ left), start
    return best


def in_sensors_alone(effect: str) -> bool:
    """Tell whether an effect changes nothing but what the sensors show."""
    kind = catalogue()[effect]
    return kind.sense is not Effect.sense and kind.period is Effect.period


def signatures(fitter: Fitter, fit: Fit, starts: Sequence[Start], moved: Array) -> Signatures:
    """Return the signatures of effects beside a fit from the changes (M, starts) that they make."""
    own = _basis(fit.whitened_jacobian)
    usable = np.flatnonzero(np.all(np.isfinite(moved), axis=0))
    white = fitter.covariance.whiten(moved[:, usable])
    white -= own @ (own.T @ white)
    columns: dict[str, list[Array]] = {}
    points: dict[str, list[Start]] = {}
    for place, column in zip(usable, white.T, strict=True):
        columns.setdefault(starts[place].effect, []).append(column)
        points.setdefault(starts[place].effect, []).append(starts[place])
    return Signatures(fit.residual - own @ (own.T @ fit.residual),
                      {name: np.column_stack(own) for name, own in columns.items()},
                      {name: tuple(own) for name, own in points.items()})


def alike(fit: Fit, one: str, other: str) -> float:
    """Return how much two effects of a fit look alike: the largest squared cosine of what their parameters change.

    What the others' parameters can do is projected out.
    """
    white, names = fit.whitened_jacobian, np.array([own.effect for own in fit.space.coordinates])
    rest = _basis(white[:, ~np.isin(names, (one, other))])
    first, second = (_basis(own - rest @ (rest.T @ own)) for own in (white[:, names == one], white[:, names == other]))
    return float(np.linalg.svd(first.T @ second, compute_uv=False).max(initial=0.0)**2)


def _basis(columns: Array) -> Array:
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-8 * max(float(size.max(initial=0.0)), FAINT)])
