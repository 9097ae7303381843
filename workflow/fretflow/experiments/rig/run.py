"""The diagnosis of a recording of the rig: baseline, detection, place, name, and the fit before and after.

The baseline's own parameters are refitted first. Everything is fitted on a coarse contact mesh, whose errors are in
the covariance; a full diagnosis confirms its answer on a mesh of the pipeline's size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fretflow.case.config import Case, Reduction
from fretflow.core.errors import FretflowError
from fretflow.experiments.rig import words
from fretflow.experiments.rig.course import FAST, FULL, chosen_set, refine, search, start_search
from fretflow.experiments.rig.detection import detect, unsteady
from fretflow.experiments.rig.estimates import case_text, estimates
from fretflow.experiments.rig.fit import Fit, Fitter
from fretflow.experiments.rig.held_out import HeldOutPrediction, held_out
from fretflow.experiments.rig.law import residual_law
from fretflow.experiments.rig.location import locate
from fretflow.experiments.rig.model import Hypothesis, RigModel, Simulation
from fretflow.experiments.rig.observation import Array, Observation, observe
from fretflow.experiments.rig.search import Names, Pool, RigSearch
from fretflow.experiments.rig.setup import (
    MESHES,
    MESHES_FAST,
    Reduce,
    case_of,
    depth_error,
    errors_of,
    first_friction,
    first_simulation,
    first_wear,
    friction_from_energy,
    model_of,
)
from fretflow.experiments.rig.tangent import neighbours
from fretflow.experiments.rig.verdict import Found, decide, held_to, predicts, smallest_visible
from fretflow.experiments.rig.views import comparisons, held_out_error, residual_maps, wear_map
from fretflow.inference.verdict import Diagnosis, Verdict
from fretflow.inference.words import after_model, blocks_of
from fretflow.recordings.recording import Recording

Progress = Callable[[float, str], None]
SAMPLES = 50  # of a period, at most; each loop's error by it is in the covariance
STEEPER = 1.01  # friction, to see how loops follow it
FULL_PERIODS = 4  # times the samples, on the mesh that confirms


@dataclass(frozen=True)
class RigTools:
    """What lies above the diagnosis: meshes and reduction of a case, and processes to call functions in."""

    reduce: Reduce
    pool: Pool


@dataclass(frozen=True)
class _Prediction:
    """A prediction that a process is asked for."""

    model: RigModel
    hypothesis: Hypothesis


def predict_task(asked: _Prediction) -> Array:
    """Return the vector (M,) of a hypothesis."""
    return asked.model.predict(asked.model.simulate(asked.hypothesis))


def diagnose_rig(recording: Recording, fast: bool, progress: Progress, tools: RigTools) -> Diagnosis:
    """Return what a recording of the rig shows that the baseline leaves out.

    Raises
    ------
    RecordingError
        If the recording does not hold what is needed.
    NonConvergenceError
        If the baseline cannot be simulated.
    """
    began = time.monotonic()
    progress(0.01, "specimens on two meshes")
    observation = observe(recording, SAMPLES)
    case = case_of(recording)
    fitter, first, checks = _fitter(recording, observation, MESHES_FAST if fast else MESHES, tools, progress)
    progress(0.15, "refitting the baseline")
    observation, effort = fitter.rig.observation, FAST if fast else FULL
    looked = start_search(fitter, first, effort, tools.pool, checks)
    base = looked.baseline
    progress(0.3, "screening all effects")
    detection = detect(observation, base, looked.screen(frozenset()))
    chosen: Names = frozenset()
    if detection.p_value < detection.false_alarm_rate:
        search(looked, effort, lambda share, text: progress(0.35 + 0.45 * share, text))
        progress(0.8, "fitting the best to the end")
        refine(looked, chosen_set(looked))
        chosen = chosen_set(looked)
    progress(0.85, "held-out loops")
    found, unseen = _held(looked, decide(looked, chosen, detection))
    after = looked.fits[found.after]
    location = locate(fitter, base, blocks_of(found.effects) if found.effects else "",
                      cut=found.verdict is Verdict.UNKNOWN)
    law = residual_law(observation, base.predicted) if found.verdict is Verdict.UNKNOWN else None
    notes = [*map(str, recording.notes), *words.unfinished({
        names for names in (frozenset(), found.after) if not looked.fits[names].converged})]
    if unsteady(observation):
        notes.append(words.not_repeated())
    if not fast:
        progress(0.9, "confirming on the full mesh")
        notes.append(_confirmed(case, fitter, list(dict.fromkeys((base, after))), tools))
    named = found.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    return Diagnosis(
        title=recording.title, recording=str(recording.path), kind=recording.kind.value, verdict=found.verdict,
        effects=found.effects, probability=found.probability, ranking=found.ranking,
        sentence=words.sentence(found.verdict, found.sets, found.explained, location, law, not unsteady(observation),
                                predicts(unseen.error)),
        detection=detection,
        location=location, parameters=estimates(fitter.rig, after, found.widened), held_out=unseen.error,
        separating_measurement=words.next_measurement(law) if law is not None else words.separating(found.sets),
        residual_law=law, smallest_visible=smallest_visible(looked) if found.verdict is Verdict.NONE else {},
        comparisons=comparisons(observation, unseen.before, unseen.after, unseen.labels),
        residual_maps=residual_maps(observation, fitter.covariance, base.predicted, after.predicted),
        wear_map=wear_map(observation, base.predicted, after.predicted), notes=tuple(notes),
        case_file=case_text(case, fitter.rig, after) if named else "",
        after_model=after_model(found.verdict, found.after), seconds=time.monotonic() - began, fast=fast)


def _held(looked: RigSearch, found: Found) -> tuple[Found, HeldOutPrediction]:
    """Return the verdict and what is predicted of held-out loops, by the first alternative that helps there."""
    first = held_out(looked, found.after)
    if not predicts(first.error):
        for names in found.sets[1:]:
            other = held_out(looked, names)
            if predicts(other.error):
                return replace(found, after=names), other
    return held_to(found, first.error), first


def _fitter(recording: Recording, observation: Observation, meshes: Sequence[int], tools: RigTools,
            progress: Progress) -> tuple[Fitter, Simulation, tuple[RigModel, RigModel]]:
    """Return the fitter on the coarse mesh, the first simulation, and the models that tell what the mesh leaves out."""
    # the contact follows its static stiffness; the specimens' own modes are not looked at
    plain = {"reduction": Reduction(fixed_interface_modes=1, checked_frequencies=1)}
    coarse, fine = (tools.reduce(case_of(recording, elements, f"{elements}-elements").model_copy(update=plain))
                    for elements in meshes)
    read = [reading(recording) for reading in (first_friction, friction_from_energy)]
    model, first = first_simulation([
        model_of(recording, observation, coarse.vary(friction_coefficient=friction),
                 first_wear(recording, friction)) for friction in read])
    progress(0.08, "what the coarse mesh leaves out")
    finer = replace(model, problem=fine.vary(friction_coefficient=model.problem.friction_coefficient))
    denser = replace(model, samples=2 * model.samples)
    predicted = tools.pool(predict_task, [_Prediction(one, Hypothesis()) for one in (finer, denser)])
    plainly = model.predict(first)
    slope = neighbours(model, first, [Hypothesis(friction=STEEPER)])[:, 0]
    observation = observation.less_sure(depth_error(observation, predicted[0], plainly)).scattering(
        np.nan_to_num(slope))
    correction, modes = errors_of(observation, predicted[0], predicted[1], plainly)
    model, finer, denser = (replace(one, observation=observation) for one in (model, finer, denser))
    return Fitter(model, observation.covariance(modes), correction), first, (finer, denser)


def _confirmed(case: Case, fitter: Fitter, fits: Sequence[Fit], tools: RigTools) -> str:
    """Return in words how well fits predict the recording on a mesh of the pipeline's size, without any correction."""
    rig, observation = fitter.rig, fitter.rig.observation
    problem = tools.reduce(case).vary(friction_coefficient=rig.problem.friction_coefficient)
    full = replace(rig, problem=problem, samples=FULL_PERIODS * rig.samples)
    try:
        found = tools.pool(predict_task, [_Prediction(full, fit.space.hypothesis(fit.z)) for fit in fits])
    except FretflowError as error:
        return f"on the mesh of the case file the answer could not be confirmed: {error}"
    sizes = [held_out_error(observation, one) for one in found]
    nodes = problem.interface.size
    return (f"on the mesh of the case file ({nodes} contact nodes) all loops are predicted to "
            f"{', '.join(f'{size:.3g}' for size in sizes)} times what repeats differ by "
            f"({'baseline, then ' if len(sizes) > 1 else ''}the model of the verdict)")
