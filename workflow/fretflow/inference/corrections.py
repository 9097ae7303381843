"""What the model's numbers leave out, put right at the fits of the sets that lead: finer meshes and more samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fretflow.core.errors import NonConvergenceError
from fretflow.inference.least_squares import ENOUGH, Fit, Fitter
from fretflow.inference.parameters import is_bent
from fretflow.inference.search import NEGLIGIBLE, Search, fit_task

MOST_CORRECTIONS = 3  # of the numerical errors at fits that these move


def correct(search: Search, of: Sequence[int]) -> None:
    """Put the numerical errors of the leading sets of some sizes right at their own fits, and of those that lead then.

    What a set explains by the errors of a coarse model is no longer explained, and another leads: one that is less
    probable by no more than what errors put right have changed until then. Sets that are less probable than smaller
    ones need none, nor are sets fitted on that are then hopeless beside the best of their size. Where a fit moves far,
    its errors are put right once more.
    """
    changed = 0.0  # of log evidence
    for _ in range(MOST_CORRECTIONS):
        leading = [names for size in of for names in search.promising(search.best(size)[:search.effort.bases], changed)
                   if not search.is_settled(names) and all(
                       search.log_evidence(names, frozenset()) > search.log_evidence(one, frozenset())
                       for less in range(size) for one in search.best(less)[:1])]
        if not leading:
            break
        before = {names: search.log_evidence(names, frozenset()) for names in leading}
        asked = [(search.fitter_of(names), search.fits[names]) for names in leading]
        search.settled.update({names: search.fits[names].z for names in leading})
        put_right = {names: own for names, own in zip(leading, search.pool(correct_task, asked), strict=True)
                     if own is not None}
        for names, own in put_right.items():
            search.fitters[names], search.fits[names] = own
        if frozenset() in put_right:
            correct_beside_baseline(search)
        search.compute_signatures(put_right)
        # nothing, which shares the posterior and is no law of others, is held against all that is fitted
        again = [names for names in put_right if search.log_evidence(names) > -NEGLIGIBLE + max(
            search.log_evidence(one) for one in put_right if len(one) == len(names) or not names)]
        for names, fit in zip(again, search.pool(fit_task, [search.allowing(one) for one in again]), strict=True):
            if fit is not None:
                search.keep_more_probable(replace(search.fitter_of(names).linearised(fit.prediction, fit.jacobian),
                                                  converged=fit.converged, secant=fit.secant), known_by=0.5 * ENOUGH)
        changed = max(changed, *(abs(search.log_evidence(names, frozenset()) - own) for names, own in before.items()))


def correct_beside_baseline(search: Search) -> None:
    """Put the numerical errors of single effects right as the baseline's are, as long as they are not at own fits.

    Errors that were told elsewhere made all of them more probable than nothing, by what these do to a baseline. Where
    that is bent they were begun beside the stated one first, and its errors are not theirs.
    """
    if is_bent(search.baseline.z).any():
        return
    experiment = search.fitter_of(frozenset()).experiment
    sets = [names for names in search.best(1) if names not in search.settled
            and experiment.has_made(search.fits[names].prediction)]
    asked = [(replace(search.fitter_of(names), experiment=experiment), search.fits[names]) for names in sets]
    for names, (fitter, _), fit in zip(sets, asked, search.pool(predict_anew_task, asked), strict=True):
        if fit is not None:
            search.fitters[names], search.fits[names] = fitter, fit


def predict_anew_task(asked: tuple[Fitter, Fit]) -> Fit | None:
    """Return a fit where it stands as another experiment of the same model predicts it; None without a solution."""
    fitter, fit = asked
    try:
        anew = fitter.experiment.predict(fit.prediction.point, fit.prediction)
    except NonConvergenceError:
        return None
    return replace(fitter.linearised(anew, fit.jacobian), converged=fit.converged, provisional=fit.provisional,
                   secant=fit.secant)


def correct_task(asked: tuple[Fitter, Fit]) -> tuple[Fitter, Fit] | None:
    """Return a fitter with the numerical errors put right at a fit, and that; None where nothing finer tells them."""
    fitter, fit = asked
    experiment = fitter.experiment.corrected(fit.prediction)
    if experiment is None:
        return None
    own = replace(fitter, experiment=experiment)
    if experiment.has_made(fit.prediction):
        anew = predict_anew_task((own, fit))
        return None if anew is None else (own, anew)
    try:  # derivatives are of another model as well
        return own, own.at(fit.prediction.point, fit.prediction)
    except NonConvergenceError:
        return None
