"""The report's measured and predicted loops: each large with its differences, and all of them small, to choose from.

So are backbones, responses and worn profiles: measured points, and the curves of both predictions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import Comparison, Diagnosis, MeasuredCurve
from fretflow.inference.words import number
from markupsafe import Markup

from fretflow_post.diagnosed import SAME, curve_units, readings
from fretflow_post.report.charts import LOW, Chart, Limits, extent, thinned

ALIKE = 4.0  # largest over smallest extent of loops that are drawn on one scale
READABLE = 0.1  # of a channel's unit: what is smaller is told in a unit of its own
MOST_SAMPLES = 4000  # of a loop as it was measured: as fine as any screen
SMALL = 112.0, 76.0  # pixels of a loop to choose by, within 4 around it


@dataclass(frozen=True)
class Channel:
    """A channel of one loop in the unit that it is read in; (N,)."""

    name: str
    unit: str
    size: float  # of that unit in SI
    si: str
    measured: Array
    before: Array
    after: Array
    raw: Array  # (n,), every sample where it differs from what is compared, else none

    @property
    def predicted(self) -> bool:
        """Return whether the model predicts the channel, rather than taking it as given."""
        limit = SAME * np.nanmax(np.abs(self.measured), initial=0.0)
        return any(bool(np.any(np.abs(p - self.measured) > limit)) for p in (self.before, self.after))

    @property
    def label(self) -> str:
        """Return the text of the channel's axis."""
        return f"{self.name} ({self.unit})"


@dataclass(frozen=True)
class LoopView:
    """One loop as the page shows it."""

    label: str
    held_out: bool
    charts: tuple[tuple[str, Markup], ...]  # each with its title
    small: Markup
    misfit: str


@dataclass(frozen=True)
class LoopViews:
    """All loops; whether they share one scale, have a prediction after, and have samples beside what is compared."""

    views: tuple[LoopView, ...]
    word: str  # what they are: loops, or stretches of a long record
    one_scale: bool
    with_after: bool
    raw: bool  # measured samples stand beside the harmonics that are compared

    @property
    def words(self) -> str:
        """Return the word of several."""
        return {"loop": "loops", "stretch": "stretches"}[self.word]


def loop_views(diagnosis: Diagnosis) -> LoopViews:
    """Return the loops of `diagnosis` as charts."""
    loops = diagnosis.comparisons
    after = has_after(loops)
    sizes = [readable_unit(_largest(values), unit) for values, unit in (
        ([one.displacement for one in loops], "m"), ([one.force for one in loops], "N"))]
    names = ("displacement", "force") if diagnosis.kind == "lumped" else ("relative displacement", "friction force")
    channels = [tuple(_channels(one, names, sizes)) for one in loops]
    shared = [_one_scale([pair[k] for pair in channels], after) for k in (0, 1)]
    common = None not in shared
    views = tuple(_view(one, pair, after, tuple(shared) if common else None)
                  for one, pair in zip(loops, channels, strict=True))
    return LoopViews(views, "stretch" if any(one.time is not None for one in loops) else "loop", common, after,
                     any(one.raw_force is not None for one in loops))


def evolution_views(diagnosis: Diagnosis, after: bool) -> tuple[tuple[str, Markup], ...]:
    """Return what is read off the loops over the cycles as charts, each with its title."""
    evolution, charts = diagnosis.evolution, []
    if evolution is None:
        return ()
    for name, unit, values in readings(evolution):
        shown = list(zip(("measured", "before", "after"), values, strict=True))[:3 if after else 2]
        chart = Chart(f"{name} over the cycles", "cycles", f"{name} ({unit})", height=LOW)
        for look, own in shown:
            chart.curve(look, look, evolution.cycles, own)
        chart.read(along=True)
        charts.append((name, chart.markup()))
    return tuple(charts)


