"""The diagnosis of a wear series by the inference engine: whether one coefficient explains the worn volumes.

The baseline is Archard's law in its energy form with the coefficient refitted. What it leaves is tested against powers
of the conditions, a smooth curve through all columns, and repeats; laws of the catalogue compete for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fretflow.core.progress import Progress
from fretflow.core.records import Array
from fretflow.effects.volume_law import VolumeLaw
from fretflow.experiments.independent import IndependentSearch, at_rest, estimates, in_turn, smallest_visible
from fretflow.experiments.tools import DiagnosisTools
from fretflow.experiments.wear_series import words
from fretflow.experiments.wear_series.data import WearData, scatter_odds, tests_of_detection, wear_data
from fretflow.experiments.wear_series.experiment import WearSeriesExperiment
from fretflow.experiments.wear_series.location import locate, residual_law
from fretflow.experiments.wear_series.scatter import volume_laws
from fretflow.experiments.words import sentence
from fretflow.inference.decision import Decision, decide, detected, shared_anew
from fretflow.inference.diagnosis import diagnosed, share_left
from fretflow.inference.experiment import Point
from fretflow.inference.least_squares import Fit, Fitter
from fretflow.inference.parameters import HALF
from fretflow.inference.posterior import largest_odds
from fretflow.inference.search import FAST, FULL, NEGLIGIBLE
from fretflow.inference.strategy import run_search
from fretflow.inference.verdict import (
    FALSE_ALARMS,
    Detection,
    Diagnosis,
    Estimate,
    HeldOut,
    Remainder,
    Verdict,
    WearTests,
)
from fretflow.inference.words import implausible, listed, number
from fretflow.recordings.kinds.wear_series import WearSeries

WearSearch = IndependentSearch[WearSeriesExperiment]


@dataclass(frozen=True, eq=False)
class Form:
    """A law that an effect may have, fitted alone, and its log evidence with a discrepancy beside it."""

    law: VolumeLaw
    search: WearSearch
    worth: float

    @property
    def names(self) -> frozenset[str]:
        """Return the effect, as a set."""
        return frozenset({self.law.effect})


def diagnose_wear_series(series: WearSeries, fast: bool, progress: Progress,
                         tools: DiagnosisTools | None = None) -> Diagnosis:
    """Return what the worn volumes of a series show that one wear coefficient leaves out.

    Raises
    ------
    RecordingError
        If the series has too few conditions.
    """
    data = wear_data(series)
    progress(0.2, "tests of one coefficient")
    detection = detect(data)
    forms = fitted_forms(data)
    search = start_search(data, {one.law.effect: one.law for one in reversed(forms)}, fast)
    run_search(search, lambda share, text: progress(0.3 + 0.5 * share, text))
    progress(0.8, "what is held out")
    decision = left_to_chance(detected(decide(search), detection), detection.p_value)
    experiment, base, fit = search.experiment, search.baseline, search.fits[decision.after]
    unseen = held_out(experiment, base, fit)
    progress(0.95, "parameters and pictures")
    unknown, none = decision.verdict is Verdict.UNKNOWN, decision.verdict is Verdict.NONE
    before, after = (experiment.volumes(one.prediction.point) for one in (base, fit))
    law = residual_law(data, before) if unknown else None
    parameters = estimates(search, frozenset() if unknown else decision.after)
    view = _view(data, before, after)
    location = locate(data, before)
    if none:
        location = replace(location, block="", channel="", condition="", text="", cycles=(0, 0), places=())
    powers = tuple(name for one in decision.after for name in experiment.forms[one].powers)
    rivals = [one for one in forms if one.names == decision.after and powers and not set(powers) <= set(one.law.powers)
              and one.worth > forms[0].worth - NEGLIGIBLE]
    remainder = Remainder(share=share_left(search, decision),
                          times_noise=float(np.sqrt(fit.chi_squared / experiment.measurement.expected)), where="")
    return diagnosed(
        series, decision, detection, sentence=sentence(decision, remainder, location, law), location=location,
        parameters=parameters, held_out=unseen, remainder=remainder,
        separating_measurement=words.next_measurement(decision.sets, data, powers, [one.law for one in rivals], law),
        residual_law=law, wear_tests=view,
        smallest_visible=smallest_visible(search) if none else {},
        warnings=tuple(words.warnings(data)),
        notes=(*words.notes(data, view), *_of_law(search, fit, powers, rivals, parameters)))


def left_to_chance(decision: Decision, p: float) -> Decision:
    """Return a verdict with as much probability of nothing as a p-value leaves at least.

    Few tests do not tell their scatter well. Each hypothesis' evidence takes the growth of scatter for known, the tests
    do not: without this the one would be sure of what the other is not.
    """
    least, none = 1.0 / (1.0 + largest_odds(p)), decision.posterior.none
    if decision.verdict is Verdict.NONE or none >= least:
        return decision
    rest = (1.0 - least) / (1.0 - none)
    return replace(shared_anew(decision, least, rest), probability=rest * decision.probability)


def detect(data: WearData) -> Detection:
    """Return whether one coefficient leaves more than scatter, by classical tests beside the posterior's answer."""
    tests = tests_of_detection(data)
    name = min(tests, key=lambda key: tests[key], default="")
    return Detection(p_value=min(1.0, len(tests) * tests[name]) if name else 1.0, statistic=name, tests=tests,
                     false_alarm_rate=FALSE_ALARMS)


