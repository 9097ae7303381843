"""What is drawn and said of a driven joint: its cycles, where they differ, what to measure next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fretflow.core.records import Array
from fretflow.experiments.driven.data import LEAST_OF_CYCLE, DrivenData
from fretflow.experiments.driven.noise import Noise
from fretflow.experiments.loops import MOST_SHOWN, evolution
from fretflow.inference.parameters import HALF
from fretflow.inference.verdict import Comparison, Estimate, Evolution, ResidualLaw, ResidualMap
from fretflow.inference.words import interval
from fretflow.recordings.kinds.joints import LUMPED


def comparisons(data: DrivenData, before: Array, after: Array) -> tuple[Comparison, ...]:
    """Return up to eight cycles and all that are held out, or the two halves of a record without cycles.

    Parameters
    ----------
    data
        The record.
    before, after
        Predicted forces (N,) without and with the effects.
    """
    spread = set(np.linspace(0, len(data.cycles) - 1, min(MOST_SHOWN, len(data.cycles))).round().astype(int))
    kept = [one for k, one in enumerate(data.cycles) if k in spread or one.held_out]
    groups = [(one.label, one.held_out, data.samples_of(one), slice(one.start, one.stop)) for one in kept]
    if not groups and data.kind is LUMPED:
        groups = [(name, out, np.flatnonzero(mask), slice(0)) for name, out, mask in (
            ("fitted", False, data.fitted), ("held out", True, data.held_out))]
    shown = []
    for label, held_out, own, whole in groups:
        x = data.motion.displacement[own]
        thin = data.every > 1 and whole.stop > 0
        shown.append(Comparison(
            label=label, held_out=held_out, displacement=x, force=data.force[own], before_displacement=x,
            after_displacement=x, before_force=before[own], after_force=after[own],
            time=data.motion.time[own] if data.kind is LUMPED and data.timed else None,
            raw_displacement=data.unsmoothed[whole] if thin else None,
            raw_force=data.whole_force[whole] if thin else None))
    return tuple(shown)


def evolved(data: DrivenData, before: Array, after: Array) -> Evolution | None:
    """Return what is read off all cycles, predicted forces (N,) beside; None of a lumped force, which holds inertia."""
    if data.kind is LUMPED:
        return None
    own = {one.number: data.samples_of(one) for one in data.cycles}
    return evolution(list(own), [tuple((data.motion.displacement[at], force[at]) for force in (
        data.force, before, after)) for at in own.values()])


def two_stiffnesses(readings: Evolution | None, made: Iterable[Estimate]) -> list[str]:
    """Return why the stiffness that is read off loops is not the fitted one, where its interval leaves that out."""
    fitted = next((one for one in made if one.name == "baseline.tangential_stiffness"), None)
    if readings is None or fitted is None or np.isnan(readings.tangential_stiffness[0]).all():
        return []
    every = readings.tangential_stiffness[0][np.isfinite(readings.tangential_stiffness[0])]
    read, scatter = float(np.median(every)), float(HALF * np.std(every)) / np.sqrt(len(every))
    if fitted.low - scatter <= read <= fitted.high + scatter:
        return []
    shown = interval(replace(fitted, value=read, low=fitted.low - fitted.value + read,
                             high=fitted.high - fitted.value + read))
    return [f"loops show a tangential stiffness of {shown.value} {shown.unit} right after their reversals, which "
            "`fretflow loops` reads; the fitted one is of a single spring over all that it takes until sliding, play "
            "and rounded corners included"]


def residual_maps(data: DrivenData, noise: Noise, before: Array, after: Array) -> tuple[ResidualMap, ...]:
    """Return the differences over the noise by cycle and phase; none for a record without cycles."""
    if not data.cycles:
        return ()
    at = (np.arange(LEAST_OF_CYCLE) + 0.5) / LEAST_OF_CYCLE

    def table(predicted: Array) -> Array:
        left = (data.force - predicted) / noise.sd
        return np.array([np.interp(at, data.phases_of(one), left[data.samples_of(one)]) for one in data.cycles])

    return (ResidualMap(channel="force", rows=tuple(one.label for one in data.cycles), phase=at, before=table(before),
                        after=table(after)),)


def next_measurement(law: ResidualLaw) -> str:
    """Return what to measure where nothing of the catalogue fits."""
    return (f"Records at other amplitudes and frequencies, to see whether what is left still follows the {law.state}, "
            "and at another normal load, to see whether it belongs to the friction.")
