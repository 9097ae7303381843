"""The diagnosis of a recording of the rig: baseline, detection, place, name, and the fit before and after.

The baseline's own parameters are refitted first. Everything is fitted on a coarse contact mesh, whose errors are in
the covariance; a full diagnosis confirms its answer on a mesh of the pipeline's size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from fretflow.case.config import Case
from fretflow.core.errors import FretflowError
from fretflow.core.progress import Progress
from fretflow.core.records import Array
from fretflow.experiments.rig import words
from fretflow.experiments.rig.experiment import BASELINE, RigExperiment, hypothesis, simulation_of
from fretflow.experiments.rig.held_out import HeldOutPrediction, detect, held_out
from fretflow.experiments.rig.instruments import doubts, faults
from fretflow.experiments.rig.law import residual_law
from fretflow.experiments.rig.location import locate
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.observation import measured_loops, observe
from fretflow.experiments.rig.setup import (
    ELEMENTS,
    FRICTION,
    case_of,
    depth_error,
    errors_of,
    first_friction,
    first_simulation,
    first_wear,
    friction_from_energy,
    is_seen,
    linear_case,
    load_calibration,
    model_of,
    stiff_asperities,
    worn_as_much,
)
from fretflow.experiments.rig.simulation import Hypothesis, Simulation
from fretflow.experiments.rig.tangent import neighbours
from fretflow.experiments.rig.views import comparisons, evolved, held_out_error, residual_maps, wear_map
from fretflow.experiments.rig.words import case_text, estimates
from fretflow.experiments.tools import DiagnosisTools
from fretflow.experiments.words import at_bounds, sentence, unfinished
from fretflow.inference.decision import (
    Decision,
    beyond_noise,
    decide,
    detected,
    held_to,
    ruled_out,
    shared_anew,
    smallest_visible,
)
from fretflow.inference.diagnosis import diagnosed, share_left
from fretflow.inference.experiment import STEP, Point, Prediction
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.posterior import largest_odds
from fretflow.inference.search import FAST, FULL, Search
from fretflow.inference.strategy import run_search, start_search
from fretflow.inference.verdict import FALSE_ALARMS, Detection, Diagnosis, Location, Remainder, Verdict
from fretflow.inference.words import blocks_of, listed, separating
from fretflow.recordings.periods import LEVEL
from fretflow.recordings.recording import Recording
from fretflow.recordings.repeatability import is_unsteady


@dataclass(frozen=True)
class _Prediction:
    """A prediction that a process is asked for: of a hypothesis, or of a coarser model's simulation."""

    model: RigModel
    of: Hypothesis | Simulation


def predict_task(asked: _Prediction) -> Array:
    """Return the vector (M,) that is asked for."""
    model, of = asked.model, asked.of
    return model.predict(model.simulate(of) if isinstance(of, Hypothesis) else model.refine(of))


def diagnose_rig(recording: Recording, fast: bool, progress: Progress, tools: DiagnosisTools) -> Diagnosis:
    """Return what a recording of the rig shows that the baseline leaves out.

    Raises
    ------
    RecordingError
        If the recording does not hold what is needed.
    NonConvergenceError
        If the baseline cannot be simulated.
    """
    stage = "specimens on coarse meshes"
    progress(0.01, stage)
    case = case_of(recording)
    wrong = faults(recording, case)
    if wrong:
        return faulty(recording, wrong)
    doubted = doubts(recording, case)
    for one in doubted:
        progress(0.02, f"{stage}: {one}")
    experiment, first = experiment_of(recording, (ELEMENTS, ELEMENTS + 1), tools, progress)
    progress(0.15, "refitting the baseline")
    search = start_search(experiment, first, FAST if fast else FULL, tools.pool)
    run_search(search, lambda share, text: progress(0.2 + 0.65 * share, text))
    before = _plainly(experiment, search.baseline)
    detection = detect(experiment.rig.observation, before)
    decision = detected(plausible(decide(search), search, experiment), detection)
    # where what repeats differ by is motion, there is no noise to hide in
    decision = periodic(decision, recording) if experiment.rig.observation.unsteady else beyond_noise(decision, search)
    progress(0.85, "held-out loops")
    unseen = held_out(search, experiment, decision.after)
    # what models leave is smooth over a loop: each channel of a loop is one error, whatever its samples
    judging = [piece for piece in experiment.rig.observation.pieces if piece.label in unseen.judged]
    decision = held_to(decision, unseen.error, len(judging))
    return _told(recording, case, experiment, search, decision, before, detection, unseen, doubted, tools, fast,
                 progress)


