"""How probable it is that nothing is left out, that a set of the catalogue is, or something that the catalogue lacks.

The prior is indifferent between nothing, one effect, two effects and an unlisted effect, and within each between all
that it may be. A listed effect has a law-form error as published forms of laws have (`law_forms`). An unlisted one
looks like the nearest listed one, or like two, with an error such as the catalogue's own effects leave when each is
left out in turn and the others explain what it does on this very recording.

A wider set, or a law that extends another, is weighed against another form of the plainer law that does the same: draws
of law-form errors, and the catalogue's own effects where a form may be as large, tell what share of them the best other
effect takes by chance, where a p-value p is worth at most ``-1 / (e p ln p)`` (T. Sellke, M. J. Bayarri, J. O. Berger,
Am. Stat. 55 (2001) 62-71), and published forms how rare one is that differs by as much. What is taken of mere noise
counts by Wilks' test too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, e, exp, inf, log, prod, sqrt

import numpy as np
from scipy.special import logit
from scipy.stats import chi2, norm

from fretflow.effects.catalogue import catalogue
from fretflow.inference.evidence import DRAWS, FORMS
from fretflow.inference.law_forms import density, law_form_errors
from fretflow.inference.parameters import HALF, Array, Coordinate
from fretflow.inference.search import NEGLIGIBLE, Names, Search, Start, basis, extends
from fretflow.recordings.periods import LEVEL
from fretflow.recordings.readings import SEED


@dataclass(frozen=True)
class Posterior:
    """Probabilities of all hypotheses, which sum to one."""

    sets: dict[Names, float]  # of the catalogue, none among them; the most probable first
    unlisted: float
    shows: dict[Names, dict[str, float]]  # standard deviations by which each effect of a set is away from doing nothing
    log_evidence: float = 0.0  # of all hypotheses together, under the errors of their search

    @property
    def none(self) -> float:
        """Return the probability that nothing is left out that the recording shows."""
        return self.sets[frozenset()]

    def of(self, effect: str) -> float:
        """Return the probability that an effect acts, alone or beside others."""
        return sum(own for names, own in self.sets.items() if effect in names)

    @property
    def listed(self) -> float:
        """Return the probability of all sets of effects."""
        return 1.0 - self.none - self.unlisted


Weighed = tuple[float, Posterior]  # the probability of another reading of a recording, and what is probable under it


def averaged(own: Posterior, others: Sequence[Weighed]) -> Posterior:
    """Return the mean of posteriors under several readings of a recording, `own` that of what the others leave.

    That is Bayesian model averaging (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Stat. Sci. 14 (1999)
    382-417).
    """
    every = [(1.0 - sum(share for share, _ in others), own), *others]
    sets = {names: sum(share * one.sets.get(names, 0.0) for share, one in every)
            for names in dict.fromkeys(names for _, one in every for names in one.sets)}
    unlisted = sum(share * one.unlisted for share, one in every)
    total = unlisted + sum(sets.values())
    order = sorted(sets, key=lambda names: -sets[names])
    return Posterior({names: sets[names] / total for names in order}, unlisted / total, own.shows)


def freedom(search: Search, names: Names) -> int:
    """Return how many coordinates a set has, those of what it leaves to chance among them."""
    return len(search.fits[names].z) + search.by_chance(names).shape[1]


def posterior(search: Search) -> Posterior:
    """Return the probabilities of all hypotheses that were fitted, and of something that is not in the catalogue."""
    count = len(search.experiment.candidates())
    prior = {0: 0.0, 1: -log(count), 2: -log(max(comb(count, 2), 1))}
    singles = search.promising(search.best(1))
    pairs = search.promising(search.best(2)) if singles else []
    singles += [names for names in search.best(1) if names not in singles
                and any(_plainer(names, one) for one in (*singles, *pairs))]
    search.compute_signatures([*singles, *pairs])
    weight: dict[Names, float] = {frozenset(): search.log_evidence(frozenset())}
    errors = {size: left_out(search.starts, size, count) for size in (1, 2)}
    like: dict[Names, float] = {}  # what an unlisted effect may be like, and the evidence for that
    shows = {names: search.shows(names) for names in (*singles, *pairs)}
    for names in sorted(shows, key=lambda one: sum(_plainer(other, one) for other in shows)):
        strong = prod(1.0 - faint(search, names, one) for one in names)
        if min(shows[names].values()) < HALF or strong < LEVEL:
            continue  # what it says of one effect is that this does nothing: it is the set without it
        left = search.fits[names].chi_squared
        if any(fewer < names and left > search.fits[fewer].chi_squared for fewer in weight if fewer):
            continue  # its fit was not ended: a wider set can do all that a plainer one does
        by_form = any(mostly_by_form(search, names, one) for one in names)
        if by_form and len(names) > 1:
            continue  # beside others it is no more than another form of theirs
        own = search.log_evidence(names)
        beyond = {fewer: beyond_forms(search, fewer, names) + farther_out(search, fewer, names)
                  for fewer in _likeliest(search, names, [one for one in weight if one and _plainer(one, names)])}
        like[names] = search.evidence(names).averaged(search.prior(names, forms=errors[len(names)]))
        if by_form:
            continue  # it is like it, and not it
        for fewer, odds in beyond.items():  # another form of its laws may do the same, or as what is like the wider set
            weight[fewer] = float(np.logaddexp(weight[fewer], max(own, like[names]) - odds + prior[len(fewer)]))
        weight[names] = own + prior[len(names)] + log(strong)
    values = [[search.evidence(frozenset()).averaged(search.beyond_codes())], *(
        [prior[size] + own for names, own in like.items() if len(names) == size] for size in errors)]
    unlisted = float(np.logaddexp.reduce([one for own in values for one in own])) - log(len(values))
    top = max(*weight.values(), unlisted)
    total = sum(exp(value - top) for value in weight.values()) + exp(unlisted - top)
    order = sorted(weight, key=lambda one: -weight[one])
    return Posterior({names: exp(weight[names] - top) / total for names in order}, exp(unlisted - top) / total, shows,
                     top + log(total))


def faint(search: Search, names: Names, effect: str) -> float:
    """Return the probability that an effect of a fitted set, or what it adds to a law, is weaker than its range begins.

    So weak an effect is what codes and laws differ by, and not what its name says.
    """
    kind, space = catalogue()[effect], search.fits[names].parameters
    mean, covariance = search.evidence(names).coordinates(search.prior(names))
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))  # what is held at a limit has none
    told = list(zip(space.coordinates, mean, deviations, strict=True))
    strong = 1.0
    for less in (kind.neutral(), kind.plainest()):
        sizes = [(own, at, sd, getattr(less, own.field)) for own, at, sd in told
                 if own.effect == effect and own.field in less.model_fields_set]
        if sizes:  # one of several may be none
            strong = min(strong, 1.0 - prod(_is_off(*one) for one in sizes))
    return 1.0 - strong


def mostly_by_form(search: Search, names: Names, effect: str) -> bool:
    """Tell whether an effect of a fitted set is probable by other forms of its law more than by its law.

    That is where its law, as the catalogue has it, adds less evidence to the rest of the set than another form of it
    adds to that: the freedom of any law that changes as much would do the same.
    """
    less, worth = names - {effect}, search.log_evidence
    if less not in search.fits:
        return False
    law, form = worth(names, less) - worth(less), worth(names) - worth(names, less)
    return form > abs(law)


def _is_off(own: Coordinate, at: float, sd: float, off: float) -> float:
    """Return the probability that a coordinate is nearer to the value `off` than its range begins.

    Of a range about `off`, it is off where it may be that within its interval.
    """
    ends = sorted(own.sign * own.value(way * HALF) for way in (-1.0, 1.0))
    if ends[0] <= own.sign * off <= ends[1]:
        return float(abs(at - own.place(off)) < HALF * sd)
    return float(norm.cdf((-HALF - at) / sd) if own.sign * off < ends[0] else norm.sf((HALF - at) / sd))


def _likeliest(search: Search, wider: Names, sets: Sequence[Names]) -> list[Names]:
    """Return the plainer sets of which a wider one may be another form.

    Where one of them does what the wider set does, other forms of its laws allowed for, that is no other form of those
    which are negligible beside it.
    """
    best = max((search.log_evidence(names) for names in sets), default=0.0)
    if best < search.log_evidence(wider) - NEGLIGIBLE:
        return list(sets)
    return [names for names in sets if search.log_evidence(names) > best - NEGLIGIBLE]


def farther_out(search: Search, fewer: Names, wider: Names) -> float:
    """Return by what log prior the parameters of a plainer set are farther out of their ranges than a wider one's.

    Where it does the same by another form of its laws, it does it there.
    """
    squares = []
    for names in (fewer, wider):
        mean, _ = search.evidence(names).coordinates(search.prior(names))
        squares.append(float(mean @ mean))
    return 0.5 * max(squares[0] - squares[1], 0.0)


def _plainer(fewer: Names, names: Names) -> bool:
    """Tell whether a set has an effect less than another, or one that the other's extends."""
    if fewer < names:
        return True
    rest, more = fewer - names, names - fewer
    return len(rest) == len(more) == 1 and extends(*more, *rest)


