"""The diagnosis of a joint that a measured motion drives: noise, detection, place, name, and the fit before and after.

The baseline is a slider with a spring (imposed displacement) or a mass on a damper (lumped). Its own parameters are
refitted first. All that is judged was fitted to one part of the record; the errors shown are of the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fretflow.effects.effect import Kind
from fretflow.experiments.driven import words
from fretflow.experiments.driven.data import DrivenData, driven_data
from fretflow.experiments.driven.estimates import estimates, refitted
from fretflow.experiments.driven.fit import DrivenFit, Scale, scaled_priors
from fretflow.experiments.driven.location import block_of, locate, residual_law
from fretflow.experiments.driven.noise import Noise, harmonic_p, mean_square_p, measured_noise
from fretflow.experiments.driven.search import (
    Names,
    Search,
    aliases,
    baseline_fit,
    first_parameter,
    search,
    usable_effects,
)
from fretflow.experiments.driven.views import comparisons, residual_maps
from fretflow.inference.verdict import EXPLAINED_GATE, Candidate, Detection, Diagnosis, HeldOut, Verdict
from fretflow.inference.words import after_model
from fretflow.recordings.recording import Recording

Progress = Callable[[float, str], None]
FALSE_ALARMS = 0.05
HARMONICS = 9
MOST, MOST_FAST = 4, 2  # effects at once
GATE_WIDTH = 0.05  # of the explained share, over which the catalogue's claim fades
MOST_RANKED = 40  # sets that are listed
CLEARLY = 2.0  # times the noise: more is left than repeats explain
VISIBLE = 4.0  # standard deviations at which an effect would have been seen
BASELINE_SET: Names = frozenset()


@dataclass(frozen=True)
class _Found:
    """What the search came to."""

    verdict: Verdict
    chosen: Names
    stand_ins: dict[str, tuple[str, ...]]
    ranking: tuple[Candidate, ...]
    after: DrivenFit

    @property
    def alternatives(self) -> tuple[Names, ...]:
        """Return the set and those with a stand-in in place of one of its effects."""
        return self.chosen, *(self.chosen - {name} | {other} for name, others in self.stand_ins.items()
                              for other in others)

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the effects that the verdict names, stand-ins included."""
        if self.verdict in (Verdict.NONE, Verdict.UNKNOWN):
            return ()
        return tuple(sorted({*self.chosen, *(other for others in self.stand_ins.values() for other in others)}))


def diagnose_driven(recording: Recording, fast: bool, progress: Progress) -> Diagnosis:
    """Return what a recording of an imposed displacement or of a lumped system shows that its model leaves out.

    Raises
    ------
    RecordingError
        If the recording does not hold what is needed.
    """
    began = time.monotonic()
    data = driven_data(recording)
    progress(0.05, "baseline")
    baseline = baseline_fit(data)
    noise = measured_noise(data, baseline.joint)
    detection = detect(data, noise, baseline)
    own, left_out = usable_effects(data)
    looked = Search(data, noise, own, {BASELINE_SET: baseline}, {BASELINE_SET})
    found = _found(looked, detection, fast, lambda share, text: progress(0.1 + 0.75 * share, text))
    progress(0.9, "parameters and pictures")
    block = words.blocks_of(found.effects) or block_of(data.kind)
    location = locate(data, noise, baseline, "" if found.verdict is Verdict.NONE else block)
    law = residual_law(data, noise, baseline.residual if not found.chosen else found.after.residual) \
        if found.verdict is Verdict.UNKNOWN else None
    final = refitted(data, found.after)
    share = looked.explained(found.chosen)
    apart = words.separating(found.alternatives) if law is None else words.next_measurement(law)
    named = found.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    return Diagnosis(
        title=recording.title, recording=str(recording.path), kind=data.kind.value, verdict=found.verdict,
        effects=found.effects, probability=_probability(looked, found, detection), ranking=found.ranking,
        sentence=words.sentence(found.verdict, sorted(found.chosen), found.stand_ins, share, location, law),
        detection=detection, location=location, parameters=estimates(data, final),
        held_out=_held_out(data, noise, baseline, found.after), separating_measurement=apart, residual_law=law,
        smallest_visible=_visible(looked) if found.verdict is Verdict.NONE else {},
        comparisons=comparisons(data, baseline, found.after),
        residual_maps=residual_maps(data, noise, baseline, found.after),
        notes=_notes(recording, data, noise, left_out, found),
        case_file=words.case_text(recording.title, final.joint) if named else "",
        after_model=after_model(found.verdict, (one.id for one in found.after.joint.effects)),
        seconds=time.monotonic() - began, fast=fast)


