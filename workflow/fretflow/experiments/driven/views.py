"""What the report draws of a driven joint: its cycles measured and predicted, and where they differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.effects.effect import Kind
from fretflow.experiments.driven.data import Array, Cycle, DrivenData
from fretflow.experiments.driven.fit import DrivenFit
from fretflow.experiments.driven.noise import Noise
from fretflow.inference.verdict import Comparison, ResidualMap

MOST_SHOWN, MOST_ROWS = 8, 40
PHASES = 200


def comparisons(data: DrivenData, before: DrivenFit, after: DrivenFit) -> tuple[Comparison, ...]:
    """Return up to eight cycles, or the two halves of a record without cycles."""
    if data.kind is Kind.LUMPED:
        groups = [(one.label, one.held_out, data.samples_of(one)) for one in _some(data.cycles, MOST_SHOWN)]
        groups = groups or [(name, out, np.flatnonzero(mask)) for name, out, mask in (
            ("fitted", False, data.fitted), ("held out", True, data.held_out))]
        return tuple(_comparison(data, before, after, *one) for one in groups)
    shown = [_comparison(data, before, after, one.label, one.held_out, data.samples_of(one))
             for one in _some(data.cycles, MOST_SHOWN)]
    return tuple(shown)


def _some(cycles: tuple[Cycle, ...], most: int) -> list[Cycle]:
    """Return some cycles, evenly spread, those held out among them."""
    if len(cycles) <= most:
        return list(cycles)
    kept = [cycles[k] for k in np.unique(np.linspace(0, len(cycles) - 1, most).round().astype(int))]
    if not any(one.held_out for one in kept):
        kept[-1] = next(one for one in cycles if one.held_out)
    return kept


def _comparison(data: DrivenData, before: DrivenFit, after: DrivenFit, label: str, held_out: bool,
                own: NDArray[np.int64]) -> Comparison:
    x, force = data.motion.displacement[own], data.force[own]
    return Comparison(
        label=label, held_out=held_out, displacement=x, force=force, before_displacement=x, after_displacement=x,
        before_force=force - before.residual[own], after_force=force - after.residual[own],
        time=data.motion.time[own] if data.kind is Kind.LUMPED and data.timed else None)


def residual_maps(data: DrivenData, noise: Noise, before: DrivenFit, after: DrivenFit) -> tuple[ResidualMap, ...]:
    """Return the differences over the noise by cycle and phase; none for a record without cycles."""
    if not data.cycles:
        return ()
    rows = _some(data.cycles, MOST_ROWS)
    at = (np.arange(PHASES) + 0.5) / PHASES

    def table(found: DrivenFit) -> Array:
        return np.array([np.interp(at, data.phases_of(one), found.residual[data.samples_of(one)]) for one in rows]
                        ) / noise.sd

    return (ResidualMap(channel="force", rows=tuple(one.label for one in rows), phase=at, before=table(before),
                        after=table(after)),)