def faulty(recording: Recording, wrong: Sequence[str]) -> Diagnosis:
    """Return what is said of a recording whose instruments contradict themselves or the rig: no physics."""
    whole, told = Remainder(share=1.0, times_noise=np.inf, where="the instruments"), (*wrong, *words.assumed(recording))
    return Diagnosis(
        title=recording.title, recording=str(recording.path), kind=recording.kind.id, verdict=Verdict.UNKNOWN,
        effects=(), probability=1.0 - FALSE_ALARMS, ranking=(), sentence=words.of_instruments(wrong),
        detection=Detection(p_value=FALSE_ALARMS, statistic="instruments", tests={}, false_alarm_rate=FALSE_ALARMS),
        location=Location(block="sensor", channel="", phase="", cycles=(0, 0), zone="", text=""), parameters=(),
        held_out=None, faults=tuple(wrong),
        separating_measurement="The channels again, calibrated against each other at rest and unloaded.",
        smallest_visible={}, remainder=whole, warnings=told)


def _told(recording: Recording, case: Case, experiment: RigExperiment, search: Search, decision: Decision, before: Fit,
          detection: Detection, unseen: HeldOutPrediction, doubted: Sequence[str], tools: DiagnosisTools,
          fast: bool, progress: Progress) -> Diagnosis:
    """Return the diagnosis of a verdict."""
    observation, base, after = experiment.rig.observation, search.baseline, search.fits[decision.after]
    behind = before if after is base else _plainly(experiment, after)
    location = locate(experiment, before, blocks_of(decision.effects) if decision.effects else "",
                      cut=decision.verdict is Verdict.UNKNOWN)
    law = residual_law(observation, base.predicted) if (
        decision.verdict is Verdict.UNKNOWN and observation.has_loops) else None
    remainder = _remainder(experiment, search, decision, behind)
    warnings = [*doubted, *words.assumed(recording), *map(str, recording.notes), *unfinished({
        names for names in (frozenset[str](), decision.after) if not search.fits[names].converged})]
    warnings += at_bounds(after.parameters, after.z)
    if experiment.rig.observation.unsteady:
        warnings.append(words.not_repeated())
    if unseen.labels and not unseen.judged:
        warnings.append(words.not_judged())
    notes: tuple[str, ...] = ()
    if not fast and observation.has_loops:
        progress(0.9, "confirming on the full mesh")
        notes = (_confirmed(case, experiment, list(dict.fromkeys((base, after))), tools),)
    named = decision.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    mean, covariance = search.evidence(decision.after).coordinates(search.prior(decision.after))
    return diagnosed(
        recording, decision, detection, sentence=sentence(decision, remainder, location, law) + words.in_doubt(doubted),
        location=location, parameters=estimates(
            case, experiment.rig, after.parameters, mean, covariance, load_calibration(recording)),
        held_out=unseen.error, remainder=remainder, warnings=tuple(warnings),
        separating_measurement=words.next_measurement(law) if law is not None else separating(decision.rivals),
        residual_law=law, smallest_visible=smallest_visible(search) if decision.verdict is Verdict.NONE else {},
        comparisons=comparisons(observation, unseen.before, unseen.after, unseen.labels, measured_loops(recording)),
        evolution=evolved(observation, base.predicted, after.predicted),
        residual_maps=residual_maps(observation, experiment.measurement.covariance(), base.predicted, after.predicted),
        wear_map=wear_map(observation, base.predicted, after.predicted), notes=notes,
        case_file=case_text(case, hypothesis(Point(after.parameters, mean)),
                            float(np.mean(experiment.rig.problem.friction_coefficient)),
                            experiment.rig.wear_coefficient) if named else "")


def plausible(decision: Decision, search: Search, experiment: RigExperiment) -> Decision:
    """Return a verdict that names nothing where the fit asks for a rig that is not the stated one.

    That is a friction coefficient that no dry contact has, or a parameter of the baseline that less than one in a
    thousand of what the file states is beyond: an effect that is right needs no such help (prior-data conflict:
    M. Evans, H. Moshonov, Bayesian Anal. 1 (2006) 893-914). How sure that makes, says the smallest of their p-values
    times how many there are. Damping is no such parameter: it is seldom measured, and the steps of another code damp
    the arm several times as much as its file states.
    """
    if decision.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return decision
    fit = search.fits[decision.after]
    friction = hypothesis(fit.prediction.point).friction * float(np.mean(experiment.rig.problem.friction_coefficient))
    if not FRICTION[0] < friction < FRICTION[1]:
        return ruled_out(decision, "needs a friction coefficient that no dry contact has")
    held = [place for place, one in enumerate(fit.parameters.coordinates) if not one.effect and one.field != "damping"]
    p = len(held) * 2.0 * norm.sf(np.abs(fit.z[held]))
    beyond = [fit.parameters.coordinates[place].name for place, own in zip(held, p, strict=True) if own < LEVEL]
    if not beyond:
        return decision
    return ruled_out(decision, f"needs {listed(beyond)} far from what is stated", float(p.min()))


