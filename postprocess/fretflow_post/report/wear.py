"""The report's wear: maps of depth measured and predicted, what they differ by, and profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import WearMap
from fretflow.inference.words import number
from markupsafe import Markup
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.report.loops import LOW
from fretflow_post.report.svg import BOTTOM, RIGHT, TOP, Chart, colour_bar, coloured, extent, horizontal, vertical
from fretflow_post.wear_maps import differences, known_maps, profile, raster

Array = NDArray[np.float64]

EVERY = 3  # of a map's pixels is kept for the readout
EVEN = 0.5  # of the largest depth: where no point is shallower, colours do not begin at zero


@dataclass(frozen=True)
class WearViews:
    """Wear depth measured and predicted on one scale and their differences on another, each map with words below."""

    panels: tuple[tuple[str, Markup, str], ...]  # name, map, words
    scale: Markup
    begins: str  # where the colours begin, if not at zero
    away: tuple[tuple[str, Markup, str], ...]
    away_scale: Markup | None
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
        return f"mean {number(float(np.nanmean(values)) / size)} {unit}, {second} {number(most / size)} {unit}"

    panels = tuple((name, _wear_map(wear, values / size, f"wear depth {name}", style.DEPTH_MAP, (low, high), unit),
                    told(values, "deepest", float(np.nanmax(values)))) for name, values in shown.items())
    reach = max((float(np.nanmax(np.abs(values))) for values in away.values()), default=0.0) / size or 1.0
    off = tuple((name, _wear_map(wear, values / size, f"measured − {name}", style.SHAPE_MAP,
                                 (-reach, reach), unit), told(values, "sd", float(np.nanstd(values))))
                for name, values in away.items())
    return WearViews(
        panels, colour_bar(style.DEPTH_MAP, low, high, f"wear depth ({unit})"), f"{number(low)} {unit}" if low > 0.0
        else "", off, colour_bar(style.SHAPE_MAP, -reach, reach, f"measured − predicted ({unit})")
        if off else None, _profiles(wear, shown, size, unit))


def _profiles(wear: WearMap, shown: dict[str, Array], size: float, unit: str) -> Markup:
    """Return the mean depth across over x, with the sd of the measured one across."""
    found = {name: profile(wear.x * 1e3, values / size) for name, values in shown.items()}
    x, mean, sd = found["measured"]
    reach = extent([mean - sd, mean + sd, *(one[1] for one in found.values())])
    chart = Chart(horizontal("x, sliding direction (mm)", *extent([x], 0.02), "mm"),
                  vertical(f"mean depth across ({unit})", *reach, unit, LOW), "mean wear depth across, over x",
                  height=LOW, readout="trace")
    chart.band("spread", x, mean - sd, mean + sd)
    for name, (at, own, _) in found.items():
        chart.curve(name, name, at, own)
    return chart.markup()


def _lowest(least: float, largest: float) -> float:
    """Return where the colours of depth begin: at zero, unless that would hide the shape of even wear."""
    if least < EVEN * largest or not largest > least:
        return min(0.0, least)
    step = 10.0 ** np.floor(np.log10(largest - least))
    return float(np.floor(least / step) * step)


def _wear_map(wear: WearMap, depth: Array, name: str, colours: str, limits: tuple[float, float], unit: str) -> Markup:
    length_unit, size = readable_unit(float(np.nanmax(np.abs(np.r_[wear.x, wear.y]), initial=0.0)), "m")
    x, y = wear.x / size, wear.y / size
    pixels, (left, right, low, high) = raster(x, y, depth)
    shape = (high - low) / (right - left)
    width, inner = 330.0, 330.0 - 54.0 - RIGHT
    height = float(np.clip(inner * shape, 40.0, 600.0)) + TOP + BOTTOM
    printed = pretty_unit(length_unit)
    chart = Chart(horizontal(f"x, sliding direction ({printed})", left, right, printed, width, 54.0),
                  vertical(f"y ({printed})", low, high, printed, height), name, width, height)
    box = (54.0, TOP, inner, height - TOP - BOTTOM)
    chart.image(coloured(pixels, colours, *limits), box)
    chart.values(pixels[EVERY // 2::EVERY, EVERY // 2::EVERY], (limits[1] - limits[0]) / 1000.0, box, unit)
    return chart.markup()
