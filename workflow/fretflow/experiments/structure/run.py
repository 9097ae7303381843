"""The diagnosis of a structure from its backbone, or from worn profiles: fit, search, verdict."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from math import exp, log, log1p
from typing import Any

import numpy as np
from scipy.special import expit, softmax
from scipy.stats import chi2

from fretflow.core.errors import NonConvergenceError
from fretflow.core.progress import Progress
from fretflow.core.units import pretty_quantity
from fretflow.effects.catalogue import described
from fretflow.experiments.independent import in_turn
from fretflow.experiments.structure import backbone, worn
from fretflow.experiments.structure.experiment import STATED, StructureExperiment
from fretflow.experiments.structure.profiles import ProfileExperiment
from fretflow.experiments.tools import DiagnosisTools
from fretflow.inference.corrections import correct
from fretflow.inference.decision import Decision, decide, detected, estimate, held_to, smallest_visible
from fretflow.inference.diagnosis import diagnosed, estimated, share_left
from fretflow.inference.evidence import groups_of
from fretflow.inference.experiment import Point
from fretflow.inference.parameters import HALF
from fretflow.inference.posterior import Posterior, Weighed, averaged, posterior
from fretflow.inference.search import FAST, FULL, Effort, Names, Pool, Search, Task, fit_task
from fretflow.inference.strategy import allow_for_chance, begin_all, run_search, start_search
from fretflow.inference.verdict import FALSE_ALARMS, Detection, Diagnosis, Estimate, Remainder, Verdict
from fretflow.inference.words import separating
from fretflow.recordings.kinds.structures import StructureRecording, WornRecording

QUICK = replace(FAST, secants=True)  # derivatives are differences, several times as dear as a prediction
AGAIN = 2  # times that fits move the amplitudes at which points slide, and with them what periodic motions correct
BASELINE = {"bolt_load": ("N", "load of the bolts"), "friction_coefficient": ("1", "friction of the faces"),
            "modal_damping": ("1", "damping ratio of the structure without its joint"),
            "wear_coefficient": ("m^2/N", "K_w: worn volume over load and sliding")}


def diagnose_structure(recording: StructureRecording | WornRecording, fast: bool, progress: Progress,
                       tools: DiagnosisTools | None = None) -> Diagnosis:
    """Return what a recording of a structure shows that its model leaves out.

    Raises
    ------
    InputError
        If it has no backbone, or its matrices cannot be used.
    NonConvergenceError
        If the baseline has no equilibrium, or no pressure.
    """
    progress(0.02, "building the model")
    pool = in_turn if tools is None else tools.pool
    if isinstance(recording, WornRecording):
        return _of_profiles(recording, pool, QUICK if fast else FULL, progress)
    return _of_backbone(recording, pool, fast, progress)


def _of_backbone(recording: StructureRecording, pool: Pool, fast: bool, progress: Progress) -> Diagnosis:
    plain = experiment = StructureExperiment.of(recording)
    progress(0.1, "; ".join(["refitting the baseline", *backbone.outside_of_mode(experiment)]))
    effort = QUICK if fast or experiment.many else FULL
    search = start_search(experiment, experiment.first_prediction(), effort, pool)
    begin_baselines(experiment, search)
    _search_where_detected(search, lambda share, text: progress(0.15 + 0.3 * share, text))
    experiment, search, others = told_again(experiment, search)
    detection = _search_where_detected(search, lambda share, text: progress(0.45 + 0.2 * share, text))
    contradicted = min(detection.p_value, p_of_stated(search, plain.recording)) < FALSE_ALARMS
    if contradicted and any(plain.recording.known.values()):
        free = told_again(plain.released(), released(plain.released(), search))
        found = _search_where_detected(free[1], lambda share, text: progress(0.65 + 0.2 * share, text))
        experiment, search, others = either((experiment, search, others), free)
        detection = found if search is free[1] else detection
    for _ in range(AGAIN):
        search.settled.clear()
        correct(search, [0, 1, 2])
    decision = detected(decide(search, averaged(posterior(search), others)), detection)
    progress(0.85, "what is held out")
    unseen = backbone.held_out(experiment, search, decision.after)
    decision = held_to(decision, unseen, len(groups_of(experiment.measurement)))  # what is left of each is one error
    made, left = estimates(search, decision.after), remainder(search, decision)
    return diagnosed(
        recording, decision, detection, parameters=made, held_out=unseen, remainder=left,
        warnings=(*backbone.warnings(experiment), *beyond_stated(plain.recording, made)), **next_and_visible(
            search, decision, backbone.NEXT), **backbone.told(experiment, search, decision, left))


def _of_profiles(recording: WornRecording, pool: Pool, effort: Effort, progress: Progress) -> Diagnosis:
    experiment = ProfileExperiment(recording)
    progress(0.1, "refitting the baseline")
    search = start_search(experiment, experiment.first_prediction(), effort, pool)
    detection = _search_where_detected(search, lambda share, text: progress(0.15 + 0.7 * share, text))
    decision = detected(decide(search), detection)
    progress(0.85, "what is held out")
    unseen = worn.held_out(experiment, search, decision.after)
    decision = held_to(decision, unseen, len(groups_of(experiment.measurement)))
    left = remainder(search, decision)
    return diagnosed(
        recording, decision, detection, parameters=estimates(search, decision.after), held_out=unseen, remainder=left,
        warnings=tuple(map(str, recording.notes)), **next_and_visible(search, decision, worn.NEXT),
        **worn.told(experiment, search, decision, left))


def next_and_visible(search: Search, decision: Decision, beyond: str) -> dict[str, Any]:
    """Return what to measure next, `beyond` where nothing of the catalogue is named, and what would have been seen."""
    unknown, none = (decision.verdict is one for one in (Verdict.UNKNOWN, Verdict.NONE))
    return {"separating_measurement": beyond if unknown else separating(decision.rivals or [()]),
            "smallest_visible": smallest_visible(search) if none else {}}


def _search_where_detected(search: Search, progress: Progress) -> Detection:
    """Return whether the baseline leaves anything, all sets fitted that may explain it."""
    detection = detect(search)
    if detection.p_value < FALSE_ALARMS:
        run_search(search, progress)
    else:
        begin_all(search)  # what would have been seen
    return detection


def begin_baselines(experiment: StructureExperiment, search: Search) -> None:
    """Fit the baseline from all over its range, the best of one step on to rest; then along what is told least.

    Where points slide, load times friction is told first; along one product the cost has minima of its own, as what
    the load alone moves, points that open, moves by steps.
    """
    _settle(search, experiment.beginnings())
    at, (_, covariance) = search.baseline.prediction.point, search.evidence(frozenset()).coordinates(
        search.prior(frozenset()))
    axis = np.linalg.eigh(covariance)[1][:, -1]
    _settle(search, [replace(at, z=at.z + share * HALF * axis) for share in (-1.0, -0.5, 0.5, 1.0)])


def _settle(search: Search, starts: Sequence[Point]) -> None:
    """Fit the baseline from `starts` by one step, and the best of these to rest."""
    first_fits = search.pool(fit_task, [Task(search.fitter, one, search.baseline.prediction, 1) for one in starts])
    best = sorted((one for one in first_fits if one is not None), key=lambda one: one.objective)[:search.effort.bases]
    search.keep(search.pool(fit_task, [
        Task(search.fitter, one.prediction.point, one.prediction, search.effort.last_steps) for one in best]))


def told_again(experiment: StructureExperiment, search: Search
               ) -> tuple[StructureExperiment, Search, list[Weighed]]:
    """Return an experiment with its numerical errors told where the best of some fits is, and a search from these on.

    In mid-range, where a search begins, they are those of a model that may have nothing to do with the recording. Of
    the meshes and loads that this may be of, those count that make it most probable, with something that the catalogue
    lacks too: what that does, errors of another mesh would take up as well. What is probable under the others comes
    with them, as far as it is known of these fits.
    """
    best = max(search.fits, key=lambda names: search.log_evidence(names, frozenset()))
    told = experiment.told_at(search.fits[best].prediction)
    parts = [frozenset(own) for size in range(len(best) + 1) for own in combinations(sorted(best), size)]
    choice = log(len(experiment.candidates()))  # what that of an effect costs

    def under(one: StructureExperiment) -> tuple[float, StructureExperiment, Search, Posterior]:
        again = gone_on(one, search, parts)
        if one.spacing != 1.0:  # whether the baseline leaves anything is asked under errors that are its own
            one = of_baseline(one, again)
            again = gone_on(one, again, parts)
        unlisted = again.evidence(frozenset()).averaged(again.beyond_codes())
        sets = {names: again.log_evidence(names, frozenset()) - len(names) * choice
                for names in parts if names in again.fits}
        probable = float(np.logaddexp.reduce([unlisted, *sets.values()]))
        known = Posterior({names: exp(own - probable) for names, own in sets.items()}, exp(unlisted - probable), {})
        return probable + again.discrepancy.covariance.log_density, one, again, known

    made = [under(one) for one in told.readings()]
    likeliest = max(made, key=lambda one: one[0])
    made = sorted([*made, under(replace(likeliest[1], matched=False))], key=lambda one: -one[0])
    _, told, again, _ = made[0]
    share = softmax([one[0] for one in made])
    others = [(float(own), fitted_by(again, known)) for own, (*_, known) in zip(share[1:], made[1:], strict=True)]
    if told.spacing == 1.0 and any(
            one.spacing != 1.0 and detect(own).p_value >= FALSE_ALARMS for _, one, own, _ in made):
        told = replace(told, or_finer=True)
    again.continue_fits(again.promising(sorted((names for names in again.fits if names), key=lambda names: (
        -again.log_evidence(names, frozenset())))), search.effort.last_steps)
    return told, again, others


def fitted_by(search: Search, known: Posterior) -> Posterior:
    """Return the probabilities of the sets that a search has fitted, and of something else."""
    return replace(known, sets={names: own for names, own in known.sets.items() if names in search.fits})


def either(*readings: tuple[StructureExperiment, Search, list[Weighed]]
           ) -> tuple[StructureExperiment, Search, list[Weighed]]:
    """Return the more probable of a structure of the stated values and of free ones, with what the other says.

    That a stated value is wrong is as probable beforehand as that none is.
    """
    known = [posterior(search) for _, search, _ in readings]
    total = [own.log_evidence + search.discrepancy.covariance.log_density - log1p(-sum(share for share, _ in others))
             for own, (_, search, others) in zip(known, readings, strict=True)]
    first, second = np.argsort(total)[::-1]
    share = float(expit(total[second] - total[first]))
    experiment, search, others = readings[first]
    other = fitted_by(search, averaged(known[second], readings[second][2]))
    return experiment, search, [*(((1.0 - share) * own, one) for own, one in others), (share, other)]


def gone_on(experiment: StructureExperiment, search: Search, sets: Sequence[Names]) -> Search:
    """Return a search under an experiment's errors from fits on, of which `sets` are fitted further."""
    again = Search(experiment, search.pool, search.effort)
    again.keep(replace(again.fitter.linearised(experiment.predict(fit.prediction.point, fit.prediction), fit.jacobian),
                       secant=True) for fit in search.fits.values())  # other errors leave derivatives about as they are
    again.stated = again.baseline
    again.continue_fits((names for names in sets if not again.by_chance(names).shape[1]), search.effort.last_steps)
    allow_for_chance(again)  # without that as an error, what is left to chance leads the others astray
    begin_baselines(experiment, again)
    return again


