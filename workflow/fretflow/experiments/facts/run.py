"""The diagnosis of scalar facts: the rig's unknown parameters first, then what its model leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from fretflow.case.config import Case, Wear
from fretflow.core.errors import NonConvergenceError
from fretflow.core.progress import Progress
from fretflow.core.units import pretty_quantity
from fretflow.experiments.facts.experiment import FactsExperiment, shown
from fretflow.experiments.independent import IndependentSearch, estimates
from fretflow.experiments.rig.model import SAMPLES, RigModel
from fretflow.experiments.rig.observation import Observation
from fretflow.experiments.rig.setup import CONFIRMING, ELEMENTS, bare_case
from fretflow.experiments.rig.words import case_text
from fretflow.experiments.tools import DiagnosisTools
from fretflow.experiments.words import at_bounds, grade, unfinished
from fretflow.inference.decision import Decision, decide, detected, smallest_visible
from fretflow.inference.diagnosis import diagnosed, share_left
from fretflow.inference.experiment import Point, Prediction
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import HALF
from fretflow.inference.search import FAST, FULL, Pool, Task, fit_task
from fretflow.inference.strategy import run_search
from fretflow.inference.verdict import FALSE_ALARMS, Detection, Diagnosis, HeldOut, Location, Place, Remainder, Verdict
from fretflow.inference.words import blocks_of, listed, separating
from fretflow.recordings.kinds.facts import QUANTITIES, FactsFile, FactsRecording
from fretflow.recordings.schema import DisplacementOf, MeasuredAt
from fretflow.solvers.periodic import PeriodicProblem

FactsSearch = IndependentSearch[FactsExperiment]
NAMES = {"moving_mass": "rig.moving_mass", "friction_coefficient": "contact.friction_coefficient",
         "wear_coefficient": "wear.coefficient", "compliance": "specimen.compliance"}
NEXT = ("Loops over cycles at both amplitudes and maps of the wear at several cycle counts, for which facts stand that "
        "nothing in the catalogue explains.")


def diagnose_facts(recording: FactsRecording, fast: bool, progress: Progress, tools: DiagnosisTools) -> Diagnosis:
    """Return what facts of a rig's tests show that its model leaves out.

    Raises
    ------
    NonConvergenceError
        If no rig within the ranges shows what the facts are of.
    """
    progress(0.01, "specimens on two meshes")
    case, first = case_of(recording.file), ELEMENTS if fast else ELEMENTS + 1
    coarse, fine = (model_of(recording.file, problem) for problem in tools.statics(
        case_of(recording.file, elements) for elements in range(first, first + 2)))
    progress(0.1, "refitting the baseline")
    search = refitted(FactsExperiment.of(recording.file, coarse), fine, fast, tools.pool)
    run_search(search, lambda share, text: progress(0.2 + 0.7 * share, text))
    detection = detect(search)
    decision = detected(decide(search), detection)
    progress(0.95, "what is held out")
    return told(recording, case, search, decision, detection)


def case_of(file: FactsFile, elements: int = CONFIRMING) -> Case:
    """Return the case of the test that facts are of, with a contact of so many elements a side."""
    case = bare_case(file.test, file.test.cycles, elements, f"{elements}-elements")
    return case.model_copy(update={"title": file.title, "rig": file.rig, "specimen": file.specimen,
                                   "contact": file.contact})


def model_of(file: FactsFile, problem: PeriodicProblem) -> RigModel:
    """Return the rig's model on the mesh of `problem`, at which no channels are looked."""
    none = np.zeros(0)
    unseen = Observation(values=none, variance=none, noise=none, modes=np.zeros((0, 0)), floor=none, pieces=(),
                         harmonics=SAMPLES // 4, aligned_to="excitation", conditions=(), points=np.zeros((0, 2)))
    return RigModel(problem=problem, wear_coefficient=Wear().coefficient, observation=unseen,
                    displacement_of=DisplacementOf(MeasuredAt.CONTACT_FACES), samples=SAMPLES,
                    total_cycles=file.test.cycles)


def refitted(experiment: FactsExperiment, finer: RigModel, fast: bool, pool: Pool) -> FactsSearch:
    """Return a search with the baseline fitted from the best of several starts, its numerical errors told there.

    Raises
    ------
    NonConvergenceError
        If no start shows what the facts are of.
    """
    effort, space = FAST if fast else FULL, experiment.parameters(())
    coarse = FactsSearch(experiment, pool, effort)
    laid = [np.zeros(space.size), *(way * HALF * one for one in np.eye(space.size) for way in (-1.0, 1.0))]
    predictions = [one for one in pool(begin_task, [(experiment, Point(space, z)) for z in laid]) if one is not None]
    if not predictions:
        raise NonConvergenceError("no rig in the middle or at the ends of the ranges of [unknown] shows what the facts "
                                  "are of; widen the ranges")
    measured = experiment.measurement.values
    predictions.sort(key=lambda one: float(np.sum(np.square(measured - one.values)) + np.sum(np.square(one.point.z))))
    coarse.keep(pool(fit_task, [Task(coarse.fitter, one.point, one, effort.last_steps)
                                for one in predictions[:effort.starts]]))
    checked = experiment.checked_by(finer, coarse.baseline.prediction)
    search = FactsSearch(checked, pool, effort)
    first = coarse.baseline.prediction
    search.fits[frozenset()] = search.fitter.fit(first.point, first, effort.last_steps)
    return search


def begin_task(asked: tuple[FactsExperiment, Point]) -> Prediction | None:
    """Return what a point predicts; None where it has no solution."""
    try:
        return asked[0].predict(asked[1])
    except NonConvergenceError:
        return None


def detect(search: FactsSearch) -> Detection:
    """Return whether any rig within its ranges shows the facts: Box's check of what was predicted beforehand.

    Were all linear and normal, the least ``|r|^2 + |z|^2`` of M facts would be a chi-squared of M degrees of freedom,
    whatever the number of parameters (G. E. P. Box, J. R. Stat. Soc. A 143 (1980) 383-430); a bound adds less.
    """
    name = "least squares of facts and parameters"
    p = float(chi2.sf(search.baseline.objective, len(search.experiment.measurement.values)))
    return Detection(p_value=p, statistic=name, tests={name: p}, false_alarm_rate=FALSE_ALARMS)


def told(recording: FactsRecording, case: Case, search: FactsSearch, decision: Decision, detection: Detection
         ) -> Diagnosis:
    """Return the diagnosis of a verdict."""
    base, after = search.baseline, search.fits[decision.after]
    made = tuple(replace(one, name=NAMES.get(one.name.removeprefix("baseline."), one.name))
                 for one in estimates(search, decision.after))
    remainder = Remainder(share=share_left(search, decision),
                          times_noise=float(np.sqrt(np.mean(after.residual**2))),
                          where=listed_misses(search, after))
    location = locate(search, decision)
    unlisted = decision.verdict is Verdict.UNKNOWN
    warnings = (*map(str, recording.notes), *unfinished({
        names for names in (frozenset[str](), decision.after) if not search.fits[names].converged}),
        *at_bounds(after.parameters, after.z))
    return diagnosed(
        recording, decision, detection, sentence=sentence(decision, remainder, location), location=location,
        parameters=made, held_out=held_out(search, base, after), remainder=remainder, warnings=warnings,
        separating_measurement=NEXT if unlisted else separating(decision.rivals or [()]),
        smallest_visible=smallest_visible(search) if decision.verdict is Verdict.NONE else {},
        notes=tuple(comparisons(search, base, after)),
        case_file=case_text(case, search.experiment.hypothesis(after.prediction.point),
                            case.contact.friction_coefficient, case.wear.coefficient)
        if decision.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else "")


def comparisons(search: FactsSearch, base: Fit, after: Fit) -> list[str]:
    """Return each fact in words: what is stated, and what the baseline and the model of the verdict give."""
    models = {"the baseline gives": base, "the model of the verdict": after}
    if after is base:
        del models["the model of the verdict"]
    lines = []
    for k, fact in enumerate(search.experiment.file.facts):
        unit = QUANTITIES[fact.quantity][0]
        given = [f"{text} {pretty_quantity(float(shown(fit.prediction).quantities[k]), unit, 3)} "
                 f"({_off(float(fit.residual[k]))})" for text, fit in models.items()]
        lines.append(f"{fact.label}; {', '.join(given)}")
    return lines


def _off(residual: float) -> str:
    size = abs(residual)
    return "as stated" if size < 0.05 else f"{size:.1f} sd too {'low' if residual > 0.0 else 'high'}"


def listed_misses(search: FactsSearch, fit: Fit) -> str:
    """Return the facts that a fit misses by more than their 90 % interval, in words."""
    facts = search.experiment.file.facts
    missed = dict.fromkeys(fact.quantity.replace("-", " ") for fact, off in zip(facts, fit.residual, strict=True)
                           if abs(off) > HALF)
    return listed(missed) if missed else ""


def locate(search: FactsSearch, decision: Decision) -> Location:
    """Return which facts the refitted baseline misses."""
    own, square = search.experiment.measurement, search.baseline.residual**2
    places = tuple(Place(cut="channel", where=label, share=float(one / max(square.sum(), 1e-300)),
                         p_value=float(min(1.0, len(square) * chi2.sf(one, 1))))
                   for label, one in sorted(zip(own.channels, square, strict=True), key=lambda pair: -pair[1]))
    if decision.verdict is Verdict.NONE:
        return Location(block="", channel="", phase="", cycles=(0, 0), zone="", places=places)
    missed = listed_misses(search, search.baseline)
    return Location(block=blocks_of(decision.effects) if decision.effects else "", channel=places[0].where, phase="",
                    cycles=(0, 0), zone="", places=places,
                    text=f"The refitted baseline misses the {missed}." if missed else "")


def sentence(decision: Decision, remainder: Remainder, location: Location) -> str:
    """Return the verdict in one sentence."""
    share = f"{100.0 * decision.explained:.0f} %"
    left = f"it still misses the {remainder.where}" if remainder.where else (
        "all facts are then within their uncertainty")
    if decision.verdict is Verdict.NONE:
        return "A rig within the given ranges shows the facts within their uncertainty."
    if decision.verdict is Verdict.UNKNOWN:
        best = listed(decision.after) if decision.after else "nothing in the catalogue"
        return (f"No rig within the given ranges shows these facts, and no effect of the catalogue explains them well "
                f"enough: {best} explains {share} of the difference; {left}. {location.text}")
    names = " or ".join(" with ".join(sorted(one)) for one in decision.sets)
    return (f"{grade(decision.probability)}, the model leaves out {names}, which explains {share} of the difference; "
            f"{left}. {location.text}")


def held_out(search: FactsSearch, *fits: Fit) -> HeldOut:
    """Return the errors of each fact as the others predict it, to first order about the fits.

    With ``H = J (1 + J^T J)^-1 J^T`` of whitened derivatives, leaving row i out makes its residual
    ``r_i / (1 - H_ii)``.
    """
    sizes = []
    for fit in fits:
        own = np.einsum("ij,ji->i", fit.whitened_jacobian, np.linalg.solve(fit.information, fit.whitened_jacobian.T))
        sizes.append(float(np.sqrt(np.mean(np.square(fit.residual / (1.0 - own))))))
    return HeldOut(what="each fact from the others, to first order", before=sizes[0], after=sizes[-1], floor=1.0)