def left_out(starts: list[Start], size: int, candidates: int) -> Array:
    """Return the shares (forms,) of the errors with which so many others explain each effect of a catalogue, at best.

    The error is what is left over what the others change then, both whitened; these act within their ranges as all
    hypotheses do. What the recording would not show of so many candidates is none that could be missed here.
    """
    errors = []
    for one in starts:
        wanted = one.changes[:, 0]
        if np.linalg.norm(wanted) < visible(candidates):
            continue
        others = [other for other in starts if not _related(one.effect, other.effect)]
        nearest: list[Start] = []
        for _ in range(size):
            beside = [other for other in others if other.effect not in {own.effect for own in nearest}]
            if beside:  # small catalogues may have no other, or no second one
                nearest.append(min(beside, key=lambda other: _explained(wanted, [*nearest, other])[0]))
        if nearest:
            left, explained = _explained(wanted, nearest)
            errors.append(left / max(explained, 1e-300))
    return density(np.array(errors), FORMS) if errors else np.full(len(FORMS), 1.0 / len(FORMS))


def _explained(wanted: Array, others: list[Start]) -> tuple[float, float]:
    """Return the norms of what other effects leave of a change (M,), and of what they change for that."""
    columns = np.hstack([one.changes for one in others])
    weights = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, columns.T @ wanted)
    return (float(np.linalg.norm(wanted - columns @ weights)),
            float(np.linalg.norm(np.hstack([one.whole for one in others]) @ weights)))


