"""Which effects explain a driven joint's force: fits of sets of effects, found forward, by exchange and by leaving out.

Sets are compared by ``log Z = -n/2 log(mean square) - P/2 log n``, n the number of independent samples in what the
richest set leaves. An effect stays in the set only if it explains its part of what is left without it, and if what was
held out is predicted better, beyond chance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import catalogue
from fretflow.effects.driven import BASELINE, DrivenJoint
from fretflow.effects.effect import declared_priors
from fretflow.experiments.driven.data import DrivenData
from fretflow.experiments.driven.fit import RIG, DrivenFit, Scale, first_joints, fit, scaled_priors
from fretflow.experiments.driven.noise import Noise, effective
from fretflow.inference.verdict import EXPLAINED_GATE

LEAST_SHARE = 1.0 - EXPLAINED_GATE  # of what is left without it, that an effect must explain
ALIAS_SINE = 0.15
SHARES = (1.0, 0.2, -0.4)  # of the way from neutral to the default, to start an effect from
QUICK, THOROUGH = 4, 40  # evaluations
USUAL = 3  # effects of a set; more only where these do not explain enough for a name
LOOKED_AT = 4  # candidates of a step that are fitted thoroughly
SIGNIFICANT = 0.05
FADING = 0.5 * LEAST_SHARE  # of what is left: a step that explains less is the last one
SETTLED = 0.02  # of the baseline's excess: less is not looked into
UNIT = Scale(2.0 * RIG.force, 3.0 * RIG.length, 5.0 * RIG.time)  # that changes whatever has a dimension
Names = frozenset[str]


@dataclass
class Search:
    """Fits of sets of effects to what is fitted of a recording; each is made once and kept."""

    data: DrivenData
    noise: Noise
    candidates: tuple[str, ...]
    fits: dict[Names, DrivenFit] = field(default_factory=dict)
    thorough: set[Names] = field(default_factory=set)

    @property
    def baseline(self) -> DrivenFit:
        """Return the fit without effects."""
        return self.fits[frozenset()]

    def square(self, found: DrivenFit) -> float:
        """Return the mean square in N^2 that a fit leaves of what was fitted."""
        return float(np.mean(found.residual[self.data.fitted]**2))

    def excess(self, found: DrivenFit) -> float:
        """Return what a fit leaves beyond the noise, N^2."""
        return max(self.square(found) - self.noise.sd**2, 0.0)

    def explained(self, names: Names) -> float:
        """Return the share of the baseline's excess that a set explains."""
        most = self.square(self.baseline) - self.noise.sd**2
        if most <= 0.0:
            return 0.0
        return float(np.clip((self.square(self.baseline) - self.square(self.fits[names])) / most, 0.0, 1.0))

    def independent(self) -> float:
        """Return how many independent samples there are in what the best set leaves of what was fitted."""
        best = min(self.fits.values(), key=self.square)
        return max(effective(best.residual, self.data.fitted), 8.0)

    def log_evidence(self, names: Names, independent: float) -> float:
        """Return log Z of a set that was fitted, up to a constant."""
        found = self.fits[names]
        square = max(self.square(found), 1e-6 * self.noise.sd**2)
        return -0.5 * independent * float(np.log(square)) - 0.5 * len(found.names) * float(np.log(independent))

    def fitted(self, names: Names, near: DrivenFit | None = None, thoroughly: bool = False) -> DrivenFit:
        """Return the fit of a set of effects, begun from one with fewer or others."""
        if names in self.fits and (not thoroughly or names in self.thorough):
            return self.fits[names]
        starts = self._starts(names, near or self.baseline)
        if names in self.fits:
            starts = [self.fits[names].joint, *starts]
        free = tuple(name for name, prior in starts[0].priors.items() if not prior.held)
        found = fit(starts, self.data.motion, self.data.force, free, self.data.fitted,
                    THOROUGH if thoroughly else QUICK, plausible_sizes(starts[0]))
        self.fits[names] = found
        if thoroughly:
            self.thorough.add(names)
        return found

    def _starts(self, names: Names, near: DrivenFit) -> list[DrivenJoint]:
        kept = {effect.id: effect for effect in near.joint.effects if effect.id in names}
        added = [name for name in sorted(names) if name not in kept]
        chosen = [*kept.values(), *(catalogue()[name]() for name in added)]
        joint = DrivenJoint.build(near.joint.baseline, chosen)
        return [_at_share(joint, added, self.data, share) for share in SHARES] if added else [joint]

    def scaled(self, name: str) -> DrivenJoint:
        """Return the fitted baseline with one effect at its default, at the recording's scale."""
        joint = DrivenJoint.build(self.baseline.joint.baseline, [catalogue()[name]()])
        return _at_share(joint, [name], self.data, 1.0)

    def together(self, names: Names) -> bool:
        """Return whether effects work together."""
        try:
            DrivenJoint.build(self.baseline.joint.baseline, [catalogue()[name]() for name in names])
        except ConfigError:
            return False
        return True

    def held_out_p(self, fewer: DrivenFit, more: DrivenFit) -> float:
        """Return how probable it is that chance alone makes `more` predict what was held out better than `fewer`.

        Twice the logarithm of the ratio of their likelihoods counts as chi-squared with as many degrees of freedom as
        there are more parameters; the samples count as the independent ones that they amount to.
        """
        out = self.data.held_out
        squares = [float(np.mean(one.residual[out]**2)) + 1e-12 * self.noise.sd**2 for one in (fewer, more)]
        gain = effective(more.residual, out) * float(np.log(squares[0] / squares[1]))
        return float(stats.chi2.sf(max(gain, 0.0), max(len(more.names) - len(fewer.names), 1)))


