"""What a recorded backbone tells of a structure: held-out amplitudes, where it parts, periodic motions as a check."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from fretflow.core.errors import NonConvergenceError
from fretflow.core.units import pretty_quantity
from fretflow.experiments.structure.experiment import THIRDS, StructureExperiment
from fretflow.experiments.structure.observation import MATRICES
from fretflow.experiments.structure.responses import response_curves
from fretflow.inference.decision import Decision
from fretflow.inference.experiment import Prediction
from fretflow.inference.search import Names, Search, Task
from fretflow.inference.strategy import chance_task
from fretflow.inference.verdict import FALSE_ALARMS, HeldOut, Location, MeasuredCurve, Place, Remainder, Verdict
from fretflow.inference.words import blocks_of, listed, not_enough, percent
from fretflow.recordings.kinds.structures import MODAL_UNIT
from fretflow.recordings.plausibility import NOTED
from fretflow.solvers.nonlinear_modes.periodic_mode import HARMONICS

NEXT = "pressure between the faces (film), the form of both faces, and the backbone at another bolt load"


def told(experiment: StructureExperiment, search: Search, decision: Decision, left: Remainder) -> dict[str, Any]:
    """Return the fields of a diagnosis that are of a backbone alone."""
    location, after = _locate(experiment, search, decision), search.fits[decision.after]
    return {"location": location, "sentence": _sentence(decision, search, left, location.text, experiment.or_finer),
            "curves": curves(experiment, search.baseline.prediction, after.prediction),
            "notes": (*_notes(experiment, after.prediction), _checked(search, decision.after))}


def warnings(experiment: StructureExperiment) -> tuple[str, ...]:
    """Return what makes any verdict on a recording less sure."""
    return (*map(str, experiment.recording.notes), *outside_of_mode(experiment))


def held_out(experiment: StructureExperiment, search: Search, names: Names) -> HeldOut | None:
    """Return how well amplitudes above those that are fitted are predicted, before and after."""
    own, last = experiment.measurement, experiment.held_out
    count = len(experiment.points.amplitude)
    head = int(np.sum(~last[:count]))
    sizes = []
    for one in (frozenset[str](), names):
        fit, model = search.fits[one], search.fitter_of(one).experiment
        model = model if isinstance(model, StructureExperiment) else experiment
        below = model.first(head)
        refitted = chance_task(Task(replace(search.fitter, experiment=below, covariance=below.measurement.covariance()),
                                    fit.prediction.point, fit.prediction, 6))
        if refitted is None:
            return None
        try:
            predicted = model.predict(refitted.prediction.point)
        except NonConvergenceError:
            return None
        # the draw is one at all amplitudes, as other errors in common are: what is fitted tells it
        known = own.covariance().with_modes(model.by_chance(predicted))
        rest = own.values - predicted.values
        rest -= known.modes @ known.hiding(last).shared(rest)
        rest = rest[last] / np.sqrt(own.variance[last])
        sizes.append(float(np.sqrt(np.mean(rest**2))))
    above = pretty_quantity(float(experiment.points.amplitude[head - 1]), experiment.recorded.amplitude_unit, 3)
    return HeldOut(what=f"amplitudes above {above}", before=sizes[0], after=sizes[1], floor=1.0)


def _locate(experiment: StructureExperiment, search: Search, decision: Decision) -> Location:
    """Return by channel and amplitude where the baseline and the recording part."""
    if decision.verdict is Verdict.NONE:
        return Location(block="", channel="", phase="", cycles=(0, 0), zone="")
    own, fit = search.experiment.measurement, search.baseline
    square = np.square(own.values - experiment.as_recorded(fit.prediction)) / own.variance
    total = max(float(square.sum()), 1e-300)
    third = np.tile(experiment.third, len(own.channels))
    places = []
    for cut, labels, index in (("channel", own.channels, own.channel), ("amplitude", THIRDS, third)):
        for k, label in enumerate(labels):
            rows = index == k
            if rows.any():
                places.append(Place(cut=cut, where=label, share=float(square[rows].sum()) / total,
                                    p_value=min(1.0, 5.0 * float(chi2.sf(square[rows].sum(), int(rows.sum()))))))
    channel, zone = (max((one for one in places if one.cut == cut), key=lambda one: one.share) for cut in (
        "channel", "amplitude"))
    block = blocks_of(frozenset().union(*decision.sets)) if decision.sets else "contact law"
    return Location(block=block, channel=channel.where, phase="", cycles=(0, 0), zone=zone.where, places=tuple(places),
                    text=_parted(channel, zone))


def _notes(experiment: StructureExperiment, fitted: Prediction) -> list[str]:
    own, off = experiment.structure, float(experiment.as_recorded(fitted)[0] / fitted.values[0]) - 1.0
    notes = [f"{own.contacts} contact points, {len(own.eigenvalues)} modes of the closed joint, {own.rigid_motions} "
             f"motions that strain nothing; mode {experiment.mode + 1} is compared"]
    if experiment.spacing != 1.0:
        notes.append("the backbone is most probable as of a mesh much finer than that of the matrices, as real faces "
                     "are: what the distance of contact points changes counts as an error")
    if experiment.static:
        notes.append("the backbone is most probable as of static loads in the shape of the mode, as quasi-static "
                     "simulators predict it, and is compared with these")
    if not experiment.matched:
        notes.append(f"the backbone is most probable as of parts that the matrices are not matched to: its frequencies "
                     f"are {100.0 * abs(off):.2g} % {'above' if off > 0.0 else 'below'} theirs, which counts as their "
                     "error; check modulus, density and thickness of the parts")
    if own.error > 0.0:
        notes.append(f"the reduction changes the first frequencies by {100.0 * own.error:.2g} %")
    if experiment.recording.responses:
        notes.append("frequency and damping are compared; of responses the force that their motion needs is shown, and "
                     "where there is no other backbone it is read off them")
    if experiment.recording.ring_down is not None:
        notes.append("the backbone alone is compared; where there is none, that of the first output in ring_down is")
    return notes


def outside_of_mode(experiment: StructureExperiment) -> list[str]:
    """Return what contradicts that contact only stiffens: a mode lies between that of the open and the closed joint."""
    seen, (low, high) = float(experiment.points.frequency[0]), experiment.observation.span(experiment.mode)
    off = max(low / seen, seen / high) - 1.0
    if off <= MATRICES:
        return []
    check = "the unit of the frequency, backbone.mode and both matrices" if off > NOTED - 1.0 else (
        "how well both matrices are matched to the parts")
    return [f"its smallest amplitude has {seen:.5g} Hz, {100.0 * off:.2g} % beyond what M and K give mode "
            f"{experiment.mode + 1}: {low:.5g} Hz with the joint open, {high:.5g} Hz with it glued; check {check}"]


def _checked(search: Search, names: Names) -> str:
    """Return in words how far periodic motion differs from static loads for a model at its fit."""
    model = search.fitter_of(names).experiment
    more = None
    if isinstance(model, StructureExperiment):
        more = model.correction if model.correction is not None else model.beyond_static_loads(
            search.fits[names].prediction)
    if more is None:
        return "the fitted model was not confirmed by periodic motions: none was found"
    frequency = np.max(np.abs(more[0]) / search.experiment.measurement.values[:more.shape[1]])
    damping = "".join(f" and {np.max(np.abs(one)):.2g} of the damping ratio" for one in more[1:])
    compared = "" if isinstance(model, StructureExperiment) and model.static else ", with which it is compared,"
    return (f"periodic motions of the fitted model ({HARMONICS} harmonics){compared} differ from static loads by "
            f"{100.0 * frequency:.2g} % of the frequency{damping} at most")


def curves(experiment: StructureExperiment, *fits: Prediction) -> tuple[MeasuredCurve, ...]:
    """Return backbone and responses as measured and as two predictions, before and after, have them."""
    own, told = experiment.measurement, experiment.recorded
    before, after = (experiment.as_recorded(one) for one in fits)
    models = [(one.state, experiment.joint(one.point).linear_modes(experiment.mode + 1)[experiment.mode])
              for one in fits]
    name, unit = "modal amplitude", MODAL_UNIT
    if told.amplitude_unit != MODAL_UNIT:
        name, unit = f"amplitude of {told.amplitude_of}", told.amplitude_unit
    backbones = tuple(MeasuredCurve(
        label=f"{channel} over amplitude", x_label=name, x_unit=unit,
        y_label=("natural frequency", "damping ratio")[k], y_unit=("Hz", "1")[k], x=experiment.points.amplitude,
        measured=own.values[own.channel == k], before=before[own.channel == k], after=after[own.channel == k])
        for k, channel in enumerate(own.channels))
    return backbones + response_curves(experiment.recording.responses, experiment.structure, models)


def _sentence(decision: Decision, search: Search, left: Remainder, where: str, or_finer: bool = False) -> str:
    """Return the verdict in a sentence or two."""
    verdict, sets, explained = decision.verdict, decision.sets, search.explained(decision.after)
    if verdict is Verdict.NONE:
        misses, count = search.chi_squared(frozenset()), len(search.experiment.measurement.values)
        if chi2.sf(misses, count) < FALSE_ALARMS:
            return ("Bolt load, friction and modal damping leave something within the numerical errors of the model "
                    "here, so that nothing can be named; see what finer matrices give.")
        return "Bolt load, friction and modal damping explain frequency and damping over the amplitude."
    if verdict is Verdict.UNKNOWN:
        near = (f": {listed(decision.after)} would explain {percent(explained)} of the difference, "
                f"{not_enough(decision.against, left.times_noise)}") if decision.after else ""
        finer = (" Or nothing is missing, and the faces have a finer mesh than the matrices, whose errors would leave "
                 "no more than noise; that is less probable, and matrices of a finer mesh tell.") if or_finer else ""
        return f"Something is missing that no effect of the catalogue explains{near}. {where}".strip() + finer
    names = " or ".join(" with ".join(sorted(one)) for one in sets)
    return f"What is missing is {names}: {percent(explained)} of the difference. {where}".strip()


def _parted(channel: Place, zone: Place) -> str:
    """Return where measured and predicted part."""
    return (f"They part most in the {channel.where} ({100.0 * channel.share:.0f} % of the difference) and at "
            f"{zone.where} ({100.0 * zone.share:.0f} %).")