def of_baseline(experiment: StructureExperiment, search: Search) -> StructureExperiment:
    """Return an experiment with its numerical errors told at the baseline that is most probable under its own.

    These differ as much as baselines do: one that is fitted under the errors of another may stay where it is not.
    """
    effort = replace(search.effort, last_steps=AGAIN)
    asked = [(experiment, effort, one) for one in (search.baseline.prediction.point, *experiment.beginnings())]
    return max(search.pool(told_task, asked), key=lambda one: one[0])[1]


def told_task(asked: tuple[StructureExperiment, Effort, Point]) -> tuple[float, StructureExperiment]:
    """Return the log evidence without effects of an experiment with its errors told at a baseline's fit, and that."""
    experiment, effort, point = asked
    one, value = experiment, -np.inf
    try:
        for _ in range(AGAIN):  # then those of the fit, which a step or two tell as well as its rest
            one = experiment.with_errors_at(experiment.predict(point))
            own = start_search(one, one.predict(point), effort, in_turn)
            value = own.log_evidence(frozenset()) + own.discrepancy.covariance.log_density
            point = own.baseline.prediction.point
    except NonConvergenceError:
        return -np.inf, experiment
    return value, one


def p_of_stated(search: Search, recording: StructureRecording) -> float:
    """Return the p-value of how far the baseline is from the values that its recording states as known."""
    fit = search.baseline
    off = fit.z[[one.field in recording.known for one in fit.parameters.coordinates]]
    return float(chi2.sf(float(off @ off), max(len(off), 1)))


