"""A first guess of the arm's motion: the whole contact as one Jenkins element on the rig.

The element has the stuck joint's tangential stiffness and the friction limit mu N. The rig with it is marched in time
(trapezoidal rule, implicit) until it repeats, which costs milliseconds and needs no guess of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi

import numpy as np
from numpy.typing import NDArray

from fretflow.structure.internal_forces import InternalForce
from fretflow.structure.two_mass_rig.lumped import LumpedRig

MAX_PERIODS = 200
MAX_EXPLICIT_PERIODS = 20
ROUGHLY = 1e-3  # how well an explicit march must repeat
REPEATS_TO = 1e-4


@dataclass
class _Mass:
    """Displacement, velocity and acceleration of a lumped mass."""

    x: float = 0.0
    v: float = 0.0
    a: float = 0.0

    def move(self, x: float, h: float) -> None:
        """Advance to `x` by the trapezoidal rule of step `h`."""
        v = 2.0 / h * (x - self.x) - self.v
        self.a = 2.0 / h * (v - self.v) - self.a
        self.x, self.v = x, v


def jenkins_arm_motion(rig: LumpedRig, stiffness: float, limit: float, excitation: float, frequency: float,
                       samples: int) -> NDArray[np.float64]:
    """Return one period of the arm's motion (samples,) in m, close to periodic.

    Parameters
    ----------
    rig : LumpedRig
    stiffness, limit : float
        Of the Jenkins element, N/m and N.
    excitation, frequency : float
        Force amplitude on the block in N, and Hz.
    samples : int
        Samples of the period; also the steps of the march.
    """
    h = 1.0 / (frequency * samples)
    k11, k12, k22 = _entries(rig.stiffness + 2.0 / h * rig.damping + 4.0 / h**2 * rig.mass)
    schur = k22 - k12 * k12 / k11
    c11, c12, c22 = _entries(rig.damping)
    forces = [excitation * cos(2.0 * pi * (j + 1) / samples) for j in range(samples)]
    block, arm, friction = _Mass(), _Mass(), 0.0
    before: NDArray[np.float64] = np.full(samples, np.inf)
    for _ in range(MAX_PERIODS):
        motion = []
        for force in forces:
            vb, va = 2.0 / h * block.x + block.v, 2.0 / h * arm.x + arm.v
            push_b = rig.moving_mass * (2.0 / h * (vb + block.v) + block.a) + c11 * vb + c12 * va + force
            push_a = rig.arm_mass * (2.0 / h * (va + arm.v) + arm.a) + c12 * vb + c22 * va
            push = push_a - k12 / k11 * push_b
            x = (push - friction + stiffness * arm.x) / (schur + stiffness)
            friction += stiffness * (x - arm.x)
            if abs(friction) > limit:
                friction = limit if friction > 0.0 else -limit
                x = (push - friction) / schur
            block.move((push_b - k12 * x) / k11, h)
            arm.move(x, h)
            motion.append(x)
        after: NDArray[np.float64] = np.roll(motion, 1)  # the march ends its steps at t_1 ... t_N
        if np.abs(after - before).max() < REPEATS_TO * np.ptp(after):
            break
        before = after
    return after


def _entries(matrix: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the entries 11, 12 and 22 of a symmetric matrix as floats, which are faster than NumPy's."""
    return float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])


def jenkins_rig_motion(rig: LumpedRig, forces: Sequence[InternalForce], stiffness: float, limit: float,
                       excitation: Sequence[float], frequency: float) -> NDArray[np.float64]:
    """Return one period of block and arm (steps, 2) in m, close to periodic, under further forces on them.

    Parameters
    ----------
    rig, stiffness, limit, frequency
        As for `jenkins_arm_motion`.
    forces : sequence of InternalForce
    excitation : sequence of float
        Force on the block in N at each step; a step must be a small part of the rig's fastest oscillation.

    Notes
    -----
    Explicit (symplectic Euler): forces that set in suddenly need small steps anyway.
    """
    h = 1.0 / (frequency * len(excitation))
    (kb, kc, ka), (cb, cc, ca) = _entries(rig.stiffness), _entries(rig.damping)
    x, v, slider = np.zeros((1, 2)), np.zeros((1, 2)), 0.0
    before: NDArray[np.float64] = np.full((len(excitation), 2), np.inf)
    for _ in range(MAX_EXPLICIT_PERIODS):
        after = np.empty_like(before)
        for j, push in enumerate(excitation):
            after[j] = x[0]
            beside = sum((force(x, v).force[0] for force in forces), np.zeros(2))
            (xb, xa), (vb, va) = x[0], v[0]
            friction = min(max(stiffness * (xa - slider), -limit), limit)
            slider = xa - friction / stiffness
            v[0, 0] += h / rig.moving_mass * (push + beside[0] - kb * xb - kc * xa - cb * vb - cc * va)
            v[0, 1] += h / rig.arm_mass * (beside[1] - friction - kc * xb - ka * xa - cc * vb - ca * va)
            x += h * v
        if np.abs(after - before).max() < ROUGHLY * np.ptp(after[:, 1]):
            break
        before = after
    return after
