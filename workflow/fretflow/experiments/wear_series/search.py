"""Which effects explain a wear series: laws with one or two of them, fitted to all tests, and to all but some.

A set of effects may stand for several laws, such as powers of pressure or of frequency; its evidence is that of its
best law, less the choice among them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fretflow.core.units import format_quantity
from fretflow.effects.volume_law import FREQUENCY, PRESSURE, SLIDING, UNITS
from fretflow.experiments.wear_series.data import Ids, WearData, log_evidence, volume_laws
from fretflow.experiments.wear_series.laws import Law, LawFit, Tests, fit
from fretflow.inference.verdict import EXPLAINED_GATE, Candidate, Estimate

Effects = tuple[str, ...]
Progress = Callable[[float, str], None]

SIGNIFICANT = 0.05
LEAST_SHARE = 0.2  # of what is left without it, that an effect of a pair has to explain
AS_PROBABLE = 3.0  # difference of log Z within which explanations are alternatives
MOST_FOLDS = 40
SEED = 20210
LEVEL = 0.95  # quantile of an interval's upper end
LARGEST = 1e6  # ratio of an interval's end to the value: the data know no end


@dataclass(frozen=True)
class Search:
    """All laws, fitted; those of each set of effects in the order of their evidence."""

    data: WearData
    catalogue: int  # effects that have a law of such tests
    fits: Mapping[Effects, tuple[LawFit, ...]]

    @property
    def baseline(self) -> LawFit:
        """Return Archard's law."""
        return self.fits[()][0]

    @property
    def excess(self) -> float:
        """Return what the baseline leaves beyond scatter, m^6."""
        return max(self.baseline.square - self.data.tests.count * self.data.sd**2, 0.0)

    def explained(self, found: LawFit) -> float:
        """Return the share of the baseline's excess that a law explains."""
        gain = self.baseline.square - found.square
        return float(np.clip(gain / self.excess, 0.0, 1.0)) if self.excess > 0.0 else 0.0

    def log_evidence(self, effects: Effects) -> float:
        """Return log Z of a set of effects, the choice of its law and of the effects paid."""
        laws = self.fits[effects]
        own = log_evidence(laws[0].square, laws[0].law.size, self.data.tests)
        return own - float(np.log(len(laws))) - len(effects) * float(np.log(self.catalogue))

    def earned(self, effects: Effects) -> bool:
        """Return whether each effect of a pair explains enough of what is left without it, and more than by chance."""
        more = self.fits[effects][0]
        for name in effects:
            fewer = self.fits[tuple(other for other in effects if other != name)][0]
            left = fewer.square - self.data.tests.count * self.data.sd**2
            gain, added = fewer.square - more.square, max(more.law.size - fewer.law.size, 1)
            free = self.data.tests.count - more.law.size
            chance = float(stats.f.sf(max(gain, 0.0) / added / (more.square / free), added, free))
            tried = self.catalogue * len(self.fits[effects])
            if gain < LEAST_SHARE * left or gain <= 0.0 or chance * tried > SIGNIFICANT:
                return False
        return True


def search(data: WearData, pairs: bool, progress: Progress) -> Search:
    """Return the fits of all laws that the recorded conditions allow, with two effects if `pairs`."""
    known = volume_laws(data.tests)
    laws = [Law(), *(Law((one,)) for own in known.values() for one in own)]
    if pairs:
        every = [one for own in known.values() for one in own]
        laws += [Law((one, other)) for one in every for other in every if one.powers and not other.powers]
    laws = [law for law in laws if data.tests.count - law.size >= 2]
    found: dict[Effects, list[LawFit]] = {}
    for k, law in enumerate(laws):
        progress(k / len(laws), "laws of wear")
        found.setdefault(law.effects, []).append(fit(law, data.tests))
    ordered = {effects: tuple(sorted(own, key=lambda one: -log_evidence(one.square, one.law.size, data.tests)))
               for effects, own in found.items()}
    return Search(data, max(len(known), 1), ordered)


def ranking(looked: Search) -> tuple[Candidate, ...]:
    """Return the sets of effects with their probabilities; pairs only if each of the two earned its place."""
    sets = [effects for effects in looked.fits if len(effects) < 2 or looked.earned(effects)]
    evidence = np.array([looked.log_evidence(effects) for effects in sets])
    weight = np.exp(evidence - evidence.max())
    tests, sd = looked.data.tests, looked.data.sd
    return tuple(Candidate(
        effects=sets[k], probability=float(weight[k] / weight.sum()),
        explained=looked.explained(looked.fits[sets[k]][0]), chi_squared=looked.fits[sets[k]][0].square / sd**2,
        degrees_of_freedom=round(tests.count) - looked.fits[sets[k]][0].law.size, log_evidence=float(evidence[k]),
        converged=True) for k in np.argsort(-weight, kind="stable"))


