"""What worn profiles of a line contact tell: how far one wear coefficient explains each, and where it does not."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import trapezoid
from scipy.stats import chi2

from fretflow.core.errors import NonConvergenceError
from fretflow.experiments.structure.profiles import ProfileExperiment
from fretflow.inference.decision import Decision
from fretflow.inference.least_squares import Fitter
from fretflow.inference.search import Names, Search
from fretflow.inference.verdict import HeldOut, Location, MeasuredCurve, Place, Remainder, Verdict
from fretflow.inference.words import blocks_of, listed, not_enough, percent

REGIONS = ("borders of the scar", "middle of the scar")
NEXT = "profiles of each body, of shorter tests, and at other frequencies and loads"


def told(experiment: ProfileExperiment, search: Search, decision: Decision, left: Remainder) -> dict[str, Any]:
    """Return the fields of a diagnosis that are of worn profiles alone."""
    location = _locate(search, decision)
    return {"location": location, "sentence": _sentence(decision, search, left, location.text),
            "curves": _curves(experiment, search, decision.after),
            "notes": tuple(_areas(experiment, search, decision.after))}


def _sentence(decision: Decision, search: Search, left: Remainder, where: str) -> str:
    share = percent(search.explained(decision.after))
    if decision.verdict is Verdict.NONE:
        return "One wear coefficient explains the worn profiles."
    if decision.verdict is Verdict.UNKNOWN:
        near = (f": {listed(decision.after)} would explain {share} of the difference, "
                f"{not_enough(decision.against, left.times_noise)}") if decision.after else ""
        return (f"One wear coefficient does not explain the profiles, and no effect of the catalogue does so well "
                f"enough{near}. {where}")
    names = " or ".join(" with ".join(sorted(one)) for one in decision.sets)
    return f"What is missing is {names}: {share} of the difference. {where}"


def held_out(experiment: ProfileExperiment, search: Search, names: Names) -> HeldOut | None:
    """Return how well each profile or volume is predicted by laws fitted to the others, before and after."""
    own, sizes = experiment.measurement, []
    if len(own.groups) < 2:
        return None
    for one in (frozenset[str](), names):
        square = 0.0
        for k in range(len(own.groups)):
            out = own.group == k
            try:
                fit = Fitter(experiment, own.covariance().hiding(out)).fit(search.fits[one].prediction.point, None, 6)
            except NonConvergenceError:
                return None
            square += float(np.sum(((own.values - fit.predicted)**2 / own.variance)[out]))
        sizes.append(float(np.sqrt(square / len(own.values))))
    return HeldOut(what="each profile from the others", before=sizes[0], after=sizes[1], floor=1.0)


def _locate(search: Search, decision: Decision) -> Location:
    if decision.verdict is Verdict.NONE:
        return Location(block="", channel="", phase="", cycles=(0, 0), zone="")
    own = search.experiment.measurement
    square = np.square(own.values - search.baseline.predicted) / own.variance
    middle = (np.abs(own.phase - 0.25) < 0.1).astype(np.int64)
    places = [Place(cut=cut, where=label, share=float(square[index == k].sum() / max(square.sum(), 1e-300)),
                    p_value=float(chi2.sf(square[index == k].sum(), int((index == k).sum()))))
              for cut, labels, index in (("condition", own.groups, own.group), ("zone", REGIONS, middle))
              for k, label in enumerate(labels) if (index == k).any()]
    group, zone = (max((one for one in places if one.cut == cut), key=lambda one: one.share) for cut in (
        "condition", "zone"))
    block = blocks_of(frozenset().union(*decision.sets)) if decision.sets else "wear"
    text = (f"They part most in {group.where} ({100.0 * group.share:.0f} %) and in the {zone.where} "
            f"({100.0 * zone.share:.0f} %).")
    return Location(block=block, channel=own.channels[0], phase="", cycles=(0, 0), zone=zone.where,
                    places=tuple(places), condition=group.where, text=text)


def _curves(experiment: ProfileExperiment, search: Search, names: Names) -> tuple[MeasuredCurve, ...]:
    own = experiment.measurement
    return tuple(MeasuredCurve(
        label=one.name, x_label="place across the scar", x_unit="m", y_label="worn depth of both bodies", y_unit="m",
        x=one.x, measured=one.depth, before=search.baseline.predicted[own.group == k],
        after=search.fits[names].predicted[own.group == k]) for k, one in enumerate(experiment.recording.profiles))


def _areas(experiment: ProfileExperiment, search: Search, names: Names) -> list[str]:
    """Return in words the area of each profile, measured, before and after."""
    told = []
    for one in _curves(experiment, search, names):
        sizes = ", ".join(f"{1e6 * float(trapezoid(y, one.x)):.3f}" for y in (one.measured, one.before, one.after))
        told.append(f"{one.label}: worn area {sizes} mm² measured, by one coefficient and with the effects")
    return told
