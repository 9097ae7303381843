"""The report's maps of differences over loop and phase, and the law read off the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import DRIVEN, Prior, declared_priors
from fretflow.inference.verdict import Comparison, Diagnosis, Estimate, ResidualLaw, ResidualMap, WearTests
from fretflow.inference.words import channel_words, number, of_any_size
from markupsafe import Markup
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.report.loops import SAME, has_after
from fretflow_post.report.svg import (
    BOTTOM,
    LETTER,
    RIGHT,
    TOP,
    WIDTH,
    Axis,
    Chart,
    colour_bar,
    coloured,
    extent,
    horizontal,
    vertical,
)

Array = NDArray[np.float64]

LARGE = 12.0  # sd: above it colours follow the square root, so that what is left after is seen beside what was before
SMALLEST_LIMIT = 6.0  # sd: smaller differences than this are never drawn in full colour
LARGEST_SHARE = 0.99  # of the differences before lies within the colours
STRIP = 46.0  # pixels, height of the loop above a map
LONGEST_NAME = 22  # letters of a row's name
MOST_COLUMNS = 400  # of a map
NORMAL_90 = 1.645  # sd of half a 90 % interval
RADIUS = 3.4  # pixels


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
    scale: Markup
    limit: str
    root: bool  # whether colours follow the square root
    with_strip: bool


def map_views(diagnosis: Diagnosis) -> MapViews | None:
    """Return the differences of `diagnosis` as maps, or None where there are none."""
    maps = [one for one in diagnosis.residual_maps if np.nanmax(np.abs(one.before), initial=0.0) > SAME]
    if not maps:
        return None
    known = np.concatenate([np.abs(one.before[np.isfinite(one.before)]) for one in maps])
    limit = style.round_scale(max(SMALLEST_LIMIT, float(np.quantile(known, LARGEST_SHARE))))[0]
    after = has_after(diagnosis.comparisons) or any(
        np.isfinite(one.after).any() and not np.array_equal(one.after, one.before, equal_nan=True) for one in maps)
    loop = next((one for one in diagnosis.comparisons if one.time is None), None)
    views, strips = [], []
    for one in maps:
        strip = loop if loop is not None and len(loop.displacement) == one.before.shape[1] else None
        strips.append(strip is not None)
        views.append(MapView(channel_words(one.channel), _map(one, one.before, "before", limit, strip),
                             _map(one, one.after, "after", limit, strip) if after else None))
    scale = colour_bar(style.SHAPE_MAP, -1.0, 1.0, "(measured − predicted) / standard deviation", _marks(limit))
    return MapViews(tuple(views), scale, f"{limit:g}", limit > LARGE, all(strips))


def _exponent(limit: float) -> float:
    return 0.5 if limit > LARGE else 1.0


def _marks(limit: float) -> list[tuple[float, str]]:
    """Return place and text of the ticks of the colours' scale, as far apart as their texts need."""
    exponent, places = _exponent(limit), [0.0]
    for tick in style.root_ticks(limit)[1:]:
        at = (tick / limit) ** exponent
        if at - places[-1] > 0.2 and (1.0 - at > 0.2 or tick == limit):
            places.append(at)
    return [(0.5 + 0.5 * sign * at, f"{sign * limit * at ** (1.0 / exponent):.3g}".replace("-", "−"))
            for at in places for sign in ((-1, 1) if at else (1,))]


def _map(one: ResidualMap, values: Array, when: str, limit: float, loop: Comparison | None) -> Markup:
    columns = np.unique(np.linspace(0, values.shape[1] - 1, min(MOST_COLUMNS, values.shape[1])).astype(int))
    values, rows = values[:, columns], len(values)
    row = float(np.clip(240.0 / rows, 3.0, 22.0))
    names = [name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME - 1]}…" for name in one.rows]
    left = 14.0 + LETTER * max([len(name) for name in names], default=0)
    strip = 0.0 if loop is None else STRIP
    top = TOP + strip
    height = top + rows * row + BOTTOM
    chart = Chart(horizontal("share of the period", 0.0, 1.0, left=left), Axis("", 0.0, 1.0, height - BOTTOM, top),
                  f"{channel_words(one.channel)} {when}: difference over its standard deviation, by loop and phase",
                  height=height)
    box = (left, top, WIDTH - RIGHT - left, rows * row)
    shades = np.sign(values) * (np.abs(values) / limit) ** _exponent(limit)
    chart.image(coloured(shades, style.SHAPE_MAP, -1.0, 1.0), box)
    chart.values(values, 0.1, box, "sd", one.rows)
    for k in range(0, rows, max(1, int(np.ceil(12.0 / row)))):
        at = top + (k + 0.5) * row + 4.0
        chart.parts.append(Markup('<text class="tick" x="{:.1f}" y="{:.1f}" text-anchor="end">{}</text>').format(
            left - 6.0, at, names[k]))
    if loop is not None:
        _draw_strip(chart, loop, left)
    return chart.markup(y_axis=False)


