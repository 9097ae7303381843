"""The rig's equations of motion as a test of its channels: they hold whatever the contact does.

At each harmonic of every repeat, with the rig's receptances H, block b, arm a, and the specimens' compliance c ::

    H_ab excitation = (1 / g_x) (1 + i w t_x) x + (1 / g_F + c / H_aa) (1 + i w t_F) H_aa F + i w d H_ab x

The gains g, delays t, c and d, by which the rig's damping differs from what is stated, are fitted by linear least
squares. Repeats tell the errors, so that whether the equations hold at all is an F test of lack of fit (N. R. Draper,
H. Smith, Applied Regression Analysis, 3rd ed. (1998), 2.1). The terms have such errors too, which make the unknowns too
small: what repeats tell of them is taken off the moments (W. A. Fuller, Measurement Error Models (1987), 2.2). One gain
of a repeat changes all its harmonics: the unknowns are no surer than their repeats, taken as a whole each, make them
(K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13-22).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fretflow.core.records import Array
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.periods import LEVEL
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import SMOOTH, is_unsteady
from fretflow.structure.two_mass_rig.lumped import LumpedRig

Complex = NDArray[np.complex128]


class Unknown(IntEnum):
    """Places of the unknowns: the inverse gains of two channels, each before its delay by it, then c."""

    DISPLACEMENT = 0
    DISPLACEMENT_DELAY = 1
    FORCE = 2
    FORCE_DELAY = 3
    COMPLIANCE = 4


POWERS = (1, 2, 3)  # of the motion, that further forces on the arm go with
GAINS = [Unknown.DISPLACEMENT, Unknown.FORCE]
DELAYS = [Unknown.DISPLACEMENT_DELAY, Unknown.FORCE_DELAY]


def blocks_of(recording: Recording) -> list[tuple[LoopSet, Array]]:
    """Return the loops of the test and of the sweep after it, and the frequency (K,) of each in Hz."""
    usual = recording.test.excitation_frequency or np.nan
    blocks = [] if recording.loops is None else [(recording.loops, np.full(len(recording.loops.cycles), usual))]
    if recording.sweep is not None:
        own = {one.id: one.excitation_frequency or usual for one in recording.sweep.conditions}
        blocks.append((recording.sweep.loops, np.array([own[int(k)] for k in recording.sweep.loops.cycles])))
    return blocks


@dataclass(frozen=True)
class Solution:
    """Least squares of the equations: unknowns (p,), first 1 / g_x, t_x / g_x, 1 / g_F, t_F / g_F, c and d."""

    values: Array
    covariance: Array  # (p, p)
    squares: float
    freedom: int
    repeats: int
    lack_of_fit: float  # p-value
    attenuated: Array  # (p,), by what errors of the terms had made the unknowns too small
    independent: Array  # (p,), variances if a repeat's harmonics had errors of their own

    @property
    def holds(self) -> bool:
        """Tell whether what is left is no more than what repeats differ by, and that no more than what errors may.

        Loops that do not repeat themselves with the drive are none that the equations hold for: gains would follow
        from how their repeats differ.
        """
        moved = self.attenuated[GAINS]**2 / self.independent[GAINS]
        return self.lack_of_fit > LEVEL and bool(np.all(stats.f.sf(moved, 1, self.freedom) > LEVEL))

    def is_off(self, distance: float, variance: float, known: float = 0.0) -> bool:
        """Tell whether a distance is more than chance makes it; of its variance repeats tell one part.

        Degrees of freedom by F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110-114.
        """
        freedom = max(1, self.repeats - len(self.values)) * ((variance + known) / variance)**2
        return bool(stats.f.sf(distance**2 / (variance + known), 1, freedom) < LEVEL)

    def better_than(self, plain: Solution, level: float = LEVEL) -> bool:
        """Tell whether the unknowns beyond those of `plain` take more off what is left than chance does."""
        more = plain.freedom - self.freedom
        gained = (plain.squares - self.squares) / more / (self.squares / self.freedom)
        return bool(stats.f.sf(gained, more, self.freedom) < level)

    def odds_over(self, other: Solution) -> float:
        """Return the ratio of likelihoods to a solution with other unknowns."""
        return float(np.exp(min(0.5 * (other.squares - self.squares) / (self.squares / self.freedom), 700.0)))


@dataclass(frozen=True)
class Equations:
    """The terms of all equations (n,): those of a loop's harmonic differ by the repeat alone."""

    drive: Complex  # H_ab excitation, m
    displacement: Complex  # m
    friction: Complex  # H_aa F, m
    force: Complex  # F, N
    damped: Complex  # H_ab x, m^2 / N
    omega: Array  # rad/s
    harmonic: NDArray[np.int64]
    loop: NDArray[np.int64]
    repeat: NDArray[np.int64]  # numbered over all loops
    cycles: NDArray[np.int64]

    @classmethod
    def of(cls, recording: Recording, rig: LumpedRig) -> Equations | None:
        """Return the equations of a recording; None without a record of the drive, as a stated one has no phase.

        None too where the motion does not repeat itself with the drive: what repeats differ by is then no error.
        """
        first = recording.loops
        if first is None or "excitation" not in first.channels or not is_periodic(first):
            return None
        rows: list[tuple[Any, ...]] = []
        for loops, frequency in blocks_of(recording):
            if "excitation" not in loops.channels:
                continue
            own = loops is first
            place = 0 if own else len(first.cycles)
            cycles = loops.cycles if own else np.full(len(frequency), first.cycles[-1])
            lines = [np.fft.rfft(loops.channels[name], axis=2) * 2.0 / len(loops.phase)
                     for name in ("excitation", "displacement", loops.force_name)]
            for k, j in zip(*np.nonzero(loops.usable), strict=True):
                rows += [(*(line[k, j, n] for line in lines), 2.0 * np.pi * n * frequency[k], n, place + k,
                          len(rows) // SMOOTH, cycles[k]) for n in range(1, SMOOTH + 1)]
        excitation, x, force, omega, *places = (np.array(column) for column in zip(*rows, strict=True))
        receptance = np.linalg.inv(rig.impedance(omega))
        block, arm = receptance[:, 1, 0], receptance[:, 1, 1]
        return cls(block * excitation, x, arm * force, force, block * x, omega, *places)

    @cached_property
    def groups(self) -> tuple[NDArray[np.int64], int]:
        """Return which loop's harmonic each equation belongs to, and how many there are."""
        names, own = np.unique(np.stack([self.loop, self.harmonic]), axis=1, return_inverse=True)
        return own.reshape(-1), names.shape[1]

    @property
    def repeated(self) -> bool:
        """Tell whether any loop has repeats, which tell the errors."""
        own, count = self.groups
        return len(own) > count

    def synchronised(self, late: Array) -> tuple[Array, Solution] | None:
        """Return by how many seconds displacement and force (2,) come late, and the least squares without that.

        Gauss-Newton from a first guess `late` to a thousandth of its errors, else None: delays of a few samples turn
        higher harmonics by more than first order.
        """
        for _ in range(20):  # where there is a root, a handful
            x, force = np.exp(1j * np.outer(late, self.omega))
            solution = replace(self, displacement=x * self.displacement, damped=x * self.damped,
                               friction=force * self.friction, force=force * self.force).solve()
            step = solution.values[DELAYS] / solution.values[GAINS]
            if np.all(np.abs(step) < 1e-3 * np.sqrt(np.diag(solution.covariance)[DELAYS])):
                return late, solution
            late = late + step
        return None

    def solve(self, more: Sequence[Complex] = ()) -> Solution:
        """Return the least squares with further terms (n,), each with a real unknown of its own.

        Each harmonic is weighted by what repeats differ by there.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the terms do not tell the unknowns, or there are no repeats.
        """
        delayed = 1j * self.omega
        terms = np.stack([self.displacement, delayed * self.displacement, self.friction, delayed * self.friction,
                          self.force, delayed * self.damped, *more], axis=1)
        left = self.drive - self.displacement - self.friction
        own, count = self.groups
        freedom = 2 * (len(own) - count)
        if not self.repeated:
            raise np.linalg.LinAlgError("no loop has two repeats")
        for _ in range(2):  # the weights, then the compliance in them and in what comes late
            away = np.abs(left - self._repeated(left))**2
            weight = 1.0 / np.sqrt([np.mean(away[self.harmonic == n]) for n in self.harmonic])
            rows, wanted = _real(weight[:, None] * terms), _real(weight * self.drive)
            size = np.linalg.norm(rows, axis=0)
            inverse = np.linalg.inv((rows / size).T @ (rows / size)) / np.outer(size, size)
            scatter = _real(weight[:, None] * (terms - np.stack([self._repeated(one) for one in terms.T], axis=1)))
            errors = scatter.T @ scatter * len(own) / (len(own) - count)
            plain = inverse @ (rows.T @ wanted)
            values = np.linalg.solve((rows.T @ rows - errors) / np.outer(size, size), rows.T @ wanted / size) / size
            left = self.drive - terms @ values
            terms[:, Unknown.FORCE_DELAY] = delayed * (self.friction + values[Unknown.COMPLIANCE] * self.force)
        squares = float(np.sum((weight * np.abs(left))**2))
        pure = float(np.sum((weight * np.abs(left - self._repeated(left)))**2))
        lacking = 2 * count - len(values)
        ratio = (squares - pure) / lacking / (pure / freedom)
        covariance, repeats = inverse * squares / (freedom + lacking), len(np.unique(self.repeat))
        summed = np.zeros((repeats, len(values)))  # the score of each repeat
        np.add.at(summed, np.tile(self.repeat, 2), rows * _real(weight * left)[:, None])
        alike = np.sum((summed @ inverse)**2, axis=0) * repeats / (repeats - 1) / np.diag(covariance)
        less = np.sqrt(np.maximum(alike, 1.0))
        return Solution(values, covariance * np.outer(less, less), squares, freedom + lacking, repeats,
                        float(stats.f.sf(ratio, lacking, freedom)), values - plain, np.diag(covariance))

    def _repeated(self, values: Complex) -> Complex:
        """Return the means (n,) over the repeats."""
        own, count = self.groups
        total = np.zeros(count, dtype=complex)
        np.add.at(total, own, values)
        return np.asarray((total / np.bincount(own))[own])


def further_forces(recording: Recording, equations: Equations) -> list[Complex]:
    """Return the terms (n,) of forces on the arm that go with powers of its motion, or with its speed's square.

    A drag may also act beside the specimens, which then yield less than the sensor of the force tells.
    """
    lines = []
    for loops, _ in [one for one in blocks_of(recording) if "excitation" in one[0].channels]:
        spectrum = np.fft.rfft(loops.mean("displacement"))
        spectrum[:, 0] = 0.0
        motion, speed = (np.fft.irfft(own, len(loops.phase)) for own in (
            spectrum, spectrum * 1j * np.arange(spectrum.shape[1])))
        own = np.fft.rfft(np.stack([*(motion**power for power in POWERS), np.abs(speed) * speed]))
        lines += [own[:, k, 1:SMOOTH + 1] for k in np.nonzero(loops.usable)[0]]
    bent = np.concatenate(lines, axis=1)
    return [*(equations.friction / equations.force * bent), bent[-1]]


def is_periodic(loops: LoopSet) -> bool:
    """Tell whether displacement and force repeat themselves with the drive but for noise, as far as repeats tell."""
    return not is_unsteady(loops.channels["displacement"], loops.channels[loops.force_name])


def _real(rows: Complex) -> Array:
    return np.concatenate([rows.real, rows.imag])