def alternatives(looked: Search, ranked: tuple[Candidate, ...]) -> tuple[Effects, ...]:
    """Return the sets that explain as well as the first one that adds something, that one first."""
    some = [one for one in ranked if one.effects and one.explained >= EXPLAINED_GATE]
    return tuple(one.effects for one in some if one.log_evidence > some[0].log_evidence - AS_PROBABLE
                 and len(one.effects) == len(some[0].effects))


def held_out(data: WearData, law: Law) -> float:
    """Return the error of tests that were not fitted, over the scatter; rows of one condition go together."""
    folds = _folds(data)
    tests, square = data.tests, 0.0
    whole = fit(law, tests)
    for k in np.unique(folds):
        out = folds == k
        found = fit(law, tests.some(~out), whole.value)
        rest = tests.some(out)
        square += rest.square(found.predict(rest))
    return float(np.sqrt(square / tests.count)) / data.sd


def folds_in_words(data: WearData) -> str:
    """Return what is held out, in words."""
    count, own = len(np.unique(_folds(data))), len(np.unique(data.condition))
    parts = f"each of the {own} conditions" if count == own else f"each of {count} parts of the {own} conditions"
    return f"{parts} in turn, repeats and rows that stand twice together"


def _folds(data: WearData) -> Ids:
    own = np.unique(data.condition, return_inverse=True)[1]
    order = np.random.default_rng(SEED).permutation(int(own.max()) + 1) % MOST_FOLDS
    return np.asarray(order[own])


def estimates(looked: Search, found: LawFit) -> tuple[Estimate, ...]:
    """Return the parameters of a law with their 90 % intervals by Student's t."""
    tests, law = looked.data.tests, found.law
    free = max(tests.count - law.size, 1.0)
    size = np.maximum(np.linalg.norm(found.jacobian, axis=0), 1e-300)
    scaled = found.jacobian / size
    covariance = np.linalg.pinv(scaled.T @ scaled) * found.square / free
    half = float(stats.t.ppf(LEVEL, free)) * np.sqrt(np.diag(covariance)) / size
    made = [_exponential("baseline.wear_coefficient", found.value[0], half[0], *_coefficient(looked.data),
                         _at(law, tests))]
    own = [(one.effect, parameter) for one in law.laws for parameter in one.parameters]
    for (effect, parameter), value, reach in zip(own, found.value[1:], half[1:], strict=True):
        name, unit, meaning = f"{effect}.{parameter.name}", parameter.unit, parameter.meaning
        made.append(_exponential(name, value, reach, unit, meaning) if parameter.logarithmic else Estimate(
            name=name, value=float(value), low=float(value - reach), high=float(value + reach), unit=unit,
            meaning=meaning))
    return tuple(made)


def _coefficient(data: WearData) -> tuple[str, str]:
    """Return unit and meaning of the coefficient."""
    if not data.series.relative:
        return "m^3/J", "worn volume per dissipated energy, K_w over the friction coefficient"
    if "load" in data.series.states:
        return "m^2/N", "K_w: worn volume per load and sliding"
    return "m^2/Pa", "worn volume per pressure and sliding, K_w times the area"


def _exponential(name: str, value: float, half: float, unit: str, meaning: str, at: str = "") -> Estimate:
    half = min(half, float(np.log(LARGEST)))
    middle, low, high = (float(np.exp(np.clip(v, -300.0, 300.0))) for v in (value, value - half, value + half))
    return Estimate(name=name, value=middle, low=low, high=high, unit=unit,
                    meaning=meaning + at)


def _at(law: Law, tests: Tests) -> str:
    at = [f"{name} {format_quantity(tests.middle(name), UNITS[name], 3)}" for name in law.states]
    return f", at {', '.join(at)}" if at else ""


def together(data: WearData) -> tuple[tuple[str, str], ...]:
    """Return pairs of conditions that vary together, so that powers of one cannot be told from those of the other."""
    own = [name for name in (PRESSURE, SLIDING, FREQUENCY) if name in data.varied]
    logs = {name: np.log(data.tests.states[name]) for name in own}
    return tuple((one, other) for k, one in enumerate(own) for other in own[k + 1:]
                 if abs(np.corrcoef(logs[one], logs[other])[0, 1]) > 0.95)


def other_powers(looked: Search, found: LawFit) -> tuple[LawFit, ...]:
    """Return the laws with powers of other conditions that explain as well as the one found."""
    own, tests = set(found.law.states), looked.data.tests
    least = log_evidence(found.square, found.law.size, tests) - AS_PROBABLE
    return tuple(one for one in looked.fits[found.law.effects] if own and not own <= set(one.law.states)
                 and looked.explained(one) >= EXPLAINED_GATE
                 and log_evidence(one.square, one.law.size, tests) > least)
