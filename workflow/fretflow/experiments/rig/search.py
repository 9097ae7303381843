"""The fits of sets of effects to a recording of the rig, and how they are made from one another.

Models are compared by their evidence, tempered: two independent codes differ by more than noise even
where nothing is hidden, and laws are never exactly those of the catalogue, so that differences in log evidence count
less by `SYSTEMATIC`, and less again where even the best fit leaves more than noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import log
from typing import Protocol, TypeVar

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.experiments.rig.coordinates import Space
from fretflow.experiments.rig.fit import Fit, Fitter
from fretflow.experiments.rig.model import RigModel, Simulation
from fretflow.experiments.rig.observation import Array
from fretflow.experiments.rig.screening import (
    Signatures,
    Start,
    changes,
    in_sensors_alone,
    rig_effects,
    seen_through,
    signatures,
    starts_beside,
    swapped,
    with_start,
    without,
)
from fretflow.experiments.rig.setup import errors_of
from fretflow.inference.covariance import SYSTEMATIC

T = TypeVar("T")
R = TypeVar("R")
Names = frozenset[str]

SLACK = 1.25  # of the expected chi-squared: what independent codes differ by where nothing is hidden
ASTRAY = 5.0  # times the expected chi-squared, from which a fitted baseline says little about its own parameters
LOST = 25.0  # the same, from which strong effects are simulated where screening finds nothing that explains it
BEYOND = 1.0  # of the recording's own size: a first-order change that is larger says nothing
LEAST_GAIN = 12.0  # in log evidence that an effect must promise to be looked at, and bring to be taken; see above
NEARLY_ALL = 0.97  # share explained from which nothing else is looked for in the place of what does


class Pool(Protocol):
    """Calls a function of a module's top level on many arguments at once; the values come in their order."""

    def __call__(self, function: Callable[[T], R], arguments: Sequence[T], /) -> list[R]:
        """Return the values of all calls."""
        ...


@dataclass(frozen=True)
class _Task:
    fitter: Fitter
    space: Space
    z: Array
    near: Simulation
    steps: int
    worth: float  # objective without the effect


@dataclass(frozen=True)
class _Corrected:
    fitter: Fitter
    fit: Fit
    checks: Sequence[RigModel]
    steps: int


@dataclass(frozen=True)
class _Laid:
    fitter: Fitter
    fit: Fit
    starts: tuple[Start, ...]


def fit_task(task: _Task) -> Fit | None:
    """Return the fit that a task asks for; None where its start has no simulation."""
    for share in (1.0, 0.5, 0.0):
        try:
            return task.fitter.fit(task.space, share * task.z, task.near, task.steps, task.worth)
        except NonConvergenceError:
            continue
    return None


def corrected_task(asked: _Corrected) -> tuple[Fitter, Fit]:
    """Return a fitter with what the coarse mesh leaves out at a fitted hypothesis, and the fit carried on with it."""
    fit, hypothesis = asked.fit, asked.fit.space.hypothesis(asked.fit.z)
    try:
        finer, denser = (model.predict(model.simulate(hypothesis)) for model in asked.checks)
        correction, _ = errors_of(asked.fitter.rig.observation, finer, denser, fit.predicted - asked.fitter.correction)
        own = replace(asked.fitter, correction=correction)
        return own, own.fit(fit.space, fit.z, fit.simulation, asked.steps)
    except NonConvergenceError:
        return asked.fitter, fit


def changes_task(laid: _Laid) -> Array:
    """Return the changes of `screening.changes`."""
    return changes(laid.fitter, laid.fit, laid.starts)