def released(free: StructureExperiment, search: Search) -> Search:
    """Return a search from the fits of another on, as if nothing were said of the stated values."""
    starts = [free.at(fit.prediction.point) for fit in search.fits.values()]
    middle = free.parameters(())
    again = start_search(free, free.predict(starts[0]), search.effort, search.pool)
    again.keep(again.pool(fit_task, [Task(again.fitter, one, None, search.effort.last_steps) for one in (
        *starts, Point(middle, np.zeros(middle.size)))]))
    return again


def detect(search: Search) -> Detection:
    """Return whether the refitted baseline leaves more than noise, matrices and steps of load explain."""
    own, fit = search.experiment.measurement, search.baseline
    rest = search.discrepancy.covariance.whiten(own.values - fit.predicted)  # what codes differ by the verdict weighs
    freedom = max(1, len(own.values) - len(fit.z))
    tests = {"chi-squared of what is left": float(chi2.sf(float(rest @ rest), freedom))}
    for k, channel in enumerate(own.channels):
        rows = own.channel == k
        tests[f"chi-squared of the {channel}"] = float(chi2.sf(float(rest[rows] @ rest[rows]), int(rows.sum())))
    name = min(tests, key=lambda one: tests[one])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def estimates(search: Search, names: Names) -> tuple[Estimate, ...]:
    """Return the parameters with their 90 % intervals, discrepancies of the laws and of the rest in them."""
    # a fit ends where a step is worth little
    mean, covariance = search.evidence(names).coordinates(search.prior(names))
    made = estimated(
        search.fits[names].parameters, mean, covariance, lambda one, z, half, draws: estimate(
            one, z, half, draws, described(one.effect, one.field) if one.effect else BASELINE[one.field]))
    return tuple(replace(one, name=one.name.replace("baseline.", "structure.")) for one in made)


