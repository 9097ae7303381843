"""Which effects could explain what is left, before any of them is fitted.

At the fitted baseline, each effect is laid out at a few points of its ranges; the first-order changes of the recording
from no effect to these points span what it can do. With a standard normal weight on each column, and the baseline's own
parameters projected out, the gain in log evidence of a set of columns S over none is::

    (S^T r)^T (1 + S^T S)^-1 (S^T r) / 2 - log det(1 + S^T S) / 2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fretflow.diagnosis.coordinates import Space
from fretflow.diagnosis.fit import Fit, Fitter
from fretflow.diagnosis.observation import Array
from fretflow.diagnosis.rig_model import Hypothesis
from fretflow.diagnosis.tangent import neighbours
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import Kind

AWAY = 1.2  # coordinate of a point beside the middle of the ranges
FAINT = 1e-9


@dataclass(frozen=True)
class Signatures:
    """Whitened changes (M, columns) by effect, with the baseline's own parameters projected out."""

    residual: Array
    columns: Mapping[str, Array]

    def gain(self, effects: Sequence[str]) -> float:
        """Return the gain in log evidence over the baseline."""
        s = np.hstack([self.columns[name] for name in effects])
        inner = np.eye(s.shape[1]) + s.T @ s
        pulled = s.T @ self.residual
        return float(0.5 * pulled @ np.linalg.solve(inner, pulled) - 0.5 * np.linalg.slogdet(inner)[1])

    def explained(self, effects: Sequence[str]) -> float:
        """Return the share of what is left that the effects' columns can take up, at any weight."""
        s = np.hstack([self.columns[name] for name in effects])
        basis = _basis(s)
        return float(np.sum((basis.T @ self.residual)**2) / max(float(self.residual @ self.residual), FAINT))

    def apart(self, one: str, other: str) -> float:
        """Return the sine of the angle between the main directions of two effects."""
        a, b = (_main(self.columns[name]) for name in (one, other))
        return float(np.sqrt(max(0.0, 1.0 - float(a @ b)**2)))


def signatures(fitter: Fitter, base: Fit) -> Signatures:
    """Return the signatures of all effects of the catalogue that act in the rig, at a fitted baseline."""
    kinds = {name: kind for name, kind in catalogue().items() if Kind.FRETTING_RIG in kind.kinds}
    laid: list[tuple[str, Hypothesis]] = []
    for name in kinds:
        laid += [(name, one) for one in _points(name, base)]
    changes = neighbours(fitter.rig, base.simulation, [one for _, one in laid])
    own = _basis(base.whitened_jacobian)
    found: dict[str, list[Array]] = {name: [] for name in kinds}
    for (name, _), change in zip(laid, changes.T, strict=True):
        if np.all(np.isfinite(change)):
            white = fitter.covariance.whiten(change)
            found[name].append(white - own @ (own.T @ white))
    residual = base.residual - own @ (own.T @ base.residual)
    return Signatures(residual, {name: np.column_stack(columns) for name, columns in found.items() if columns})


def _points(name: str, base: Fit) -> list[Hypothesis]:
    """Return the hypotheses at the middle of an effect's ranges and beside it, the baseline as fitted."""
    space = Space.of((name,))
    own = len(base.z)
    points = [np.zeros(space.size - own)]
    for i in range(space.size - own):
        for way in (-AWAY, AWAY):
            points.append(points[0].copy())
            points[-1][i] = way
    return [space.hypothesis(np.concatenate([base.z, point])) for point in points]


def _basis(columns: Array) -> Array:
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-8 * max(float(size.max(initial=0.0)), FAINT)])


def _main(columns: Array) -> Array:
    left, _, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, 0])