def _draw_strip(chart: Chart, loop: Comparison, left: float) -> None:
    """Draw the measured loop over its period above the map, to tell where reversals and plateaus are."""
    above = Chart(chart.x, Axis("", -1.1, 1.1, TOP + STRIP - 6.0, TOP), "")
    share = np.arange(len(loop.displacement)) / len(loop.displacement)
    for look, values, sign in (("thin-displacement", loop.displacement, "x"), ("thin-force", loop.force, "T")):
        if not np.isfinite(values).any():
            continue
        middle = 0.5 * (np.nanmax(values) + np.nanmin(values))
        reach = 0.5 * np.ptp(values[np.isfinite(values)]) or 1.0
        above.curve(sign, look, share, (values - middle) / reach)
        above.text(left - 14.0, TOP + (14.0 if sign == "x" else 32.0), sign, f"tick {look}-text")
    chart.parts += above.parts


def law_view(law: ResidualLaw | None) -> Markup | None:
    """Return what an unlisted effect does as a curve with its 90 % interval, or None where there is none."""
    if law is None or not (np.isfinite(law.x) & np.isfinite(law.y)).any():
        return None
    (x_unit, x_size), (y_unit, y_size) = (readable_unit(float(np.nanmax(np.abs(values))), unit) for values, unit in (
        (law.x, law.state_unit), (law.y, law.channel_unit)))
    order = np.argsort(law.x)
    x, y, reach = law.x[order] / x_size, law.y[order] / y_size, NORMAL_90 * law.sd[order] / y_size
    units = [pretty_unit(unit) for unit in (x_unit, y_unit)]
    names = [f"{name} ({unit})" if unit else name for name, unit in zip(
        (law.state, f"{channel_words(law.channel)}, measured − predicted"), units, strict=True)]
    chart = Chart(horizontal(names[0], *extent([x], 0.02), units[0]),
                  vertical(names[1], *extent([y, y - reach, y + reach], around_zero=True), units[1]),
                  f"{names[1]} over {names[0]}", readout="trace")
    chart.band("interval", x, y - reach, y + reach)
    chart.level("zero", 0.0)
    chart.curve("difference", "after", x, y)
    return chart.markup()


def plausible_range(estimate: Estimate, recorded: str) -> Markup | None:
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
    return Markup('<svg class="range" viewBox="0 0 140 16" role="img" aria-label="{0}"><title>{0}</title>'
                  '<path class="rail" d="M8 8H132M8 4V12M132 4V12"/><path class="reach" d="M{1:.1f} 8H{2:.1f}"/>'
                  '<circle cx="{3:.1f}" cy="8" r="2.4"/></svg>').format(words, low, max(high, low + 1.0), value)


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
    reach = extent([values / size for values in (tests.measured, *(one[1] for one in shown))], around_zero=True)
    printed = pretty_unit(unit)
    return TestsView(tuple((name, _chart(tests, values, name, printed, size, reach), f"R² = {number(r2, 0.01)}")
                           for name, values, r2 in shown))


def _chart(tests: WearTests, predicted: Array, name: str, unit: str, size: float, reach: tuple[float, float]) -> Markup:
    chart = Chart(horizontal(f"measured volume ({unit})", *reach, unit), vertical(f"predicted volume ({unit})", *reach,
                                                                                   unit),
                  f"predicted volume {name} over measured volume of each test")
    ends = np.array(reach)
    chart.curve("equal", "equal", ends, ends)
    for row, x, y in zip(tests.rows, tests.measured / size, predicted / size, strict=True):
        chart.parts.append(Markup(
            '<circle class="at {}" cx="{:.1f}" cy="{:.1f}" r="{}"><title>row {}: measured {} {}, predicted {}</title>'
            "</circle>").format(name, float(chart.x.pixels(x)), float(chart.y.pixels(y)), RADIUS, row, number(float(x)),
                                unit, number(float(y))))
    return chart.markup()