def beyond_stated(recording: StructureRecording, made: Iterable[Estimate]) -> list[str]:
    """Return a warning for each value that is another than the recording states, or beyond the range that it gives."""
    notes = []
    for one in made:
        name = one.name.removeprefix("structure.")
        low, high = recording.unknown.get(name, (-np.inf, np.inf))
        stated = recording.known.get(name, 0.0)
        value, low_end, high_end, said = (pretty_quantity(v, one.unit, 3) for v in (one.value, low, high, stated))
        if not low <= one.value <= high:
            notes.append(f"{one.name} = {value} lies beyond the stated {low_end} to {high_end}")
        if stated > 0.0 and abs(log(one.value / stated)) > 2.0 * HALF * STATED:
            notes.append(f"{one.name} = {value} instead of {said}, which the backbone contradicts; check it")
    return notes


def remainder(search: Search, decision: Decision) -> Remainder:
    """Return what the model of the verdict leaves, and the channel where it leaves most."""
    own = search.experiment.measurement
    values = search.experiment.as_recorded(search.fits[decision.after].prediction)
    square = np.square(own.values - values) / own.variance
    shares = [float(square[own.channel == k].sum()) for k in range(len(own.channels))]
    return Remainder(share=share_left(search, decision),
                     times_noise=float(np.sqrt(square.mean())), where=own.channels[int(np.argmax(shares))])
