"""Newton on the coefficients of the internal coordinates, with the exact tangent of the contact's force.

Semi-smooth: samples that change their state put kinks into the force, so that far from a root the line search may creep
from kink to kink. A start that is close enough (see `quasi_static.starts`) is what makes it converge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.quasi_static.internal import InternalBalance, InternalEquations
from fretflow.solvers.quasi_static.march import ContactMarch, PeriodicMarch
from fretflow.solvers.quasi_static.sample import Array, PeriodHistory, SampleState

SMALLEST_STEP = 1e-3
REPEATS = 0.02  # how well a period must repeat, relative to the residual before it
LAGGED = 0.3  # decrease of the residual with which a former tangent serves
NEAR = 1e-2  # residual below which the last period is a good guess of the next
CLOSE = 5e-3  # residual of a neighbouring period below which no other start is looked at
STALLED = 10.0  # times the tolerance at which a residual that no step lowers is taken, by whoever takes such
COARSE = 1e-6  # tolerance from which a period is a step on the way to something, and its contact as rough
HALVED = 0.5
ACROSS = 4.0  # growth of the smallest residual that is let pass, as nodes change state
TANGENT_BYTES = 2**28  # of the tangent that is marched at once


@dataclass(frozen=True)
class InitialGuess:
    """Coefficients of a and of b, None where b follows a, and what is known near by.

    That is a period, and the `tangent` (n_a, n_a) N/m of the contact's force.
    """

    seen: Array
    other: Array | None = None
    near: PeriodHistory | None = None
    tangent: Array | None = None


@dataclass(frozen=True)
class Iterate:
    """The coefficients of a, the period they make, the structure's balance with it and its norm over the load.

    `felt` (n_a,) N is the contact's force on a and `tangent` (n_a, n_a) N/m its derivative, None where it has to be
    made anew. b `follows` a, or is an unknown beside it.
    """

    seen: Array
    history: PeriodHistory
    felt: Array
    balance: InternalBalance
    norm: float
    tangent: Array | None
    follows: bool


class InternalNewton:
    """Newton on the coefficients of a with a line search on the residual.

    The tangent costs five times the period itself, so that it is made only where a step was taken. Close to the root
    that of the step before serves, at first that of the start, corrected so that it gives the change of force just
    seen (C. G. Broyden, Math. Comp. 19 (1965) 577-593).
    """

    def __init__(self, equations: InternalEquations, march: ContactMarch, tolerance: float,
                 patience: int | None = None, takes_stalled: bool = False) -> None:
        """Take the steps in which a residual far from the root has to halve; by default it may creep."""
        self.equations = equations
        self.march = march
        self.tolerance = tolerance
        self.patience = patience
        self.takes_stalled = takes_stalled
        self.smallest = np.inf  # residual so far
        self.lagged = False  # whether a former tangent was tried

    def solve(self, starts: Iterator[InitialGuess], before: SampleState, max_iterations: int
              ) -> tuple[Iterate, tuple[float, ...]]:
        """Return the root and the residual history; where former tangents lead astray, again without them.

        Further starts are looked at only where those before are far from balance; the best of them is taken.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        """
        return self.refine(self.best(starts, before), max_iterations)

    def refine(self, first: Iterate, max_iterations: int) -> tuple[Iterate, tuple[float, ...]]:
        """Return the root near `first` and the residual history. Raises as `solve`."""
        try:
            return self._solve(first, max_iterations, NEAR)
        except NonConvergenceError:
            if self.patience is None and (self.smallest >= NEAR or not self.lagged):  # it would go the same way
                raise
            return self._solve(first, max_iterations, 0.0)

    def best(self, starts: Iterator[InitialGuess], before: SampleState) -> Iterate:
        """Return the first of the starts that is close to balance, else the closest."""
        best: Iterate | None = None
        while best is None or best.norm > CLOSE:
            try:
                start = next(starts, None)
                if start is None:
                    break
                period = self._march(start.seen, self._none, before, start.near, 1.0)
                iterate = self._iterate(start, period.history, start.tangent)
            except NonConvergenceError as error:
                failure = error
                continue
            best = iterate if best is None or iterate.norm < best.norm else best
        if best is None:
            raise failure
        return best

    def _march(self, seen: Array, directions: Array, before: SampleState, near: PeriodHistory | None, last: float
               ) -> PeriodicMarch:
        """March the period of `seen`; `last` is the norm before, for the contact's accuracy."""
        # the contact need not be solved much closer than the residual that Newton is about to reach
        accuracy = max(0.1 * self.tolerance, min(1e-6, 1e-3 * last**2))
        repeat = min(REPEATS * last, last**2)
        return self.march.period(self.equations.motion(seen), directions, before, near, accuracy, repeat)

    def tangent(self, at: Iterate) -> Array:
        """Return the derivative (n_a, n_a) N/m of the contact's force there."""
        return self._differentiated(at)[1]

    @property
    def _none(self) -> Array:
        return np.zeros((len(self.equations.synthesis), len(self.equations.seen), 0))

    def _felt(self, history: PeriodHistory) -> Array:
        return self.equations.coefficients(history.force @ self.march.system.transfer.T)

    def _iterate(self, at: InitialGuess, history: PeriodHistory, tangent: Array | None = None) -> Iterate:
        e = self.equations
        balance = e.balance(at.seen) if at.other is None else e.beside_balance(at.seen, at.other)
        felt = self._felt(history)
        residual = balance.residual - felt
        return Iterate(at.seen, history, felt, replace(balance, residual=residual),
                        float(np.hypot(np.linalg.norm(residual), balance.size)) / e.scale, tangent, at.other is None)

    def _solve(self, first: Iterate, max_iterations: int, lagged_below: float) -> tuple[Iterate, tuple[float, ...]]:
        now, self.smallest, self.lagged = first, first.norm, False
        history = [now.norm]
        while not now.norm <= self.tolerance:  # nan included
            try:
                gives_up = len(history) > max_iterations or self._creeps(history)
                following = None if gives_up else self._step(now, lagged_below)
            except NonConvergenceError as error:
                error.history = error.history or tuple(history)
                raise
            if following is None and not gives_up and self.takes_stalled and now.norm <= STALLED * self.tolerance:
                return now, tuple(history)
            if following is None:
                way = "raise max_iterations" if len(history) > max_iterations else "use more samples"
                raise NonConvergenceError(
                    f"quasi-static period: residual {now.norm:.1e} of the excitation after {len(history) - 1} "
                    f"iterations; {way}, or start from a neighbouring solution", history)
            now, self.smallest = following, min(self.smallest, following.norm)
            history.append(now.norm)
        return now, tuple(history)

    def _creeps(self, history: list[float]) -> bool:
        """Tell whether the last steps led nowhere; close to the root that is the accuracy of the march."""
        if self.patience is None or len(history) <= self.patience:
            return False
        best = min(history[-self.patience:])
        return best > max(COARSE, HALVED * min(history[:-self.patience]))

    def _step(self, now: Iterate, lagged_below: float) -> Iterate | None:
        if now.tangent is not None:
            self.lagged = True
            following = self._searched(now, now.tangent, lagged_below, shortest=1.0)
            if following is not None:
                return following
        closer, tangent = self._differentiated(now)
        if closer.norm <= self.tolerance:  # what was left came from the accuracy of the march
            return closer
        return self._searched(closer, tangent, lagged_below, SMALLEST_STEP)

    def _searched(self, now: Iterate, tangent: Array, lagged_below: float, shortest: float) -> Iterate | None:
        """Return the iterate after the longest step that helps; with a tangent only where that serves once more.

        From kink to kink such steps only creep, where whole ones lead across, to a smaller residual a few steps later
        (R. M. Chamberlain et al., Math. Program. Stud. 16 (1982) 1-17): where patience has an end those come first.
        """
        step = np.linalg.solve(now.balance.linear.jacobian - tangent, -now.balance.reduced)
        moved, length = now.balance.other_step(step), 1.0
        bound = ACROSS * self.smallest if self.patience and lagged_below and shortest < 1.0 else 0.0
        while length >= shortest:
            following = self._tried(now, tangent, length * step, length * moved)
            if following is not None and following.norm < max((1.0 - 1e-3 * length) * now.norm, bound):
                serves = following.norm < min(lagged_below, LAGGED * now.norm)
                return following if serves else replace(following, tangent=None)
            length *= 0.5
        return None

    def _differentiated(self, now: Iterate) -> tuple[Iterate, Array]:
        """Return the same iterate, marched once more, and the tangent there, made by as many columns as fit."""
        e = self.equations
        directions, history, parts = e.directions(), now.history, []
        columns = max(1, TANGENT_BYTES // (8 * directions[:, :, 0].size))
        for first in range(0, directions.shape[2], columns):
            period = self._march(now.seen, directions[:, :, first:first + columns], SampleState.of(history), history,
                                 now.norm)
            history = period.history
            parts.append(e.coefficients(period.tangent))
        other = None if now.follows else now.balance.other
        return self._iterate(InitialGuess(now.seen, other), history), np.hstack(parts)

    def _tried(self, now: Iterate, tangent: Array, step: Array, moved: Array) -> Iterate | None:
        """Return the iterate after a step, with the tangent corrected by it; None where the contact is not found."""
        near = now.history if now.norm < NEAR else None
        try:
            history = self._march(now.seen + step, self._none, SampleState.of(now.history), near, now.norm).history
        except NonConvergenceError:  # of the contact, too far from where it was
            return None
        corrected = tangent + np.outer(self._felt(history) - now.felt - tangent @ step, step / (step @ step))
        return self._iterate(InitialGuess(now.seen + step, now.balance.other + moved), history, corrected)
