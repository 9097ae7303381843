"""The diagnosis of a structure from its backbone: fit, search, verdict, and the same by periodic motions as a check."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fretflow.core.errors import FretflowError, NonConvergenceError
from fretflow.core.units import pretty_quantity
from fretflow.effects.catalogue import catalogue
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.inference.evidence import drawn
from fretflow.inference.least_squares import Fit
from fretflow.inference.parameters import WIDTH
from fretflow.inference.posterior import Found, decide, smallest_visible
from fretflow.inference.search import FAST, FULL, Names, Search, begin_all, search, start_search
from fretflow.inference.verdict import Detection, Diagnosis, Estimate, HeldOut, Location, Place, Remainder, Verdict
from fretflow.inference.words import after_model, blocks_of, separating
from fretflow.recordings.kinds.structures import StructureRecording, WornRecording
from fretflow.solvers.nonlinear_modes.periodic_mode import follow_mode

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

FALSE_ALARMS = 0.05
MOST_RANKED = 40
CHECKED = 5  # amplitudes at which the fitted model is solved as periodic motion too
NOTHING: Names = frozenset()
THIRDS = ("small amplitudes", "middle amplitudes", "large amplitudes")
NEXT = "pressure between the faces (film), the form of both faces, and the backbone at another bolt load"
MEANINGS = {"bolt_load": "load of the bolts", "friction_coefficient": "friction of the faces",
            "modal_damping": "damping ratio of the structure without its joint",
            "wear_coefficient": "K_w: worn volume over load and sliding"}
UNITS = {"bolt_load": "N", "wear_coefficient": "m^2/N"}


def diagnose_structure(recording: StructureRecording | WornRecording, fast: bool, progress: Progress,
                       tools: Any = None) -> Diagnosis:
    """Return what a recording of a structure shows that its model leaves out.

    Raises
    ------
    InputError
        If it has no backbone, or its matrices cannot be used.
    NonConvergenceError
        If the baseline has no equilibrium.
    """
    from fretflow.experiments.structure.worn import diagnose_profiles

    pool = _one_by_one if tools is None else tools.pool
    if isinstance(recording, WornRecording):
        return diagnose_profiles(recording, fast, progress, pool)
    began = time.monotonic()
    progress(0.02, "reducing the structure")
    experiment = StructureExperiment.of(recording)
    progress(0.1, "refitting the baseline")
    first = experiment.first_prediction()
    found = start_search(experiment, first, FAST if fast or experiment.many else FULL, pool)
    detection = detect(found)
    if detection.p_value < FALSE_ALARMS:
        search(found, lambda share, text: progress(0.15 + 0.65 * share, text))
    else:
        begin_all(found)  # what would have been seen
    judged = decide(found)
    progress(0.85, "held-out amplitudes, and periodic motions as a check")
    held_out = _held_out(experiment, found, judged.after)
    location = _locate(found, judged)
    after = found.fits[judged.after]
    return Diagnosis(
        title=recording.title, recording=str(recording.path), kind=recording.kind.id, verdict=judged.verdict,
        effects=judged.effects, probability=judged.probability,
        sentence=sentence(judged.verdict, judged.sets, found.explained(judged.after), location.text),
        ranking=judged.ranking[:MOST_RANKED], detection=detection, location=location,
        parameters=estimates(found, judged.after), held_out=held_out, remainder=remainder(found, judged),
        separating_measurement=NEXT if judged.verdict is Verdict.UNKNOWN else separating(judged.sets or [()]),
        smallest_visible=smallest_visible(found) if judged.verdict is Verdict.NONE else {},
        notes=(*map(str, recording.notes), *_notes(experiment), _checked(experiment, after)),
        curves=experiment.curves(found.baseline.prediction, after.prediction),
        after_model=after_model(judged.verdict, judged.after), seconds=time.monotonic() - began, fast=fast)


def _one_by_one(function: Callable[[Any], Any], arguments: Any) -> list[Any]:
    return [function(one) for one in arguments]


def detect(found: Search) -> Detection:
    """Return whether the refitted baseline leaves more than noise, matrices and steps of load explain."""
    own = found.experiment.measurement
    fit = found.baseline
    freedom = max(1, len(own.values) - len(fit.z))
    tests = {"chi-squared of what is left": float(chi2.sf(fit.chi_squared, freedom))}
    for k, channel in enumerate(own.channels):
        rows = own.channel == k
        tests[f"chi-squared of the {channel}"] = float(chi2.sf(float(fit.residual[rows] @ fit.residual[rows]),
                                                               int(rows.sum())))
    name = min(tests, key=lambda one: tests[one])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def estimates(found: Search, names: Names) -> tuple[Estimate, ...]:
    """Return the parameters with their 90 % intervals, discrepancies of the laws and of the rest in them."""
    fit = found.fits[names]
    _, covariance = found.evidence(names).coordinates(found.prior(names))
    spread, draws = np.sqrt(np.diag(covariance)), drawn(fit.z, covariance)
    made = []
    for k, one in enumerate(fit.parameters.coordinates):
        middle = float(fit.z[k])
        ends = sorted(one.value(middle + way * 0.5 * WIDTH * float(spread[k])) for way in (-1.0, 1.0))
        info = catalogue()[one.effect].model_fields[one.field] if one.effect else None
        marks = [] if info is None else [mark.unit for mark in info.metadata if hasattr(mark, "unit")]
        made.append(Estimate(
            name=one.name if one.effect else f"structure.{one.field}", value=one.value(middle), low=ends[0],
            high=ends[1], unit=UNITS.get(one.field, marks[0] if marks else "1"),
            meaning=MEANINGS.get(one.field, "") if info is None else info.description or "",
            draws=one.values(draws[k])))
    return tuple(made)


def _held_out(experiment: StructureExperiment, found: Search, names: Names) -> HeldOut | None:
    """Return how well amplitudes above those that are fitted are predicted, before and after."""
    own, last = experiment.measurement, experiment.measurement.held_out
    count = len(experiment.points.amplitude)
    head = int(np.sum(~last[:count]))
    below = replace(experiment, points=experiment.points.first(head))
    sd = np.sqrt(own.variance[last])
    sizes = []
    for one in (NOTHING, names):
        fit = found.fits[one]
        try:
            refitted = replace(found.fitter, experiment=below, covariance=below.measurement.covariance()).fit(
                fit.prediction.point, None, 6)
            rest = (experiment.predict(refitted.prediction.point).values - own.values)[last] / sd
        except NonConvergenceError:
            return None
        sizes.append(float(np.sqrt(np.mean(rest**2))))
    above = pretty_quantity(float(experiment.points.amplitude[head - 1]), experiment.recorded.amplitude_unit, 3)
    return HeldOut(what=f"amplitudes above {above}", before=sizes[0], after=sizes[1], floor=1.0)


def remainder(found: Search, judged: Found) -> Remainder:
    """Return what the model of the verdict leaves, and the channel where it leaves most."""
    own = found.experiment.measurement
    square = np.square(own.values - found.fits[judged.after].predicted) / own.variance
    shares = [float(square[own.channel == k].sum()) for k in range(len(own.channels))]
    return Remainder(share=1.0 - found.explained(judged.after) if judged.after else 1.0,
                     times_noise=float(np.sqrt(square.mean())), where=own.channels[int(np.argmax(shares))])


def _locate(found: Search, judged: Found) -> Location:
    """Return by channel and amplitude where the baseline and the recording part."""
    if judged.verdict is Verdict.NONE:
        return Location(block="", channel="", phase="", cycles=(0, 0), zone="")
    own, fit = found.experiment.measurement, found.baseline
    square = np.square(own.values - fit.predicted) / own.variance
    total = max(float(square.sum()), 1e-300)
    third = np.digitize(own.phase, (0.5 / 3.0, 1.0 / 3.0))
    places = []
    for cut, labels, index in (("channel", own.channels, own.channel), ("amplitude", THIRDS, third)):
        for k, label in enumerate(labels):
            rows = index == k
            if rows.any():
                places.append(Place(cut=cut, where=label, share=float(square[rows].sum()) / total,
                                    p_value=min(1.0, 5.0 * float(chi2.sf(square[rows].sum(), int(rows.sum()))))))
    channel, zone = (max((one for one in places if one.cut == cut), key=lambda one: one.share) for cut in (
        "channel", "amplitude"))
    block = blocks_of(frozenset().union(*judged.sets)) if judged.sets else "contact law"
    return Location(block=block, channel=channel.where, phase="", cycles=(0, 0), zone=zone.where, places=tuple(places),
                    text=parted(channel, zone))


def _notes(experiment: StructureExperiment) -> list[str]:
    own = experiment.structure
    notes = [f"{own.contacts} contact points, {len(own.eigenvalues)} modes of the closed joint, {own.rigid_motions} "
             f"motions that strain nothing; mode {experiment.mode + 1} is compared"]
    if own.error > 0.0:
        notes.append(f"the reduction changes the first frequencies by {100.0 * own.error:.2g} %")
    if experiment.recording.responses:
        notes.append("frequency and damping are compared; of responses the force that their motion needs is shown, and "
                     "where there is no other backbone it is read off them")
    if experiment.recording.ring_down is not None:
        notes.append("the backbone alone is compared; where there is none, that of the first output in ring_down is")
    return notes


def _checked(experiment: StructureExperiment, fit: Fit) -> str:
    """Return in words how far static loads and periodic motion differ for the fitted model."""
    joint = experiment.joint(fit.prediction.point)
    try:
        mode = joint.linear_modes(experiment.mode + 1)[experiment.mode]
        curve = experiment.backbone(joint, mode)
        some = np.unique(np.linspace(0, len(curve.amplitude) - 1, CHECKED).round().astype(int))
        periodic = follow_mode(joint, mode, np.sort(curve.amplitude)[some])
    except FretflowError as error:
        return f"the fitted model was not confirmed by periodic motions: {error}"
    order = np.argsort(curve.amplitude)[some]
    frequency = np.max(np.abs([one.frequency for one in periodic] / curve.frequency[order] - 1.0))
    damping = np.max(np.abs([one.damping for one in periodic] - curve.damping[order]))
    return (f"periodic motions of the fitted model (4 harmonics) differ from static loads by {100.0 * frequency:.2g} % "
            f"of the frequency and {damping:.2g} of the damping ratio at most")


def sentence(verdict: Verdict, sets: Sequence[frozenset[str]], explained: float, where: str) -> str:
    """Return the verdict in a sentence or two."""
    if verdict is Verdict.NONE:
        return "Bolt load, friction and modal damping explain frequency and damping over the amplitude."
    if verdict is Verdict.UNKNOWN:
        return (f"Something is missing that no effect of the catalogue explains; the best leaves "
                f"{100.0 * (1.0 - explained):.0f} % of the difference. {where}").strip()
    names = " or ".join(" with ".join(sorted(one)) for one in sets)
    return f"What is missing is {names}: {100.0 * explained:.0f} % of the difference. {where}".strip()


def parted(channel: Place, zone: Place) -> str:
    """Return where measured and predicted part."""
    return (f"They part most in the {channel.where} ({100.0 * channel.share:.0f} % of the difference) and at "
            f"{zone.where} ({100.0 * zone.share:.0f} %).")
