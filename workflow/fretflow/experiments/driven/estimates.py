"""Parameters of a driven joint with intervals that hold where residuals are correlated."""

from __future__ import annotations

import numpy as np
from scipy import stats

from fretflow.experiments.driven.data import Array, DrivenData
from fretflow.experiments.driven.fit import DrivenFit, fit, parameter_unit
from fretflow.experiments.driven.noise import effective
from fretflow.experiments.driven.search import THOROUGH, plausible_sizes
from fretflow.inference.verdict import Estimate

LEVEL = 0.95  # quantile of an interval's upper end
LEAST_BLOCKS = 10


def refitted(data: DrivenData, found: DrivenFit) -> DrivenFit:
    """Return the joint fitted to all that is used, what was held out included."""
    return fit([found.joint], data.motion, data.force, found.names, data.used, THOROUGH, plausible_sizes(found.joint))


def estimates(data: DrivenData, found: DrivenFit) -> tuple[Estimate, ...]:
    """Return the parameters with their 90 % intervals.

    The covariance is ``(J^T J)^-1 (sum over blocks of g g^T) (J^T J)^-1`` with ``g = J^T r`` of a block (Huber 1967;
    Newey and West, Econometrica 55, 1987), which needs no model of how residuals are correlated within a block.
    """
    if not found.names:
        return ()
    jacobian = found.joint.derivatives(data.motion, found.names)[data.used]
    left = found.residual[data.used]
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    independent = effective(found.residual, data.used)
    blocks = int(np.clip(independent / 3.0, LEAST_BLOCKS, max(LEAST_BLOCKS, len(left) // 4)))
    sd = _block_sd(jacobian / size, left, blocks) / size
    freedom = max(blocks - len(found.names), 3)
    reach = float(stats.t.ppf(LEVEL, freedom)) * sd
    made = []
    for name, value, half in zip(found.names, found.value, reach, strict=True):
        low, high = found.joint.bounds[name]
        part, _, field = name.partition(".")
        meaning = type(found.joint.parts[part]).model_fields[field].description or ""
        made.append(Estimate(name=name, value=float(value), low=float(max(value - half, low)),
                             high=float(min(value + half, high)), unit=parameter_unit(found.joint, name) or "1",
                             meaning=meaning))
    return tuple(made)


def _block_sd(jacobian: Array, left: Array, blocks: int) -> Array:
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = np.array([j.T @ r for j, r in zip(np.array_split(jacobian, blocks), np.array_split(left, blocks),
                                               strict=True)])
    correction = blocks / max(blocks - jacobian.shape[1], 1)
    clustered = np.diag(inverse @ (scores.T @ scores) @ inverse) * correction
    plain = np.diag(inverse) * float(left @ left) / max(len(left) - jacobian.shape[1], 1)
    return np.asarray(np.sqrt(np.maximum(np.maximum(clustered, plain), 0.0)))
