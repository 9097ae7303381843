"""The report's wear: maps of depth measured and predicted, what they differ by, and profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import WearMap
from fretflow.inference.words import number
from markupsafe import Markup

from fretflow_post import style
from fretflow_post.report.charts import LOW, MARGINS, Chart, Limits
from fretflow_post.wear_maps import differences, known_maps, profile, raster

X_LABEL, Y_LABEL = "x, sliding direction (mm)", "y (mm)"
EVERY = 2  # of a picture's pixels is kept
INNER, SIDES = 264, 66  # pixels of a map, and beside it
EVEN = 0.5  # of the largest depth: where no point is shallower, colours do not begin at zero


@dataclass(frozen=True)
class WearViews:
    """Wear depth measured and predicted on one scale and their differences on another, each map with words below."""

    panels: tuple[tuple[str, Markup, str], ...]  # name, map, words
    begins: str  # where the colours begin, if not at zero
    away: tuple[tuple[str, Markup, str], ...]
    profiles: Markup


def wear_views(wear: WearMap | None, after: bool) -> WearViews | None:
    """Return the wear maps, or None where nothing was measured."""
    if wear is None or not np.isfinite(wear.measured).any():
        return None
    shown, away = known_maps(wear, after), differences(wear, after)
    largest = max(float(np.nanmax(values)) for values in shown.values())
    plain, size = readable_unit(largest, "m")
    unit = pretty_unit(plain)
    low = _lowest(min(float(np.nanmin(values)) for values in shown.values()) / size, largest / size)
    high = max(largest / size, low + 1e-12) if largest > 0.0 else low + 1.0

    def told(values: Array, second: str, most: float) -> str:
        mean = number(float(np.nanmean(values)) / size)
        return f"mean of the points {mean} {unit}, {second} {number(most / size)} {unit}"

    panels = tuple((name, _wear_map(wear, values / size, f"wear depth {name}", style.DEPTH_MAP, (low, high),
                                    f"wear depth ({unit})"),
                    told(values, "deepest", float(np.nanmax(values)))) for name, values in shown.items())
    limit = max((float(np.nanmax(np.abs(values))) for values in away.values()), default=0.0) / size or 1.0
    off = tuple((name, _wear_map(wear, values / size, f"measured − {name}", style.SHAPE_MAP, (-limit, limit),
                                 f"measured − predicted ({unit})"),
                 told(values, "sd", float(np.nanstd(values)))) for name, values in away.items())
    return WearViews(panels, f"{number(low)} {unit}" if low > 0.0 else "", off, _profiles(wear, shown, size, unit))


def _profiles(wear: WearMap, shown: dict[str, Array], size: float, unit: str) -> Markup:
    """Return the mean depth across over x, with the sd of the measured one across."""
    profiles = {name: profile(wear.x * 1e3, values / size) for name, values in shown.items()}
    x, mean, sd = profiles["measured"]
    chart = Chart("mean wear depth across, over x", X_LABEL, f"mean depth across ({unit})",
                  height=LOW)
    chart.band("measured", x, mean - sd, mean + sd)
    for name, (at, own, _) in profiles.items():
        chart.curve(name, name, at, own)
    chart.read(along=True)
    return chart.markup()


def _lowest(least: float, largest: float) -> float:
    """Return where the colours of depth begin: at zero, unless that would hide the shape of even wear."""
    if least < EVEN * largest or not largest > least:
        return min(0.0, least)
    step = 10.0 ** np.floor(np.log10(largest - least))
    return float(np.floor(least / step) * step)


def _wear_map(wear: WearMap, depth: Array, name: str, colours: str, limits: Limits, label: str) -> Markup:
    pixels, box = raster(1e3 * wear.x, 1e3 * wear.y, depth)
    left, right, low, high = box
    height = round(float(np.clip(INNER * (high - low) / (right - left), 40.0, 600.0)))
    chart = Chart(name, X_LABEL, Y_LABEL, (left, right), (low, high), height + MARGINS, INNER + SIDES)
    chart.image(pixels[EVERY // 2::EVERY, EVERY // 2::EVERY], box, style.palette(colours), limits, label)
    return chart.markup()