def visible(candidates: int) -> float:
    """Return the norm of a whitened signature at which one of so many effects would be as probable as none.

    There half of its square is the logarithm of how many there are.
    """
    return sqrt(2.0 * log(max(candidates, 2)))


def beyond_forms(search: Search, fewer: Names, wider: Names) -> float:
    """Return the log odds of a wider set over another form of the plainer set's laws that does the same.

    They are those of what the wider set takes beyond chance, and how rare forms are among published ones that differ by
    as much. Of further effects the first are at most theirs in what no form of these laws explains. And the share of
    what the plainer set leaves that the wider one takes is compared with the shares that the best other effect takes of
    law-form errors of the plainer set, drawn smooth and, as these are physics too, as structured as the catalogue's own
    effects.
    """
    told, before, after = search.experiment.measurement.expected, search.chi_squared(fewer), search.chi_squared(wider)
    left = before - min(told, after)  # as in `Search.explained`, noise is no more than what a set leaves
    outside = max(_outside_forms(search, fewer, wider), 0.0) if fewer < wider else inf
    if before <= told:  # all that is left passes for noise: what is taken of that may be chance
        more = max(freedom(search, wider) - freedom(search, fewer), 1)
        outside = min(outside, log(largest_odds(float(chi2.sf(before - after, more)))))
    if left <= 0.0:
        return outside
    least = float(np.finfo(np.float32).eps)  # so that logits are finite
    taken = float(np.clip((before - after) / left, least, 1.0 - least))
    shares = logit(np.clip(taken_by_chance(search, fewer), least, 1.0 - least))
    p = float(norm.sf((logit(taken) - shares.mean()) / max(float(shares.std()), least)))
    beyond = min(log(largest_odds(p)), outside)
    size = float(np.linalg.norm(form_changes(search, fewer)))  # as it is seen: what parameters take up is not left
    if left > size**2:
        return inf  # what is larger than all that a law does is no form of it
    alike = taken_of_effects(search, fewer)
    rank = np.count_nonzero(alike >= taken)  # that none takes as much is no p-value, but happens to one of so many
    beyond = min(beyond, log(largest_odds((rank + 1) / (len(alike) + 1)) if rank else len(alike) + 1))
    forms = law_form_errors() * size
    return beyond - log((np.count_nonzero(np.square(forms) >= taken * left) + 1) / (len(forms) + 1))