def periodic(decision: Decision, recording: Recording) -> Decision:
    """Return a verdict held to repeats of a motion that are no repeats: with a drive that has its own, no model is so.

    What drives the rig may wander itself where it is not recorded.
    """
    loops = recording.loops
    if loops is None or "excitation" not in loops.channels or is_unsteady(
            loops.channels["excitation"], loops.channels["displacement"]):
        return decision
    left = decision.posterior.none / (1.0 + largest_odds(LEVEL))
    return ruled_out(shared_anew(decision, left, 1.0),
                     "repeats itself with the drive, which the recorded motion does not", LEVEL)


def _plainly(experiment: RigExperiment, fit: Fit) -> Fit:
    """Return a fit under the errors of the measurement alone."""
    slopes = None if fit.provisional else fit.jacobian
    return Fitter(experiment, experiment.measurement.covariance()).linearised(fit.prediction, slopes)


def _remainder(experiment: RigExperiment, search: Search, decision: Decision, after: Fit) -> Remainder:
    """Return what the model of the verdict leaves."""
    place = locate(experiment, after, cut=False)
    where = ", ".join(part for part in (place.channel, f"the {place.phase}" if place.phase else "", place.condition)
                      if part)
    return Remainder(share=share_left(search, decision), where=where,
                     times_noise=float(np.sqrt(after.chi_squared / experiment.measurement.expected)))


def experiment_of(recording: Recording, elements: Sequence[int], tools: DiagnosisTools, progress: Progress
                  ) -> tuple[RigExperiment, Prediction]:
    """Return a recording under the engine and its first prediction."""
    observation = observe(recording)
    cases = [case_of(recording, own, f"{own}-elements") for own in elements]
    coarse, fine, linear = tools.statics([*cases, linear_case(cases[0])])
    read = [reading(recording) for reading in (first_friction, friction_from_energy)]
    model, first = first_simulation([
        model_of(recording, observation, coarse.vary(friction_coefficient=friction),
                 first_wear(recording, friction)) for friction in read])
    if not observation.has_loops:
        model, first = worn_as_much(model, first)
    progress(0.08, "what the coarse mesh leaves out")
    finer, denser = model.finer(fine), model.denser()
    untold = next(one.size for one in BASELINE if one.field == "compliance")
    asked = [_Prediction(one, Hypothesis()) for one in (finer, denser)]
    asked.append(_Prediction(model, Hypothesis(effects=(stiff_asperities(model.problem, untold),))))
    asked.append(_Prediction(model.finer(linear), Hypothesis()))
    predicted = tools.pool(predict_task, asked)
    plainly = model.predict(first)
    others, codes = np.column_stack(predicted[2:]) - plainly[:, None], [plainly, predicted[0], predicted[3]]
    if is_seen(observation, predicted[1] - plainly):  # at other parameters kinks fall otherwise between the samples
        model, finer = model.twice_as_dense(), finer.twice_as_dense()
        first, predicted[0] = model.simulate(Hypothesis()), predict_task(_Prediction(finer, Hypothesis()))
        plainly = model.predict(first)
    slopes = np.nan_to_num(neighbours(model, first, [
        Hypothesis(friction=1.0 + STEP), Hypothesis(mass=1.0 + STEP), Hypothesis(compliance=1.0 + STEP),
        Hypothesis(damping=1.0 + STEP)]))
    observation = observation.less_sure(np.zeros(len(plainly)), others)
    for one, other in pairwise(codes):
        observation = observation.less_sure(*depth_error(observation, one, other))
    observation = observation.scattering(slopes[:, 0])
    correction, modes = errors_of(observation, predicted[0], predicted[1], plainly,
                                  denser.samples / model.samples)
    model, finer, denser = (replace(one, observation=observation) for one in (model, finer, denser))
    made = RigExperiment(model, correction, modes, checks=(finer, denser), embedded=slopes / STEP)
    space = made.parameters(())
    return made, Prediction(Point(space, np.zeros(space.size)), plainly + correction, first)


def _confirmed(case: Case, experiment: RigExperiment, fits: Sequence[Fit], tools: DiagnosisTools) -> str:
    """Return in words how well fits predict the recording on a mesh of the pipeline's size, without any correction."""
    rig, observation = experiment.rig, experiment.rig.observation
    full = rig.finer(tools.reduce(case)).denser()
    try:
        predictions = tools.pool(predict_task, [_Prediction(full, simulation_of(fit.prediction)) for fit in fits])
    except FretflowError as error:
        return f"on the mesh of the case file the answer could not be confirmed: {error}"
    sizes = [held_out_error(observation, one) for one in predictions]
    nodes = full.problem.interface.size
    return (f"on the mesh of the case file ({nodes} contact nodes) all loops are predicted to "
            f"{', '.join(f'{size:.3g}' for size in sizes)} times what repeats differ by "
            f"({'baseline, then ' if len(sizes) > 1 else ''}the model of the verdict)")