def detect(data: DrivenData, noise: Noise, baseline: DrivenFit) -> Detection:
    """Return whether the baseline leaves more than noise, in its size or in the harmonics that all cycles share."""
    tests = {"mean square of what is left": mean_square_p(noise, baseline.residual[data.fitted]),
             "harmonics common to all cycles": harmonic_p(noise, data, baseline.residual, HARMONICS)}
    name = min(tests, key=lambda key: tests[key])
    return Detection(p_value=min(1.0, len(tests) * tests[name]), statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def _found(looked: Search, detection: Detection, fast: bool, progress: Progress) -> _Found:
    if detection.p_value >= FALSE_ALARMS:
        return _Found(Verdict.NONE, BASELINE_SET, {}, _ranking(looked, BASELINE_SET), looked.baseline)
    chosen = search(looked, MOST_FAST if fast else MOST, progress)
    ranking = _ranking(looked, chosen)
    if not chosen or looked.explained(chosen) < EXPLAINED_GATE:
        best = next((frozenset(one.effects) for one in ranking if one.effects), BASELINE_SET)
        return _Found(Verdict.UNKNOWN, chosen, {}, ranking, looked.fits[chosen or best])
    progress(0.95, "stand-ins")
    stand_ins = dict(aliases(looked, chosen))
    verdict = Verdict.AMBIGUOUS if any(stand_ins.values()) else Verdict.NAMED
    return _Found(verdict, chosen, stand_ins, _ranking(looked, chosen), looked.fits[chosen])


def _ranking(looked: Search, chosen: Names) -> tuple[Candidate, ...]:
    """Return the sets that were fitted with their probabilities; each effect costs the choice among all of them.

    Sets that only add to the chosen one what did not earn its place are left out.
    """
    n, cost = looked.independent(), float(np.log(max(len(looked.candidates), 1)))
    sets = [names for names in looked.fits if not (chosen and names > chosen)]
    evidence = np.array([looked.log_evidence(names, n) - cost * len(names) for names in sets])
    weight = np.exp(evidence - evidence.max())
    order = np.argsort(-weight, kind="stable")
    used = int(looked.data.fitted.sum())
    return tuple(Candidate(
        effects=tuple(sorted(sets[k])), probability=float(weight[k] / weight.sum()),
        explained=looked.explained(sets[k]), log_evidence=float(evidence[k]),
        chi_squared=used * looked.square(looked.fits[sets[k]]) / looked.noise.sd**2,
        degrees_of_freedom=used - len(looked.fits[sets[k]].names),
        converged=True) for k in order[:MOST_RANKED])


def _probability(looked: Search, found: _Found, detection: Detection) -> float:
    """Return the probability of the verdict: of its sets among all, if the catalogue holds the cause at all."""
    if found.verdict is Verdict.NONE:
        p = detection.p_value
        odds = 1.0 / (-np.e * p * np.log(p)) if 0.0 < p < 1.0 / np.e else 1.0
        return float(1.0 / (1.0 + odds * FALSE_ALARMS / (1.0 - FALSE_ALARMS)))
    best = max((looked.explained(names) for names in (found.chosen, *(frozenset(one.effects) for one in found.ranking[
        :1]))), default=0.0)
    listed = float(1.0 / (1.0 + np.exp(-(best - EXPLAINED_GATE) / GATE_WIDTH)))
    if found.verdict is Verdict.UNKNOWN:
        return 1.0 - listed
    same = set(found.effects)
    alike = sum(one.probability for one in found.ranking if len(one.effects) == len(found.chosen)
                and set(one.effects) <= same)
    return listed * float(min(alike, 1.0))


def _held_out(data: DrivenData, noise: Noise, baseline: DrivenFit, after: DrivenFit) -> HeldOut:
    before, behind = (float(np.sqrt(np.mean(one.residual[data.held_out]**2))) / noise.sd for one in (baseline, after))
    return HeldOut(what=data.held_out_words, before=before, after=behind, floor=1.0)


def _visible(looked: Search) -> dict[str, float]:
    """Return the smallest size of each effect that would have been seen, over the upper end of its plausible range."""
    data, noise = looked.data, looked.noise
    base = looked.baseline
    jacobian = base.joint.derivatives(data.motion, base.names)[data.fitted]
    basis = np.linalg.qr(jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300))[0]
    scale, found = Scale.of(data.motion, data.force), {}
    for name in looked.candidates:
        joint = looked.scaled(name)
        change = (joint.predict(data.motion).measured - base.joint.predict(data.motion).measured)[data.fitted]
        seen = float(np.linalg.norm(change - basis @ (basis.T @ change))) / (noise.sd * np.sqrt(noise.correlation))
        strength = first_parameter(name)
        most = abs(scaled_priors(joint, scale)[strength].high)
        found[name] = VISIBLE / max(seen, 1e-300) * abs(joint.values[strength]) / max(most, 1e-300)
    return found


def _notes(recording: Recording, data: DrivenData, noise: Noise, left_out: tuple[str, ...], found: _Found
           ) -> tuple[str, ...]:
    notes = [*map(str, recording.notes), *data.notes, f"noise: {noise.sd:,.3g} N a sample, from {noise.source}"]
    if left_out:
        notes.append(f"the record has no time axis, so that {words.listed(left_out)} were not looked at")
    if data.kind is Kind.LUMPED:
        notes.append("the force is predicted from the measured motion, which is taken as it is")
    if found.chosen:
        left = float(np.sqrt(np.mean(found.after.residual[data.held_out]**2))) / noise.sd
        if left > CLEARLY:
            notes.append(f"with {words.listed(found.chosen)} what is left is still {left:.2g} times what cycles differ "
                         "by, so that they are not all that acts; intervals allow for it by blocks of residuals")
    return tuple(notes)