def _outside_forms(search: Search, fewer: Names, wider: Names) -> float:
    """Return the log evidence for the further effects of a wider set in what no form of the plainer laws explains."""
    fit, white = search.fits[wider], search.fitter.covariance.whiten
    further = [place for place, name in enumerate(sorted(wider)) if name not in fewer]
    own = np.any([fit.parameters.own(sorted(wider)[place]) for place in further], axis=0)
    columns = np.column_stack([white(search.signatures(wider)[:, further]), white(fit.jacobian[:, own])])
    return search.gain_beside(fewer, columns, beyond_forms=True)


def largest_odds(p: float) -> float:
    """Return the most odds that a p-value is worth against its null hypothesis."""
    if p >= 1.0 / e:
        return 1.0
    return -1.0 / (e * p * log(p)) if p > 0.0 else inf


def form_changes(search: Search, names: Names) -> Array:
    """Return what law-form errors of size one change (M, any), whitened, beyond what a fitted set's parameters can."""
    rest = basis(search.fits[names].whitened_jacobian)
    errors = search.fitter.covariance.whiten(search.formed(names))
    return np.asarray(errors - rest @ (rest.T @ errors))


def taken_by_chance(search: Search, names: Names) -> Array:
    """Return the share (DRAWS,) of draws of a set's law-form error that the best further effect takes."""
    rest, errors = basis(search.fits[names].whitened_jacobian), form_changes(search, names)
    draws = errors @ np.random.default_rng(SEED).standard_normal((errors.shape[1], DRAWS))
    draws /= np.maximum(np.linalg.norm(draws, axis=0), 1e-300)
    best = np.zeros(DRAWS)
    for start in search.starts:
        if start.effect not in names:
            own = basis(start.changes - rest @ (rest.T @ start.changes))
            best = np.maximum(best, np.sum((own.T @ draws)**2, axis=0))
    return best


def taken_of_effects(search: Search, names: Names) -> Array:
    """Return the share (any,) of what each effect would change beside a set that the best other effect takes.

    Of those alone that this recording would show.
    """
    rest = basis(search.fits[names].whitened_jacobian)
    starts = [one for one in search.starts if one.effect not in names]
    columns = [one.changes - rest @ (rest.T @ one.changes) for one in starts]
    bases = [basis(own) for own in columns]
    least, shares = visible(len(search.experiment.candidates())), []
    for one, own in zip(starts, columns, strict=True):
        size = float(np.linalg.norm(own[:, 0]))
        if size >= least:
            shares.append(max((float(np.sum((across.T @ own[:, 0])**2)) / size**2
                               for other, across in zip(starts, bases, strict=True)
                               if not _related(one.effect, other.effect)), default=0.0))
    return np.array(shares)


def _related(one: str, other: str) -> bool:
    """Tell whether two effects are the same, or the law of one holds that of the other."""
    return one == other or extends(one, other) or extends(other, one)


