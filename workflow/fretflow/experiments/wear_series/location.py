"""Where the worn volumes of a series and one coefficient part: ranges of the conditions, and the law behind it."""

from __future__ import annotations

import numpy as np
from scipy import stats

from fretflow.core.records import Array
from fretflow.core.units import pretty_number, pretty_quantity
from fretflow.effects.volume_law import CYCLES, UNITS
from fretflow.experiments.laws import equal_bins
from fretflow.experiments.wear_series.data import WearData, growths
from fretflow.inference.verdict import Location, Place, ResidualLaw


def locate(data: WearData, model: Array) -> Location:
    """Return the ranges of each condition in which the mean of what the baseline's `model` (n,) leaves is not zero.

    As of the tests of detection, a p-value is the larger one of two growths of scatter.
    """
    tests = data.tests
    left, excess = tests.residual(model), _excess(data, model)
    groups = [(name, x[own], own) for name, x in _conditions(data).items() for own in equal_bins(x)]
    free = max(data.pure_freedom, tests.count - data.curve.shape[1])
    places = []
    for name, x, own in groups:
        weight = tests.weight[own]
        mean, ratio = np.average(left[own], weights=weight), weight @ tests.volume[own] / (weight @ model[own])
        square = float(mean**2 * weight.sum())
        p = max(2.0 * float(stats.t.sf(abs(np.average(one[own], weights=weight)) * np.sqrt(weight.sum()) / sd, free))
                for one, sd in growths(data, model))
        places.append(Place(
            cut="condition", where=f"{within(name, float(x.min()), float(x.max()))}, with {ratio:.2g} times the "
                                   "wear that it predicts",
            share=float(np.clip((square - data.sd**2) / excess, 0.0, 1.0)), p_value=min(1.0, p * len(groups))))
    if not places:
        return Location(block="", channel="", phase="", zone="", cycles=(0, 0))
    cycles = tests.states.get(CYCLES, np.zeros(1))
    first = min(places, key=lambda one: (one.p_value, -one.share))
    return Location(block="wear law", channel="worn volume", phase="", zone="", condition=first.where,
                    cycles=(int(cycles.min()), int(cycles.max())), places=tuple(places),
                    text=f"One coefficient parts from the worn volumes most at {first.where}.")


def residual_law(data: WearData, model: Array) -> ResidualLaw | None:
    """Return wear over that of the `model` (n,) against the condition that tells most of it; bins pay for it."""
    tests, excess = data.tests, _excess(data, model)
    left, ratio = tests.residual(model), tests.volume / model - 1.0
    best: ResidualLaw | None = None
    for name, x in _conditions(data).items():
        groups = equal_bins(x)
        inside = sum(float(tests.weight[own] @ (left[own] - np.average(left[own], weights=tests.weight[own]))**2)
                     for own in groups)
        gain = tests.square(model) - inside - (len(groups) - 1) * data.sd**2
        explained = float(np.clip(gain / excess, 0.0, 1.0))
        if best is not None and explained <= best.explained:
            continue
        at, mean = (np.array([np.average(v[own], weights=tests.weight[own]) for own in groups]) for v in (x, ratio))
        sd = np.array([data.sd / tests.scale / np.sqrt(tests.weight[own].sum()) for own in groups])
        best = ResidualLaw(channel="worn volume over the law's", state=name, state_unit=UNITS.get(name, "1"),
                           channel_unit="1", x=at, y=mean, sd=sd, explained=explained)
    return best


def _excess(data: WearData, model: Array) -> float:
    """Return what a model leaves beyond scatter, m^6."""
    return max(data.tests.square(model) - data.tests.count * data.sd**2, 1e-300)


def _conditions(data: WearData) -> dict[str, Array]:
    """Return all recorded conditions that vary, known ones by their names."""
    own = {name: data.tests.states[name] for name in data.varied}
    return own | {name: x for name, x in data.series.further.items() if np.isfinite(x).all() and np.ptp(x) > 0.0}


def within(name: str, low: float, high: float) -> str:
    """Return a range of a condition for people."""
    unit = UNITS.get(name, "")
    ends = [pretty_quantity(v, unit, 3) if unit not in ("", "1") else pretty_number(v) for v in (low, high)]
    return f"{name} {ends[0]}" if ends[0] == ends[1] else f"{name} {ends[0]} to {ends[1]}"