def has_after(loops: Sequence[Comparison]) -> bool:
    """Return whether any loop has a prediction after that differs from the one before."""
    return any(np.isfinite(new).any() and not np.array_equal(new, old, equal_nan=True)
               for one in loops for new, old in ((one.after_force, one.before_force),
                                                 (one.after_displacement, one.before_displacement)))


def _channels(one: Comparison, names: Sequence[str], sizes: Sequence[tuple[str, float]]) -> Iterator[Channel]:
    kept = thinned(one.displacement, one.force)
    given = ((one.displacement, one.before_displacement, one.after_displacement),
             (one.force, one.before_force, one.after_force))
    raws: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    if one.raw_displacement is not None and one.raw_force is not None:
        seen = thinned(one.raw_displacement, one.raw_force, most=MOST_SAMPLES)
        raws = one.raw_displacement[seen], one.raw_force[seen]
    for name, (unit, size), si, values, raw in zip(names, sizes, ("m", "N"), given, raws, strict=True):
        measured, before, after = (np.asarray(v, dtype=float)[kept] / size for v in values)
        yield Channel(name, pretty_unit(unit), size, si, measured, before, after, raw / size)


def _one_scale(channels: Sequence[Channel], after: bool) -> Limits | None:
    """Return the limits that hold all loops, or None if they are too unlike to be drawn on one scale."""
    reaches = [np.ptp(c.measured[np.isfinite(c.measured)]) for c in channels if np.isfinite(c.measured).any()]
    if reaches and max(reaches) > ALIKE * min(reaches):
        return None
    return extent([v for c in channels for v in (*_curves(c, after), c.raw)])


def _curves(channel: Channel, after: bool) -> tuple[Array, ...]:
    return (channel.measured, channel.before, channel.after) if after else (channel.measured, channel.before)


def _view(one: Comparison, pair: tuple[Channel, ...], after: bool,
          shared: tuple[Limits | None, ...] | None) -> LoopView:
    limits = [(None if shared is None else shared[k]) or extent((*_curves(own, after), own.raw))
              for k, own in enumerate(pair)]
    closed = one.time is None
    charts = []
    if all(np.isfinite(channel.measured).any() for channel in pair):
        charts.append((f"{pair[1].name} over {pair[0].name}", _loop_chart(one, pair, limits, after)))
    label, x = _along(one)
    predicted = [channel for channel in reversed(pair) if channel.predicted]
    if not closed:
        charts += [(f"{channel.name} over time", _trace_chart(channel, label, x, after)) for channel in predicted]
    charts += [(f"difference in {channel.name}", _difference_chart(channel, label, x, after)) for channel in predicted]
    return LoopView(one.label, one.held_out, tuple(charts), _small(pair, limits, after, closed),
                    _misfit(predicted, after))


def _along(one: Comparison) -> tuple[str, Array]:
    """Return the label of the axis along a period or a stretch of time, and where the samples lie on it."""
    count = len(one.displacement)
    kept = thinned(one.displacement, one.force)
    if one.time is None:
        return "share of the period", kept / count
    time = np.asarray(one.time)[kept]
    unit, size = readable_unit(float(np.nanmax(np.abs(time), initial=0.0)), "s")
    return f"time ({pretty_unit(unit)})", time / size


def _loop_chart(one: Comparison, pair: tuple[Channel, ...], limits: Sequence[Limits], after: bool) -> Markup:
    (x, y), closed = pair, one.time is None
    chart = Chart(f"{one.label}: {y.name} over {x.name}, measured and predicted", x.label, y.label, x=limits[0],
                  y=limits[1])
    if x.raw.size and y.raw.size:
        chart.curve("every sample", "measured", np.append(x.raw, x.raw[0]), np.append(y.raw, y.raw[0]), line_width=1.0,
                    line_alpha=1.0)
    for name, u, v in _named(pair, after):
        chart.curve(name, name, *((np.append(w, w[0]) if closed else w) for w in (u, v)))
    chart.read()
    return chart.markup()


def _named(pair: tuple[Channel, ...], after: bool) -> Iterator[tuple[str, Array, Array]]:
    x, y = pair
    yield "measured", x.measured, y.measured
    yield "before", x.before, y.before
    if after:
        yield "after", x.after, y.after


