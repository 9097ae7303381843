"""The report's measured and predicted loops: each large with its differences, and all of them small, to choose from.

So are backbones, responses and worn profiles: measured points, and the curves of both predictions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import Comparison, Diagnosis, MeasuredCurve
from fretflow.inference.words import number
from markupsafe import Markup
from numpy.typing import NDArray

from fretflow_post.diagnosed import readings
from fretflow_post.report.svg import Axis, Chart, extent, horizontal, thinned, vertical

Array = NDArray[np.float64]

ALIKE = 4.0  # largest over smallest extent of loops that are drawn on one scale
SAME = 1e-9  # of the largest value: a channel that is predicted this well was given, not predicted
READABLE = 0.1  # of a channel's unit: what is smaller is told in a unit of its own
LOW = 230.0  # pixels, height of the differences
SMALL_WIDTH, SMALL_HEIGHT = 120.0, 84.0
RADIUS = 3.0  # pixels of a measured point of a curve
FIXED_UNITS = {"1": ("%", 0.01), "Hz": ("Hz", 1.0), "m*kg^0.5": ("m·√kg", 1.0)}  # which need no other size or have none

Limits = tuple[float, float]


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
    found, charts = diagnosis.evolution, []
    if found is None:
        return ()
    for name, unit, values in readings(found):
        shown = list(zip(("measured", "before", "after"), values, strict=True))[:3 if after else 2]
        chart = Chart(horizontal("cycles", *extent([found.cycles], 0.02)), vertical(
            f"{name} ({unit})", *extent([own for _, own in shown]), unit, LOW), f"{name} over the cycles", height=LOW,
            readout="trace")
        for look, own in shown:
            chart.curve(look, look, found.cycles, own)
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
    raws = (one.raw_displacement, one.raw_force)
    for name, (unit, size), si, values, raw in zip(names, sizes, ("m", "N"), given, raws, strict=True):
        measured, before, after = (np.asarray(v, dtype=float)[kept] / size for v in values)
        yield Channel(name, pretty_unit(unit), size, si, measured, before, after,
                      np.zeros(0) if raw is None else raw / size)


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
    x_axis, x = _along(one)
    predicted = [channel for channel in reversed(pair) if channel.predicted]
    if not closed:
        charts += [(f"{channel.name} over time", _trace_chart(channel, x_axis, x, after)) for channel in predicted]
    charts += [(f"difference in {channel.name}", _difference_chart(channel, x_axis, x, after)) for channel in predicted]
    return LoopView(one.label, one.held_out, tuple(charts), _small(pair, limits, after, closed),
                    _misfit(predicted, after))


def _along(one: Comparison) -> tuple[Axis, Array]:
    """Return the axis along a period or a stretch of time, and where the samples lie on it."""
    count = len(one.displacement)
    kept = thinned(one.displacement, one.force)
    if one.time is None:
        return horizontal("share of the period", 0.0, 1.0), kept / count
    time = np.asarray(one.time)[kept]
    unit, size = readable_unit(float(np.nanmax(np.abs(time), initial=0.0)), "s")
    return horizontal(f"time ({pretty_unit(unit)})", *extent([time / size], 0.0), pretty_unit(unit)), time / size


def _loop_chart(one: Comparison, pair: tuple[Channel, ...], limits: Sequence[Limits], after: bool) -> Markup:
    (x, y), closed = pair, one.time is None
    chart = Chart(horizontal(x.label, *limits[0], x.unit), vertical(y.label, *limits[1], y.unit),
                  f"{one.label}: {y.name} over {x.name}, measured and predicted", readout="curves")
    if x.raw.size and y.raw.size:
        chart.trace("raw", np.append(x.raw, x.raw[0]), np.append(y.raw, y.raw[0]))
    for name, look, u, v in _named(pair, after):
        chart.curve(name, look, *((np.append(w, w[0]) if closed else w) for w in (u, v)))
    return chart.markup()


def _named(pair: tuple[Channel, ...], after: bool) -> Iterator[tuple[str, str, Array, Array]]:
    x, y = pair
    yield "measured", "measured", x.measured, y.measured
    yield "before", "before", x.before, y.before
    if after:
        yield "after", "after", x.after, y.after


def _trace_chart(channel: Channel, x_axis: Axis, x: Array, after: bool) -> Markup:
    chart = Chart(x_axis, vertical(channel.label, *extent(_curves(channel, after)), channel.unit),
                  f"{channel.name} over time, measured and predicted", readout="trace")
    for name, values in zip(("measured", "before", "after"), _curves(channel, after), strict=False):
        chart.curve(name, name, x, values)
    return chart.markup()


def _difference_chart(channel: Channel, x_axis: Axis, x: Array, after: bool) -> Markup:
    gaps = [(channel.measured - predicted) * channel.size for predicted in _curves(channel, after)[1:]]
    plain, size = readable_unit(_largest(gaps), channel.si)
    gaps, unit = [gap / size for gap in gaps], pretty_unit(plain)
    label = f"measured − predicted ({unit})"
    chart = Chart(x_axis, vertical(label, *extent(gaps, around_zero=True), unit, LOW),
                  f"{channel.name}, {label}, over the {x_axis.label}", height=LOW, readout="trace")
    chart.level("zero", 0.0)
    for name, values in zip(("before", "after"), gaps, strict=False):
        chart.curve(name, f"{name} difference", x, values)
    return chart.markup()


def _small(pair: tuple[Channel, ...], limits: Sequence[Limits], after: bool, closed: bool) -> Markup:
    """Return a loop without axes, to choose it by; over time where one of its channels was not measured."""
    chart = Chart(Axis("", *limits[0], 4.0, SMALL_WIDTH - 4.0), Axis("", *limits[1], SMALL_HEIGHT - 4.0, 4.0), "",
                  SMALL_WIDTH, SMALL_HEIGHT)
    every = max(1, len(pair[0].measured) // 100)
    for name, look, u, v in _named(pair, after):
        u, v = u[::every], v[::every]
        chart.curve(name, look, *((np.append(w, w[0]) if closed else w) for w in (u, v)))
    return Markup('<svg viewBox="0 0 {:.0f} {:.0f}" aria-hidden="true">{}</svg>').format(
        SMALL_WIDTH, SMALL_HEIGHT, Markup().join(chart.parts))


def _misfit(predicted: Sequence[Channel], after: bool) -> str:
    texts = []
    for channel in predicted:
        sizes = [_rms(channel.measured - values) for values in _curves(channel, after)[1:]]
        when = (" before", " after") if after else ("",)
        parts = [f"{_quantity(size, channel)}{word}" for size, word in zip(sizes, when, strict=True)]
        texts.append(f"{channel.name} {', '.join(parts)}")
    return f"Root-mean-square difference: {'; '.join(texts)}." if texts else ""


def _quantity(value: float, channel: Channel) -> str:
    if not value < READABLE:
        return f"{number(value)} {channel.unit}"
    unit, size = readable_unit(value * channel.size, channel.si)
    return f"{number(value * channel.size / size)} {pretty_unit(unit)}"


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
    (x_unit, x_size), (y_unit, y_size) = (FIXED_UNITS.get(unit) or _readable(values, unit) for values, unit in (
        (one.x, one.x_unit), (one.measured, one.y_unit)))
    reach = extent([values / y_size for values in (one.measured, *shown.values())])
    chart = Chart(horizontal(f"{one.x_label} ({x_unit})", *extent([one.x / x_size]), x_unit),
                  vertical(f"{one.y_label} ({y_unit})", *reach, y_unit),
                  f"{one.y_label} over {one.x_label}, measured and predicted")
    for name, values in shown.items():
        chart.curve(name, name, one.x / x_size, values / y_size)
    for x, y in zip(one.x / x_size, one.measured / y_size, strict=True):
        chart.parts.append(Markup(
            '<circle class="at measured" cx="{:.1f}" cy="{:.1f}" r="{}"><title>{} {}, measured {} {}</title></circle>'
        ).format(float(chart.x.pixels(x)), float(chart.y.pixels(y)), RADIUS, number(float(x)), x_unit, number(float(y)),
                 y_unit))
    return chart.markup()


def _readable(values: Array, unit: str) -> tuple[str, float]:
    found, size = readable_unit(float(np.median(np.abs(values))), unit)
    return pretty_unit(found), size