def usable_effects(data: DrivenData) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the effects that can act on such a recording, and those that need a time axis which it lacks."""
    own = tuple(name for name, effect in catalogue().items() if data.kind in effect.kinds)
    left = tuple(name for name in own if not data.timed and catalogue()[name].needs_time)
    return tuple(name for name in own if name not in left), left


def baseline_fit(data: DrivenData) -> DrivenFit:
    """Return the baseline with its own parameters refitted."""
    return fit(first_joints(data.kind, [], data.motion, data.force), data.motion, data.force, used=data.fitted)


def plausible_sizes(joint: DrivenJoint) -> dict[str, float]:
    """Return the largest plausible size of the effects' parameters without a dimension: no scale excuses more."""
    own, scaled = joint.priors, scaled_priors(joint, UNIT)
    return {name: prior.high for name, prior in own.items()
            if not name.startswith(f"{BASELINE}.") and scaled[name].high == prior.high and prior.high > 0.0}


def search(found: Search, most: int, progress: Callable[[float, str], None]) -> Names:
    """Return the set of effects that explains most, each of which earns its place; none if no effect does."""
    best: Names = frozenset()
    for step in range(most):
        progress(step / (most + 1.0), f"sets of {step + 1}")
        grown, promising = _grown(found, best)
        if grown is None:
            break
        before, best = best, grown
        if len(best) > 1:
            best = _exchanged(found, best, promising)
        gain = found.square(found.fits[before]) - found.square(found.fits[best])
        if gain < FADING * found.excess(found.fits[before]) or (
                found.excess(found.fits[best]) < SETTLED * found.excess(found.baseline)) or (
                len(best) >= USUAL and found.explained(best) >= EXPLAINED_GATE):
            break
    progress(most / (most + 1.0), "leaving out")
    return _pruned(found, best)


def _grown(found: Search, now: Names) -> tuple[Names | None, tuple[str, ...]]:
    """Return the set with the effect that adds most, None if none adds evidence; and the promising effects."""
    wider = [now | {name} for name in found.candidates if name not in now and found.together(now | {name})]
    tried = _best_of(found, wider, found.fits[now])
    if not tried:
        return None, ()
    n = found.independent()
    better = found.log_evidence(tried[0], n) > found.log_evidence(now, n)
    return tried[0] if better else None, tuple(next(iter(names - now)) for names in tried)