def fitted_forms(data: WearData) -> tuple[Form, ...]:
    """Return the laws that effects may have of such tests, the most probable first."""
    forms = []
    for laws in volume_laws(data.tests).values():
        for law in laws:
            search = start_search(data, {law.effect: law}, True)
            own = search.experiment.parameters([law.effect])
            if not search.experiment.together([law.effect]):
                continue
            starts = [np.r_[search.baseline.z, np.full(own.size - 1, way)] for way in (-HALF, 0.0, HALF)]
            search.keep(at_rest(search.fitter, Point(own, start)) for start in starts)
            names = frozenset({law.effect})
            worth = search.evidence(names).averaged(search.any_size(names))
            forms.append(Form(law, search, worth))
    return tuple(sorted(forms, key=lambda one: -one.worth))


def start_search(data: WearData, forms: dict[str, VolumeLaw], fast: bool) -> WearSearch:
    """Return a search with the baseline fitted."""
    counts = {name: len(laws) for name, laws in volume_laws(data.tests).items()}
    search = WearSearch(WearSeriesExperiment(data, forms, counts), in_turn, FAST if fast else FULL)
    own = search.experiment.parameters(())
    search.fits[frozenset()] = at_rest(search.fitter, Point(own, np.zeros(own.size)))
    return search


def held_out(experiment: WearSeriesExperiment, *fits: Fit) -> HeldOut:
    """Return the errors of tests that were not fitted, over the scatter; rows of one condition go together."""
    own, data = experiment.measurement, experiment.data
    folds, sizes = np.unique(data.condition, return_inverse=True)[1], []
    for fit in fits:
        square = 0.0
        for k in np.unique(folds):
            out = folds == k
            fitter = Fitter(experiment, own.covariance().hiding(out))
            rest = own.values - at_rest(fitter, fit.prediction.point).predicted
            square += float(np.sum((rest**2 / own.variance)[out]))
        sizes.append(float(np.sqrt(square / own.expected)))
    return HeldOut(what=f"each of the {int(folds.max()) + 1} conditions in turn, repeats and rows that stand twice "
                        "together", before=sizes[0], after=sizes[-1], floor=1.0)


def _of_law(search: WearSearch, fit: Fit, powers: tuple[str, ...], rivals: Sequence[Form],
            made: Sequence[Estimate]) -> list[str]:
    """Return what limits a named law: rivals, exponents out of range, another growth of the scatter."""
    notes = [f"powers of {listed(one.law.powers)} instead of {listed(powers)} explain "
             f"{100.0 * one.search.explained(one.names):.0f} %, and are not ruled out" for one in rivals]
    notes += implausible(made)
    known = {one.name: one for one in made if one.name.endswith("_exponent")}
    for power, told in ((0.0, "in proportion to the volume"), (1.0, "not at all with the volume")) if known else ():
        share, other = other_scatter(search, fit, power)
        values = {one.name: one.value(float(z)) for one, z in zip(other.parameters.coordinates, other.z, strict=True)}
        if share < 0.5 or any(not one.low <= values[name] <= one.high for name, one in known.items()):
            exponents = ", ".join(f"{name.rpartition('.')[2].replace('_', ' ')} {values[name]:.2f}" for name in known)
            odds = scatter_odds(search.experiment.data, powers, power)
            notes.append(f"if scatter grew {told}, of which these tests make the law {number(odds, 1.0)} times less "
                         f"probable, it would remove {100.0 * share:.0f} % of all squares, with the {exponents}")
    return notes


def other_scatter(search: WearSearch, fit: Fit, power: float) -> tuple[float, Fit]:
    """Return the share of all squares that a law removes, and its fit, if scatter grew with another `power`."""
    experiment = search.experiment
    other = replace(experiment, data=replace(experiment.data, tests=replace(experiment.data.tests, power=power)))
    before, after = (at_rest(Fitter(other, other.measurement.covariance()), one.prediction.point)
                     for one in (search.baseline, fit))
    return 1.0 - after.chi_squared / before.chi_squared, after


def _view(data: WearData, before: Array, after: Array) -> WearTests:
    tests = data.tests
    return WearTests(rows=data.series.rows, measured=tests.volume, before=before, after=after,
                     r2_before=_r2(data, before), r2_after=_r2(data, after))


def _r2(data: WearData, model: Array) -> float:
    """Return the share of the worn volumes' variance that a law explains; a test that stands twice counts once."""
    volume, weight = data.tests.volume, data.tests.weight
    mean = np.average(volume, weights=weight)
    return float(1.0 - weight @ (volume - model)**2 / (weight @ (volume - mean)**2))