def _trace_chart(channel: Channel, label: str, x: Array, after: bool) -> Markup:
    chart = Chart(f"{channel.name} over time, measured and predicted", label, channel.label)
    for name, values in zip(("measured", "before", "after"), _curves(channel, after), strict=False):
        chart.curve(name, name, x, values)
    chart.read(along=True)
    return chart.markup()


def _difference_chart(channel: Channel, x_label: str, x: Array, after: bool) -> Markup:
    gaps = [(channel.measured - predicted) * channel.size for predicted in _curves(channel, after)[1:]]
    plain, size = readable_unit(_largest(gaps), channel.si)
    label = f"measured − predicted ({pretty_unit(plain)})"
    chart = Chart(f"{channel.name}, {label}, over the {x_label}", x_label, label, height=LOW)
    chart.level(0.0)
    for name, gap in zip(("before", "after"), gaps, strict=False):
        chart.curve(name, name, x, gap / size, line_dash="solid")
    chart.read(along=True)
    return chart.markup()


def _small(pair: tuple[Channel, ...], limits: Sequence[Limits], after: bool, closed: bool) -> Markup:
    """Return a loop without axes, to choose it by; over time where one of its channels was not measured."""
    every, paths = max(1, len(pair[0].measured) // 100), Markup()
    for name, *curve in _named(pair, after):
        u, v = (((np.append(w[::every], w[0]) if closed else w[::every]) - low) / (high - low)
                for w, (low, high) in zip(curve, limits, strict=True))
        known = np.isfinite(u) & np.isfinite(v)
        points = np.column_stack([SMALL[0] * u[known], SMALL[1] * (1.0 - v[known])]).round(1).ravel().tolist()
        paths += Markup('<polyline class="curve {}" points="{}"/>').format(name, " ".join(map(str, points)))
    return Markup('<svg viewBox="-4 -4 120 84" aria-hidden="true">{}</svg>').format(paths)


def _misfit(predicted: Sequence[Channel], after: bool) -> str:
    texts = []
    for channel in predicted:
        sizes = [_rms(channel.measured - values) for values in _curves(channel, after)[1:]]
        when = (" before", " after") if after else ("",)
        largest, unit, size = max(sizes), channel.unit, 1.0
        if largest < READABLE:
            name, scale = readable_unit(largest * channel.size, channel.si)
            unit, size = pretty_unit(name), scale / channel.size
        parts = [f"{number(value / size)} {unit}{word}" for value, word in zip(sizes, when, strict=True)]
        texts.append(f"{channel.name} {', '.join(parts)}")
    return f"Root-mean-square difference: {'; '.join(texts)}." if texts else ""


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _largest(arrays: Sequence[Array]) -> float:
    return max((float(np.nanmax(np.abs(a), initial=0.0)) for a in arrays if np.isfinite(a).any()), default=0.0)


def curve_views(curves: tuple[MeasuredCurve, ...], with_after: bool) -> tuple[tuple[str, Markup], ...]:
    """Return the title and the chart of each curve."""
    return tuple((one.label, _curve_chart(one, with_after)) for one in curves)


def _curve_chart(one: MeasuredCurve, with_after: bool) -> Markup:
    shown = {"before": one.before} | ({"after": one.after} if with_after else {})
    (x_unit, x_size), (y_unit, y_size) = curve_units(one)
    chart = Chart(f"{one.y_label} over {one.x_label}, measured and predicted", f"{one.x_label} ({x_unit})",
                  f"{one.y_label} ({y_unit})")
    x, measured = one.x / x_size, one.measured / y_size
    for name, values in shown.items():
        chart.curve(name, name, x, values / y_size)
    chart.points("measured", "measured", x, measured, [
        f"{number(float(u))} {x_unit}, measured {number(float(v))} {y_unit}" for u, v in zip(x, measured, strict=True)])
    return chart.markup()
