"""Whether the fitted baseline leaves more than errors explain, by classical tests beside the posterior's answer.

The whitened residual, what the baseline's parameters can do projected out, is standard normal under the null.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from fretflow.experiments.rig.observation import Array, Observation
from fretflow.inference.least_squares import Fit
from fretflow.inference.verdict import Detection

FALSE_ALARMS = 0.05


def detect(observation: Observation, base: Fit) -> Detection:
    """Return whether anything is left at a fitted baseline: in all, and in the harmonics that loops have in common."""
    residual = base.residual
    tests = {"chi-squared of all that is left": float(stats.chi2.sf(base.chi_squared, len(residual) - len(base.z))),
             "harmonics of the loops by their trend over the cycles": _harmonics(observation, residual, base)}
    name = min(tests, key=lambda key: tests[key])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def _harmonics(observation: Observation, residual: Array, base: Fit) -> float:
    """Return the p-value of the largest harmonic of a channel's residual, constant or linear in the loops' order."""
    probes = []
    angle = 2.0 * np.pi * np.arange(observation.samples) / observation.samples
    waves = [shape(k * angle) for k in range(1, observation.harmonics + 1) for shape in (np.cos, np.sin)]
    for channel in dict.fromkeys(piece.channel for piece in observation.pieces if piece.block == "loops"):
        pieces = [piece for piece in observation.pieces if piece.block == "loops" and piece.channel == channel]
        trend = np.linspace(-1.0, 1.0, len(pieces)) if len(pieces) > 1 else np.zeros(1)
        for wave in waves:
            for weight in (np.ones(len(pieces)), trend):
                probe = np.zeros(len(residual))
                for piece, size in zip(pieces, weight, strict=True):
                    probe[piece.place] = size * wave
                if np.any(probe):
                    probes.append(probe)
    own, _ = np.linalg.qr(base.whitened_jacobian)
    probed = np.column_stack(probes)
    probed -= own @ (own.T @ probed)
    size = np.linalg.norm(probed, axis=0)
    kept = size > np.finfo(np.float32).eps * size.max()
    squares = (probed[:, kept].T @ residual / size[kept])**2
    return float(min(1.0, kept.sum() * stats.chi2.sf(squares.max(), 1)))
