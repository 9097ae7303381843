"""The two-mass rig, stepped exactly: forces are linear within a step (first-order hold, matrix exponential)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

BLOCK, ARM = 0, 1  # places in the displacement half of a state; velocities follow


@dataclass(frozen=True)
class Rig:
    """Block on a ground spring, arm hinged to it, and a spring and dashpot from the arm to the ground; SI."""

    block_mass: float = 10.0
    arm_mass: float = 0.5
    in_phase: float = 40.0  # Hz
    out_of_phase: float = 2500.0  # Hz
    damping_ratio: float = 0.01
    added_mass: float = 0.0  # of the specimen, moves with the arm
    beside_stiffness: float = 0.0  # N/m
    beside_damping: float = 0.0  # N s/m

    @property
    def ground(self) -> float:
        """Return the stiffness of the ground spring, N/m."""
        return (self.block_mass + self.arm_mass) * (2.0 * np.pi * self.in_phase)**2

    @property
    def hinge(self) -> float:
        """Return the stiffness of the hinge, N/m."""
        reduced = self.block_mass * self.arm_mass / (self.block_mass + self.arm_mass)
        return reduced * (2.0 * np.pi * self.out_of_phase)**2

    def matrices(self) -> tuple[Array, Array, Array]:
        """Return mass, damping and stiffness (2, 2), order block, arm."""
        pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
        ground_damping = 2.0 * self.damping_ratio * np.sqrt(self.ground * (self.block_mass + self.arm_mass))
        hinge_damping = 2.0 * self.damping_ratio * np.sqrt(self.hinge * self.arm_mass)
        mass = np.diag([self.block_mass, self.arm_mass + self.added_mass])
        damping = np.diag([ground_damping, self.beside_damping]) + hinge_damping * pair
        stiffness = np.diag([self.ground, self.beside_stiffness]) + self.hinge * pair
        return mass, damping, stiffness


@dataclass(frozen=True)
class Scheme:
    """How the rig is integrated over a step.

    `method` is ``exact`` for forces linear in time, ``implicit`` (the theta rule; with theta = 1/2 the trapezoidal
    rule, which is Newmark's of constant average acceleration) or ``explicit`` (velocity Verlet, which is Newmark's of
    central differences).
    """

    method: str = "exact"
    theta: float = 0.5  # of the implicit rule; more damps


EXACT = Scheme()


@dataclass(frozen=True)
class Step:
    """``y' = free y + early f + late f'`` over one step, with forces (block, arm) at its start and end."""

    free: Array  # (4, 4)
    early: Array  # (4, 2)
    late: Array  # (4, 2)


def step_of(rig: Rig, duration: float, scheme: Scheme = EXACT) -> Step:
    """Return the step of `duration` in s.

    Sources: C. F. Van Loan, IEEE Trans. Autom. Control 23 (1978) 395-404 for the exponential of the system augmented by
    force and force rate; N. M. Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67-94 for the others.
    """
    mass, damping, stiffness = rig.matrices()
    if scheme.method == "implicit":
        return _implicit_step(mass, damping, stiffness, duration, scheme.theta)
    if scheme.method == "explicit":
        return _explicit_step(mass, damping, stiffness, duration)
    augmented = np.zeros((8, 8))
    augmented[0:2, 2:4] = np.eye(2)
    augmented[2:4, 0:2] = -np.linalg.solve(mass, stiffness)
    augmented[2:4, 2:4] = -np.linalg.solve(mass, damping)
    augmented[2:4, 4:6] = np.linalg.inv(mass)
    augmented[4:6, 6:8] = np.eye(2)
    transition = expm(augmented * duration)
    late = transition[:4, 6:8] / duration
    return Step(transition[:4, :4], transition[:4, 4:6] - late, late)


def _implicit_step(mass: Array, damping: Array, stiffness: Array, duration: float, theta: float) -> Step:
    pull, drag = np.linalg.solve(mass, stiffness), np.linalg.solve(mass, damping)
    rates = np.block([[np.zeros((2, 2)), np.eye(2)], [-pull, -drag]])
    forced = duration * np.vstack([np.zeros((2, 2)), np.linalg.inv(mass)])
    left = np.linalg.inv(np.eye(4) - theta * duration * rates)
    return Step(left @ (np.eye(4) + (1.0 - theta) * duration * rates), (1.0 - theta) * left @ forced,
                theta * left @ forced)


def _explicit_step(mass: Array, damping: Array, stiffness: Array, duration: float) -> Step:
    pull, drag, push = (np.linalg.solve(mass, one) for one in (stiffness, damping, np.eye(2)))
    half, none = 0.5 * duration, np.zeros((2, 2))
    # accelerations at the start by position, velocity, force; then positions, and velocities with those at the end
    place = np.hstack([np.eye(2) - duration * half * pull, duration * np.eye(2) - duration * half * drag,
                       duration * half * push, none])
    kept = np.linalg.inv(np.eye(2) + half * drag)
    speed = kept @ (np.hstack([-half * pull, np.eye(2) - half * drag, half * push, half * push]) - half * pull @ place)
    both = np.vstack([place, speed])
    return Step(both[:, :4], both[:, 4:6], both[:, 6:])
