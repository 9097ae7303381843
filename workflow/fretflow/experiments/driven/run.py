"""The diagnosis of a joint that a measured motion drives, or of a lumped body, by the inference engine.

The baseline is a slider with a spring (imposed displacement) or a mass on a damper (lumped).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from fretflow.core.progress import Progress
from fretflow.effects.catalogue import catalogue
from fretflow.experiments.driven.data import DrivenData, driven_data
from fretflow.experiments.driven.experiment import DrivenExperiment
from fretflow.experiments.driven.location import detect, locate, residual_law
from fretflow.experiments.driven.noise import effective, measured_noise, white_noise
from fretflow.experiments.driven.views import (
    comparisons,
    evolved,
    next_measurement,
    residual_maps,
    two_stiffnesses,
)
from fretflow.experiments.independent import IndependentSearch, at_rest, estimates, in_turn, smallest_visible
from fretflow.experiments.tools import DiagnosisTools
from fretflow.experiments.words import sentence
from fretflow.inference.decision import decide
from fretflow.inference.diagnosis import diagnosed, share_left
from fretflow.inference.experiment import Point
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import HALF, signed_fields
from fretflow.inference.search import FAST, FULL
from fretflow.inference.strategy import begin_all, run_search
from fretflow.inference.verdict import Diagnosis, HeldOut, Remainder, Verdict
from fretflow.inference.words import blocks_of, implausible, listed, separating
from fretflow.recordings.kinds.joints import LUMPED
from fretflow.recordings.recording import Recording

DrivenSearch = IndependentSearch[DrivenExperiment]
ROWS = 800  # samples that count in a search, so that all hypotheses are weighed in seconds


def diagnose_driven(recording: Recording, fast: bool, progress: Progress,
                    tools: DiagnosisTools | None = None) -> Diagnosis:
    """Return what a recording of an imposed displacement or of a lumped system shows that its model leaves out.

    Raises
    ------
    RecordingError
        If the recording does not hold what is needed.
    """
    data = driven_data(recording)
    progress(0.05, "baseline and noise")
    search = searched(data, fast, progress)
    decision = decide(search)
    progress(0.9, "parameters and pictures")
    experiment, fit = search.experiment, search.fits[decision.after]
    before, after = (experiment.force(one) for one in (search.baseline, fit))
    noise = experiment.noise
    block = blocks_of(decision.effects) or ("rig" if data.kind is LUMPED else "contact law")
    location = locate(data, noise, data.force - before, "" if decision.verdict is Verdict.NONE else block)
    law = residual_law(data, noise, data.force - before) if decision.verdict is Verdict.UNKNOWN else None
    remainder = Remainder(
        share=share_left(search, decision),
        times_noise=float(np.sqrt(np.mean((data.force - after)[data.used]**2))) / noise.sd,
        where=locate(data, noise, data.force - after, block).phase)
    made, readings = estimates(search, decision.after), evolved(data, before, after)
    return diagnosed(
        recording, decision, detect(data, noise, data.force - before),
        sentence=sentence(decision, remainder, location, law), location=location, remainder=remainder, parameters=made,
        held_out=held_out(experiment, search.baseline, fit), residual_law=law,
        separating_measurement=separating(decision.rivals or [()]) if law is None else next_measurement(law),
        smallest_visible=smallest_visible(search) if decision.verdict is Verdict.NONE else {},
        comparisons=comparisons(data, before, after), evolution=readings,
        residual_maps=residual_maps(data, noise, before, after),
        warnings=(*_warnings(recording, data), *implausible(made), *two_stiffnesses(readings, made)),
        notes=_notes(data, experiment))


def searched(data: DrivenData, fast: bool, progress: Progress) -> DrivenSearch:
    """Return the finished search among joints.

    The noise is what the fitted baseline leaves between repeats. As many samples count as one as are alike in what the
    best of all effects alone leaves.
    """
    rough = DrivenExperiment(data, white_noise(data), 1.0)
    first = fitted(data, ())
    noise = measured_noise(data, rough.joint(first.prediction.point))
    shared, every = max(noise.correlation, _alike(rough, first)), max(1, int(data.used.sum()) // ROWS)
    if shared > noise.correlation:  # what is alike in it the baseline may lack
        alone = _start_search(DrivenExperiment(data, noise, shared, every), first, fast)
        begin_all(alone)
        best = min((alone.fitter.fit(fit.prediction.point, None) for fit in alone.fits.values()),
                   key=lambda fit: fit.chi_squared)
        shared = max(noise.correlation, _alike(rough, best))
    search = _start_search(DrivenExperiment(data, noise, shared, every), first, fast)
    run_search(search, lambda share, text: progress(0.2 + 0.65 * share, text))
    return search


def _alike(experiment: DrivenExperiment, fit: Fit) -> float:
    """Return how many samples count as one in what a fit leaves."""
    data = experiment.data
    return float(data.used.sum()) / effective(data.force - experiment.force(fit), data.used)


def _start_search(experiment: DrivenExperiment, first: Fit, fast: bool) -> DrivenSearch:
    search = DrivenSearch(experiment, in_turn, FAST if fast else FULL)
    search.fits[frozenset()] = refitted(experiment, first.prediction.point)
    search.stated = search.fitter.at(Point(first.parameters, np.zeros(len(first.z))), None)
    return search


def refitted(experiment: DrivenExperiment, point: Point) -> Fit:
    """Return the most probable parameters from a point, however many steps they take."""
    return at_rest(Fitter(experiment, experiment.measurement.covariance()), point)


def fitted(data: DrivenData, effects: Sequence[str]) -> Fit:
    """Return the most probable joint with given effects, from the best of several starts."""
    experiment = DrivenExperiment(data, white_noise(data), 1.0)
    fields = [f"{name}.{field}" for name in effects for field in signed_fields(catalogue()[name])]
    ends = []
    for ways in product((1.0, -1.0), repeat=len(fields)):
        own = experiment.parameters(effects, dict(zip(fields, ways, strict=True)))
        ends += [refitted(experiment, Point(own, np.r_[start, np.zeros(own.size - 1)])) for start in (-HALF, 0.0, HALF)]
    return min(ends, key=lambda fit: fit.objective)


def held_out(experiment: DrivenExperiment, *fits: Fit) -> HeldOut:
    """Return the errors on what is held out of the baseline and of a set, refitted to the rest, over the noise."""
    data = experiment.data
    part, sizes = replace(experiment, data=replace(data, held_out=np.zeros_like(data.held_out))), []
    for fit in fits:
        left = (data.force - experiment.force(refitted(part, fit.prediction.point)))[data.held_out]
        sizes.append(float(np.sqrt(np.mean(left**2))) / experiment.noise.sd)
    return HeldOut(what=data.held_out_words, before=sizes[0], after=sizes[-1], floor=1.0)


def _warnings(recording: Recording, data: DrivenData) -> tuple[str, ...]:
    told = (*map(str, recording.notes), *data.notes)
    rates = [name for name, kind in catalogue().items() if data.kind in kind.kinds and kind.needs_time]
    if data.timed or not rates:
        return told
    return (*told, f"the record has no time axis, so that {listed(rates)} were not looked at")


def _notes(data: DrivenData, experiment: DrivenExperiment) -> tuple[str, ...]:
    noise = experiment.noise
    said = f"noise: {noise.sd:,.3g} N a sample, from {noise.source}"
    return (said, "the force is predicted from the measured motion, which is taken as it is") if (
        data.kind is LUMPED) else (said,)