@dataclass
class RigSearch:
    """The fits of sets of effects so far, the baseline's among them.

    `checks` are the models on a finer mesh and with more samples that tell what the fitter's leaves out; sets that were
    corrected by them at their own fit have fitters of their own.
    """

    fitter: Fitter
    pool: Pool
    fits: dict[Names, Fit]
    checks: Sequence[RigModel] = ()
    fitters: dict[Names, Fitter] = field(default_factory=dict)
    screened: dict[Names, Signatures] = field(default_factory=dict)

    @property
    def baseline(self) -> Fit:
        """Return the fit without effects."""
        return self.fits[frozenset()]

    @property
    def baseline_biased(self) -> bool:
        """Return whether the fitted baseline is bent to explain what it cannot."""
        return self.baseline.chi_squared > ASTRAY * self.expected

    @property
    def lost(self) -> bool:
        """Return whether the baseline is too far from the answer for its first-order changes to lead there."""
        explained = max(map(self.explained, self.fits))
        return self.baseline.chi_squared > LOST * self.expected and explained < NEARLY_ALL

    @property
    def expected(self) -> float:
        """Return the chi-squared that repeats explain."""
        return float(self.fitter.rig.observation.noise.sum())

    def unbent(self) -> Fit:
        """Return the baseline's fit, or where that is astray the baseline simulated with its own readings."""
        if not self.baseline_biased:
            return self.baseline
        space = self.baseline.space
        return self.fitter.fit(space, np.zeros(space.size), self.baseline.simulation, 0)

    def excess(self, fit: Fit) -> float:
        """Return by how much chi-squared is larger than what noise and independent codes explain."""
        return max(0.0, fit.chi_squared - SLACK * self.expected)

    def explained(self, names: Names) -> float:
        """Return the share of the baseline's excess that a set explains."""
        before, after = self.baseline.chi_squared, self.fits[names].chi_squared
        gain = before - after
        return float(np.clip(gain / max(gain + self.excess(self.fits[names]), 1e-9), 0.0, 1.0))

    def temper(self) -> float:
        """Return by how much differences of log evidence count less."""
        best = min(fit.chi_squared for fit in self.fits.values())
        return SYSTEMATIC * max(1.0, best / (SLACK * self.expected))

    def log_probability(self, names: Names) -> float:
        """Return the log of a set's probability, up to a constant: each effect is one of the catalogue's."""
        return self.fits[names].log_evidence / self.temper() - len(names) * log(len(rig_effects()))

    def probabilities(self) -> dict[Names, float]:
        """Return the probability of each set that was fitted, the largest first."""
        weight = {names: self.log_probability(names) for names in self.fits}
        most = max(weight.values())
        total = sum(np.exp(value - most) for value in weight.values())
        return {names: float(np.exp(value - most) / total)
                for names, value in sorted(weight.items(), key=lambda item: -item[1])}

    def screen(self, names: Names) -> Signatures:
        """Return the signatures of all further effects beside a fitted set."""
        if names not in self.screened:
            fit = self.fits[names]
            starts = starts_beside(fit, rig_effects())
            halves = (tuple(starts[::2]), tuple(starts[1::2]))
            own = self.fitter_of(names)
            found = self.pool(changes_task, [_Laid(own, fit, half) for half in halves])
            moved = np.empty((len(found[0]), len(starts)))
            moved[:, ::2], moved[:, 1::2] = found
            self._simulate_beyond(own, fit, starts, moved)
            self.screened[names] = signatures(own, fit, starts, moved)
        return self.screened[names]

    def _simulate_beyond(self, own: Fitter, fit: Fit, starts: list[Start], moved: Array) -> None:
        """Put simulated changes in place of first-order ones where these tell nothing; drop those beyond all sense."""
        size = float(np.linalg.norm(own.covariance.whiten(own.rig.observation.values)))
        white = np.linalg.norm(own.covariance.whiten(np.nan_to_num(moved)), axis=0)
        moved[:, white > BEYOND * size] = np.nan
        unlike = [k for k, start in enumerate(starts) if not catalogue()[start.effect].first_order]
        asked = [k for k in unlike if not np.any(starts[k].z)]
        for k in asked:
            if in_sensors_alone(starts[k].effect):
                starts[k] = seen_through(own, fit if fit.space.effects else self.unbent(), starts[k].effect)
        tasks = [_Task(own, *with_start(fit, starts[k]), fit.simulation, 0, np.inf) for k in asked]
        moved[:, unlike] = np.nan
        for k, found in zip(asked, self.pool(fit_task, tasks), strict=True):
            if found is not None:
                moved[:, k] = found.predicted - fit.predicted

    def add(self, to: Names, effects: Iterable[str], steps: int) -> None:
        """Fit a set with each of `effects` added, some steps each, from the starts of either sign."""
        seen, fit = self.screen(to), self.fits[to]
        begun = [(name, start) for name in effects if name in seen.columns and to | {name} not in self.fits
                 for start in seen.begin(name)]
        tasks = [_Task(self.fitter_of(to), *self._begun(to, start), fit.simulation, steps, fit.objective)
                 for _, start in begun]
        for (name, _), found in zip(begun, self.pool(fit_task, tasks), strict=True):
            if found is not None:
                self._keep(to | {name}, found)
                if to in self.fitters:
                    self.fitters[to | {name}] = self.fitters[to]

    def survey(self, starts: Sequence[Start], most: int, steps: int) -> None:
        """Fit those single effects that simulations at `starts` promise most of; for a baseline far from the answer."""
        fit = self.baseline
        best: dict[tuple[str, tuple[float, ...]], Fit] = {}
        tasks = [_Task(self.fitter, *self._begun(frozenset(), start), fit.simulation, 0, np.inf) for start in starts]
        for start, found in zip(starts, self.pool(fit_task, tasks), strict=True):
            key = (start.effect, start.sign)
            if found is not None and (key not in best or self.fitter.promise(found) < self.fitter.promise(best[key])):
                best[key] = found
        promising = sorted(best.values(), key=self.fitter.promise)[:most]
        tasks = [_Task(self.fitter, one.space, one.z, one.simulation, steps, fit.objective) for one in promising]
        for found in self.pool(fit_task, tasks):
            if found is not None:
                self._keep(frozenset(found.space.effects), found)

    def _keep(self, names: Names, fit: Fit) -> bool:
        known = self.fits.get(names)
        better = known is None or fit.objective < known.objective
        if better:
            self.fits[names] = fit
            self.screened.pop(names, None)
        return better

    def _begun(self, to: Names, start: Start) -> tuple[Space, Array]:
        """Return the space and the coordinates at which a fit with another effect begins.

        A baseline that has been bent to explain what it cannot is no start: its own readings are.
        """
        space, z = with_start(self.fits[to], start)
        if not to and self.baseline_biased:
            z[:Space.of(()).size] = 0.0
        return space, z

    def continue_fits(self, sets: Iterable[Names], steps: int) -> None:
        """Fit the sets that have not converged further."""
        open_ = [names for names in sets if not self.fits[names].converged]
        tasks = [_Task(self.fitter_of(names), fit.space, fit.z, fit.simulation, steps, np.inf)
                 for names, fit in ((names, self.fits[names]) for names in open_)]
        for names, found in zip(open_, self.pool(fit_task, tasks), strict=True):
            if found is not None and found.objective < self.fits[names].objective:
                self.fits[names] = found
            elif found is not None and found.converged:
                self.fits[names] = replace(self.fits[names], converged=True)

    def swap(self, sets: Iterable[Names], steps: int) -> None:
        """Fit sets in which one effect gives way to another that extends its law, or that its law extends."""
        self._from_neighbours([(names, *start) for names in sets for start in swapped(self.fits[names])], steps)

    def thin(self, names: Names, steps: int) -> None:
        """Fit a set with each of its effects left out, from where the rest was fitted beside it."""
        self._from_neighbours([(names, *without(self.fits[names], one)) for one in sorted(names)], steps)

    def _from_neighbours(self, begun: Sequence[tuple[Names, Space, Array]], steps: int) -> None:
        """Fit sets from points of their spaces that the fits of others lead to, with the corrections of these."""
        tasks = [_Task(self.fitter_of(names), space, z, self.fits[names].simulation, steps, np.inf)
                 for names, space, z in begun]
        for (names, space, _), found in zip(begun, self.pool(fit_task, tasks), strict=True):
            if found is not None and self._keep(frozenset(space.effects), found):
                self.fitters[frozenset(space.effects)] = self.fitter_of(names)

    def correct(self, sets: Iterable[Names], steps: int) -> None:
        """Correct sets that leave more than noise by what the coarse mesh leaves out at their own fits.

        The correction at the baseline says little of a hypothesis with strong effects.
        """
        asked = [names for names in sets if self.checks and self.excess(self.fits[names]) > 0.0]
        tasks = [_Corrected(self.fitter_of(names), self.fits[names], self.checks, steps) for names in asked]
        for names, (own, fit) in zip(asked, self.pool(corrected_task, tasks), strict=True):
            if fit.objective < self.fits[names].objective:  # else what the corrections extrapolate is beyond them
                self.fitters[names], self.fits[names] = own, fit
                self.screened.pop(names, None)

    def promising(self, effects: Iterable[str], most: int) -> list[Names]:
        """Return the single effects, of those with a fit, whose next step would reach least if all were linear."""
        there = [names for names in (frozenset({name}) for name in effects) if names in self.fits]
        return sorted(there, key=lambda names: self.fitter.promise(self.fits[names]))[:most]

    def fitter_of(self, names: Names) -> Fitter:
        """Return the fitter of a set."""
        return self.fitters.get(names, self.fitter)

    def best(self, size: int, most: int, containing: Names = frozenset()) -> list[Names]:
        """Return the sets of a size with the largest evidence."""
        own = [names for names in self.fits if len(names) == size and containing <= names]
        return sorted(own, key=lambda names: -self.fits[names].log_evidence)[:most]