def _best_of(found: Search, sets: Iterable[Names], near: DrivenFit) -> list[Names]:
    """Return the most promising of some sets, the best one first."""
    tried = sorted(sets, key=lambda names: found.square(found.fitted(names, near)))[:LOOKED_AT]
    for names in tried:
        found.fitted(names, near, thoroughly=True)
    n = found.independent()
    return sorted(tried, key=lambda names: -found.log_evidence(names, n))


def _exchanged(found: Search, now: Names, promising: Iterable[str]) -> Names:
    """Return the set with one effect exchanged for a promising one, where that is better."""
    near = found.fits[now]
    others = [now - {old} | {new} for old in now for new in promising if new not in now
              and found.together(now - {old} | {new})]
    tried = _best_of(found, others, near)
    return now if not tried or found.square(found.fits[tried[0]]) >= found.square(near) else tried[0]


def _pruned(found: Search, now: Names) -> Names:
    """Return the set without the effects that do not earn their place, the least one first."""
    while now:
        needed = {name: _needed(found, now, name) for name in sorted(now)}
        weakest = min(needed, key=lambda name: needed[name])
        if needed[weakest] > 0.0:
            break
        now = now - {weakest}
    return now


def _needed(found: Search, now: Names, name: str) -> float:
    """Return by how much an effect explains more of what is left without it than it has to; negative if not needed."""
    more, fewer = found.fits[now], found.fitted(now - {name}, found.fits[now], thoroughly=True)
    left = found.excess(fewer)
    share = (found.square(fewer) - found.square(more)) / left if left > 0.0 else 0.0
    n = found.independent()
    tells = found.log_evidence(now, n) > found.log_evidence(now - {name}, n) and found.held_out_p(
        fewer, more) < SIGNIFICANT
    return share - LEAST_SHARE if tells else share - LEAST_SHARE - 10.0


def aliases(found: Search, chosen: Names) -> Mapping[str, tuple[str, ...]]:
    """Return what could stand in for each effect of a set: what it predicts lies closer than sine 0.15 after refits."""
    best, stand_ins = found.fits[chosen], {}
    for name in sorted(chosen):
        without = found.fitted(chosen - {name}, best, thoroughly=True)
        sets = {other: chosen - {name} | {other} for other in found.candidates if other not in chosen}
        close = []
        for other, names in sets.items():
            if not found.together(names):
                continue
            near = found.fitted(names, best)
            gain = found.square(without) - found.square(near)
            if gain < 0.8 * (found.square(without) - found.square(best)):
                continue
            near = found.fitted(names, best, thoroughly=True)
            if _sine(found.data, best, near, without) < ALIAS_SINE or _as_probable(found, chosen, names):
                close.append(other)
        stand_ins[name] = tuple(close)
    return stand_ins


def _sine(data: DrivenData, best: DrivenFit, near: DrivenFit, without: DrivenFit) -> float:
    apart, size = (float(np.linalg.norm((one.residual - best.residual)[data.used])) for one in (near, without))
    return apart / max(size, 1e-300)


def _as_probable(found: Search, chosen: Names, other: Names) -> bool:
    n = found.independent()
    return found.log_evidence(other, n) > found.log_evidence(chosen, n) - 3.0


def _at_share(joint: DrivenJoint, added: list[str], data: DrivenData, share: float) -> DrivenJoint:
    """Return a joint whose `added` effects are at the recording's scale, part of the way from neutral to default."""
    own, scaled = joint.priors, scaled_priors(joint, Scale.of(data.motion, data.force))
    plain = DrivenJoint(joint.baseline, tuple(effect.neutral() for effect in joint.effects)).values
    values = {}
    for name, value in joint.values.items():
        if name.partition(".")[0] not in added:
            continue
        factor = scaled[name].high / own[name].high if own[name].high else 1.0
        low, high = joint.bounds[name]
        start = plain[name] + share * (value - plain[name])
        if not low <= start * factor <= high:
            start = plain[name] + abs(share) * (value - plain[name])
        values[name] = float(np.clip(start * factor, low, high))
    return joint.with_values(values)


def first_parameter(name: str) -> str:
    """Return the full name of an effect's first parameter, its strength."""
    return f"{name}.{next(iter(declared_priors(catalogue()[name])))}"
