"""What each block of the rig's model could change in a recording, whatever the law: the model cut at measured signals.

Each block has a space of changes that leaves the equations of all other blocks as they are. With the rig seen from the
arm, ``Z_a x_a = g + Phi``, and the faces behind the specimens' compliance c, ``x = x_a + c Phi``:

- contact law: any friction force dF in a loop; the arm follows the rig, ``dx_a = -dF / Z_a``, so that the measured
  motion and force still satisfy the rig's equation;
- rig: any force on the arm; the contact answers with its own law. A force that runs beside the contact shows in the
  measured force too and is a function of the motion that all loops share;
- excitation: overtones of the drive, which scale with its amplitude;
- geometry, wear law: any field of gap or depth over the contact, with the map and the volume that it leaves;
- sensor: a channel alone, everything else as it was.

The block is the one whose space has the largest evidence for what is left (see `Space`), so that a larger space
has to earn its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from fretflow.core.records import Array, quantity, record
from fretflow.experiments.rig.changes import MAKERS, Loop
from fretflow.experiments.rig.experiment import RigExperiment, simulation_of
from fretflow.inference.evidence import SIZES
from fretflow.inference.least_squares import Fit


@record
class Space:
    """Whitened changes (M, k) of a block: those that all loops share, and those of one loop each."""

    block: str
    shared: Array = quantity("1", "(M, k)")
    single: Array = quantity("1", "(M, l)")

    def evidence(self, residual: Array) -> tuple[float, Array]:
        """Return the largest gain in log evidence over nothing, and the changes (M,) that it takes for it.

        The weights of the columns, without those of one loop or with them, are normal beforehand with one standard
        deviation a; with the singular values s and vectors U of the columns::

            log Z = sum_i [a^2 s_i^2 / (1 + a^2 s_i^2) (U_i^T r)^2 - log(1 + a^2 s_i^2)] / 2
        """
        best, taken = -np.inf, np.zeros_like(residual)
        for columns in (self.shared, np.hstack([self.shared, self.single])):
            left, size, _ = np.linalg.svd(columns, full_matrices=False)
            pulled = left.T @ residual
            signal = (SIZES[:, None] * size)**2
            kept = signal / (1.0 + signal)
            gains = 0.5 * np.sum(kept * pulled**2 - np.log1p(signal), axis=1)
            if gains.max() > best:
                best = float(gains.max())
                taken = left @ (kept[int(gains.argmax())] * pulled)
        return best, taken


@dataclass(frozen=True)
class Cut:
    """A block against what the fitted baseline leaves."""

    block: str
    gain: float  # in log evidence over the baseline alone
    share: float  # of the excess that it takes up
    p_value: float  # that noise alone gains as much


def cuts(experiment: RigExperiment, base: Fit) -> tuple[Cut, ...]:
    """Return the blocks, the most probable first; to first order about the fitted baseline."""
    residual = projected(base, base.residual)
    excess = max(float(residual @ residual) - float(experiment.measurement.expected), 1.0)
    best: dict[str, Cut] = {}
    for space in spaces(experiment, base):
        gain, taken = space.evidence(residual)
        rest = residual - taken
        share = float(np.clip((residual @ residual - rest @ rest) / excess, 0.0, 1.0))
        if space.block not in best or gain > best[space.block].gain:
            # twice the log ratio of likelihoods with one parameter, the amplitude; the gain is what Occam leaves of it
            chance = float(stats.chi2.sf(2.0 * max(gain, 0.0), 1))
            best[space.block] = Cut(space.block, gain, share, chance)
    return tuple(sorted(best.values(), key=lambda cut: -cut.gain))


def projected(base: Fit, columns: Array) -> Array:
    """Return whitened `columns` (M, ...) without what the baseline's own parameters can do."""
    basis, _ = np.linalg.qr(base.whitened_jacobian)
    return np.asarray(columns - basis @ (basis.T @ columns))


def spaces(experiment: RigExperiment, base: Fit) -> list[Space]:
    """Return the spaces of all blocks at a fitted baseline."""
    solved, covariance = simulation_of(base.prediction), experiment.measurement.covariance()
    loops = [Loop.of(experiment.rig, base, period) for period in (*solved.loops, *solved.sweep)]
    by_block = []
    for block, make in MAKERS:
        shared, single = (projected(base, covariance.whiten(part)) for part in make(experiment.rig, loops))
        by_block.append(Space(block=block, shared=shared, single=single))
    return by_block
