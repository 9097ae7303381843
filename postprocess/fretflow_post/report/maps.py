"""The report's maps of differences over loop and phase, and the law read off the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import DRIVEN, Prior, declared_priors
from fretflow.inference.verdict import Comparison, Diagnosis, Estimate, ResidualLaw, ResidualMap, WearTests
from fretflow.inference.words import channel_words, number, of_any_size
from markupsafe import Markup

from fretflow_post import style
from fretflow_post.diagnosed import law_curve, residuals
from fretflow_post.report.charts import MARGINS, Chart, Limits, extent
from fretflow_post.report.loops import has_after

LONGEST_NAME = 22  # letters of a row's name
MOST_COLUMNS = 400  # of a map


@dataclass(frozen=True)
class MapView:
    """The differences of one channel."""

    channel: str
    before: Markup
    after: Markup | None


@dataclass(frozen=True)
class MapViews:
    """All channels on one scale of colours."""

    views: tuple[MapView, ...]
    limit: str
    root: bool  # whether colours follow the square root
    with_strip: bool


def map_views(diagnosis: Diagnosis) -> MapViews | None:
    """Return the differences of `diagnosis` as maps, or None where there are none."""
    maps, limit, exponent = residuals(diagnosis)
    if not maps:
        return None
    after = has_after(diagnosis.comparisons) or any(
        np.isfinite(one.after).any() and not np.array_equal(one.after, one.before, equal_nan=True) for one in maps)
    loop = next((one for one in diagnosis.comparisons if one.time is None), None)
    views, strips = [], []
    for one in maps:
        strip = loop if loop is not None and len(loop.displacement) == one.before.shape[1] else None
        strips.append(strip is not None)
        views.append(MapView(channel_words(one.channel), _map(one, one.before, "before", limit, exponent, strip),
                             _map(one, one.after, "after", limit, exponent, strip) if after else None))
    return MapViews(tuple(views), f"{limit:g}", exponent < 1.0, all(strips))


def _map(one: ResidualMap, values: Array, when: str, limit: float, exponent: float, loop: Comparison | None
         ) -> Markup:
    columns = np.unique(np.linspace(0, values.shape[1] - 1, min(MOST_COLUMNS, values.shape[1])).astype(int))
    values, rows = values[:, columns], len(values)
    strip = 0.0 if loop is None else max(2.0, 0.2 * rows)  # rows, height of the loop above the map
    row = int(np.clip(240.0 / rows, 3.0, 22.0))
    chart = Chart(f"{channel_words(one.channel)} {when}: difference over its standard deviation, by loop and phase",
                  "share of the period", "", (0.0, 1.0), (0.0, rows + strip), round((rows + strip) * row) + MARGINS)
    chart.image(values, (0.0, 1.0, 0.0, rows), style.palette(style.SHAPE_MAP, exponent), (-limit, limit),
                "(measured − predicted) / standard deviation", one.rows)
    marks = {rows - k - 0.5: name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME - 1]}…"
             for k, name in list(enumerate(one.rows))[::-(-12 // row)]}
    if loop is not None:
        marks |= _draw_strip(chart, loop, rows, strip)
    chart.mark(marks)
    return chart.markup()


def _draw_strip(chart: Chart, loop: Comparison, rows: int, strip: float) -> dict[float, str]:
    """Draw the measured loop over its period above the map, to tell reversals from plateaus; return its mark."""
    share, middle = np.arange(len(loop.displacement)) / len(loop.displacement), rows + 0.5 * strip
    for look, values, dash in (("muted", loop.displacement, "dashed"), ("ink", loop.force, "solid")):
        known = values[np.isfinite(values)]
        if known.size:
            centred = (values - 0.5 * (known.max() + known.min())) / (np.ptp(known) or 1.0)
            chart.curve("", look, share, middle + 0.8 * strip * centred, line_dash=dash, line_width=1.2)
    return {middle: "x, T"}


def law_view(law: ResidualLaw | None) -> Markup | None:
    """Return what an unlisted effect does as a curve with its 90 % interval, or None where there is none."""
    curve = law_curve(law)
    if curve is None:
        return None
    names, x, y, half_width = curve
    chart = Chart(f"{names[1]} over {names[0]}", *names)
    chart.band("after", x, y - half_width, y + half_width)
    chart.level(0.0)
    chart.curve("difference", "after", x, y)
    chart.read(along=True)
    return chart.markup()


class PlausibleRange(NamedTuple):
    """Where a parameter lies in its plausible range, drawn, and who says that range."""

    drawing: Markup
    source: str


def plausible_range(estimate: Estimate, recorded: str) -> PlausibleRange | None:
    """Return where an effect's parameter lies in its plausible range, or None where there is none.

    Those of forces and lengths are a rig's: in `recorded` joints that a motion drives they go with the joint.
    """
    name, _, field = estimate.name.rpartition(".")
    kind = catalogue().get(name)
    known = kind is not None and (recorded not in {one.id for one in DRIVEN} or of_any_size(kind, estimate.unit))
    prior = declared_priors(kind).get(field) if kind is not None and known else None
    ends = (estimate.low, estimate.value, estimate.high)
    if prior is None or not np.isfinite(ends).all() or not prior.high > prior.low:
        return None
    low, value, high = (8.0 + 124.0 * _share(prior, end) for end in ends)
    unit, size = readable_unit(max(abs(prior.low), abs(prior.high)), estimate.unit)
    words = f"plausible {number(prior.low / size)} to {number(prior.high / size)} {pretty_unit(unit)}".rstrip()
    drawing = Markup('<svg class="range" viewBox="0 0 140 16" role="img" aria-label="{0}"><title>{0}</title>'
                     '<path class="rail" d="M8 8H132M8 4V12M132 4V12"/><path class="reach" d="M{1:.1f} 8H{2:.1f}"/>'
                     '<circle cx="{3:.1f}" cy="8" r="2.4"/></svg>').format(words, low, max(high, low + 1.0), value)
    return PlausibleRange(drawing, prior.source)


def _share(prior: Prior, value: float) -> float:
    """Return where `value` lies in a plausible range, a little beyond its ends at most."""
    if prior.logarithmic:
        share = np.log(max(value, 1e-300) / prior.low) / np.log(prior.high / prior.low)
    else:
        share = (value - prior.low) / (prior.high - prior.low)
    return float(np.clip(share, -0.05, 1.05))


@dataclass(frozen=True)
class TestsView:
    """A chart for each prediction, with its title and what it says."""

    __test__ = False

    panels: tuple[tuple[str, Markup, str], ...]  # "before" or "after", chart, words


def tests_view(tests: WearTests | None, with_after: bool) -> TestsView | None:
    """Return the worn volumes as charts on one scale, or None where there are none."""
    if tests is None or not len(tests.measured):
        return None
    shown = [("before", tests.before, tests.r2_before)] + (
        [("after", tests.after, tests.r2_after)] if with_after else [])
    unit, size = readable_unit(float(np.median(tests.measured)), "m^3")
    if unit == "um^3":
        unit, size = "mm^3", 1e-9  # which wear volumes are told in
    limits = extent([values / size for values in (tests.measured, *(one[1] for one in shown))], around_zero=True)
    return TestsView(tuple((name, _chart(tests, values, name, pretty_unit(unit), size, limits),
                            f"R² = {number(r2, 0.01)}") for name, values, r2 in shown))


def _chart(tests: WearTests, predicted: Array, name: str, unit: str, size: float, limits: Limits) -> Markup:
    chart = Chart(f"predicted volume {name} over measured volume of each test", f"measured volume ({unit})",
                  f"predicted volume ({unit})", limits, limits)
    chart.curve("equal", "muted", np.array(limits), np.array(limits))
    chart.points(name, name, tests.measured / size, predicted / size, [
        f"row {row}: measured {number(float(x))} {unit}, predicted {number(float(y))}"
        for row, x, y in zip(tests.rows, tests.measured / size, predicted / size, strict=True)])
    return chart.markup()
